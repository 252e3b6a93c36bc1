//! `facewire-fit film`: renders a clip of one person, driven by a recording, with the truth of every frame.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use facewire_face::BLENDSHAPES;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::assets::Assets;
use super::canvas::MOST_SAMPLES;
use super::options::{Set, Sources, picture_size};
use super::sample::{PictureSpec, Subject, Variety};
use super::script::{Moment, Part, RATE, Script, random_sway, sines};
use super::variety::{Condition, Without};
use super::worker::Imager;
use crate::output;
use crate::shapes::modelled;

/// Limit on the length of a clip, longer than any recording.
const MOST_SECONDS: i64 = 3600;
const SECONDS: u32 = 8;
/// Numbers of people from here on are used in films only.
const FILM_PEOPLE: u64 = 1 << 40;
const SHUTTER: f32 = 0.4;

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  facewire-fit film clip.avi --truth clip.csv --seconds 10
  facewire-fit film clips --count 20 --seconds 10      clips/01.avi, clips/01.csv, ...
  facewire-fit film gaze --count 20 --script gaze --seconds 10
  facewire-fit film wearers --count 20 --script wearer  wearers/01.avi, wearers/01.csv, wearers/01.parts.csv, ...
  facewire-fit film sines --count 1 --script sine --blendshapes jawOpen,eyeBlinkLeft
  facewire track clip.avi --neutral 0..15 --out track.csv")]
pub struct Options {
    /// The Motion-JPEG file to write (AVI); with --count, the folder for the clips
    out: PathBuf,
    /// The file for true head pose and coefficients of every frame (CSV)
    #[arg(long, required_unless_present = "count", conflicts_with = "count")]
    truth: Option<PathBuf>,
    /// Make this many clips, each of another person, on all cores: 01.avi with the truth in 01.csv, and so on
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    count: Option<u16>,
    /// Seed of the random numbers, which choose people and parts of recordings
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// What the person does
    #[arg(long, value_enum, default_value = "recordings")]
    script: Script,
    /// The coefficients of `--script sine`, by ARKit name, separated by commas [default: all]
    #[arg(long, value_delimiter = ',', value_parser = modelled)]
    blendshapes: Vec<usize>,
    /// Length of a clip in seconds [default: 8]. It starts with half a second of the neutral face. That of a wearer and of
    /// sines is fixed
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=MOST_SECONDS))]
    seconds: Option<u32>,
    /// Set of textures and recordings to use
    #[arg(long, value_enum, default_value = "judge")]
    set: Set,
    /// Width and height of the pictures
    #[arg(long, num_args = 2, default_values_t = [640, 480], value_names = ["WIDTH", "HEIGHT"])]
    size: Vec<usize>,
    /// Condition of all frames [default: none]
    #[arg(long, value_enum, value_name = "NAME")]
    condition: Option<Condition>,
    #[command(flatten)]
    sources: Sources,
}

pub fn run(options: &Options) -> Result<()> {
    let files = files(options)?;
    let (script, shapes) = (options.script, &options.blendshapes);
    ensure!(!script.is_fixed() || options.seconds.is_none(), "the length of this script is fixed: leave out --seconds");
    ensure!(script == Script::Sine || shapes.is_empty(), "--blendshapes is for --script sine");
    files.iter().flatten().try_for_each(|path| output::check(path))?;
    let recordings = options.sources.curves.recordings(options.set)?;
    let assets = Assets::load(&options.sources.rig)?;
    let textures = options.sources.textures(options.set, &assets.names)?;
    let variety = Variety { textures, without: Without::conditions(), condition: options.condition, covered: 0.0 };
    let size = picture_size(&options.size)?;
    let shoot = |(number, [film, truth]): (usize, &[PathBuf; 2])| -> Result<()> {
        let person = [options.set.seed(options.seed), FILM_PEOPLE + number as u64];
        let mut subject = Subject::random(&assets, &variety, size, person);
        let count = (options.seconds.unwrap_or(SECONDS) * RATE) as usize;
        let parts = match shapes.as_slice() {
            [] => script.parts(&mut subject.rng, &recordings, count)?,
            shapes => sines(shapes),
        };
        let specs = specs(&assets, &mut subject, &parts);
        let mut imager = Imager::new(size, MOST_SAMPLES)?;
        let pictures = specs.iter().map(|spec| imager.take_picture(&assets, &mut subject, spec));
        let pictures = pictures.collect::<Result<Vec<_>>>()?;
        output::write(film, avi(&pictures, [u32::try_from(size[0])?, u32::try_from(size[1])?], RATE))?;
        if script.is_fixed() {
            output::write(&truth.with_extension("parts.csv"), places(&parts))?;
        }
        output::write(truth, table(&specs))?;
        eprintln!("{}: {} frames", film.display(), specs.len());
        Ok(())
    };
    files.par_iter().enumerate().try_for_each(shoot)
}

/// Returns the film and the truth of each clip to write. With `--count`, makes the folder for them.
pub fn files(options: &Options) -> Result<Vec<[PathBuf; 2]>> {
    let Options { out, truth, count, .. } = options;
    if let Some(truth) = truth {
        return Ok(vec![[out.clone(), truth.clone()]]);
    }
    std::fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let files = |number: u16| ["avi", "csv"].map(|ending| out.join(format!("{number:02}.{ending}")));
    Ok((1..=count.unwrap_or(1)).map(files).collect())
}

fn specs(assets: &Assets, subject: &mut Subject, parts: &[Part]) -> Vec<PictureSpec> {
    let moments: Vec<&Moment> = parts.iter().flat_map(|part| &part.moments).collect();
    let sway = random_sway(&mut subject.rng, moments.len());
    let spec = |(moment, motion): (&&Moment, [f32; 6])| {
        let [yaw, pitch, roll, x, y, z] = motion.map(|value| moment.sway * value);
        let mut spec = subject.pose(assets, moment.face, [yaw + moment.yaw_deg, pitch, roll], Vec3::new(x, y, z));
        spec.effects.exposure *= moment.light.exposure;
        spec.effects.noise = spec.effects.noise.map(|noise| moment.light.noise * noise);
        spec
    };
    let mut specs: Vec<PictureSpec> = moments.iter().zip(sway).map(spec).collect();
    let noses: Vec<Option<Vec2>> = specs.iter().map(|spec| spec.scene.nose()).collect();
    for (spec, pair) in specs.iter_mut().skip(1).zip(noses.windows(2)) {
        if let [Some(before), Some(after)] = pair {
            spec.effects.motion_px = SHUTTER * (*after - *before);
        }
    }
    specs
}

fn places(parts: &[Part]) -> String {
    let (mut text, mut first) = ("part,first_frame,frames\n".to_owned(), 0);
    for part in parts {
        text += &format!("{},{first},{}\n", part.name, part.moments.len());
        first += part.moments.len();
    }
    text
}

/// Returns the truth as `evaluate` and `clip --truth` read it, with pitch positive when nodding down.
fn table(specs: &[PictureSpec]) -> String {
    let mut text = format!("frame,yaw_deg,pitch_deg,roll_deg,{}\n", BLENDSHAPES.join(","));
    for (number, spec) in specs.iter().enumerate() {
        let values = spec.scene.placement.angles_deg.iter().chain(&spec.scene.weights);
        let values: String = values.map(|value| format!(",{value:.4}")).collect();
        text += &format!("{number}{values}\n");
    }
    text
}

fn numbers(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn length(bytes: &[u8]) -> u32 {
    u32::try_from(bytes.len()).unwrap_or(u32::MAX)
}

fn chunk(id: &[u8; 4], parts: &[&[u8]]) -> Vec<u8> {
    let body = parts.concat();
    let padding = vec![0; body.len() % 2];
    [id.as_slice(), &numbers(&[length(&body)]), &body, &padding].concat()
}

/// Returns an AVI file with `frames` (JPEG images of `size`) at `rate` frames per second. It must be smaller than 4 GB.
pub fn avi(frames: &[Vec<u8>], [width, height]: [u32; 2], rate: u32) -> Vec<u8> {
    let count = u32::try_from(frames.len()).unwrap_or(u32::MAX);
    let largest = frames.iter().map(|frame| length(frame)).max().unwrap_or(0);
    let (mut images, mut index) = (Vec::new(), Vec::new());
    for frame in frames {
        index.extend(b"00dc");
        // AVIIF_KEYFRAME: every image can be decoded on its own.
        index.extend(numbers(&[0x10, length(&images) + 4, length(frame)]));
        images.extend(chunk(b"00dc", &[frame]));
    }
    let main = [1_000_000 / rate, largest * rate, 0, 0x10, count, 0, 1, largest, width, height, 0, 0, 0, 0];
    let stream = numbers(&[0, 0, 0, 1, rate, 0, count, largest, u32::MAX, 0, 0, height << 16 | width]);
    let format = [numbers(&[40, width, height, 24 << 16 | 1]), b"MJPG".to_vec()].concat();
    let format = chunk(b"strf", &[&format, &numbers(&[3 * width * height, 0, 0, 0, 0])]);
    let streams = chunk(b"LIST", &[b"strl", &chunk(b"strh", &[b"vidsMJPG", &stream]), &format]);
    let header = chunk(b"LIST", &[b"hdrl", &chunk(b"avih", &[&numbers(&main)]), &streams]);
    let images = chunk(b"LIST", &[b"movi", &images]);
    chunk(b"RIFF", &[b"AVI ", &header, &images, &chunk(b"idx1", &[&index])])
}
