//! The page that shows sampled beside recorded expressions.

use anyhow::Result;
use facewire::solve::BLENDSHAPES;
use maud::{Markup, html};

use super::{
    drawings,
    figures::{Difference, Figures, Marginal, largest_differences},
};
use crate::html::{RowHeader, figure, page, table};

/// Number of pairs of blendshapes that are listed because their correlations differ most.
const LISTED: usize = 24;
const COLOURS: &str = "Blue: recorded. Orange: sampled";

/// Returns the whole page. `mix` names the sampled kinds of expressions.
pub fn html(recorded: &Figures, sampled: &Figures, mix: &str) -> Result<String> {
    let difference: Vec<Vec<f64>> = (recorded.correlations.iter().zip(&sampled.correlations))
        .map(|(one, other)| one.iter().zip(other).map(|(one, other)| other - one).collect())
        .collect();
    let densities = drawings::densities(recorded, sampled)?;
    let ranges = drawings::ranges(recorded, sampled)?;
    let maps = [&recorded.correlations, &sampled.correlations, &difference].map(|values| drawings::matrix(values));
    let [recorded_map, sampled_map, difference_map] = maps;
    let body = html! {
        header {
            h1 { "Expressions" }
            p { (recorded.count) " recorded frames and " (sampled.count) " sampled expressions: " (mix) "." }
        }
        nav aria-label="Contents" {
            a href="#density" { "Density" }
            a href="#shapes" { "Blendshapes" }
            a href="#sides" { "Left and right" }
            a href="#correlations" { "Correlations" }
        }
        main {
            h2 id="density" { "Density" }
            (density_table(recorded, sampled))
            div.figures { (figure(&densities, COLOURS, "Number of visible coefficients")) }
            h2 id="shapes" { "Blendshapes" }
            div.figures.large { (figure(&ranges, "Lines run from the median to the 99th percentile, dots are at the 90th. Blue: recorded. Orange: sampled", "Ranges")) }
            (shape_table(recorded, sampled))
            h2 id="sides" { "Left and right" }
            p { "The mean absolute difference of both sides, and their correlation." }
            (side_table(recorded, sampled))
            h2 id="correlations" { "Correlations" }
            p { "The pairs whose correlations differ most." }
            (difference_table(&largest_differences(recorded, sampled, LISTED)))
            div.figures.large {
                (figure(&recorded_map?, "Recorded: blue -1, white 0, red 1", "Correlations"))
                (figure(&sampled_map?, "Sampled", "Correlations"))
                (figure(&difference_map?, "Sampled minus recorded", "Differences of correlations"))
            }
        }
    };
    Ok(page("expressions", &body))
}

/// Returns a summary as text.
pub fn summary(recorded: &Figures, sampled: &Figures) -> String {
    let line = |name: &str, figures: &Figures| {
        let [low, middle, high] = [0.05, 0.5, 0.95].map(|share| figures.density_quantile(share));
        format!(
            "{name}: {} expressions, on average {:.1} coefficients above 0.1 (5 %: {low}, 50 %: {middle}, 95 %: {high}) and {:.1} above 0.3; {:.1} % at rest\n",
            figures.count,
            figures.visible(),
            figures.strong,
            100.0 * figures.rest
        )
    };
    line("recorded", recorded) + &line("sampled", sampled)
}

fn row(name: &str, cells: Vec<String>) -> (RowHeader<'_>, Vec<String>) {
    (RowHeader { name, link: false }, cells)
}

fn density_table(recorded: &Figures, sampled: &Figures) -> Markup {
    let both = |of: &dyn Fn(&Figures) -> String| vec![of(recorded), of(sampled)];
    let quantile = |share: f64| both(&|figures| figures.density_quantile(share).to_string());
    let rows = [
        row("coefficients above 0.1, mean", both(&|figures| format!("{:.1}", figures.visible()))),
        row("5th percentile", quantile(0.05)),
        row("median", quantile(0.5)),
        row("95th percentile", quantile(0.95)),
        row("coefficients above 0.3, mean", both(&|figures| format!("{:.1}", figures.strong))),
        row("% at rest (none above 0.1)", both(&|figures| format!("{:.1}", 100.0 * figures.rest))),
    ];
    table("statistic", &["recorded", "sampled"], &rows)
}

fn shape_table(recorded: &Figures, sampled: &Figures) -> Markup {
    let heads = ["% at 0", "sampled", "median", "sampled", "75 %", "sampled", "90 %", "sampled", "99 %", "sampled"];
    let cells = |(one, other): (&Marginal, &Marginal)| {
        let zero = [one, other].map(|own| format!("{:.0}", 100.0 * own.zero));
        let pairs = one.quantiles.iter().zip(&other.quantiles);
        let quantiles = pairs.flat_map(|(one, other)| [one, other].map(|value| format!("{value:.2}")));
        row(BLENDSHAPES[one.index], zero.into_iter().chain(quantiles).collect())
    };
    table("blendshape", &heads, &recorded.shapes.iter().zip(&sampled.shapes).map(cells).collect::<Vec<_>>())
}

fn side_table(recorded: &Figures, sampled: &Figures) -> Markup {
    let sides = recorded.shapes.iter().zip(&sampled.shapes).filter_map(|(one, other)| {
        let ([gap, r], [sampled_gap, sampled_r]) = (one.sides?, other.sides?);
        let cells = [gap, sampled_gap, r, sampled_r].map(|value| format!("{value:.2}"));
        Some(row(BLENDSHAPES[one.index].trim_end_matches("Left"), cells.to_vec()))
    });
    table("blendshape", &["difference", "sampled", "correlation", "sampled"], &sides.collect::<Vec<_>>())
}

fn difference_table(differences: &[Difference]) -> Markup {
    let names: Vec<String> =
        differences.iter().map(|own| own.pair.map(|index| BLENDSHAPES[index]).join(", ")).collect();
    let cells = |(own, name): (&Difference, _)| {
        let Difference { correlations: [recorded, sampled], .. } = own;
        row(name, [*recorded, *sampled, sampled - recorded].map(|value| format!("{value:.2}")).to_vec())
    };
    let rows: Vec<_> = differences.iter().zip(names.iter().map(String::as_str)).map(cells).collect();
    table("pair", &["recorded", "sampled", "difference"], &rows)
}
