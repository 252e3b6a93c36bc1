//! Compares the curves of a clip with the true curves.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use facewire_face::{BLENDSHAPES, COEFFS, Solution};

use crate::output::Table;
use crate::recording::CsvTable;
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

pub fn shut(truth: &[[f64; COEFFS]], lid: usize) -> Vec<Range<usize>> {
    runs((0..truth.len()).filter(|frame| truth[*frame][lid] > SHUT))
}

fn runs(frames: impl Iterator<Item = usize>) -> Vec<Range<usize>> {
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
