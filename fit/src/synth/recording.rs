//! Reads recordings of real ARKit coefficients (Live Link Face, CSV). Columns are matched by name.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use facewire::solve::{BLENDSHAPES, COEFFS};

use super::expression::Coefficients;

/// A recording of coefficients at 30 frames per second.
pub struct Recording {
    /// The frames, with coefficients from 0 to 1.
    pub frames: Vec<Coefficients>,
}

/// Returns the recordings of a folder in the order of their names.
pub fn in_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read the folder {}", folder.display()))?;
    let paths = entries.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    let is_table = |path: &PathBuf| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"));
    let mut recordings: Vec<PathBuf> = paths.into_iter().filter(is_table).collect();
    ensure!(!recordings.is_empty(), "{} has no recordings (CSV)", folder.display());
    recordings.sort();
    Ok(recordings)
}

impl Recording {
    /// Reads a CSV file with a header of blendshape names, in any order and case.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::parse(&text).with_context(|| format!("{} is not a recording of blendshapes", path.display()))
    }

    fn parse(text: &str) -> Result<Self> {
        let mut lines = text.lines();
        let header: Vec<&str> = lines.next().context("the table is empty")?.split(',').map(str::trim).collect();
        let column = |name: &&str| {
            header
                .iter()
                .position(|known| known.eq_ignore_ascii_case(name))
                .with_context(|| format!("no column {name}"))
        };
        let columns = BLENDSHAPES.iter().map(column).collect::<Result<Vec<_>>>()?;
        let lines = lines.enumerate().filter(|(_, line)| !line.trim().is_empty());
        let frames =
            lines.map(|(row, line)| frame(line, &columns).with_context(|| format!("line {} is damaged", row + 2)));
        let frames = frames.collect::<Result<Vec<_>>>()?;
        ensure!(!frames.is_empty(), "there are no frames");
        Ok(Self { frames })
    }
}

fn frame(line: &str, columns: &[usize]) -> Result<Coefficients> {
    let values: Vec<&str> = line.split(',').collect();
    let mut frame = [0.0; COEFFS];
    for (slot, column) in frame.iter_mut().zip(columns) {
        let text = values.get(*column).context("a line is short")?;
        let value = text.trim().parse::<f32>().ok().filter(|value| value.is_finite());
        *slot = value.with_context(|| format!("{text} is not a number"))?.clamp(0.0, 1.0);
    }
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_matched_by_name() {
        let mut names: Vec<String> = BLENDSHAPES.iter().map(|name| name[..1].to_uppercase() + &name[1..]).collect();
        names.reverse();
        let values: Vec<String> = (0..COEFFS).map(|index| format!("{:.2}", index as f32 / 100.0)).collect();
        let text = format!("Timecode,{}\n10:00,{}\n", names.join(","), values.join(","));
        let recording = Recording::parse(&text).expect("a recording");
        assert_eq!(recording.frames.len(), 1);
        assert!((recording.frames[0][0] - 0.51).abs() < 1e-6, "the first blendshape is in the last column");
        assert!(Recording::parse("Timecode,JawOpen\n1,0.5\n").is_err());
    }

    #[test]
    fn a_value_that_is_not_a_number_is_refused_with_file_and_line() {
        let folder = tempfile::tempdir().expect("a folder");
        for wrong in ["NaN", "inf", "high"] {
            let path = folder.path().join("spec.csv");
            let (good, mut bad) = (["0.5"; COEFFS], ["0.5"; COEFFS]);
            bad[7] = wrong;
            let text = [BLENDSHAPES, good, bad].map(|row| row.join(",")).join("\n");
            std::fs::write(&path, text).expect("written");
            let error = format!("{:#}", Recording::load(&path).err().expect("refused"));
            assert!(error.contains("spec.csv") && error.contains("line 3") && error.contains(wrong), "{error}");
        }
    }
}
