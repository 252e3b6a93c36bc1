//! Why a network cannot be used.

use std::fmt;

/// Why a network cannot be used. Displayed without its kind, which the caller's sentence states with the file and the
/// remedy: "NAME is damaged (its checksum does not match: it was cut short or changed)".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error {
    /// The file does not contain an intact network. Writing it again helps.
    Damaged(&'static str),
    /// The file contains a network that this engine cannot run. Another engine may.
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
