//! Reads numbers from the bytes of the fuzzer.

/// The bytes that have not been read yet.
pub struct Input<'a>(pub &'a [u8]);

impl Input<'_> {
    /// Takes the next `N` bytes. Bytes past the end are 0.
    pub fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let mut taken = [0; N];
        let (front, rest) = self.0.split_at(N.min(self.0.len()));
        taken[..front.len()].copy_from_slice(front);
        self.0 = rest;
        taken
    }

    /// Takes the next byte.
    pub fn byte(&mut self) -> u8 {
        let [byte] = self.bytes();
        byte
    }

    /// Takes the next 16 bits.
    pub fn short(&mut self) -> u16 {
        u16::from_le_bytes(self.bytes())
    }

    /// Takes the next 32 bits.
    pub fn word(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }
}
