//! The complete configuration as a commented file.

use super::{
    board,
    section::Section,
    settings::{LinkKind, LinkSettings, Settings},
};

const HEAD: &str = "\
# facewire: every setting with its default. To change one, take the \"# \" off its line; the rest may stay as it is.
# `facewire check --config FILE` names every fault at once.

# The machine this runs on: its values take the place of the defaults below.
# Takes ";

/// Before the example of a serial link.
const SERIAL: &str = "
# A serial port, beside the receiver above or instead of it: take the first \"# \" off these lines.
";

/// The default settings in TOML, each with its comment and commented out itself: what a board sets stays as it is. The
/// text loads to [`Settings::default`], with and without the signs of comment before its settings.
#[must_use]
pub fn defaults() -> String {
    let board = format!("{}.\n# board = \"generic\"\n", board::expected());
    let mut text = HEAD.to_owned() + &board;
    for line in written(&Settings::default()).lines() {
        let is_setting = !line.is_empty() && !line.starts_with(['#', '[']);
        text.extend([if is_setting { "# " } else { "" }, line, "\n"]);
    }
    text += SERIAL;
    serial_example().lines().for_each(|line| text.extend(["# ", line, "\n"]));
    text
}

/// Settings in TOML, each with its comment. The text loads back to the same settings.
#[must_use]
pub fn written(settings: &Settings) -> String {
    let mut text = String::new();
    write(&mut text, "[camera]", &settings.camera);
    write(&mut text, "[networks]", &settings.networks);
    write(&mut text, "[solver]", &settings.solver);
    write(&mut text, "[failsafe]", &settings.failsafe);
    write(&mut text, "[send]", &settings.send);
    write(&mut text, "[realtime]", &settings.realtime);
    write(&mut text, "[metrics]", &settings.metrics);
    write(&mut text, "[log]", &settings.log);
    for link in &settings.links {
        text.extend(["\n[[link]]\n", &link.write(link.kind.keys())]);
    }
    text
}

fn write<S: Section>(text: &mut String, heading: &str, section: &S) {
    text.extend(["\n", heading, "\n", &section.write(S::KEYS)]);
}

/// A link to the first serial port of most boards that are plugged into USB.
fn serial_example() -> String {
    let device = "/dev/ttyACM0".into();
    let link = LinkSettings { kind: LinkKind::Serial, device, ..LinkSettings::default() };
    format!("[[link]]\n{}", link.write(link.kind.keys()))
}
