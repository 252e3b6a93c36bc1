//! Solved clips of wearers: what the filters are given, and what is sent.

use std::path::Path;

use anyhow::{Context, Result};
use facewire::{
    capture::{FileOptions, open_file},
    config::Settings,
    pipeline::Pipeline,
    playback::{Face, Playback, neutral_of},
    preflight::{load_tracker, shaping},
    solve::{BLENDSHAPES, COEFFS, Filters, Group, HeadPose, Model, Profile, Shaping, Solver},
};

use super::{
    measure::{Curves, Sums},
    smoothing::Part,
    summary::angles_deg,
};
use crate::{curves::Truth, judge::clips::load_each, parts::Parts};

/// Frames at the start of a clip in which the face is at rest, and from which its neutral face is taken.
const NEUTRAL_FRAMES: u64 = 75;

/// A clip of one wearer.
pub struct Stream {
    /// Parts of the clip with their frames.
    pub parts: Parts,
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
    load_each(folder, |film| Stream::load(film, settings))
}

impl Stream {
    fn load(film: &Path, settings: &Settings) -> Result<Self> {
        let csv = film.with_extension("csv");
        let (truth, parts) = (Truth::load(&csv)?, Parts::load(&film.with_extension("parts.csv"))?);
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

    fn empty(truth: Truth, parts: Parts) -> Self {
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
        let [still, moving] = [still, moving].map(|names| self.parts.starting_with(names).collect::<Vec<_>>());
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
