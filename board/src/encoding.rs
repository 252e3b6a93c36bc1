//! Text files as editors and shells save them: in UTF-8, with a byte order mark or without, or by mistake in another encoding.

/// Why a file is not read: the line with the first byte that is not UTF-8, counted from 1, and a sentence without its end.
#[derive(Debug, PartialEq, Eq)]
pub struct WrongEncoding {
    pub line: usize,
    pub sentence: &'static str,
}

/// Returns the text of a file in UTF-8, with its byte order mark if it has one, which parsers of TOML pass over.
pub fn utf8(file: Vec<u8>) -> Result<String, WrongEncoding> {
    if is_utf16(&file) {
        let sentence = "the file is in UTF-16, as some editors and older PowerShells save it; save it as UTF-8";
        return Err(WrongEncoding { line: 1, sentence });
    }
    String::from_utf8(file).map_err(|error| {
        let good = error.as_bytes().iter().take(error.utf8_error().valid_up_to());
        let line = 1 + good.filter(|byte| **byte == b'\n').count();
        WrongEncoding { line, sentence: "this line is not in UTF-8; save the file as UTF-8" }
    })
}

/// Whether a file begins with the byte order mark of UTF-16, or with a letter of ASCII in UTF-16.
pub fn is_utf16(file: &[u8]) -> bool {
    matches!(file, [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] | [0, 1..=0xFF, ..] | [1..=0xFF, 0, ..])
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# höhe\n[camera]\n";

    fn utf16(bytes_of: fn(u16) -> [u8; 2], mark: &str) -> Vec<u8> {
        format!("{mark}{TEXT}").encode_utf16().flat_map(bytes_of).collect()
    }

    #[test]
    fn utf8_is_read_with_and_without_a_byte_order_mark() {
        for text in [TEXT, "\u{feff}# h\u{f6}he\n", "", "a"] {
            assert_eq!(utf8(text.into()).unwrap(), text);
        }
    }

    #[test]
    fn another_encoding_is_named_with_its_first_line() {
        for bytes_of in [u16::to_le_bytes, u16::to_be_bytes] {
            for mark in ["", "\u{feff}"] {
                let wrong = utf8(utf16(bytes_of, mark)).unwrap_err();
                assert!(wrong.line == 1 && wrong.sentence.starts_with("the file is in UTF-16"), "{wrong:?}");
            }
        }
        let latin1 = b"[camera]\n# gr\xFC\xDFe\ndevice = \"demo\"\n".to_vec();
        let sentence = "this line is not in UTF-8; save the file as UTF-8";
        assert_eq!(utf8(latin1).unwrap_err(), WrongEncoding { line: 2, sentence });
        assert_eq!(utf8(b"a\r\nb\r\n\xC3".to_vec()).unwrap_err(), WrongEncoding { line: 3, sentence });
    }
}
