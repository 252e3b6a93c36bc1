//! The true curves of a clip, and the parts of a wearer's clip.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use facewire_face::COEFFS;

use crate::recording::CsvTable;

pub const FRAME_US: u64 = 33_333;
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

    pub fn of(table: &CsvTable) -> Result<Self> {
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

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Parts(pub Vec<(String, Range<usize>)>);

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
        let parts = self.0.iter().filter(|(known, _)| names.iter().any(|name| known.starts_with(name)));
        parts.map(|(_, frames)| frames.clone())
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
