//! Faults of settings.

use std::{fmt, io, path::PathBuf};

use super::value::SerialDevice;

/// A fault of the settings. `place` is its position as `file:line`.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The file cannot be read.
    #[error("{}: cannot be read ({error}); give --config a readable file", path.display())]
    Unreadable {
        /// The path of the file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// An unknown board.
    #[error("board \"{name}\": not known; give --board one of {known}")]
    UnknownBoard {
        /// The name given.
        name: String,
        /// The known names.
        known: String,
    },
    /// A syntax error of TOML.
    #[error("{place}: not valid TOML: {message}")]
    Syntax {
        /// The position.
        place: String,
        /// The message of the parser.
        message: String,
    },
    /// An unknown key or table.
    #[error("{place}: {key} is not a setting{hint}")]
    Unknown {
        /// The position.
        place: String,
        /// The key.
        key: String,
        /// The end of the sentence, which names the most similar key.
        hint: String,
    },
    /// A setting of an earlier version.
    #[error("{place}: {key} is no longer a setting: {instead}")]
    Replaced {
        /// The position.
        place: String,
        /// The key.
        key: String,
        /// What to give instead.
        instead: &'static str,
    },
    /// A value of the wrong type, or out of bounds.
    #[error("{place}: {key} = {value}: give {expected}")]
    Value {
        /// The position.
        place: String,
        /// The key.
        key: String,
        /// The value in the file.
        value: String,
        /// The type and the bounds.
        expected: String,
    },
    /// A key that only links of another kind have.
    #[error("{place}: {key} is not a setting of a link with kind = \"{kind}\"; that has {known}")]
    OtherKind {
        /// The position.
        place: String,
        /// The key.
        key: String,
        /// The kind of the link.
        kind: &'static str,
        /// The keys of this kind.
        known: String,
    },
    /// Two links with the same serial port.
    #[error("link.device = \"{device}\": an earlier link has the same port; give this link another one, or remove it")]
    SamePort {
        /// The serial port.
        device: SerialDevice,
    },
    /// A link to any board beside a link to a certain one.
    #[error(
        "link.device = \"auto\": another link has the port {other}, which \"auto\" may find, too; give the path of a \
         port, or remove this link"
    )]
    AutoBeside {
        /// The other link's port.
        other: SerialDevice,
    },
    /// A serial line that is too slow for the packets of its link.
    #[error(
        "link.baud = {baud}: give {advice}: {rate_hz} packets a second need more than 80 % of the line at {device}"
    )]
    SlowLine {
        /// The serial port.
        device: SerialDevice,
        /// Its baud rate.
        baud: u32,
        /// The most packets per second that the link sends.
        rate_hz: u32,
        /// What to give instead.
        advice: String,
    },
    /// A value that does not fit another setting.
    #[error("{key} = {value}: give {expected}")]
    Together {
        /// The key to change.
        key: &'static str,
        /// Its value.
        value: String,
        /// The values that fit.
        expected: String,
    },
}

/// All faults of the settings, displayed one per line.
#[derive(Debug, Default, thiserror::Error)]
pub struct Faults(Vec<Fault>);

impl Faults {
    pub(super) fn push(&mut self, fault: Fault) {
        self.0.push(fault);
    }

    /// Returns `value` if there are no faults.
    pub(super) fn into_result<T>(self, value: T) -> Result<T, Self> {
        if self.0.is_empty() { Ok(value) } else { Err(self) }
    }

    /// Whether a value in this table is a fault by itself.
    pub(super) fn concern(&self, table: &str) -> bool {
        let in_table = |key: &str| key.split('.').next() == Some(table);
        self.0.iter().any(|fault| matches!(fault, Fault::Value { key, .. } if in_table(key)))
    }

    /// Iterates over the faults.
    pub fn iter(&self) -> impl Iterator<Item = &Fault> {
        self.0.iter()
    }
}

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines: Vec<String> = self.0.iter().map(Fault::to_string).collect();
        f.write_str(&lines.join("\n"))
    }
}
