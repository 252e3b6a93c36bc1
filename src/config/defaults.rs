//! The complete configuration as a commented file.

use super::{LinkKind, LinkSettings, SerialSettings, board, section::Section, settings::Settings};

const HEAD: &str = "\
# facewire: every setting with its default. To change a setting, remove the \"# \" at the start of its line; leave all
# other lines as they are. `facewire check --config FILE` names every fault of the file at once.

# The board that facewire runs on. Its settings replace the defaults below. \"auto\" is the one that facewire recognises by
# the device tree or the processor; `facewire check` names it.
# Takes ";

/// Introduces the link to the microcontroller board.
const BOARD_LINK: &str = "
# A second link, to the microcontroller board that is plugged into USB. While there is none, the link waits for one.
# It takes the settings of every link, too. Remove these lines if no board is to receive the face.
";

/// Writes the default settings in TOML, each after its comment. The settings are commented out, so that those of a board
/// stay in force, except those that make the second link another one than the first. The text loads to
/// [`Settings::default`], whether the settings are commented out or not.
#[must_use]
pub fn defaults() -> String {
    let board = format!("{}.\n# board = \"{}\"\n", board::expected(), board::AUTO);
    let first = Settings { links: vec![LinkSettings::default()], ..Settings::default() };
    [HEAD, &board, &commented_out(&tables(&first)), BOARD_LINK, &board_link()].concat()
}

/// Writes a `[[link]]` of the kind of this name with all its settings, each after its comment, and with an example of
/// the settings without which it cannot work. Returns `None` if there is no such kind.
#[must_use]
pub fn default_link(kind: &str) -> Option<String> {
    let kind = LinkKind::all().into_iter().find(|known| known.name() == kind)?;
    Some(format!("[[link]]\n{}", LinkSettings::of(kind.with_example()).write()))
}

/// Puts a "# " before each setting.
fn commented_out(text: &str) -> String {
    let is_setting = |line: &str| !line.is_empty() && !line.starts_with(['#', '[']);
    text.lines().flat_map(|line| [if is_setting(line) { "# " } else { "" }, line, "\n"]).collect()
}

/// Writes the link to the microcontroller board. Its pace was explained with the first link.
fn board_link() -> String {
    let link = LinkSettings::to_the_board();
    let pace = link.pace.write();
    let pace: String =
        pace.lines().filter(|line| !line.starts_with('#') && !line.is_empty()).flat_map(|line| [line, "\n"]).collect();
    let serial = commented_out(&SerialSettings::default().write());
    format!("[[link]]\nkind = \"{}\"\n{pace}\n{serial}", link.kind.name())
}

/// Writes settings in TOML, each after its comment. The text loads back to the same settings.
#[must_use]
pub fn written(settings: &Settings) -> String {
    format!("board = \"{}\"\n", settings.board) + &tables(settings)
}

/// Writes the tables of the settings.
fn tables(settings: &Settings) -> String {
    let mut text = String::new();
    write(&mut text, "[camera]", &settings.camera);
    write(&mut text, "[networks]", &settings.networks);
    write(&mut text, "[solver]", &settings.solver);
    write(&mut text, "[smoothing]", &settings.smoothing);
    write(&mut text, "[wearer]", &settings.wearer);
    write(&mut text, "[plausibility]", &settings.plausibility);
    write(&mut text, "[adjust]", &settings.adjust);
    write(&mut text, "[failsafe]", &settings.failsafe);
    write(&mut text, "[send]", &settings.send);
    write(&mut text, "[realtime]", &settings.realtime);
    write(&mut text, "[hardware]", &settings.hardware);
    write(&mut text, "[adaptation]", &settings.adaptation);
    write(&mut text, "[metrics]", &settings.metrics);
    write(&mut text, "[log]", &settings.log);
    for link in &settings.links {
        text.extend(["\n[[link]]\n", &link.write()]);
    }
    text
}

fn write(text: &mut String, heading: &str, section: &dyn Section) {
    text.extend(["\n", heading, "\n", &section.write()]);
}
