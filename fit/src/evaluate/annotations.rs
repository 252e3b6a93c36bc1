//! Annotated events: a person noted when an expression was visible, not how strong it was.

use std::{collections::BTreeMap, fs::File, path::Path};

use anyhow::{Context, Result, ensure};
use csv::StringRecord;
use facewire::solve::BLENDSHAPES;

use crate::statistics::Event;

/// The events of each annotated blendshape.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Annotations(BTreeMap<&'static str, Vec<Event>>);

/// A column of times.
#[derive(Debug, Clone, Copy)]
struct Times {
    column: usize,
    per_second: f64,
}

impl Annotations {
    /// Reads a CSV file with the columns `blendshape` and `time_s` or `frame`, and maybe `end_s` or `end_frame`.
    pub fn load(path: &Path, fps: f64) -> Result<Self> {
        let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::read(file, fps).with_context(|| format!("{}", path.display()))
    }

    fn read(input: impl std::io::Read, fps: f64) -> Result<Self> {
        let mut reader = csv::Reader::from_reader(input);
        let header = reader.headers().context("is not a CSV file")?.clone();
        let names = position(&header, "blendshape").context("has no column blendshape")?;
        let begin = Times::of(&header, ["time_s", "frame"], fps).context("has no column time_s or frame")?;
        let finish = Times::of(&header, ["end_s", "end_frame"], fps);
        let mut events: BTreeMap<_, Vec<Event>> = BTreeMap::new();
        for (line, record) in (2..).zip(reader.records()) {
            let record = record.context("is not a CSV file")?;
            let cell = record.get(names).unwrap_or_default().trim();
            let known = BLENDSHAPES.into_iter().find(|name| name.eq_ignore_ascii_case(cell));
            let name = known.with_context(|| format!("line {line}: `{cell}` is not a blendshape"))?;
            let time = |times: Times| times.seconds(&record).with_context(|| format!("line {line}"));
            let start_s = time(begin)?;
            let end_s = finish.filter(|column| !column.is_blank(&record)).map_or(Ok(start_s), time)?;
            ensure!(end_s >= start_s, "line {line}: the event ends before it begins");
            events.entry(name).or_default().push(Event { start_s, end_s });
        }
        ensure!(!events.is_empty(), "has no events");
        Ok(Self(events))
    }

    /// Returns the events of a blendshape, or `None` if the blendshape was not annotated.
    pub fn of(&self, blendshape: &str) -> Option<&[Event]> {
        self.0.get(blendshape).map(Vec::as_slice)
    }
}

fn position(header: &StringRecord, name: &str) -> Option<usize> {
    header.iter().position(|cell| cell.trim() == name)
}

impl Times {
    /// Finds a column of seconds, or else one of frames.
    fn of(header: &StringRecord, [seconds, frames]: [&str; 2], fps: f64) -> Option<Self> {
        let column = |name, per_second| position(header, name).map(|column| Self { column, per_second });
        column(seconds, 1.0).or_else(|| column(frames, fps))
    }

    fn cell(self, record: &StringRecord) -> &str {
        record.get(self.column).unwrap_or_default().trim()
    }

    fn is_blank(self, record: &StringRecord) -> bool {
        self.cell(record).is_empty()
    }

    fn seconds(self, record: &StringRecord) -> Result<f64> {
        let number = self.cell(record).parse().ok().filter(|number: &f64| number.is_finite());
        Ok(number.with_context(|| format!("`{}` is not a number", self.cell(record)))? / self.per_second)
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
        assert_eq!(seconds.of("jawOpen"), Some(&[Event::at(0.5), Event::at(1.5)][..]));
        assert_eq!(seconds.of("jawLeft"), None);
        assert_eq!(read("frame,blendshape\n15,jawOpen\n60,eyeBlinkLeft\n45,jawOpen\n").unwrap(), seconds);
    }

    #[test]
    fn an_event_may_have_an_end() {
        let events = read("blendshape,frame,end_frame\njawOpen,15,60\njawOpen,90,\n").unwrap();
        let wanted = [Event { start_s: 0.5, end_s: 2.0 }, Event::at(3.0)];
        assert_eq!(events.of("jawOpen"), Some(&wanted[..]));
    }

    #[test]
    fn errors_name_the_line() {
        let refusal = |text| format!("{:#}", read(text).unwrap_err());
        assert!(refusal("blendshape,time_s\njawOpen,1\njawOpened,2\n").contains("line 3: `jawOpened`"));
        assert!(refusal("blendshape,time_s\njawOpen,soon\n").contains("line 2: `soon`"));
        assert!(refusal("blendshape,time_s,end_s\njawOpen,2,1\n").contains("line 2: the event ends before"));
        assert!(refusal("blendshape,when\njawOpen,1\n").contains("time_s or frame"));
        assert!(refusal("blendshape,time_s\n").contains("no events"));
    }
}
