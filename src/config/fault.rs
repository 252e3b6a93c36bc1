//! What can be wrong with settings.

use std::{fmt, io, path::PathBuf};

/// One fault, with its place as `file:line`.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// The file cannot be read.
    #[error("{}: cannot be read ({error}); give --config a readable file", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// No board file of this name is built in.
    #[error("board \"{name}\": not known; give --board one of {known}")]
    UnknownBoard {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// Not TOML.
    #[error("{place}: not valid TOML: {message}")]
    Syntax {
        /// Where.
        place: String,
        /// What the parser says.
        message: String,
    },
    /// A key or table that no setting has.
    #[error("{place}: {key} is not a setting{hint}")]
    Unknown {
        /// Where.
        place: String,
        /// The key.
        key: String,
        /// The nearest name there is, as a half sentence, or nothing.
        hint: String,
    },
    /// A wrong type, or a value out of its bounds.
    #[error("{place}: {key} = {value}: give {expected}")]
    Value {
        /// Where.
        place: String,
        /// The key.
        key: String,
        /// What stands there.
        value: String,
        /// Type and bounds.
        expected: String,
    },
    /// A setting of links of another kind.
    #[error("{place}: {key} is not a setting of a link with kind = \"{kind}\"; that has {known}")]
    OtherKind {
        /// Where.
        place: String,
        /// The key.
        key: String,
        /// The kind of the link.
        kind: &'static str,
        /// What such links have.
        known: String,
    },
    /// A serial link without its port.
    #[error("{place}: link.device is missing: give the path of a serial port; `facewire devices` lists them")]
    NoDevice {
        /// Where the link begins.
        place: String,
    },
    /// Two serial links at one port.
    #[error(
        "link.device = \"{}\": give another port, or leave the link out: \"{}\" of an earlier link is the same", device.display(),
        first.display()
    )]
    SamePort {
        /// The port of the earlier link.
        first: PathBuf,
        /// That of the later.
        device: PathBuf,
    },
    /// More packets than the line of a serial link carries.
    #[error(
        "link.baud = {baud}: give {enough} or more, or camera.fps and send.rate_hz of at most {most_hz}: {rate_hz} packets \
         a second need more than 80 % of the line at {}", device.display()
    )]
    SlowLine {
        /// The serial port.
        device: PathBuf,
        /// Its baud rate.
        baud: u32,
        /// Packets a second, by the settings.
        rate_hz: u32,
        /// Most packets a second that the baud rate carries.
        most_hz: u32,
        /// A usual baud rate that carries them.
        enough: u32,
    },
    /// Settings that do not go together.
    #[error("{key} = {value}: give {expected}")]
    Together {
        /// The key that has to change.
        key: &'static str,
        /// What it is.
        value: String,
        /// What it has to be beside the others.
        expected: String,
    },
}

/// All faults of the settings, shown one a line.
#[derive(Debug, Default, thiserror::Error)]
pub struct Faults(Vec<Fault>);

impl Faults {
    pub(super) fn push(&mut self, fault: Fault) {
        self.0.push(fault);
    }

    /// The value if there are no faults.
    pub(super) fn into_result<T>(self, value: T) -> Result<T, Self> {
        if self.0.is_empty() { Ok(value) } else { Err(self) }
    }

    /// Whether a value of this table is faulty by itself.
    pub(super) fn concern(&self, table: &str) -> bool {
        let in_table = |key: &str| key.split('.').next() == Some(table);
        self.0.iter().any(|fault| matches!(fault, Fault::Value { key, .. } if in_table(key)))
    }

    /// Each fault.
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
