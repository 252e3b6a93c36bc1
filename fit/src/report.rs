//! `facewire-fit report`: statistics of every blendshape and kind of model, as one HTML page with charts.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use facewire_face::{BLENDSHAPES, COEFFS, Model, model::MAX_HIDDEN};
use maud::{Markup, html};
use plotters::prelude::*;
use rayon::prelude::*;

use crate::compare::{self, FitOptions, Split};
use crate::dataset;
use crate::drawing::{Axis, BLUE_INK, LandmarkMotion, ORANGE_INK, POINT_PX, SIZE_PX, chart, face, scatter, svg};
use crate::faces::{Faces, estimates, regression_ns};
use crate::judge::load_model;
use crate::output::{self, figures, guide};
use crate::paper::{Fitted, MODELS_TITLE, P, Values, model_rows, table, with_papers};
use crate::statistics::{autocorrelation, column_means, subsample};

const LAGS: usize = 30;

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

/// Applies the model that facewire runs. Its memory and time are divided evenly among the blendshapes.
fn shipped(kind: &str, model: &Model, faces: &Faces, rows: &[usize]) -> Result<Vec<(usize, Fitted)>> {
    let costs = [(model.to_bytes().len() / COEFFS) as f64, regression_ns(model, faces, rows)? / COEFFS as f64];
    let fitted = |(blendshape, predictions): (usize, Vec<f64>)| {
        let truth = faces.truth(blendshape, rows);
        (blendshape, Fitted::new(kind.to_owned(), predictions, &truth, MAX_HIDDEN, costs))
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
        let options = FitOptions::to_kinds(args.kinds.clone());
        let split = Split::new(&samples, options.folds, false)?;
        ensure!(!split.one_subject, "a report of kinds needs several subjects");
        fitted.extend(compare::fitted(&samples, &known, &options, &split)?);
    }
    let section = |(blendshape, name): (usize, &'static str)| {
        let models: Vec<_> = fitted.iter().filter(|own| own.0 == blendshape).map(|(_, model)| model).collect();
        (!models.is_empty()).then(|| Section { name, truth: known.truth(blendshape, &rows), models })
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
        p { (sections.first().map_or("", |section| &section.models[0].kind)) "." }
        (table("blendshape", sections.iter().map(|own| (own.name, own.models[0].values))).linked().html())
        (guide(&GUIDE))
        @for section in &drawn { (section) }
    };
    let contents = [("kinds", "Kinds of model"), ("all", "All blendshapes"), ("guide", "How to read it")];
    let names: Vec<String> = sections.iter().map(|section| section.name.to_owned()).collect();
    output::write_page(&args.out, "Blendshape models", &contents, &names, &body)
}

/// A blendshape with the results of every kind of model. Charts are drawn for the first kind.
struct Section<'a> {
    name: &'static str,
    truth: Vec<f64>,
    models: Vec<&'a Fitted>,
}

fn means(sections: &[Section]) -> Vec<(String, Values)> {
    let mut kinds: Vec<(String, Vec<Values>)> = Vec::new();
    for model in sections.iter().flat_map(|section| &section.models) {
        match kinds.iter_mut().find(|(kind, _)| *kind == model.kind) {
            Some((_, values)) => values.push(model.values),
            None => kinds.push((model.kind.clone(), vec![model.values])),
        }
    }
    let mean = |(kind, values): (String, Vec<Values>)| {
        let mut means = column_means(&values);
        means[P] = None;
        (kind, means)
    };
    kinds.into_iter().map(mean).collect()
}

impl Section<'_> {
    fn html(&self, motion: &LandmarkMotion) -> Result<Markup> {
        let model = self.models.first().context("a blendshape has no model")?;
        let pairs: Vec<_> = model.predictions.iter().copied().zip(self.truth.iter().copied()).collect();
        let lags = autocorrelation(&model.residuals, LAGS);
        let found = motion.correlations(&self.truth);
        let by_value = |a: &(usize, &f64), b: &(usize, &f64)| a.1.total_cmp(b.1);
        let (least, _) = found.iter().enumerate().min_by(by_value).context("there are no landmarks")?;
        let (most, highest) = found.iter().enumerate().max_by(by_value).context("there are no landmarks")?;
        let [follows, rests] = [most, least].map(|landmark| motion.movement(landmark, &self.truth));
        let correlation = format!("Correlation of each landmark with the truth: black 0, yellow {highest:.2}");
        let moved = format!("Landmarks {most} (blue, most correlated) and {least} (orange, least), in eye distances");
        let drawn = [
            (fit_chart(&pairs)?, "Estimate against truth, mostly of pictures that show the expression"),
            (ranked_chart(&pairs)?, "Estimates (dots) and truth (line), with the pictures in the order of the truth"),
            (residual_chart(&pairs)?, "Residuals against estimates, for the same pictures"),
            (autocorrelation_chart(&lags, pairs.len())?, "Autocorrelation of the residuals"),
            (face(&motion.positions, &found, &[])?, &correlation),
            (movement_chart(&follows, &rests)?, &moved),
        ];
        let paper = model_rows(self.name);
        Ok(html! {
            section id=(self.name) {
                h2 { (self.name) }
                (with_papers(&self.models, paper).html())
                @if !paper.is_empty() { p { "Last rows: " (MODELS_TITLE) " of the paper, fitted and judged on pictures of one avatar." } }
                (figures(&drawn, self.name))
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

pub fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| "an unknown CPU".to_owned(), |(_, name)| name.trim().to_owned())
}

/// Number of points in a scatter plot: enough to see its shape, and few enough for fifty plots on a page.
const CLOUD: usize = 300;
const LARGEST: usize = 200;

pub fn fit_chart(pairs: &[(f64, f64)]) -> Result<String> {
    let points: Vec<_> = thinned(pairs).into_iter().map(|(estimate, truth)| (truth, estimate)).collect();
    let axes = [Axis::linear("truth", [0.0, 1.0]), Axis::linear("estimate", [0.0, 1.0])];
    scatter(&[(&points, BLUE_INK)], &axes, &[[(0.0, 0.0), (1.0, 1.0)]])
}

fn residual_chart(pairs: &[(f64, f64)]) -> Result<String> {
    let points: Vec<_> = thinned(pairs).into_iter().map(|(estimate, truth)| (estimate, truth - estimate)).collect();
    let axes = [Axis::linear("estimate", [0.0, 1.0]), Axis::linear("residual", [-1.0, 1.0])];
    scatter(&[(&points, BLUE_INK)], &axes, &[[(0.0, 0.0), (1.0, 0.0)]])
}

/// Plots the displacement of a landmark that follows the blendshape (blue), and of one that rests (orange).
pub fn movement_chart(follows: &[(f64, f64)], rests: &[(f64, f64)]) -> Result<String> {
    let largest = follows.iter().chain(rests).map(|(_, moved)| moved.abs()).fold(0.0, f64::max);
    let axes = [Axis::linear("truth", [0.0, 1.0]), Axis::linear("displacement", [-largest, largest])];
    let half = |points: &[(f64, f64)]| subsample(&thinned(points), CLOUD / 2);
    scatter(&[(&half(rests), ORANGE_INK), (&half(follows), BLUE_INK)], &axes, &[])
}

/// Returns at most [`CLOUD`] points: the largest, and a sample of the others, most of which are 0.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| b.0.max(b.1).total_cmp(&a.0.max(a.1)));
    let (largest, others) = sorted.split_at(sorted.len().min(LARGEST));
    [largest.to_vec(), subsample(others, CLOUD - LARGEST)].concat()
}

pub fn ranked_chart(pairs: &[(f64, f64)]) -> Result<String> {
    let mut pairs = pairs.to_vec();
    pairs.sort_by(|a, b| a.1.total_cmp(&b.1));
    let pairs = subsample(&pairs, CLOUD);
    let percent = |index: usize| 100.0 * index as f64 / pairs.len() as f64;
    let axes = [Axis::linear("% of pictures, by truth", [0.0, 100.0]), Axis::linear("coefficient", [0.0, 1.0])];
    svg(SIZE_PX, |area| {
        let mut chart = chart(area, &axes)?;
        let points = pairs.iter().enumerate().map(|(index, pair)| (percent(index), pair.0));
        chart.draw_series(points.map(|point| Circle::new(point, POINT_PX, BLUE_INK.filled())))?;
        let line = pairs.iter().enumerate().map(|(index, pair)| (percent(index), pair.1));
        chart.draw_series(LineSeries::new(line, ORANGE_INK.stroke_width(2)))?;
        Ok(())
    })
}

/// Plots the autocorrelation by lag, with the 95 % limits of uncorrelated values.
fn autocorrelation_chart(lags: &[f64], values: usize) -> Result<String> {
    let last = lags.len() as f64;
    let axes = [Axis::linear("lag", [0.0, last]), Axis::linear("autocorrelation", [-0.5, 1.0])];
    let limit = 1.96 / (values as f64).sqrt();
    svg(SIZE_PX, |area| {
        let mut chart = chart(area, &axes)?;
        let bar = |(lag, value): (usize, &f64)| {
            PathElement::new(vec![(lag as f64, 0.0), (lag as f64, *value)], BLUE_INK.stroke_width(5))
        };
        chart.draw_series(lags.iter().enumerate().skip(1).map(bar))?;
        for level in [-limit, limit] {
            chart.draw_series(LineSeries::new([(0.0, level), (last, level)], ORANGE_INK.stroke_width(1)))?;
        }
        Ok(())
    })
}
