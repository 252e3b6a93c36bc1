//! What a bench measures, and its figures as a table, as JSON and as a drawing.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use plotters::prelude::*;
use rustix::param::clock_ticks_per_second;
use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

use super::layers::Layers;
use facewire::cli::Failure;
use facewire::hardware::{self, Machine};
use facewire::pipeline::StageTimes;

/// The usual rate of a camera, frames per second.
const CAMERA_FPS: f64 = 30.0;
/// The points of the distribution in JSON, in percent.
const DISTRIBUTION: [f64; 15] =
    [0.1, 1.0, 5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0, 98.0, 99.0, 99.5, 99.8, 99.9, 100.0];
/// Steps of the loop of constant work between two readings of the clock, while its speed is measured.
const CALIBRATION_STEPS: u64 = 20_000;
/// How often another process took the processor from this one, how many interrupts all cores had, and how many milliseconds
/// of all cores the hypervisor gave to other virtual machines.
const INTERRUPTIONS: [&str; 3] = ["involuntary_switches", "interrupts", "stolen_ms"];
const DRAWING_PX: (u32, u32) = (800, 480);
/// Share of the frames whose times fit the width of the drawing.
const SHOWN: f64 = 0.999;

/// One value for each stage.
#[derive(Default, Serialize)]
pub struct Stages<T> {
    /// From the file to a frame in memory. This includes frames without a face.
    pub decode: T,
    detect: T,
    mesh: T,
    solve: T,
    /// From a frame in memory to its coefficients.
    pub whole: T,
    /// From the file to coefficients.
    decode_and_whole: T,
    /// A loop of constant work that takes as long as the median frame. Its spread shows what the machine itself adds.
    pub constant_work: T,
}

/// The durations of each stage, frame by frame, and figures of all rounds.
#[derive(Default)]
pub struct Samples {
    pub frames: u64,
    pub stages: Stages<Vec<Duration>>,
    /// Processor time.
    pub cpu: Duration,
    pub elapsed: Duration,
    pub interruptions: [u64; 3],
}

impl Samples {
    /// Adds a frame with a face.
    pub fn push(&mut self, decode: Duration, times: &StageTimes, whole: Duration) {
        self.stages.detect.extend(times.detect);
        self.stages.mesh.extend(times.mesh);
        self.stages.solve.extend(times.solve);
        self.stages.whole.push(whole);
        self.stages.decode_and_whole.push(decode + whole);
    }
}

#[derive(Serialize)]
pub struct Figures {
    input: String,
    frames: u64,
    faces: usize,
    #[serde(flatten)]
    stages: Stages<Latency>,
    /// Distribution of `whole`: pairs of a percentage of the frames and the milliseconds that they took at most.
    whole_distribution_ms: Vec<[f64; 2]>,
    interruptions: BTreeMap<&'static str, u64>,
    /// Processor time, with decoding, as a share of the time that the rounds took; 100 is one core.
    cpu_percent: f64,
    /// Processor time per frame, with decoding, as a share of one core at 30 frames per second.
    cpu_percent_at_30_fps: f64,
    /// Largest resident memory of the process.
    peak_memory_mb: f64,
    version: &'static str,
    machine: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub layers: Option<Layers>,
}

#[derive(Serialize)]
struct Latency {
    p50_ms: f64,
    p95_ms: f64,
    p99_ms: f64,
    #[serde(rename = "p999_ms")]
    p99_9_ms: f64,
    max_ms: f64,
}

impl Latency {
    fn of(samples: &[Duration]) -> Self {
        let mut sorted = samples.to_vec();
        sorted.sort_unstable();
        let [p50_ms, p95_ms, p99_ms, p99_9_ms, max_ms] = [0.5, 0.95, 0.99, 0.999, 1.0].map(|part| ms(&sorted, part));
        Self { p50_ms, p95_ms, p99_ms, p99_9_ms, max_ms }
    }
}

impl Figures {
    pub fn new(input: &str, samples: &Samples) -> Self {
        let cpu_s = samples.cpu.as_secs_f64();
        let cpu_per_frame_s = cpu_s / samples.frames.max(1) as f64;
        let stages = &samples.stages;
        let mut whole = stages.whole.clone();
        whole.sort_unstable();
        Self {
            input: input.to_owned(),
            frames: samples.frames,
            faces: whole.len(),
            stages: Stages {
                decode: Latency::of(&stages.decode),
                detect: Latency::of(&stages.detect),
                mesh: Latency::of(&stages.mesh),
                solve: Latency::of(&stages.solve),
                whole: Latency::of(&whole),
                decode_and_whole: Latency::of(&stages.decode_and_whole),
                constant_work: Latency::of(&stages.constant_work),
            },
            whole_distribution_ms: DISTRIBUTION.map(|percent| [percent, ms(&whole, percent / 100.0)]).to_vec(),
            interruptions: INTERRUPTIONS.into_iter().zip(samples.interruptions).collect(),
            cpu_percent: rounded(100.0 * cpu_s / samples.elapsed.as_secs_f64().max(f64::MIN_POSITIVE)),
            cpu_percent_at_30_fps: rounded(100.0 * cpu_per_frame_s * CAMERA_FPS),
            peak_memory_mb: rounded(number("/proc/self/status", "VmHWM:", 0) as f64 / 1024.0),
            version: env!("CARGO_PKG_VERSION"),
            machine: format!("{} ({})", Machine::detect(&hardware::root()).model, std::env::consts::ARCH),
            layers: None,
        }
    }

    /// The frames per second that this machine can process: 95 % of the frames, with decoding, keep up with this rate.
    pub fn frames_per_second(&self) -> f64 {
        1000.0 / self.stages.decode_and_whole.p95_ms.max(f64::MIN_POSITIVE)
    }

    pub fn json(&self) -> String {
        // Numbers and strings always have a JSON form.
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }

    pub fn table(&self) -> String {
        let Stages { decode, detect, mesh, solve, whole, decode_and_whole, constant_work } = &self.stages;
        let rows = [
            ("decode", decode),
            ("detect", detect),
            ("mesh", mesh),
            ("solve", solve),
            ("whole", whole),
            ("decode and whole", decode_and_whole),
            ("constant work", constant_work),
        ];
        let rows = rows.map(|(stage, Latency { p50_ms, p95_ms, p99_ms, p99_9_ms, max_ms })| {
            format!("{stage:<16} {p50_ms:>8.3} {p95_ms:>8.3} {p99_ms:>8.3} {p99_9_ms:>8.3} {max_ms:>8.3}\n")
        });
        let Self { input, frames, faces, machine, peak_memory_mb, .. } = self;
        let [switches, interrupts, stolen_ms] = INTERRUPTIONS.map(|name| self.interruptions.get(name).unwrap_or(&0));
        format!(
            "{input}: {frames} frames, {faces} with a face, on {machine}\n\n\
             milliseconds          p50      p95      p99    p99.9      max\n{}\n\
             `whole` is the time from a decoded frame in memory to its coefficients: detect, mesh and solve. `constant \
             work` is\na loop that uses no memory and takes as long as the median frame: its times above p50 come from the \
             machine, not\nfrom facewire.\n\n\
             {:.1} % of one core at 30 frames a second, {:.0} % in this run; peak memory {peak_memory_mb:.1} MB\n\
             During the frames: {switches} switches to other processes, {interrupts} interrupts of all cores, \
             {stolen_ms} ms stolen by the hypervisor\n{}",
            rows.concat(),
            self.cpu_percent_at_30_fps,
            self.cpu_percent,
            self.layers.as_ref().map_or_else(String::new, |layers| format!("\n{}", layers.table()))
        )
    }
}

fn ms(sorted: &[Duration], part: f64) -> f64 {
    rounded(quantile(sorted, part).as_secs_f64() * 1000.0)
}

/// Returns the smallest sample that a share `part` of all samples does not exceed, or zero if there are no samples.
pub fn quantile(sorted: &[Duration], part: f64) -> Duration {
    let rank = (part * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or_default()
}

fn rounded(value: f64) -> f64 {
    (value * 10_000.0).round() / 10_000.0
}

/// Draws the share of frames over the milliseconds that they took at most.
pub fn draw(path: &Path, samples: &[Duration]) -> Result<(), Failure> {
    let failed = |error| Failure::failed(format!("cannot draw {}: {error}; leave out --svg", path.display()));
    let svg = drawing(samples).map_err(failed)?;
    fs::write(path, svg).map_err(|error| Failure::unwritable(path, &error))
}

fn drawing(samples: &[Duration]) -> Result<String, Box<dyn Error>> {
    let mut sorted = samples.to_vec();
    sorted.sort_unstable();
    let widest_ms = 1.1 * ms(&sorted, SHOWN);
    let percent = |rank: i32| 100.0 * f64::from(rank) / sorted.len() as f64;
    let steps = sorted.iter().zip(1..).map(|(sample, rank)| (sample.as_secs_f64() * 1000.0, percent(rank)));
    let mut svg = String::new();
    let drawing = SVGBackend::with_string(&mut svg, DRAWING_PX).into_drawing_area();
    drawing.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&drawing)
        .margin(16)
        .caption("From a frame in memory to its coefficients", ("sans-serif", 20))
        .x_label_area_size(40)
        .y_label_area_size(50)
        .build_cartesian_2d(0.0..widest_ms, 0.0..100.0)?;
    chart.configure_mesh().x_desc("milliseconds").y_desc("% of frames").draw()?;
    chart.draw_series(LineSeries::new(steps.filter(|(ms, _)| *ms <= widest_ms), BLUE.stroke_width(2)))?;
    drawing.present()?;
    drop(chart);
    drop(drawing);
    Ok(svg)
}

/// Repeats a loop of constant work, and returns how long each pass took. The loop uses no memory, so its times differ only
/// by what the machine does meanwhile: interrupts, other processes, other virtual machines, changes of the clock rate.
pub fn constant_work(length: Duration, passes: usize) -> Vec<Duration> {
    let fastest = (0..50).map(|_| timed(CALIBRATION_STEPS)).min().unwrap_or_default().max(Duration::from_nanos(1));
    let steps = length.div_duration_f64(fastest) * CALIBRATION_STEPS as f64;
    (0..passes).map(|_| timed(steps as u64)).collect()
}

/// Returns the duration of `steps` steps of a linear congruential generator. Each step depends on the one before it, so the
/// processor cannot overlap them.
fn timed(steps: u64) -> Duration {
    let begun = Instant::now();
    let next = |state: u64, _| black_box(state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1));
    black_box((0..steps).fold(1, next));
    begun.elapsed()
}

/// Returns the counts of [`INTERRUPTIONS`] since the start of the process and of the machine.
pub fn interruptions() -> [u64; 3] {
    // The fields of `cpu` are ticks: user, nice, system, idle, iowait, irq, softirq, steal (man 5 proc).
    let stolen_ms = number("/proc/stat", "cpu ", 7) * 1000 / clock_ticks_per_second().max(1);
    [number("/proc/self/status", "nonvoluntary_ctxt_switches:", 0), number("/proc/stat", "intr ", 0), stolen_ms]
}

/// Returns the number at `index`, counted from 0, on the line of a file that begins with `key`. Returns 0 if it is missing.
fn number(file: &str, key: &str, index: usize) -> u64 {
    let text = fs::read_to_string(file).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix(key));
    line.and_then(|line| line.split_whitespace().nth(index)?.parse().ok()).unwrap_or(0)
}

/// Returns the processor time that this process has used.
pub fn cpu_time() -> Duration {
    clock_gettime(ClockId::ProcessCPUTime).try_into().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_quantile_is_one_of_the_samples() {
        let samples: Vec<_> = (1..=100).map(Duration::from_millis).collect();
        assert_eq!([0.5, 0.99, 0.999, 1.0].map(|part| quantile(&samples, part).as_millis()), [50, 99, 100, 100]);
        assert_eq!(quantile(&[], 0.5), Duration::ZERO);
    }

    #[test]
    fn constant_work_takes_about_as_long_as_requested() {
        let fastest = constant_work(Duration::from_micros(500), 21).into_iter().min();
        // Even on a busy machine the fastest of many passes runs without interruption.
        assert!((Some(Duration::from_micros(100))..Some(Duration::from_millis(50))).contains(&fastest), "{fastest:?}");
    }
}
