//! `facewire bench --report`: one block about the board and the speed, which its owner can send in.
//!
//! It contains no host name, user name, address, path or serial number (`tests/hardware.rs`).

use std::path::{Path, PathBuf};

use super::figures::Figures;
use super::layers::Layers;
use facewire::config::{Choice as _, Settings};
use facewire::hardware::{self, Board, Flags, Readings, Sensors, root};

const END: &str = "\
This block names no person, machine, address, path or serial number. Please tell us: the settings of boards are estimates
until their owners have measured them.
";

/// The board before the measurement.
pub struct Report {
    root: PathBuf,
    sensors: Sensors,
    before: Readings,
}

impl Report {
    /// Reads the sensors before the measurement begins.
    pub fn begin(settings: &Settings) -> Self {
        let root = root();
        let sensors = Sensors::find(&root, &settings.hardware);
        Self { before: sensors.read(), sensors, root }
    }

    /// Returns the block. `bound` says whether the measurement ran on the CPU that the settings name.
    pub fn text(&self, settings: &Settings, bound: Option<String>, figures: &Figures, layers: &Layers) -> String {
        let lines = [
            ("facewire", format!("{}; {}", env!("CARGO_PKG_VERSION"), in_force(settings))),
            ("bound", bound.unwrap_or_else(|| "to no CPU".to_owned())),
            ("board", Board::detect(&self.root).tell(settings.board)),
            ("system", hardware::system()),
            ("processors", hardware::processors(&self.root)),
            ("memory", memory(&self.root)),
            ("before", self.before.to_string()),
            ("after", self.sensors.read().to_string()),
            ("flags", Flags::ask().map_or_else(|| "none".to_owned(), |flags| flags.to_string())),
            ("networks", layers.summary()),
            ("rate", format!("{:.0} frames a second at p95, with decoding", figures.frames_per_second())),
        ];
        let lines = lines.map(|(name, value)| format!("{name:<11}{value}\n")).concat();
        format!("--- facewire bench --report ---\n{lines}\n{}---\n{END}", figures.table())
    }
}

fn memory(root: &Path) -> String {
    hardware::memory_mb(root).map_or_else(|| "unknown".to_owned(), |mb| format!("{mb} MB"))
}

/// Returns the settings that matter for speed.
fn in_force(settings: &Settings) -> String {
    let (networks, camera) = (&settings.networks, &settings.camera);
    format!(
        "networks.engine {}, networks.threads {}, camera {} x {} at {}/s in format {}",
        networks.engine.name(),
        networks.threads,
        camera.width,
        camera.height,
        camera.fps,
        camera.format.name(),
    )
}
