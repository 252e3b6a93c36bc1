//! What the kernel tells of the board: temperature, supply voltage, clock rates, and which board it is.
//!
//! Role: finds the sensors below a root folder, which is `/` except in tests, and reads them. [`Hardware`] turns the
//! readings into impairments with hysteresis for the service, [`Readings`] shows them once for `facewire check`.
//! Limits: all files are readable by everybody. A Raspberry Pi's flags of a reduced clock rate are not among them:
//! `get_throttled` in `/sys` makes the kernel log a warning with a stack trace, and kernels since 2025 do not have it. Low
//! voltage is in `rpi_volt`, which the kernel asks the firmware for every 2 s, and a Pi that slows down because of heat
//! shows it in its temperature.

mod board;
mod sensors;

use std::fmt;
use std::path::{Path, PathBuf};

pub use self::board::{Board, Flags, memory_mb, processors, system};
pub use self::sensors::root;
use self::sensors::{Clock, Policy, Thermometer, Throttling, number, numbered, text};
use crate::config::HardwareSettings;
use crate::impairment::{Impairment, ImpairmentSet};

/// Time between two readings.
const POLL_US: u64 = 2_000_000;
/// Time after which sensors are looked for again, because drivers may be loaded late.
const SEARCH_US: u64 = 60_000_000;
/// An impairment lasts this long after it was seen last, so that brief dips of the voltage do not come and go.
const HOLD_US: u64 = 10_000_000;
/// A hot processor counts as hot until it is this much below the limit.
const HYSTERESIS_C: f32 = 5.0;

#[derive(Debug)]
pub struct Sensors {
    thermometer: Option<Thermometer>,
    throttling: Throttling,
    /// The alarm of the supply voltage, on Raspberry Pis.
    voltage_alarm: Option<PathBuf>,
    policies: Vec<Policy>,
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
    fn is_undervolted(&self) -> Option<bool> {
        self.voltage_alarm.as_deref().and_then(number).map(|alarm| alarm != 0)
    }

    pub fn read(&self) -> Readings {
        let thermometer = self.thermometer.as_ref();
        Readings {
            temperature: thermometer.and_then(|found| Some((found.name.clone(), found.read_c()?, found.limit_c))),
            is_throttled: self.throttling.is_slowed(),
            is_undervolted: self.is_undervolted(),
            clocks: self.policies.iter().filter_map(Policy::clock).collect(),
            has_slow_governor: self.policies.iter().any(Policy::is_slow),
        }
    }
}

/// The sensors' readings at one moment. They display as one line.
#[derive(Debug, Clone, PartialEq)]
pub struct Readings {
    /// The sensor's name, the temperature and the limit, in degrees Celsius.
    temperature: Option<(String, f32, f32)>,
    is_throttled: bool,
    is_undervolted: Option<bool>,
    clocks: Vec<Clock>,
    has_slow_governor: bool,
}

impl Readings {
    pub fn impairments(&self) -> ImpairmentSet {
        let mut found = ImpairmentSet::default();
        let is_hot = self.temperature.as_ref().is_some_and(|(_, now_c, limit_c)| now_c >= limit_c);
        found.set(Impairment::Hot, is_hot || self.is_throttled);
        found.set(Impairment::Undervoltage, self.is_undervolted == Some(true));
        found.set(Impairment::SlowGovernor, self.has_slow_governor);
        found
    }
}

impl fmt::Display for Readings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.temperature {
            Some((name, now_c, limit_c)) => write!(f, "processor {now_c:.1} °C ({name}), limit {limit_c:.0} °C")?,
            None => f.write_str("no temperature sensor")?,
        }
        if self.is_throttled {
            f.write_str(", slowed down")?;
        }
        let mut last = None;
        for clock in self.clocks.iter().filter(|clock| last.replace(*clock) != Some(*clock)) {
            write!(f, "; {} at {} of {} MHz", clock.governor, clock.now_mhz, clock.highest_mhz)?;
        }
        match self.is_undervolted {
            None => Ok(()),
            Some(true) => f.write_str("; supply voltage too low"),
            Some(false) => f.write_str("; supply voltage good"),
        }
    }
}

/// The hardware as the service watches it: polled every [`POLL_US`], with hysteresis.
#[derive(Debug)]
pub struct Hardware {
    root: PathBuf,
    settings: HardwareSettings,
    sensors: Sensors,
    next_poll_us: u64,
    next_search_us: u64,
    throttle_count: i64,
    /// Until when each of [`Hardware::FINDS`] lasts.
    until_us: [u64; 3],
    found: ImpairmentSet,
}

impl Hardware {
    pub const FINDS: [Impairment; 3] = [Impairment::Undervoltage, Impairment::Hot, Impairment::SlowGovernor];

    pub fn new(root: PathBuf, settings: HardwareSettings) -> Self {
        let sensors = Sensors::find(&root, &settings);
        Self {
            throttle_count: sensors.throttling.count(),
            root,
            settings,
            sensors,
            next_poll_us: 0,
            next_search_us: 0,
            until_us: [0; 3],
            found: ImpairmentSet::default(),
        }
    }

    pub fn set(&mut self, settings: &HardwareSettings) {
        if self.settings != *settings {
            self.settings = settings.clone();
            self.next_search_us = 0;
        }
    }

    /// Reads the sensors if it is time to. Returns the impairments of [`Hardware::FINDS`] if they are others than before.
    pub fn poll(&mut self, now_us: u64) -> Option<ImpairmentSet> {
        if now_us < self.next_poll_us {
            return None;
        }
        self.next_poll_us = now_us + POLL_US;
        if now_us >= self.next_search_us {
            self.next_search_us = now_us + SEARCH_US;
            self.sensors = Sensors::find(&self.root, &self.settings);
        }
        let before = self.found;
        let is_undervolted = self.sensors.is_undervolted() == Some(true);
        let is_slow = self.sensors.policies.iter().any(Policy::is_slow);
        let seen = [is_undervolted, self.is_hot(), is_slow];
        for ((impairment, until_us), is_seen) in Self::FINDS.into_iter().zip(&mut self.until_us).zip(seen) {
            if is_seen {
                *until_us = now_us + HOLD_US;
            }
            self.found.set(impairment, now_us < *until_us);
        }
        (self.found != before).then_some(self.found)
    }

    /// Whether the processor is hot, was hot and has not cooled down enough, or has been slowed down since the last call.
    fn is_hot(&mut self) -> bool {
        let count = self.sensors.throttling.count();
        let has_throttled = count > std::mem::replace(&mut self.throttle_count, count);
        let was_hot = self.found.contains(Impairment::Hot);
        let is_above = self.sensors.thermometer.as_ref().is_some_and(|found| {
            let limit_c = if was_hot { found.limit_c - HYSTERESIS_C } else { found.limit_c };
            found.read_c().is_some_and(|now_c| now_c >= limit_c)
        });
        is_above || has_throttled || self.sensors.throttling.is_slowed()
    }
}

#[cfg(test)]
mod tests;
