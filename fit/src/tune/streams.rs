//! Solved clips of wearers: what the filters are given, and what is sent.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
};

use anyhow::{Context, Result, ensure};
use facewire::{
    capture::{FileOptions, open_file},
    config::Settings,
    pipeline::Pipeline,
    playback::{Face, Playback, neutral_of},
    preflight::{load_tracker, shaping},
    solve::{BLENDSHAPES, COEFFS, Filters, Group, HeadPose, Model, Profile, Shaping, Solver},
};
use rayon::prelude::*;

use super::{
    measure::{Curves, Sums},
    smoothing::Part,
    summary::angles_deg,
};
use crate::{curves::Truth, judge::clips::films};

/// Frames at the start of a clip in which the face is at rest, and from which its neutral face is taken.
const NEUTRAL_FRAMES: u64 = 75;

/// A clip of one wearer.
pub struct Stream {
    /// Parts of the clip with their frames.
    pub parts: Vec<(String, Range<usize>)>,
    /// The true curves.
    pub truth: Truth,
    /// Coefficients before the rules and the filters.
    pub raw: Vec<[f32; COEFFS]>,
    /// Poses of the head before the filter.
    pub raw_heads: Vec<HeadPose>,
    /// Coefficients as they are sent.
    pub sent: Vec<[f32; COEFFS]>,
    /// Poses of the head as they are sent.
    pub sent_heads: Vec<HeadPose>,
}

/// Tracks and solves the clips of a folder, in parallel. The solver knows the neutral face.
pub fn load(folder: &Path, settings: &Settings) -> Result<Vec<Stream>> {
    let films = films(folder)?;
    let done = AtomicUsize::new(0);
    let load = |film: &PathBuf| -> Result<Stream> {
        let stream = Stream::load(film, settings).with_context(|| format!("{}", film.display()))?;
        let number = done.fetch_add(1, Ordering::Relaxed) + 1;
        eprintln!("{}: tracked {number} of {} clips", folder.display(), films.len());
        Ok(stream)
    };
    films.par_iter().map(load).collect()
}

impl Stream {
    fn load(film: &Path, settings: &Settings) -> Result<Self> {
        let csv = film.with_extension("csv");
        let (truth, parts) = (Truth::load(&csv)?, parts(&film.with_extension("parts.csv"))?);
        let path = film.to_str().context("the path is not UTF-8")?;
        let mut source = open_file(path, &FileOptions::default())?;
        let solver = Solver::new(Model::embedded(), Profile::default(), Shaping::only(Filters::OFF));
        let pipeline = Pipeline::new(load_tracker(&settings.networks)?, solver, settings.camera.horizontal_fov_deg);
        let mut finder = Playback::new(pipeline, &settings.failsafe);
        let mut next = || -> Result<Option<Face>> { Ok(finder.find(&mut *source)?) };
        let mut first = Vec::new();
        while first.len() < NEUTRAL_FRAMES as usize {
            first.push(next()?.context("the clip is too short")?);
        }
        let neutral = neutral_of(&first, &(0..NEUTRAL_FRAMES)).context("no neutral face in the first frames")?;
        let profile = Profile { neutral: Some(neutral), ..Profile::default() };
        let solver = Solver::new(Model::embedded(), profile, shaping(settings));
        let pipeline = Pipeline::for_landmarks(solver, settings.camera.horizontal_fov_deg);
        let mut run =
            Solved { playback: Playback::new(pipeline, &settings.failsafe), stream: Self::empty(truth, parts) };
        first.iter().try_for_each(|face| run.add(face))?;
        while let Some(face) = next()? {
            run.add(&face)?;
        }
        run.stream.truth.fits(&csv, run.stream.raw.len())?;
        Ok(run.stream)
    }

    fn empty(truth: Truth, parts: Vec<(String, Range<usize>)>) -> Self {
        Self { parts, truth, raw: vec![], raw_heads: vec![], sent: vec![], sent_heads: vec![] }
    }

    /// Measures a part of the face, given what a filter makes of the clip, in the parts of the clip at rest and in motion.
    pub fn sums(
        &self,
        part: Part,
        coefficients: &[[f32; COEFFS]],
        heads: &[HeadPose],
        still: &[&str],
        moving: &[&str],
    ) -> Sums {
        let [still, moving] = [still, moving].map(|names| self.frames(names).collect::<Vec<_>>());
        let sums =
            |raw: &[f64], filtered: &[f64], truth: &[f64]| Sums::of(&Curves { raw, filtered, truth }, &still, &moving);
        let Part::Group(group) = part else {
            let angle =
                |heads: &[HeadPose], axis: usize| heads.iter().map(|head| angles_deg(head)[axis]).collect::<Vec<_>>();
            let truth = |axis: usize| self.truth.pose_deg.iter().map(|pose| pose[axis]).collect::<Vec<_>>();
            return (0..3).map(|axis| sums(&angle(&self.raw_heads, axis), &angle(heads, axis), &truth(axis))).sum();
        };
        let curve = |frames: &[[f32; COEFFS]], index: usize| {
            frames.iter().map(|frame| frame[index].into()).collect::<Vec<f64>>()
        };
        let truth = |index: usize| self.truth.coefficients.iter().map(|frame| frame[index]).collect::<Vec<_>>();
        let members = (0..COEFFS).filter(|index| Group::of(BLENDSHAPES[*index]) == group);
        members.map(|index| sums(&curve(&self.raw, index), &curve(coefficients, index), &truth(index))).sum()
    }

    /// The frames of the parts whose names begin with one of these.
    pub fn frames(&self, names: &[&str]) -> impl Iterator<Item = Range<usize>> {
        let is_named = |part: &&(String, Range<usize>)| names.iter().any(|name| part.0.starts_with(name));
        self.parts.iter().filter(is_named).map(|(_, frames)| frames.clone()).collect::<Vec<_>>().into_iter()
    }
}

struct Solved {
    playback: Playback,
    stream: Stream,
}

impl Solved {
    /// Solves a frame. One without a solution repeats the frame before.
    fn add(&mut self, face: &Face) -> Result<()> {
        let stream = &mut self.stream;
        if let Some(solution) = self.playback.show(face).solution {
            stream.raw.push(solution.corrected.0);
            stream.raw_heads.push(solution.raw_head);
            stream.sent.push(solution.smoothed.0);
            stream.sent_heads.push(solution.head);
        } else {
            stream.raw.push(*stream.raw.last().context("no face in the first frame")?);
            stream.raw_heads.push(*stream.raw_heads.last().context("no face in the first frame")?);
            stream.sent.push(*stream.sent.last().context("no face in the first frame")?);
            stream.sent_heads.push(*stream.sent_heads.last().context("no face in the first frame")?);
        }
        Ok(())
    }
}

/// Reads the table of parts that `facewire-fit film --script wearer` writes: name, first frame, number of frames.
fn parts(path: &Path) -> Result<Vec<(String, Range<usize>)>> {
    let refusal = || format!("{} is no table of parts: make the clip with `facewire-fit film`", path.display());
    let text = std::fs::read_to_string(path).with_context(refusal)?;
    let part = |line: &str| {
        let [name, first, frames] = line.split(',').collect::<Vec<_>>()[..] else { return None };
        let (first, frames): (usize, usize) = (first.parse().ok()?, frames.parse().ok()?);
        Some((name.to_owned(), first..first + frames))
    };
    let parts: Vec<_> = text.lines().skip(1).map(part).collect::<Option<_>>().with_context(refusal)?;
    ensure!(!parts.is_empty(), refusal());
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_of_parts_is_read_and_another_file_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("01.parts.csv");
        std::fs::write(&path, "part,first_frame,frames\nstill-bright,0,75\nblinks,75,195\n").expect("written");
        assert_eq!(
            parts(&path).expect("a table"),
            [("still-bright".to_owned(), 0..75), ("blinks".to_owned(), 75..270)]
        );
        std::fs::write(&path, "frame,yaw_deg\n1,2\n").expect("written");
        assert!(parts(&path).expect_err("refused").to_string().contains("no table of parts"));
    }
}
