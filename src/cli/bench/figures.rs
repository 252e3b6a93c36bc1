//! The figures of a bench, as a table and as JSON.

use std::fmt::Write as _;
use std::fs;
use std::time::Duration;

use serde::Serialize;

use crate::pipeline::StageTimes;

/// The usual rate of a camera, frames per second.
const CAMERA_FPS: f64 = 30.0;

/// Durations of each stage, frame by frame.
#[derive(Debug, Default)]
pub(super) struct Samples {
    pub(super) frames: u64,
    /// From the file to a frame in memory. Also measured for frames without a face.
    pub(super) decode: Vec<Duration>,
    pub(super) detect: Vec<Duration>,
    pub(super) mesh: Vec<Duration>,
    pub(super) solve: Vec<Duration>,
    /// From a frame in memory to its coefficients.
    pub(super) whole: Vec<Duration>,
}

impl Samples {
    /// Adds a frame with a face.
    pub(super) fn push(&mut self, times: &StageTimes, whole: Duration) {
        let stages = [(&mut self.detect, times.detect), (&mut self.mesh, times.mesh), (&mut self.solve, times.solve)];
        for (samples, time) in stages {
            samples.extend(time);
        }
        self.whole.push(whole);
    }
}

/// The results.
#[derive(Debug, Serialize)]
pub(super) struct Figures {
    input: String,
    frames: u64,
    faces: usize,
    decode: Latency,
    detect: Latency,
    mesh: Latency,
    solve: Latency,
    whole: Latency,
    /// Processor time per frame, with decoding, as a share of one core at 30 frames per second.
    cpu_percent_at_30_fps: f64,
    /// Largest resident memory of the process.
    peak_memory_mb: f64,
    version: &'static str,
    machine: String,
}

/// Milliseconds.
#[derive(Debug, Serialize)]
#[expect(clippy::struct_field_names, reason = "the unit belongs to the name in JSON")]
struct Latency {
    p50_ms: f64,
    p95_ms: f64,
    p99_ms: f64,
    max_ms: f64,
}

impl Figures {
    pub(super) fn new(input: &str, samples: &Samples, cpu: Duration) -> Self {
        let cpu_per_frame_s = cpu.as_secs_f64() / samples.frames.max(1) as f64;
        Self {
            input: input.to_owned(),
            frames: samples.frames,
            faces: samples.whole.len(),
            decode: Latency::of(&samples.decode),
            detect: Latency::of(&samples.detect),
            mesh: Latency::of(&samples.mesh),
            solve: Latency::of(&samples.solve),
            whole: Latency::of(&samples.whole),
            cpu_percent_at_30_fps: rounded(100.0 * cpu_per_frame_s * CAMERA_FPS),
            peak_memory_mb: rounded(peak_memory_kb() / 1024.0),
            version: env!("CARGO_PKG_VERSION"),
            machine: format!("{} ({})", processor(), std::env::consts::ARCH),
        }
    }

    pub(super) fn json(&self) -> String {
        // Numbers and strings always have a JSON form.
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }

    pub(super) fn table(&self) -> String {
        let mut text =
            format!("{}: {} frames, {} with a face, on {}\n\n", self.input, self.frames, self.faces, self.machine);
        text += "milliseconds      p50      p95      p99      max\n";
        let rows = [
            ("decode", &self.decode),
            ("detect", &self.detect),
            ("mesh", &self.mesh),
            ("solve", &self.solve),
            ("whole", &self.whole),
        ];
        for (stage, latency) in rows {
            let Latency { p50_ms, p95_ms, p99_ms, max_ms } = latency;
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{stage:<12} {p50_ms:>8.3} {p95_ms:>8.3} {p99_ms:>8.3} {max_ms:>8.3}");
        }
        text += "\nThe whole is from a frame in memory to its coefficients: detect, mesh and solve.\n";
        let (cpu, memory) = (self.cpu_percent_at_30_fps, self.peak_memory_mb);
        let _ = writeln!(text, "{cpu:.1} % of one core at 30 frames a second; peak memory {memory:.1} MB");
        text
    }
}

impl Latency {
    fn of(samples: &[Duration]) -> Self {
        let mut sorted = samples.to_vec();
        sorted.sort_unstable();
        let ms = |part: f64| rounded(quantile(&sorted, part).as_secs_f64() * 1000.0);
        Self { p50_ms: ms(0.5), p95_ms: ms(0.95), p99_ms: ms(0.99), max_ms: ms(1.0) }
    }
}

/// The smallest sample that a share `part` of all samples does not exceed; zero without samples.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index within the samples")]
pub(super) fn quantile(sorted: &[Duration], part: f64) -> Duration {
    let rank = (part * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or_default()
}

fn rounded(value: f64) -> f64 {
    (value * 10_000.0).round() / 10_000.0
}

fn peak_memory_kb() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).unwrap_or(0.0)
}

/// Name of the board or of the processor.
fn processor() -> String {
    let board = fs::read_to_string("/proc/device-tree/model").ok().map(|model| model.trim_end_matches('\0').to_owned());
    let cpus = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpus.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split_once(": "));
    board.or_else(|| model.map(|(_, name)| name.to_owned())).unwrap_or_else(|| "unknown processor".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_quantile_is_one_of_the_samples() {
        let samples: Vec<_> = (1..=100).map(Duration::from_millis).collect();
        assert_eq!([0.5, 0.99, 1.0].map(|part| quantile(&samples, part).as_millis()), [50, 99, 100]);
        assert_eq!(quantile(&[], 0.5), Duration::ZERO);
    }
}
