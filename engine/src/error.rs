//! Why a network cannot be used.

use std::fmt;

/// Why a network cannot be used.
///
/// `Display` writes only the reason. The caller's message names the file, the kind of error and the remedy, for example
/// "NAME is damaged (its checksum does not match: it was cut short or changed)".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error {
    /// The file does not contain an intact network. Writing the file again helps.
    Damaged(&'static str),
    /// The file contains a network that this engine cannot run. Another engine may be able to run it.
    Unsupported(&'static str),
}

impl fmt::Display for Error {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damaged(reason) | Self::Unsupported(reason) => formatter.write_str(reason),
        }
    }
}

impl std::error::Error for Error {}
