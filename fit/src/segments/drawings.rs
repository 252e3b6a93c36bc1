//! Drawings of rankings.

use anyhow::Result;
use plotters::style::RGBColor;

use super::ranking::{NAMES, Segment};
use crate::drawing::{Axes, Axis, BLUE_INK, clouds, evenly};

/// Points of the features that no ranking has among its best: enough to see how they lie.
const OTHERS: usize = 250;
/// Features that are not kept.
const GREY_INK: RGBColor = RGBColor(140, 150, 165);
/// What the axes say of the ranks by [`NAMES`].
const RANKS: [&str; NAMES.len()] = ["rank by correlation", "rank by partial F", "rank by SVR"];

/// Size of the correlation, by its rank: kept features blue, up to a line.
pub fn order(segment: &Segment) -> Result<String> {
    let ranking = &segment.rankings[0];
    let place = |feature: &usize| ((ranking.ranks[*feature] as f64).log10(), ranking.scores[*feature]);
    let (kept, others) = ranking.order.split_at(segment.count);
    let [kept, others] = [kept, &evenly(others, OTHERS)].map(|some| some.iter().map(place).collect::<Vec<_>>());
    let most = tenth_above(ranking.scores[ranking.order[0]]);
    let axes =
        Axes { x: Axis::ranks(RANKS[0], ranking.ranks.len()), y: Axis::linear("size of the correlation", [0.0, most]) };
    let cut = cut(segment);
    clouds(&[(&others, GREY_INK), (&kept, BLUE_INK)], axes, &[[(cut, 0.0), (cut, most)]])
}

/// Ranks by two of [`NAMES`]. The lower left corner holds what both keep; features that are kept by correlation are blue.
pub fn ranks(segment: &Segment, (x, y): (usize, usize)) -> Result<String> {
    let [a, b] = [x, y].map(|index| &segment.rankings[index]);
    let power = |rank: usize| (rank as f64).log10();
    let place = |feature: &usize| (power(a.ranks[*feature]), power(b.ranks[*feature]));
    let best = |feature: &usize| a.ranks[*feature] <= segment.count || b.ranks[*feature] <= segment.count;
    let (best, others): (Vec<usize>, Vec<usize>) =
        a.order.iter().filter(|feature| !segment.keeps(**feature)).partition(|feature| best(feature));
    let kept: Vec<_> = segment.kept().iter().map(place).collect();
    let others: Vec<_> = best.iter().chain(&evenly(&others, OTHERS)).map(place).collect();
    let last = a.ranks.len();
    let (cut, end) = (cut(segment), power(last));
    let axes = Axes { x: Axis::ranks(RANKS[x], last), y: Axis::ranks(RANKS[y], last) };
    clouds(&[(&others, GREY_INK), (&kept, BLUE_INK)], axes, &[[(cut, 0.0), (cut, end)], [(0.0, cut), (end, cut)]])
}

/// Half a rank behind the last that is kept.
fn cut(segment: &Segment) -> f64 {
    (segment.count as f64 + 0.5).log10()
}

fn tenth_above(value: f64) -> f64 {
    ((value * 10.0).ceil() / 10.0).clamp(0.1, 1.0)
}
