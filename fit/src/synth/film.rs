//! `facewire-fit film`: renders a clip of one person, driven by a recording, with the truth of every frame.

use std::fmt::Write;
use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use facewire_face::BLENDSHAPES;
use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::assets::Assets;
use super::canvas::MOST_SAMPLES;
use super::conditions::Condition;
use super::expression::Coefficients;
use super::factors::Without;
use super::options::{Set, Sources, picture_size};
use super::sample::{PictureSpec, Subject, Variety};
use super::script::{Moment, Part, RATE, Script, random_sway};
use super::worker::Imager;
use crate::output;

/// Limit on the length of a clip, longer than any recording.
const MOST_SECONDS: i64 = 3600;
/// Numbers of people from here on are used in films only.
const FILM_PEOPLE: u64 = 1 << 40;
/// Exposure time as a share of the frame period.
const SHUTTER: f32 = 0.4;

/// Arguments of `film`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  facewire-fit film clip.avi --truth clip.csv --seconds 10
  facewire-fit film clips --count 20 --seconds 10      clips/01.avi, clips/01.csv, ...
  facewire-fit film wearers --count 20 --script wearer  wearers/01.avi, wearers/01.csv, wearers/01.parts.csv, ...
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
    /// Length of a clip of recordings in seconds. It starts with half a second of the neutral face
    #[arg(long, default_value_t = 8, conflicts_with = "script", value_parser = clap::value_parser!(u32).range(1..=MOST_SECONDS))]
    seconds: u32,
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

/// Everything that the clips of a run share.
struct Studio {
    assets: Assets,
    variety: Variety,
    recordings: Vec<Vec<Coefficients>>,
    script: Script,
    size: [usize; 2],
    frames: usize,
    seed: u64,
}

struct Files {
    film: PathBuf,
    truth: PathBuf,
}

pub fn run(options: &Options) -> Result<()> {
    let files = files(options)?;
    for Files { film, truth } in &files {
        output::check(film)?;
        output::check(truth)?;
    }
    let studio = Studio::open(options)?;
    files.par_iter().enumerate().try_for_each(|(number, files)| {
        let frames = studio.shoot(number, files)?;
        eprintln!("{}: {frames} frames", files.film.display());
        Ok(())
    })
}

/// Returns the files to write. With `--count`, makes the folder for them.
fn files(options: &Options) -> Result<Vec<Files>> {
    let Options { out, truth, count, .. } = options;
    if let Some(truth) = truth {
        return Ok(vec![Files { film: out.clone(), truth: truth.clone() }]);
    }
    std::fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let name = |number: u16, ending: &str| out.join(format!("{number:02}.{ending}"));
    let files = |number| Files { film: name(number, "avi"), truth: name(number, "csv") };
    Ok((1..=count.unwrap_or(1)).map(files).collect())
}

impl Studio {
    fn open(options: &Options) -> Result<Self> {
        let recordings = options.sources.curves.recordings(options.set)?;
        let assets = Assets::load(&options.sources.rig)?;
        let textures = options.sources.textures(options.set, &assets.names)?;
        Ok(Self {
            assets,
            variety: Variety { textures, without: Without::conditions(), condition: options.condition },
            recordings,
            script: options.script,
            size: picture_size(&options.size)?,
            frames: (options.seconds * RATE) as usize,
            seed: options.set.seed(options.seed),
        })
    }

    fn shoot(&self, number: usize, files: &Files) -> Result<usize> {
        let person = [self.seed, FILM_PEOPLE + number as u64];
        let mut subject = Subject::random(&self.assets, &self.variety, self.size, person);
        let parts = self.script.parts(subject.rng(), &self.recordings, self.frames)?;
        let specs = specs(&mut subject, &parts);
        let mut imager = Imager::new(self.size, MOST_SAMPLES)?;
        let pictures = specs.iter().map(|spec| imager.take_picture(&self.assets, &mut subject, spec));
        let pictures = pictures.collect::<Result<Vec<_>>>()?;
        let [width, height] = self.size;
        let size = [u32::try_from(width)?, u32::try_from(height)?];
        output::write(&files.film, avi(&pictures, size, RATE))?;
        if self.script == Script::Wearer {
            output::write(&files.truth.with_extension("parts.csv"), places(&parts)?)?;
        }
        output::write(&files.truth, table(&specs)?)?;
        Ok(specs.len())
    }
}

fn specs(subject: &mut Subject, parts: &[Part]) -> Vec<PictureSpec> {
    let moments: Vec<&Moment> = parts.iter().flat_map(|part| &part.moments).collect();
    let sway = random_sway(subject.rng(), moments.len());
    let spec = |(moment, motion): (&&Moment, [f32; 6])| {
        let [yaw, pitch, roll, x, y, z] = motion.map(|value| moment.sway * value);
        let mut spec = subject.pose(moment.face, [yaw + moment.yaw_deg, pitch, roll], Vec3::new(x, y, z));
        spec.effects.exposure *= moment.light.exposure;
        spec.effects.noise = spec.effects.noise.map(|noise| moment.light.noise * noise);
        spec
    };
    let mut specs: Vec<PictureSpec> = moments.iter().zip(sway).map(spec).collect();
    blur_motion(&mut specs);
    specs
}

fn places(parts: &[Part]) -> Result<String> {
    let (mut text, mut first) = ("part,first_frame,frames\n".to_owned(), 0);
    for part in parts {
        writeln!(text, "{},{first},{}", part.name, part.moments.len())?;
        first += part.moments.len();
    }
    Ok(text)
}

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

struct Chunks(Vec<u8>);

impl Chunks {
    fn numbers(&mut self, values: &[u32]) -> &mut Self {
        for value in values {
            self.0.extend(value.to_le_bytes());
        }
        self
    }

    fn chunk(&mut self, id: [u8; 4], body: &[u8]) -> &mut Self {
        self.0.extend(id);
        self.numbers(&[length(body)]);
        self.0.extend(body);
        self.0.resize(self.0.len().next_multiple_of(2), 0);
        self
    }

    fn list(&mut self, id: [u8; 4], kind: [u8; 4], body: &[u8]) -> &mut Self {
        self.chunk(id, &[kind.as_slice(), body].concat())
    }
}

fn length(bytes: &[u8]) -> u32 {
    u32::try_from(bytes.len()).unwrap_or(u32::MAX)
}

/// Returns an AVI file with `frames` (JPEG images of `size`) at `rate` frames per second. It must be smaller than 4 GB.
fn avi(frames: &[Vec<u8>], [width, height]: [u32; 2], rate: u32) -> Vec<u8> {
    let count = u32::try_from(frames.len()).unwrap_or(u32::MAX);
    let largest = frames.iter().map(|frame| length(frame)).max().unwrap_or(0);
    let (mut images, mut index) = (Chunks(vec![]), Chunks(vec![]));
    for frame in frames {
        let offset = length(&images.0) + 4;
        images.chunk(*b"00dc", frame);
        index.0.extend(b"00dc");
        // AVIIF_KEYFRAME: every image can be decoded on its own.
        index.numbers(&[0x10, offset, length(frame)]);
    }
    let mut body = Chunks(vec![]);
    body.list(*b"LIST", *b"hdrl", &header(count, largest, [width, height], rate));
    body.list(*b"LIST", *b"movi", &images.0).chunk(*b"idx1", &index.0);
    let mut file = Chunks(vec![]);
    file.list(*b"RIFF", *b"AVI ", &body.0);
    file.0
}

fn header(count: u32, largest: u32, [width, height]: [u32; 2], rate: u32) -> Vec<u8> {
    let mut main = Chunks(vec![]);
    main.numbers(&[1_000_000 / rate, largest * rate, 0, 0x10, count, 0, 1, largest, width, height, 0, 0, 0, 0]);
    let mut stream = Chunks(b"vidsMJPG".to_vec());
    stream.numbers(&[0, 0, 0, 1, rate, 0, count, largest, u32::MAX, 0, 0, height << 16 | width]);
    let mut format = Chunks(vec![]);
    format.numbers(&[40, width, height, 24 << 16 | 1]).0.extend(b"MJPG");
    format.numbers(&[3 * width * height, 0, 0, 0, 0]);
    let mut streams = Chunks(vec![]);
    streams.chunk(*b"strh", &stream.0).chunk(*b"strf", &format.0);
    let mut all = Chunks(vec![]);
    all.chunk(*b"avih", &main.0).list(*b"LIST", *b"strl", &streams.0);
    all.0
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use facewire::capture::{AviSource, FrameRate, Source};

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
    fn with_a_count_the_clips_have_numbers_and_their_truth_beside_them() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("clips").display().to_string();
        let options = Cli::try_parse_from(["film", &out, "--count", "11"]).expect("no --truth needed").options;
        let files = files(&options).expect("a folder");
        assert_eq!(files.len(), 11);
        assert!(files[0].film.ends_with("clips/01.avi") && files[10].truth.ends_with("clips/11.csv"));
        assert!(Cli::try_parse_from(["film", "a.avi"]).is_err_and(|error| error.to_string().contains("--truth")));
    }

    #[test]
    fn film_does_not_accept_options_that_have_no_effect_on_it() {
        assert_eq!(refusal(&["--seconds", "10", "--skins", "one"]), "");
        for option in ["--count=3", "--mix=rest=1", "--shapes=jawOpen", "--turn-deg=1"] {
            let error = refusal(&[option]);
            assert!(error.contains("unexpected argument") || error.contains("cannot be used with"), "{error}");
        }
    }

    #[test]
    fn facewire_reads_size_rate_and_every_frame() {
        let image = turbojpeg::Image {
            pixels: vec![90_u8; 64 * 48 * 3],
            width: 64,
            pitch: 192,
            height: 48,
            format: turbojpeg::PixelFormat::RGB,
        };
        let jpeg = turbojpeg::compress(image.as_deref(), 80, turbojpeg::Subsamp::Sub2x1).expect("a JPEG").to_vec();
        let film = avi(&[jpeg.clone(), jpeg.clone(), jpeg], [64, 48], 30);
        let mut source = AviSource::open(film.as_slice(), "film", FrameRate::FPS_30).expect("an AVI file");
        assert_eq!(source.frame_period_us(), Some(33_333));
        let mut count = 0;
        while let Some(frame) = source.next().expect("a frame") {
            assert_eq!(frame.picture().map(|picture| [picture.width, picture.height]), Some([64, 48]));
            count += 1;
        }
        assert_eq!(count, 3);
    }
}
