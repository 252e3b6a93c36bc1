//! Aligns two recordings in time: the truth is interpolated at the times of the track.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use facewire_face::BLENDSHAPES;

use crate::curves::MOVING;
use crate::recording::{CsvTable, Recording};
use crate::statistics::{Event, mean, pearson, standard_deviation};

/// Tolerance at the ends of a recording, because files round their times.
const SLACK_S: f64 = 0.001;
/// Recordings count as different in length if they differ by more than this many frames.
const LENGTH_FRAMES: f64 = 1.5;
const SEARCH_S: f64 = 2.0;
const LEAST_ROWS: usize = 10;

#[derive(Debug, Clone, PartialEq)]
pub struct Pair {
    pub blendshape: &'static str,
    pub estimate: Vec<f64>,
    pub truth: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Aligned {
    /// Seconds since the truth's first row.
    pub times_s: Vec<f64>,
    pub shift_frames: i32,
    /// Seconds per frame of the track, and of the truth.
    pub steps_s: [f64; 2],
    pub pairs: Vec<Pair>,
    pub unmatched: [Vec<&'static str>; 2],
}

pub fn same_length(track: &Recording, truth: &Recording) -> Result<()> {
    let (a, b) = (track.length_s(), truth.length_s());
    ensure!(
        (a - b).abs() <= LENGTH_FRAMES * track.step_s().max(truth.step_s()),
        "the track lasts {a:.2} s, but the truth {b:.2} s: cut them to the same frames, state their rate with --fps, \
         or judge their overlap with --overlap"
    );
    Ok(())
}

impl Aligned {
    pub fn new(track: &Recording, truth: &Recording, shift_frames: i32) -> Result<Self> {
        let unmatched = [(track, truth), (truth, track)].map(|(one, other)| {
            let alone = |name: &&&'static str| !other.curves.contains_key(**name);
            one.curves.keys().filter(alone).copied().collect()
        });
        let lag_s = f64::from(shift_frames) * track.step_s();
        let inside = |time: &f64| (-SLACK_S..=truth.length_s() + SLACK_S).contains(time);
        let times = track.times_s.iter().map(|time| time - lag_s).enumerate().filter(|(_, time)| inside(time));
        let (rows, times_s): (Vec<usize>, Vec<f64>) = times.unzip();
        ensure!(rows.len() >= LEAST_ROWS, "the files overlap in {} frames, but {LEAST_ROWS} are needed", rows.len());
        let pair = |(name, curve): (&&'static str, &Vec<f64>)| {
            let at = |time: &f64| truth.at(name, time.clamp(0.0, truth.length_s()));
            let truth: Vec<f64> = times_s.iter().filter_map(at).collect();
            let estimate = rows.iter().map(|row| curve[*row]).collect();
            (truth.len() == rows.len()).then_some(Pair { blendshape: name, estimate, truth })
        };
        let pairs: Vec<Pair> = track.curves.iter().filter_map(pair).collect();
        ensure!(!pairs.is_empty(), "the two files have no blendshape in common");
        let steps_s = [track.step_s(), truth.step_s()];
        Ok(Self { times_s, shift_frames, steps_s, pairs, unmatched })
    }

    pub fn mean_correlation(&self) -> f64 {
        let moving = self.pairs.iter().filter(|pair| pair.moves());
        mean(moving.map(|pair| pearson(&pair.estimate, &pair.truth)))
    }
}

impl Pair {
    pub fn moves(&self) -> bool {
        standard_deviation(&self.truth) > MOVING
    }
}

/// Aligns two recordings with the best-correlating shift within [`SEARCH_S`] that keeps at least half of their overlap.
pub fn best(track: &Recording, truth: &Recording) -> Result<Aligned> {
    let whole = Aligned::new(track, truth, 0)?;
    let reach = (SEARCH_S / track.step_s()).ceil() as i32;
    let least_rows = whole.times_s.len() / 2;
    let shifted = (-reach..=reach).filter_map(|shift| Aligned::new(track, truth, shift).ok());
    let long_enough = shifted.filter(|aligned| aligned.times_s.len() >= least_rows);
    let correlation = Aligned::mean_correlation;
    Ok(long_enough.fold(whole, |best, next| if correlation(&next) > correlation(&best) { next } else { best }))
}

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Annotations(pub BTreeMap<&'static str, Vec<Event>>);

impl Annotations {
    /// Reads a CSV file with the columns `blendshape` and `time_s` or `frame`, and maybe `end_s` or `end_frame`.
    pub fn load(path: &Path, fps: f64) -> Result<Self> {
        Self::of(&CsvTable::load(path)?, fps).with_context(|| path.display().to_string())
    }

    pub fn of(table: &CsvTable, fps: f64) -> Result<Self> {
        let names = table.column("blendshape").context("has no column blendshape")?;
        let times = |seconds: &str, frames: &str| {
            let column = table.column(seconds).map(|column| (column, 1.0));
            column.or_else(|| table.column(frames).map(|column| (column, fps)))
        };
        let begin = times("time_s", "frame").context("has no column time_s or frame")?;
        let finish = times("end_s", "end_frame");
        let mut events: BTreeMap<_, Vec<Event>> = BTreeMap::new();
        for row in 0..table.rows.len() {
            let cell = table.cell(row, names);
            let known = BLENDSHAPES.into_iter().find(|name| name.eq_ignore_ascii_case(cell));
            let name = known.with_context(|| format!("line {}: `{cell}` is not a blendshape", row + 2))?;
            let time_s = |(column, per_second)| Ok::<_, anyhow::Error>(table.number(row, column)? / per_second);
            let start_s = time_s(begin)?;
            let end_s = finish.filter(|end| !table.cell(row, end.0).is_empty()).map_or(Ok(start_s), time_s)?;
            ensure!(end_s >= start_s, "line {}: the event ends before it begins", row + 2);
            events.entry(name).or_default().push(Event { start_s, end_s });
        }
        ensure!(!events.is_empty(), "has no events");
        Ok(Self(events))
    }

    /// Returns the events of a blendshape, or `None` if the blendshape was not annotated.
    pub fn of_blendshape(&self, blendshape: &str) -> Option<&[Event]> {
        self.0.get(blendshape).map(Vec::as_slice)
    }
}
