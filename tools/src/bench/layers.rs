//! Times the layers of the networks on the native engine, and compares them with the peak of this core.

use std::time::{Duration, Instant};

use facewire_engine::{Network, kernels, peak};
use serde::Serialize;

use facewire::config::NetworkSettings;
use facewire_face::InferError;
use facewire_face::stages::native_network;

/// The networks from files of a frame in which a face is followed, in the order in which they run, and the detector.
const NETWORKS: [&str; 5] = ["mesh", "lips", "left_eye", "right_eye", DETECTOR];
const DETECTOR: &str = "detector";
/// How often each network runs as a whole, and then again layer by layer.
const RUNS: usize = 100;

#[derive(Serialize)]
pub struct Layers {
    kernels: &'static str,
    /// The most multiply-adds per second that this core can compute, with operands in registers, in thousand millions.
    peak_g_per_s: f64,
    /// The networks of a followed face together, without that of the eyes.
    frame: Speed,
    networks: Vec<NetworkSpeed>,
}

#[derive(Serialize)]
struct NetworkSpeed {
    name: &'static str,
    #[serde(flatten)]
    speed: Speed,
    layers: Vec<LayerSpeed>,
}

#[derive(Serialize)]
struct LayerSpeed {
    layer: String,
    #[serde(flatten)]
    speed: Speed,
}

#[derive(Debug, Clone, Copy, Serialize)]
struct Speed {
    p50_us: f64,
    multiply_adds: usize,
    g_per_s: f64,
    percent_of_peak: f64,
}

impl Speed {
    fn of(multiply_adds: usize, time: Duration, peak_per_s: f64) -> Self {
        let per_s = multiply_adds as f64 / time.as_secs_f64().max(f64::MIN_POSITIVE);
        let p50_us = time.as_secs_f64() * 1e6;
        let percent_of_peak = 100.0 * per_s / peak_per_s;
        Self { p50_us, multiply_adds, g_per_s: per_s / 1e9, percent_of_peak }
    }

    fn line(&self, name: &str) -> String {
        let Self { p50_us, multiply_adds, g_per_s, percent_of_peak } = self;
        format!("{name:<40}{multiply_adds:>14}{p50_us:>8.1}{g_per_s:>8.1}{percent_of_peak:>8.0}\n")
    }
}

impl Layers {
    /// Measures all networks. They run alternately, so that each finds the caches as the one before it left them.
    pub fn measure(settings: &NetworkSettings) -> Result<Self, InferError> {
        let kernels = kernels::fastest();
        let load = |name| Ok(TimedNetwork::new(name, native_network(&settings.folder, kernels, name)?));
        let mut timed = NETWORKS.into_iter().map(load).collect::<Result<Vec<_>, InferError>>()?;
        let before = peak::multiply_adds_per_second(kernels);
        for _ in 0..RUNS {
            for TimedNetwork { network, whole, .. } in &mut timed {
                let begun = Instant::now();
                network.run();
                whole.push(begun.elapsed());
            }
            timed.iter_mut().for_each(TimedNetwork::time_layers);
        }
        let peak_per_s = before.max(peak::multiply_adds_per_second(kernels));
        let networks: Vec<_> = timed.into_iter().map(|network| network.speed(peak_per_s)).collect();
        let of_frame = || networks.iter().filter(|network| network.name != DETECTOR).map(|network| network.speed);
        let time = Duration::from_secs_f64(of_frame().map(|speed| speed.p50_us / 1e6).sum());
        let frame = Speed::of(of_frame().map(|speed| speed.multiply_adds).sum(), time, peak_per_s);
        Ok(Self { kernels: kernels.name, peak_g_per_s: peak_per_s / 1e9, frame, networks })
    }

    /// Returns the instruction set, and the speed of the networks of a followed face.
    pub fn summary(&self) -> String {
        let Speed { p50_us, percent_of_peak, .. } = self.frame;
        let kernels = self.kernels;
        let peak = self.peak_g_per_s;
        let p50_ms = p50_us / 1000.0;
        format!("{kernels}; {p50_ms:.2} ms, {percent_of_peak:.0} % of {peak:.1} G multiply-adds/s, on one thread")
    }

    pub fn table(&self) -> String {
        let heading = format!("{:<40}{:>14}{:>8}{:>8}{:>8}\n", "layer", "multiply-adds", "us p50", "G/s", "% peak");
        let layers = self.networks.iter().flat_map(|network| {
            network.layers.iter().map(|LayerSpeed { layer, speed }| speed.line(&format!("{:<10}{layer}", network.name)))
        });
        let networks = self.networks.iter().map(|network| network.speed.line(network.name));
        format!(
            "{heading}{}\n{}{}\nThis core computes at most {:.1} G multiply-adds/s with {}.\n",
            layers.collect::<String>(),
            networks.collect::<String>(),
            self.frame.line("all networks without the detector"),
            self.peak_g_per_s,
            self.kernels
        )
    }
}

struct TimedNetwork {
    name: &'static str,
    network: Network,
    whole: Vec<Duration>,
    /// For each layer, its duration in each run.
    layers: Vec<Vec<Duration>>,
}

impl TimedNetwork {
    fn new(name: &'static str, mut network: Network) -> Self {
        for row in 0..network.input_rows() {
            network.input_row(row).fill_with(fastrand::f32);
        }
        let layers = vec![Vec::with_capacity(RUNS); network.layers().len()];
        Self { name, network, whole: Vec::with_capacity(RUNS), layers }
    }

    /// Times each layer as the sum of its strips of rows. Reading the clock after each strip makes the run 1 to 2 % longer.
    fn time_layers(&mut self) {
        self.layers.iter_mut().for_each(|runs| runs.push(Duration::ZERO));
        let mut last = Instant::now();
        self.network.run_watched(|layer| {
            let now = Instant::now();
            if let Some(time) = self.layers.get_mut(layer).and_then(|runs| runs.last_mut()) {
                *time += now - last;
            }
            last = now;
        });
    }

    fn speed(self, peak_per_s: f64) -> NetworkSpeed {
        let speed = |multiply_adds, mut times: Vec<Duration>| {
            times.sort_unstable();
            Speed::of(multiply_adds, times.get(RUNS / 2).copied().unwrap_or_default(), peak_per_s)
        };
        let described = self.network.layers();
        let multiply_adds = described.iter().map(|(_, multiply_adds)| multiply_adds).sum();
        let layers = described.into_iter().zip(self.layers);
        let layers = layers.map(|((layer, adds), times)| LayerSpeed { layer, speed: speed(adds, times) }).collect();
        NetworkSpeed { name: self.name, speed: speed(multiply_adds, self.whole), layers }
    }
}
