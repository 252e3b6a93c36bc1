//! The page of the report.

use anyhow::{Context, Result};
use facewire::solve::BLENDSHAPES;
use maud::{Markup, html};
use rayon::prelude::*;

use super::{
    Judged,
    diagnostics::Diagnostics,
    drawings,
    table::{self, Line},
};
use crate::{
    drawing::face::face,
    fitted::Fitted,
    heat::LandmarkMotion,
    html::{figure, page},
    paper::{CHEEK_PUFF, MODELS_TITLE, ModelRow, SMILE_LEFT},
    statistics::autocorrelation,
};

/// Largest lag of the autocorrelation chart.
const LAGS: usize = 30;

/// A blendshape with the results of every kind of model. Charts are drawn for the first kind.
struct Section<'a> {
    name: &'static str,
    truth: Vec<f64>,
    models: Vec<(&'a Fitted, Diagnostics)>,
}

/// Returns the whole page.
pub fn html(judged: &Judged, fitted: &[Fitted]) -> Result<String> {
    let sections = sections(judged, fitted);
    let landmarks = LandmarkMotion::new(judged.known, judged.unknown, &judged.rows)?;
    let drawn = sections.par_iter().map(|section| section.html(&landmarks)).collect::<Result<Vec<_>>>()?;
    let first = sections.first().and_then(|section| section.models.first()).context("there is no model to report")?.0;
    let body = html! {
        header {
            h1 { "Blendshape models" }
            p { (judged.described) ". Times: " (cpu()) "." }
        }
        (contents(&sections))
        main {
            h2 id="kinds" { "Kinds of model" }
            p { "Mean over the blendshapes." }
            (table::html("kind", &means(&sections)))
            h2 id="all" { "All blendshapes" }
            p { (first.kind) "." }
            (table::html("blendshape", &all(&sections)))
            (guide())
            @for section in &drawn { (section) }
        }
    };
    Ok(page("blendshape models", &body))
}

fn sections<'a>(judged: &Judged, fitted: &'a [Fitted]) -> Vec<Section<'a>> {
    let section = |(blendshape, name): (usize, &'static str)| {
        let truth = judged.known.truth(blendshape, &judged.rows);
        let own = fitted.iter().filter(|model| model.blendshape == blendshape);
        let models: Vec<_> = own.map(|model| (model, Diagnostics::new(model, &truth))).collect();
        (!models.is_empty()).then_some(Section { name, truth, models })
    };
    BLENDSHAPES.into_iter().enumerate().filter_map(section).collect()
}

fn contents(sections: &[Section]) -> Markup {
    html! {
        nav aria-label="Contents" {
            a href="#kinds" { "Kinds of model" }
            a href="#all" { "All blendshapes" }
            a href="#guide" { "How to read it" }
            @for section in sections { a.small href={ "#" (section.name) } { (section.name) } }
        }
    }
}

/// Returns a line for every kind of model, averaged over the blendshapes.
fn means(sections: &[Section]) -> Vec<Line> {
    let mut kinds: Vec<&str> = Vec::new();
    for (model, _) in sections.iter().flat_map(|section| &section.models) {
        if !kinds.contains(&model.kind.as_str()) {
            kinds.push(&model.kind);
        }
    }
    let line = |kind: &str| {
        let models = sections.iter().flat_map(|section| &section.models).filter(|(model, _)| model.kind == kind);
        Line::mean(kind, &models.map(|(model, diagnostics)| Line::new("", model, diagnostics)).collect::<Vec<_>>())
    };
    kinds.into_iter().map(line).collect()
}

fn all(sections: &[Section]) -> Vec<Line> {
    let line = |section: &Section| {
        let (model, diagnostics) = section.models.first()?;
        Some(Line::new(section.name, model, diagnostics).linked())
    };
    sections.iter().filter_map(line).collect()
}

impl Section<'_> {
    fn html(&self, landmarks: &LandmarkMotion) -> Result<Markup> {
        let (model, diagnostics) = self.models.first().context("a blendshape has no model")?;
        let pairs: Vec<_> = model.predictions.iter().copied().zip(self.truth.iter().copied()).collect();
        let lags = autocorrelation(&diagnostics.residuals, LAGS);
        let mut figures = vec![
            (drawings::fit(&pairs)?, "Estimate against truth, mostly of pictures that show the expression".to_owned()),
            (
                drawings::ranked(&pairs)?,
                "Estimates (dots) and truth (line), with the pictures in the order of the truth".to_owned(),
            ),
            (drawings::residuals(&pairs)?, "Residuals against estimates, for the same pictures".to_owned()),
            (drawings::autocorrelation(&lags, pairs.len())?, "Autocorrelation of the residuals".to_owned()),
        ];
        figures.extend(self.landmark_figures(landmarks)?);
        let lines: Vec<Line> =
            self.models.iter().map(|(model, diagnostics)| Line::new(&model.kind, model, diagnostics)).collect();
        Ok(html! {
            section id=(self.name) {
                h2 { (self.name) }
                (table::html("kind", &lines))
                (papers(self.name))
                div.figures { @for (drawing, caption) in &figures { (figure(drawing, caption, self.name)) } }
                p.up { a href="#all" { "All blendshapes" } }
            }
        })
    }

    /// Draws the correlation of every landmark, and the motion of the most and the least correlated landmark.
    fn landmark_figures(&self, landmarks: &LandmarkMotion) -> Result<[(String, String); 2]> {
        let found = landmarks.correlations(&self.truth);
        let by_value = |a: &(usize, &f64), b: &(usize, &f64)| a.1.total_cmp(b.1);
        let (least, _) = found.iter().enumerate().min_by(by_value).context("there are no landmarks")?;
        let (most, highest) = found.iter().enumerate().max_by(by_value).context("there are no landmarks")?;
        let [follows, rests] = [most, least].map(|landmark| landmarks.movement(landmark, &self.truth));
        Ok([
            (
                face(&landmarks.positions, &found, &[])?,
                format!("Correlation of each landmark with the truth: black 0, yellow {highest:.2}"),
            ),
            (
                drawings::movements(&follows, &rests)?,
                format!("Landmarks {most} (blue, most correlated) and {least} (orange, least), in eye distances"),
            ),
        ])
    }
}

/// Returns the paper's table for the two blendshapes that it reports.
fn papers(name: &str) -> Markup {
    let rows: &[ModelRow] = match name {
        "mouthSmileLeft" => &SMILE_LEFT,
        "cheekPuff" => &CHEEK_PUFF,
        _ => return html! {},
    };
    html! {
        p { "Results of the paper, table " (MODELS_TITLE) ": fitted and judged on pictures of one avatar." }
        (table::html("kind", &rows.iter().map(Line::from_paper).collect::<Vec<_>>()))
    }
}

fn guide() -> Markup {
    html! {
        h2 id="guide" { "How to read it" }
        dl {
            dt { "R2, r" } dd { "Share of the truth's variance that the model explains, and Pearson's correlation. With R2 below 0 the model is worse than the mean of the truth." }
            dt { "xi" } dd { "Chatterjee's correlation: the degree to which the truth is a function of the estimate." }
            dt { "MSE" } dd { "Mean squared error." }
            dt { "DW" } dd { "Durbin-Watson statistic, with the residuals in the order of the estimates: 2 if neighbours are uncorrelated. A value far below 2 means that the model has the wrong curvature." }
            dt { "BP" } dd { "Breusch-Pagan test (Koenker's form) on the estimates, with one degree of freedom. A small p means that the errors grow or shrink with the coefficient." }
            dt { "F" } dd { "Overall F, with the number of the blendshape's own weights as degrees of freedom. The model was not fitted to these pictures, so F only measures the size of the effect and has no p." }
            dt { "SW" } dd { "Shapiro-Wilk W of the residuals: 1 if they look normal. With a thousand pictures, p is small for any real model." }
            dt { "bytes, ns" } dd { "Memory, and time of the regression for one face. The blendshapes of the shipped model share parts; each gets an even share of its cost." }
        }
    }
}

/// Returns the name of the CPU on which the times were taken.
fn cpu() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| "an unknown CPU".to_owned(), |(_, name)| name.trim().to_owned())
}
