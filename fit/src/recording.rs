//! Reads curves of blendshapes over time from CSV.
//!
//! Columns are matched by name regardless of case and order, because Live Link Face has `JawRight` before `JawLeft`.
//! The time is the column `Timecode` (Live Link Face, `hours:minutes:seconds:frames.part`), `time_s` (`facewire
//! track`), or `frame` at a given rate. Without any of these columns, rows are assumed to follow each other at that rate. Times
//! count from the first row. Other columns are ignored.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use csv::{Reader, StringRecord};
use facewire_face::{BLENDSHAPES, COEFFS};

#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Time of each row in seconds since the first row, strictly increasing.
    pub times_s: Vec<f64>,
    /// One value per row, by name of the blendshape.
    pub curves: BTreeMap<&'static str, Vec<f64>>,
}

/// A CSV file with a header. Columns are found regardless of case. Cells that nobody asks for may hold anything.
pub struct CsvTable {
    header: StringRecord,
    pub rows: Vec<StringRecord>,
}

impl CsvTable {
    pub fn load(path: &Path) -> Result<Self> {
        let file = File::open(path).with_context(|| format!("cannot read {}", path.display()))?;
        Self::read(file).with_context(|| path.display().to_string())
    }

    pub fn read(input: impl std::io::Read) -> Result<Self> {
        let mut reader = Reader::from_reader(input);
        let header = reader.headers().context("is not a CSV file")?.clone();
        let rows = reader.records().collect::<Result<_, _>>().context("is not a CSV file")?;
        Ok(Self { header, rows })
    }

    pub fn columns<'a>(&'a self, name: &'a str) -> impl Iterator<Item = usize> + 'a {
        let cells = self.header.iter().enumerate();
        cells.filter(move |(_, cell)| cell.trim().eq_ignore_ascii_case(name)).map(|(index, _)| index)
    }

    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns(name).next()
    }

    pub fn cell(&self, row: usize, column: usize) -> &str {
        self.rows[row].get(column).unwrap_or_default().trim()
    }

    pub fn number(&self, row: usize, column: usize) -> Result<f64> {
        let (cell, name) = (self.cell(row, column), &self.header[column]);
        let value = cell.parse().ok().filter(|value: &f64| value.is_finite());
        value.with_context(|| format!("line {}, column {name}: `{cell}` is not a number", row + 2))
    }

    pub fn numbers(&self, name: &str) -> Result<Vec<f64>> {
        let column = self.column(name).with_context(|| format!("no column {name}"))?;
        (0..self.rows.len()).map(|row| self.number(row, column)).collect()
    }

    /// Returns the coefficients of every row. All blendshapes must have a column.
    pub fn coefficients(&self) -> Result<Vec<[f64; COEFFS]>> {
        let curves = BLENDSHAPES.iter().map(|name| self.numbers(name)).collect::<Result<Vec<_>>>()?;
        Ok((0..self.rows.len()).map(|row| core::array::from_fn(|shape| curves[shape][row])).collect())
    }
}

impl Recording {
    pub fn load(path: &Path, fps: f64) -> Result<Self> {
        Self::of(&CsvTable::load(path)?, fps).with_context(|| path.display().to_string())
    }

    pub fn of(table: &CsvTable, fps: f64) -> Result<Self> {
        let mut columns = Vec::new();
        for name in BLENDSHAPES {
            let count = table.columns(name).count();
            ensure!(count <= 1, "has {count} columns called {name}");
            columns.extend(table.column(name).map(|column| (name, column)));
        }
        let begin: Vec<&str> = table.header.iter().take(4).collect();
        ensure!(!columns.is_empty(), "has no column of a blendshape: its first line begins with `{}`", begin.join(","));
        let rows = table.rows.len();
        ensure!(rows >= 2, "has {rows} rows of coefficients, but at least 2 are needed");
        let times = times_s(table, fps)?;
        let kept = increasing(&times)?;
        let curve = |(name, column)| {
            let values = kept.iter().map(|row| table.number(*row, column)).collect::<Result<_>>();
            Ok((name, values?))
        };
        let curves = columns.into_iter().map(curve).collect::<Result<_>>()?;
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

    /// Interpolates a blendshape linearly. Returns `None` outside of the recorded times and for an unrecorded one.
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

pub fn times_s(table: &CsvTable, fps: f64) -> Result<Vec<f64>> {
    if let Some(column) = table.column("timecode") {
        return timecode_seconds((0..table.rows.len()).map(|row| table.cell(row, column)));
    }
    if table.column("time_s").is_some() {
        return table.numbers("time_s");
    }
    let rows = (0..table.rows.len()).map(|row| row as f64);
    let frames = if table.column("frame").is_some() { table.numbers("frame")? } else { rows.collect() };
    Ok(frames.into_iter().map(|frame| frame / fps).collect())
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

/// Frame rates of timecodes. The rate may be higher than that of the recording, such as 60 for a recording at 30 Hz.
const RATES: [f64; 5] = [24.0, 25.0, 30.0, 50.0, 60.0];
/// The application's default, for recordings that are too short to contain every frame number.
const DEFAULT_RATE: f64 = 60.0;
const SHOWS_RATE_S: f64 = 2.0;
const DAY_S: f64 = 86_400.0;

pub type Timecode = (f64, f64);

/// Converts timecodes to seconds since the first midnight, at the lowest usual rate that has all frame numbers.
pub fn timecode_seconds<'a>(codes: impl Iterator<Item = &'a str>) -> Result<Vec<f64>> {
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
