//! The sets that a model is judged on: pictures, or clips with truth, tracked as `facewire track` tracks them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, ensure};
use facewire::capture::{AviSource, FrameRate};
use facewire::config::Settings;
use facewire::pipeline::{Pipeline, load_tracker, shaping};
use facewire::playback::{Playback, Shown, TrackedFrame, neutral_of};
use facewire_face::{COEFFS, Model, Neutral, NeutralMode, Profile, Solver, Tracker};
use rayon::prelude::*;

use super::figures::{Person, SolvedFaces};
use crate::curves::{Parts, Truth};
use crate::dataset::{self, Appearances, Sample};
use crate::faces::{Faces, estimates, pose_error_deg};
use crate::output;

pub struct Set {
    pub name: String,
    content: Content,
}

enum Content {
    /// Single pictures of each person, and the look of the faces if that is known.
    Pictures(Vec<Sample>, Option<Appearances>),
    /// Clips with the neutral face of each person, and the number of frames from which it was taken.
    Clips(Vec<(Clip, Neutral)>, u64),
}

/// Results of the regression with the truth: for each picture of a person a pair of all blendshapes.
pub type RawFaces = Vec<([f32; COEFFS], [f64; COEFFS])>;

impl Set {
    /// Loads a dataset, or its held-out subjects, or a folder of clips that begin with `neutral_frames` at rest.
    pub fn load(path: &Path, all_subjects: bool, neutral_frames: u32) -> Result<Self> {
        let (name, neutral_frames) = (path.display().to_string(), neutral_frames.into());
        if path.is_dir() {
            let clips = Clip::load_all(path, false)?;
            let neutrals = clips.iter().map(|clip| clip.neutral(neutral_frames)).collect::<Result<Vec<_>>>()?;
            let clips = clips.into_iter().zip(neutrals).collect();
            return Ok(Self { name, content: Content::Clips(clips, neutral_frames) });
        }
        let samples = dataset::load(path)?;
        let appearances = dataset::load_appearances(&[path], samples.len())?;
        Self::of(name, samples, appearances, all_subjects)
    }

    pub fn of(
        name: String,
        mut samples: Vec<Sample>,
        appearances: Option<Appearances>,
        all_subjects: bool,
    ) -> Result<Self> {
        if !all_subjects {
            dataset::held_out(&samples)?;
            samples.retain(Sample::held_out);
        }
        Ok(Self { name, content: Content::Pictures(samples, appearances) })
    }

    /// Runs each model on every face. Returns the people by model.
    pub fn people(&self, models: &[&Model], neutral_known: bool) -> Result<Vec<Vec<Person>>> {
        match &self.content {
            Content::Pictures(samples, appearances) => {
                let faces = Faces::new(samples, neutral_known)?.with_appearances(appearances.as_ref());
                models.iter().map(|model| people_of(model, samples, &faces)).collect()
            }
            Content::Clips(clips, neutral_frames) => {
                let person = |model: &Model, (clip, neutral): &(Clip, Neutral)| {
                    let shown = clip.shown(model, neutral_known.then_some(neutral));
                    clip.person(&shown, 0..shown.len(), *neutral_frames)
                };
                Ok(models.iter().map(|model| clips.par_iter().map(|clip| person(model, clip)).collect()).collect())
            }
        }
    }

    /// Returns the results of the regression with the truth, person by person. Frames without a face are left out.
    pub fn raw(&self, model: &Model, neutral_known: bool) -> Result<Vec<RawFaces>> {
        match &self.content {
            Content::Pictures(samples, appearances) => {
                let faces = Faces::new(samples, neutral_known)?.with_appearances(appearances.as_ref());
                let mut people: BTreeMap<usize, RawFaces> = BTreeMap::new();
                for (row, sample) in samples.iter().enumerate() {
                    people.entry(sample.subject).or_default().push((faces.raw(model, row)?.0, sample.truth));
                }
                Ok(people.into_values().collect())
            }
            Content::Clips(clips, _) => {
                let raw = |(clip, neutral): &(Clip, Neutral)| {
                    let shown = clip.shown(model, neutral_known.then_some(neutral));
                    let pairs = shown.into_iter().zip(&clip.truth.coefficients);
                    pairs.filter_map(|(shown, truth)| Some((shown.solution?.raw.0, *truth))).collect()
                };
                Ok(clips.par_iter().map(raw).collect())
            }
        }
    }

    /// Returns a line with the error of the head pose, or the number of frames without a face.
    pub fn notes(&self) -> Result<String> {
        match &self.content {
            Content::Pictures(samples, _) => {
                let [yaw, pitch, roll] = pose_error_deg(samples)?;
                Ok(format!("head pose, mean error: yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} degrees"))
            }
            Content::Clips(clips, _) => {
                let frames = || clips.iter().flat_map(|(clip, _)| &clip.faces);
                let faceless = frames().filter(|face| face.landmarks.is_none()).count();
                Ok(format!("no face was found in {faceless} of {} frames", frames().count()))
            }
        }
    }
}

fn people_of(model: &Model, samples: &[Sample], faces: &Faces) -> Result<Vec<Person>> {
    let estimates = estimates(model, faces, &faces.rows(true)?)?;
    let mut people: BTreeMap<usize, SolvedFaces> = BTreeMap::new();
    for (row, sample) in samples.iter().enumerate() {
        let person = people.entry(sample.subject).or_default();
        person.estimates.push(core::array::from_fn(|blendshape| estimates[blendshape][row]));
        person.truths.push(sample.truth);
        person.is_neutral.push(sample.neutral);
        person.head_yaw_deg.push(sample.pose_deg[0]);
    }
    Ok(people.iter().map(|(subject, faces)| Person::new(subject.to_string(), faces, false)).collect())
}

/// A clip of one person with its truth, tracked as `facewire track` does.
pub struct Clip {
    pub name: String,
    pub faces: Vec<TrackedFrame>,
    pub truth: Truth,
    pub parts: Parts,
}

impl Clip {
    /// Loads every clip of a folder, in parallel, in the order of their names.
    pub fn load_all(folder: &Path, has_parts: bool) -> Result<Vec<Self>> {
        let films = output::files(folder, &["avi"])?;
        ensure!(!films.is_empty(), "{} has no .avi files: make them with `facewire-fit film`", folder.display());
        let done = AtomicUsize::new(0);
        let load = |film: &PathBuf| -> Result<Self> {
            let clip = Self::load(film, has_parts).with_context(|| film.display().to_string())?;
            let done = done.fetch_add(1, Ordering::Relaxed) + 1;
            eprintln!("{}: tracked {done} of {} clips", folder.display(), films.len());
            Ok(clip)
        };
        films.par_iter().map(load).collect()
    }

    fn load(film: &Path, has_parts: bool) -> Result<Self> {
        let csv = film.with_extension("csv");
        let truth = Truth::load(&csv)?;
        let parts = if has_parts { Parts::load(&film.with_extension("parts.csv"))? } else { Parts::default() };
        let faces = track(film)?;
        truth.fits(&csv, faces.len())?;
        let name = film.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { name, faces, truth, parts })
    }

    /// Returns what the solver and the failsafe show in each frame.
    pub fn shown(&self, model: &Model, neutral: Option<&Neutral>) -> Vec<Shown> {
        let profile = neutral.cloned().map(Profile::from).unwrap_or_default();
        let mut playback = playback(None, model, profile, NeutralMode::Off);
        self.faces.iter().map(|face| playback.show(face)).collect()
    }

    /// Sums up `shown`, which is what `frames` show. The person's neutral face was taken from the first `neutral_frames`.
    pub fn person(&self, shown: &[Shown], frames: Range<usize>, neutral_frames: u64) -> Person {
        let faces = SolvedFaces {
            estimates: shown.iter().map(|shown| shown.pose.coefficients.map(f64::from)).collect(),
            truths: self.truth.coefficients[frames.clone()].to_vec(),
            is_neutral: self.faces[frames.clone()].iter().map(|face| face.number < neutral_frames).collect(),
            head_yaw_deg: self.truth.pose_deg[frames].iter().map(|pose| pose[0]).collect(),
        };
        Person::new(self.name.clone(), &faces, true)
    }

    pub fn neutral(&self, frames: u64) -> Result<Neutral> {
        neutral_of(&self.faces, &(0..frames))
            .with_context(|| format!("{}: no neutral face in the first frames", self.name))
    }
}

fn track(film: &Path) -> Result<Vec<TrackedFrame>> {
    let settings = Settings::default();
    let path = film.to_str().context("the path is not UTF-8")?;
    let mut source = AviSource::open(BufReader::new(File::open(film)?), path, FrameRate::FPS_30)?;
    let tracker = Some(load_tracker(&settings.networks)?);
    let mut playback = playback(tracker, &Model::embedded(), Profile::default(), NeutralMode::Off);
    std::iter::from_fn(|| playback.find(&mut source).transpose()).map(|face| Ok(face?)).collect()
}

/// Returns the solver and the failsafe with the default settings. Without a tracker, they show faces that were found before.
pub fn playback(tracker: Option<Tracker>, model: &Model, profile: Profile, neutral_mode: NeutralMode) -> Playback {
    let settings = Settings::default();
    let mut solver = Solver::new(model.clone(), profile, shaping(&settings));
    solver.neutral_mode = neutral_mode;
    let pipeline = Pipeline { tracker, solver, horizontal_fov_deg: settings.camera.horizontal_fov_deg };
    Playback::new(pipeline, &settings.failsafe)
}
