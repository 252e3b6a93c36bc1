//! `facewire-fit tune smoothing`: every kind of filter with many times for each part of the face.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use facewire::{
    config::Settings,
    preflight::shaping,
    solve::{BLENDSHAPES, COEFFS, Corrected, Filter, FilterKind, Filters, FiltersState, Group, HeadPose},
};
use rayon::prelude::*;

use super::{
    measure::{FPS, Sums},
    page,
    streams::{self, Stream},
    summary,
};
use crate::{html, output};

/// Arguments of `facewire-fit tune smoothing`.
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
pub const MOST_JITTER: f64 = 1.0 / 3.0;
/// The kinds to try.
pub const KINDS: [(FilterKind, &str); 6] = [
    (FilterKind::Kalman, "kalman"),
    (FilterKind::MovingAverage, "moving-average"),
    (FilterKind::TimeWeightedAverage, "time-weighted-average"),
    (FilterKind::LowPass, "low-pass"),
    (FilterKind::GatedAverage, "gated-average"),
    (FilterKind::OneEuro, "one-euro"),
];
/// The times to try, milliseconds.
const TIMES_MS: [u16; 10] = [40, 70, 80, 100, 130, 180, 220, 260, 300, 350];
/// Sizes of small changes to try, relative to that of the settings.
const SIZES: [f32; 5] = [0.4, 0.6, 1.0, 1.6, 2.5];

/// A part of the face, or the head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part {
    /// A group of coefficients.
    Group(Group),
    /// The rotation of the head.
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

/// One setting of a filter, with its figures.
#[derive(Clone, Copy)]
pub struct Trial {
    pub kind: FilterKind,
    pub time_ms: f32,
    /// Size of a small change, relative to that of the settings.
    pub size: f32,
    pub sums: Sums,
}

pub fn run(options: &Options) -> Result<()> {
    output::check(&options.out)?;
    let settings = Settings::default();
    let streams = streams::load(&options.folder, &settings)?;
    let (all, defaults) = (trials(&streams), shaping(&settings).filters);
    let default_sums = measured(&defaults, &streams);
    let mut sections = Vec::new();
    println!(
        "| part | setting | time ms | small | jitter | lag ms | same value ms | mse |\n|---|---|---|---|---|---|---|---|"
    );
    for (number, (part, name, most_lag_ms)) in PARTS.into_iter().enumerate() {
        let trials: Vec<Trial> = all.iter().map(|(trial, sums)| Trial { sums: sums[number], ..*trial }).collect();
        let best = best(&trials, most_lag_ms);
        let default = default_of(part, &defaults, &default_sums[number]);
        print_row(name, "best", &best);
        print_row(name, "default", &default);
        for (kind, _) in KINDS {
            let of_kind: Vec<Trial> = trials.iter().filter(|trial| trial.kind == kind).copied().collect();
            print_row(name, "best of kind", &self::best(&of_kind, most_lag_ms));
        }
        sections.push(page::section(name, &trials, &best, &default, most_lag_ms)?);
    }
    let summary = summary::of(&streams);
    print!("{summary}");
    html::write(&options.out, &page::html(&sections, &summary, streams.len()))
}

fn print_row(part: &str, what: &str, Trial { kind, time_ms, size, sums }: &Trial) {
    let name = kind_name(*kind);
    println!(
        "| {part} | {what}: {name} | {time_ms} | {size} | {:.3} | {:.1} | {:.1} | {:.5} |",
        sums.jitter(),
        sums.lag_ms(),
        sums.same_value_ms(),
        sums.mse()
    );
}

pub fn kind_name(kind: FilterKind) -> &'static str {
    KINDS.iter().find(|(known, _)| *known == kind).map_or("off", |(_, name)| name)
}

/// Measures every kind with every time, and the kinds that let large changes pass with every size of these.
fn trials(streams: &[Stream]) -> Vec<(Trial, [Sums; PARTS.len()])> {
    let is_adaptive = |kind| matches!(kind, FilterKind::Kalman | FilterKind::GatedAverage | FilterKind::OneEuro);
    let all = KINDS.iter().flat_map(|(kind, _)| TIMES_MS.map(|time_ms| (*kind, f32::from(time_ms))));
    let all = all.flat_map(|(kind, time_ms)| SIZES.map(|size| (kind, time_ms, size)));
    let all: Vec<_> = all.filter(|(kind, _, size)| is_adaptive(*kind) || (size - 1.0).abs() < 0.01).collect();
    let trial = |(kind, time_ms, size): (FilterKind, f32, f32)| {
        let mut filters = Filters::uniform(kind, time_ms / 1000.0);
        filters.coefficients.iter_mut().for_each(|filter| filter.small *= size);
        filters.head.rotation.small *= size;
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
        Part::Head => filters.head.rotation,
    };
    Trial { kind: filter.kind, time_ms: (filter.time_s * 1000.0).round(), size: 1.0, sums: *sums }
}

/// The most accurate trial among those that smooth enough and whose delay by both measures is at most `most_lag_ms`. If
/// there is none, the one with the least delay among those that smooth enough and whose delay by cross-correlation is at
/// most that; if there is none either, the one that smooths best among those with at most that delay by
/// cross-correlation.
pub fn best(trials: &[Trial], most_lag_ms: f64) -> Trial {
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

/// Measures every part of the face with these filters.
fn measured(filters: &Filters, streams: &[Stream]) -> [Sums; PARTS.len()] {
    let mut all = [Sums::default(); PARTS.len()];
    for stream in streams {
        let mut state = FiltersState::default();
        let step = |(coefficients, head): (&[f32; COEFFS], &HeadPose)| {
            let (smoothed, head) = filters.step(&mut state, &Corrected(*coefficients), head, 1.0 / FPS as f32);
            (smoothed.0, head)
        };
        let (coefficients, heads): (Vec<_>, Vec<_>) = stream.raw.iter().zip(&stream.raw_heads).map(step).unzip();
        for (sums, (part, ..)) in all.iter_mut().zip(PARTS) {
            *sums = [*sums, stream.sums(part, &coefficients, &heads, &STILL, &MOVING)].into_iter().sum();
        }
    }
    all
}
