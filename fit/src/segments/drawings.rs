//! Charts of rankings.

use anyhow::Result;
use plotters::style::RGBColor;

use super::ranking::{NAMES, Segment};
use crate::drawing::{Axes, Axis, BLUE_INK, scatter, subsample};

/// Number of points for features that are not among the best of any ranking: enough to show their distribution.
const OTHERS: usize = 250;
/// Colour of features that are not kept.
const GREY_INK: RGBColor = RGBColor(140, 150, 165);
/// Titles of the axes for the ranks by [`NAMES`].
const RANKS: [&str; NAMES.len()] = ["rank by correlation", "rank by partial F", "rank by SVR"];

/// Plots the absolute correlation by rank. Kept features are blue, up to a vertical line.
pub fn order(segment: &Segment) -> Result<String> {
    let ranking = &segment.rankings[0];
    let point = |feature: &usize| ((ranking.ranks[*feature] as f64).log10(), ranking.scores[*feature]);
    let (kept, others) = ranking.order.split_at(segment.count);
    let [kept, others] = [kept, &subsample(others, OTHERS)].map(|some| some.iter().map(point).collect::<Vec<_>>());
    let most = tenth_above(ranking.scores[ranking.order[0]]);
    let axes =
        Axes { x: Axis::ranks(RANKS[0], ranking.ranks.len()), y: Axis::linear("absolute correlation", [0.0, most]) };
    let cut = cut(segment);
    scatter(&[(&others, GREY_INK), (&kept, BLUE_INK)], axes, &[[(cut, 0.0), (cut, most)]])
}

/// Plots the ranks by two of [`NAMES`] against each other. The lower left corner holds the best features of both.
/// Features that are kept by correlation are blue.
pub fn ranks(segment: &Segment, (x, y): (usize, usize)) -> Result<String> {
    let [a, b] = [x, y].map(|index| &segment.rankings[index]);
    let power = |rank: usize| (rank as f64).log10();
    let point = |feature: &usize| (power(a.ranks[*feature]), power(b.ranks[*feature]));
    let best = |feature: &usize| a.ranks[*feature] <= segment.count || b.ranks[*feature] <= segment.count;
    let (best, others): (Vec<usize>, Vec<usize>) =
        a.order.iter().filter(|feature| !segment.keeps(**feature)).partition(|feature| best(feature));
    let kept: Vec<_> = segment.kept().iter().map(point).collect();
    let others: Vec<_> = best.iter().chain(&subsample(&others, OTHERS)).map(point).collect();
    let last = a.ranks.len();
    let (cut, end) = (cut(segment), power(last));
    let axes = Axes { x: Axis::ranks(RANKS[x], last), y: Axis::ranks(RANKS[y], last) };
    scatter(&[(&others, GREY_INK), (&kept, BLUE_INK)], axes, &[[(cut, 0.0), (cut, end)], [(0.0, cut), (end, cut)]])
}

/// Returns the position of the line behind the last feature that is kept.
fn cut(segment: &Segment) -> f64 {
    (segment.count as f64 + 0.5).log10()
}

fn tenth_above(value: f64) -> f64 {
    ((value * 10.0).ceil() / 10.0).clamp(0.1, 1.0)
}
