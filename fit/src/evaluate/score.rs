//! Scores each blendshape by several metrics, and averages them.

use std::fmt::Write as _;

use facewire_face::BLENDSHAPES;
use serde_json::{Value, json};

use super::align::{Aligned, Annotations, Pair};
use crate::output::{Table, number};
use crate::paper::{AGAINST_ARKIT, AGAINST_ARKIT_AVERAGE, AGAINST_ARKIT_TITLE, AgainstArkit};
use crate::statistics::{
    Event, EventCounts, EventLimits, accuracy, count_events, deviation_of_differences, events_of, jitter_at_rest, mean,
    mse, pearson, spearman, xi,
};

/// The number of metrics.
pub const METRICS: usize = 11;
/// The names of the metrics, in the order of [`Score::metrics`].
pub const NAMES: [&str; METRICS] =
    ["pearson", "spearman", "xi", "accuracy", "msd", "deviation", "jitter_at_rest", "precision", "recall", "f1", "j"];

/// Metrics in the order of [`NAMES`]. A metric that is not defined for a curve is `None`.
pub type Metrics = [Option<f64>; METRICS];

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
        Some(annotations) => annotations.of(pair.blendshape).map(<[Event]>::to_vec),
        None => Some(events_of(times_s, truth, limits.f_min)),
    };
    let events = reference.map(|events| count_events(times_s, estimate, &events, limits));
    let found = events.filter(|events| events.reference > 0);
    let metrics = [
        moves.then(|| pearson(estimate, truth)),
        moves.then(|| spearman(estimate, truth)),
        moves.then(|| xi(estimate, truth)),
        Some(accuracy(estimate, truth)),
        Some(mse(estimate, truth)),
        Some(deviation_of_differences(estimate, truth)),
        jitter_at_rest(estimate, truth),
        found.and_then(|events| events.precision()),
        found.and_then(|events| events.recall()),
        found.and_then(|events| events.f1()),
        found.and_then(|events| events.j()),
    ];
    Score { blendshape: pair.blendshape, moves, metrics, events }
}

/// Returns the paper's metrics of a blendshape. The paper reports neither jitter nor J.
fn paper_metrics(row: &AgainstArkit) -> Metrics {
    let ([precision, recall, f1], [pearson, spearman, xi, accuracy, msd, deviation]) = (row.events, row.agreement);
    let known = [pearson, spearman, xi, accuracy, msd, deviation, f64::NAN, precision, recall, f1, f64::NAN];
    known.map(|value| (!value.is_nan()).then_some(value))
}

pub fn means<'a>(scores: &(impl Iterator<Item = &'a Score> + Clone)) -> Metrics {
    core::array::from_fn(|index| {
        let values = scores.clone().filter_map(move |score| score.metrics[index]);
        values.clone().next().map(|_| mean(values))
    })
}

/// How many of the blendshapes that only one file has are named in the text. JSON names all of them.
const NAMED: usize = 5;
/// Title and decimals of each column.
const COLUMNS: [(&str, usize); METRICS] = [
    ("r", 3),
    ("rho", 3),
    ("xi", 3),
    ("acc.", 3),
    ("MSD", 4),
    ("dev.", 3),
    ("jitter", 4),
    ("P", 2),
    ("R", 2),
    ("F1", 2),
    ("J", 2),
];

fn paper_row(blendshape: &str) -> Option<&'static AgainstArkit> {
    AGAINST_ARKIT.iter().find(|row| row.blendshape == blendshape)
}

/// Returns everything that the command prints.
pub fn text(aligned: &Aligned, scores: &[Score]) -> String {
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
            let _ = writeln!(text, "{} only in the {side}: {}{dots}", names.len(), named.join(", "));
        }
    }
    text
}

fn line(name: &str, metrics: &Metrics, events: String) -> Vec<String> {
    let cells = metrics.iter().zip(&COLUMNS).map(|(value, (_, decimals))| number(*value, *decimals));
    [name.to_owned()].into_iter().chain(cells).chain([events]).collect()
}

/// Returns a line for each blendshape, followed by the paper's line if it reports this blendshape, and the means.
fn table(scores: &[Score]) -> Table {
    let row = |score: &Score| {
        let events = score.events.map_or_else(String::new, |events| format!("{}/{}", events.found, events.reference));
        let paper = paper_row(score.blendshape).map(|row| line("  paper", &paper_metrics(row), String::new()));
        [line(score.blendshape, &score.metrics, events)].into_iter().chain(paper)
    };
    let ordered = BLENDSHAPES.into_iter().filter_map(|name| scores.iter().find(|score| score.blendshape == name));
    let mut rows: Vec<_> = ordered.flat_map(row).collect();
    let moving = scores.iter().filter(|score| score.moves);
    let in_paper = moving.clone().filter(|score| paper_row(score.blendshape).is_some());
    rows.push(line(&format!("mean of {} moving", moving.clone().count()), &means(&moving), String::new()));
    if in_paper.clone().next().is_some() {
        let count = in_paper.clone().count();
        rows.push(line(&format!("mean of {count} of paper"), &means(&in_paper), String::new()));
        rows.push(line("  paper, mean of 15", &paper_metrics(&AGAINST_ARKIT_AVERAGE), String::new()));
    }
    let heads = ["blendshape"].into_iter().chain(COLUMNS.map(|(title, _)| title)).chain(["events"]);
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
        "mean_of_moving": named(&means(&moving())),
        "mean_of_the_papers": named(&means(&in_paper)),
        "paper_mean": named(&paper_metrics(&AGAINST_ARKIT_AVERAGE)),
        "events_where_the_reference_has_none": false_events(scores),
    })
}

fn named(metrics: &Metrics) -> Value {
    NAMES.iter().zip(metrics).map(|(name, value)| ((*name).to_owned(), json!(value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: EventLimits = EventLimits { f_min: 0.3, tolerance_s: 0.5 };

    fn aligned(estimate: Vec<f64>, truth: Vec<f64>) -> Aligned {
        let times_s = (0..truth.len()).map(|frame| frame as f64 / 30.0).collect();
        let pairs = vec![Pair { blendshape: "jawOpen", estimate, truth }];
        Aligned { times_s, shift_frames: 0, steps_s: [1.0 / 30.0; 2], pairs, unmatched: [vec![], vec![]] }
    }

    fn metric(score: &Score, name: &str) -> Option<f64> {
        score.metrics[NAMES.iter().position(|known| *known == name).unwrap()]
    }

    #[test]
    fn a_truth_at_rest_has_jitter_and_deviation_but_no_correlation() {
        let shaken = (0..90).map(|frame| if frame % 2 == 0 { 0.0 } else { 0.1 }).collect();
        let score = &all(&aligned(shaken, vec![0.0; 90]), None, LIMITS)[0];
        assert_eq!([metric(score, "pearson"), metric(score, "f1")], [None, None]);
        assert!((metric(score, "jitter_at_rest").unwrap() - 0.1).abs() < 1e-12);
        assert!((metric(score, "msd").unwrap() - 0.005).abs() < 1e-12);
    }

    #[test]
    fn with_annotations_only_annotated_blendshapes_have_events() {
        let curve: Vec<f64> = (0..90).map(|frame| (f64::from(frame) / 10.0).sin()).collect();
        let derived = &all(&aligned(curve.clone(), curve.clone()), None, LIMITS)[0];
        assert_eq!(metric(derived, "f1"), Some(1.0));
        let none = Annotations::default();
        assert_eq!(all(&aligned(curve.clone(), curve), Some(&none), LIMITS)[0].events, None);
    }

    #[test]
    fn means_are_over_the_blendshapes_that_have_the_metric() {
        let score = |pearson| {
            let metrics = core::array::from_fn(|index| if index == 0 { pearson } else { None });
            Score { blendshape: "jawOpen", moves: true, metrics, events: None }
        };
        let scores = [score(Some(0.5)), score(None), score(Some(1.0))];
        assert_eq!(means(&scores.iter())[..2], [Some(0.75), None]);
    }

    fn score(blendshape: &'static str) -> Score {
        Score { blendshape, moves: true, metrics: [Some(0.5); METRICS], events: None }
    }

    #[test]
    fn the_papers_line_follows_the_blendshapes_that_it_reports() {
        let table = table(&[score("jawOpen"), score("jawLeft")]).text();
        let lines: Vec<&str> = table.lines().collect();
        assert!(lines[2].contains("jawLeft") && lines[3].contains("jawOpen") && lines[4].contains("0.921"));
    }
}
