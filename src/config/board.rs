//! The boards whose settings are built in.

use super::{Fault, value::quoted};

/// The name that stands for the board that was recognised.
pub const AUTO: &str = "auto";

/// A board: its name and its settings.
pub type Board = (&'static str, &'static str);

/// The boards, from the folder `boards`.
pub const BOARDS: [Board; 8] = [
    ("generic", include_str!("../../boards/generic.toml")),
    ("pi3", include_str!("../../boards/pi3.toml")),
    ("pi4", include_str!("../../boards/pi4.toml")),
    ("pi5", include_str!("../../boards/pi5.toml")),
    ("pi-zero-2w", include_str!("../../boards/pi-zero-2w.toml")),
    ("orange-pi-5", include_str!("../../boards/orange-pi-5.toml")),
    ("radxa-zero-3", include_str!("../../boards/radxa-zero-3.toml")),
    ("intel-n100", include_str!("../../boards/intel-n100.toml")),
];

/// Returns the board called `name`. [`AUTO`] stands for the board called `detected`.
pub fn find(name: &str, detected: &str) -> Option<Board> {
    let name = if name == AUTO { detected } else { name };
    BOARDS.into_iter().find(|(known, _)| *known == name)
}

/// Returns the board that an argument names.
///
/// # Errors
/// Names the known boards if the name is unknown.
pub fn named(name: &str, detected: &str) -> Result<Board, Fault> {
    let known = || names().collect::<Vec<_>>().join(", ");
    find(name, detected).ok_or_else(|| Fault::UnknownBoard { name: name.to_owned(), known: known() })
}

/// Describes the values of the key `board`.
pub fn expected() -> String {
    format!("one of {}", names().map(quoted).collect::<Vec<_>>().join(", "))
}

fn names() -> impl Iterator<Item = &'static str> {
    [AUTO].into_iter().chain(BOARDS.map(|(name, _)| name))
}
