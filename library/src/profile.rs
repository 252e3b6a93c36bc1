//! What is known of a wearer: the file of `facewire calibrate`, or faces at rest.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::Read as _;
use std::path::Path;
use std::time::SystemTime;

use facewire_face::stages::{FaceMean, normalise};
use facewire_face::{BLENDSHAPES, GAINS, LANDMARKS, MAX_REST, Neutral, Profile};
use serde::Deserialize;

use crate::{Error, Face};

const FORMAT: u32 = 1;
const MAX_BYTES: u64 = 16 << 10;
/// Steps of an eye distance in which the file counts.
const STEPS: f32 = 10_000.0;

/// Greatest coordinate in a text, steps. Faces stay below 3 eye distances.
const MAX_STEPS: f32 = 32_000.0;

/// What this crate reads of a profile; the service writes more.
#[derive(Deserialize)]
struct Table {
    format: u32,
    neutral: Vec<[i16; 3]>,
    blendshapes: BTreeMap<String, Terms>,
}

#[derive(Deserialize)]
struct Terms {
    rest: f32,
    gain: f32,
}

/// Reads a profile that `facewire calibrate` made (`NAME.toml`).
pub fn read_profile(path: impl AsRef<Path>) -> Result<Profile, Error> {
    let path = path.as_ref();
    let wrong = |reason: String| Error::File(format!("{}: {reason}", path.display()));
    let mut text = String::new();
    let file = File::open(path).map_err(|error| wrong(error.to_string()))?;
    file.take(MAX_BYTES + 1).read_to_string(&mut text).map_err(|error| wrong(error.to_string()))?;
    parse(&text).map_err(wrong)
}

/// Reads the text of a profile, by [`profile_text`] or by `facewire calibrate`.
pub fn parse_profile(text: &str) -> Result<Profile, Error> {
    parse(text).map_err(|reason| Error::File(format!("the profile: {reason}")))
}

fn parse(text: &str) -> Result<Profile, String> {
    let damaged = || "it is no profile, or damaged; make it again with `facewire calibrate`".to_owned();
    let table: Table = toml::from_str(text).map_err(|_| damaged())?;
    if table.format != FORMAT {
        return Err(format!("it has format {}, and this version reads format {FORMAT}", table.format));
    }
    profile_of(&table).ok_or_else(damaged)
}

/// Returns the text of a profile as `facewire calibrate` writes it, for [`parse_profile`], or for a file that [`read_profile`]
/// and the service read. `None` if the profile has no neutral face.
pub fn profile_text(profile: &Profile) -> Option<String> {
    let neutral = profile.neutral.as_ref()?;
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let mut text = format!("format = {FORMAT}\nmade_by = \"facewire {}\"\n", env!("CARGO_PKG_VERSION"));
    let _ = writeln!(text, "made_at_unix_s = {}\ntakes = []\n\nneutral = [", now.as_secs());
    #[expect(clippy::cast_possible_truncation, reason = "the greatest coordinate is an i16")]
    let steps = |value: f32| (value * STEPS).round().clamp(-MAX_STEPS, MAX_STEPS) as i16;
    for [x, y, z] in neutral.points() {
        let _ = writeln!(text, "[{},{},{}],", steps(x), steps(y), steps(z));
    }
    text.push_str("]\n\n[blendshapes]\n");
    for (name, (rest, gain)) in BLENDSHAPES.iter().zip(profile.rest.iter().zip(&profile.gain)) {
        let _ = writeln!(text, "{name} = {{ rest = {rest:.4}, gain = {gain:.4} }}");
    }
    Some(text)
}

fn profile_of(table: &Table) -> Option<Profile> {
    let steps: &[[i16; 3]; LANDMARKS] = table.neutral.as_slice().try_into().ok()?;
    let points = steps.map(|point| point.map(|step| f32::from(step) / STEPS));
    let mut profile = Profile::from(Neutral::of_face(&points).ok()?);
    for (name, (rest, gain)) in BLENDSHAPES.iter().zip(profile.rest.iter_mut().zip(&mut profile.gain)) {
        let terms = table.blendshapes.get(*name)?;
        let is_sane = terms.rest.abs() <= MAX_REST && (GAINS[0]..=GAINS[1]).contains(&terms.gain);
        (*rest, *gain) = is_sane.then_some((terms.rest, terms.gain))?;
    }
    Some(profile)
}

/// Returns the mean of faces at rest, which look at the camera: the neutral face of a [`Profile`]. Half a second of a film is
/// enough.
pub fn neutral_of<'a>(faces: impl IntoIterator<Item = &'a Face>) -> Result<Neutral, Error> {
    let mut mean = FaceMean::default();
    for face in faces {
        mean.add(&normalise(&face.landmarks)?);
    }
    Ok(mean.neutral()?)
}
