//! `facewire-fit evaluate`: compares the curves of a tracker with true curves, or with those of another tracker.

mod align;
mod score;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use self::align::{Aligned, Annotations};
use crate::output;
use crate::recording::Recording;
use crate::statistics::EventLimits;

const AFTER_HELP: &str = "\
Accepts the CSV of `facewire track`, recordings of Live Link Face, and any table with blendshape names in its header and
a column time_s or frame. Columns are matched by name. The truth is interpolated at the times of TRACK.
Correlations are given where the truth moves (standard deviation above 0.02), jitter where it rests.
An event is a rise of the truth to f-min after a fall below half of it, or a line of EVENTS (blendshape,time_s or
blendshape,frame, counted from the truth's first row). It is found if TRACK rises to f-min within the tolerance. Each
rise finds one event. EVENTS may also tell when an event ends (end_s or end_frame).
J is recall minus the share of false time: of the frames further than the tolerance from every event, that part in which
TRACK is at least f-min.

Examples:
  facewire track demo --out track.csv && facewire-fit evaluate track.csv truth.csv
  facewire-fit evaluate track.csv MySlate_5_iPhone.csv --shift auto --overlap --json scores.json
  facewire-fit evaluate track.csv track.csv --events seen-by-eye.csv";

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct EvaluateArgs {
    /// The curves to judge (CSV)
    track: PathBuf,
    /// The true curves, or those of another tracker (CSV)
    truth: PathBuf,
    /// Annotated events, instead of events derived from the truth
    #[arg(long, value_name = "EVENTS.csv")]
    events: Option<PathBuf>,
    /// JSON file for all results
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Frames by which TRACK lags the truth, or `auto` for the best lag within 2 seconds
    #[arg(long, value_name = "FRAMES", default_value = "0", allow_negative_numbers = true, value_parser = parse_shift)]
    shift: Shift,
    /// Judge the overlap of two recordings of different length
    #[arg(long)]
    overlap: bool,
    /// Frame rate of tables without times
    #[arg(long, default_value_t = 30.0, value_parser = positive)]
    fps: f64,
    /// Coefficient from which on an expression counts as an event
    #[arg(long, default_value_t = 0.3, value_parser = positive)]
    f_min: f64,
    /// Largest distance in time between an event and the rise that finds it (the paper: about 15 frames)
    #[arg(long, default_value_t = 0.5, value_parser = positive)]
    tolerance_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shift {
    Frames(i32),
    Auto,
}

pub fn run(args: &EvaluateArgs) -> Result<()> {
    args.json.iter().try_for_each(|path| output::check(path))?;
    let [track, truth] = [&args.track, &args.truth].map(|path| Recording::load(path, args.fps));
    let (track, truth) = (track?, truth?);
    if !args.overlap {
        align::same_length(&track, &truth)?;
    }
    let aligned = match args.shift {
        Shift::Frames(frames) => Aligned::new(&track, &truth, frames)?,
        Shift::Auto => align::best(&track, &truth)?,
    };
    let events = args.events.as_deref().map(|path| Annotations::load(path, args.fps)).transpose()?;
    let limits = EventLimits { f_min: args.f_min, tolerance_s: args.tolerance_s };
    let scores = score::all(&aligned, events.as_ref(), limits);
    print!("{}", score::text(&aligned, &scores));
    let Some(path) = &args.json else { return Ok(()) };
    output::write(path, serde_json::to_string_pretty(&score::json(&aligned, &scores))?)
}

fn parse_shift(text: &str) -> Result<Shift, String> {
    let frames = || text.parse().map(Shift::Frames).map_err(|_| "not a whole number of frames or `auto`".to_owned());
    if text == "auto" { Ok(Shift::Auto) } else { frames() }
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| *number > 0.0 && number.is_finite());
    number.ok_or_else(|| "not a number above 0".to_owned())
}
