//! `facewire-fit report`: statistics of every blendshape and kind of model, as one HTML page with charts.

mod drawings;

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use facewire_face::{BLENDSHAPES, COEFFS, Model, model::MAX_HIDDEN};
use maud::{Markup, html};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::compare::{self, FitOptions};
use crate::dataset;
use crate::drawing::{face::face, subsample};
use crate::heat::LandmarkMotion;
use crate::judge::{Faces, command::load_model, estimates, regression_ns};
use crate::output::{self, Table, figure, guide, number};
use crate::paper::{MODELS_TITLE, ModelRow, model_rows};
use crate::statistics::{
    SHAPIRO_WILK_MAX, TestResult, autocorrelation, breusch_pagan, durbin_watson, f_statistic, mean, mse, pearson,
    r_squared, shapiro_wilk, xi,
};

/// Largest lag of the autocorrelation chart.
const LAGS: usize = 30;
/// Titles and decimals of the statistics.
const COLUMNS: [(&str, usize); 11] = [
    ("R2", 3),
    ("xi", 3),
    ("MSE", 4),
    ("DW", 2),
    ("BP", 1),
    ("p(BP)", 3),
    ("F", 1),
    ("SW", 3),
    ("r", 3),
    ("bytes", 0),
    ("ns", 0),
];
/// The column of p values, which are too small to be averaged or written with a fixed number of decimals.
const P: usize = 5;

/// Arguments of `report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Landmarks with true coefficients (npz archive with names.json beside it)
    dataset: PathBuf,
    /// The page to write
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// A model to judge instead of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Judge on all subjects: only for data that the model was not fitted on
    #[arg(long)]
    all_subjects: bool,
    /// Kinds of model to fit and show beside the shipped model, by their names in `fit`, separated by commas
    #[arg(long, value_delimiter = ',', conflicts_with = "all_subjects")]
    kinds: Vec<String>,
}

/// A fitted model of one blendshape with its predictions for the judged pictures, in the order of the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    pub kind: String,
    pub blendshape: usize,
    pub predictions: Vec<f64>,
    /// The number of fitted weights, without the constant.
    pub degrees_of_freedom: usize,
    pub bytes: usize,
    pub nanoseconds: f64,
}

/// Applies the model that facewire runs. Its memory and time are divided evenly among the blendshapes.
fn shipped(kind: &str, model: &Model, faces: &Faces, rows: &[usize]) -> Result<Vec<Fitted>> {
    let nanoseconds = regression_ns(model, faces, rows)? / COEFFS as f64;
    let fitted = |(blendshape, predictions): (usize, Vec<f64>)| Fitted {
        kind: kind.to_owned(),
        blendshape,
        predictions,
        degrees_of_freedom: MAX_HIDDEN,
        bytes: model.size_bytes() / COEFFS,
        nanoseconds,
    };
    // The last blendshape, `tongueOut`, has no model.
    Ok(estimates(model, faces, rows)?.into_iter().enumerate().take(COEFFS - 1).map(fitted).collect())
}

pub fn run(args: &ReportArgs) -> Result<()> {
    output::check(&args.out)?;
    let samples = dataset::load(&args.dataset)?;
    let (known, unknown) = (Faces::new(&samples, true)?, Faces::new(&samples, false)?);
    let rows = known.rows(args.all_subjects)?;
    let model = load_model(args.model.as_deref())?;
    let mut fitted = shipped("shipped, neutral known", &model, &known, &rows)?;
    fitted.extend(shipped("shipped, neutral not known", &model, &unknown, &rows)?);
    if !args.kinds.is_empty() {
        fitted.extend(compare::fitted(&samples, &known, &FitOptions::to_kinds(args.kinds.clone()))?);
    }
    let section = |(blendshape, name): (usize, &'static str)| {
        let truth = known.truth(blendshape, &rows);
        let own = fitted.iter().filter(|model| model.blendshape == blendshape);
        let models: Vec<_> = own.map(|model| (model, Diagnostics::new(model, &truth))).collect();
        (!models.is_empty()).then_some(Section { name, truth, models })
    };
    let sections: Vec<Section> = BLENDSHAPES.into_iter().enumerate().filter_map(section).collect();
    let motion = LandmarkMotion::new(&known, &unknown, &rows)?;
    let drawn = sections.par_iter().map(|section| section.html(&motion)).collect::<Result<Vec<_>>>()?;
    let subjects = if args.all_subjects { "all subjects" } else { "subjects that the fit never saw" };
    let body = html! {
        p {
            (rows.len()) " rendered pictures of " (subjects) ", from "
            (args.dataset.file_name().unwrap_or_default().to_string_lossy()) ". Times: " (cpu()) "."
        }
        h2 id="kinds" { "Kinds of model" }
        p { "Mean over the blendshapes." }
        (table("kind", means(&sections)).html())
        h2 id="all" { "All blendshapes" }
        p { (sections.first().map_or("", |section| &section.models[0].0.kind)) "." }
        (table("blendshape", sections.iter().map(|own| (own.name, own.models[0].1.values))).linked().html())
        (guide(&GUIDE))
        @for section in &drawn { (section) }
    };
    let contents = [("kinds", "Kinds of model"), ("all", "All blendshapes"), ("guide", "How to read it")];
    let names: Vec<String> = sections.iter().map(|section| section.name.to_owned()).collect();
    output::write_page(&args.out, "Blendshape models", &contents, &names, &body)
}

type Values = [Option<f64>; COLUMNS.len()];

/// The statistics of the paper's tables, for one model of one blendshape on the judged pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostics {
    values: Values,
    /// Truth minus estimate, in the order of the estimates.
    residuals: Vec<f64>,
}

impl Diagnostics {
    /// Computes the statistics of a model's predictions. Pictures have no natural order, so the residuals are ordered
    /// by estimate. Correlated neighbours then mean that the model has the wrong curvature. There is no F of a model that is
    /// worse than the mean of the truth.
    pub fn new(fitted: &Fitted, truth: &[f64]) -> Self {
        let estimates = &fitted.predictions;
        let mut order: Vec<usize> = (0..truth.len()).collect();
        order.sort_by(|a, b| estimates[*a].total_cmp(&estimates[*b]));
        let residuals: Vec<f64> = order.iter().map(|row| truth[*row] - estimates[*row]).collect();
        let sorted: Vec<f64> = order.iter().map(|row| estimates[*row]).collect();
        let r_squared = r_squared(estimates, truth);
        let f = f_statistic(r_squared, truth.len(), fitted.degrees_of_freedom).filter(|f| f.statistic > 0.0);
        let spread = breusch_pagan(&residuals, &DMatrix::from_column_slice(sorted.len(), 1, &sorted));
        let spread = spread.map(|tested| tested.lagrange);
        let statistic = |tested: Option<TestResult>| tested.map(|tested| tested.statistic);
        let values = [
            Some(r_squared),
            Some(xi(estimates, truth)),
            Some(mse(estimates, truth)),
            Some(durbin_watson(&residuals)),
            statistic(spread),
            spread.map(|tested| tested.p),
            statistic(f),
            statistic(shapiro_wilk(&subsample(&residuals, SHAPIRO_WILK_MAX))),
            Some(pearson(estimates, truth)),
            Some(fitted.bytes as f64),
            Some(fitted.nanoseconds),
        ];
        Self { values, residuals }
    }
}

fn table<N: Into<String>>(first: &str, rows: impl IntoIterator<Item = (N, Values)>) -> Table {
    let cell = |(column, value): (usize, Option<f64>)| match value {
        Some(0.0) if column == P => "0".to_owned(),
        Some(p) if column == P && p < 0.001 => format!("{p:.0e}"),
        value => number(value, COLUMNS[column].1),
    };
    let row = |(name, values): (N, Values)| {
        [name.into()].into_iter().chain(values.into_iter().enumerate().map(cell)).collect::<Vec<_>>()
    };
    Table::new([first].into_iter().chain(COLUMNS.map(|(title, _)| title)), rows.into_iter().map(row))
}

/// Returns the statistics of models of one blendshape, followed by those of the paper, which has fewer columns.
pub fn with_papers(models: &[(&str, &Diagnostics)], paper: &[ModelRow]) -> Table {
    let own = models.iter().map(|(name, found)| ((*name).to_owned(), found.values));
    let papers = paper.iter().map(|row| {
        let [r_squared, xi, mse, durbin_watson, shapiro_wilk] = row.figures.map(Some);
        let bytes = Some(row.bytes as f64);
        let values = [r_squared, xi, mse, durbin_watson, None, None, None, shapiro_wilk, None, bytes, None];
        (format!("  {}", row.kind), values)
    });
    table("kind", own.chain(papers))
}

/// A blendshape with the results of every kind of model. Charts are drawn for the first kind.
struct Section<'a> {
    name: &'static str,
    truth: Vec<f64>,
    models: Vec<(&'a Fitted, Diagnostics)>,
}

/// Returns the statistics of every kind of model, averaged over the blendshapes.
fn means(sections: &[Section]) -> Vec<(String, Values)> {
    let mut kinds: Vec<(String, Vec<Values>)> = Vec::new();
    for (model, found) in sections.iter().flat_map(|section| &section.models) {
        match kinds.iter_mut().find(|(kind, _)| *kind == model.kind) {
            Some((_, values)) => values.push(found.values),
            None => kinds.push((model.kind.clone(), vec![found.values])),
        }
    }
    kinds.into_iter().map(|(kind, values)| (kind, mean_values(&values))).collect()
}

fn mean_values(all: &[Values]) -> Values {
    core::array::from_fn(|column| {
        let values: Vec<f64> = all.iter().filter_map(|values| values[column]).collect();
        (column != P && !values.is_empty()).then(|| mean(values.into_iter()))
    })
}

impl Section<'_> {
    fn html(&self, motion: &LandmarkMotion) -> Result<Markup> {
        let (model, diagnostics) = self.models.first().context("a blendshape has no model")?;
        let pairs: Vec<_> = model.predictions.iter().copied().zip(self.truth.iter().copied()).collect();
        let lags = autocorrelation(&diagnostics.residuals, LAGS);
        let found = motion.correlations(&self.truth);
        let by_value = |a: &(usize, &f64), b: &(usize, &f64)| a.1.total_cmp(b.1);
        let (least, _) = found.iter().enumerate().min_by(by_value).context("there are no landmarks")?;
        let (most, highest) = found.iter().enumerate().max_by(by_value).context("there are no landmarks")?;
        let [follows, rests] = [most, least].map(|landmark| motion.movement(landmark, &self.truth));
        let correlation = format!("Correlation of each landmark with the truth: black 0, yellow {highest:.2}");
        let moved = format!("Landmarks {most} (blue, most correlated) and {least} (orange, least), in eye distances");
        let figures = [
            (drawings::fit(&pairs)?, "Estimate against truth, mostly of pictures that show the expression"),
            (
                drawings::ranked(&pairs)?,
                "Estimates (dots) and truth (line), with the pictures in the order of the truth",
            ),
            (drawings::residuals(&pairs)?, "Residuals against estimates, for the same pictures"),
            (drawings::autocorrelation(&lags, pairs.len())?, "Autocorrelation of the residuals"),
            (face(&motion.positions, &found, &[])?, &correlation),
            (drawings::movements(&follows, &rests)?, &moved),
        ];
        let models: Vec<_> = self.models.iter().map(|(model, found)| (model.kind.as_str(), found)).collect();
        let paper = model_rows(self.name);
        Ok(html! {
            section id=(self.name) {
                h2 { (self.name) }
                (with_papers(&models, paper).html())
                @if !paper.is_empty() { p { "Last rows: " (MODELS_TITLE) " of the paper, fitted and judged on pictures of one avatar." } }
                div.figures { @for (drawing, caption) in &figures { (figure(drawing, caption, self.name)) } }
                p.up { a href="#all" { "All blendshapes" } }
            }
        })
    }
}

const GUIDE: [(&str, &str); 8] = [
    (
        "R2, r",
        "Share of the truth's variance that the model explains, and Pearson's correlation. With R2 below 0 the model is \
         worse than the mean of the truth.",
    ),
    ("xi", "Chatterjee's correlation: the degree to which the truth is a function of the estimate."),
    ("MSE", "Mean squared error."),
    (
        "DW",
        "Durbin-Watson statistic, with the residuals in the order of the estimates: 2 if neighbours are uncorrelated. A \
         value far below 2 means that the model has the wrong curvature.",
    ),
    (
        "BP",
        "Breusch-Pagan test (Koenker's form) on the estimates, with one degree of freedom. A small p means that the errors \
         grow or shrink with the coefficient.",
    ),
    (
        "F",
        "Overall F, with the number of the blendshape's own weights as degrees of freedom. The model was not fitted to \
         these pictures, so F only measures the size of the effect and has no p.",
    ),
    (
        "SW",
        "Shapiro-Wilk W of the residuals: 1 if they look normal. With a thousand pictures, p is small for any real model.",
    ),
    (
        "bytes, ns",
        "Memory, and time of the regression for one face. The blendshapes of the shipped model share parts; each gets an \
         even share of its cost.",
    ),
];

fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| "an unknown CPU".to_owned(), |(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagnostics(predictions: Vec<f64>, truth: &[f64]) -> Diagnostics {
        let kind = "test".to_owned();
        let fitted = Fitted { kind, blendshape: 0, predictions, degrees_of_freedom: 1, bytes: 8, nanoseconds: 1.0 };
        Diagnostics::new(&fitted, truth)
    }

    #[test]
    fn a_model_of_wrong_curvature_has_a_low_durbin_watson_in_any_order_of_the_pictures() {
        let truth: Vec<f64> = (0..200).map(|i| f64::from(i * 77 % 200) / 200.0).collect();
        let bent = truth.iter().map(|value| value * value).collect();
        assert!(diagnostics(bent, &truth).values[3].unwrap() < 0.1);
    }

    #[test]
    fn a_model_worse_than_the_mean_has_no_f_and_a_small_p_keeps_its_magnitude() {
        let truth: Vec<f64> = (0..20).map(f64::from).collect();
        let mut values = diagnostics(truth.iter().rev().copied().collect(), &truth).values;
        assert!(values[0].unwrap() < 0.0 && values[6].is_none());
        values[P] = Some(2.68e-5);
        let text = table("kind", [("one", values)]).text();
        assert!(text.contains(" 3e-5 |"), "{text}");
        let mean = mean_values(&[values, [None; COLUMNS.len()]]);
        assert_eq!([mean[0], mean[P], mean[6]], [values[0], None, None], "means leave out p and missing values");
    }
}
