//! CPU, memory and response time while a video is solved, by a process that does nothing else.

use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use facewire::capture::{AviSource, FrameRate};
use facewire::config::Settings;
use facewire::pipeline::load_tracker;
use facewire_face::{Model, NeutralMode, Profile};
use maud::{Markup, html};
use rustix::time::{ClockId, clock_gettime};

use crate::drawing::{Axis, BLUE_INK, Curve, Mark, ORANGE_INK, curves};
use crate::judge::set::playback;
use crate::output::{Table, figures, number};
use crate::recording::CsvTable;
use crate::synth::script::RATE;

const COLUMNS: [&str; 4] = ["landmarks_ms", "solver_ms", "cpu_percent", "memory_mb"];
/// Frames at the start that are not counted, because the machine still loads what it needs.
const WARM_UP: usize = 10;

fn cpu_s() -> f64 {
    let spent = clock_gettime(ClockId::ProcessCPUTime);
    spent.tv_sec as f64 + spent.tv_nsec as f64 / 1e9
}

/// The resident memory of this process in MB.
fn memory_mb() -> Result<f64> {
    let status = std::fs::read_to_string("/proc/self/status").context("cannot read /proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("no VmRSS in /proc/self/status")?;
    Ok(line.trim().trim_end_matches("kB").trim().parse::<f64>()? / 1024.0)
}

/// Solves a video and prints a line for each frame: what `--measure` does, in a process of its own.
pub fn measure(video: &Path) -> Result<()> {
    let path = video.to_str().context("the path is not UTF-8")?;
    let open = File::open(video).with_context(|| format!("cannot read {path}"))?;
    let mut source = AviSource::open(BufReader::new(open), path, FrameRate::FPS_30)?;
    let tracker = load_tracker(&Settings::default().networks)?;
    let mut playback = playback(Some(tracker), &Model::embedded_formulas(), Profile::default(), NeutralMode::Off);
    println!("{}", COLUMNS.join(","));
    loop {
        let (start, spent_s) = (Instant::now(), cpu_s());
        let Some(face) = playback.find(&mut source)? else { return Ok(()) };
        let found = Instant::now();
        std::hint::black_box(playback.show(&face));
        let milliseconds = [found - start, found.elapsed()].map(|time| time.as_secs_f64() * 1e3);
        // The share of one core that this frame takes of its time.
        let percent = 100.0 * (cpu_s() - spent_s) * f64::from(RATE);
        println!("{:.4},{:.4},{percent:.2},{:.2}", milliseconds[0], milliseconds[1], memory_mb()?);
    }
}

pub struct Hardware {
    pub html: Markup,
    /// Median and 95th percentile of the solver's time in ms, the CPU in percent, and the memory in MB.
    pub figures: [[f64; 2]; 3],
}

/// Returns the value below which a share of the sorted values lies.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(f64::NAN)
}

fn run(videos: &[PathBuf]) -> Result<[Vec<f64>; COLUMNS.len()]> {
    let mut all = [const { Vec::new() }; COLUMNS.len()];
    for video in videos {
        let output = Command::new(std::env::current_exe()?).args(["paper", "--measure"]).arg(video).output()?;
        ensure!(output.status.success(), "{}: {}", video.display(), String::from_utf8_lossy(&output.stderr));
        let table = CsvTable::read(output.stdout.as_slice())?;
        for (all, name) in all.iter_mut().zip(COLUMNS) {
            all.extend(table.numbers(name)?.into_iter().skip(WARM_UP));
        }
    }
    Ok(all)
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

/// The share of the frames that a chart shows: the slowest few would flatten the others.
const SHOWN: f64 = 0.995;

fn cumulative(name: &'static str, values: &[f64]) -> Result<String> {
    let sorted = sorted(values);
    let most = quantile(&sorted, SHOWN);
    let shares = (0..=200_u8).map(|at| f64::from(at) / 200.0);
    let points = shares.map(|share| (quantile(&sorted, share), share)).filter(|point| point.0 <= most);
    let line = |share: f64| {
        let value = quantile(&sorted, share);
        Curve::new(Mark::Dashes, ORANGE_INK, vec![(value, 0.0), (value, share)])
    };
    let shown = [Curve::new(Mark::Line, BLUE_INK, points.collect()), line(0.5), line(0.95)];
    curves(&shown, &[Axis::linear(name, [0.0, 1.05 * most]), Axis::linear("share of frames", [0.0, 1.0])])
}

fn over_time(name: &'static str, values: &[f64]) -> Result<String> {
    let most = 1.2 * quantile(&sorted(values), SHOWN);
    let points = values.iter().enumerate().map(|(frame, value)| (frame as f64 / f64::from(RATE), value.min(most)));
    let axes =
        [Axis::linear("s of video", [0.0, values.len() as f64 / f64::from(RATE)]), Axis::linear(name, [0.0, most])];
    curves(&[Curve::new(Mark::Line, BLUE_INK, points.collect())], &axes)
}

/// Draws figure 12 from videos that are solved one after the other.
pub fn section(videos: &[PathBuf], cpu: &str) -> Result<Hardware> {
    eprintln!("solving {} videos to measure CPU, memory and response time", videos.len());
    let [landmarks, solver, percent, memory] = run(videos)?;
    let shown = [("CPU of one core, %", &percent), ("memory, MB", &memory), ("solver, ms", &solver)];
    let mut drawn = Vec::new();
    for (name, values) in shown {
        drawn.push((over_time(name, values)?, format!("{name} over time")));
    }
    for (name, values) in shown {
        drawn.push((cumulative(name, values)?, format!("{name}: cumulative, with its 50th and 95th percentile")));
    }
    let drawn: Vec<(String, &str)> =
        drawn.iter().map(|(drawing, caption)| (drawing.clone(), caption.as_str())).collect();
    let ends = |values: &[f64]| {
        let sorted = sorted(values);
        [0.05, 0.5, 0.95, 0.99].map(|share| quantile(&sorted, share))
    };
    let row = |name: &str, values: &[f64], decimals: usize, paper: &str| {
        let cells = ends(values).map(|value| number(Some(value), decimals));
        [name.to_owned()].into_iter().chain(cells).chain([paper.to_owned()]).collect::<Vec<_>>()
    };
    let rows = [
        row("solver, ms", &solver, 3, "0.86, 2.46"),
        row("picture and landmarks, ms", &landmarks, 1, "-"),
        row("CPU of one core at 30 frames a second, %", &percent, 1, "39.1, 81.2"),
        row("memory, MB", &memory, 1, "549, 569"),
    ];
    let heads = ["", "5 %", "50 %", "95 %", "99 %", "paper: 50 %, 95 %"];
    let html = html! {
        p { (solver.len()) " frames in " (videos.len()) " videos, each solved by a process of its own as fast as it can, by the formulas of the paper's method, on " (cpu) ". The CPU is the time that a frame takes of one core, in percent of 1/30 s. The memory is what the process has in RAM, networks included. The solver's time is that from landmarks to what is sent." }
        (figures(&drawn, "Figure 12"))
        (Table::new(heads, rows).html())
        p { "The paper measured a program in Python on an Intel Core i7-12700H, with MediaPipe, which takes more than 90 % of its memory." }
    };
    let two = |values: &[f64]| [ends(values)[1], ends(values)[2]];
    Ok(Hardware { html, figures: [two(&solver), two(&percent), two(&memory)] })
}
