//! Annotated events: a person noted when an expression was visible, not how strong it was.

use std::{collections::BTreeMap, fs::File, path::Path};

use anyhow::{Context, Result, ensure};
use facewire::solve::BLENDSHAPES;

/// The times of the events of each annotated blendshape.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Annotations(BTreeMap<&'static str, Vec<f64>>);

impl Annotations {
    /// Reads a CSV file with the columns `blendshape` and `time_s` or `frame`.
    pub fn load(path: &Path, fps: f64) -> Result<Self> {
        let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::read(file, fps).with_context(|| format!("{}", path.display()))
    }

    fn read(input: impl std::io::Read, fps: f64) -> Result<Self> {
        let mut reader = csv::Reader::from_reader(input);
        let header = reader.headers().context("is not a CSV file")?.clone();
        let column = |name| header.iter().position(|cell| cell.trim() == name);
        let names = column("blendshape").context("has no column blendshape")?;
        let seconds = column("time_s").map(|index| (index, 1.0));
        let (times, per_second) =
            seconds.or_else(|| column("frame").map(|index| (index, fps))).context("has no column time_s or frame")?;
        let mut events: BTreeMap<_, Vec<f64>> = BTreeMap::new();
        for (row, record) in reader.records().enumerate() {
            let record = record.context("is not a CSV file")?;
            let cell = |index| record.get(index).unwrap_or_default().trim();
            let known = BLENDSHAPES.into_iter().find(|name| name.eq_ignore_ascii_case(cell(names)));
            let name = known.with_context(|| format!("line {}: `{}` is not a blendshape", row + 2, cell(names)))?;
            let time = cell(times).parse().ok().filter(|time: &f64| time.is_finite());
            let time = time.with_context(|| format!("line {}: `{}` is not a number", row + 2, cell(times)))?;
            events.entry(name).or_default().push(time / per_second);
        }
        ensure!(!events.is_empty(), "has no events");
        Ok(Self(events))
    }

    /// Returns the times of a blendshape's events in seconds, or `None` if the blendshape was not annotated.
    pub fn of(&self, blendshape: &str) -> Option<&[f64]> {
        self.0.get(blendshape).map(Vec::as_slice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Annotations> {
        Annotations::read(text.as_bytes(), 30.0)
    }

    #[test]
    fn events_may_be_given_in_seconds_or_frames() {
        let seconds = read("blendshape,time_s\njawOpen,0.5\nEyeBlinkLeft,2\njawOpen,1.5\n").unwrap();
        assert_eq!(seconds.of("jawOpen"), Some(&[0.5, 1.5][..]));
        assert_eq!(seconds.of("jawLeft"), None);
        assert_eq!(read("frame,blendshape\n15,jawOpen\n60,eyeBlinkLeft\n45,jawOpen\n").unwrap(), seconds);
    }

    #[test]
    fn errors_name_the_line() {
        let refusal = |text| format!("{:#}", read(text).unwrap_err());
        assert!(refusal("blendshape,time_s\njawOpen,1\njawOpened,2\n").contains("line 3: `jawOpened`"));
        assert!(refusal("blendshape,time_s\njawOpen,soon\n").contains("line 2: `soon`"));
        assert!(refusal("blendshape,when\njawOpen,1\n").contains("time_s or frame"));
        assert!(refusal("blendshape,time_s\n").contains("no events"));
    }
}
