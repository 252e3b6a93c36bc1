//! The boards whose settings are built in.

use super::{Fault, value::quoted};

/// Name and settings of each board, from `boards/`.
pub const BOARDS: [(&str, &str); 4] = [
    ("generic", include_str!("../../boards/generic.toml")),
    ("pi4", include_str!("../../boards/pi4.toml")),
    ("pi5", include_str!("../../boards/pi5.toml")),
    ("pi-zero-2w", include_str!("../../boards/pi-zero-2w.toml")),
];

/// The name as it stands in [`BOARDS`], and the settings of the board of this name.
pub fn find(name: &str) -> Option<(&'static str, &'static str)> {
    BOARDS.into_iter().find(|(known, _)| *known == name)
}

/// As [`find`], for a name that was given as an argument.
pub fn named(name: &str) -> Result<(&'static str, &'static str), Fault> {
    let known = || BOARDS.map(|(known, _)| known).join(", ");
    find(name).ok_or_else(|| Fault::UnknownBoard { name: name.to_owned(), known: known() })
}

/// What the key `board` of a file takes.
pub fn expected() -> String {
    format!("one of {}", BOARDS.map(|(known, _)| quoted(known)).join(", "))
}
