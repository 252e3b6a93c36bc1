//! Datasets: landmarks with their true coefficients, as an npz archive with `names.json` beside it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use facewire_face::model::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS};
use facewire_face::stages::{EYE_SIDE, Eyes, MOUTH_SIDE, Mouth, Visible};
use facewire_face::{Appearance, BLENDSHAPES, COEFFS, InferError, LANDMARKS, Landmarks, Looks};

use half::{f16, slice::HalfFloatSliceExt};
use rayon::prelude::*;

use crate::arrays::Arrays;

/// One in this many subjects is held out: the fit never sees their pictures.
pub const HOLD_OUT_EVERY: usize = 8;
pub const LANDMARK_SHAPE: [usize; 2] = [LANDMARKS, 3];
pub const LANDMARK_VALUES: usize = 3 * LANDMARKS;
pub const FEATURES: &str = "features";
/// The number of columns of `meta`. The last column is 1 for a neutral face.
const META: usize = 5;

#[derive(Clone)]
pub struct Sample {
    pub landmarks: Landmarks,
    pub truth: [f64; COEFFS],
    /// The true yaw, pitch (positive when the head nods up) and roll in degrees.
    pub pose_deg: [f64; 3],
    pub picture: usize,
    pub subject: usize,
    pub neutral: bool,
    pub mirrored: bool,
}

/// A subject, and whether its faces are mirrored. The mirror image of a subject counts as another person.
pub type Person = (usize, bool);

impl Sample {
    pub fn person(&self) -> Person {
        (self.subject, self.mirrored)
    }

    /// Returns whether the fit must not see this picture. Whole subjects are held out, never single pictures.
    pub fn held_out(&self) -> bool {
        self.subject % HOLD_OUT_EVERY == HOLD_OUT_EVERY - 1
    }
}

/// Returns the text file beside an archive with the settings of its pictures. Its first line is a summary.
pub fn provenance(archive: &Path) -> PathBuf {
    archive.with_extension("txt")
}

pub fn load(path: &Path) -> Result<Vec<Sample>> {
    load_all(&[path])
}

/// Loads the pictures of several datasets, one after another. Subjects with the same number count as one person if
/// `synth` made both datasets with the same seed and `--set`, which then show the same people, or if it made neither.
pub fn load_all(paths: &[impl AsRef<Path>]) -> Result<Vec<Sample>> {
    let (mut samples, mut numbers) = (Vec::new(), Vec::new());
    for path in paths {
        numbers.extend(append(path.as_ref(), &mut samples)?);
    }
    for (sample, subject) in samples.iter_mut().zip(ranks(&numbers)) {
        sample.subject = subject;
    }
    Ok(samples)
}

/// Appends the pictures of a dataset, and returns for each the origin of its people ([`people_of`]) and its subject's number.
fn append(path: &Path, samples: &mut Vec<Sample>) -> Result<Vec<(Option<String>, i32)>> {
    let columns = columns(&path.with_file_name("names.json"))?;
    let mut arrays = Arrays::open(path)?;
    let landmarks = arrays.floats("landmarks", &LANDMARK_SHAPE)?;
    let weights = arrays.floats("weights", &[COEFFS])?;
    let pose = arrays.floats("pose", &[3])?;
    let meta = arrays.floats("meta", &[META])?;
    let subjects = arrays.integers("subject", &[])?;
    let pictures = landmarks.len() / LANDMARK_VALUES;
    let rows = [weights.len() / COEFFS, pose.len() / 3, meta.len() / META, subjects.len()];
    for (name, rows) in ["weights", "pose", "meta", "subject"].into_iter().zip(rows) {
        ensure!(rows == pictures, "{}: {name} has {rows} rows, but landmarks has {pictures}", path.display());
    }
    let points = landmarks.chunks_exact(LANDMARK_VALUES).zip(weights.chunks_exact(COEFFS));
    let labels = pose.chunks_exact(3).zip(meta.chunks_exact(META));
    let first = samples.len();
    samples.extend(points.zip(labels).enumerate().map(|(picture, ((points, weights), (pose, meta)))| Sample {
        landmarks: landmarks_of(points),
        truth: columns.map(|column| f64::from(weights[column])),
        pose_deg: pose_of(pose),
        picture: first + picture,
        subject: 0,
        neutral: meta[META - 1] > 0.5,
        mirrored: false,
    }));
    let people = people_of(path);
    Ok(subjects.into_iter().map(|subject| (people.clone(), subject)).collect())
}

/// Returns the seed and the set of a dataset of `synth`, which determine its people, or `None` for other datasets.
fn people_of(path: &Path) -> Option<String> {
    let text = std::fs::read_to_string(provenance(path)).ok()?;
    Some(text.lines().next()?.split(", ").skip(1).take(2).collect())
}

/// How the faces look: for each picture a row with the feature map at some landmarks, and the pictures of both eyes.
pub struct Appearances {
    rows: Vec<f16>,
    looks: Vec<Looks>,
}

/// These networks.
struct Networks {
    eyes: Eyes,
    mouth: Mouth,
    visible: Visible,
}

impl Networks {
    fn load() -> Result<Self, InferError> {
        Ok(Self { eyes: Eyes::load()?, mouth: Mouth::load()?, visible: Visible::load()? })
    }

    fn read(&mut self, row: &[f16]) -> Result<Looks, InferError> {
        let (map, pictures) = row.split_at(Appearances::VALUES);
        let (eyes, mouth) = pictures.split_at(Appearances::EYES);
        let mut appearance = Appearance::zero();
        map.convert_to_f32_slice(appearance.skin.as_flattened_mut());
        eyes.convert_to_f32_slice(self.eyes.pictures.as_flattened_mut());
        mouth.convert_to_f32_slice(&mut *self.mouth.picture);
        let in_view = self.visible.read(&appearance.skin)?;
        Ok(Looks { eyes: self.eyes.read()?, mouth: self.mouth.read()?, in_view })
    }
}

impl Appearances {
    /// Values of the feature map.
    pub const VALUES: usize = APPEARANCE_LANDMARKS.len() * APPEARANCE_CHANNELS;
    const EYES: usize = 2 * EYE_SIDE * EYE_SIDE;
    /// Values of the feature map, pixels of the right eye and of the left, and pixels of the mouth.
    pub const ROW: usize = Self::VALUES + Self::EYES + MOUTH_SIDE * MOUTH_SIDE;

    fn new(rows: Vec<f16>) -> Result<Self> {
        let read = |networks: &mut Result<Networks, InferError>, row: &[f16]| -> Result<Looks> {
            let networks = networks.as_mut().map_err(|error| InferError(error.0.clone()))?;
            Ok(networks.read(row)?)
        };
        let looks = rows.par_chunks_exact(Self::ROW).map_init(Networks::load, read).collect::<Result<_>>()?;
        Ok(Self { rows, looks })
    }

    /// Copies the feature map.
    pub fn copy(&self, picture: usize, out: &mut [f32]) {
        self.rows[picture * Self::ROW..][..Self::VALUES].convert_to_f32_slice(out);
    }

    pub fn of(&self, picture: usize) -> Appearance {
        let mut appearance = Appearance { looks: self.looks[picture], ..Appearance::zero() };
        self.copy(picture, appearance.skin.as_flattened_mut());
        appearance
    }
}

/// Loads how the faces look, for this number of pictures in all. Returns `None` if an archive lacks the map.
pub fn load_appearances(paths: &[impl AsRef<Path>], pictures: usize) -> Result<Option<Appearances>> {
    let mut values = Vec::new();
    let mut archives = paths.iter().map(|path| Arrays::open(path.as_ref())).collect::<Result<Vec<_>>>()?;
    if !archives.iter().all(|arrays| arrays.has(FEATURES)) {
        return Ok(None);
    }
    for arrays in &mut archives {
        values.extend(arrays.halves(FEATURES, &[Appearances::ROW])?);
    }
    let rows = values.len() / Appearances::ROW;
    ensure!(rows == pictures, "{FEATURES} has {rows} rows, but landmarks has {pictures}");
    Appearances::new(values).map(Some)
}

pub fn held_out(samples: &[Sample]) -> Result<Vec<usize>> {
    let rows: Vec<usize> = (0..samples.len()).filter(|row| samples[*row].held_out()).collect();
    let subjects = samples.iter().map(|sample| sample.subject + 1).max().unwrap_or(0);
    ensure!(
        !rows.is_empty(),
        "{subjects} subjects are too few: one in {HOLD_OUT_EVERY} is held out to judge by, so {HOLD_OUT_EVERY} are \
         needed (`judge` and `report` accept --all-subjects for data that the fit never saw)"
    );
    Ok(rows)
}

/// Returns the column of each of [`BLENDSHAPES`]. Live Link Face has some right sides before the left ones.
fn columns(path: &Path) -> Result<[usize; COEFFS]> {
    let file = path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {file}"))?;
    let names: Vec<String> = serde_json::from_str(&text).with_context(|| format!("{file} is not a list of names"))?;
    ensure!(names.len() == COEFFS, "{file} has {} names for the {COEFFS} columns of weights", names.len());
    let mut columns = [0; COEFFS];
    for (column, known) in columns.iter_mut().zip(BLENDSHAPES) {
        let index = names.iter().position(|name| name == known);
        *column = index.with_context(|| format!("{file} lacks {known}: it must name every column of weights"))?;
    }
    Ok(columns)
}

/// Numbers the people. Those of each origin begin at a multiple of [`HOLD_OUT_EVERY`], so that datasets with other people do
/// not change who is held out.
fn ranks(people: &[(Option<String>, i32)]) -> Vec<usize> {
    let (mut ranks, mut next, mut last) = (BTreeMap::new(), 0_usize, None);
    for person in people.iter().collect::<BTreeSet<_>>() {
        if last.replace(&person.0).is_some_and(|last| *last != person.0) {
            next = next.next_multiple_of(HOLD_OUT_EVERY);
        }
        ranks.insert(person, next);
        next += 1;
    }
    people.iter().map(|person| ranks[person]).collect()
}

/// Converts a row of the array to landmarks and levels the irises, which some trackers leave at depth 0.
pub fn landmarks_of(row: &[f32]) -> Landmarks {
    let mut landmarks = Landmarks::zero();
    landmarks.0.as_flattened_mut().copy_from_slice(row);
    landmarks.level_irises();
    landmarks
}

/// Converts a pose of the file, whose pitch is positive when the head nods down, to facewire's convention.
pub fn pose_of(row: &[f32]) -> [f64; 3] {
    let angle = |index: usize| row.get(index).copied().map_or(0.0, f64::from);
    [angle(0), -angle(1), angle(2)]
}
