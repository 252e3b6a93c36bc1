//! The sensors of a board as the kernel shows them in `/sys`: temperature, throttling, clock rates and supply voltage.

use std::fs;
use std::path::{Path, PathBuf};

use crate::{Impairment, ImpairmentSet};

/// Reads a text without the zero byte that ends it in a device tree. Sensors come and go, and some refuse a reading for a
/// moment.
pub(super) fn text(path: &Path) -> Option<String> {
    let bytes = fs::read(path).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    Some(text.trim_matches(|c: char| c == '\0' || c.is_whitespace()).to_owned())
}

fn number(path: &Path) -> Option<i64> {
    text(path)?.parse().ok()
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
/// Types of the cooling devices that slow the processor down. Others drive fans or slow a graphics processor down.
const SLOWING: [&str; 3] = ["thermal-cpufreq", "cpufreq-", "Processor"];

/// A sensor that names only its critical temperature counts as hot from so far below it on. Raspberry Pis, with
/// 90 °C, slow down from 80 °C on.
const BELOW_CRITICAL_C: f32 = 10.0;
/// The limit of a sensor that names no temperatures: the usual passive trip point of boards.
const USUAL_LIMIT_C: f32 = 85.0;
/// Sensors that are not ready return values outside of this range.
const CREDIBLE_C: std::ops::RangeInclusive<f32> = -40.0..=150.0;

/// What an owner says of the sensors.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct HardwareSettings {
    /// The type of the thermal zone to read. Empty for the one that fits best.
    pub thermal_zone: String,
    /// The temperature from which on the processor is hot. 0 for the limit that the sensor names.
    pub temperature_limit_c: u32,
}

#[derive(Debug)]
struct Thermometer {
    /// The type of the thermal zone, or the name of the chip.
    name: String,
    file: PathBuf,
    limit_c: f32,
}

impl Thermometer {
    fn find(root: &Path, settings: &HardwareSettings) -> Option<Self> {
        let zones = numbered(&root.join("sys/class/thermal"), "thermal_zone");
        let of_zone = |name: &str| {
            let zone = zones.iter().find(|zone| text(&zone.join("type")).as_deref() == Some(name))?;
            Some(Self { name: name.to_owned(), file: zone.join("temp"), limit_c: limit_of_zone(zone) })
        };
        let of_chip = || {
            let chips = numbered(&root.join("sys/class/hwmon"), "hwmon").into_iter();
            let mut named = chips.filter_map(|chip| Some((text(&chip.join("name"))?, chip)));
            let (name, chip) = named.find(|(name, _)| CHIPS.contains(&name.as_str()))?;
            let critical_c = celsius(&chip.join("temp1_crit"));
            let limit_c = critical_c.map_or(USUAL_LIMIT_C, |critical_c| critical_c - BELOW_CRITICAL_C);
            Some(Self { name, file: chip.join("temp1_input"), limit_c })
        };
        let mut found = if settings.thermal_zone.is_empty() {
            let of_boards = ZONES.into_iter().find_map(of_zone);
            of_boards.or_else(of_chip).or_else(|| PC_ZONES.into_iter().find_map(of_zone))?
        } else {
            of_zone(&settings.thermal_zone)?
        };
        if settings.temperature_limit_c > 0 {
            found.limit_c = settings.temperature_limit_c as f32;
        }
        Some(found)
    }
}

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

/// Drivers whose governor "powersave" chooses the rate by load, as "schedutil" does with other drivers. The preference for
/// energy or performance is a separate setting there.
const DYNAMIC_DRIVERS: [&str; 2] = ["intel_pstate", "amd-pstate-epp"];
/// A processor whose governor is slow to raise the rate is slow below this share of its highest rate.
const SLOW_PERCENT: i64 = 60;

/// Describes the governor and the clock rate of processors that share one clock, given their folder.
fn clock(folder: &Path) -> Option<String> {
    let governor = text(&folder.join("scaling_governor"))?;
    let mhz = |file| Some(number(&folder.join(file))? / 1000);
    Some(format!("; {governor} at {} of {} MHz", mhz("scaling_cur_freq")?, mhz("cpuinfo_max_freq")?))
}

/// Whether these processors run slower than they could, or soon will, because the governor saves power.
fn has_slow_governor(folder: &Path) -> Option<bool> {
    let read = |file| text(&folder.join(file));
    let khz = |file| number(&folder.join(file));
    Some(match read("scaling_governor")?.as_str() {
        "powersave" if read("scaling_driver").is_some_and(|driver| DYNAMIC_DRIVERS.contains(&driver.as_str())) => {
            read("energy_performance_preference")? == "power"
        }
        "powersave" => true,
        "conservative" | "userspace" => khz("scaling_cur_freq")? * 100 < khz("cpuinfo_max_freq")? * SLOW_PERCENT,
        _ => false,
    })
}

#[derive(Debug)]
pub struct Sensors {
    thermometer: Option<Thermometer>,
    /// States of cooling devices: 0 while the processor may run at its full clock rate.
    cooling_states: Vec<PathBuf>,
    /// How often each core of an x86 processor has slowed itself down.
    throttle_counts: Vec<PathBuf>,
    /// The alarm of the supply voltage, on Raspberry Pis: whether it has been too low within the last 2 s.
    voltage_alarm: Option<PathBuf>,
    /// Folders of groups of processors that share one clock.
    policies: Vec<PathBuf>,
}

impl Sensors {
    pub fn find(root: &Path, settings: &HardwareSettings) -> Self {
        let chips = numbered(&root.join("sys/class/hwmon"), "hwmon");
        let is_supply = |chip: &&PathBuf| text(&chip.join("name")).as_deref() == Some("rpi_volt");
        let devices = numbered(&root.join("sys/class/thermal"), "cooling_device").into_iter();
        let slows = |device: &PathBuf| {
            text(&device.join("type")).is_some_and(|kind| SLOWING.iter().any(|slowing| kind.starts_with(slowing)))
        };
        let cpus = numbered(&root.join("sys/devices/system/cpu"), "cpu").into_iter();
        let counts =
            |cpu: PathBuf| ["core", "package"].map(|part| cpu.join(format!("thermal_throttle/{part}_throttle_count")));
        Self {
            thermometer: Thermometer::find(root, settings),
            cooling_states: devices.filter(slows).map(|device| device.join("cur_state")).collect(),
            throttle_counts: cpus.flat_map(counts).filter(|path| path.exists()).collect(),
            voltage_alarm: chips.iter().find(is_supply).map(|chip| chip.join("in0_lcrit_alarm")),
            policies: numbered(&root.join("sys/devices/system/cpu/cpufreq"), "policy"),
        }
    }

    /// How often the processor has slowed itself down since the machine was started.
    pub(super) fn throttle_count(&self) -> i64 {
        self.throttle_counts.iter().filter_map(|path| number(path)).sum()
    }

    pub fn temperature_c(&self) -> Option<f32> {
        celsius(&self.thermometer.as_ref()?.file)
    }

    /// Whether the supply voltage is too low, where a sensor tells.
    pub fn is_undervolted(&self) -> Option<bool> {
        number(self.voltage_alarm.as_deref()?).map(|alarm| alarm != 0)
    }

    /// Returns a line that shows the sensors, and what they mean. The processor is hot from so far below its limit on.
    pub fn read(&self, below_limit_c: f32) -> (String, ImpairmentSet) {
        let temperature = self.thermometer.as_ref().zip(self.temperature_c());
        let is_slowed = self.cooling_states.iter().any(|path| number(path).is_some_and(|state| state > 0));
        let is_undervolted = self.is_undervolted();
        let is_hot = temperature.is_some_and(|(found, now_c)| now_c >= found.limit_c - below_limit_c);
        let has_slow_governor = self.policies.iter().any(|folder| has_slow_governor(folder) == Some(true));
        let mut impairments = ImpairmentSet::default();
        impairments.set(Impairment::Hot, is_hot || is_slowed);
        impairments.set(Impairment::Undervoltage, is_undervolted == Some(true));
        impairments.set(Impairment::SlowGovernor, has_slow_governor);
        let mut line = match temperature {
            Some((Thermometer { name, limit_c, .. }, now_c)) => {
                format!("processor {now_c:.1} °C ({name}), limit {limit_c:.0} °C")
            }
            None => "no temperature sensor".to_owned(),
        };
        line += if is_slowed { ", slowed down" } else { "" };
        let mut clocks: Vec<_> = self.policies.iter().filter_map(|folder| clock(folder)).collect();
        clocks.dedup();
        line += &clocks.concat();
        line += match is_undervolted {
            None => "",
            Some(false) => "; supply voltage good",
            Some(true) => "; supply voltage too low",
        };
        (line, impairments)
    }
}
