//! The boards whose settings are built in.

use super::Fault;

/// Name and settings of each board, from `boards/`.
pub const BOARDS: [(&str, &str); 4] = [
    ("generic", include_str!("../../boards/generic.toml")),
    ("pi4", include_str!("../../boards/pi4.toml")),
    ("pi5", include_str!("../../boards/pi5.toml")),
    ("pi-zero-2w", include_str!("../../boards/pi-zero-2w.toml")),
];

/// The settings of the board of this name.
pub fn text(name: &str) -> Result<&'static str, Fault> {
    let board = BOARDS.iter().find(|(known, _)| *known == name);
    board
        .map(|(_, text)| *text)
        .ok_or_else(|| Fault::UnknownBoard { name: name.to_owned(), known: BOARDS.map(|(known, _)| known).join(", ") })
}
