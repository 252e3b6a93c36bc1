//! The name of a wearer.

use core::fmt;

/// Longest name, bytes.
const MAX_LENGTH: usize = 32;

/// The name of a wearer, which is also that of a file: 1 to 32 letters, digits, `-` and `_` of ASCII.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct WearerName(String);

impl WearerName {
    /// What a name may be; the text follows "give".
    pub const EXPECTED: &'static str = "1 to 32 letters, digits, - or _";

    /// Reads a name. `None` if it is too long, or has characters that a name may not have.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        let is_sane = text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
        // A name that begins with - would be taken for an option.
        let is_good = is_sane && (1..=MAX_LENGTH).contains(&text.len()) && !text.starts_with('-');
        is_good.then(|| Self(text.to_owned()))
    }

    /// Like [`WearerName::new`], for arguments.
    ///
    /// # Errors
    /// Says what a name may be.
    pub fn parse(text: &str) -> Result<Self, String> {
        Self::new(text).ok_or_else(|| format!("give {}", Self::EXPECTED))
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for WearerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_could_be_paths_options_or_hidden_files_are_refused() {
        for bad in ["", ".", "..", "a/b", "../a", ".a", "-a", "a b", "a\n", "a\0", "é", "a.toml", &"a".repeat(33)] {
            assert_eq!(WearerName::new(bad), None, "{bad:?}");
        }
        for good in ["anna", "Anna-2", "_", "7", &"a".repeat(32)] {
            assert_eq!(WearerName::new(good).map(|name| name.to_string()).as_deref(), Some(good));
        }
    }
}
