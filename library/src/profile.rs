//! What is known of a wearer: the file of `facewire calibrate`, or faces at rest.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use facewire_face::stages::{FaceMean, normalise};
use facewire_face::{BLENDSHAPES, GAINS, LANDMARKS, MAX_REST, Neutral, Profile};
use serde::Deserialize;

use crate::{Error, Face};

const FORMAT: u32 = 1;
const MAX_BYTES: u64 = 16 << 10;
/// Steps of an eye distance in which the file counts.
const STEPS: f32 = 10_000.0;

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
    let damaged = || wrong("it is no profile, or damaged; make it again with `facewire calibrate`".to_owned());
    let table: Table = toml::from_str(&text).map_err(|_| damaged())?;
    if table.format != FORMAT {
        return Err(wrong(format!("it has format {}, and this version reads format {FORMAT}", table.format)));
    }
    profile_of(&table).ok_or_else(damaged)
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
