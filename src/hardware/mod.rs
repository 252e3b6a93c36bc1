//! What the kernel tells of the board: temperature, supply voltage, clock rates, and which board it is.
//!
//! Role: finds the sensors below a root folder, which is `/` except in tests, and reads them. [`Hardware`] turns the
//! readings into impairments with hysteresis for the service, [`Readings`] shows them once for `facewire check`.
//! Limits: all files are readable by everybody. A Raspberry Pi's flags of a reduced clock rate are not among them:
//! `get_throttled` in `/sys` makes the kernel log a warning with a stack trace, and kernels since 2025 do not have it. Low
//! voltage is in `rpi_volt`, which the kernel asks the firmware for every 2 s, and a Pi that slows down because of heat
//! shows it in its temperature.

mod machine;
mod sensors;

use std::path::PathBuf;

pub use self::machine::{Flags, Machine, memory_mb, processors, system};
pub use self::sensors::{Readings, Sensors};
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

/// Returns the folder that contains `sys` and `proc`: `/`, unless a test names another one.
pub fn root() -> PathBuf {
    std::env::var_os("FACEWIRE_SYSROOT").map_or_else(|| PathBuf::from("/"), PathBuf::from)
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
        let seen = [is_undervolted, self.is_hot(), self.sensors.has_slow_governor()];
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
mod tests {
    use std::fs;
    use std::path::Path;

    use tempfile::TempDir;

    use super::*;

    /// A folder with the files of `/sys` and `/proc` that a board has.
    pub(super) struct Tree(TempDir);

    impl Tree {
        pub(super) fn new(files: &[(&str, &str)]) -> Self {
            let tree = Self(tempfile::tempdir().unwrap());
            tree.write(files);
            tree
        }

        pub(super) fn root(&self) -> &Path {
            self.0.path()
        }

        fn write(&self, files: &[(&str, &str)]) {
            for (path, text) in files {
                let path = self.root().join(path);
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, text).unwrap();
            }
        }

        /// The line that shows the readings, and the impairments.
        fn read(&self) -> (String, String) {
            let Readings { line, impairments } = Sensors::find(self.root(), &HardwareSettings::default()).read();
            (line, impairments.to_string())
        }
    }

    const TEMPERATURE: &str = "sys/class/thermal/thermal_zone0/temp";
    const ALARM: &str = "sys/class/hwmon/hwmon1/in0_lcrit_alarm";
    const GOVERNOR: &str = "sys/devices/system/cpu/cpufreq/policy0/scaling_governor";
    const DRIVER: &str = "sys/devices/system/cpu/cpufreq/policy0/scaling_driver";
    const CLOCK: &str = "sys/devices/system/cpu/cpufreq/policy0/scaling_cur_freq";
    const PREFERENCE: &str = "sys/devices/system/cpu/cpufreq/policy0/energy_performance_preference";

    /// A Raspberry Pi 4: a critical trip point alone, and the alarm of its supply voltage.
    fn pi4() -> Tree {
        Tree::new(&[
            ("sys/class/thermal/thermal_zone0/type", "cpu-thermal\n"),
            (TEMPERATURE, "48199\n"),
            ("sys/class/thermal/thermal_zone0/trip_point_0_type", "critical\n"),
            ("sys/class/thermal/thermal_zone0/trip_point_0_temp", "90000\n"),
            ("sys/class/hwmon/hwmon0/name", "cpu_thermal\n"),
            ("sys/class/hwmon/hwmon1/name", "rpi_volt\n"),
            (ALARM, "0\n"),
            (DRIVER, "cpufreq-dt\n"),
            (GOVERNOR, "ondemand\n"),
            (CLOCK, "1500000\n"),
            ("sys/devices/system/cpu/cpufreq/policy0/cpuinfo_max_freq", "1800000\n"),
        ])
    }

    #[test]
    fn sensors_show_their_figures_and_what_they_mean() {
        let device = "sys/class/thermal/cooling_device1";
        let [kind, state] = ["type", "cur_state"].map(|file| format!("{device}/{file}"));
        let policy = |file| format!("sys/devices/system/cpu/cpufreq/policy4/{file}");
        let [governor, now, highest] = ["scaling_governor", "scaling_cur_freq", "cpuinfo_max_freq"].map(policy);
        let good = "processor 48.2 °C (cpu-thermal), limit 80 °C; ondemand at 1500 of 1800 MHz; supply voltage good";
        let cases: [(&[(&str, &str)], &str, &str); 12] = [
            (&[], "none", good),
            (&[(TEMPERATURE, "79900")], "none", "processor 79.9 °C"),
            (&[(TEMPERATURE, "80100")], "hot", "processor 80.1 °C"),
            // Sensors that are not ready return nonsense.
            (&[(TEMPERATURE, "-274000")], "none", "no temperature sensor"),
            (&[(TEMPERATURE, "327670")], "none", "no temperature sensor"),
            (&[(TEMPERATURE, "")], "none", "no temperature sensor"),
            (&[(ALARM, "1\n")], "undervoltage", "; supply voltage too low"),
            // Other chips have alarms of other voltages.
            (&[(ALARM, "1\n"), ("sys/class/hwmon/hwmon1/name", "ina219")], "none", "1800 MHz"),
            (&[(&kind, "pwm-fan"), (&state, "3")], "none", good),
            (&[(&kind, "thermal-cpufreq-0"), (&state, "1")], "hot", ", slowed down"),
            (&[(&kind, "Processor"), (&state, "1")], "hot", ", slowed down"),
            (
                &[(&governor, "powersave"), (&now, "408000"), (&highest, "2400000")],
                "slow-governor",
                "; ondemand at 1500 of 1800 MHz; powersave at 408 of 2400 MHz; supply",
            ),
        ];
        for (files, found, shown) in cases {
            let tree = pi4();
            tree.write(files);
            let (line, impairments) = tree.read();
            assert!(impairments == found && line.contains(shown), "{files:?}: {impairments}, {line}");
        }
        assert_eq!(Tree::new(&[]).read(), ("no temperature sensor".to_owned(), "none".to_owned()));
    }

    #[test]
    fn rk3588_is_measured_at_its_big_cores_and_hot_at_its_highest_passive_trip_point() {
        let tree = Tree::new(&[]);
        let zones = [("gpu-thermal", "99000"), ("soc-thermal", "60000"), ("bigcore0-thermal", "71000")];
        let points = [("active", "50000"), ("passive", "75000"), ("passive", "85000"), ("critical", "115000")];
        for (index, (kind, temp)) in zones.into_iter().enumerate() {
            let zone = format!("sys/class/thermal/thermal_zone{index}");
            tree.write(&[(&format!("{zone}/type"), kind), (&format!("{zone}/temp"), temp)]);
            for (point, (kind, temp)) in points.into_iter().enumerate() {
                let point = format!("{zone}/trip_point_{point}");
                tree.write(&[(&format!("{point}_type"), kind), (&format!("{point}_temp"), temp)]);
            }
        }
        assert_eq!(tree.read().0, "processor 71.0 °C (bigcore0-thermal), limit 85 °C");
        let settings = HardwareSettings { thermal_zone: "gpu-thermal".to_owned(), temperature_limit_c: 95 };
        let readings = Sensors::find(tree.root(), &settings).read();
        assert_eq!(readings.line, "processor 99.0 °C (gpu-thermal), limit 95 °C");
        assert!(readings.impairments.contains(Impairment::Hot));
    }

    #[test]
    fn a_pc_is_measured_by_its_processor_and_not_by_the_constant_of_its_firmware() {
        let tree = Tree::new(&[
            ("sys/class/thermal/thermal_zone0/type", "acpitz"),
            (TEMPERATURE, "27800"),
            ("sys/class/thermal/thermal_zone1/type", "x86_pkg_temp"),
            ("sys/class/thermal/thermal_zone1/temp", "61000"),
            ("sys/class/thermal/thermal_zone1/trip_point_0_type", "passive"),
            ("sys/class/thermal/thermal_zone1/trip_point_0_temp", "0"),
        ]);
        let of_zone = "processor 61.0 °C (x86_pkg_temp), limit 85 °C";
        assert_eq!(tree.read().0, of_zone, "a trip point of 0 means nothing");
        tree.write(&[
            ("sys/class/hwmon/hwmon10/name", "coretemp"),
            ("sys/class/hwmon/hwmon10/temp1_input", "62000"),
            ("sys/class/hwmon/hwmon10/temp1_crit", "105000"),
        ]);
        assert_eq!(tree.read().0, "processor 62.0 °C (coretemp), limit 95 °C");
    }

    #[test]
    fn governors_that_save_power_are_slow_and_those_that_follow_the_load_are_not() {
        let cases = [
            ("performance", "cpufreq-dt", "1800000", "", false),
            ("schedutil", "cpufreq-dt", "600000", "", false),
            ("ondemand", "cpufreq-dt", "600000", "", false),
            ("powersave", "cpufreq-dt", "600000", "", true),
            ("powersave", "intel_cpufreq", "600000", "", true),
            ("powersave", "intel_pstate", "700000", "balance_performance", false),
            ("powersave", "amd-pstate-epp", "700000", "balance_power", false),
            ("powersave", "intel_pstate", "700000", "power", true),
            ("powersave", "intel_pstate", "700000", "", false),
            ("conservative", "cpufreq-dt", "600000", "", true),
            ("conservative", "cpufreq-dt", "1500000", "", false),
            ("userspace", "cpufreq-dt", "1000000", "", true),
        ];
        for (governor, driver, now_khz, preference, is_slow) in cases {
            let tree = pi4();
            tree.write(&[(GOVERNOR, governor), (DRIVER, driver), (CLOCK, now_khz), (PREFERENCE, preference)]);
            let want = if is_slow { "slow-governor" } else { "none" };
            assert_eq!(tree.read().1, want, "{governor} of {driver} at {now_khz} kHz, {preference}");
        }
    }

    /// The hardware of a board as the service watches it, and the time.
    struct Watched {
        tree: Tree,
        hardware: Hardware,
        now_us: u64,
    }

    impl Watched {
        fn new(tree: Tree) -> Self {
            let hardware = Hardware::new(tree.root().to_owned(), HardwareSettings::default());
            Self { tree, hardware, now_us: 1_000_000_000 }
        }

        /// Lets this time pass after the files have changed, and returns the impairments at its end.
        fn after(&mut self, seconds: u64, files: &[(&str, &str)]) -> String {
            self.tree.write(files);
            for _ in 0..seconds * 20 {
                self.now_us += 50_000;
                self.hardware.poll(self.now_us);
            }
            self.hardware.found.to_string()
        }
    }

    #[test]
    fn heat_begins_at_the_limit_ends_5_degrees_below_it_and_passes_with_a_sensor_that_goes_away() {
        let mut board = Watched::new(pi4());
        let at_c = |celsius: &str| board.after(15, &[(TEMPERATURE, &format!("{celsius}000\n"))]);
        let found = ["79", "80", "78", "76", "75", "74", "79", "80"].map(at_c);
        assert_eq!(found, ["none", "hot", "hot", "hot", "hot", "none", "none", "hot"]);
        fs::remove_file(board.tree.root().join(TEMPERATURE)).unwrap();
        assert_eq!(board.after(15, &[]), "none");
    }

    #[test]
    fn what_was_seen_counts_for_10_seconds_and_a_sensor_that_comes_late_within_a_minute() {
        let count = "sys/devices/system/cpu/cpu3/thermal_throttle/core_throttle_count";
        let tree = pi4();
        tree.write(&[(count, "7\n")]);
        let mut board = Watched::new(tree);
        assert_eq!(board.after(3, &[]), "none", "what a core did before the start does not count");
        assert_eq!(board.after(3, &[(count, "8\n")]), "hot");
        assert_eq!(board.after(13, &[(ALARM, "1\n")]), "undervoltage");
        assert_eq!(board.after(6, &[(ALARM, "0\n")]), "undervoltage");
        assert_eq!(board.after(6, &[]), "none");
        board.hardware.set(&HardwareSettings { temperature_limit_c: 45, ..HardwareSettings::default() });
        assert_eq!(board.after(3, &[]), "hot", "changed settings count at once");

        let mut board = Watched::new(Tree::new(&[]));
        assert_eq!(board.after(10, &[]), "none");
        let late = [("sys/class/hwmon/hwmon0/name", "rpi_volt"), ("sys/class/hwmon/hwmon0/in0_lcrit_alarm", "1")];
        assert_eq!(board.after(61, &late), "undervoltage");
    }
}
