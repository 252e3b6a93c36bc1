//! Settings of single coefficients.

use toml::de::{DeTable, DeValue};

use super::{
    section::{Section, write_setting},
    value::Value,
};
use crate::solve::{Adjustment, Adjustments, BLENDSHAPES};

/// Changes of the final output: one key for each blendshape, and `mirror`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AdjustSettings(pub Adjustments);

/// `mirror`, then the blendshapes.
const KEYS: [&str; 1 + BLENDSHAPES.len()] = {
    let mut keys = ["mirror"; 1 + BLENDSHAPES.len()];
    let (_, names) = keys.split_at_mut(1);
    names.copy_from_slice(&BLENDSHAPES);
    keys
};
const MIRROR: [&str; 1] = [" Swaps left and right: what is sent is the mirror image of the wearer."];
/// How single coefficients are changed.
const EXAMPLE: &str = "
# Single coefficients can be multiplied and limited after everything else. Each of the four numbers may be left out, and
# the names are those in the output. The coefficient is gain * value + offset, within min to max:
#   jawOpen = { gain = 1.2, offset = 0.0, min = 0.0, max = 0.8 }
";

impl Section for AdjustSettings {
    fn keys(&self) -> &'static [&'static str] {
        &KEYS
    }

    fn set(&mut self, key: &str, value: &DeValue<'_>) -> Result<(), String> {
        if key == "mirror" {
            self.0.mirror = bool::read(value, &()).ok_or_else(|| bool::expected(&()))?;
        }
        let named = BLENDSHAPES.iter().zip(&mut self.0.coefficients).find(|(name, _)| **name == key);
        if let Some((_, adjustment)) = named {
            *adjustment = value.as_table().and_then(|table| read(table, *adjustment)).ok_or_else(expected)?;
        }
        Ok(())
    }

    fn write(&self) -> String {
        let mut text = String::new();
        let assignment = format!("mirror = {}", self.0.mirror);
        write_setting(&mut text, &MIRROR, &bool::expected(&()), &assignment);
        text.push_str(EXAMPLE);
        text.extend(self.coefficients().map(|assignment| assignment + "\n"));
        text
    }
}

impl AdjustSettings {
    /// Writes the settings that are not the default on one line, as an inline table.
    pub(super) fn write_inline(&self) -> String {
        let mirror = self.0.mirror.then(|| "mirror = true".to_owned());
        let settings: Vec<String> = mirror.into_iter().chain(self.coefficients()).collect();
        if settings.is_empty() { "{}".to_owned() } else { format!("{{ {} }}", settings.join(", ")) }
    }

    /// Writes the assignment of each coefficient that is changed.
    fn coefficients(&self) -> impl Iterator<Item = String> {
        let changed = BLENDSHAPES.iter().zip(&self.0.coefficients).filter(|(_, it)| **it != Adjustment::default());
        changed.map(|(name, Adjustment { gain, offset, min, max })| {
            format!("{name} = {{ gain = {gain:?}, offset = {offset:?}, min = {min:?}, max = {max:?} }}")
        })
    }
}

/// Reads the numbers of one coefficient over those of `adjustment`. Returns `None` if one is unknown, no number or out of
/// bounds, or if the least exceeds the greatest.
fn read(table: &DeTable<'_>, mut adjustment: Adjustment) -> Option<Adjustment> {
    for (name, value) in table {
        let (number, bounds) = match name.get_ref().as_ref() {
            "gain" => (&mut adjustment.gain, 0.0..=10.0),
            "offset" => (&mut adjustment.offset, -1.0..=1.0),
            "min" => (&mut adjustment.min, 0.0..=1.0),
            "max" => (&mut adjustment.max, 0.0..=1.0),
            _ => return None,
        };
        *number = f32::read(value.get_ref(), &bounds)?;
    }
    (adjustment.min <= adjustment.max).then_some(adjustment)
}

fn expected() -> String {
    "{ gain = 0.0 to 10.0, offset = -1.0 to 1.0, min = 0.0 to 1.0, max = 0.0 to 1.0 } with min at most max; each may be \
     left out"
        .to_owned()
}
