//! Judges a model on a clip: every stage of facewire's solver in a row, frame by frame.

use std::{hint::black_box, ops::Range, path::Path, time::Instant};

use anyhow::{Context, Result};
use facewire::{
    face::Landmarks,
    solve::{
        COEFFS, Camera, Corrected, Correction, Features, GatedAverage, GatedAverageState, HeadPose, Model, Neutral,
        NeutralMean, Normalised, RawCoeffs, Smoothed, normalise,
    },
};

use crate::{
    arrays::{Arrays, lone_floats},
    dataset::{LANDMARK_SHAPE, LANDMARK_VALUES, landmarks_of},
    statistics::mean,
};

/// Frame rate of the clips.
const FRAME_S: f32 = 1.0 / 30.0;
/// Faces whose solution is timed.
const TIMED_FACES: usize = 20_000;

/// What the solver makes of each frame.
pub struct Solved {
    /// Output of the regression.
    pub raw: Vec<RawCoeffs>,
    /// After the corrective terms.
    pub corrected: Vec<Corrected>,
    /// After smoothing.
    pub smoothed: Vec<Smoothed>,
    /// Of each frame.
    pub poses: Vec<HeadPose>,
}

/// Reads the frames of a `.npy` file of `facewire track --landmarks`, or `landmarks` of an archive.
pub fn load(path: &Path) -> Result<Vec<Landmarks>> {
    let lone = path.extension().is_some_and(|ending| ending == "npy");
    let values = if lone {
        lone_floats(path, &LANDMARK_SHAPE)?
    } else {
        Arrays::open(path)?.floats("landmarks", &LANDMARK_SHAPE)?
    };
    Ok(values.chunks_exact(LANDMARK_VALUES).map(landmarks_of).collect())
}

/// Runs all stages over a clip, `neutral` being frames of the face at rest.
pub fn solve(model: &Model, clip: &[Landmarks], neutral: Option<Range<usize>>) -> Result<Solved> {
    let faces = clip.iter().map(normalise).collect::<Result<Vec<_>, _>>()?;
    let neutral = neutral.map(|frames| mean_face(&faces, frames)).transpose()?;
    let camera = Camera { width_px: 640.0, height_px: 480.0, horizontal_fov_deg: 60.0 };
    let (correction, smoothing) = (Correction::default(), GatedAverage::default());
    let (mut rest, mut history) = (correction.start(), GatedAverageState::default());
    let mut out = Solved { raw: vec![], corrected: vec![], smoothed: vec![], poses: vec![] };
    for face in &faces {
        let raw = model.process(&Features::new(face, neutral.as_ref()))?;
        let corrected = correction.process(&mut rest, &raw, FRAME_S);
        out.smoothed.push(smoothing.process(&mut history, &corrected));
        out.poses.push(HeadPose::new(face, &camera));
        out.raw.push(raw);
        out.corrected.push(corrected);
    }
    Ok(out)
}

fn mean_face(faces: &[Normalised], frames: Range<usize>) -> Result<Neutral> {
    let mut mean = NeutralMean::default();
    faces.get(frames).context("the clip has no such frames")?.iter().for_each(|face| mean.add(face));
    Ok(mean.finish()?)
}

/// Mean absolute second difference over all coefficients, raw and smoothed: jitter, where a face moves slowly.
pub fn jitters(solved: &Solved) -> [f64; 2] {
    let raw: Vec<_> = solved.raw.iter().map(|frame| frame.0).collect();
    let smoothed: Vec<_> = solved.smoothed.iter().map(|frame| frame.0).collect();
    [jitter(&raw), jitter(&smoothed)]
}

fn jitter(frames: &[[f32; COEFFS]]) -> f64 {
    let second = |w: &[[f32; COEFFS]], i: usize| f64::from((w[2][i] - 2.0 * w[1][i] + w[0][i]).abs());
    mean(frames.windows(3).flat_map(|window| (0..COEFFS).map(move |index| second(window, index))))
}

/// Time of all stages for one face, landmarks to smoothed coefficients: median and 99th percentile, microseconds.
pub fn cost_us(model: &Model, clip: &[Landmarks]) -> Result<[f64; 2]> {
    let (correction, smoothing) = (Correction::default(), GatedAverage::default());
    let (mut rest, mut history) = (correction.start(), GatedAverageState::default());
    let neutral = mean_face(&[normalise(clip.first().context("the clip is empty")?)?], 0..1)?;
    let mut times = Vec::new();
    for landmarks in clip.iter().cycle().take(TIMED_FACES) {
        let start = Instant::now();
        let raw = model.process(&Features::new(&normalise(landmarks)?, Some(&neutral)))?;
        let corrected = correction.process(&mut rest, &raw, FRAME_S);
        black_box(smoothing.process(&mut history, &corrected));
        times.push(start.elapsed().as_secs_f64() * 1e6);
    }
    times.sort_by(f64::total_cmp);
    Ok([times[TIMED_FACES / 2], times[TIMED_FACES * 99 / 100]])
}

#[cfg(test)]
mod tests {
    use facewire::face::LANDMARKS;
    use npyz::{WriteOptions, WriterBuilder};

    use super::*;

    /// Writes frames of points as `facewire track --landmarks` does, and reads them.
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
    fn lone_array_of_a_track_is_read_with_irises_in_depth() {
        let flat = |place: usize| if place / 3 % LANDMARKS < 468 { 6.0 } else { 0.0 };
        let frames = loaded("clip.npy", [2, 478, 3], flat).expect("frames");
        assert_eq!(frames.len(), 2);
        assert!(frames[1].0.iter().all(|point| (point[2] - 6.0).abs() < 1e-6));
    }

    #[test]
    fn what_is_no_clip_is_refused_with_its_name_and_frame() {
        let refusal = |name, shape, value: f32| {
            let at = move |place| if place == 3 * LANDMARKS { value } else { 1.0 };
            format!("{:#}", loaded(name, shape, at).expect_err("refused"))
        };
        let faceless = refusal("clip.npy", [2, 478, 3], f32::NAN);
        assert!(faceless.contains("clip.npy: row 1") && faceless.contains("without a face"), "{faceless}");
        assert!(refusal("clip.npy", [2, 468, 3], 1.0).contains("shape [2, 468, 3]"));
        assert!(refusal("clip.npz", [2, 478, 3], 1.0).contains("clip.npz is not a NumPy archive"));
    }
}
