//! The boards whose settings are built in.

use super::{Fault, value::quoted};

/// The name and the settings of each board, from the folder `boards`.
pub const BOARDS: [(&str, &str); 4] = [
    ("generic", include_str!("../../boards/generic.toml")),
    ("pi4", include_str!("../../boards/pi4.toml")),
    ("pi5", include_str!("../../boards/pi5.toml")),
    ("pi-zero-2w", include_str!("../../boards/pi-zero-2w.toml")),
];

/// Returns the board called `name` from [`BOARDS`].
pub fn find(name: &str) -> Option<(&'static str, &'static str)> {
    BOARDS.into_iter().find(|(known, _)| *known == name)
}

/// Returns the board that an argument names.
///
/// # Errors
/// Names the known boards if the name is unknown.
pub fn named(name: &str) -> Result<(&'static str, &'static str), Fault> {
    let known = || BOARDS.map(|(known, _)| known).join(", ");
    find(name).ok_or_else(|| Fault::UnknownBoard { name: name.to_owned(), known: known() })
}

/// Describes the values of the key `board`.
pub fn expected() -> String {
    format!("one of {}", BOARDS.map(|(known, _)| quoted(known)).join(", "))
}
