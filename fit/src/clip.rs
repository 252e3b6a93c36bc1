//! Judges a model on a clip: runs every stage of facewire's solver, frame by frame.

use std::{hint::black_box, ops::Range, path::Path, time::Instant};

use anyhow::{Context, Result};
use facewire::{config::Settings, preflight::shaping};
use facewire_face::stages::{FaceMean, Features, normalise};
use facewire_face::{Appearance, COEFFS, Camera, Face, Landmarks, Model, Neutral, Profile, Solution, Solver};

use crate::arrays::{Arrays, npy_floats};
use crate::dataset::{LANDMARK_SHAPE, LANDMARK_VALUES, landmarks_of};
use crate::statistics::mean;

pub const FRAME_US: u64 = 33_333;
const CAMERA: Camera = Camera { width_px: 640.0, height_px: 480.0, horizontal_fov_deg: 60.0 };
const TIMED_FACES: usize = 4_000;

/// Reads the frames from a `.npy` file of `facewire track --landmarks`, or from the array `landmarks` of an archive.
pub fn load(path: &Path) -> Result<Vec<Landmarks>> {
    let is_npy = path.extension().is_some_and(|extension| extension == "npy");
    let values = if is_npy {
        npy_floats(path, &LANDMARK_SHAPE)?
    } else {
        Arrays::open(path)?.floats("landmarks", &LANDMARK_SHAPE)?
    };
    Ok(values.chunks_exact(LANDMARK_VALUES).map(landmarks_of).collect())
}

pub fn solve(model: &Model, clip: &[Landmarks], neutral: Option<Range<usize>>, frame_us: u64) -> Result<Vec<Solution>> {
    let neutral = neutral.map(|frames| mean_face(clip, frames)).transpose()?;
    let mut solver = solver(model, neutral);
    let frames = (0..).step_by(frame_us as usize).zip(clip);
    frames.map(|(time_us, landmarks)| Ok(solver.solve(landmarks, &CAMERA, time_us)?)).collect()
}

fn solver(model: &Model, neutral: Option<Neutral>) -> Solver {
    Solver::new(model.clone(), Profile { neutral, ..Profile::default() }, shaping(&Settings::default()))
}

fn mean_face(clip: &[Landmarks], frames: Range<usize>) -> Result<Neutral> {
    let mut mean = FaceMean::default();
    for landmarks in clip.get(frames).context("the clip has fewer frames than the neutral range")? {
        mean.add(&normalise(landmarks)?);
    }
    Ok(mean.neutral()?)
}

/// Returns the mean absolute second difference over all coefficients, raw and smoothed. It measures the jitter of a
/// face that moves slowly.
pub fn jitters(solved: &[Solution]) -> [f64; 2] {
    let raw: Vec<_> = solved.iter().map(|frame| frame.raw.0).collect();
    let smoothed: Vec<_> = solved.iter().map(|frame| frame.smoothed.0).collect();
    [jitter(&raw), jitter(&smoothed)]
}

fn jitter(frames: &[[f32; COEFFS]]) -> f64 {
    let second = |w: &[[f32; COEFFS]], i: usize| f64::from((w[2][i] - 2.0 * w[1][i] + w[0][i]).abs());
    mean(frames.windows(3).flat_map(|window| (0..COEFFS).map(move |index| second(window, index))))
}

/// Times the solver from a face to its solution. Returns median and 99th percentile in microseconds.
pub fn cost_us(model: &Model, clip: &[Landmarks]) -> Result<[f64; 2]> {
    let mut solver = solver(model, Some(mean_face(clip, 0..1)?));
    // The clip does not tell how the face looks. The values make no difference to the time.
    let appearance = Appearance::zero();
    let frames = (0..).step_by(FRAME_US as usize).zip(clip.iter().cycle());
    times_us(frames, |(time_us, landmarks)| {
        let face = Face { landmarks, appearance: Some(&appearance) };
        black_box(solver.solve(black_box(face), &CAMERA, time_us)?);
        Ok(())
    })
}

/// Times the regression alone. Returns median and 99th percentile in microseconds.
pub fn regression_us(model: &Model, clip: &[Landmarks]) -> Result<[f64; 2]> {
    let neutral = mean_face(clip, 0..1)?;
    let features = |landmarks| Ok(Features::new(&normalise(landmarks)?, Some(&neutral)));
    let faces: Vec<Features> = clip.iter().map(features).collect::<Result<_>>()?;
    times_us(faces.iter().cycle(), |face| {
        black_box(model.process(black_box(face))?);
        Ok(())
    })
}

fn times_us<T>(faces: impl Iterator<Item = T>, mut solve: impl FnMut(T) -> Result<()>) -> Result<[f64; 2]> {
    let one = |face| {
        let start = Instant::now();
        solve(face)?;
        Ok(start.elapsed().as_secs_f64() * 1e6)
    };
    let mut times = faces.take(TIMED_FACES).map(one).collect::<Result<Vec<f64>>>()?;
    times.sort_by(f64::total_cmp);
    Ok([times[TIMED_FACES / 2], times[TIMED_FACES * 99 / 100]])
}

#[cfg(test)]
pub mod tests {
    use facewire_face::LANDMARKS;
    use npyz::{NpyFile, WriteOptions, WriterBuilder};

    use super::*;

    /// Returns MediaPipe's landmarks of every 8th frame of the built-in clip, which the file stores in 1/32 pixel.
    pub fn test_clip() -> Vec<Landmarks> {
        let file = include_bytes!("../../tests/golden/demo-landmarks.npy");
        let values: Vec<i16> = NpyFile::new(&file[..]).expect("an array").into_vec().expect("16 bits");
        let values: Vec<f32> = values.into_iter().map(|value| f32::from(value) / 32.0).collect();
        values.chunks_exact(LANDMARK_VALUES).map(landmarks_of).collect()
    }

    fn loaded(name: &str, shape: [u64; 3], value: impl Fn(usize) -> f32) -> Result<Vec<Landmarks>> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join(name);
        let file = std::fs::File::create(&path)?;
        let mut array = WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd()?;
        array.extend((0..shape.iter().product::<u64>() as usize).map(value))?;
        array.finish()?;
        load(&path)
    }

    #[test]
    fn a_landmark_file_of_track_is_read_and_its_irises_are_levelled() {
        let flat = |index: usize| if index / 3 % LANDMARKS < 468 { 6.0 } else { 0.0 };
        let frames = loaded("clip.npy", [2, 478, 3], flat).expect("frames");
        assert_eq!(frames.len(), 2);
        assert!(frames[1].0.iter().all(|point| (point[2] - 6.0).abs() < 1e-6));
    }
}
