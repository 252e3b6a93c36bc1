//! The page of filters: for each part of the face a plot of delay against jitter.

use anyhow::Result;
use maud::{Markup, html};
use plotters::prelude::*;

use super::{
    smoothing::{KINDS, MOST_JITTER, Trial, kind_name},
    summary::Summary,
};
use crate::{
    drawing::{Axes, Axis, svg},
    html::{RowHeader, figure, page, table},
};

const SIZE_PX: (u32, u32) = (520, 360);
/// One colour for each of [`KINDS`].
const INKS: [RGBColor; 6] = [
    RGBColor(47, 126, 216),
    RGBColor(230, 126, 34),
    RGBColor(241, 196, 15),
    RGBColor(127, 140, 141),
    RGBColor(39, 174, 96),
    RGBColor(155, 89, 182),
];
/// Longest delay that a plot shows.
const MOST_MS: f64 = 160.0;

/// The section of one part of the face.
pub fn section(name: &str, trials: &[Trial], best: &Trial, default: &Trial, most_lag_ms: f64) -> Result<Markup> {
    let by_lag = plot(trials, best, most_lag_ms, |trial| trial.sums.lag_ms())?;
    let by_value = plot(trials, best, most_lag_ms, |trial| trial.sums.same_value_ms())?;
    let row = |what: &'static str, trial: &Trial| {
        let cells = vec![
            kind_name(trial.kind).to_owned(),
            format!("{}", trial.time_ms),
            format!("{}", trial.size),
            format!("{:.2}", trial.sums.jitter()),
            format!("{:.0}", trial.sums.lag_ms()),
            format!("{:.0}", trial.sums.same_value_ms()),
        ];
        (RowHeader { name: what, link: false }, cells)
    };
    let heads = ["filter", "time, ms", "small, relative", "jitter", "lag, ms", "same value, ms"];
    Ok(html! {
        section id=(name) {
            h2 { (name) }
            (table("setting", &heads, &[row("best", best), row("default", default)]))
            div.figures {
                (figure(&by_lag, "Delay by cross-correlation with the truth. The lines are the limits, the ring is the best setting", name))
                (figure(&by_value, "Mean time until the same value appears", name))
            }
        }
    })
}

/// Plots each kind as a line through its times.
fn plot(trials: &[Trial], best: &Trial, most_lag_ms: f64, delay_ms: impl Fn(&Trial) -> f64) -> Result<String> {
    let axes = Axes { x: Axis::linear("delay, ms", [-10.0, MOST_MS]), y: Axis::linear("jitter left", [0.0, 1.0]) };
    let point = |trial: &Trial| (delay_ms(trial), trial.sums.jitter());
    svg(SIZE_PX, |area| {
        let mut chart = axes.draw(area)?;
        for (kind, ink) in KINDS.iter().map(|(kind, _)| *kind).zip(INKS) {
            let of_kind = trials.iter().filter(|trial| trial.kind == kind);
            let shown = of_kind.clone().filter(|trial| delay_ms(trial) < MOST_MS);
            chart.draw_series(shown.clone().map(|trial| Circle::new(point(trial), 2, ink.mix(0.4).filled())))?;
            let usual = shown.filter(|trial| (trial.size - 1.0).abs() < 0.01);
            chart.draw_series(LineSeries::new(usual.map(point), ink.stroke_width(2)))?;
        }
        for limit in [[(-10.0, MOST_JITTER), (MOST_MS, MOST_JITTER)], [(most_lag_ms, 0.0), (most_lag_ms, 1.0)]] {
            chart.draw_series(LineSeries::new(limit, BLACK.mix(0.4).stroke_width(1)))?;
        }
        chart.draw_series([Circle::new(point(best), 6, BLACK.stroke_width(2))])?;
        Ok(())
    })
}

/// The whole page.
pub fn html(sections: &[Markup], summary: &Summary, clips: usize) -> String {
    let body = html! {
        header {
            h1 { "Filters" }
            p { (clips) " rendered wearers at 30 frames a second. Jitter is the standard deviation over 2 seconds of a still face with the camera's noise, as a share of that before the filter. A line leads through the times of one kind of filter from 40 to 350 ms; points are other sizes of a small change." }
            p { @for ((_, name), ink) in KINDS.iter().zip(INKS) { span style=(format!("color: rgb({},{},{})", ink.0, ink.1, ink.2)) { "■ " (name) " " } } }
        }
        main {
            h2 { "With the default settings, as sent" }
            pre { (summary) }
            @for section in sections { (section) }
        }
    };
    page("filters", &body)
}
