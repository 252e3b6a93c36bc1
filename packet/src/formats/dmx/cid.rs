//! The component identifier of an E1.31 source, a hash of secret parts.

/// The name space of facewire's identifiers, chosen at random.
const NAME_SPACE: [u8; 16] = *b"\x8D\x1B\x5E\x37\x4A\xC2\x4F\x90\xB6\x0E\x2C\x71\xD9\x3F\xA8\x54";
/// The state of SHA-1 before the first block (RFC 3174).
const BEGIN: [u32; 5] = [0x6745_2301, 0xEFCD_AB89, 0x98BA_DCFE, 0x1032_5476, 0xC3D2_E1F0];
const BLOCK: usize = 64;

/// Returns the identifier of a source: a UUID of version 5 (RFC 9562). Equal `parts` give equal identifiers, which do not
/// reveal them.
#[must_use]
pub fn cid(parts: &[&str]) -> [u8; 16] {
    uuid(NAME_SPACE, parts.join("\n").as_bytes())
}

fn uuid(name_space: [u8; 16], name: &[u8]) -> [u8; 16] {
    let hash = sha1(&[&name_space, name].concat());
    let mut bytes = [0; 16];
    bytes.iter_mut().zip(hash).for_each(|(to, from)| *to = from);
    bytes[6] = bytes[6] & 0x0F | 0x50;
    bytes[8] = bytes[8] & 0x3F | 0x80;
    bytes
}

fn sha1(message: &[u8]) -> [u8; 20] {
    let mut padded = [message, &[0x80]].concat();
    let bits = message.len() as u64 * 8;
    padded.resize((padded.len() + 8).next_multiple_of(BLOCK) - 8, 0);
    padded.extend_from_slice(&bits.to_be_bytes());
    let (words, _) = padded.as_chunks().0.as_chunks::<16>();
    let state = words.iter().fold(BEGIN, |state, block| compress(state, block.map(u32::from_be_bytes)));
    let mut hash = [0; 20];
    hash.iter_mut().zip(state.map(u32::to_be_bytes).as_flattened()).for_each(|(to, from)| *to = *from);
    hash
}

#[expect(clippy::many_single_char_names, reason = "the standard's names")]
fn compress(state: [u32; 5], block: [u32; 16]) -> [u32; 5] {
    let mut words = block;
    let [mut a, mut b, mut c, mut d, mut e] = state;
    for round in 0..80_usize {
        let mixed = match round / 20 {
            0 => (b & c | !b & d).wrapping_add(0x5A82_7999),
            1 => (b ^ c ^ d).wrapping_add(0x6ED9_EBA1),
            2 => (b & c | b & d | c & d).wrapping_add(0x8F1B_BCDC),
            _ => (b ^ c ^ d).wrapping_add(0xCA62_C1D6),
        };
        let next = a.rotate_left(5).wrapping_add(mixed).wrapping_add(e).wrapping_add(words[0]);
        (e, d, c, b, a) = (d, c, b.rotate_left(30), a, next);
        let word = (words[13] ^ words[8] ^ words[2] ^ words[0]).rotate_left(1);
        words.rotate_left(1);
        words[15] = word;
    }
    let mut sums = [a, b, c, d, e];
    sums.iter_mut().zip(state).for_each(|(sum, before)| *sum = sum.wrapping_add(before));
    sums
}

#[cfg(test)]
#[allow(clippy::indexing_slicing)]
mod tests {
    use super::*;

    /// The bytes as one number, so that they are written as in the standards.
    fn number(bytes: &[u8]) -> u128 {
        bytes.iter().fold(0, |number, byte| number << 8 | u128::from(*byte))
    }

    #[test]
    fn an_identifier_is_a_uuid_of_version_5_of_what_is_given() {
        let halves = |message: &[u8]| [0..4, 4..20].map(|part| number(&sha1(message)[part]));
        assert_eq!(halves(b"abc"), [0xa999_3e36, 0x4706_816a_ba3e_2571_7850_c26c_9cd0_d89d]);
        let two_blocks = b"abcdbcdecdefdefgefghfghighijhijkijkljklmklmnlmnomnopnopq";
        assert_eq!(halves(two_blocks), [0x8498_3e44, 0x1c3b_d26e_baae_4aa1_f951_29e5_e546_70f1]);
        // The name space of host names in RFC 9562, and the identifier that Python's `uuid` gives.
        let of_names = *b"\x6B\xA7\xB8\x10\x9D\xAD\x11\xD1\x80\xB4\x00\xC0\x4F\xD4\x30\xC8";
        assert_eq!(number(&uuid(of_names, b"www.example.com")), 0x2ed6_657d_e927_568b_95e1_2665_a8ae_a6a2);
    }

    #[test]
    fn two_machines_and_two_names_have_different_identifiers() {
        let all = [["m1", "face"], ["m2", "face"], ["m1", "head"]].map(|parts| cid(&parts));
        assert!(all[0] != all[1] && all[0] != all[2] && all[0] == cid(&["m1", "face"]), "{all:?}");
    }
}
