//! `facewire bench`: measures the duration of each stage over a clip, processor time and memory.

mod figures;
mod layers;

use std::{path::PathBuf, time::Instant};

use clap::Args;
use serde_json::{Value, json};

pub use self::figures::cpu_time;
use self::figures::{Samples, constant_work, interruptions, peak_memory_mb, quantile};
use self::layers::Layers;
use crate::input::{self, USUAL_SIZE_PX};
use crate::progress::ProgressLine;
use facewire::capture::{DEMO, FrameRate};
use facewire::cli::{Failure, SettingsArgs, print};
use facewire::config::{CameraSettings, Choice as _, NetworkSettings, Settings};
use facewire::pipeline::{Pipeline, Rejected};
use facewire::service::{Step, bind_to_hot_cpu};
use facewire_board::{self as board, Flags, Machine, Sensors};

const EXAMPLES: &str = "\
Examples:
  facewire bench
  facewire bench talk.avi --rounds 1 --json
  facewire bench --svg latency.svg
  facewire bench --layers
  facewire bench --report > report.txt

`whole` is the time from a decoded frame in memory to its coefficients. scripts/compare compares it with MediaPipe.";

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct BenchArgs {
    /// A .y4m or Motion-JPEG .avi file, a .npy file of landmarks, or `demo`, the built-in clip.
    #[arg(default_value = DEMO)]
    input: String,
    /// Play the input N times, after one round to warm up.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    rounds: u32,
    /// Also time each layer of the networks on the native engine, and compare its multiply-adds per second with the peak
    /// of this core.
    #[arg(long)]
    layers: bool,
    /// Run on a lower step, as the service does on a board that is too slow. Times are those of the frames that the step
    /// takes.
    #[arg(long, value_enum, default_value_t = Step::Full)]
    step: Step,
    /// Print one JSON object on one line.
    #[arg(long)]
    json: bool,
    /// Print one block about the board and its speed that you can send in. It names no person, machine or address.
    #[arg(long, conflicts_with_all = ["json", "layers"])]
    report: bool,
    /// Draw the distribution of the latency of whole frames into an SVG file.
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    #[command(flatten)]
    settings: SettingsArgs,
}

pub fn run(args: &BenchArgs) -> Result<(), Failure> {
    if args.input == "-" {
        return Err(Failure::data("standard input cannot be played more than once; give bench a file".to_owned()));
    }
    let settings = args.settings.load()?;
    let report = args.report.then(|| {
        let sensors = Sensors::find(&board::root(), &settings.hardware);
        (sensors.read(0.0).0, sensors)
    });
    let source = input::open(&args.input, FrameRate::FPS_30, USUAL_SIZE_PX)?.source;
    let mut pipeline = Pipeline::load(&settings, source.shows_pictures())?;
    // The helper threads of the networks have started, and may run on every CPU, as in the service.
    let bound = bind_to_hot_cpu(&settings.realtime);
    pipeline.set_turns(args.step.has_turns());
    // It draws nothing while something is measured.
    let mut progress = ProgressLine::new();
    progress.draw(None, "a round to warm up");
    play(&mut pipeline, args, &mut Samples::default())?;
    let mut samples = Samples::default();
    for round in 1..=args.rounds {
        progress.draw(None, format_args!("round {round} of {}", args.rounds));
        measure(&mut pipeline, args, &mut samples)?;
    }
    drop(progress);
    if samples.whole.is_empty() {
        return Err(Failure::data(format!("{} shows no face in any frame", args.input)));
    }
    // A report does not contain the path of a file.
    let input = if args.report && args.input != DEMO { "another film" } else { &args.input };
    // Peak memory is read before the layers are measured, which takes memory for further networks.
    samples.peak_memory_mb = peak_memory_mb();
    let layers = (args.layers || args.report).then(|| Layers::measure(&settings.networks)).transpose()?;
    // The figures are printed before the drawing, so that they are not lost if the drawing cannot be written.
    print(&match (report, layers) {
        (Some((before, sensors)), Some(layers)) => {
            report_text(&settings, bound, [before, sensors.read(0.0).0], &layers, (input, &samples))
        }
        (_, layers) if args.json => {
            let layers = layers.map(|layers| ("layers".to_owned(), json!(layers)));
            let figures: Value = samples.json(input).into_iter().chain(layers).collect();
            format!("{figures}\n")
        }
        (_, layers) => {
            samples.table(input) + &layers.map_or_else(String::new, |layers| format!("\n{}", layers.table()))
        }
    })?;
    args.svg.as_ref().map_or(Ok(()), |path| figures::draw(path, &samples.whole))
}

/// Plays the input once. Then runs a loop of constant work, which takes as long as the median frame, once for each frame
/// with a face.
fn measure(pipeline: &mut Pipeline, args: &BenchArgs, samples: &mut Samples) -> Result<(), Failure> {
    let cpu = cpu_time();
    let begun = Instant::now();
    let before = interruptions();
    let faces = samples.whole.len();
    play(pipeline, args, samples)?;
    samples.cpu += cpu_time().saturating_sub(cpu);
    samples.elapsed += begun.elapsed();
    for ((sum, now), before) in samples.interruptions.iter_mut().zip(interruptions()).zip(before) {
        *sum += now.saturating_sub(before);
    }
    samples.constant_work.extend(constant_work(quantile(&samples.whole, 0.5), samples.whole.len() - faces));
    Ok(())
}

/// Plays the input once, and keeps the durations of the stages of each frame that has a solution.
fn play(pipeline: &mut Pipeline, args: &BenchArgs, samples: &mut Samples) -> Result<(), Failure> {
    let mut source = input::open(&args.input, FrameRate::FPS_30, USUAL_SIZE_PX)?.source;
    pipeline.forget_face();
    loop {
        let begun = Instant::now();
        let Some(frame) = source.next()? else { return Ok(()) };
        let decode = begun.elapsed();
        samples.decode.push(decode);
        samples.frames += 1;
        let begun = Instant::now();
        let processed = pipeline.process(&frame);
        match processed.solved {
            Ok(_) => samples.push(decode, &processed.times, begun.elapsed()),
            Err(Rejected::Infer(error)) => return Err(error.into()),
            Err(_) => {}
        }
        for _ in 1..args.step.every() {
            source.skip()?;
        }
    }
}

/// Returns one block about the board and the speed, which its owner can send in. It contains no host name, user name,
/// address, path or serial number (`tests/hardware.rs`).
fn report_text(
    settings: &Settings,
    bound: Option<String>,
    [before, after]: [String; 2],
    layers: &Layers,
    (input, samples): (&str, &Samples),
) -> String {
    let root = board::root();
    let NetworkSettings { engine, threads, .. } = &settings.networks;
    let CameraSettings { width, height, fps, format, .. } = &settings.camera;
    let engine = engine.name();
    let format = format.name();
    let in_force = format!(
        "networks.engine {engine}, networks.threads {threads}, camera {width} x {height} at {fps}/s in format {format}"
    );
    let lines = [
        ("facewire", format!("{}; {in_force}", env!("CARGO_PKG_VERSION"))),
        ("bound", bound.unwrap_or_else(|| "to no CPU".to_owned())),
        ("board", Machine::detect(&root).tell(settings.board)),
        ("system", board::system()),
        ("processors", board::processors(&root)),
        ("memory", board::memory_mb(&root).map_or_else(|| "unknown".to_owned(), |mb| format!("{mb} MB"))),
        ("before", before),
        ("after", after),
        ("flags", Flags::ask().map_or_else(|| "none".to_owned(), |flags| flags.to_string())),
        ("networks", layers.summary()),
        ("rate", format!("{:.0} frames a second at p95, with decoding", samples.frames_per_second())),
    ];
    let lines = lines.map(|(name, value)| format!("{name:<11}{value}\n")).concat();
    format!(
        "--- facewire bench --report ---\n{lines}\n{}---\n\
         This block names no person, machine, address, path or serial number. Please tell us: the settings of boards are \
         estimates\nuntil their owners have measured them.\n",
        samples.table(input)
    )
}
