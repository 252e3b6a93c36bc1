//! Compares the reader of iFacialMocap's requests with a second implementation.

use facewire_packet::formats::ifacialmocap::request;

const REQUEST: &str = "iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719";

/// Checks that the bytes are read as the second implementation reads them, and that a request is read whatever white space
/// and zeros follow it.
pub fn subscription(data: &[u8]) {
    assert_eq!(request(data), expected(data));
    let filling: Vec<u8> = data.iter().map(|byte| [0, b' ', b'\n', b'\t'][usize::from(*byte) % 4]).collect();
    for (ending, version) in [("", 1), ("|sendDataVersion=v2", 2)] {
        let datagram = [REQUEST.as_bytes(), ending.as_bytes(), &filling].concat();
        assert_eq!(request(&datagram), Some(version));
    }
}

/// Reads a request as text. Returns the version that it asks for.
fn expected(data: &[u8]) -> Option<u32> {
    let text = String::from_utf8_lossy(data);
    let ending = text.strip_prefix(REQUEST)?.trim_end_matches(|c: char| c == '\0' || c.is_ascii_whitespace());
    match ending {
        "|sendDataVersion=v2" => Some(2),
        ending if ending.is_empty() || ending.starts_with('|') => Some(1),
        _ => None,
    }
}
