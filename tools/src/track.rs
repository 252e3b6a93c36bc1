//! `facewire track`: runs every frame of a file through the pipeline, in the file's own time.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use facewire_packet::{BLENDSHAPES, Visibility, yaw_pitch_roll_deg};
use npyz::WriterBuilder as _;

use crate::input::{self, Input};
use crate::progress::{ProgressLine, ShareRead};
use facewire::calibration::WearerName;
use facewire::capture::{FrameFault, FrameRate, Source};
use facewire::cli::{Failure, STANDARD_OUTPUT, SettingsArgs, say};
use facewire::pipeline::{Pipeline, load_profile};
use facewire::playback::{Playback, TrackedFrame, neutral_of};
use facewire::service::Step;
use facewire_face::{LANDMARKS, NeutralMode, Profile, Wears};

const EXAMPLES: &str = "\
A frame with a face is live at once, without the ramp by which the service comes back from neutral.

Examples:
  facewire track demo --out demo.csv
  ffmpeg -i talk.mp4 -f yuv4mpegpipe -pix_fmt yuv420p - | facewire track - --neutral 0..30
  facewire track talk.avi --neutral auto --out talk.csv
  facewire track talk.avi --wearer anna --out talk.csv
  facewire track talk.avi --landmarks talk.npy --out talk.csv
  facewire track talk.npy --fps 30 --stage raw
  facewire track talk.avi --model formulas.toml --out talk.csv";

const PROGRESS_FRAMES: u64 = 1000;
const HEAD_COLUMNS: [&str; 6] =
    ["head_yaw_deg", "head_pitch_deg", "head_roll_deg", "head_x_mm", "head_y_mm", "head_z_mm"];

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct TrackArgs {
    /// A .y4m or Motion-JPEG .avi file, `-` (y4m on standard input), `demo` (the built-in clip), a .npy file of
    /// landmarks (frames x 478 x 3, pixels), or a recording by `facewire record`. Landmarks do not show the skin between
    /// them, so their coefficients are less accurate than those of the film.
    input: String,
    /// The CSV file; without it, standard output.
    #[arg(long, value_name = "FILE.csv")]
    out: Option<PathBuf>,
    /// Also write the landmarks (frames x 478 x 3, pixels; not-a-number where there is no face).
    #[arg(long, value_name = "FILE.npy")]
    landmarks: Option<PathBuf>,
    /// The wearer's neutral face: `A..B` takes it from frames A up to B, without B; `auto` estimates it while the film
    /// goes on, as the service does. Without this option and without a profile it is the mean of many people.
    #[arg(long, value_name = "A..B|auto", value_parser = NeutralSource::parse)]
    neutral: Option<NeutralSource>,
    /// Use the profile of this wearer, made by `facewire calibrate`, instead of that of `wearer.name` of the settings.
    #[arg(long, value_name = "NAME", value_parser = WearerName::parse, conflicts_with = "neutral")]
    wearer: Option<WearerName>,
    /// Which coefficients to write.
    #[arg(long, value_enum, default_value_t = Stage::Smoothed)]
    stage: Stage,
    /// Run on a lower step, as the service does on a board that is too slow. A frame that the step leaves out repeats the
    /// row before, as receivers see it.
    #[arg(long, value_enum, default_value_t = Step::Full, conflicts_with_all = ["neutral", "landmarks"])]
    step: Step,
    /// Frames a second, where the input states none [default: 30].
    #[arg(long, value_parser = parse_fps)]
    fps: Option<FrameRate>,
    /// Size of the picture that the points of a .npy file lie in, for the head's position.
    #[arg(long, value_name = "WxH", value_parser = parse_size, default_value = "640x480")]
    size: [u16; 2],
    /// The blendshape model, instead of `solver.model` of the settings.
    #[arg(long, value_name = "FILE.toml")]
    model: Option<String>,
    #[command(flatten)]
    settings: SettingsArgs,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum NeutralSource {
    Frames(Range<u64>),
    Estimate,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Stage {
    /// Output of the regression.
    Raw,
    /// After the corrective terms.
    Corrected,
    /// After the rules of anatomy, the filters and the adjustments, as the service sends them.
    Smoothed,
}

pub fn run(args: &TrackArgs) -> Result<(), Failure> {
    let mut settings = args.settings.load()?;
    if let Some(model) = &args.model {
        settings.solver.model.clone_from(model);
    }
    if let Some(wearer) = &args.wearer {
        settings.wearer.name = wearer.to_string();
    }
    let Input { source, read } = input::open(&args.input, args.fps.unwrap_or(FrameRate::FPS_30), args.size)?;
    if !source.shows_pictures() {
        // Landmarks alone do not tell what covers a face.
        settings.wearer.wears = Wears::Nothing;
    }
    let (profile, warning) = match args.neutral {
        None => load_profile(&settings.wearer, &settings.solver)?,
        Some(_) => (Profile::default(), None),
    };
    if let Some(warning) = warning {
        say(warning);
    }
    let mut pipeline = Pipeline::load(&settings, source.shows_pictures())?;
    pipeline.solver.profile = profile;
    let is_estimated = args.neutral == Some(NeutralSource::Estimate);
    pipeline.solver.neutral_mode = if is_estimated { NeutralMode::Auto } else { NeutralMode::Off };
    pipeline.set_turns(args.step.has_turns());
    let out: Box<dyn Write> = match &args.out {
        Some(path) => Box::new(File::create(path).map_err(|error| Failure::unwritable(path, &error))?),
        None => Box::new(io::stdout()),
    };
    let playback = Playback::new(pipeline, &settings.failsafe);
    let out = BufWriter::new(out);
    let progress = ProgressLine::new();
    let progress = if args.out.is_some() { progress } else { progress.beside_standard_output() };
    let mut track = Track {
        source,
        read,
        progress: Some(progress),
        playback,
        args,
        out,
        landmarks: Vec::new(),
        frames: 0,
        faces: 0,
        damaged: 0,
        fault: None,
        is_readable: false,
    };
    if let Some(path) = &args.landmarks {
        // The path is checked before a long film is read. An existing file keeps its content until the end, because it
        // may be the input.
        let opened = File::options().append(true).create(true).open(path);
        opened.map_err(|error| Failure::unwritable(path, &error))?;
    }
    let begun = Instant::now();
    let outcome = track.all();
    track.progress = None;
    // The rows before an error of the input are kept.
    if let Some(path) = &args.landmarks {
        write_npy(path, &track.landmarks).map_err(|error| Failure::unwritable(path, &error))?;
    }
    track.out.flush().map_err(|error| track.unwritable(&error))?;
    if track.frames > 0 {
        say(format_args!("{}{} in {:.1} s", track.summary(), track.estimate(), begun.elapsed().as_secs_f64()));
    }
    match track.source.take_tally().stray_bytes {
        0 => {}
        bytes => say(format_args!("{}: bytes that belong to no frame and were passed over: {bytes}", args.input)),
    }
    outcome?;
    track.judge()
}

struct Track<'a> {
    source: Box<dyn Source>,
    read: ShareRead,
    /// It is there until all frames were read.
    progress: Option<ProgressLine>,
    playback: Playback,
    args: &'a TrackArgs,
    out: BufWriter<Box<dyn Write>>,
    /// The landmarks of all frames. They are kept until the end, because the header of the file states their number.
    landmarks: Vec<f32>,
    frames: u64,
    faces: u64,
    damaged: u64,
    /// What is wrong with the last damaged frame.
    fault: Option<FrameFault>,
    /// Whether any frame could be read.
    is_readable: bool,
}

impl Track<'_> {
    fn all(&mut self) -> Result<(), Failure> {
        let columns = ["frame", "time_s", "state"].into_iter().chain(BLENDSHAPES).chain(HEAD_COLUMNS);
        let columns = columns.map(str::to_owned).chain(Visibility::NAMES.map(|part| format!("visibility_{part}")));
        self.write(&columns.collect::<Vec<_>>().join(","))?;
        if let Some(NeutralSource::Frames(range)) = &self.args.neutral {
            self.learn_neutral(range)?;
        }
        while let Some(face) = self.playback.find(&mut *self.source)? {
            let row = self.frame(&face)?;
            self.leave_out(&face, &row)?;
        }
        Ok(())
    }

    /// Fails if no frame could be read, and says so if none shows a face.
    fn judge(&self) -> Result<(), Failure> {
        let input = self.source.describe().origin;
        if self.frames == 0 {
            return Err(Failure::data(format!("{input} has no frame; record or convert it again")));
        }
        if let Some(fault) = self.fault.filter(|_| !self.is_readable) {
            let remedy = "record it again, or convert it with `ffmpeg -i FILE -c:v mjpeg -q:v 3 out.avi`";
            return Err(Failure::data(format!("no frame of {input} could be read (the last: {fault}); {remedy}")));
        }
        if self.faces == 0 {
            let remedy = if self.source.shows_pictures() {
                "check that a face is upright, well lit and at least an eighth of the picture's longer side"
            } else {
                "check that its points are MediaPipe's 478, in pixels, and not all NaN or 0"
            };
            say(format_args!("no frame of {input} shows a face; {remedy}"));
        }
        Ok(())
    }

    /// Reads up to the end of the range, takes the mean of the faces in the range as neutral, then solves all frames read.
    fn learn_neutral(&mut self, range: &Range<u64>) -> Result<(), Failure> {
        let mut read = Vec::new();
        while read.last().is_none_or(|face: &TrackedFrame| face.number + 1 < range.end) {
            let Some(face) = self.playback.find(&mut *self.source)? else { break };
            read.push(face);
        }
        let frames = read.last().map_or(0, |face| face.number + 1);
        let refuse = |why: String| Failure::data(format!("--neutral {}..{}: {why}", range.start, range.end));
        if frames <= range.start {
            return Err(refuse(format!("the input has {frames} frames; give a range within them")));
        }
        if frames < range.end {
            say(format_args!("--neutral {}..{}: the input has only {frames} frames", range.start, range.end));
        }
        let neutral = neutral_of(&read, range).map_err(|error| refuse(error.to_string()))?;
        let mut profile = Profile::from(neutral);
        let solver = &mut self.playback.pipeline.solver;
        profile.wears = solver.wears();
        solver.profile = profile;
        read.iter().try_for_each(|face| self.frame(face).map(drop))
    }

    /// Skips the frames that the step leaves out after this one, and repeats its row for each.
    fn leave_out(&mut self, face: &TrackedFrame, row: &str) -> Result<(), Failure> {
        let rate = self.source.describe().rate.unwrap_or(FrameRate::FPS_30);
        for number in (face.number + 1..).take(self.args.step.every() as usize - 1) {
            if !self.source.skip()? {
                break;
            }
            self.frames += 1;
            self.write_row(number, rate.stamp_us(number), row)?;
        }
        Ok(())
    }

    /// Solves a frame and writes its row. Returns the state and the numbers of the row.
    fn frame(&mut self, face: &TrackedFrame) -> Result<String, Failure> {
        if self.args.landmarks.is_some() {
            let landmarks = face.landmarks.as_deref().map(|landmarks| landmarks.0.as_flattened());
            self.landmarks.extend_from_slice(landmarks.unwrap_or(&[f32::NAN; 3 * LANDMARKS]));
        }
        let shown = self.playback.show(face);
        self.frames += 1;
        self.faces += u64::from(shown.solution.is_some());
        self.damaged += u64::from(face.fault.is_some());
        self.fault = face.fault.or(self.fault);
        self.is_readable |= face.fault.is_none();
        self.report_progress();
        let mut pose = shown.pose;
        if let (Some(solution), Stage::Raw | Stage::Corrected) = (&shown.solution, self.args.stage) {
            let is_raw = self.args.stage == Stage::Raw;
            pose.coefficients = if is_raw { solution.raw.0 } else { solution.corrected.0 };
            pose.rotation = solution.raw_head.rotation_xyzw;
            pose.position_mm = solution.raw_head.position_mm;
        }
        let angles_deg = yaw_pitch_roll_deg(pose.rotation);
        // Adding 0 turns -0 into 0.
        let number = |number: &f32| format!(",{:.6}", number + 0.0);
        let numbers = pose.coefficients.iter().chain(&angles_deg).chain(&pose.position_mm);
        let visibility = pose.visibility.values();
        let numbers = numbers.chain(&visibility).map(number);
        let row = format!("{}{}", shown.state.name(), numbers.collect::<String>());
        self.write_row(face.number, face.time_us, &row)?;
        Ok(row)
    }

    fn report_progress(&mut self) {
        let is_shown = self.progress.as_ref().is_some_and(ProgressLine::is_shown);
        if !is_shown && !self.frames.is_multiple_of(PROGRESS_FRAMES) {
            return;
        }
        let summary = self.summary();
        match &mut self.progress {
            Some(progress) if is_shown => progress.draw(self.read.share(), summary),
            _ => say(summary),
        }
    }

    fn write_row(&mut self, number: u64, time_us: u64, row: &str) -> Result<(), Failure> {
        self.write(&format!("{number},{:.6},{row}", time_us as f64 / 1e6))
    }

    fn write(&mut self, line: &str) -> Result<(), Failure> {
        let written = writeln!(self.out, "{line}");
        written.map_err(|error| self.unwritable(&error))
    }

    fn unwritable(&self, error: &io::Error) -> Failure {
        Failure::unwritable(self.args.out.as_deref().unwrap_or(Path::new(STANDARD_OUTPUT)), error)
    }

    fn summary(&self) -> String {
        let damaged =
            self.fault.map_or_else(String::new, |fault| format!(", {} damaged (the last: {fault})", self.damaged));
        format!("{} frames, {} with a face{damaged}", self.frames, self.faces)
    }

    /// How far the estimate of the neutral face has come at the end, and how often it was forgotten.
    fn estimate(&self) -> String {
        let solver = &self.playback.pipeline.solver;
        if solver.neutral_mode != NeutralMode::Auto {
            return String::new();
        }
        let forgotten = match solver.neutral_forgotten() {
            0 => String::new(),
            1 => ", forgotten once for another person".to_owned(),
            times => format!(", forgotten {times} times for another person"),
        };
        format!(", neutral face estimated to {:.0} %{forgotten}", 100.0 * solver.neutral_share())
    }
}

/// Writes the landmarks of frames. Those of a frame without a face must be not-a-number.
pub(crate) fn write_npy(path: &Path, values: &[f32]) -> io::Result<()> {
    let shape = [values.len() / (3 * LANDMARKS), LANDMARKS, 3].map(|side| side as u64);
    let file = BufWriter::new(File::create(path)?);
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd()?;
    writer.extend(values.iter().copied())?;
    writer.finish()
}

impl NeutralSource {
    fn parse(text: &str) -> Result<Self, String> {
        let range = || {
            let (start, end) = text.split_once("..")?;
            let range = start.parse().ok()?..end.parse().ok()?;
            (!range.is_empty()).then_some(Self::Frames(range))
        };
        let wanted = "write auto, or A..B with A below B, such as 0..30";
        if text == "auto" { Ok(Self::Estimate) } else { range().ok_or_else(|| wanted.to_owned()) }
    }
}

fn parse_fps(text: &str) -> Result<FrameRate, String> {
    let rate = text.parse().ok().and_then(FrameRate::from_fps);
    rate.ok_or_else(|| "write a number from 0.1 to 1000".to_owned())
}

fn parse_size(text: &str) -> Result<[u16; 2], String> {
    let side = |text: &str| text.parse().ok().filter(|side| *side > 0);
    let sides = text.split_once('x').and_then(|(width, height)| Some([side(width)?, side(height)?]));
    sides.ok_or_else(|| "write WIDTHxHEIGHT in pixels, such as 640x480".to_owned())
}
