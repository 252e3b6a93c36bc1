//! The figures as a table for a terminal, the paper's beside them, and as JSON.

use std::fmt::Write as _;

use facewire::solve::BLENDSHAPES;
use serde_json::{Value, json};

use super::{
    Score,
    align::Aligned,
    score::{FIGURES, Figures, NAMES, means, of_paper},
};
use crate::paper::{AGAINST_ARKIT, AGAINST_ARKIT_AVERAGE, AGAINST_ARKIT_TITLE, AgainstArkit};

/// So many blendshapes that only one side has are named; JSON names all.
const NAMED: usize = 5;
/// Head of each column, its width and decimals.
const COLUMNS: [(&str, usize, usize); FIGURES] = [
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
];

/// The scores in the order of ARKit.
fn ordered(scores: &[Score]) -> impl Iterator<Item = &Score> + Clone {
    BLENDSHAPES.into_iter().filter_map(|name| scores.iter().find(|score| score.blendshape == name))
}

fn of_table(blendshape: &str) -> Option<&'static AgainstArkit> {
    AGAINST_ARKIT.iter().find(|row| row.blendshape == blendshape)
}

/// Everything the command prints.
pub fn text(aligned: &Aligned, scores: &[Score]) -> String {
    format!("{}\n{}{}{}\n{}", heading(aligned), head(), rows(scores), mean_rows(scores), notes(scores))
}

fn heading(aligned: &Aligned) -> String {
    let [track, truth] = aligned.steps_s.map(f64::recip);
    let late = aligned.shift_frames;
    let mut text =
        format!("{} frames; track {track:.1} Hz, truth {truth:.1} Hz; shift {late} frames\n", aligned.times_s.len());
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

fn line(name: &str, figures: &Figures, events: &str) -> String {
    let cell = |(value, (_, width, decimals)): (&Option<f64>, &(&str, usize, usize))| match value {
        Some(value) => format!(" {value:>width$.decimals$} |"),
        None => format!(" {:>width$} |", "-"),
    };
    let cells: String = figures.iter().zip(&COLUMNS).map(cell).collect();
    format!("| {name:<19} |{cells} {events:>6} |\n")
}

/// Each blendshape, and under it the paper's.
fn rows(scores: &[Score]) -> String {
    let row = |score: &Score| {
        let events = score.events.map_or_else(String::new, |events| format!("{}/{}", events.found, events.reference));
        let paper = of_table(score.blendshape).map(|row| line("  paper", &of_paper(row), ""));
        line(score.blendshape, &score.figures, &events) + &paper.unwrap_or_default()
    };
    ordered(scores).map(row).collect()
}

fn mean_rows(scores: &[Score]) -> String {
    let moving = scores.iter().filter(|score| score.moves);
    let like_paper = moving.clone().filter(|score| of_table(score.blendshape).is_some());
    let mut text = line(&format!("mean of {} moving", moving.clone().count()), &means(&moving), "");
    if like_paper.clone().next().is_some() {
        text += &line(&format!("mean of {} of paper", like_paper.clone().count()), &means(&like_paper), "");
        text += &line("  paper, mean of 15", &of_paper(&AGAINST_ARKIT_AVERAGE), "");
    }
    text
}

/// Events where the reference has none: they would otherwise show nowhere.
fn imagined(scores: &[Score]) -> usize {
    let counts = scores.iter().filter_map(|score| score.events);
    counts.filter(|events| events.reference == 0).map(|events| events.estimate).sum()
}

fn notes(scores: &[Score]) -> String {
    format!(
        "events: found/in the reference; {} more where the reference has none. jitter: RMS of frame-to-frame steps at \
         rest.\npaper: its table {AGAINST_ARKIT_TITLE}: other faces, events annotated\nby a person, curves against \
         ARKit 6.\n",
        imagined(scores)
    )
}

/// The same figures by name.
pub fn json(aligned: &Aligned, scores: &[Score]) -> Value {
    let moving = || scores.iter().filter(|score| score.moves);
    let like_paper = moving().filter(|score| of_table(score.blendshape).is_some());
    let row = |score: &Score| {
        let paper = of_table(score.blendshape).map(|row| named(&of_paper(row)));
        let own =
            json!({ "moves": score.moves, "figures": named(&score.figures), "events": score.events, "paper": paper });
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
        "mean_of_the_papers": named(&means(&like_paper)),
        "paper_mean": named(&of_paper(&AGAINST_ARKIT_AVERAGE)),
        "events_where_the_reference_has_none": imagined(scores),
    })
}

fn named(figures: &Figures) -> Value {
    NAMES.iter().zip(figures).map(|(name, value)| ((*name).to_owned(), json!(value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(blendshape: &'static str) -> Score {
        Score { blendshape, moves: true, figures: [Some(0.5); FIGURES], events: None }
    }

    #[test]
    fn every_line_of_the_table_is_as_wide_as_its_head_and_fits_115_columns() {
        let scores = [score("mouthUpperUpRight"), score("jawOpen")];
        let table = head() + &rows(&scores) + &mean_rows(&scores);
        let widths: Vec<usize> = table.lines().map(str::len).collect();
        assert!(widths.iter().all(|width| *width == widths[0] && *width <= 115), "{table}");
    }

    #[test]
    fn papers_figures_stand_under_the_blendshapes_that_it_reports() {
        let table = rows(&[score("jawOpen"), score("jawLeft")]);
        let lines: Vec<&str> = table.lines().collect();
        assert!(lines[0].contains("jawLeft") && lines[1].contains("jawOpen") && lines[2].contains("0.921"));
        assert_eq!(lines.len(), 3);
    }
}
