//! The sets that a model is judged on: pictures, or clips with truth, tracked as `facewire track` tracks them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, Result, ensure};
use facewire::capture::{AviSource, FrameRate};
use facewire::config::Settings;
use facewire::pipeline::Pipeline;
use facewire::playback::{Face, Playback, Shown, neutral_of};
use facewire::preflight::{load_tracker, shaping};
use facewire_face::{COEFFS, Model, Neutral, Profile, Solver};
use rayon::prelude::*;

use super::figures::{Person, SolvedFaces};
use super::{Faces, estimates, pose_error_deg};
use crate::curves::Truth;
use crate::dataset::{self, Appearances, Sample};

pub struct Set {
    pub name: String,
    content: Content,
}

enum Content {
    /// Single pictures of each person, and the look of the faces if that is known.
    Pictures(Vec<Sample>, Option<Appearances>),
    Clips(Vec<Clip>),
}

/// Results of the regression with the truth: for each picture of a person a pair of all blendshapes.
pub type RawFaces = Vec<([f32; COEFFS], [f64; COEFFS])>;

/// Which part of a set counts, and where its neutral faces are.
#[derive(Debug, Clone, Copy)]
pub struct SetOptions {
    /// Judge on all subjects of a dataset, not only the held-out ones.
    pub all_subjects: bool,
    /// Number of frames at the start of each clip in which the face is at rest.
    pub neutral_frames: u32,
}

impl Set {
    pub fn load(path: &Path, options: SetOptions) -> Result<Self> {
        let name = path.display().to_string();
        if path.is_dir() {
            return Ok(Self {
                name,
                content: Content::Clips(load_each(path, |film| Clip::load(film, options.neutral_frames))?),
            });
        }
        let samples = dataset::load(path)?;
        let appearances = dataset::load_appearances(&[path], samples.len())?;
        Self::of(name, samples, appearances, options.all_subjects)
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

    /// Runs each model on every face, relative to the person's neutral face if `neutral_known`. Returns the people by
    /// model.
    pub fn people(&self, models: &[&Model], neutral_known: bool) -> Result<Vec<Vec<Person>>> {
        match &self.content {
            Content::Pictures(samples, appearances) => {
                let faces = Faces::new(samples, neutral_known)?.with_appearances(appearances.as_ref());
                models.iter().map(|model| people_of(model, samples, &faces)).collect()
            }
            Content::Clips(clips) => {
                let solve = |model: &&Model| clips.par_iter().map(|clip| clip.person(model, neutral_known)).collect();
                Ok(models.iter().map(solve).collect())
            }
        }
    }

    /// Returns the results of the regression with the truth, person by person, relative to the neutral face if
    /// `neutral_known`.
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
            Content::Clips(clips) => Ok(clips.par_iter().map(|clip| clip.raw(model, neutral_known)).collect()),
        }
    }

    /// Returns facts about the set itself in one line: the error of the head pose, or the number of frames without a
    /// face.
    pub fn notes(&self) -> Result<String> {
        match &self.content {
            Content::Pictures(samples, _) => {
                let [yaw, pitch, roll] = pose_error_deg(samples)?;
                Ok(format!("head pose, mean error: yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} degrees"))
            }
            Content::Clips(clips) => {
                let [all, faceless] = clips.iter().map(Clip::frames).fold([0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
                Ok(format!("no face was found in {faceless} of {all} frames"))
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
    }
    Ok(people.iter().map(|(subject, faces)| Person::new(subject.to_string(), faces, false)).collect())
}

struct Clip {
    name: String,
    faces: Vec<Face>,
    truth: Truth,
    neutral: Neutral,
    neutral_frames: u32,
}

/// Loads every film of a folder, in parallel, in the order of their names.
pub fn load_each<T: Send>(folder: &Path, load: impl Fn(&Path) -> Result<T> + Sync) -> Result<Vec<T>> {
    let films = films(folder)?;
    let done = AtomicUsize::new(0);
    let load = |film: &PathBuf| -> Result<T> {
        let clip = load(film).with_context(|| format!("{}", film.display()))?;
        eprintln!(
            "{}: tracked {} of {} clips",
            folder.display(),
            done.fetch_add(1, Ordering::Relaxed) + 1,
            films.len()
        );
        Ok(clip)
    };
    films.par_iter().map(load).collect()
}

/// Returns the films of a folder in the order of their names.
fn films(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    let mut films: Vec<PathBuf> =
        paths.into_iter().filter(|path| path.extension().is_some_and(|end| end == "avi")).collect();
    films.sort();
    ensure!(!films.is_empty(), "{} has no .avi files: make them with `facewire-fit film`", folder.display());
    Ok(films)
}

impl Clip {
    fn load(film: &Path, neutral_frames: u32) -> Result<Self> {
        let csv = film.with_extension("csv");
        let truth = Truth::load(&csv)?;
        let faces = track(film)?;
        truth.fits(&csv, faces.len())?;
        let neutral = neutral_of(&faces, &(0..neutral_frames.into())).context("no neutral face in the first frames")?;
        let name = film.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(Self { name, faces, truth, neutral, neutral_frames })
    }

    /// Solves every frame, relative to the neutral face if `neutral_known`.
    fn person(&self, model: &Model, neutral_known: bool) -> Person {
        let shown = self.shown(model, neutral_known);
        let faces = SolvedFaces {
            estimates: shown.map(|shown| shown.pose.coefficients.map(f64::from)).collect(),
            truths: self.truth.coefficients.clone(),
            is_neutral: self.faces.iter().map(|face| face.number < self.neutral_frames.into()).collect(),
        };
        Person::new(self.name.clone(), &faces, true)
    }

    /// Returns the results of the regression with the truth, for every frame with a face.
    fn raw(&self, model: &Model, neutral_known: bool) -> RawFaces {
        let pairs = self.shown(model, neutral_known).zip(&self.truth.coefficients);
        pairs.filter_map(|(shown, truth)| Some((shown.solution?.raw.0, *truth))).collect()
    }

    fn shown(&self, model: &Model, neutral_known: bool) -> impl Iterator<Item = Shown> {
        let settings = Settings::default();
        let profile = Profile { neutral: neutral_known.then(|| self.neutral.clone()), ..Profile::default() };
        let solver = Solver::new(model.clone(), profile, shaping(&settings));
        let pipeline = Pipeline::for_landmarks(solver, settings.camera.horizontal_fov_deg);
        let mut playback = Playback::new(pipeline, &settings.failsafe);
        self.faces.iter().map(move |face| playback.show(face))
    }

    fn frames(&self) -> [usize; 2] {
        [self.faces.len(), self.faces.iter().filter(|face| face.landmarks.is_none()).count()]
    }
}

pub fn track(film: &Path) -> Result<Vec<Face>> {
    let settings = Settings::default();
    let path = film.to_str().context("the path is not UTF-8")?;
    let mut source = AviSource::open(BufReader::new(File::open(film)?), path, FrameRate::FPS_30)?;
    let solver = Solver::new(Model::embedded(), Profile::default(), shaping(&settings));
    let tracker = Some(load_tracker(&settings.networks)?);
    let pipeline = Pipeline { tracker, solver, horizontal_fov_deg: settings.camera.horizontal_fov_deg };
    let mut playback = Playback::new(pipeline, &settings.failsafe);
    std::iter::from_fn(|| playback.find(&mut source).transpose()).map(|face| Ok(face?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_films_is_refused_with_the_remedy() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("01.csv"), "").expect("written");
        let refusal = load_each(folder.path(), |_| Ok(())).expect_err("refused").to_string();
        assert!(refusal.contains("no .avi files") && refusal.contains("facewire-fit film"), "{refusal}");
    }
}
