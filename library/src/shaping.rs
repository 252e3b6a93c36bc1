//! Filters, rules and adjustments in the words of the service's settings.

use facewire_face::Shaping;
use facewire_face::settings::{Faults, Overlay, ShapingSettings, shaping};

use crate::Error;

/// The rules and filters of the service's default settings.
pub fn default_shaping() -> Shaping {
    shaping_of(&ShapingSettings::default())
}

/// Reads the tables `[smoothing]`, `[plausibility]` and `[adjust]` of the service's settings: filters and their times, rules, and
/// gains, offsets and limits. What the text does not name is that of [`default_shaping`].
///
/// ```
/// let shaping = facewire_library::parse_shaping("[smoothing]\njaw = \"one-euro\"\njaw_ms = 100\n\n[adjust]\njawOpen.gain = 1.5\n")?;
/// # Ok::<(), facewire_library::Error>(())
/// ```
pub fn parse_shaping(text: &str) -> Result<Shaping, Error> {
    let mut settings = ShapingSettings::default();
    let mut faults = Faults::default();
    let (file, document) = Overlay::parse("settings", text);
    file.lay(&document, &mut settings, &mut faults);
    if faults.iter().next().is_none() { Ok(shaping_of(&settings)) } else { Err(Error::Settings(faults.to_string())) }
}

fn shaping_of(settings: &ShapingSettings) -> Shaping {
    shaping(&settings.smoothing, settings.plausibility, &settings.adjust)
}
