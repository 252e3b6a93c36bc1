//! Tables of the report, with one column per statistic.

use maud::Markup;

use super::diagnostics::Diagnostics;
use crate::{
    fitted::Fitted,
    html::RowHeader,
    paper::ModelRow,
    statistics::{TestResult, mean},
};

/// Number of columns.
const COLUMNS: usize = 11;
/// Titles of the columns.
const HEADS: [&str; COLUMNS] = ["R2", "xi", "MSE", "DW", "BP", "p(BP)", "F", "SW", "r", "bytes", "ns"];
/// Decimals of each column.
const DECIMALS: [usize; COLUMNS] = [3, 3, 4, 2, 1, 3, 1, 3, 3, 0, 0];
/// The column of p values, which are too small to be averaged or written with a fixed number of decimals.
const P: usize = 5;

/// A line of a table.
pub struct Line {
    name: String,
    link: bool,
    values: [Option<f64>; COLUMNS],
}

impl Line {
    /// Returns the line of one model of one blendshape.
    pub fn new(name: &str, model: &Fitted, diagnostics: &Diagnostics) -> Self {
        let statistic = |tested: Option<TestResult>| tested.map(|tested| tested.statistic);
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

    /// Returns a line of the paper's table, which has fewer columns.
    pub fn from_paper(row: &ModelRow) -> Self {
        let [r_squared, xi, mse, durbin_watson, shapiro_wilk] = row.figures.map(Some);
        let bytes = Some(row.bytes as f64);
        let values = [r_squared, xi, mse, durbin_watson, None, None, None, shapiro_wilk, None, bytes, None];
        Self { name: row.kind.to_owned(), link: false, values }
    }

    /// Returns the mean of several lines, column by column.
    pub fn mean(name: &str, lines: &[Self]) -> Self {
        let column = |index: usize| {
            let values = lines.iter().filter_map(|line| line.values[index]);
            (index != P && values.clone().next().is_some()).then(|| mean(values))
        };
        Self { name: name.to_owned(), link: false, values: core::array::from_fn(column) }
    }

    /// Makes the name a link to the section of that name.
    pub fn linked(self) -> Self {
        Self { link: true, ..self }
    }
}

/// Returns lines as an HTML table.
pub fn html(first: &str, lines: &[Line]) -> Markup {
    crate::html::table(first, &HEADS, &lines.iter().map(row).collect::<Vec<_>>())
}

fn row(line: &Line) -> (RowHeader<'_>, Vec<String>) {
    let cells = line.values.iter().enumerate().map(|(column, value)| cell(column, *value));
    (RowHeader { name: &line.name, link: line.link }, cells.collect())
}

fn cell(column: usize, value: Option<f64>) -> String {
    let decimals = DECIMALS[column];
    match value {
        None => "–".to_owned(),
        Some(0.0) if column == P => "0".to_owned(),
        Some(p) if column == P && p < 0.001 => format!("{p:.0e}"),
        Some(value) => format!("{value:.decimals$}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_p_keeps_its_magnitude_and_missing_values_are_dashes() {
        assert_eq!(cell(P, Some(2.68e-5)), "3e-5");
        assert_eq!(cell(P, Some(0.25)), "0.250");
        assert_eq!(cell(0, None), "–");
    }

    #[test]
    fn means_leave_out_p_and_missing_values() {
        let line = |r_squared| Line {
            name: String::new(),
            link: false,
            values: core::array::from_fn(|column| if column == 0 { r_squared } else { Some(1.0) }),
        };
        let mean = Line::mean("", &[line(Some(0.5)), line(None)]);
        assert_eq!([mean.values[0], mean.values[P], mean.values[1]], [Some(0.5), None, Some(1.0)]);
    }
}
