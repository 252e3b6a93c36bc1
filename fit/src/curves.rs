//! Compares the curves of a clip with the true curves.

use std::fmt::Write;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use facewire_face::{BLENDSHAPES, COEFFS, Solution};

use crate::statistics::{mean, pearson, standard_deviation};

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
    /// Reads a CSV file with a header: `yaw_deg,pitch_deg,roll_deg` (pitch positive when nodding down) and the
    /// blendshapes.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&text).with_context(|| format!("{} is not a table of true curves", path.display()))
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
    let angles = |frame: &Solution| frame.head.yaw_pitch_roll_deg().map(f64::from);
    let pairs = || solved.iter().map(angles).zip(&truth.pose_deg);
    core::array::from_fn(|axis| mean(pairs().map(|(angles, truth)| (angles[axis] - truth[axis]).abs())))
}

/// Names of the parts with their frames, in order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Parts(Vec<(String, Range<usize>)>);

impl Parts {
    /// Reads a table of name, first frame and number of frames.
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

pub fn runs(frames: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for frame in frames {
        match runs.last_mut() {
            Some(run) if run.end == frame => run.end += 1,
            _ => runs.push(frame..frame + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use facewire_face::Model;

    use crate::clip::tests::test_clip;
    use crate::clip::{FRAME_US, solve};
    use crate::reference;

    use super::*;

    /// Solves the built-in clip from MediaPipe's landmarks of every 8th frame, and returns the truth of these frames.
    fn demo(neutral: Option<core::ops::Range<usize>>) -> (Vec<Solution>, Truth) {
        let truth = Truth::load(Path::new(reference::DEMO_TRUTH)).expect("the truth");
        let pose_deg = truth.pose_deg.into_iter().step_by(8).collect();
        let truth = Truth { pose_deg, coefficients: truth.coefficients.into_iter().step_by(8).collect() };
        let solved = solve(&Model::embedded(), &test_clip(), neutral, 8 * FRAME_US).expect("every frame");
        (solved, truth)
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
        let (solved, truth) = demo(None);
        for (name, least) in [("jawOpen", 0.9), ("eyeBlinkLeft", 0.8), ("eyeBlinkRight", 0.8)] {
            let index = index_of(name);
            let true_curve: Vec<f64> = truth.coefficients.iter().map(|frame| frame[index]).collect();
            let (r, _) = lagged_r(&curve(&solved, index), &true_curve);
            assert!(r > least, "{name}: {r}");
        }
    }

    #[test]
    fn closed_eyes_read_above_0_8_and_open_ones_below_0_1() {
        let (solved, _) = demo(Some(0..1));
        for name in ["eyeBlinkLeft", "eyeBlinkRight"] {
            let curve = curve(&solved, index_of(name));
            assert!(curve.iter().any(|value| *value > 0.8), "{name}");
            assert!(curve.iter().take(3).all(|value| *value < 0.1), "{name}");
        }
    }

    #[test]
    fn head_pose_error_is_below_1_5_degrees_on_average() {
        let (solved, truth) = demo(None);
        assert!(pose_error_deg(&truth, &solved).iter().all(|error| *error < 1.5));
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
