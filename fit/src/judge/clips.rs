//! Clips with truth, tracked as `facewire track` tracks them.

use std::{
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
};

use anyhow::{Context, Result, ensure};
use facewire::{
    capture::{FileOptions, open_file},
    config::Settings,
    pipeline::Pipeline,
    playback::{Face, Playback, Shown, neutral_of},
    preflight::{load_tracker, shaping},
    solve::{Model, Neutral, Profile, Solver},
};
use rayon::prelude::*;

use super::{
    people::{Person, SolvedFaces},
    set::RawFaces,
};
use crate::curves::Truth;

/// A clip of one person, with the faces that were found in it.
pub struct Clip {
    name: String,
    faces: Vec<Face>,
    truth: Truth,
    neutral: Neutral,
    neutral_frames: u32,
}

/// Tracks every film of a folder that has its truth beside it, in parallel. In the first `neutral_frames` of each, the
/// face is at rest.
pub fn load(folder: &Path, neutral_frames: u32) -> Result<Vec<Clip>> {
    load_each(folder, |film| Clip::load(film, neutral_frames))
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
    pub fn person(&self, model: &Model, neutral_known: bool) -> Person {
        let shown = self.shown(model, neutral_known);
        let faces = SolvedFaces {
            estimates: shown.map(|shown| shown.pose.coefficients.map(f64::from)).collect(),
            truths: self.truth.coefficients.clone(),
            is_neutral: self.faces.iter().map(|face| face.number < self.neutral_frames.into()).collect(),
        };
        Person::new(self.name.clone(), &faces, true)
    }

    /// Returns the results of the regression with the truth, for every frame with a face.
    pub fn raw(&self, model: &Model, neutral_known: bool) -> RawFaces {
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

    /// Returns the number of frames, and how many of them show no face.
    pub fn frames(&self) -> [usize; 2] {
        [self.faces.len(), self.faces.iter().filter(|face| face.landmarks.is_none()).count()]
    }
}

/// Finds the face in every frame of a film.
pub fn track(film: &Path) -> Result<Vec<Face>> {
    let settings = Settings::default();
    let path = film.to_str().context("the path is not UTF-8")?;
    let mut source = open_file(path, &FileOptions::default())?;
    let solver = Solver::new(Model::embedded(), Profile::default(), shaping(&settings));
    let pipeline = Pipeline::new(load_tracker(&settings.networks)?, solver, settings.camera.horizontal_fov_deg);
    let mut playback = Playback::new(pipeline, &settings.failsafe);
    std::iter::from_fn(|| playback.find(&mut *source).transpose()).map(|face| Ok(face?)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_films_is_refused_with_the_remedy() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("01.csv"), "").expect("written");
        let refusal = load(folder.path(), 10).err().expect("refused").to_string();
        assert!(refusal.contains("no .avi files") && refusal.contains("facewire-fit film"), "{refusal}");
    }
}
