//! The complete configuration as a commented file.

use super::{SerialSettings, board, section::Section, settings::Settings};

const HEAD: &str = "\
# facewire: every setting with its default. To change a setting, remove the \"# \" at the start of its line; leave all
# other lines as they are. `facewire check --config FILE` names every fault of the file at once.

# The board that facewire runs on. Its settings replace the defaults below. \"auto\" is the one that facewire recognises by
# the device tree or the processor; `facewire check` names it.
# Takes ";

/// Introduces the example of a serial link.
const SERIAL: &str = "
# Example of a link to a serial port, beside or instead of the link above. To use it, remove the first \"# \" of each of
# these lines. It also takes pace and rate_hz.
";

/// Writes the default settings in TOML, each after its comment. The settings are commented out, so that those of a board
/// stay in force. The text loads to [`Settings::default`], whether the settings are commented out or not.
#[must_use]
pub fn defaults() -> String {
    let board = format!("{}.\n# board = \"{}\"\n", board::expected(), board::AUTO);
    let mut text = HEAD.to_owned() + &board;
    for line in tables(&Settings::default()).lines() {
        let is_setting = !line.is_empty() && !line.starts_with(['#', '[']);
        text.extend([if is_setting { "# " } else { "" }, line, "\n"]);
    }
    text += SERIAL;
    serial_example().lines().for_each(|line| text.extend([format!("# {line}").trim_end(), "\n"]));
    text
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

/// Writes a link to the serial port that most boards get when they are plugged into USB.
fn serial_example() -> String {
    let serial = SerialSettings { device: "/dev/ttyACM0".into(), ..SerialSettings::default() };
    format!("[[link]]\nkind = \"serial\"\n{}", serial.write())
}
