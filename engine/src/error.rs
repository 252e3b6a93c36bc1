//! Why a network cannot be used.

use std::fmt;

/// Why a network cannot be used. The text completes a sentence that names the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Error {
    /// The file does not hold a network.
    Damaged(&'static str),
    /// The file holds a network, and this engine has no way to run it.
    Unsupported(&'static str),
}

impl fmt::Display for Error {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damaged(reason) => write!(formatter, "damaged: {reason}"),
            Self::Unsupported(reason) => write!(formatter, "not supported: {reason}"),
        }
    }
}

impl std::error::Error for Error {}
