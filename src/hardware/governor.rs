//! The clock rate of the processors, and the governors that choose it.

use std::path::{Path, PathBuf};

use super::files::{number, numbered, read, text};

/// Drivers whose governor "powersave" chooses the rate by load, as "schedutil" does with other drivers. The preference for
/// energy or performance is a separate setting there.
const DYNAMIC_DRIVERS: [&str; 2] = ["intel_pstate", "amd-pstate-epp"];
/// A processor whose governor is slow to raise the rate is slow below this share of its highest rate.
const SLOW_PERCENT: i64 = 60;

/// Processors that share one clock rate.
#[derive(Debug)]
pub(super) struct Policy {
    folder: PathBuf,
    is_dynamic: bool,
}

/// What a policy does at present.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Clock {
    pub(super) governor: String,
    pub(super) now_mhz: i64,
    pub(super) highest_mhz: i64,
}

impl Policy {
    pub(super) fn find_all(root: &Path) -> Vec<Self> {
        let folders = numbered(&root.join("sys/devices/system/cpu/cpufreq"), "policy");
        let dynamic = |driver: &str| Some(DYNAMIC_DRIVERS.contains(&driver));
        let policy = |folder: PathBuf| {
            let is_dynamic = read(&folder.join("scaling_driver"), dynamic).unwrap_or(false);
            Self { folder, is_dynamic }
        };
        folders.into_iter().map(policy).collect()
    }

    /// Whether the processors run slower than they could, or soon will, because the governor saves power.
    pub(super) fn is_slow(&self) -> bool {
        let is_slow = |governor: &str| match governor {
            "powersave" if self.is_dynamic => {
                read(&self.folder.join("energy_performance_preference"), |preference| Some(preference == "power"))
            }
            "powersave" => Some(true),
            "conservative" | "userspace" => {
                Some(self.khz("scaling_cur_freq")? * 100 < self.khz("cpuinfo_max_freq")? * SLOW_PERCENT)
            }
            _ => Some(false),
        };
        read(&self.folder.join("scaling_governor"), is_slow).unwrap_or(false)
    }

    pub(super) fn clock(&self) -> Option<Clock> {
        let governor = text(&self.folder.join("scaling_governor"))?;
        let mhz = |file: &str| Some(self.khz(file)? / 1000);
        Some(Clock { governor, now_mhz: mhz("scaling_cur_freq")?, highest_mhz: mhz("cpuinfo_max_freq")? })
    }

    fn khz(&self, file: &str) -> Option<i64> {
        number(&self.folder.join(file))
    }
}
