//! `facewire-fit film`: renders a clip of one person, driven by a recording, with the truth of every frame.

use std::{f32::consts::TAU, fmt::Write, path::PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use facewire::solve::BLENDSHAPES;
use glam::{Vec2, Vec3};
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::ChaCha8Rng;

use super::{
    anatomy::enforce_limits,
    assets::Assets,
    avi,
    canvas::MOST_SAMPLES,
    expression::Coefficients,
    factors::Without,
    geometry::smoothstep,
    imager::Imager,
    options::{Sources, picture_size},
    sample::{PictureSpec, Subject, Variety},
    set::Set,
};
use crate::output;

/// Frame rate of recordings and clips.
const RATE: u32 = 30;
/// Limit on the length of a clip, longer than any recording.
const MOST_SECONDS: i64 = 3600;
/// A clip starts with a neutral face. Motion fades in between these times in seconds.
const START_S: [f32; 2] = [0.3, 1.3];
/// Amplitude of the head's motion: yaw, pitch, roll (degrees), x, y, z (centimetres); and number of waves it consists
/// of.
const SWAY: [f32; 6] = [13.0, 7.0, 5.0, 1.6, 1.0, 2.0];
const WAVES: usize = 4;
/// Numbers of people from here on are used in films only.
const FILM_PEOPLE: u64 = 1 << 40;
/// Exposure time as a share of the frame period.
const SHUTTER: f32 = 0.4;

/// Arguments of `film`.
#[derive(Debug, Args)]
pub struct Options {
    /// The Motion-JPEG file to write (AVI)
    out: PathBuf,
    /// The file for true head pose and coefficients of every frame (CSV)
    #[arg(long)]
    truth: PathBuf,
    /// Seed of the random numbers, which choose the person and the part of the recording
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length of the clip in seconds
    #[arg(long, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=MOST_SECONDS))]
    seconds: u32,
    /// Set of textures and recordings to use
    #[arg(long, value_enum, default_value = "judge")]
    set: Set,
    /// Width and height of the pictures
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
    let recordings = options.sources.curves.recordings(options.set)?;
    let assets = Assets::load(&options.sources.rig)?;
    let textures = options.sources.textures(options.set, &assets.names)?;
    let variety = Variety { textures, without: Without::default() };
    let seed = options.set.seed(options.seed);
    let mut subject = Subject::random(&assets, &variety, [width, height], [seed, FILM_PEOPLE]);
    let specs = specs(&mut subject, &recordings, count)?;
    let mut imager = Imager::new([width, height], MOST_SAMPLES)?;
    let frames =
        specs.iter().map(|spec| imager.take_picture(&assets, &mut subject, spec)).collect::<Result<Vec<_>>>()?;
    let size = [u32::try_from(width)?, u32::try_from(height)?];
    output::write(&options.out, avi::film(&frames, size, RATE))?;
    output::write(&options.truth, table(&specs)?)?;
    eprintln!("{}: {count} frames", options.out.display());
    Ok(())
}

/// Returns the frames of a clip: part of a recording, on a head that sways.
fn specs(subject: &mut Subject, recordings: &[Vec<Coefficients>], count: usize) -> Result<Vec<PictureSpec>> {
    let long = recordings.iter().filter(|frames| frames.len() >= count);
    let frames = long.choose(subject.rng()).context("no recording of this set is so long: choose fewer --seconds")?;
    let first = subject.rng().random_range(0..=frames.len() - count);
    let gains: Coefficients = core::array::from_fn(|_| subject.rng().random_range(1.0..1.5));
    let sway = SWAY.map(|size| Wave::random(subject.rng(), size));
    let mut specs: Vec<PictureSpec> = Vec::with_capacity(count);
    for (number, frame) in frames[first..first + count].iter().enumerate() {
        let time_s = number as f32 / RATE as f32;
        let start = smoothstep(START_S[0], START_S[1], time_s);
        let mut weights = core::array::from_fn(|index| (start * gains[index] * frame[index]).min(1.0));
        enforce_limits(&mut weights);
        let [yaw, pitch, roll, x, y, z] = sway.each_ref().map(|waves| start * Wave::sum(waves, time_s));
        specs.push(subject.pose(weights, [yaw, pitch, roll], Vec3::new(x, y, z)));
    }
    blur_motion(&mut specs);
    Ok(specs)
}

/// A sinusoidal component of a motion.
struct Wave {
    size: f32,
    hertz: f32,
    phase: f32,
}

impl Wave {
    /// Returns waves with an overall amplitude of about `size`. Faster waves are smaller.
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

/// Sets each picture's motion blur from the motion of the nose since the previous picture.
fn blur_motion(specs: &mut [PictureSpec]) {
    let noses: Vec<Option<Vec2>> = specs.iter().map(|spec| spec.scene.nose()).collect();
    for (spec, pair) in specs.iter_mut().skip(1).zip(noses.windows(2)) {
        if let [Some(before), Some(after)] = pair {
            spec.effects.motion_px = SHUTTER * (*after - *before);
        }
    }
}

/// Returns the truth as `evaluate` and `clip --truth` read it, with pitch positive when nodding down.
fn table(specs: &[PictureSpec]) -> Result<String> {
    let mut text = format!("frame,yaw_deg,pitch_deg,roll_deg,{}\n", BLENDSHAPES.join(","));
    for (number, spec) in specs.iter().enumerate() {
        write!(text, "{number}")?;
        let values = spec.scene.placement.angles_deg.iter().chain(&spec.scene.weights);
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
    fn film_does_not_accept_options_that_have_no_effect_on_it() {
        assert_eq!(refusal(&["--seconds", "10", "--skins", "one"]), "");
        for option in ["--mix=rest=1", "--shapes=jawOpen", "--turn-deg=1"] {
            assert!(refusal(&[option]).contains("unexpected argument"), "{option}");
        }
    }

    #[test]
    fn lengths_beyond_any_recording_are_refused() {
        assert!(refusal(&["--seconds", "143165577"]).contains("not in 1..=3600"));
        assert!(refusal(&["--seconds", "0"]).contains("not in 1..=3600"));
    }
}
