//! Reads curves of blendshapes over time from CSV.
//!
//! Columns are matched by name regardless of case and order, because Live Link Face has `JawRight` before `JawLeft`.
//! The time is the column `Timecode` (Live Link Face, `hours:minutes:seconds:frames.part`), `time_s` (`facewire
//! track`), or
//! `frame` at a given rate. Without any of these columns, rows are assumed to follow each other at that rate. Times
//! count from the first row. Other columns are ignored.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use csv::{Reader, StringRecord};
use facewire_face::BLENDSHAPES;

#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Time of each row in seconds since the first row, strictly increasing.
    pub times_s: Vec<f64>,
    /// One value per row, by name of the blendshape.
    pub curves: BTreeMap<&'static str, Vec<f64>>,
}

/// The source of a row's time, with the index of its column.
#[derive(Debug, Clone, Copy)]
enum Clock {
    Timecode(usize),
    Seconds(usize),
    Frame(usize),
    Rows,
}

impl Recording {
    /// Reads a file. `fps` is the rate of files without times.
    pub fn load(path: &Path, fps: f64) -> Result<Self> {
        let named = || format!("{}", path.display());
        let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::read(file, fps).with_context(named)
    }

    pub fn read(input: impl std::io::Read, fps: f64) -> Result<Self> {
        let mut reader = Reader::from_reader(input);
        let header = reader.headers().context("is not a CSV file")?.clone();
        let columns = blendshape_columns(&header)?;
        let clock = Clock::of(&header);
        let rows = reader.records().collect::<Result<Vec<_>, _>>().context("is not a CSV file")?;
        ensure!(rows.len() >= 2, "has {} rows of coefficients, but at least 2 are needed", rows.len());
        let times = clock.times_s(&rows, fps)?;
        let kept = increasing(&times)?;
        let mut curves = BTreeMap::new();
        for (name, column) in columns {
            let values = kept.iter().map(|row| number(&rows[*row], *row, column, name));
            curves.insert(name, values.collect::<Result<Vec<_>>>()?);
        }
        Ok(Self { times_s: kept.iter().map(|row| times[*row] - times[0]).collect(), curves })
    }

    pub fn length_s(&self) -> f64 {
        self.times_s.last().copied().unwrap_or(0.0)
    }

    /// Returns the seconds from row to row: the median, which gaps do not affect.
    pub fn step_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or(0.0)
    }

    /// Interpolates a blendshape linearly at a time between the first and the last row. Returns `None` outside of that
    /// range, and for a blendshape that was not recorded.
    pub fn at(&self, blendshape: &str, time_s: f64) -> Option<f64> {
        let curve = self.curves.get(blendshape)?;
        let next = self.times_s.partition_point(|time| *time < time_s);
        let (after, value) = (*self.times_s.get(next)?, *curve.get(next)?);
        if next == 0 {
            return (time_s >= after).then_some(value);
        }
        let (before, start) = (self.times_s[next - 1], curve[next - 1]);
        Some(start + (value - start) * (time_s - before) / (after - before))
    }
}

fn blendshape_columns(header: &StringRecord) -> Result<Vec<(&'static str, usize)>> {
    let mut found = Vec::new();
    for name in BLENDSHAPES {
        let columns: Vec<usize> = columns(header, name).collect();
        ensure!(columns.len() <= 1, "has {} columns called {name}", columns.len());
        found.extend(columns.first().map(|column| (name, *column)));
    }
    let begin: Vec<&str> = header.iter().take(4).collect();
    ensure!(!found.is_empty(), "has no column of a blendshape: its first line begins with `{}`", begin.join(","));
    Ok(found)
}

fn columns<'a>(header: &'a StringRecord, name: &'a str) -> impl Iterator<Item = usize> + 'a {
    header.iter().enumerate().filter(move |(_, cell)| cell.trim().eq_ignore_ascii_case(name)).map(|(index, _)| index)
}

impl Clock {
    fn of(header: &StringRecord) -> Self {
        let column = |name| columns(header, name).next();
        let timecode = column("timecode").map(Self::Timecode);
        let seconds = || column("time_s").map(Self::Seconds);
        timecode.or_else(seconds).or_else(|| column("frame").map(Self::Frame)).unwrap_or(Self::Rows)
    }

    fn times_s(self, rows: &[StringRecord], fps: f64) -> Result<Vec<f64>> {
        let numbers = |column, name| rows.iter().zip(0..).map(move |(record, row)| number(record, row, column, name));
        match self {
            Self::Timecode(column) => timecode_seconds(rows.iter().map(|row| row.get(column).unwrap_or_default())),
            Self::Seconds(column) => numbers(column, "time_s").collect(),
            Self::Frame(column) => numbers(column, "frame").map(|frame| Ok(frame? / fps)).collect(),
            Self::Rows => Ok((0..rows.len()).map(|row| row as f64 / fps).collect()),
        }
    }
}

/// Returns the rows that are later than the previous row. Recordings repeat a time if a frame was late.
fn increasing(times: &[f64]) -> Result<Vec<usize>> {
    let mut kept = vec![0];
    for (row, pair) in (1..).zip(times.windows(2)) {
        if pair[1] < pair[0] {
            bail!("line {}: the time goes back from {:.3} to {:.3} s", row + 2, pair[0], pair[1]);
        }
        if pair[1] > pair[0] {
            kept.push(row);
        }
    }
    ensure!(kept.len() >= 2, "all rows have the same time");
    Ok(kept)
}

fn number(record: &StringRecord, row: usize, column: usize, name: &str) -> Result<f64> {
    let cell = record.get(column).unwrap_or_default().trim();
    let value = cell.parse().ok().filter(|value: &f64| value.is_finite());
    value.with_context(|| format!("line {}, column {name}: `{cell}` is not a number", row + 2))
}

/// Frame rates of timecodes. The rate may be higher than that of the recording, such as 60 for a recording at 30 Hz.
const RATES: [f64; 5] = [24.0, 25.0, 30.0, 50.0, 60.0];
/// The application's default, for recordings that are too short to contain every frame number.
const DEFAULT_RATE: f64 = 60.0;
/// Length of a recording in seconds that contains every frame number.
const SHOWS_RATE_S: f64 = 2.0;
const DAY_S: f64 = 86_400.0;

/// A timecode: whole seconds since midnight, and frames.
type Timecode = (f64, f64);

/// Converts timecodes to seconds since the midnight before the first of them. The recording may pass midnight. The rate
/// is assumed to be the lowest usual rate at which the highest frame number occurs.
fn timecode_seconds<'a>(codes: impl Iterator<Item = &'a str>) -> Result<Vec<f64>> {
    let one = |(row, code): (usize, &str)| {
        parse(code).with_context(|| format!("line {}: `{code}` is not a timecode hh:mm:ss:ff.fff", row + 2))
    };
    let codes = codes.enumerate().map(one).collect::<Result<Vec<_>>>()?;
    let rate = rate(&codes)?;
    let mut days = 0.0;
    let mut before = 0.0;
    let unwrap = |(seconds, frames): &Timecode| {
        let time = seconds + frames / rate;
        days += if before - time > DAY_S / 2.0 { DAY_S } else { 0.0 };
        before = time;
        time + days
    };
    Ok(codes.iter().map(unwrap).collect())
}

fn parse(code: &str) -> Option<Timecode> {
    let parts: Vec<f64> = code.trim().split(':').map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let [hours, minutes, seconds, frames] = parts[..] else { return None };
    let valid = parts.iter().all(|part| *part >= 0.0) && hours < 24.0 && minutes < 60.0 && seconds < 60.0;
    valid.then_some((hours * 3600.0 + minutes * 60.0 + seconds, frames))
}

fn rate(codes: &[Timecode]) -> Result<f64> {
    let highest = codes.iter().map(|(_, frames)| frames.floor()).fold(0.0, f64::max);
    let lowest = RATES.into_iter().find(|rate| highest < *rate);
    let lowest = lowest.with_context(|| format!("a timecode has frame {highest}, but rates end at 60 a second"))?;
    ensure!(!codes.is_empty(), "there is no timecode");
    let shown = codes.iter().any(|(seconds, _)| (seconds - codes[0].0).abs() > SHOWS_RATE_S);
    Ok(if shown { lowest } else { DEFAULT_RATE })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Recording> {
        Recording::read(text.as_bytes(), 30.0)
    }

    fn refusal(text: &str) -> String {
        format!("{:#}", read(text).unwrap_err())
    }

    #[test]
    fn columns_are_found_by_name_in_any_order_and_case() {
        let track = read("frame,time_s,state,jawLeft,jawRight\n0,0.0,live,0.1,0.2\n1,0.5,live,0.3,0.4\n").unwrap();
        let live_link = read(
            "Timecode,BlendShapeCount,JawRight,JawLeft,HeadYaw\n01:00:00:00.0,61,0.2,0.1,0\n01:00:00:30.0,61,0.4,0.3,0\n",
        );
        assert_eq!(track.curves["jawLeft"], [0.1, 0.3]);
        assert_eq!(live_link.unwrap(), track);
    }

    #[test]
    fn files_without_times_use_the_given_rate() {
        assert_eq!(read("frame,jawOpen\n5,0\n8,1\n").unwrap().times_s, [0.0, 3.0 / 30.0]);
        assert_eq!(read("jawOpen\n0\n1\n").unwrap().times_s, [0.0, 1.0 / 30.0]);
    }

    #[test]
    fn values_between_rows_are_interpolated_and_there_are_none_outside() {
        let recording = read("time_s,jawOpen\n2.0,0.0\n3.0,0.5\n4.0,0.1\n").unwrap();
        let values = [0.0, 0.5, 1.5, 2.0].map(|time| recording.at("jawOpen", time).unwrap());
        let wanted = [0.0, 0.25, 0.3, 0.1];
        assert!(values.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-12), "{values:?}");
        assert_eq!([-0.1, 2.1].map(|time| recording.at("jawOpen", time)), [None, None]);
        assert_eq!(recording.at("jawLeft", 1.0), None);
    }

    #[test]
    fn a_row_that_repeats_the_previous_time_is_left_out() {
        let recording = read("time_s,jawOpen\n0,0.1\n1,0.2\n1,0.9\n2,0.3\n").unwrap();
        assert_eq!(recording.curves["jawOpen"], [0.1, 0.2, 0.3]);
    }

    #[test]
    fn errors_name_line_and_column() {
        assert!(refusal("time,x\n1,2\n").contains("no column of a blendshape: its first line begins with `time,x`"));
        assert!(refusal("jawOpen,JawOpen\n1,2\n").contains("2 columns called jawOpen"));
        assert!(refusal("time_s,jawOpen\n0,0\n1,high\n").contains("line 3, column jawOpen: `high`"));
        assert!(refusal("time_s,jawOpen\n0,0\n1,NaN\n").contains("line 3"));
        assert!(refusal("time_s,jawOpen\n1,0\n0,0\n").contains("line 3: the time goes back"));
        assert!(refusal("jawOpen\n0.5\n").contains("1 rows"));
        assert!(refusal("jawOpen,jawLeft\n0.5,0.5\n0.5\n").contains("is not a CSV file"));
    }

    #[test]
    fn the_rate_follows_from_the_highest_frame_number() {
        let last = |highest| timecode_seconds(["00:00:00:00.0", highest, "00:00:03:15.0"].into_iter()).unwrap()[2];
        assert!((last("00:00:01:29.0") - 3.5).abs() < 1e-9);
        assert!((last("00:00:01:58.0") - 3.25).abs() < 1e-9);
    }

    #[test]
    fn a_short_recording_is_assumed_to_count_60_frames_a_second() {
        assert_eq!(timecode_seconds(["00:00:01:00.0", "00:00:01:15.0"].into_iter()).unwrap(), [1.0, 1.25]);
    }

    #[test]
    fn a_recording_may_pass_midnight() {
        let times = timecode_seconds(["23:59:59:30.0", "00:00:00:30.0"].into_iter()).unwrap();
        assert!((times[1] - times[0] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn an_invalid_timecode_is_refused_with_its_line() {
        for wrong in ["12:00", "1.5", "a:b:c:d", "25:00:00:00", "00:00:00:-1"] {
            let refusal = timecode_seconds(["00:00:00:00.0", wrong].into_iter()).unwrap_err();
            assert!(format!("{refusal:#}").contains("line 3"), "{wrong}");
        }
        assert!(timecode_seconds(["00:00:00:61.0"].into_iter()).is_err());
    }
}
