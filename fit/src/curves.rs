//! Runs a clip through every stage of facewire's solver, frame by frame, and compares its curves with the true curves.

use std::hint::black_box;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use facewire::{config::Settings, pipeline::shaping};
use facewire_face::stages::{FaceMean, Features, normalise};
use facewire_face::{
    Appearance, BLENDSHAPES, COEFFS, Camera, Face, Landmarks, Model, Neutral, Profile, Solution, Solver,
};

use crate::arrays::{Arrays, npy_floats};
use crate::dataset::{LANDMARK_SHAPE, LANDMARK_VALUES, landmarks_of};
use crate::output::Table;
use crate::recording::CsvTable;
use crate::statistics::{mean, pearson, standard_deviation};

pub const FRAME_US: u64 = 33_333;
const CAMERA: Camera = Camera { width_px: 640.0, height_px: 480.0, horizontal_fov_deg: 60.0 };
const TIMED_FACES: usize = 4_000;

/// Reads the frames from a `.npy` file of `facewire track --landmarks`, or from the array `landmarks` of an archive.
pub fn load_landmarks(path: &Path) -> Result<Vec<Landmarks>> {
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

/// Returns the mean absolute second difference of the coefficients, raw and smoothed: the jitter of a slow face.
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

/// The largest lag in frames by which a curve may follow the truth. Smoothing and the network delay curves.
const MAX_LAG: usize = 5;
/// Curves with a smaller standard deviation are left out, because their correlation means nothing.
pub const MOVING: f64 = 0.02;

pub struct Truth {
    /// Yaw, pitch (positive when the head nods up) and roll of each frame in degrees.
    pub pose_deg: Vec<[f64; 3]>,
    pub coefficients: Vec<[f64; COEFFS]>,
}

impl Truth {
    /// Reads a CSV file with `yaw_deg,pitch_deg,roll_deg` (pitch positive when nodding down) and all blendshapes.
    pub fn load(path: &Path) -> Result<Self> {
        Self::of(&CsvTable::load(path)?).with_context(|| format!("{} is not a table of true curves", path.display()))
    }

    fn of(table: &CsvTable) -> Result<Self> {
        let [yaw, pitch, roll] = ["yaw_deg", "pitch_deg", "roll_deg"].map(|name| table.numbers(name));
        let (yaw, pitch, roll) = (yaw?, pitch?, roll?);
        let pose_deg = (0..yaw.len()).map(|row| [yaw[row], -pitch[row], roll[row]]).collect();
        Ok(Self { pose_deg, coefficients: table.coefficients()? })
    }

    pub fn fits(&self, path: &Path, frames: usize) -> Result<()> {
        let rows = self.coefficients.len();
        ensure!(
            rows == frames,
            "{} has {rows} rows, but the clip has {frames} frames: cut both to the same frames",
            path.display()
        );
        Ok(())
    }
}

fn lagged_r(curve: &[f64], truth: &[f64]) -> (f64, usize) {
    let at = |lag: usize| (pearson(curve.get(lag..).unwrap_or_default(), truth), lag);
    (0..=MAX_LAG).map(at).fold((-1.0, 0), |best, next| if next.0 > best.0 { next } else { best })
}

/// Returns the table that `clip` prints: the best correlation and its lag, with the neutral face known and not known.
pub fn table(truth: &Truth, known: &[Solution], unknown: &[Solution]) -> Table {
    let found = |index: usize| {
        let true_curve: Vec<f64> = truth.coefficients.iter().map(|frame| frame[index]).collect();
        let both = || [known, unknown].map(|solved| lagged_r(&curve(solved, index), &true_curve));
        (standard_deviation(&true_curve) > MOVING).then(|| (BLENDSHAPES[index], both()))
    };
    let found: Vec<_> = (0..COEFFS).filter_map(found).collect();
    let row = |(name, both): &(&str, [(f64, usize); 2])| {
        [(*name).to_owned()].into_iter().chain(both.map(|(r, lag)| format!("{r:.3} ({lag})"))).collect::<Vec<_>>()
    };
    let means = [0, 1].map(|side: usize| format!("{:.3}", mean(found.iter().map(|(_, both)| both[side].0))));
    let means = [format!("mean of {}", found.len())].into_iter().chain(means).collect();
    let heads = ["blendshape", "r, neutral known (lag)", "r, not known (lag)"];
    Table::new(heads, found.iter().map(row).chain([means]))
}

fn curve(solved: &[Solution], index: usize) -> Vec<f64> {
    solved.iter().map(|frame| f64::from(frame.smoothed.0[index])).collect()
}

pub fn pose_error_deg(truth: &Truth, solved: &[Solution]) -> [f64; 3] {
    let angles = |frame: &Solution| frame.head.yaw_pitch_roll_deg().map(f64::from);
    let pairs = || solved.iter().map(angles).zip(&truth.pose_deg);
    core::array::from_fn(|axis| mean(pairs().map(|(angles, truth)| (angles[axis] - truth[axis]).abs())))
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Parts(Vec<(String, Range<usize>)>);

impl Parts {
    pub fn load(path: &Path) -> Result<Self> {
        let refusal = || {
            format!("{} is no table of parts: make the clip with `facewire-fit film --script wearer`", path.display())
        };
        let mut rows = csv::Reader::from_path(path).with_context(refusal)?;
        let part = |row: Result<(String, usize, usize), csv::Error>| {
            let (name, first, frames) = row?;
            Ok((name, first..first + frames))
        };
        let parts: Vec<_> = rows.deserialize().map(part).collect::<Result<_>>().with_context(refusal)?;
        ensure!(!parts.is_empty(), refusal());
        Ok(Self(parts))
    }

    pub fn of(&self, name: &str) -> Range<usize> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, frames)| frames.clone()).unwrap_or_default()
    }

    pub fn starting_with(&self, names: &[&str]) -> impl Iterator<Item = Range<usize>> {
        self.0
            .iter()
            .filter(|(known, _)| names.iter().any(|name| known.starts_with(name)))
            .map(|(_, frames)| frames.clone())
    }
}

/// A lid is shut above the first value, and open below the second.
pub const SHUT: f64 = 0.9;
pub const OPEN: f64 = 0.1;
/// `eyeBlinkLeft` and `eyeBlinkRight`.
pub const LIDS: [usize; 2] = [0, 7];

/// Returns the frames in which the true lid is shut, as ranges.
pub fn shut(truth: &[[f64; COEFFS]], lid: usize) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for frame in (0..truth.len()).filter(|frame| truth[*frame][lid] > SHUT) {
        match runs.last_mut() {
            Some(run) if run.end == frame => run.end += 1,
            _ => runs.push(frame..frame + 1),
        }
    }
    runs
}

#[cfg(test)]
pub mod tests {
    use facewire_face::LANDMARKS;
    use npyz::{NpyFile, WriteOptions, WriterBuilder};

    use super::*;
    use crate::{design::index_of, reference};

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
        load_landmarks(&path)
    }

    #[test]
    fn a_landmark_file_of_track_is_read_and_its_irises_are_levelled() {
        let flat = |index: usize| if index / 3 % LANDMARKS < 468 { 6.0 } else { 0.0 };
        let frames = loaded("clip.npy", [2, 478, 3], flat).expect("frames");
        assert_eq!(frames.len(), 2);
        assert!(frames[1].0.iter().all(|point| (point[2] - 6.0).abs() < 1e-6));
    }

    /// Solves the built-in clip from MediaPipe's landmarks of every 8th frame, and returns the truth of these frames.
    fn demo(neutral: Option<core::ops::Range<usize>>) -> (Vec<Solution>, Truth) {
        let truth = Truth::load(Path::new(reference::DEMO_TRUTH)).expect("the truth");
        let pose_deg = truth.pose_deg.into_iter().step_by(8).collect();
        let truth = Truth { pose_deg, coefficients: truth.coefficients.into_iter().step_by(8).collect() };
        let solved = solve(&Model::embedded(), &test_clip(), neutral, 8 * FRAME_US).expect("every frame");
        (solved, truth)
    }

    #[test]
    fn truth_of_another_length_or_without_numbers_is_refused() {
        let header = format!("frame,yaw_deg,pitch_deg,roll_deg,{}", BLENDSHAPES.join(","));
        let row = |value: &str| ["0.5"; COEFFS + 3].join(",") + "," + value;
        let read = |last: &str| {
            let text = [&header, &row("0.1"), &row(last)].map(String::as_str).join("\n");
            Truth::of(&CsvTable::read(text.as_bytes())?)
        };
        let truth = read("0.2").expect("a table");
        assert!(truth.fits(Path::new("clip.csv"), 2).is_ok());
        let refusal = truth.fits(Path::new("clip.csv"), 3).expect_err("a row is missing").to_string();
        assert!(refusal.contains("clip.csv has 2 rows") && refusal.contains("3 frames"), "{refusal}");
        assert!(read("NaN").is_err_and(|error| error.to_string().contains("line 3")));
    }

    #[test]
    fn jaw_blinks_and_head_follow_the_truth_even_if_the_neutral_face_is_not_known() {
        let (solved, truth) = demo(None);
        for (name, least) in [("jawOpen", 0.9), ("eyeBlinkLeft", 0.8), ("eyeBlinkRight", 0.8)] {
            let index = index_of(name);
            let true_curve: Vec<f64> = truth.coefficients.iter().map(|frame| frame[index]).collect();
            let (r, _) = lagged_r(&curve(&solved, index), &true_curve);
            assert!(r > least, "{name}: {r}");
        }
        assert!(pose_error_deg(&truth, &solved).iter().all(|error| *error < 1.5));
        let (solved, _) = demo(Some(0..1));
        for lid in LIDS {
            let curve = curve(&solved, lid);
            assert!(curve.iter().any(|value| *value > 0.8), "closed");
            assert!(curve.iter().take(3).all(|value| *value < 0.1), "open");
        }
    }

    #[test]
    fn shut_lids_are_found_as_ranges() {
        let truth = [0.0, 0.95, 1.0, 0.2, 0.0, 1.0].map(|value| [value; COEFFS]);
        assert_eq!(shut(&truth, LIDS[1]), [1..3, 5..6]);
    }

    #[test]
    fn table_of_parts_is_read_and_another_file_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("01.parts.csv");
        std::fs::write(&path, "part,first_frame,frames\nstill-bright,0,75\nblinks,75,195\n").expect("written");
        let parts = Parts::load(&path).expect("a table");
        assert_eq!(parts.0, [("still-bright".to_owned(), 0..75), ("blinks".to_owned(), 75..270)]);
        assert_eq!((parts.of("blinks"), parts.of("winks")), (75..270, 0..0));
        assert!(parts.starting_with(&["still"]).eq(std::iter::once(0..75)));
        std::fs::write(&path, "frame,yaw_deg\n1,2\n").expect("written");
        assert!(Parts::load(&path).expect_err("refused").to_string().contains("no table of parts"));
    }
}
