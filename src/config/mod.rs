//! Settings: TOML files laid over the defaults.
//!
//! The board's file overrides the defaults, and the user's file, which may name the board, overrides the board's. Either
//! every setting is valid, or [`Faults`] names every fault at once, each with key, value and bounds. Settings are judged
//! by their text alone: no device, host or model file is touched. `settings.rs` and `link.rs` declare each key with its
//! type, default and bounds; `systemd/facewire.toml` and `links.toml` explain them.

mod explanation;
mod link;
mod schema;
mod settings;
#[cfg(test)]
mod tests;
mod value;

use std::path::Path;

use facewire_board::{WrongEncoding, utf8};
use facewire_face::Method;
pub use facewire_face::settings::Faults;
pub(crate) use facewire_face::settings::quoted;
use facewire_face::settings::{Entry, Overlay, Section as _, Takes};
pub use link::*;
pub use schema::schema;
pub use settings::*;
pub use value::{Address, Choice, JsonTarget, Listen, Scene, Script, SerialDevice};

use self::explanation::{Explanation, explanations};
use crate::calibration::WearerName;

/// Exit status for bad settings, as in `sysexits.h`. systemd does not restart a service that exits with it.
pub const EX_CONFIG: u8 = 78;
/// Slowest rate of a link, packets per second: receivers go neutral after 500 ms without one.
pub const SLOWEST_LINK_HZ: u32 = 10;
/// The name that stands for the board that was recognised.
const AUTO: &str = "auto";

/// The names of the boards and their settings, from the folder `boards`.
pub const BOARDS: [(&str, &str); 8] = [
    ("generic", include_str!("../../boards/generic.toml")),
    ("pi3", include_str!("../../boards/pi3.toml")),
    ("pi4", include_str!("../../boards/pi4.toml")),
    ("pi5", include_str!("../../boards/pi5.toml")),
    ("pi-zero-2w", include_str!("../../boards/pi-zero-2w.toml")),
    ("orange-pi-5", include_str!("../../boards/orange-pi-5.toml")),
    ("radxa-zero-3", include_str!("../../boards/radxa-zero-3.toml")),
    ("intel-n100", include_str!("../../boards/intel-n100.toml")),
];

/// The default settings in TOML, each after its comment. The settings are commented out, so that those of a board stay in
/// force, except those that make the second link another one than the first.
pub const DEFAULTS: &str = include_str!("../../systemd/facewire.toml");
const LINKS: &str = include_str!("links.toml");

/// The headings of the tables of a link and of its servos in [`DEFAULTS`] and [`LINKS`].
const LINK_HEADING: &str = "[[link]]";
const CHANNEL_HEADING: &str = "[[link.channel]]";

/// Returns a `[[link]]` of the kind of this name with all its settings, each after its comment, and with an example of
/// the settings without which it cannot work. Returns `None` if there is no such kind.
pub fn default_link(name: &str) -> Option<String> {
    let mut link = LinkSettings::of(LinkKind::named(name)?);
    let defaults = explanations(DEFAULTS);
    let of_all = |key| defaults.iter().find(|of_all| of_all.heading == LINK_HEADING && of_all.key == key);
    let of_kinds = explanations(LINKS);
    let is_kind = |of_kind: &&Explanation| of_kind.key == "kind";
    let of_kind = of_kinds.iter().skip_while(|of_kind| !is_kind(of_kind) || of_kind.value != quoted(name)).skip(1);
    let of_kind = of_kind.take_while(|of_kind| of_kind.heading == LINK_HEADING && !is_kind(of_kind));
    let with_value = |key, value: &str| Some(Explanation { value, ..*of_all(key)? }.to_string());
    let mut paragraphs = vec![with_value("kind", &quoted(name))?];
    paragraphs.extend(of_kind.map(Explanation::to_string));
    paragraphs.push(with_value("pace", &quoted(link.pace.pace.name()))?);
    paragraphs.push(with_value("rate_hz", &link.pace.rate_hz.to_string())?);
    paragraphs.push(with_value("loss", &quoted(link.pace.loss.name()))?);
    paragraphs.push(with_value("adjust", "{}")?);
    let own = format!("{LINK_HEADING}\n{}", paragraphs.join("\n"));
    if !link.keys().contains(&"channel") {
        return Some(own);
    }
    // Addresses of a universe count from 1.
    let first = if link.kind.universe().is_some() { "1" } else { "0" };
    let of_channel = of_kinds.iter().filter(|of_channel| of_channel.heading == CHANNEL_HEADING);
    let of_channel = of_channel.map(|of_channel| match of_channel.key {
        "channel" => Explanation { value: first, ..*of_channel }.to_string(),
        _ => of_channel.to_string(),
    });
    Some(format!("{own}\n{CHANNEL_HEADING}\n{}", of_channel.collect::<Vec<_>>().join("\n")))
}

/// Loads the settings of a run. `argument` takes precedence over the board that the file names. `detected` is the board
/// that was recognised, for "auto". `check` adds the faults that settings can have besides, such as those of links.
pub fn load(
    argument: Option<&str>,
    detected: &str,
    file: Option<&Path>,
    check: impl FnOnce(&Settings, &mut Faults),
) -> Result<Settings, Faults> {
    let mut faults = Faults::default();
    let source = file.map_or_else(String::new, |path| path.display().to_string());
    let fixed = argument.and_then(|name| find_board(name, detected));
    if let (Some(name), None) = (argument, fixed) {
        let known = board_names().collect::<Vec<_>>().join(", ");
        faults.push(format!("board \"{name}\": not known; give --board one of {known}"));
    }
    let read = file.map_or_else(|| Ok(Vec::new()), std::fs::read).unwrap_or_else(|error| {
        faults.push(format!("{source}: cannot be read ({error}); give --config a readable file"));
        Vec::new()
    });
    let text = utf8(read).unwrap_or_else(|WrongEncoding { line, sentence }| {
        faults.push(format!("{source}:{line}: {sentence}"));
        String::new()
    });
    lay(&source, &text, fixed, detected, faults, check)
}

/// Parses the settings in `text`, over the defaults and the board that the text names, with "generic" for "auto". Faults
/// refer to the text as `source`. Links are not checked.
pub fn parse(source: &str, text: &str) -> Result<Settings, Faults> {
    parse_and_check(source, text, |_, _| {})
}

/// As [`parse`], with the same `check` as [`load`].
pub fn parse_and_check(
    source: &str,
    text: &str,
    check: impl FnOnce(&Settings, &mut Faults),
) -> Result<Settings, Faults> {
    lay(source, text, None, "generic", Faults::default(), check)
}

fn lay(
    source: &str,
    text: &str,
    fixed: Option<(&'static str, &'static str)>,
    detected: &str,
    mut faults: Faults,
    check_more: impl FnOnce(&Settings, &mut Faults),
) -> Result<Settings, Faults> {
    let mut settings = Settings::default();
    let (mut file, document) = Overlay::parse(source, text);
    let value = document.get("board");
    let named = value.map_or(Some(AUTO), |value| value.get_ref().as_str()).and_then(|name| find_board(name, detected));
    // A board that the file names must be known, even if another one is fixed.
    if let (Some(value), None) = (value, named) {
        file.refuse_value(&Entry { path: "board".to_owned(), value }, &Takes::OneOf(board_names().collect()), |_| None);
    }
    if let Some((name, text)) = fixed.or(named) {
        settings.board = name;
        let source = format!("board {name}");
        let (board, document) = Overlay::parse(&source, text);
        board.lay(&document, &mut settings, &mut faults);
    }
    file.lay(&document, &mut settings, &mut faults);
    let wears = settings.wearer.wears;
    settings.links.iter_mut().for_each(|link| link.kind.set_wears(wears));
    check(&settings, &mut faults);
    check_more(&settings, &mut faults);
    if faults.iter().next().is_none() { Ok(settings) } else { Err(faults) }
}

impl Settings {
    /// The links without a value that is wrong by itself, each with its place. None if some may not have been read.
    pub fn readable_links(&self, faults: &Faults) -> Vec<(usize, &LinkSettings)> {
        let is_readable =
            |(place, _): &(usize, &LinkSettings)| !faults.is_full() && !faults.has_invalid_value_at(*place);
        self.links.iter().enumerate().filter(is_readable).collect()
    }

    /// A key as a fault of the link at this place names it: with the number of the link if there are several.
    pub fn key_of_link(&self, place: usize, key: &str) -> String {
        if self.links.len() > 1 { format!("link {}: {key}", place + 1) } else { key.to_owned() }
    }
}

/// Returns the board called `name`. [`AUTO`] stands for the board called `detected`.
fn find_board(name: &str, detected: &str) -> Option<(&'static str, &'static str)> {
    let name = if name == AUTO { detected } else { name };
    BOARDS.into_iter().find(|(known, _)| *known == name)
}

/// The names that the key `board` takes.
fn board_names() -> impl Iterator<Item = &'static str> {
    [AUTO].into_iter().chain(BOARDS.map(|(name, _)| name))
}

/// Adds the faults of values that can be read but cannot be used, alone or together.
fn check(settings: &Settings, faults: &mut Faults) {
    let FailsafeSettings { live_ms, hold_ms, neutral_ms, .. } = settings.failsafe;
    let after_live = format!("more than failsafe.live_ms, which is {live_ms}");
    faults.require(live_ms < hold_ms, "failsafe.hold_ms", hold_ms, after_live);
    let after_hold = format!("more than failsafe.hold_ms, which is {hold_ms}");
    faults.require(hold_ms < neutral_ms, "failsafe.neutral_ms", neutral_ms, after_hold);
    let device = &settings.camera.device;
    let name = &settings.wearer.name;
    let cameras = "\"auto\", the path of a camera, part of its name, \"demo\" or a rehearsal";
    faults.require(!device.trim().is_empty(), "camera.device", format!("{device:?}"), cameras);
    let bad = Script::of(device).and_then(Result::err);
    faults.require(bad.is_none(), "camera.device", format!("{device:?}"), bad.unwrap_or_default());
    let paths = [
        ("networks.folder", &settings.networks.folder),
        ("solver.model", &settings.solver.model),
        ("wearer.folder", &settings.wearer.folder),
    ];
    for (key, path) in paths {
        let expected = "a path from / on: no shell replaces the ~ of a setting";
        faults.require(!path.starts_with('~'), key, format!("{path:?}"), expected);
    }
    let SolverSettings { method, model } = &settings.solver;
    let is_one = *method == Method::Network || model.is_empty();
    faults.require(
        is_one,
        "solver.model",
        format!("{model:?}"),
        "none with method = \"paper\": a file brings its own method",
    );
    let is_name = name.is_empty() || WearerName::new(name).is_some();
    faults.require(is_name, "wearer.name", format!("{name:?}"), format!("{}, or \"\"", WearerName::EXPECTED));
    faults.require(!settings.links.is_empty(), "link", "[]", "at least one [[link]]");
    for (place, link) in settings.readable_links(faults) {
        let rate_hz = link.pace.rate_hz;
        if (1..SLOWEST_LINK_HZ).contains(&rate_hz) {
            let expected =
                format!("0 or at least {SLOWEST_LINK_HZ}: receivers go neutral when packets come more rarely");
            faults.conflict(&settings.key_of_link(place, "link.rate_hz"), rate_hz, expected);
        }
    }
}
