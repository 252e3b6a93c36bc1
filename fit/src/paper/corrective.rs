//! Eq. 7 and 8: the corrective terms, as the paper prints them and as facewire uses them.

use anyhow::Result;
use facewire_face::model::CorrectiveTerms;
use maud::{Markup, html};

use super::material::Signal;
use crate::drawing::{Axis, BLUE_INK, Curve, GREEN_INK, GREY_INK, Mark, ORANGE_INK, PURPLE_INK, curves};
use crate::output::{Table, figures, number};
use crate::statistics::{mean, mse, pearson};
use crate::synth::rig::smoothstep;
use crate::synth::script::RATE;

/// The time scale `k` of eq. 8 in 1/s. The paper gives no value.
pub const K_PER_S: f64 = 2.0;

/// Eq. 8 as printed: `beta_t` is `f_t` while `f_t > f_t0 + exp(k (t0 - t))`, and else `beta_0`, with the least value so far
/// and its time as `f_t0` and `t0`.
pub struct PrintedShift {
    pub k_per_s: f64,
    pub beta_0: f64,
    minimum: Option<(f64, f64)>,
}

impl PrintedShift {
    pub fn new(k_per_s: f64, beta_0: f64) -> Self {
        Self { k_per_s, beta_0, minimum: None }
    }

    /// Returns the shift of the value `f` at `t_s`.
    pub fn step(&mut self, f: f64, t_s: f64) -> f64 {
        let (least, since_s) = *self.minimum.get_or_insert((f, t_s));
        if f <= least {
            self.minimum = Some((f, t_s));
            return self.beta_0;
        }
        if f > least + (self.k_per_s * (since_s - t_s)).exp() { f } else { self.beta_0 }
    }
}

/// The shift as a baseline: the same condition makes `f_t` the new minimum, which is taken away and not added.
#[derive(Default)]
pub struct Baseline(Option<(f64, f64)>);

impl Baseline {
    pub fn step(&mut self, f: f64, t_s: f64) -> f64 {
        let (least, since_s) = *self.0.get_or_insert((f, t_s));
        if f <= least || f > least + (K_PER_S * (since_s - t_s)).exp() {
            self.0 = Some((f, t_s));
        }
        -self.0.map_or(0.0, |(least, _)| least)
    }
}

/// The estimates of one reading of the shift: raw, shifted, weighted by `1 + g`, damped to `1 + g/eta`, and with `gamma`.
pub fn stages(raw: &[f64], beta: &[f64], terms: &CorrectiveTerms) -> [Vec<f64>; 5] {
    let shifted: Vec<f64> = raw.iter().zip(beta).map(|(f, beta)| f + beta).collect();
    let [from, to] = terms.response;
    let g = |value: f64| f64::from(smoothstep(from, to, value as f32));
    let gamma = f64::from(1.0 - terms.slope);
    let with = |factor: &dyn Fn(f64) -> f64| shifted.iter().map(|value| factor(g(*value)) * value).collect();
    let damped = |g: f64| 1.0 + f64::from(terms.lift) * g;
    let (weighted, all) = (with(&|g| 1.0 + g), with(&|g| damped(g) - gamma));
    [raw.to_vec(), shifted.clone(), weighted, with(&damped), all]
}

/// The same stages as facewire has them, of one person whose estimates are `rest` at rest, each within `0..=1`.
pub fn stages_as_used(raw: &[f64], rest: f64, terms: &CorrectiveTerms) -> [Vec<f64>; 5] {
    let rest = terms.rest_of(rest as f32);
    let with = |slope, lift| {
        let stage = CorrectiveTerms { slope, lift, ..*terms };
        raw.iter().map(|value| f64::from(stage.correct(*value as f32, rest, 1.0))).collect()
    };
    [raw.to_vec(), with(1.0, 0.0), with(1.0, 1.0), with(1.0, terms.lift), with(terms.slope, terms.lift)]
}

pub const STAGES: [&str; 5] = ["raw: w f + b", "+ beta", "× (1 + g)", "× (1 + g/eta)", "× (1 + g/eta - gamma)"];

const LAGS: usize = 30;

/// The estimates of each reading of the shift, one clip after the other: as printed, as a baseline, and as facewire has it,
/// with the rest of a calibration.
fn readings(signal: &Signal, terms: &CorrectiveTerms) -> Readings {
    let mut all = Readings::default();
    for frames in &signal.clips {
        let raw = &signal.raw[frames.clone()];
        let rest = mean(raw.iter().take(signal.rest_frames).copied());
        let (mut printed, mut baseline) = (PrintedShift::new(K_PER_S, 0.0), Baseline::default());
        let timed = || raw.iter().enumerate().map(|(frame, f)| (*f, frame as f64 / f64::from(RATE)));
        let printed: Vec<f64> = timed().map(|(f, t_s)| printed.step(f, t_s)).collect();
        let baseline: Vec<f64> = timed().map(|(f, t_s)| baseline.step(f, t_s)).collect();
        let of_clip = [stages(raw, &printed, terms), stages(raw, &baseline, terms), stages_as_used(raw, rest, terms)];
        all.as_flattened_mut().iter_mut().zip(of_clip.as_flattened()).for_each(|(all, own)| all.extend(own));
    }
    all
}

const READINGS: [&str; 3] =
    ["as printed", "as a baseline, subtracted", "as facewire has it: the rest of a calibration"];

pub struct Corrected {
    pub html: Markup,
    /// First-order autocorrelation of the raw estimates, and shifted as printed and by a baseline.
    pub autocorrelations: [f64; 3],
    /// Mean of the estimates at shut eyes, raw and corrected.
    pub closures: [f64; 2],
}

/// The estimates of each reading of the shift, by stage.
type Readings = [[Vec<f64>; STAGES.len()]; READINGS.len()];

fn clamped(values: &[f64]) -> Vec<f64> {
    values.iter().map(|value| value.clamp(0.0, 1.0)).collect()
}

fn table(signal: &Signal, readings: &Readings) -> Table {
    let row = |reading: &str, stage: &str, values: &[f64]| {
        let shown = clamped(values);
        let figures = [
            (signal.autocorrelation(values, 1)[1], 3),
            (pearson(&shown, &signal.truth), 3),
            (mse(&shown, &signal.truth), 4),
            (signal.shut(&shown), 2),
            (signal.open(&shown), 2),
        ];
        let figures = figures.map(|(value, decimals)| number(Some(value), decimals));
        [stage.to_owned(), reading.to_owned()].into_iter().chain(figures).collect::<Vec<_>>()
    };
    let mut rows = vec![row("-", STAGES[0], &signal.raw)];
    for (reading, stages) in READINGS.iter().zip(readings) {
        rows.extend(STAGES.iter().zip(stages).skip(1).map(|(stage, values)| row(reading, stage, values)));
    }
    let heads =
        ["estimates", "beta", "autocorrelation at lag 1", "r", "MSE", "mean at truth > 0.9", "mean at truth < 0.1"];
    Table::new(heads, rows)
}

fn shift_chart(signal: &Signal, [printed, baseline, used]: &Readings) -> Result<String> {
    let frames = signal.lively();
    let curve = |mark, ink, values: &[f64]| Curve::new(mark, ink, signal.timed(values, &frames));
    let shown = [
        curve(Mark::Dots, GREY_INK, &printed[0]),
        curve(Mark::Line, ORANGE_INK, &printed[1]),
        curve(Mark::Line, PURPLE_INK, &baseline[1]),
        curve(Mark::Line, BLUE_INK, &used[1]),
    ];
    let length_s = frames.len() as f64 / f64::from(RATE);
    curves(&shown, &[Axis::linear("s", [0.0, length_s]), Axis::linear("coefficient", [-0.5, 2.0])])
}

/// Draws what a corrective term makes of each value, for two blendshapes.
fn response_chart(terms: [&CorrectiveTerms; 2]) -> Result<String> {
    let response = |terms: &CorrectiveTerms| {
        let value = |percent: u8| f32::from(percent) / 100.0;
        (0..=100).map(|at| (f64::from(value(at)), f64::from(terms.correct(value(at), 0.0, 1.0)))).collect()
    };
    let shown = [
        Curve::new(Mark::Dashes, GREY_INK, vec![(0.0, 0.0), (1.0, 1.0)]),
        Curve::new(Mark::Line, BLUE_INK, response(terms[0])),
        Curve::new(Mark::Line, ORANGE_INK, response(terms[1])),
    ];
    curves(&shown, &[Axis::linear("w f + b + beta", [0.0, 1.0]), Axis::linear("corrected", [0.0, 1.0])])
}

fn correlation_chart(signal: &Signal, [printed, _, used]: &Readings) -> Result<String> {
    let curve = |mark, ink, values: &[f64]| {
        let lags = signal.autocorrelation(values, LAGS).into_iter().enumerate();
        Curve::new(mark, ink, lags.map(|(lag, value)| (lag as f64, value)).collect())
    };
    let shown = [
        curve(Mark::Line, GREY_INK, &printed[0]),
        curve(Mark::Line, ORANGE_INK, &printed[1]),
        curve(Mark::Line, PURPLE_INK, &printed[2]),
        curve(Mark::Dashes, GREEN_INK, &printed[3]),
        curve(Mark::Line, BLUE_INK, &used[4]),
    ];
    curves(&shown, &[Axis::linear("lag, frames", [0.0, LAGS as f64]), Axis::linear("autocorrelation", [-0.5, 1.0])])
}

fn corrected_chart(signal: &Signal, used: &[Vec<f64>; STAGES.len()]) -> Result<String> {
    let frames = signal.lively();
    let shown = [
        Curve::new(Mark::Dashes, GREEN_INK, signal.timed(&signal.truth, &frames)),
        Curve::new(Mark::Dots, GREY_INK, signal.timed(&used[0], &frames)),
        Curve::new(Mark::Line, BLUE_INK, signal.timed(&clamped(&used[4]), &frames)),
    ];
    let length_s = frames.len() as f64 / f64::from(RATE);
    curves(&shown, &[Axis::linear("s", [0.0, length_s]), Axis::linear("coefficient", [-0.2, 1.2])])
}

/// Draws figure 8 for a blendshape, whose weight function is compared with that of another one.
pub fn section(signal: &Signal, terms: &CorrectiveTerms, other: (&'static str, &CorrectiveTerms)) -> Result<Corrected> {
    let readings = readings(signal, terms);
    let responses = format!(
        "(b) Two weight functions as facewire applies them: {} (blue) and {} (orange)",
        signal.blendshape, other.0
    );
    let drawn = [
        (
            shift_chart(signal, &readings)?,
            "(a) Raw (dots), and shifted by eq. 8 as printed (orange: it doubles what is held), by the same as a baseline \
             that is subtracted (purple), and by the calibrated rest that facewire uses (blue)",
        ),
        (response_chart([terms, other.1])?, responses.as_str()),
        (
            correlation_chart(signal, &readings)?,
            "(c) Autocorrelation: raw (grey); as printed: shifted (orange), weighted (purple), damped (green); all terms \
             as facewire has them (blue)",
        ),
        (corrected_chart(signal, &readings[2])?, "(d) Truth (dashes), initial (dots) and corrected estimates (blue)"),
    ];
    let html = html! {
        p { "Eq. 7 and 8 on " (signal.raw.len()) " frames of " (signal.blendshape) ", solved by the formula w f + b of the paper's method without a known neutral face, as for a new person; k = " (K_PER_S) "/s and beta_0 = 0. g, eta and gamma are those of the model: g rises from 0 to 1 between " (terms.response[0]) " and " (terms.response[1]) ", 1/eta = " (number(Some(terms.lift.into()), 3)) ", gamma = " (number(Some((1.0 - terms.slope).into()), 3)) ". Autocorrelations are averaged over the clips." }
        (figures(&drawn, "Figure 8"))
        (table(signal, &readings).html())
        p { "The paper finds that the shift changes the autocorrelation most, and that weighting and damping do not. It prints no values. Compare the rows \"+ beta\" with the raw ones: the reading whose autocorrelation differs most is the one that the paper's figure fits. As printed, eq. 8 adds the value to itself as soon as exp(k (t0 - t)) has fallen below its height, so that every expression longer than about 1/k counts twice; the baseline that is subtracted lets a held expression fade. Neither serves the purpose, so facewire subtracts what a calibration measures at rest, divides by what is left of the range, so that 1 stays 1, and clamps the result to 0..1." }
    };
    let [printed, baseline, used] = &readings;
    let autocorrelations = [&printed[0], &printed[1], &baseline[1]].map(|values| signal.autocorrelation(values, 1)[1]);
    let closures = [0, 4].map(|stage| signal.shut(&clamped(&used[stage])));
    Ok(Corrected { html, autocorrelations, closures })
}
