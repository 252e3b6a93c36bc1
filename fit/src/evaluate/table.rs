//! The scores as a table beside the paper's, and as JSON.

use std::fmt::Write as _;

use facewire::solve::BLENDSHAPES;
use serde_json::{Value, json};

use super::{
    Score,
    align::Aligned,
    score::{METRICS, Metrics, NAMES, means, paper_metrics},
};
use crate::paper::{AGAINST_ARKIT, AGAINST_ARKIT_AVERAGE, AGAINST_ARKIT_TITLE, AgainstArkit};

/// How many of the blendshapes that only one file has are named in the text. JSON names all of them.
const NAMED: usize = 5;
/// Title, width and decimals of each column.
const COLUMNS: [(&str, usize, usize); METRICS] = [
    ("r", 6, 3),
    ("rho", 6, 3),
    ("xi", 6, 3),
    ("acc.", 5, 3),
    ("MSD", 6, 4),
    ("dev.", 5, 3),
    ("jitter", 6, 4),
    ("P", 4, 2),
    ("R", 4, 2),
    ("F1", 4, 2),
    ("J", 5, 2),
];

/// Returns the scores in ARKit's order.
fn ordered(scores: &[Score]) -> impl Iterator<Item = &Score> + Clone {
    BLENDSHAPES.into_iter().filter_map(|name| scores.iter().find(|score| score.blendshape == name))
}

fn paper_row(blendshape: &str) -> Option<&'static AgainstArkit> {
    AGAINST_ARKIT.iter().find(|row| row.blendshape == blendshape)
}

/// Returns everything that the command prints.
pub fn text(aligned: &Aligned, scores: &[Score]) -> String {
    format!("{}\n{}{}{}\n{}", heading(aligned), head(), rows(scores), mean_rows(scores), notes(scores))
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

fn head() -> String {
    let names = COLUMNS.map(|(name, width, _)| format!(" {name:>width$} |")).concat();
    let rules = COLUMNS.map(|(_, width, _)| format!("{}:|", "-".repeat(width + 1))).concat();
    format!("| {:<19} |{names} events |\n|{}|{rules}-------:|\n", "blendshape", "-".repeat(21))
}

fn line(name: &str, metrics: &Metrics, events: &str) -> String {
    let cell = |(value, (_, width, decimals)): (&Option<f64>, &(&str, usize, usize))| match value {
        Some(value) => format!(" {value:>width$.decimals$} |"),
        None => format!(" {:>width$} |", "-"),
    };
    let cells: String = metrics.iter().zip(&COLUMNS).map(cell).collect();
    format!("| {name:<19} |{cells} {events:>6} |\n")
}

/// Returns a line for each blendshape, followed by the paper's line if it reports this blendshape.
fn rows(scores: &[Score]) -> String {
    let row = |score: &Score| {
        let events = score.events.map_or_else(String::new, |events| format!("{}/{}", events.found, events.reference));
        let paper = paper_row(score.blendshape).map(|row| line("  paper", &paper_metrics(row), ""));
        line(score.blendshape, &score.metrics, &events) + &paper.unwrap_or_default()
    };
    ordered(scores).map(row).collect()
}

fn mean_rows(scores: &[Score]) -> String {
    let moving = scores.iter().filter(|score| score.moves);
    let in_paper = moving.clone().filter(|score| paper_row(score.blendshape).is_some());
    let mut text = line(&format!("mean of {} moving", moving.clone().count()), &means(&moving), "");
    if in_paper.clone().next().is_some() {
        text += &line(&format!("mean of {} of paper", in_paper.clone().count()), &means(&in_paper), "");
        text += &line("  paper, mean of 15", &paper_metrics(&AGAINST_ARKIT_AVERAGE), "");
    }
    text
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

/// Returns the same scores as JSON, by name.
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

    fn score(blendshape: &'static str) -> Score {
        Score { blendshape, moves: true, metrics: [Some(0.5); METRICS], events: None }
    }

    #[test]
    fn every_line_is_as_wide_as_the_header_and_fits_122_columns() {
        let scores = [score("mouthUpperUpRight"), score("jawOpen")];
        let table = head() + &rows(&scores) + &mean_rows(&scores);
        let widths: Vec<usize> = table.lines().map(str::len).collect();
        assert!(widths.iter().all(|width| *width == widths[0] && *width <= 122), "{table}");
    }

    #[test]
    fn the_papers_line_follows_the_blendshapes_that_it_reports() {
        let table = rows(&[score("jawOpen"), score("jawLeft")]);
        let lines: Vec<&str> = table.lines().collect();
        assert!(lines[0].contains("jawLeft") && lines[1].contains("jawOpen") && lines[2].contains("0.921"));
        assert_eq!(lines.len(), 3);
    }
}
