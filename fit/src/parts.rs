//! The parts of a clip of a wearer, as `facewire-fit film --script wearer` writes them beside it.

use std::{ops::Range, path::Path};

use anyhow::{Context, Result, ensure};

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

    /// Returns the frames of a part, none if there is no such part.
    pub fn of(&self, name: &str) -> Range<usize> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, frames)| frames.clone()).unwrap_or_default()
    }

    /// Returns the frames of the parts whose names begin with one of these.
    pub fn starting_with(&self, names: &[&str]) -> impl Iterator<Item = Range<usize>> {
        self.0
            .iter()
            .filter(|(known, _)| names.iter().any(|name| known.starts_with(name)))
            .map(|(_, frames)| frames.clone())
    }
}

/// Joins frames that follow each other.
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
    use super::*;

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
