//! A sine through renderer, camera and solver, beside the sine that generated it.

use std::f64::consts::TAU;

use anyhow::{Result, ensure};
use facewire_face::{BLENDSHAPES, Model};
use maud::{Markup, html};

use super::material::REST_FRAMES;
use crate::drawing::{Axis, BLUE_INK, Curve, GREY_INK, Mark, ORANGE_INK, curves};
use crate::judge::set::Clip;
use crate::output::{Table, figures, number};
use crate::shapes::index_of;
use crate::statistics::{mean, mse, pearson};
use crate::synth::script::{PERIOD_S, RATE};

/// How an estimate follows a sine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Following {
    pub r: f64,
    pub mse: f64,
    /// Amplitude of the estimate's wave of this period, relative to that of the truth.
    pub amplitude: f64,
    pub delay_ms: f64,
}

/// Amplitude below which an estimate has no delay.
const STILL: f64 = 0.05;

/// The wave of a period of so many frames in a curve of whole periods: its cosine and sine parts.
fn wave(values: &[f64], period: usize) -> [f64; 2] {
    let phase = |frame: usize| TAU * frame as f64 / period as f64;
    let scale = 2.0 / values.len() as f64;
    let parts =
        values.iter().enumerate().map(|(frame, value)| [value * phase(frame).cos(), value * phase(frame).sin()]);
    parts.fold([0.0; 2], |sum, part| [sum[0] + scale * part[0], sum[1] + scale * part[1]])
}

/// Compares an estimate with a sine of a period of so many frames. The delay is that of the phase, within half a period.
pub fn follow(estimate: &[f64], truth: &[f64], period: usize) -> Following {
    let whole = truth.len() / period * period;
    let (estimate, truth) = (&estimate[..whole], &truth[..whole]);
    let [own, wanted] = [estimate, truth].map(|curve| wave(curve, period));
    let size = |[cosine, sine]: [f64; 2]| cosine.hypot(sine);
    let behind = own[1].atan2(own[0]) - wanted[1].atan2(wanted[0]);
    let turns = (behind / TAU + 0.5).rem_euclid(1.0) - 0.5;
    let amplitude = size(own) / size(wanted);
    // What hardly moves has no phase.
    let delay_ms = if amplitude < STILL { f64::NAN } else { turns * period as f64 * 1000.0 / f64::from(RATE) };
    Following { r: pearson(estimate, truth), mse: mse(estimate, truth), amplitude, delay_ms }
}

pub struct Sines {
    pub html: Markup,
    /// Of jawOpen as sent, and the mean over all coefficients.
    pub jaw: Option<Following>,
    pub mean: Following,
}

/// The coefficients of which the page shows the curves, if the clip has them.
const SHOWN: [&str; 4] = ["jawOpen", "eyeBlinkLeft", "mouthSmileLeft", "browInnerUp"];

struct Driven {
    name: &'static str,
    truth: Vec<f64>,
    /// Before and after the filters.
    estimates: [Vec<f64>; 2],
}

impl Driven {
    /// Joins the frames of all clips in which this coefficient follows the sine.
    fn of(name: &'static str, clips: &[(&Clip, [Vec<Vec<f64>>; 2])]) -> Self {
        let shape = index_of(name);
        let mut driven = Self { name, truth: Vec::new(), estimates: [Vec::new(), Vec::new()] };
        for (clip, curves) in clips {
            let frames = clip.parts.of(name);
            driven.truth.extend(clip.truth.coefficients[frames.clone()].iter().map(|frame| frame[shape]));
            for (all, own) in driven.estimates.iter_mut().zip(curves) {
                all.extend(own[frames.clone()].iter().map(|frame| frame[shape]));
            }
        }
        driven
    }

    fn figures(&self) -> [Following; 2] {
        let period = (PERIOD_S * RATE as f32) as usize;
        self.estimates.each_ref().map(|estimate| follow(estimate, &self.truth, period))
    }

    fn chart(&self) -> Result<String> {
        let timed = |values: &[f64]| values.iter().enumerate().map(|(frame, value)| (seconds(frame), *value)).collect();
        let axes = [Axis::linear("s", [0.0, seconds(self.truth.len())]), Axis::linear(self.name, [0.0, 1.0])];
        let shown = [
            Curve::new(Mark::Dots, GREY_INK, timed(&self.estimates[0])),
            Curve::new(Mark::Line, BLUE_INK, timed(&self.estimates[1])),
            Curve::new(Mark::Dashes, ORANGE_INK, timed(&self.truth)),
        ];
        curves(&shown, &axes)
    }
}

fn seconds(frame: usize) -> f64 {
    frame as f64 / f64::from(RATE)
}

/// What the solver shows in each frame before and after the filters; 0 without a face.
fn shown(clip: &Clip, model: &Model) -> Result<[Vec<Vec<f64>>; 2]> {
    let neutral = clip.neutral(REST_FRAMES as u64)?;
    let shown = clip.shown(model, Some(&neutral));
    let values = |own: &[f32]| own.iter().map(|value| f64::from(*value)).collect::<Vec<_>>();
    let corrected =
        shown.iter().map(|own| own.solution.map_or(vec![0.0; BLENDSHAPES.len()], |s| values(&s.corrected.0)));
    let sent = shown.iter().map(|own| values(&own.pose.coefficients));
    Ok([corrected.collect(), sent.collect()])
}

pub fn section(clips: &[Clip], model: &Model) -> Result<Sines> {
    let solved = clips.iter().map(|clip| Ok((clip, shown(clip, model)?))).collect::<Result<Vec<_>>>()?;
    let is_driven = |name: &&&str| clips.iter().any(|clip| !clip.parts.of(name).is_empty());
    let driven: Vec<Driven> = BLENDSHAPES.iter().filter(is_driven).map(|name| Driven::of(name, &solved)).collect();
    ensure!(!driven.is_empty(), "no clip has a part for a coefficient: make them with `film --script sine`");
    let row = |name: &str, [corrected, sent]: [Following; 2]| {
        let own = |own: Following| [(own.r, 3), (own.mse, 4), (own.amplitude, 2), (own.delay_ms.round() + 0.0, 0)];
        let cells = own(corrected).into_iter().chain(own(sent));
        let cells = cells.map(|(value, decimals)| number(Some(value), decimals));
        [name.to_owned()].into_iter().chain(cells).collect::<Vec<_>>()
    };
    let all: Vec<[Following; 2]> = driven.iter().map(Driven::figures).collect();
    let means = [0, 1].map(|stage| {
        let of = |figure: fn(&Following) -> f64| {
            mean(all.iter().map(|own| figure(&own[stage])).filter(|value| value.is_finite()))
        };
        Following { r: of(|f| f.r), mse: of(|f| f.mse), amplitude: of(|f| f.amplitude), delay_ms: of(|f| f.delay_ms) }
    });
    let rows = driven.iter().zip(&all).map(|(driven, own)| row(driven.name, *own));
    let heads = [
        "blendshape",
        "r",
        "MSE",
        "amplitude",
        "delay, ms",
        "r, as sent",
        "MSE, as sent",
        "amplitude, as sent",
        "delay, as sent, ms",
    ];
    let table = Table::new(heads, rows.chain([row(&format!("mean of {}", driven.len()), means)]));
    let wanted = SHOWN.iter().filter_map(|name| driven.iter().find(|own| own.name == *name));
    let drawn = wanted.map(|own| Ok((own.chart()?, own.name))).collect::<Result<Vec<_>>>()?;
    let html = html! {
        p { "Each coefficient alone follows a sine of " (number(Some(PERIOD_S.into()), 1)) " s from 0 to 1, through renderer, camera, landmarks and solver, with the neutral face known. Dots: estimates before the filters; blue: as sent; orange dashes: the generating sine. The amplitude is that of the wave of this period relative to the sine's; the delay is that of its phase. The paper shows JawOpen and prints no figure; it finds that the model follows accurately, with instability at the top of the range." }
        (figures(&drawn, "Figure 10 (a)"))
        (table.html())
    };
    let jaw = driven.iter().position(|own| own.name == "jawOpen").map(|at| all[at][1]);
    Ok(Sines { html, jaw, mean: means[1] })
}
