//! Huffman codes of baseline JPEG: reads past coefficients without decoding their values.

use super::FrameFault;

/// Longest code, bits.
const MAX_CODE_BITS: usize = 16;
/// Coefficients of a block.
const BLOCK_COEFFICIENTS: u8 = 64;

/// One Huffman table, in the form of ITU-T T.81, F.2.2.3.
#[derive(Debug, Clone)]
pub(super) struct HuffmanTable {
    /// For each code length: the smallest 16-bit value, with the code in its high bits, that lies above all codes of this
    /// length and of shorter lengths.
    ends: [u32; MAX_CODE_BITS],
    /// For each code length: what to add to a code of this length to get the index of its value.
    offsets: [i32; MAX_CODE_BITS],
    values: [u8; 256],
}

impl HuffmanTable {
    /// Builds the table from the number of codes of each length and the values in order of their codes.
    pub(super) fn new(counts: &[u8; MAX_CODE_BITS], values: &[u8]) -> Self {
        let mut table = Self { ends: [0; MAX_CODE_BITS], offsets: [0; MAX_CODE_BITS], values: [0; 256] };
        table.values.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
        let (mut code, mut index) = (0, 0);
        for (bits, ((count, end), offset)) in (1..).zip(counts.iter().zip(&mut table.ends).zip(&mut table.offsets)) {
            *offset = index - code;
            code += i32::from(*count);
            index += i32::from(*count);
            *end = code.cast_unsigned() << (MAX_CODE_BITS - bits);
            code *= 2;
        }
        table
    }

    /// The code at the start of `bits`, 16 bits of the stream: its length and its value.
    fn decode(&self, bits: u32) -> Option<(u32, u8)> {
        let shorter = self.ends.iter().take_while(|end| bits >= **end).count();
        let code = i32::try_from(bits >> (MAX_CODE_BITS - 1).checked_sub(shorter)?).ok()?;
        let value = self.values.get(usize::try_from(code + self.offsets.get(shorter)?).ok()?)?;
        Some((u32::try_from(shorter + 1).ok()?, *value))
    }
}

/// Reads the bits of entropy-coded data up to the next marker.
#[derive(Debug)]
pub(super) struct BitReader<'a> {
    bytes: &'a [u8],
    /// Index of the next byte to be loaded.
    at: usize,
    buffer: u64,
    /// Bits of `buffer` that were not consumed yet.
    left: u32,
}

impl<'a> BitReader<'a> {
    pub(super) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at, buffer: 0, left: 0 }
    }

    /// Reads one block of coefficients.
    ///
    /// # Errors
    /// [`FrameFault::Incomplete`] if the image ends within the block, [`FrameFault::Corrupt`] for an undefined code, for
    /// coefficients beyond the last one, and for a marker within the block.
    pub(super) fn block(&mut self, dc: &HuffmanTable, ac: &HuffmanTable) -> Result<(), FrameFault> {
        let bits = self.code(dc)?;
        self.consume(bits.into())?;
        let mut coefficient = 1;
        while coefficient < BLOCK_COEFFICIENTS {
            let code = self.code(ac)?;
            let (zeros, bits) = (code >> 4, code & 15);
            // A code without a value ends the block, except for a run of 16 zeros.
            if bits == 0 && zeros < 15 {
                break;
            }
            self.consume(bits.into())?;
            coefficient += zeros + 1;
        }
        if coefficient > BLOCK_COEFFICIENTS { Err(FrameFault::Corrupt) } else { Ok(()) }
    }

    /// Index of the first byte of which no bit was consumed.
    pub(super) fn next_byte(&self) -> usize {
        (0..self.left / 8).fold(self.at, |at, _| {
            let is_stuffed = at >= 2 && self.bytes.get(at - 2..at) == Some(&[0xff, 0]);
            at.saturating_sub(if is_stuffed { 2 } else { 1 })
        })
    }

    fn code(&mut self, table: &HuffmanTable) -> Result<u8, FrameFault> {
        self.load();
        let bits = if self.left >= 16 { self.buffer >> (self.left - 16) } else { self.buffer << (16 - self.left) };
        let (length, value) = table.decode((bits & 0xffff) as u32).ok_or(FrameFault::Corrupt)?;
        self.consume(length)?;
        Ok(value)
    }

    fn consume(&mut self, bits: u32) -> Result<(), FrameFault> {
        if self.left < bits {
            self.load();
        }
        let at_end = if self.at < self.bytes.len() { FrameFault::Corrupt } else { FrameFault::Incomplete };
        self.left = self.left.checked_sub(bits).ok_or(at_end)?;
        Ok(())
    }

    /// Loads whole bytes up to the next marker. A data byte 0xff is followed by a stuffed 0.
    fn load(&mut self) {
        while self.left <= 32 {
            let (byte, length) = match self.bytes.get(self.at..) {
                Some([0xff, 0, ..]) => (0xff, 2),
                Some([byte, ..]) if *byte != 0xff => (*byte, 1),
                _ => return,
            };
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.left += 8;
            self.at += length;
        }
    }
}
