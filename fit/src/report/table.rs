//! Tables of the page, one column for each statistic.

use maud::Markup;

use super::diagnostics::Diagnostics;
use crate::{
    fitted::Fitted,
    html::RowHead,
    paper::ModelRow,
    statistics::{Tested, mean},
};

/// Columns of a table.
const COLUMNS: usize = 11;
/// Their heads.
const HEADS: [&str; COLUMNS] = ["R2", "xi", "MSE", "DW", "BP", "p(BP)", "F", "SW", "r", "bytes", "ns"];
/// Decimals of each column.
const DECIMALS: [usize; COLUMNS] = [3, 3, 4, 2, 1, 3, 1, 3, 3, 0, 0];
/// The column of p values, which are too small to be averaged or written with few decimals.
const P: usize = 5;

/// A line of a table.
pub struct Line {
    name: String,
    link: bool,
    values: [Option<f64>; COLUMNS],
}

impl Line {
    /// Of one model and blendshape.
    pub fn new(name: &str, model: &Fitted, diagnostics: &Diagnostics) -> Self {
        let statistic = |tested: Option<Tested>| tested.map(|tested| tested.statistic);
        let values = [
            Some(diagnostics.r_squared),
            Some(diagnostics.xi),
            Some(diagnostics.mse),
            Some(diagnostics.durbin_watson),
            statistic(diagnostics.breusch_pagan),
            diagnostics.breusch_pagan.map(|tested| tested.p),
            statistic(diagnostics.f),
            statistic(diagnostics.shapiro_wilk),
            Some(diagnostics.pearson),
            Some(model.bytes as f64),
            Some(model.nanoseconds),
        ];
        Self { name: name.to_owned(), link: false, values }
    }

    /// Of the paper, which reports fewer of them.
    pub fn of_paper(row: &ModelRow) -> Self {
        let [r_squared, xi, mse, durbin_watson, shapiro_wilk] = row.figures.map(Some);
        let bytes = Some(row.bytes as f64);
        let values = [r_squared, xi, mse, durbin_watson, None, None, None, shapiro_wilk, None, bytes, None];
        Self { name: row.kind.to_owned(), link: false, values }
    }

    /// Mean of several, column by column.
    pub fn mean(name: &str, lines: &[Self]) -> Self {
        let column = |place: usize| {
            let values = lines.iter().filter_map(|line| line.values[place]);
            (place != P && values.clone().next().is_some()).then(|| mean(values))
        };
        Self { name: name.to_owned(), link: false, values: core::array::from_fn(column) }
    }

    /// With its name leading to the section of that name.
    pub fn linked(self) -> Self {
        Self { link: true, ..self }
    }
}

/// Lines as a table.
pub fn html(first: &str, lines: &[Line]) -> Markup {
    crate::html::table(first, &HEADS, &lines.iter().map(row).collect::<Vec<_>>())
}

fn row(line: &Line) -> (RowHead<'_>, Vec<String>) {
    let cells = line.values.iter().enumerate().map(|(place, value)| cell(place, *value));
    (RowHead { name: &line.name, link: line.link }, cells.collect())
}

fn cell(place: usize, value: Option<f64>) -> String {
    let decimals = DECIMALS[place];
    match value {
        None => "–".to_owned(),
        Some(0.0) if place == P => "0".to_owned(),
        Some(p) if place == P && p < 0.001 => format!("{p:.0e}"),
        Some(value) => format!("{value:.decimals$}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_p_keeps_its_magnitude_and_missing_figures_are_dashes() {
        assert_eq!(cell(P, Some(2.68e-5)), "3e-5");
        assert_eq!(cell(P, Some(0.25)), "0.250");
        assert_eq!(cell(0, None), "–");
    }

    #[test]
    fn mean_leaves_out_p_and_what_some_lines_lack() {
        let line = |r_squared| Line {
            name: String::new(),
            link: false,
            values: core::array::from_fn(|place| if place == 0 { r_squared } else { Some(1.0) }),
        };
        let mean = Line::mean("", &[line(Some(0.5)), line(None)]);
        assert_eq!([mean.values[0], mean.values[P], mean.values[1]], [Some(0.5), None, Some(1.0)]);
    }
}
