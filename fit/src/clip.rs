//! Judges a model on a clip: every stage of facewire's solver in a row, frame by frame.

use std::{fs::File, hint::black_box, io::BufReader, ops::Range, path::Path, time::Instant};

use anyhow::{Context, Result, ensure};
use facewire::{
    face::Landmarks,
    solve::{
        BLENDSHAPES, COEFFS, Camera, Corrected, Correction, Features, GatedAverage,
        GatedAverageState, HeadPose, Model, Neutral, NeutralMean, Normalised, RawCoeffs, Smoothed,
        normalise,
    },
};
use npyz::npz::NpzArchive;

use crate::{
    dataset::{LANDMARK_VALUES, floats, landmarks_of},
    stats::{mean, pearson},
};

/// Frame rate of the clips.
const FRAME_S: f32 = 1.0 / 30.0;
/// Smoothing and the network delay a curve: the truth may lead by this many frames.
const MAX_LAG: usize = 5;
/// Coefficients that move less (standard deviation) say nothing about correlation.
const MOVING: f64 = 0.02;
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

/// Reads `landmarks` of an archive of frames.
pub fn load(path: &Path) -> Result<Vec<Landmarks>> {
    let file = File::open(path).with_context(|| format!("cannot open {}", path.display()))?;
    let mut archive = NpzArchive::new(BufReader::new(file)).context("not a NumPy archive")?;
    let values = floats(&mut archive, "landmarks", LANDMARK_VALUES)?;
    Ok(values
        .chunks_exact(LANDMARK_VALUES)
        .map(landmarks_of)
        .collect())
}

/// Runs all stages over a clip, `neutral` being frames of the face at rest.
pub fn solve(model: &Model, clip: &[Landmarks], neutral: Option<Range<usize>>) -> Result<Solved> {
    let faces = clip.iter().map(normalise).collect::<Result<Vec<_>, _>>()?;
    let neutral = neutral
        .map(|frames| mean_face(&faces, frames))
        .transpose()?;
    let camera = Camera {
        width_px: 640.0,
        height_px: 480.0,
        horizontal_fov_deg: 60.0,
    };
    let (correction, smoothing) = (Correction::default(), GatedAverage::default());
    let (mut rest, mut history) = (correction.start(), GatedAverageState::default());
    let mut out = Solved {
        raw: vec![],
        corrected: vec![],
        smoothed: vec![],
        poses: vec![],
    };
    for face in &faces {
        let raw = model.process(&Features::new(face, neutral.as_ref()))?;
        let corrected = correction.process(&mut rest, &raw, FRAME_S);
        out.smoothed
            .push(smoothing.process(&mut history, &corrected));
        out.poses.push(HeadPose::new(face, &camera));
        out.raw.push(raw);
        out.corrected.push(corrected);
    }
    Ok(out)
}

fn mean_face(faces: &[Normalised], frames: Range<usize>) -> Result<Neutral> {
    let mut mean = NeutralMean::default();
    faces
        .get(frames)
        .context("the clip has no such frames")?
        .iter()
        .for_each(|face| mean.add(face));
    Ok(mean.finish()?)
}

/// True curves of a clip.
pub struct Truth {
    /// Yaw, pitch (positive nods up), roll by frame, degrees.
    pub pose_deg: Vec<[f64; 3]>,
    /// Coefficients by frame.
    pub coefficients: Vec<[f64; COEFFS]>,
}

/// Reads a table with a header of names: `yaw_deg,pitch_deg,roll_deg` (pitch nods down) and the blendshapes.
pub fn load_truth(path: &Path) -> Result<Truth> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines
        .next()
        .context("the table is empty")?
        .split(',')
        .collect();
    let column = |name: &str| {
        header
            .iter()
            .position(|known| *known == name)
            .with_context(|| format!("no {name}"))
    };
    let pose = [
        column("yaw_deg")?,
        column("pitch_deg")?,
        column("roll_deg")?,
    ];
    let shapes = BLENDSHAPES
        .iter()
        .map(|name| column(name))
        .collect::<Result<Vec<_>>>()?;
    let mut truth = Truth {
        pose_deg: vec![],
        coefficients: vec![],
    };
    for line in lines {
        let row = line
            .split(',')
            .map(str::parse)
            .collect::<Result<Vec<f64>, _>>()?;
        ensure!(
            row.len() == header.len(),
            "a line has {} values, the header {}",
            row.len(),
            header.len()
        );
        let [yaw, pitch, roll] = pose.map(|index| row[index]);
        truth.pose_deg.push([yaw, -pitch, roll]);
        truth
            .coefficients
            .push(core::array::from_fn(|index| row[shapes[index]]));
    }
    Ok(truth)
}

/// Best correlation of a curve with the truth, letting the curve come up to [`MAX_LAG`] frames late, and that lag.
pub fn lagged_r(curve: &[f64], truth: &[f64]) -> (f64, usize) {
    let at = |lag: usize| {
        (
            pearson(curve.iter().skip(lag).copied().zip(truth.iter().copied())),
            lag,
        )
    };
    (0..=MAX_LAG).map(at).fold(
        (-1.0, 0),
        |best, next| if next.0 > best.0 { next } else { best },
    )
}

/// Blendshapes that move in the truth, with their curves.
pub fn moving(truth: &Truth) -> impl Iterator<Item = (usize, Vec<f64>)> {
    let curve = |index: usize| {
        truth
            .coefficients
            .iter()
            .map(|frame| frame[index])
            .collect::<Vec<_>>()
    };
    let curves = (0..COEFFS).map(move |index| (index, curve(index)));
    curves.filter(|(_, curve)| deviation(curve) > MOVING)
}

fn deviation(curve: &[f64]) -> f64 {
    let centre = mean(curve.iter().copied());
    mean(curve.iter().map(|value| (value - centre).powi(2))).sqrt()
}

/// Mean absolute second difference over all coefficients, raw and smoothed: jitter, where a face moves slowly.
pub fn jitters(solved: &Solved) -> [f64; 2] {
    let raw: Vec<_> = solved.raw.iter().map(|frame| frame.0).collect();
    let smoothed: Vec<_> = solved.smoothed.iter().map(|frame| frame.0).collect();
    [jitter(&raw), jitter(&smoothed)]
}

fn jitter(frames: &[[f32; COEFFS]]) -> f64 {
    let second =
        |w: &[[f32; COEFFS]], i: usize| f64::from((w[2][i] - 2.0 * w[1][i] + w[0][i]).abs());
    mean(
        frames
            .windows(3)
            .flat_map(|window| (0..COEFFS).map(move |index| second(window, index))),
    )
}

/// The table that `clip` prints.
pub fn table(truth: &Truth, with: &Solved, without: &Solved) -> String {
    let curve = |solved: &Solved, index: usize| {
        solved
            .smoothed
            .iter()
            .map(|f| f64::from(f.0[index]))
            .collect::<Vec<_>>()
    };
    let mut lines = String::from(
        "| blendshape           | r, neutral known (lag) | r, not known (lag) |\n|---|---|---|\n",
    );
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    for (index, true_curve) in moving(truth) {
        let (a, b) = (
            lagged_r(&curve(with, index), &true_curve),
            lagged_r(&curve(without, index), &true_curve),
        );
        lines += &format!(
            "| {:<20} | {:.3} ({}) | {:.3} ({}) |\n",
            BLENDSHAPES[index], a.0, a.1, b.0, b.1
        );
        sums = [sums[0] + a.0, sums[1] + b.0];
        count += 1.0;
    }
    lines
        + &format!(
            "| mean of {count} | {:.3} | {:.3} |\n",
            sums[0] / count,
            sums[1] / count
        )
}

/// Time of all stages for one face, landmarks to smoothed coefficients: median and 99th percentile, microseconds.
pub fn cost_us(model: &Model, clip: &[Landmarks]) -> Result<[f64; 2]> {
    let (correction, smoothing) = (Correction::default(), GatedAverage::default());
    let (mut rest, mut history) = (correction.start(), GatedAverageState::default());
    let neutral = mean_face(
        &[normalise(clip.first().context("the clip is empty")?)?],
        0..1,
    )?;
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

/// Mean absolute error of yaw, pitch, roll, degrees.
pub fn pose_error_deg(truth: &Truth, solved: &Solved) -> [f64; 3] {
    let angles = |pose: &HeadPose| [pose.yaw_deg, pose.pitch_deg, pose.roll_deg].map(f64::from);
    let pairs = || solved.poses.iter().map(angles).zip(&truth.pose_deg);
    core::array::from_fn(|axis| {
        mean(pairs().map(|(angles, truth)| (angles[axis] - truth[axis]).abs()))
    })
}
