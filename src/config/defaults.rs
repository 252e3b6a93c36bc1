//! The complete default configuration as a commented file.

use super::{section::Section, settings::Settings};

const HEAD: &str = "\
# facewire: every setting with its default. Keep the lines you change; the rest may go.
# `facewire check --config FILE` names every fault at once.
";

/// The default settings in TOML, each with its comment. The text loads back to [`Settings::default`].
#[must_use]
pub fn defaults() -> String {
    let settings = Settings::default();
    let tables = [
        ("[camera]", settings.camera.write()),
        ("[networks]", settings.networks.write()),
        ("[solver]", settings.solver.write()),
        ("[failsafe]", settings.failsafe.write()),
        ("[send]", settings.send.write()),
        ("[realtime]", settings.realtime.write()),
        ("[log]", settings.log.write()),
    ];
    let links = settings.links.iter().map(|link| ("[[link]]", link.write()));
    let mut text = HEAD.to_owned();
    for (heading, body) in tables.into_iter().chain(links) {
        text.extend(["\n", heading, "\n", &body]);
    }
    text
}
