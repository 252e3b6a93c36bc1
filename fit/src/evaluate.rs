//! `facewire-fit evaluate`: judges the curves of a tracker by true ones, or by those of another tracker.

mod align;
mod annotations;
mod score;
mod table;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use self::{
    align::Aligned,
    annotations::Annotations,
    score::{Limits, Score},
};
use crate::{output, recording::Recording};

const AFTER_HELP: &str = "\
Columns are matched by name. Read are the CSV of `facewire track`, recordings of Live Link Face, and any table with a
header of blendshapes and a column time_s or frame. The truth is interpolated at the times of TRACK.
Correlations are given where the truth moves (standard deviation above 0.02), jitter where it rests.
An event is a rise of the truth to f-min after a fall below half of it, or a line of EVENTS (blendshape,time_s or
blendshape,frame; counted from the truth's first row). It is found if TRACK rises to f-min within the tolerance; each
rise finds one event.

Examples:
  facewire track demo --out track.csv && facewire-fit evaluate track.csv truth.csv
  facewire-fit evaluate track.csv MySlate_5_iPhone.csv --shift auto --overlap --json scores.json";

/// Arguments of `evaluate`.
#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct EvaluateArgs {
    /// The curves to be judged (CSV).
    track: PathBuf,
    /// The true curves, or those of another tracker (CSV).
    truth: PathBuf,
    /// Annotated events; without them events are read off the truth.
    #[arg(long, value_name = "EVENTS.csv")]
    events: Option<PathBuf>,
    /// Also write the figures as JSON.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Frames that TRACK is late by, or `auto`: the best within 2 seconds.
    #[arg(long, value_name = "FRAMES", default_value = "0", allow_negative_numbers = true, value_parser = parse_shift)]
    shift: Shift,
    /// Judge what both cover, where one is longer.
    #[arg(long)]
    overlap: bool,
    /// Frames a second of tables that state no time.
    #[arg(long, default_value_t = 30.0, value_parser = positive)]
    fps: f64,
    /// Coefficient at which an expression counts as an event.
    #[arg(long, default_value_t = 0.3, value_parser = positive)]
    f_min: f64,
    /// How far from an event it may be found, seconds (the paper: about 15 frames).
    #[arg(long, default_value_t = 0.5, value_parser = positive)]
    tolerance_s: f64,
}

/// How far TRACK is late.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shift {
    Frames(i32),
    Auto,
}

/// Runs the command.
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
    let limits = Limits { f_min: args.f_min, tolerance_s: args.tolerance_s };
    let scores = score::all(&aligned, events.as_ref(), limits);
    print!("{}", table::text(&aligned, &scores));
    let Some(path) = &args.json else { return Ok(()) };
    output::write(path, serde_json::to_string_pretty(&table::json(&aligned, &scores))?)
}

fn parse_shift(text: &str) -> Result<Shift, String> {
    let frames = || text.parse().map(Shift::Frames).map_err(|_| "write a number of frames, or auto".to_owned());
    if text == "auto" { Ok(Shift::Auto) } else { frames() }
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number: &f64| *number > 0.0 && number.is_finite());
    number.ok_or_else(|| "write a number above 0".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shift_is_a_number_of_frames_or_auto() {
        assert_eq!(parse_shift("-3"), Ok(Shift::Frames(-3)));
        assert_eq!(parse_shift("auto"), Ok(Shift::Auto));
        assert!(parse_shift("3.5").is_err() && positive("0").is_err() && positive("inf").is_err());
    }
}
