//! `facewire-fit tune`: finds parameters from clips with truth. The corrective terms have a module of their own; here is the
//! trial of every kind of filter with many times for each part of the face.

pub mod correction;
pub mod measure;

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, Subcommand};
use facewire::config::Settings;
use facewire::pipeline::shaping;
use facewire_face::stages::{Coefficients, FiltersState};
use facewire_face::{BLENDSHAPES, COEFFS, Filter, FilterKind, Filters, Group, HeadPose};
use maud::{Markup, html};
use plotters::prelude::*;
use rayon::prelude::*;

use self::measure::{FPS, Frames, Stream, Sums, summary_of};
use crate::drawing::{Axis, chart, svg};
use crate::judge::set::Clip;
use crate::output::{self, Table, figures, number};

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Find the corrective terms (eq. 7) of every blendshape, and write the model with them
    Correction(correction::Options),
    /// Try every filter with many times on each part of the face, and plot the delay against the jitter of a face at rest
    Smoothing(Options),
}

pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Correction(options) => correction::run(options),
        Command::Smoothing(options) => smoothing(options),
    }
}

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  facewire-fit film wearers --count 8 --script wearer
  facewire-fit tune smoothing wearers --out smoothing.html")]
pub struct Options {
    /// A folder of clips with truth and parts, as `film --script wearer` makes them
    folder: PathBuf,
    /// The page to write
    #[arg(long, value_name = "FILE.html", default_value = "smoothing.html")]
    out: PathBuf,
}

/// Most jitter that is left at rest, as a share of that without a filter.
const MOST_JITTER: f64 = 1.0 / 3.0;
/// The kinds to try, each with its name in the settings and its colour.
pub const KINDS: [(FilterKind, &str, RGBColor); 7] = [
    (FilterKind::Kalman, "kalman", RGBColor(47, 126, 216)),
    (FilterKind::MovingAverage, "moving-average", RGBColor(230, 126, 34)),
    (FilterKind::TimeWeightedAverage, "time-weighted-average", RGBColor(241, 196, 15)),
    (FilterKind::LowPass, "low-pass", RGBColor(127, 140, 141)),
    (FilterKind::GatedAverage, "gated-average", RGBColor(39, 174, 96)),
    (FilterKind::GatedAsPrinted, "gated-as-printed", RGBColor(192, 57, 43)),
    (FilterKind::OneEuro, "one-euro", RGBColor(155, 89, 182)),
];
const TIMES_MS: [u16; 10] = [40, 70, 80, 100, 130, 180, 220, 260, 300, 350];
/// Sizes of small changes to try, relative to that of the settings.
const SIZES: [f32; 5] = [0.4, 0.6, 1.0, 1.6, 2.5];

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part {
    Group(Group),
    Head,
}

/// The parts, with their names in the settings and the delay that they may have.
pub const PARTS: [(Part, &str, f64); 7] = [
    (Part::Group(Group::Lids), "lids", 20.0),
    (Part::Group(Group::Gaze), "gaze", 40.0),
    (Part::Group(Group::Brows), "brows", 40.0),
    (Part::Group(Group::Mouth), "mouth", 40.0),
    (Part::Group(Group::Jaw), "jaw", 40.0),
    (Part::Group(Group::Cheeks), "cheeks", 40.0),
    (Part::Head, "head", 40.0),
];

#[derive(Clone, Copy)]
struct Trial {
    kind: FilterKind,
    time_ms: f32,
    /// Size of a small change, relative to that of the settings.
    size: f32,
    sums: Sums,
}

fn smoothing(options: &Options) -> Result<()> {
    output::check(&options.out)?;
    let clips = Clip::load_all(&options.folder, true)?.into_iter();
    let streams = clips.map(Stream::of).collect::<Result<Vec<_>>>()?;
    let (all, defaults) = (trials(&streams), shaping(&Settings::default()).filters);
    let default_sums = measured(&defaults, &streams);
    let mut sections = Vec::new();
    let mut rows = Vec::new();
    for (index, (part, name, most_lag_ms)) in PARTS.into_iter().enumerate() {
        let trials: Vec<Trial> = all.iter().map(|(trial, sums)| Trial { sums: sums[index], ..*trial }).collect();
        let best = best(&trials, most_lag_ms);
        let default = default_of(part, &defaults, &default_sums[index]);
        rows.extend([printed_row(name, "best", &best), printed_row(name, "default", &default)]);
        for (kind, ..) in KINDS {
            let of_kind: Vec<Trial> = trials.iter().filter(|trial| trial.kind == kind).copied().collect();
            rows.push(printed_row(name, "best of kind", &self::best(&of_kind, most_lag_ms)));
        }
        sections.push(section(name, &trials, &best, &default, most_lag_ms)?);
    }
    let heads = ["part", "setting", "time ms", "noise size", "jitter", "lag ms", "same value ms", "mse"];
    print!("{}", Table::new(heads, rows).text());
    let summary = summary_of(&streams);
    print!("{}", summary.text());
    let body = page(&sections, &summary, streams.len());
    output::write_page(&options.out, "Filters", &[], &PARTS.map(|(_, name, _)| name.to_owned()), &body)
}

fn row<const N: usize>(first: [String; 2], trial: &Trial, figures: [(fn(&Sums) -> f64, usize); N]) -> Vec<String> {
    let figures = figures.map(|(figure, decimals)| number(Some(figure(&trial.sums)), decimals));
    first.into_iter().chain([trial.time_ms.to_string(), trial.size.to_string()]).chain(figures).collect()
}

fn printed_row(part: &str, what: &str, trial: &Trial) -> Vec<String> {
    let first = [part.to_owned(), format!("{what}: {}", kind_name(trial.kind))];
    row(first, trial, [(Sums::jitter, 3), (Sums::lag_ms, 1), (Sums::same_value_ms, 1), (Sums::mse, 5)])
}

fn kind_name(kind: FilterKind) -> &'static str {
    KINDS.iter().find(|own| own.0 == kind).map_or("off", |own| own.1)
}

/// Measures every kind with every time, and the kinds that let large changes pass with every size of these.
fn trials(streams: &[Stream]) -> Vec<(Trial, [Sums; PARTS.len()])> {
    let is_adaptive = |kind| matches!(kind, FilterKind::Kalman | FilterKind::GatedAverage | FilterKind::OneEuro);
    let all = KINDS.iter().flat_map(|(kind, ..)| TIMES_MS.map(|time_ms| (*kind, f32::from(time_ms))));
    let all = all.flat_map(|(kind, time_ms)| SIZES.map(|size| (kind, time_ms, size)));
    let all: Vec<_> = all.filter(|(kind, _, size)| is_adaptive(*kind) || (size - 1.0).abs() < 0.01).collect();
    let trial = |(kind, time_ms, size): (FilterKind, f32, f32)| {
        let mut filters = Filters::uniform(kind, time_ms / 1000.0);
        filters.coefficients.iter_mut().for_each(|filter| filter.noise_size *= size);
        filters.rotation.noise_size *= size;
        (Trial { kind, time_ms, size, sums: Sums::default() }, measured(&filters, streams))
    };
    all.into_par_iter().map(trial).collect()
}

fn default_of(part: Part, filters: &Filters, sums: &Sums) -> Trial {
    let filter = match part {
        Part::Group(group) => {
            let filters = BLENDSHAPES.iter().zip(filters.coefficients).find(|(name, _)| Group::of(name) == group);
            filters.map_or(Filter::OFF, |(_, filter)| filter)
        }
        Part::Head => filters.rotation,
    };
    Trial { kind: filter.kind, time_ms: (filter.time_s * 1000.0).round(), size: 1.0, sums: *sums }
}

/// The most accurate trial among those that smooth enough and whose delay by both measures is at most `most_lag_ms`; else
/// the one with the least delay among those that smooth enough and whose delay by cross-correlation is at most that; else
/// the one that smooths best among the latter.
fn best(trials: &[Trial], most_lag_ms: f64) -> Trial {
    let delay = |trial: &Trial| trial.sums.lag_ms().max(0.0) + trial.sums.same_value_ms();
    let fast = trials.iter().filter(|trial| trial.sums.lag_ms() <= most_lag_ms);
    let good = fast.clone().filter(|trial| trial.sums.jitter() <= MOST_JITTER);
    let soon = good.clone().filter(|trial| trial.sums.same_value_ms() <= most_lag_ms);
    let accurate = soon.min_by(|a, b| a.sums.mse().total_cmp(&b.sums.mse()));
    let chosen = accurate.or_else(|| good.min_by(|a, b| delay(a).total_cmp(&delay(b))));
    let chosen = chosen.or_else(|| fast.min_by(|a, b| a.sums.jitter().total_cmp(&b.sums.jitter())));
    *chosen.unwrap_or(&trials[0])
}

/// Parts of a clip in which a face is at rest, and those in which it moves.
const STILL: [&str; 1] = ["still"];
const MOVING: [&str; 4] = ["talk", "judged", "blinks", "winks"];

fn measured(filters: &Filters, streams: &[Stream]) -> [Sums; PARTS.len()] {
    let mut all = [Sums::default(); PARTS.len()];
    for stream in streams {
        let mut state = FiltersState::default();
        let step = |(face, head): &([f32; COEFFS], HeadPose)| {
            let (smoothed, head) = filters.step(&mut state, &Coefficients(*face), head, 1.0 / FPS as f32);
            (smoothed.0, head)
        };
        let filtered: Frames = stream.raw.iter().map(step).collect();
        for (sums, (part, ..)) in all.iter_mut().zip(PARTS) {
            *sums = [*sums, stream.sums(part, &filtered, &STILL, &MOVING)].into_iter().sum();
        }
    }
    all
}

const SIZE_PX: (u32, u32) = (520, 360);
const MOST_MS: f64 = 160.0;

fn section(name: &str, trials: &[Trial], best: &Trial, default: &Trial, most_lag_ms: f64) -> Result<Markup> {
    let by_lag = plot(trials, best, most_lag_ms, |trial| trial.sums.lag_ms())?;
    let by_value = plot(trials, best, most_lag_ms, |trial| trial.sums.same_value_ms())?;
    let limits = "Delay by cross-correlation with the truth. The lines are the limits, the ring is the best setting";
    let drawn = [(by_lag, limits), (by_value, "Mean time until the same value appears")];
    let row = |what: &str, trial: &Trial| {
        let figures: [(fn(&Sums) -> f64, usize); 3] = [(Sums::jitter, 2), (Sums::lag_ms, 0), (Sums::same_value_ms, 0)];
        row([what.to_owned(), kind_name(trial.kind).to_owned()], trial, figures)
    };
    let heads = ["setting", "filter", "time, ms", "noise size, relative", "jitter", "lag, ms", "same value, ms"];
    Ok(html! {
        section id=(name) {
            h2 { (name) }
            (Table::new(heads, [row("best", best), row("default", default)]).html())
            (figures(&drawn, name))
        }
    })
}

fn plot(trials: &[Trial], best: &Trial, most_lag_ms: f64, delay_ms: impl Fn(&Trial) -> f64) -> Result<String> {
    let axes = [Axis::linear("delay, ms", [-10.0, MOST_MS]), Axis::linear("jitter left", [0.0, 1.0])];
    let point = |trial: &Trial| (delay_ms(trial), trial.sums.jitter());
    svg(SIZE_PX, |area| {
        let mut chart = chart(area, &axes)?;
        for (kind, _, ink) in KINDS {
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

fn page(sections: &[Markup], summary: &Table, clips: usize) -> Markup {
    html! {
        p { (clips) " rendered wearers at 30 frames a second. Jitter is the standard deviation over 2 seconds of a still face with the camera's noise, as a share of that before the filter. A line leads through the times of one kind of filter from 40 to 350 ms; points are other sizes of a small change." }
        p { @for (_, name, ink) in &KINDS { span style=(format!("color: rgb({},{},{})", ink.0, ink.1, ink.2)) { "■ " (name) " " } } }
        h2 { "With the default settings, as sent" }
        (summary.html())
        @for section in sections { (section) }
    }
}
