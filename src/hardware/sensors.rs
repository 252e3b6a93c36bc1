//! The sensors of a board as the kernel shows them in `/sys`: temperature, throttling and clock rates.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};

use crate::config::HardwareSettings;
use crate::impairment::{Impairment, ImpairmentSet};

/// Longest text that [`read`] returns. Numbers and names of governors, drivers and sensors are shorter.
const LONGEST: usize = 64;

/// Calls `judge` with the trimmed text of a short file. Allocates no memory, so that it can be called for months. Returns
/// `None` if the file cannot be read: sensors come and go, and some refuse a reading for a moment.
fn read<T>(path: &Path, judge: impl FnOnce(&str) -> Option<T>) -> Option<T> {
    let mut bytes = [0; LONGEST];
    let count = File::open(path).and_then(|mut file| file.read(&mut bytes)).ok()?;
    judge(std::str::from_utf8(bytes.get(..count)?).ok()?.trim())
}

fn number(path: &Path) -> Option<i64> {
    read(path, |text| text.parse().ok())
}

/// Reads a text, without the zero byte that ends it in a device tree.
pub(super) fn text(path: &Path) -> Option<String> {
    let bytes = fs::read(path).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    Some(text.trim_matches(|c: char| c == '\0' || c.is_whitespace()).to_owned())
}

/// Returns the entries of a folder whose names are `prefix` and a number, in the order of the numbers.
fn numbered(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let number = |path: &PathBuf| path.file_name()?.to_str()?.strip_prefix(prefix)?.parse::<u32>().ok();
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<_> = entries.filter_map(|entry| Some((number(&entry.path())?, entry.path()))).collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

/// Thermal zones of processors, the best one first. RK3588 has a zone for each cluster, and the hot loop belongs on the big
/// cores; `package-thermal` and `soc-thermal` lie at the centre of the chip. Raspberry Pis and mainline kernels for RK3566
/// have `cpu-thermal`, older Raspberry Pi kernels `bcm2835_thermal`.
const ZONES: [&str; 6] =
    ["bigcore0-thermal", "cpu-thermal", "cpu_thermal", "package-thermal", "soc-thermal", "bcm2835_thermal"];
/// Processor sensors of PCs. They state the critical temperature, which [`PC_ZONES`] often do not.
const CHIPS: [&str; 2] = ["coretemp", "k10temp"];
/// Thermal zones of PCs. `acpitz` comes last: on many boards it reports a constant.
const PC_ZONES: [&str; 3] = ["x86_pkg_temp", "TCPU", "acpitz"];
/// Cooling devices that slow the processor down. Fans and graphics processors are others.
const SLOWING: [&str; 3] = ["thermal-cpufreq", "cpufreq-", "Processor"];

/// Where a sensor that names only its critical temperature is taken for hot, below that temperature. Raspberry Pis, with
/// 90 °C, slow down from 80 °C on.
const BELOW_CRITICAL_C: f32 = 10.0;
/// The limit of a sensor that names no temperatures: the usual passive trip point of boards.
const USUAL_LIMIT_C: f32 = 85.0;
/// Sensors that are not ready return values outside of this range.
const CREDIBLE_C: std::ops::RangeInclusive<f32> = -40.0..=150.0;

#[derive(Debug)]
pub(super) struct Thermometer {
    /// The type of the thermal zone, or the name of the chip.
    name: String,
    file: PathBuf,
    /// At this temperature the processor is hot.
    pub(super) limit_c: f32,
}

impl Thermometer {
    /// Finds the sensor that the settings name, or the best one of the processor.
    fn find(root: &Path, settings: &HardwareSettings) -> Option<Self> {
        let zones = numbered(&root.join("sys/class/thermal"), "thermal_zone");
        let of_zone = |name: &str| {
            let zone = zones.iter().find(|zone| text(&zone.join("type")).as_deref() == Some(name))?;
            Some(Self { name: name.to_owned(), file: zone.join("temp"), limit_c: limit_of_zone(zone) })
        };
        let mut found = if settings.thermal_zone.is_empty() {
            let of_boards = ZONES.into_iter().find_map(of_zone);
            of_boards.or_else(|| Self::of_chip(root)).or_else(|| PC_ZONES.into_iter().find_map(of_zone))?
        } else {
            of_zone(&settings.thermal_zone)?
        };
        if settings.temperature_limit_c > 0 {
            found.limit_c = settings.temperature_limit_c as f32;
        }
        Some(found)
    }

    fn of_chip(root: &Path) -> Option<Self> {
        let chips = numbered(&root.join("sys/class/hwmon"), "hwmon");
        let named = |chip: &PathBuf| text(&chip.join("name")).filter(|name| CHIPS.contains(&name.as_str()));
        let (name, folder) = chips.iter().find_map(|chip| Some((named(chip)?, chip)))?;
        let critical_c = celsius(&folder.join("temp1_crit"));
        let limit_c = critical_c.map_or(USUAL_LIMIT_C, |critical_c| critical_c - BELOW_CRITICAL_C);
        Some(Self { name, file: folder.join("temp1_input"), limit_c })
    }

    pub(super) fn read_c(&self) -> Option<f32> {
        celsius(&self.file)
    }
}

/// Reads a temperature in thousandths of a degree.
fn celsius(path: &Path) -> Option<f32> {
    let celsius = number(path)? as f32 / 1000.0;
    CREDIBLE_C.contains(&celsius).then_some(celsius)
}

/// Returns the temperature from which on a zone is hot: its highest passive trip point, where the kernel slows the
/// processor down, or a distance below its critical one. Some PCs have trip points at or below 0 that mean nothing.
fn limit_of_zone(folder: &Path) -> f32 {
    let trip_point = |index: u32| {
        let kind = text(&folder.join(format!("trip_point_{index}_type")))?;
        Some((kind, celsius(&folder.join(format!("trip_point_{index}_temp"))).filter(|celsius| *celsius > 0.0)))
    };
    let points: Vec<_> = (0..).map_while(trip_point).collect();
    let highest = |wanted: &str| {
        let temperatures = points.iter().filter(|(kind, _)| kind == wanted).filter_map(|(_, celsius)| *celsius);
        temperatures.reduce(f32::max)
    };
    let critical_c = || highest("critical").map(|critical_c| critical_c - BELOW_CRITICAL_C);
    highest("passive").or_else(critical_c).unwrap_or(USUAL_LIMIT_C)
}

/// What tells that the kernel or the processor slows itself down because of heat.
#[derive(Debug, Default)]
pub(super) struct Throttling {
    /// States of cooling devices: 0 while the processor may run at its full clock rate.
    states: Vec<PathBuf>,
    /// How often each core of an x86 processor has slowed itself down.
    counts: Vec<PathBuf>,
}

impl Throttling {
    fn find(root: &Path) -> Self {
        let slows = |device: &PathBuf| {
            read(&device.join("type"), |kind| Some(SLOWING.iter().any(|slowing| kind.starts_with(slowing))))
                == Some(true)
        };
        let devices = numbered(&root.join("sys/class/thermal"), "cooling_device");
        let states = devices.into_iter().filter(slows).map(|device| device.join("cur_state")).collect();
        let cpus = numbered(&root.join("sys/devices/system/cpu"), "cpu").into_iter();
        let of_cpu =
            |cpu: PathBuf| ["core", "package"].map(|part| cpu.join(format!("thermal_throttle/{part}_throttle_count")));
        Self { states, counts: cpus.flat_map(of_cpu).filter(|path| path.exists()).collect() }
    }

    /// Whether a cooling device slows the processor down at present.
    pub(super) fn is_slowed(&self) -> bool {
        self.states.iter().any(|path| number(path).is_some_and(|state| state > 0))
    }

    /// How often the processor has slowed itself down since the machine was started.
    pub(super) fn count(&self) -> i64 {
        self.counts.iter().filter_map(|path| number(path)).sum()
    }
}

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

impl Policy {
    fn find_all(root: &Path) -> Vec<Self> {
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

    /// Describes the governor and the clock rate.
    fn clock(&self) -> Option<String> {
        let governor = text(&self.folder.join("scaling_governor"))?;
        let (now, highest) = (self.khz("scaling_cur_freq")? / 1000, self.khz("cpuinfo_max_freq")? / 1000);
        Some(format!("; {governor} at {now} of {highest} MHz"))
    }

    fn khz(&self, file: &str) -> Option<i64> {
        number(&self.folder.join(file))
    }
}

#[derive(Debug)]
pub struct Sensors {
    pub(super) thermometer: Option<Thermometer>,
    pub(super) throttling: Throttling,
    /// The alarm of the supply voltage, on Raspberry Pis.
    voltage_alarm: Option<PathBuf>,
    policies: Vec<Policy>,
}

/// The sensors' readings at one moment.
#[derive(Debug)]
pub struct Readings {
    /// One line that shows them.
    pub line: String,
    pub impairments: ImpairmentSet,
}

impl Sensors {
    pub fn find(root: &Path, settings: &HardwareSettings) -> Self {
        let chips = numbered(&root.join("sys/class/hwmon"), "hwmon");
        let is_supply = |chip: &&PathBuf| text(&chip.join("name")).as_deref() == Some("rpi_volt");
        Self {
            thermometer: Thermometer::find(root, settings),
            throttling: Throttling::find(root),
            voltage_alarm: chips.iter().find(is_supply).map(|chip| chip.join("in0_lcrit_alarm")),
            policies: Policy::find_all(root),
        }
    }

    /// Whether the supply voltage has been too low within the last 2 s. `None` where the board does not measure it.
    pub(super) fn is_undervolted(&self) -> Option<bool> {
        self.voltage_alarm.as_deref().and_then(number).map(|alarm| alarm != 0)
    }

    pub(super) fn has_slow_governor(&self) -> bool {
        self.policies.iter().any(Policy::is_slow)
    }

    pub fn read(&self) -> Readings {
        let temperature = self.thermometer.as_ref().and_then(|found| Some((found, found.read_c()?)));
        let (is_slowed, is_undervolted) = (self.throttling.is_slowed(), self.is_undervolted());
        let mut impairments = ImpairmentSet::default();
        let is_hot = temperature.is_some_and(|(found, now_c)| now_c >= found.limit_c);
        impairments.set(Impairment::Hot, is_hot || is_slowed);
        impairments.set(Impairment::Undervoltage, is_undervolted == Some(true));
        impairments.set(Impairment::SlowGovernor, self.has_slow_governor());
        let mut line = match temperature {
            Some((Thermometer { name, limit_c, .. }, now_c)) => {
                format!("processor {now_c:.1} °C ({name}), limit {limit_c:.0} °C")
            }
            None => "no temperature sensor".to_owned(),
        };
        line += if is_slowed { ", slowed down" } else { "" };
        let mut clocks: Vec<_> = self.policies.iter().filter_map(Policy::clock).collect();
        clocks.dedup();
        line += &clocks.concat();
        line += match is_undervolted {
            None => "",
            Some(true) => "; supply voltage too low",
            Some(false) => "; supply voltage good",
        };
        Readings { line, impairments }
    }
}
