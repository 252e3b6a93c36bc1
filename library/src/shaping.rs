//! Filters, rules and adjustments in the words of the service's settings.

use std::ops::RangeInclusive;

use facewire_face::{Adjustment, Adjustments, BLENDSHAPES, FilterKind, Filters, Group, Rules, Shaping};
use toml::{Table, Value};

use crate::Error;

const TABLES: [&str; 3] = ["smoothing", "plausibility", "adjust"];
/// The parts of the face in the order of [`Group::ALL`], and the head, with the times of their filters.
const PARTS: [(&str, f32); 7] =
    [("lids", 0.35), ("gaze", 0.1), ("brows", 0.35), ("mouth", 0.35), ("jaw", 0.22), ("cheeks", 0.35), ("head", 0.35)];
/// Longest time of a filter.
const LONGEST_MS: u16 = 350;

/// The rules and filters of the service's default settings.
pub fn default_shaping() -> Shaping {
    shaping_with(PARTS.map(|(_, time_s)| (FilterKind::GatedAverage, time_s)))
}

/// Reads the tables `[smoothing]`, `[plausibility]` and `[adjust]` of the service's settings: filters and their times, rules, and
/// gains, offsets and limits. What the text does not name is that of [`default_shaping`].
///
/// ```
/// let shaping = facewire_library::parse_shaping("[smoothing]\njaw = \"one-euro\"\njaw_ms = 100\n\n[adjust]\njawOpen.gain = 1.5\n")?;
/// # Ok::<(), facewire_library::Error>(())
/// ```
pub fn parse_shaping(text: &str) -> Result<Shaping, Error> {
    read(text).map_err(Error::Settings)
}

fn read(text: &str) -> Result<Shaping, String> {
    let table: Table = text.parse().map_err(|error: toml::de::Error| error.to_string())?;
    let mut filters = PARTS.map(|(_, time_s)| (FilterKind::GatedAverage, time_s));
    let mut rules = Rules::ALL;
    let mut adjustments = Adjustments::default();
    for (name, value) in &table {
        if !TABLES.contains(&name.as_str()) {
            return Err(format!("{name} is none of the tables {}", TABLES.join(", ")));
        }
        let entries = value.as_table().ok_or_else(|| refuse(name, value, "a table"))?;
        for (key, value) in entries {
            let path = format!("{name}.{key}");
            match name.as_str() {
                "smoothing" => smooth(&mut filters, &path, key, value)?,
                "plausibility" => rule(&mut rules, &path, key, value)?,
                _ => adjust(&mut adjustments, &path, key, value)?,
            }
        }
    }
    let mut shaping = shaping_with(filters);
    (shaping.rules, shaping.adjustments) = (rules, adjustments);
    Ok(shaping)
}

/// All rules, and these filters of the parts.
fn shaping_with(parts: [(FilterKind, f32); 7]) -> Shaping {
    let [lids, gaze, brows, mouth, jaw, cheeks, (kind, time_s)] = parts;
    let filter = |group: Group| {
        let (kind, time_s) = match group {
            Group::Lids => lids,
            Group::Gaze => gaze,
            Group::Brows => brows,
            Group::Mouth => mouth,
            Group::Jaw => jaw,
            Group::Cheeks => cheeks,
        };
        group.filter(kind, time_s)
    };
    let mut shaping = Shaping::only(Filters::new(filter, kind, time_s));
    shaping.rules = Rules::ALL;
    shaping
}

fn smooth(filters: &mut [(FilterKind, f32); 7], path: &str, key: &str, value: &Value) -> Result<(), String> {
    let part = key.strip_suffix("_ms").unwrap_or(key);
    let found = PARTS.iter().zip(filters).find(|((name, _), _)| *name == part);
    let (_, (kind, time_s)) = found.ok_or_else(|| unknown(path))?;
    if part == key {
        let known = FilterKind::NAMES.iter().find(|(name, _)| value.as_str() == Some(name));
        let names = || FilterKind::NAMES.iter().map(|(name, _)| format!("{name:?}")).collect::<Vec<_>>();
        let expected = || format!("one of {}", names().join(", "));
        (_, *kind) = *known.ok_or_else(|| refuse(path, value, &expected()))?;
        return Ok(());
    }
    let whole = value.as_integer().and_then(|whole| u16::try_from(whole).ok()).filter(|whole| *whole <= LONGEST_MS);
    let expected = || format!("a whole number from 0 to {LONGEST_MS} (ms)");
    *time_s = f32::from(whole.ok_or_else(|| refuse(path, value, &expected()))?) / 1000.0;
    Ok(())
}

fn rule(rules: &mut Rules, path: &str, key: &str, value: &Value) -> Result<(), String> {
    let rule = match key {
        "lids" => &mut rules.lids,
        "gaze" => &mut rules.gaze,
        "opposed" => &mut rules.opposed,
        "mouth_close" => &mut rules.mouth_close,
        "dead_zone" => {
            rules.dead_zone = number(path, value, 0.0..=0.2)?;
            return Ok(());
        }
        _ => return Err(unknown(path)),
    };
    *rule = flag(path, value)?;
    Ok(())
}

fn adjust(adjustments: &mut Adjustments, path: &str, key: &str, value: &Value) -> Result<(), String> {
    if key == "mirror" {
        adjustments.mirror = flag(path, value)?;
        return Ok(());
    }
    let mut all = BLENDSHAPES.iter().zip(&mut adjustments.coefficients);
    let (_, adjustment) = all.find(|(name, _)| **name == key).ok_or_else(|| unknown(path))?;
    let Adjustment { gain, offset, min, max } = adjustment;
    for (key, value) in value.as_table().ok_or_else(|| refuse(path, value, "a table"))? {
        let path = format!("{path}.{key}");
        let (setting, range) = match key.as_str() {
            "gain" => (&mut *gain, 0.0..=10.0),
            "offset" => (&mut *offset, -1.0..=1.0),
            "min" => (&mut *min, 0.0..=1.0),
            "max" => (&mut *max, 0.0..=1.0),
            _ => return Err(unknown(&path)),
        };
        *setting = number(&path, value, range)?;
    }
    if min > max { Err(refuse(path, value, "a min that is at most max")) } else { Ok(()) }
}

fn flag(path: &str, value: &Value) -> Result<bool, String> {
    value.as_bool().ok_or_else(|| refuse(path, value, "true or false"))
}

fn number(path: &str, value: &Value, range: RangeInclusive<f32>) -> Result<f32, String> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "the range is judged afterwards")]
    let number = value.as_float().map(|float| float as f32).or(value.as_integer().map(|whole| whole as f32));
    let expected = || format!("a number from {:?} to {:?}", range.start(), range.end());
    number.filter(|number| range.contains(number)).ok_or_else(|| refuse(path, value, &expected()))
}

fn refuse(path: &str, value: &Value, expected: &str) -> String {
    format!("{path} = {value}: give {expected}")
}

fn unknown(path: &str) -> String {
    format!("{path} is not a setting")
}
