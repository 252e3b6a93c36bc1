//! What a bench measures, and its figures as a table, as JSON and as a drawing.

use std::error::Error;
use std::fs;
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

use plotters::prelude::*;
use rustix::param::clock_ticks_per_second;
use rustix::time::{ClockId, clock_gettime};
use serde_json::{Map, Value, json};

use facewire::cli::Failure;
use facewire::pipeline::StageTimes;
use facewire_board::{self as board, Machine};

const CAMERA_FPS: f64 = 30.0;
const QUANTILES: [(&str, f64); 5] = [("p50", 0.5), ("p95", 0.95), ("p99", 0.99), ("p999", 0.999), ("max", 1.0)];
/// The points of the distribution in JSON, in percent.
const DISTRIBUTION: [f64; 15] =
    [0.1, 1.0, 5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0, 98.0, 99.0, 99.5, 99.8, 99.9, 100.0];
/// Steps of the loop of constant work between two readings of the clock, while its speed is measured.
const CALIBRATION_STEPS: u64 = 20_000;
const DRAWING_PX: (u32, u32) = (800, 480);
/// Share of the frames whose times fit the width of the drawing.
const SHOWN: f64 = 0.999;

/// The durations of each stage, frame by frame, and figures of all rounds.
#[derive(Default)]
pub struct Samples {
    pub frames: u64,
    /// From the file to a frame in memory. This includes frames without a face.
    pub decode: Vec<Duration>,
    detect: Vec<Duration>,
    mesh: Vec<Duration>,
    solve: Vec<Duration>,
    /// From a frame in memory to its coefficients.
    pub whole: Vec<Duration>,
    /// From the file to coefficients.
    decode_and_whole: Vec<Duration>,
    /// A loop of constant work that takes as long as the median frame. Its spread shows what the machine itself adds.
    pub constant_work: Vec<Duration>,
    pub cpu: Duration,
    pub elapsed: Duration,
    pub interruptions: [u64; 3],
    /// Largest resident memory of the process.
    pub peak_memory_mb: f64,
}

impl Samples {
    /// Adds a frame with a face.
    pub fn push(&mut self, decode: Duration, times: &StageTimes, whole: Duration) {
        self.detect.extend(times.detect);
        self.mesh.extend(times.mesh);
        self.solve.extend(times.solve);
        self.whole.push(whole);
        self.decode_and_whole.push(decode + whole);
    }

    fn stages(&self) -> [(&'static str, &[Duration]); 7] {
        [
            ("decode", &self.decode),
            ("detect", &self.detect),
            ("mesh", &self.mesh),
            ("solve", &self.solve),
            ("whole", &self.whole),
            ("decode_and_whole", &self.decode_and_whole),
            ("constant_work", &self.constant_work),
        ]
    }

    /// The frames per second that this machine can process: 95 % of the frames, with decoding, keep up with this rate.
    pub fn frames_per_second(&self) -> f64 {
        1000.0 / ms(&self.decode_and_whole, 0.95).max(f64::MIN_POSITIVE)
    }

    /// Processor time, with decoding, as a share of one core, in percent: in these rounds, and at 30 frames per second.
    fn cpu_percent(&self) -> [f64; 2] {
        let cpu_s = self.cpu.as_secs_f64();
        let at_30_fps = CAMERA_FPS * cpu_s / self.frames.max(1) as f64;
        [cpu_s / self.elapsed.as_secs_f64().max(f64::MIN_POSITIVE), at_30_fps].map(|share| rounded(100.0 * share))
    }

    pub fn json(&self, input: &str) -> Map<String, Value> {
        let latency = |samples| QUANTILES.map(|(name, part)| (format!("{name}_ms"), json!(ms(samples, part))));
        let stages = self.stages().map(|(stage, samples)| (stage, latency(samples).into_iter().collect()));
        let [cpu_percent, cpu_percent_at_30_fps] = self.cpu_percent();
        let [switches, interrupts, stolen_ms] = self.interruptions;
        let interruptions =
            json!({ "involuntary_switches": switches, "interrupts": interrupts, "stolen_ms": stolen_ms });
        let distribution_ms = DISTRIBUTION.map(|percent| [percent, ms(&self.whole, percent / 100.0)]);
        let others = [
            ("input", json!(input)),
            ("frames", json!(self.frames)),
            ("faces", json!(self.whole.len())),
            ("whole_distribution_ms", json!(distribution_ms)),
            ("interruptions", interruptions),
            ("cpu_percent", json!(cpu_percent)),
            ("cpu_percent_at_30_fps", json!(cpu_percent_at_30_fps)),
            ("peak_memory_mb", json!(self.peak_memory_mb)),
            ("version", json!(env!("CARGO_PKG_VERSION"))),
            ("machine", json!(machine())),
        ];
        stages.into_iter().chain(others).map(|(name, value)| (name.to_owned(), value)).collect()
    }

    pub fn table(&self, input: &str) -> String {
        let rows = self.stages().map(|(stage, samples)| {
            let latency = QUANTILES.map(|(_, part)| format!(" {:>8.3}", ms(samples, part))).concat();
            format!("{:<16}{latency}\n", stage.replace('_', " "))
        });
        let Self { frames, whole, peak_memory_mb, interruptions: [switches, interrupts, stolen_ms], .. } = self;
        let [cpu_percent, cpu_percent_at_30_fps] = self.cpu_percent();
        format!(
            "{input}: {frames} frames, {} with a face, on {}\n\n\
             milliseconds          p50      p95      p99    p99.9      max\n{}\n\
             `whole` is the time from a decoded frame in memory to its coefficients: detect, mesh and solve. `constant \
             work` is\na loop that uses no memory and takes as long as the median frame: its times above p50 come from the \
             machine, not\nfrom facewire.\n\n\
             {cpu_percent_at_30_fps:.1} % of one core at 30 frames a second, {cpu_percent:.0} % in this run; peak memory \
             {peak_memory_mb:.1} MB\n\
             During the frames: {switches} switches to other processes, {interrupts} interrupts of all cores, \
             {stolen_ms} ms stolen by the hypervisor\n",
            whole.len(),
            machine(),
            rows.concat(),
        )
    }
}

fn machine() -> String {
    format!("{} ({})", Machine::detect(&board::root()).model, std::env::consts::ARCH)
}

pub fn peak_memory_mb() -> f64 {
    rounded(number("/proc/self/status", "VmHWM:", 0) as f64 / 1024.0)
}

fn ms(samples: &[Duration], part: f64) -> f64 {
    rounded(quantile(samples, part).as_secs_f64() * 1000.0)
}

/// Returns the smallest sample that a share `part` of all samples does not exceed, or zero if there are no samples.
pub fn quantile(samples: &[Duration], part: f64) -> Duration {
    let mut sorted = samples.to_vec();
    sorted.sort_unstable();
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

/// Returns how often another process took the processor from this one, how many interrupts all cores had, and how many
/// milliseconds of all cores the hypervisor gave to other virtual machines, since the process or the machine started.
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

pub fn cpu_time() -> Duration {
    clock_gettime(ClockId::ProcessCPUTime).try_into().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_work_takes_at_least_a_tenth_of_the_requested_time() {
        let length = Duration::from_millis(5);
        let passes = constant_work(length, 10);
        assert_eq!(passes.len(), 10);
        // On a busy machine, the loop may seem slower than it is when its speed is measured, but not ten times slower.
        assert!(passes.iter().all(|pass| *pass > length / 10), "{passes:?}");
    }
}
