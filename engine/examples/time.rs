//! Times the networks of a folder on chosen kernels and threads. Usage: time FOLDER [KERNELS [ROUNDS [THREADS]]]
//!
//! Each round runs every network once, so that each network finds the caches as the one before it left them.
//! `facewire bench --layers` times the layers.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use std::{env, fs};

use facewire_engine::{Kernels, Network, Team, file, kernels, peak};

const NETWORKS: [&str; 5] = ["mesh", "lips", "left_eye", "right_eye", "detector"];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [folder, rest @ ..] = arguments.as_slice() else {
        return Err("usage: time FOLDER [KERNELS [ROUNDS [THREADS]]]".into());
    };
    let rounds = rest.get(1).map_or(Ok(300), |rounds| rounds.parse())?;
    let team = Arc::new(Team::new(rest.get(2).map_or(Ok(1), |threads| threads.parse())?)?);
    for kernels in kernels::available() {
        if rest.first().is_none_or(|name| name == kernels.name) {
            time(Path::new(folder), kernels, &team, rounds)?;
        }
    }
    Ok(())
}

fn time(folder: &Path, kernels: &'static Kernels, team: &Arc<Team>, rounds: usize) -> Result<(), Box<dyn Error>> {
    let mut networks = Vec::new();
    for name in NETWORKS {
        let start = Instant::now();
        let content = file::load(&folder.join(format!("{name}.fwnet")))?;
        let graph = file::read(&content)?;
        let mut network = Network::with_team(&graph, kernels, Arc::clone(team))?;
        for row in 0..network.input_rows() {
            let values = network.input_row(row).iter_mut().enumerate();
            values.for_each(|(at, value)| *value = ((row * 31 + at * 17) % 97) as f32 / 97.0);
        }
        networks.push((name, network, start.elapsed()));
    }
    let mut times = vec![Vec::with_capacity(rounds); networks.len()];
    let cpu_before = cpu_time()?;
    for _ in 0..rounds {
        for ((_, network, _), times) in networks.iter_mut().zip(&mut times) {
            let start = Instant::now();
            network.run();
            times.push(start.elapsed());
        }
    }
    let cpu_ms = cpu_time()?.saturating_sub(cpu_before).as_secs_f64() * 1e3 / rounds as f64;
    let peak = peak::multiply_adds_per_second(kernels) / 1e9;
    println!(
        "{}: median ms, G multiply-adds/s (peak {peak:.1}), ms to load, MB of weights, MB of activations",
        kernels.name
    );
    let mut frame = Duration::ZERO;
    for ((name, network, loading), times) in networks.iter().zip(&mut times) {
        let products: usize = network.layers().iter().map(|(_, products)| products).sum();
        let median = median(times);
        frame += if *name == "detector" { Duration::ZERO } else { median };
        let [weights, activations] = network.memory().map(|bytes| bytes as f64 / 1e6);
        let rate = products as f64 / median.as_secs_f64() / 1e9;
        let [median, loading] = [median, *loading].map(|time| time.as_secs_f64() * 1e3);
        println!("  {name:10}{median:8.4}{rate:8.1}{loading:8.1}{weights:8.2}{activations:8.2}");
    }
    println!("  frame     {:8.4}", frame.as_secs_f64() * 1e3);
    println!("  CPU time of all threads for the five networks: {cpu_ms:.4} ms");
    Ok(())
}

/// Processor time that the running threads of this process have used.
fn cpu_time() -> Result<Duration, Box<dyn Error>> {
    let mut nanoseconds = 0;
    for task in fs::read_dir("/proc/self/task")? {
        let statistics = fs::read_to_string(task?.path().join("schedstat"))?;
        nanoseconds += statistics.split(' ').next().unwrap_or_default().parse::<u64>()?;
    }
    Ok(Duration::from_nanos(nanoseconds))
}

fn median(times: &mut [Duration]) -> Duration {
    times.sort_unstable();
    times[times.len() / 2]
}
