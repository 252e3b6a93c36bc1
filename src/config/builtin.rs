//! The texts that the program contains: the defaults with their explanation, and the settings of boards.

use super::link::{LinkKind, LinkSettings};
use super::section::Section as _;
use super::value::{Choice as _, quoted};

/// The default settings in TOML, each after its comment. The settings are commented out, so that those of a board stay in
/// force, except those that make the second link another one than the first.
pub const DEFAULTS: &str = include_str!("../../systemd/facewire.toml");
/// The settings that only links of one kind have.
const LINKS: &str = include_str!("links.toml");

/// Returns a `[[link]]` of the kind of this name with all its settings, each after its comment, and with an example of
/// the settings without which it cannot work. Returns `None` if there is no such kind.
pub fn default_link(name: &str) -> Option<String> {
    let link = LinkSettings::of(LinkKind::named(name)?);
    let (own, channel) = LINKS.split_once("\n[[link.channel]]\n")?;
    let own = own.split("\n[[link]]\n").find_map(|own| own.strip_prefix(&format!("kind = \"{name}\"\n\n")))?;
    let (_, first) = DEFAULTS.split_once("\n[[link]]\n")?;
    // The paragraph of the first link that explains a key, with this value.
    let shared = |key: &str, value: &str| {
        let assignment = format!("\n# {key} = ");
        let (explanation, _) = first.split("\n\n").find_map(|paragraph| paragraph.split_once(&assignment))?;
        Some(format!("{explanation}\n{key} = {value}\n"))
    };
    let paragraphs = [
        shared("kind", &quoted(name))?,
        format!("{}\n", own.trim_end()),
        shared("pace", &quoted(link.pace.pace.name()))?,
        shared("rate_hz", &link.pace.rate_hz.to_string())?,
        shared("loss", &quoted(link.pace.loss.name()))?,
        shared("adjust", "{}")?,
    ];
    let channel =
        if link.keys().contains(&"channel") { ["\n[[link.channel]]\n", channel].concat() } else { String::new() };
    Some(format!("[[link]]\n{}{channel}", paragraphs.join("\n")))
}

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
pub fn find_board(name: &str, detected: &str) -> Option<Board> {
    let name = if name == AUTO { detected } else { name };
    BOARDS.into_iter().find(|(known, _)| *known == name)
}

/// The names that the key `board` takes.
pub fn board_names() -> impl Iterator<Item = &'static str> {
    [AUTO].into_iter().chain(BOARDS.map(|(name, _)| name))
}
