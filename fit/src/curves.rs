//! Compares the curves of a clip with the true curves.

use std::{fmt::Write, path::Path};

use anyhow::{Context, Result, ensure};
use facewire::solve::{BLENDSHAPES, COEFFS, Solution};

use crate::statistics::{mean, pearson, standard_deviation};

/// The largest lag in frames by which a curve may follow the truth. Smoothing and the network delay curves.
const MAX_LAG: usize = 5;
/// Curves with a smaller standard deviation are left out, because their correlation means nothing.
pub const MOVING: f64 = 0.02;

/// The true curves of a clip.
pub struct Truth {
    /// Yaw, pitch (positive when the head nods up) and roll of each frame in degrees.
    pub pose_deg: Vec<[f64; 3]>,
    /// Coefficients of each frame.
    pub coefficients: Vec<[f64; COEFFS]>,
}

impl Truth {
    /// Reads a CSV file with a header: `yaw_deg,pitch_deg,roll_deg` (pitch positive when nodding down) and the
    /// blendshapes.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&text).with_context(|| format!("{} is not a table of true curves", path.display()))
    }

    /// Checks that the table has as many rows as the clip has frames.
    pub fn fits(&self, path: &Path, frames: usize) -> Result<()> {
        let rows = self.coefficients.len();
        ensure!(
            rows == frames,
            "{} has {rows} rows, but the clip has {frames} frames: cut both to the same frames",
            path.display()
        );
        Ok(())
    }

    fn parse(text: &str) -> Result<Self> {
        let mut lines = text.lines();
        let header: Vec<&str> = lines.next().context("the table is empty")?.split(',').collect();
        let column = |name: &str| header.iter().position(|known| *known == name).with_context(|| format!("no {name}"));
        let pose = [column("yaw_deg")?, column("pitch_deg")?, column("roll_deg")?];
        let shapes = BLENDSHAPES.iter().map(|name| column(name)).collect::<Result<Vec<_>>>()?;
        let mut truth = Truth { pose_deg: vec![], coefficients: vec![] };
        for (number, line) in (2..).zip(lines) {
            let value = |cell: &str| cell.parse().ok().filter(|value: &f64| value.is_finite());
            let row: Option<Vec<f64>> = line.split(',').map(value).collect();
            let row = row.with_context(|| format!("line {number} has a value that is not a number"))?;
            ensure!(row.len() == header.len(), "line {number} has {} values instead of {}", row.len(), header.len());
            let [yaw, pitch, roll] = pose.map(|index| row[index]);
            truth.pose_deg.push([yaw, -pitch, roll]);
            truth.coefficients.push(core::array::from_fn(|index| row[shapes[index]]));
        }
        Ok(truth)
    }
}

/// Returns the best correlation of a curve that may lag the truth by up to [`MAX_LAG`] frames, and that lag.
fn lagged_r(curve: &[f64], truth: &[f64]) -> (f64, usize) {
    let at = |lag: usize| (pearson(curve.get(lag..).unwrap_or_default(), truth), lag);
    (0..=MAX_LAG).map(at).fold((-1.0, 0), |best, next| if next.0 > best.0 { next } else { best })
}

/// Returns the index and true curve of the blendshapes that move.
fn moving(truth: &Truth) -> impl Iterator<Item = (usize, Vec<f64>)> {
    let curve = |index: usize| truth.coefficients.iter().map(|frame| frame[index]).collect::<Vec<_>>();
    let curves = (0..COEFFS).map(move |index| (index, curve(index)));
    curves.filter(|(_, curve)| standard_deviation(curve) > MOVING)
}

/// Returns the table that `clip` prints: the best correlation and its lag, with the neutral face known and not known.
pub fn table(truth: &Truth, known: &[Solution], unknown: &[Solution]) -> Result<String> {
    let mut lines =
        String::from("| blendshape           | r, neutral known (lag) | r, not known (lag) |\n|---|---|---|\n");
    let mut found = Vec::new();
    for (index, true_curve) in moving(truth) {
        let [a, b] = [known, unknown].map(|solved| lagged_r(&curve(solved, index), &true_curve));
        writeln!(lines, "| {:<20} | {:.3} ({}) | {:.3} ({}) |", BLENDSHAPES[index], a.0, a.1, b.0, b.1)?;
        found.push([a.0, b.0]);
    }
    let [a, b] = [0, 1].map(|side: usize| mean(found.iter().map(|pair| pair[side])));
    writeln!(lines, "| mean of {} | {a:.3} | {b:.3} |", found.len())?;
    Ok(lines)
}

fn curve(solved: &[Solution], index: usize) -> Vec<f64> {
    solved.iter().map(|frame| f64::from(frame.smoothed.0[index])).collect()
}

/// Returns the mean absolute error of yaw, pitch and roll in degrees.
pub fn pose_error_deg(truth: &Truth, solved: &[Solution]) -> [f64; 3] {
    let angles = |frame: &Solution| [frame.head.yaw_deg, frame.head.pitch_deg, frame.head.roll_deg].map(f64::from);
    let pairs = || solved.iter().map(angles).zip(&truth.pose_deg);
    core::array::from_fn(|axis| mean(pairs().map(|(angles, truth)| (angles[axis] - truth[axis]).abs())))
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use facewire::{face::Landmarks, solve::Model};

    use super::*;
    use crate::{
        clip::{load, solve},
        reference,
    };

    /// Loads the built-in clip's landmarks and truth from the folder of reference data.
    fn demo() -> Option<(Vec<Landmarks>, Truth)> {
        let shared = reference::folder();
        let landmarks = load(&shared.join("golden/demo-mediapipe.npz")).ok();
        let truth = Truth::load(&shared.join("footage/demo.csv")).ok();
        if landmarks.is_none() || truth.is_none() {
            reference::say_skipped("golden/ and footage/");
        }
        landmarks.zip(truth)
    }

    fn index_of(name: &str) -> usize {
        BLENDSHAPES.iter().position(|known| *known == name).expect("a blendshape")
    }

    #[test]
    fn truth_of_another_length_or_without_numbers_is_refused() {
        let header = format!("frame,yaw_deg,pitch_deg,roll_deg,{}", BLENDSHAPES.join(","));
        let row = |value: &str| ["0.5"; COEFFS + 3].join(",") + "," + value;
        let truth = Truth::parse(&[&header, &row("0.1"), &row("0.2")].map(String::as_str).join("\n")).expect("a table");
        assert!(truth.fits(Path::new("clip.csv"), 2).is_ok());
        let refusal = truth.fits(Path::new("clip.csv"), 3).expect_err("a row is missing").to_string();
        assert!(refusal.contains("clip.csv has 2 rows") && refusal.contains("3 frames"), "{refusal}");
        let refusal = Truth::parse(&[&header, &row("0.1"), &row("NaN")].map(String::as_str).join("\n")).err();
        assert!(refusal.is_some_and(|error| error.to_string().contains("line 3")));
    }

    #[test]
    fn jaw_and_blinks_follow_the_truth_even_if_the_neutral_face_is_not_known() {
        let Some((landmarks, truth)) = demo() else {
            return;
        };
        let solved = solve(&Model::embedded(), &landmarks, None).expect("every frame");
        for (name, least) in [("jawOpen", 0.9), ("eyeBlinkLeft", 0.8), ("eyeBlinkRight", 0.8)] {
            let index = index_of(name);
            let true_curve: Vec<f64> = truth.coefficients.iter().map(|frame| frame[index]).collect();
            let (r, _) = lagged_r(&curve(&solved, index), &true_curve);
            assert!(r > least, "{name}: {r}");
        }
    }

    #[test]
    fn closed_eyes_read_above_0_8_and_open_ones_below_0_1() {
        let Some((landmarks, _)) = demo() else { return };
        let solved = solve(&Model::embedded(), &landmarks, Some(0..1)).expect("every frame");
        for name in ["eyeBlinkLeft", "eyeBlinkRight"] {
            let curve = curve(&solved, index_of(name));
            assert!(curve.iter().any(|value| *value > 0.8), "{name}");
            assert!(curve.iter().take(3).all(|value| *value < 0.1), "{name}");
        }
    }

    #[test]
    fn head_pose_error_is_below_1_5_degrees_on_average() {
        let Some((landmarks, truth)) = demo() else {
            return;
        };
        let solved = solve(&Model::embedded(), &landmarks, None).expect("every frame");
        assert!(pose_error_deg(&truth, &solved).iter().all(|error| *error < 1.5));
    }
}
