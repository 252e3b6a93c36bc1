//! The figures of a bench, as a table and as JSON.

use std::fmt::Write as _;
use std::time::Duration;

use serde::Serialize;

use super::layers::Layers;
use super::machine::{self, Interruptions};
use facewire::hardware::{self, Board};
use facewire::pipeline::StageTimes;

/// The usual rate of a camera, frames per second.
const CAMERA_FPS: f64 = 30.0;
/// The points of the distribution in JSON, in percent.
const DISTRIBUTION: [f64; 15] =
    [0.1, 1.0, 5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0, 98.0, 99.0, 99.5, 99.8, 99.9, 100.0];

/// What was measured: the durations of each stage, frame by frame, and figures of the rounds.
#[derive(Debug, Default)]
pub struct Samples {
    pub frames: u64,
    /// From the file to a frame in memory. This includes frames without a face.
    pub decode: Vec<Duration>,
    pub detect: Vec<Duration>,
    pub mesh: Vec<Duration>,
    pub solve: Vec<Duration>,
    /// From a frame in memory to its coefficients.
    pub whole: Vec<Duration>,
    /// From the file to coefficients.
    pub decode_and_whole: Vec<Duration>,
    /// A loop of constant work, which runs after each round.
    pub constant: Vec<Duration>,
    /// Processor time of all rounds.
    pub cpu: Duration,
    /// Elapsed time of all rounds.
    pub elapsed: Duration,
    /// Interruptions of each round.
    pub interruptions: Vec<Interruptions>,
}

impl Samples {
    /// Adds a frame with a face.
    pub fn push(&mut self, decode: Duration, times: &StageTimes, whole: Duration) {
        let stages = [(&mut self.detect, times.detect), (&mut self.mesh, times.mesh), (&mut self.solve, times.solve)];
        for (samples, time) in stages {
            samples.extend(time);
        }
        self.whole.push(whole);
        self.decode_and_whole.push(decode + whole);
    }
}

/// The results.
#[derive(Debug, Serialize)]
pub struct Figures {
    input: String,
    frames: u64,
    faces: usize,
    decode: Latency,
    detect: Latency,
    mesh: Latency,
    solve: Latency,
    whole: Latency,
    decode_and_whole: Latency,
    /// A loop of constant work that takes as long as the median frame. Its spread shows what the machine itself adds.
    constant_work: Latency,
    /// Distribution of `whole`: pairs of a percentage of the frames and the milliseconds that they took at most.
    whole_distribution_ms: Vec<[f64; 2]>,
    interruptions: Interruptions,
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

/// Quantiles of durations in milliseconds.
#[derive(Debug, Serialize)]
struct Latency {
    p50_ms: f64,
    p95_ms: f64,
    p99_ms: f64,
    #[serde(rename = "p999_ms")]
    p99_9_ms: f64,
    max_ms: f64,
}

impl Figures {
    pub fn new(input: &str, samples: &Samples) -> Self {
        let cpu_s = samples.cpu.as_secs_f64();
        let cpu_per_frame_s = cpu_s / samples.frames.max(1) as f64;
        let mut whole = samples.whole.clone();
        whole.sort_unstable();
        Self {
            input: input.to_owned(),
            frames: samples.frames,
            faces: samples.whole.len(),
            decode: Latency::of(&samples.decode),
            detect: Latency::of(&samples.detect),
            mesh: Latency::of(&samples.mesh),
            solve: Latency::of(&samples.solve),
            whole: Latency::of(&samples.whole),
            decode_and_whole: Latency::of(&samples.decode_and_whole),
            constant_work: Latency::of(&samples.constant),
            whole_distribution_ms: DISTRIBUTION.map(|percent| [percent, ms(&whole, percent / 100.0)]).to_vec(),
            interruptions: samples.interruptions.iter().copied().sum(),
            cpu_percent: rounded(100.0 * cpu_s / samples.elapsed.as_secs_f64().max(f64::MIN_POSITIVE)),
            cpu_percent_at_30_fps: rounded(100.0 * cpu_per_frame_s * CAMERA_FPS),
            peak_memory_mb: rounded(machine::peak_memory_kb() as f64 / 1024.0),
            version: env!("CARGO_PKG_VERSION"),
            machine: format!("{} ({})", Board::detect(&hardware::root()).model, std::env::consts::ARCH),
            layers: None,
        }
    }

    /// The frames per second that this machine can process: 95 % of the frames, with decoding, take no longer.
    pub fn frames_per_second(&self) -> f64 {
        1000.0 / self.decode_and_whole.p95_ms.max(f64::MIN_POSITIVE)
    }

    pub fn json(&self) -> String {
        // Numbers and strings always have a JSON form.
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }

    pub fn table(&self) -> String {
        let mut text =
            format!("{}: {} frames, {} with a face, on {}\n\n", self.input, self.frames, self.faces, self.machine);
        text += "milliseconds          p50      p95      p99    p99.9      max\n";
        let rows = [
            ("decode", &self.decode),
            ("detect", &self.detect),
            ("mesh", &self.mesh),
            ("solve", &self.solve),
            ("whole", &self.whole),
            ("decode and whole", &self.decode_and_whole),
            ("constant work", &self.constant_work),
        ];
        for (stage, latency) in rows {
            let Latency { p50_ms, p95_ms, p99_ms, p99_9_ms, max_ms } = latency;
            // Writing to a string cannot fail.
            let _ =
                writeln!(text, "{stage:<16} {p50_ms:>8.3} {p95_ms:>8.3} {p99_ms:>8.3} {p99_9_ms:>8.3} {max_ms:>8.3}");
        }
        text += "\n`whole` is the time from a decoded frame in memory to its coefficients: detect, mesh and solve. `constant \
                 work` is\na loop that uses no memory and takes as long as the median frame: its times above p50 come from the \
                 machine, not\nfrom facewire.\n\n";
        let (cpu, now, memory) = (self.cpu_percent_at_30_fps, self.cpu_percent, self.peak_memory_mb);
        let _ = writeln!(
            text,
            "{cpu:.1} % of one core at 30 frames a second, {now:.0} % in this run; peak memory {memory:.1} MB"
        );
        let Interruptions { involuntary_switches, interrupts, stolen_ms } = self.interruptions;
        let _ = writeln!(
            text,
            "During the frames: {involuntary_switches} switches to other processes, {interrupts} interrupts of all cores, \
             {stolen_ms} ms stolen by the hypervisor"
        );
        if let Some(layers) = &self.layers {
            text += "\n";
            text += &layers.table();
        }
        text
    }
}

impl Latency {
    fn of(samples: &[Duration]) -> Self {
        let mut sorted = samples.to_vec();
        sorted.sort_unstable();
        let [p50_ms, p95_ms, p99_ms, p99_9_ms, max_ms] = [0.5, 0.95, 0.99, 0.999, 1.0].map(|part| ms(&sorted, part));
        Self { p50_ms, p95_ms, p99_ms, p99_9_ms, max_ms }
    }
}

/// Returns a quantile in milliseconds.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_quantile_is_one_of_the_samples() {
        let samples: Vec<_> = (1..=100).map(Duration::from_millis).collect();
        assert_eq!([0.5, 0.99, 0.999, 1.0].map(|part| quantile(&samples, part).as_millis()), [50, 99, 100, 100]);
        assert_eq!(quantile(&[], 0.5), Duration::ZERO);
    }
}
