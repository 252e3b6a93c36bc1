//! A figure of both models side by side, with the difference and a drawing of its interval.

use maud::{Markup, html};

use super::Pair;
use crate::{
    judge::{
        people::Phase,
        sheet::{Figure, Row},
        text::number,
    },
    statistics::Interval,
};

/// Width of a drawn interval, and distance of its ends from the edges.
const BAR_PX: f64 = 80.0;
const MARGIN_PX: f64 = 6.0;

/// A figure that both models have.
pub struct Place<'a> {
    pub pair: &'a Pair<'a>,
    pub row: Row,
    pub phase: Phase,
    pub figure: Figure,
}

impl Place<'_> {
    fn compare(&self) -> Comparison {
        let Pair { model, other, .. } = self.pair;
        let (difference, interval) = model.difference(other, self.row, self.phase, self.figure);
        let is_better = (difference > 0.0) == (self.figure == Figure::R);
        let verdict = match (interval.excludes_zero(), is_better) {
            (false, _) => "",
            (true, true) => "better",
            (true, false) => "worse",
        };
        let values = [model, other].map(|judgement| judgement.sheet.get(self.row, self.phase, self.figure));
        Comparison { values, difference, interval, verdict }
    }
}

/// The values of both models, and how much they differ.
struct Comparison {
    values: [f64; 2],
    difference: f64,
    interval: Interval,
    /// Whether the model is certainly better or worse.
    verdict: &'static str,
}

/// A figure of both models in every row of a table.
pub struct Column {
    figure: Figure,
    comparisons: Vec<Comparison>,
}

/// Returns a table of values and differences, with a drawing of each interval.
pub fn comparison(first: &str, names: impl Iterator<Item = String>, columns: &[Column]) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label={ "Table by " (first) } {
            table.compact {
                thead { tr {
                    th scope="col" { (first) }
                    @for column in columns {
                        th scope="col" { (column.title()) }
                        @for head in ["other", "difference", "interval", "", ""] { th scope="col" { (head) } }
                    }
                } }
                tbody {
                    @for (index, name) in names.enumerate() {
                        tr {
                            th scope="row" { (name) }
                            @for column in columns { (column.cells(index)) }
                        }
                    }
                }
            }
        }
    }
}

impl Column {
    /// Compares the figure in every place. It gives the column its name.
    pub fn new<'a>(figure: Figure, places: impl Iterator<Item = Place<'a>>) -> Self {
        Self { figure, comparisons: places.map(|place| place.compare()).collect() }
    }

    fn title(&self) -> &'static str {
        match self.figure {
            Figure::R => "r",
            Figure::Bias => "bias",
            _ => "MSE",
        }
    }

    /// Returns the end of the scale of the drawn intervals.
    fn reach(&self) -> f64 {
        let ends = self.comparisons.iter().flat_map(|comparison| [comparison.interval.low, comparison.interval.high]);
        ends.filter(|end| end.is_finite()).map(f64::abs).fold(f64::MIN_POSITIVE, f64::max)
    }

    fn cells(&self, index: usize) -> Markup {
        let Comparison { values, difference, interval, verdict } = &self.comparisons[index];
        let signed = |value| signed(self.figure, value);
        html! {
            @for value in values { td { (number(self.figure, *value)) } }
            td { (signed(*difference)) }
            @if difference.is_finite() {
                td { (signed(interval.low)) " to " (signed(interval.high)) }
                td { (bar(*difference, *interval, self.reach(), verdict)) }
            } @else {
                td { "-" }
                td {}
            }
            td class=(verdict) { (verdict) }
        }
    }
}

/// Formats a difference.
pub fn signed(figure: Figure, value: f64) -> String {
    let decimals = if matches!(figure, Figure::R | Figure::Bias) { 3 } else { 4 };
    if value.is_finite() { format!("{value:+.decimals$}") } else { "-".to_owned() }
}

/// Draws an interval around its middle line, which is 0.
fn bar(value: f64, interval: Interval, reach: f64, verdict: &str) -> Markup {
    let x = |value: f64| format!("{:.1}", BAR_PX / 2.0 + value / reach * (BAR_PX / 2.0 - MARGIN_PX));
    html! {
        svg class={ "bar " (verdict) } width=(BAR_PX) height="14" viewBox={ "0 0 " (BAR_PX) " 14" } aria-hidden="true" {
            line.zero x1=(x(0.0)) x2=(x(0.0)) y1="0" y2="14" {}
            line x1=(x(interval.low)) x2=(x(interval.high)) y1="7" y2="7" {}
            circle cx=(x(value)) cy="7" r="3.5" {}
        }
    }
}
