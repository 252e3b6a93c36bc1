//! Eq. 9 to 11: the smoothers with 5 and 10 previous states, by autocorrelation and delay.

use anyhow::{Context, Result};
use facewire_face::stages::{Coefficients, FiltersState};
use facewire_face::{FilterKind, Filters, HeadPose, Model};
use maud::{Markup, html};

use super::material::{REST_FRAMES, Signal};
use crate::drawing::{Axis, BLUE_INK, Curve, GREEN_INK, GREY_INK, Mark, ORANGE_INK, PURPLE_INK, curves};
use crate::judge::set::Clip;
use crate::output::{Table, figures, number};
use crate::shapes::index_of;
use crate::statistics::{autocorrelation, mean, standard_deviation};
use crate::tune::KINDS;
use crate::tune::measure::{FPS, Sums};

/// The numbers of previous states that the paper compares.
const STATES: [u8; 2] = [5, 10];
/// The delay that the paper gives for its gated average with 5 states, milliseconds.
pub const PAPERS_DELAY_MS: f64 = 59.0;

pub type Track = Vec<(Coefficients, HeadPose)>;

/// Returns what the solver makes of a clip before the filters. A frame without a face repeats the frame before.
pub fn track(clip: &Clip, model: &Model) -> Result<Track> {
    let neutral = clip.neutral(REST_FRAMES as u64)?;
    let mut track = Track::new();
    for shown in clip.shown(model, Some(&neutral)) {
        let solved = shown.solution.map(|solved| (solved.corrected, solved.raw_head));
        track.push(solved.or_else(|| track.last().copied()).context("no face in the first frame")?);
    }
    Ok(track)
}

/// Smooths a coefficient over so many states at 30 frames a second.
pub fn smooth(kind: FilterKind, states: u8, track: &Track, shape: usize) -> Vec<f64> {
    // A thousandth of a second more, so that rounding does not exclude the oldest state.
    let filters = Filters::uniform(kind, f32::from(states) / FPS as f32 + 0.001);
    let mut state = FiltersState::default();
    let step = |(face, head): &(Coefficients, HeadPose)| {
        f64::from(filters.step(&mut state, face, head, 1.0 / FPS as f32).0.0[shape])
    };
    track.iter().map(step).collect()
}

pub struct Smoothed {
    pub html: Markup,
    /// First-order autocorrelation of the same curves without a filter.
    pub off: f64,
    /// First-order autocorrelation and delay of the gated average, as facewire has it and as printed, with 5 states and
    /// with 10.
    pub gated: [[[f64; 2]; 2]; 2],
    /// By how much the autocorrelation with 5 states exceeds that with 10, for each filter.
    pub excess: String,
}

struct Row {
    kind: FilterKind,
    name: &'static str,
    states: u8,
    /// First-order autocorrelation in each clip.
    autocorrelations: Vec<f64>,
    sums: Sums,
}

impl Row {
    fn autocorrelation(&self) -> f64 {
        mean(self.autocorrelations.iter().copied())
    }
}

/// States by how much an autocorrelation exceeds another one, clip by clip: mean and standard deviation.
pub fn excess(name: &str, [own, other]: [&[f64]; 2]) -> String {
    let differences: Vec<f64> = own.iter().zip(other).map(|(own, other)| own - other).collect();
    let [centre, spread] = [mean(differences.iter().copied()), standard_deviation(&differences)];
    let higher = differences.iter().filter(|difference| **difference > 0.0).count();
    format!("{name} {centre:+.4} ± {spread:.4} (above 0 in {higher} of {} clips)", differences.len())
}

fn row(clips: &[(&Clip, Track)], shape: usize, (kind, name): (FilterKind, &'static str), states: u8) -> Row {
    let (mut autocorrelations, mut sums) = (Vec::new(), Vec::new());
    for (clip, track) in clips {
        let raw: Vec<f64> = track.iter().map(|(face, _)| f64::from(face.0[shape])).collect();
        let truth: Vec<f64> = clip.truth.coefficients.iter().map(|frame| frame[shape]).collect();
        let smoothed = smooth(kind, states, track, shape);
        let (rest, rest_of_clip) = (0..REST_FRAMES, REST_FRAMES..raw.len());
        sums.push(Sums::of([&raw, &smoothed, &truth], &[rest], &[rest_of_clip]));
        autocorrelations.push(autocorrelation(&smoothed, 1)[1]);
    }
    Row { kind, name, states, autocorrelations, sums: sums.into_iter().sum() }
}

pub fn section(clips: &[Clip], model: &Model, signal: &Signal) -> Result<Smoothed> {
    let shape = index_of(signal.blendshape);
    let tracks = clips.iter().map(|clip| Ok((clip, track(clip, model)?))).collect::<Result<Vec<_>>>()?;
    let kinds = KINDS.iter().map(|(kind, name, _)| (*kind, *name));
    let of_states = |kind| STATES.iter().map(move |states| (kind, *states));
    let off = row(&tracks, shape, (FilterKind::Off, "off"), 0);
    let rows: Vec<Row> = kinds.flat_map(of_states).map(|(kind, states)| row(&tracks, shape, kind, states)).collect();
    let cells = |own: &Row| {
        let figures = [
            (own.autocorrelation(), 4),
            (standard_deviation(&own.autocorrelations), 4),
            (own.sums.same_value_ms(), 0),
            (own.sums.lag_ms(), 0),
            (own.sums.jitter(), 2),
            (own.sums.mse(), 4),
        ];
        let states = if own.states == 0 { "-".to_owned() } else { own.states.to_string() };
        let figures = figures.map(|(value, decimals)| number(Some(value), decimals));
        [own.name.to_owned(), states].into_iter().chain(figures).collect::<Vec<_>>()
    };
    let papers = ["  paper: gated-average", "5", "highest", "-", "59", "-", "-", "-"].map(str::to_owned).to_vec();
    let heads = [
        "filter",
        "N",
        "autocorrelation at lag 1",
        "deviation over clips",
        "same value, ms",
        "lag, ms",
        "jitter left",
        "MSE",
    ];
    let table = Table::new(heads, [cells(&off)].into_iter().chain(rows.iter().map(cells)).chain([papers]));
    let gated = [FilterKind::GatedAverage, FilterKind::GatedAsPrinted].map(|kind| {
        STATES.map(|states| {
            let own = rows.iter().find(|row| row.kind == kind && row.states == states);
            own.map_or([f64::NAN; 2], |row| [row.autocorrelation(), row.sums.same_value_ms()])
        })
    });
    let pairs = rows.chunks_exact(STATES.len());
    let excesses = pairs.map(|pair| excess(pair[0].name, [&pair[0].autocorrelations, &pair[1].autocorrelations]));
    let excess = excesses.collect::<Vec<_>>().join(", ");
    let html = html! {
        p { "Every filter of facewire on " (tracks.iter().map(|own| own.1.len()).sum::<usize>()) " frames of " (signal.blendshape) " before the filters, corrected and with a known neutral face, at 30 frames a second, with N previous states. \"Same value\" is the mean time until the filter returns a value that it was given, the paper's measure; lag is the delay that the filter adds: the delay behind the truth, by cross-correlation, less that without a filter. Autocorrelations are those within a clip, as mean and standard deviation over " (tracks.len()) " clips. Jitter is the standard deviation in the first " (REST_FRAMES) " frames of a clip, which are at rest, relative to that without a filter; a filter that averages 10 states never has them all there." }
        (table.html())
        (figures(&[(chart(signal, &tracks, shape)?, CAPTION)], "Figure 9"))
        p { "The paper reports that its gated average has the highest first-order autocorrelation with 5 states and not with 10, and that the same value appears after " (number(Some(PAPERS_DELAY_MS), 0)) " ms on average. It does not say at which frame rate. Here, the value with 5 states minus that with 10, as mean and standard deviation over clips: " (excess) "." }
    };
    Ok(Smoothed { html, off: off.autocorrelation(), gated, excess })
}

const CAPTION: &str = "Before the filters (dots), the gated average (blue) and eq. 11 as printed (orange), the moving \
                       average (purple), each with N = 5, and the truth (dashes), over two seconds";

fn chart(signal: &Signal, tracks: &[(&Clip, Track)], shape: usize) -> Result<String> {
    let lively = signal.lively();
    let frames = lively.start..(lively.start + 60).min(lively.end);
    let of = |kind: FilterKind| {
        let all: Vec<f64> = tracks.iter().flat_map(|(_, track)| smooth(kind, STATES[0], track, shape)).collect();
        signal.timed(&all, &frames)
    };
    let shown = [
        Curve::new(Mark::Dashes, GREEN_INK, signal.timed(&signal.truth, &frames)),
        Curve::new(Mark::Dots, GREY_INK, of(FilterKind::Off)),
        Curve::new(Mark::Line, PURPLE_INK, of(FilterKind::MovingAverage)),
        Curve::new(Mark::Line, ORANGE_INK, of(FilterKind::GatedAsPrinted)),
        Curve::new(Mark::Line, BLUE_INK, of(FilterKind::GatedAverage)),
    ];
    curves(&shown, &[Axis::linear("s", [0.0, 2.0]), Axis::linear("coefficient", [0.0, 1.0])])
}
