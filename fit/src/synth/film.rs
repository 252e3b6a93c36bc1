//! `facewire-fit film`: a clip of one person, driven by a recording, with its truth frame by frame.

use std::{f32::consts::TAU, fmt::Write, path::PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use facewire::solve::BLENDSHAPES;
use glam::{Vec2, Vec3};
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::ChaCha8Rng;

use super::{
    acting::restrain,
    avi,
    booth::Booth,
    expression::Coefficients,
    geometry::smoothstep,
    kit::Kit,
    options::{Sources, picture_size},
    sample::{Subject, Take},
    set::Set,
};
use crate::output;

/// Frames a second, of recordings and of clips.
const RATE: u32 = 30;
/// Longer than recordings are.
const MOST_SECONDS: i64 = 3600;
/// A clip starts with a neutral face and comes into motion over this time, seconds.
const START_S: [f32; 2] = [0.3, 1.3];
/// Waves of the head's motion along each of its ways: yaw, pitch, roll (degrees), x, y, z (centimetres).
const SWAY: [f32; 6] = [13.0, 7.0, 5.0, 1.6, 1.0, 2.0];
const WAVES: usize = 4;
/// Numbers of people from here on are in films only.
const FILM_PEOPLE: u64 = 1 << 40;
/// Share of a frame's time during which light is gathered.
const SHUTTER: f32 = 0.4;

/// What `film` takes.
#[derive(Debug, Args)]
pub struct Options {
    /// Motion-JPEG film to write (AVI)
    out: PathBuf,
    /// Table of the true head pose and coefficients of every frame to write (CSV)
    #[arg(long)]
    truth: PathBuf,
    /// Another seed gives another person and another part of the recording
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=MOST_SECONDS))]
    seconds: u32,
    /// Which part of textures and curves
    #[arg(long, value_enum, default_value = "judge")]
    set: Set,
    /// Columns and rows of the pictures
    #[arg(long, num_args = 2, default_values_t = [640, 480], value_names = ["WIDTH", "HEIGHT"])]
    size: Vec<usize>,
    #[command(flatten)]
    sources: Sources,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<()> {
    let [width, height] = picture_size(&options.size)?;
    output::check(&options.out)?;
    output::check(&options.truth)?;
    let count = (options.seconds * RATE) as usize;
    let recordings = options.sources.frames(options.set)?;
    let kit = Kit::load(&options.sources.rig)?;
    let wardrobe = options.sources.wardrobe(options.set, &kit.names)?;
    let seed = options.set.seed(options.seed);
    let mut subject = Subject::random(&kit, &wardrobe, [width, height], [seed, FILM_PEOPLE]);
    let takes = takes(&mut subject, &recordings, count)?;
    let mut booth = Booth::new([width, height])?;
    let frames = takes.iter().map(|take| booth.shoot(&kit, &mut subject, take)).collect::<Result<Vec<_>>>()?;
    let size = [u32::try_from(width)?, u32::try_from(height)?];
    output::write(&options.out, avi::film(&frames, size, RATE))?;
    output::write(&options.truth, table(&takes)?)?;
    eprintln!("{}: {count} frames", options.out.display());
    Ok(())
}

/// The person's frames: a stretch of a recording on a head that sways.
fn takes(subject: &mut Subject, recordings: &[Vec<Coefficients>], count: usize) -> Result<Vec<Take>> {
    let long = recordings.iter().filter(|frames| frames.len() >= count);
    let frames = long.choose(subject.rng()).context("no recording has that many frames in this set")?;
    let first = subject.rng().random_range(0..=frames.len() - count);
    let gains: Coefficients = core::array::from_fn(|_| subject.rng().random_range(1.0..1.5));
    let sway = SWAY.map(|size| Wave::random(subject.rng(), size));
    let mut takes: Vec<Take> = Vec::with_capacity(count);
    for (number, frame) in frames[first..first + count].iter().enumerate() {
        let time_s = number as f32 / RATE as f32;
        let start = smoothstep(START_S[0], START_S[1], time_s);
        let mut weights = core::array::from_fn(|index| (start * gains[index] * frame[index]).min(1.0));
        restrain(&mut weights);
        let [yaw, pitch, roll, x, y, z] = sway.each_ref().map(|waves| start * Wave::sum(waves, time_s));
        takes.push(subject.pose(weights, [yaw, pitch, roll], Vec3::new(x, y, z)));
    }
    blur_motion(&mut takes);
    Ok(takes)
}

/// One of the waves that make up a motion.
struct Wave {
    size: f32,
    hertz: f32,
    phase: f32,
}

impl Wave {
    /// Waves that together reach about `size`, faster ones smaller.
    fn random(rng: &mut ChaCha8Rng, size: f32) -> [Self; WAVES] {
        core::array::from_fn(|_| {
            let hertz: f32 = rng.random_range(0.08..0.7);
            Self {
                size: size * rng.random_range(0.2..0.7) * (0.2 / hertz).min(1.0),
                hertz,
                phase: rng.random_range(0.0..TAU),
            }
        })
    }

    fn sum(waves: &[Self], time_s: f32) -> f32 {
        waves.iter().map(|wave| wave.size * (TAU * wave.hertz * time_s + wave.phase).sin()).sum()
    }
}

/// Blurs each picture along the way of the tip of the nose since the one before.
fn blur_motion(takes: &mut [Take]) {
    let places: Vec<Option<Vec2>> = takes.iter().map(|take| take.shot.nose()).collect();
    for (take, pair) in takes.iter_mut().skip(1).zip(places.windows(2)) {
        if let [Some(before), Some(after)] = pair {
            take.effects.motion_px = SHUTTER * (*after - *before);
        }
    }
}

/// The truth as `evaluate` and `clip --truth` read it; pitch nods down.
fn table(takes: &[Take]) -> Result<String> {
    let mut text = format!("frame,yaw_deg,pitch_deg,roll_deg,{}\n", BLENDSHAPES.join(","));
    for (number, take) in takes.iter().enumerate() {
        write!(text, "{number}")?;
        let values = take.shot.placement.angles_deg.iter().chain(&take.shot.weights);
        for value in values {
            write!(text, ",{value:.4}")?;
        }
        text.push('\n');
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        options: Options,
    }

    fn refusal(arguments: &[&str]) -> String {
        let film = ["film", "a.avi", "--truth", "a.csv"];
        Cli::try_parse_from([&film, arguments].concat()).map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn what_a_film_does_not_heed_is_no_option_of_it() {
        assert_eq!(refusal(&["--seconds", "10", "--skins", "one"]), "");
        for option in ["--mix=1,0,0,0", "--shapes=jawOpen", "--turn-deg=1"] {
            assert!(refusal(&[option]).contains("unexpected argument"), "{option}");
        }
    }

    #[test]
    fn lengths_that_no_recording_has_are_refused() {
        assert!(refusal(&["--seconds", "143165577"]).contains("not in 1..=3600"));
        assert!(refusal(&["--seconds", "0"]).contains("not in 1..=3600"));
    }
}
