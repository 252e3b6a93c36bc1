//! The complete configuration as a commented file.

use super::{
    section::Section,
    settings::{LinkKind, LinkSettings, Settings},
};

const HEAD: &str = "\
# facewire: every setting with its default. Keep the lines you change; the rest may go.
# `facewire check --config FILE` names every fault at once.
";

/// Before the example of a serial link.
const SERIAL: &str = "
# A serial port, beside the receiver above or instead of it: take the first \"# \" off these lines.
";

/// The default settings in TOML, each with its comment. The text loads back to [`Settings::default`].
#[must_use]
pub fn defaults() -> String {
    let mut text = HEAD.to_owned() + &written(&Settings::default()) + SERIAL;
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
