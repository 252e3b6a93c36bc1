//! `facewire-fit evaluate`: compares the curves of a tracker with true curves, or with those of another tracker.

pub mod align;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use facewire_face::BLENDSHAPES;
use serde_json::{Value, json};

use self::align::{Aligned, Annotations, Pair};
use crate::output::{self, Table, number};
use crate::paper::{AGAINST_ARKIT, AGAINST_ARKIT_AVERAGE, AGAINST_ARKIT_TITLE, AgainstArkit};
use crate::recording::Recording;
use crate::statistics::{
    Event, EventCounts, EventLimits, accuracy, column_means, count_events, deviation_of_differences, events_of,
    jitter_at_rest, mse, pearson, spearman, xi,
};

const AFTER_HELP: &str = "\
Accepts the CSV of `facewire track`, recordings of Live Link Face, and any table with blendshape names in its header and
a column time_s or frame. Columns are matched by name. The truth is interpolated at the times of TRACK.
Correlations are given where the truth moves (standard deviation above 0.02), jitter where it rests.
An event is a rise of the truth to f-min after a fall below half of it, or a line of EVENTS (blendshape,time_s or
blendshape,frame, counted from the truth's first row). It is found if TRACK rises to f-min within the tolerance. Each
rise finds one event. EVENTS may also tell when an event ends (end_s or end_frame).
J is recall minus the share of false time: of the frames further than the tolerance from every event, that part in which
TRACK is at least f-min.

Examples:
  facewire track demo --out track.csv && facewire-fit evaluate track.csv truth.csv
  facewire-fit evaluate track.csv MySlate_5_iPhone.csv --shift auto --overlap --json scores.json
  facewire-fit evaluate track.csv track.csv --events seen-by-eye.csv";

#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct EvaluateArgs {
    /// The curves to judge (CSV)
    track: PathBuf,
    /// The true curves, or those of another tracker (CSV)
    truth: PathBuf,
    /// Annotated events, instead of events derived from the truth
    #[arg(long, value_name = "EVENTS.csv")]
    events: Option<PathBuf>,
    /// JSON file for all results
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Frames by which TRACK lags the truth, or `auto` for the best lag within 2 seconds
    #[arg(long, value_name = "FRAMES", default_value = "0", allow_negative_numbers = true, value_parser = parse_shift)]
    shift: Shift,
    /// Judge the overlap of two recordings of different length
    #[arg(long)]
    overlap: bool,
    /// Frame rate of tables without times
    #[arg(long, default_value_t = 30.0, value_parser = positive)]
    fps: f64,
    /// Coefficient from which on an expression counts as an event
    #[arg(long, default_value_t = 0.3, value_parser = positive)]
    f_min: f64,
    /// Largest distance in time between an event and the rise that finds it (the paper: about 15 frames)
    #[arg(long, default_value_t = 0.5, value_parser = positive)]
    tolerance_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shift {
    Frames(i32),
    Auto,
}

pub fn run(args: &EvaluateArgs) -> Result<()> {
    args.json.iter().try_for_each(|path| output::check(path))?;
    let [track, truth] = [&args.track, &args.truth].map(|path| Recording::load(path, args.fps));
    let (track, truth) = (track?, truth?);
    if !args.overlap {
        align::same_length(&track, &truth)?;
    }
    let aligned = match args.shift {
        Shift::Frames(frames) => Aligned::new(&track, &truth, frames)?,
        Shift::Auto => align::best(&track, &truth)?,
    };
    let events = args.events.as_deref().map(|path| Annotations::load(path, args.fps)).transpose()?;
    let limits = EventLimits { f_min: args.f_min, tolerance_s: args.tolerance_s };
    let scores = all(&aligned, events.as_ref(), limits);
    print!("{}", text(&aligned, &scores));
    output::write_json(args.json.as_deref(), &json(&aligned, &scores))
}

fn parse_shift(text: &str) -> Result<Shift, String> {
    let frames = || text.parse().map(Shift::Frames).map_err(|_| "not a whole number of frames or `auto`".to_owned());
    if text == "auto" { Ok(Shift::Auto) } else { frames() }
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| *number > 0.0 && number.is_finite());
    number.ok_or_else(|| "not a number above 0".to_owned())
}

// Scores each blendshape by several metrics, and averages them.

/// Name, title and decimals of the metrics, in the order of [`Score::metrics`].
pub const COLUMNS: [(&str, &str, usize); 11] = [
    ("pearson", "r", 3),
    ("spearman", "rho", 3),
    ("xi", "xi", 3),
    ("accuracy", "acc.", 3),
    ("msd", "MSD", 4),
    ("deviation", "dev.", 3),
    ("jitter_at_rest", "jitter", 4),
    ("precision", "P", 2),
    ("recall", "R", 2),
    ("f1", "F1", 2),
    ("j", "J", 2),
];

/// The place of F1 among the metrics.
pub const F1: usize = 9;

type Metrics = [Option<f64>; COLUMNS.len()];

#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    pub blendshape: &'static str,
    pub moves: bool,
    pub metrics: Metrics,
    /// The event counts, or `None` if events were annotated, but not of this blendshape.
    pub events: Option<EventCounts>,
}

pub fn all(aligned: &Aligned, annotations: Option<&Annotations>, limits: EventLimits) -> Vec<Score> {
    aligned.pairs.iter().map(|pair| one(pair, &aligned.times_s, annotations, limits)).collect()
}

fn one(pair: &Pair, times_s: &[f64], annotations: Option<&Annotations>, limits: EventLimits) -> Score {
    let (estimate, truth, moves) = (&pair.estimate, &pair.truth, pair.moves());
    let reference = match annotations {
        Some(annotations) => annotations.of_blendshape(pair.blendshape).map(<[Event]>::to_vec),
        None => Some(events_of(times_s, truth, limits.f_min)),
    };
    let events = reference.map(|events| count_events(times_s, estimate, &events, limits));
    let found = events.filter(|events| events.reference > 0);
    let [precision, recall, f1, j] = found.map_or([None; 4], |events| events.rates());
    let metrics = [
        moves.then(|| pearson(estimate, truth)),
        moves.then(|| spearman(estimate, truth)),
        moves.then(|| xi(estimate, truth)),
        Some(accuracy(estimate, truth)),
        Some(mse(estimate, truth)),
        Some(deviation_of_differences(estimate, truth)),
        jitter_at_rest(estimate, truth),
        precision,
        recall,
        f1,
        j,
    ];
    Score { blendshape: pair.blendshape, moves, metrics, events }
}

fn paper_metrics(row: &AgainstArkit) -> Metrics {
    let ([precision, recall, f1], [pearson, spearman, xi, accuracy, msd, deviation]) = (row.events, row.agreement);
    let known = [pearson, spearman, xi, accuracy, msd, deviation, f64::NAN, precision, recall, f1, f64::NAN];
    known.map(|value| (!value.is_nan()).then_some(value))
}

pub fn means<'a>(scores: impl Iterator<Item = &'a Score>) -> Metrics {
    column_means(&scores.map(|score| score.metrics).collect::<Vec<_>>())
}

/// How many of the blendshapes that only one file has are named in the text. JSON names all of them.
const NAMED: usize = 5;

fn paper_row(blendshape: &str) -> Option<&'static AgainstArkit> {
    AGAINST_ARKIT.iter().find(|row| row.blendshape == blendshape)
}

fn text(aligned: &Aligned, scores: &[Score]) -> String {
    format!("{}\n{}\n{}", heading(aligned), table(scores).text(), notes(scores))
}

fn heading(aligned: &Aligned) -> String {
    let [track, truth] = aligned.steps_s.map(f64::recip);
    let shift = aligned.shift_frames;
    let mut text =
        format!("{} frames; track {track:.1} Hz, truth {truth:.1} Hz; shift {shift} frames\n", aligned.times_s.len());
    for (side, names) in ["track", "truth"].iter().zip(&aligned.unmatched) {
        if !names.is_empty() {
            let named: Vec<&str> = names.iter().copied().take(NAMED).collect();
            let dots = if names.len() > NAMED { ", ..." } else { "" };
            text += &format!("{} only in the {side}: {}{dots}\n", names.len(), named.join(", "));
        }
    }
    text
}

fn line(name: &str, metrics: &Metrics, events: String) -> Vec<String> {
    let cells = metrics.iter().zip(&COLUMNS).map(|(value, (_, _, decimals))| number(*value, *decimals));
    [name.to_owned()].into_iter().chain(cells).chain([events]).collect()
}

/// Returns a line for each blendshape, followed by the paper's line if it reports this blendshape, and the means.
pub fn table(scores: &[Score]) -> Table {
    let row = |score: &Score| {
        let events = score.events.map_or_else(String::new, |events| format!("{}/{}", events.found, events.reference));
        let paper = paper_row(score.blendshape).map(|row| line("  paper", &paper_metrics(row), String::new()));
        [line(score.blendshape, &score.metrics, events)].into_iter().chain(paper)
    };
    let ordered = BLENDSHAPES.into_iter().filter_map(|name| scores.iter().find(|score| score.blendshape == name));
    let mut rows: Vec<_> = ordered.flat_map(row).collect();
    let moving = scores.iter().filter(|score| score.moves);
    let in_paper = moving.clone().filter(|score| paper_row(score.blendshape).is_some());
    rows.push(line(&format!("mean of {} moving", moving.clone().count()), &means(moving.clone()), String::new()));
    if in_paper.clone().next().is_some() {
        let count = in_paper.clone().count();
        rows.push(line(&format!("mean of {count} of paper"), &means(in_paper.clone()), String::new()));
        rows.push(line("  paper, mean of 15", &paper_metrics(&AGAINST_ARKIT_AVERAGE), String::new()));
    }
    let heads = ["blendshape"].into_iter().chain(COLUMNS.map(|(_, title, _)| title)).chain(["events"]);
    Table::new(heads, rows)
}

/// Counts the track's events in blendshapes without any true event, which no metric includes.
fn false_events(scores: &[Score]) -> usize {
    let counts = scores.iter().filter_map(|score| score.events);
    counts.filter(|events| events.reference == 0).map(|events| events.estimate).sum()
}

fn notes(scores: &[Score]) -> String {
    format!(
        "events: found/in the reference; {} more in blendshapes without any. jitter: RMS of frame-to-frame steps at \
         rest.\nJ: recall minus the share of the time outside of events in which the track is up.\npaper: its table {AGAINST_ARKIT_TITLE}: other faces, annotated events,\ncurves of ARKit 6 as the \
         truth.\n",
        false_events(scores)
    )
}

pub fn json(aligned: &Aligned, scores: &[Score]) -> Value {
    let moving = || scores.iter().filter(|score| score.moves);
    let in_paper = moving().filter(|score| paper_row(score.blendshape).is_some());
    let row = |score: &Score| {
        let paper = paper_row(score.blendshape).map(|row| named(&paper_metrics(row)));
        let own =
            json!({ "moves": score.moves, "figures": named(&score.metrics), "events": score.events, "paper": paper });
        (score.blendshape.to_owned(), own)
    };
    json!({
        "frames": aligned.times_s.len(),
        "shift_frames": aligned.shift_frames,
        "track_hz": aligned.steps_s[0].recip(),
        "truth_hz": aligned.steps_s[1].recip(),
        "only_in_track": aligned.unmatched[0],
        "only_in_truth": aligned.unmatched[1],
        "blendshapes": scores.iter().map(row).collect::<serde_json::Map<_, _>>(),
        "mean_of_moving": named(&means(moving())),
        "mean_of_the_papers": named(&means(in_paper)),
        "paper_mean": named(&paper_metrics(&AGAINST_ARKIT_AVERAGE)),
        "events_where_the_reference_has_none": false_events(scores),
    })
}

fn named(metrics: &Metrics) -> Value {
    COLUMNS.iter().zip(metrics).map(|((name, ..), value)| ((*name).to_owned(), json!(value))).collect()
}
