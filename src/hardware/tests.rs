//! What the sensors of made-up boards show.
#![allow(clippy::unwrap_used)]

use std::fs;

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

    fn found(&self) -> String {
        self.read().impairments().to_string()
    }

    fn read(&self) -> Readings {
        Sensors::find(self.root(), &HardwareSettings::default()).read()
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
        let text = tree.read().to_string();
        assert!(tree.found() == found && text.contains(shown), "{files:?}: {}, {text}", tree.found());
    }
    let empty = Tree::new(&[]);
    assert_eq!((empty.found().as_str(), empty.read().to_string().as_str()), ("none", "no temperature sensor"));
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
    assert_eq!(tree.read().temperature, Some(("bigcore0-thermal".to_owned(), 71.0, 85.0)));
    let settings = HardwareSettings { thermal_zone: "gpu-thermal".to_owned(), temperature_limit_c: 95 };
    let readings = Sensors::find(tree.root(), &settings).read();
    assert_eq!(readings.temperature, Some(("gpu-thermal".to_owned(), 99.0, 95.0)));
    assert!(readings.impairments().contains(Impairment::Hot));
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
    let of_zone = Some(("x86_pkg_temp".to_owned(), 61.0, 85.0));
    assert_eq!(tree.read().temperature, of_zone, "a trip point of 0 means nothing");
    tree.write(&[
        ("sys/class/hwmon/hwmon10/name", "coretemp"),
        ("sys/class/hwmon/hwmon10/temp1_input", "62000"),
        ("sys/class/hwmon/hwmon10/temp1_crit", "105000"),
    ]);
    assert_eq!(tree.read().temperature, Some(("coretemp".to_owned(), 62.0, 95.0)));
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
        assert_eq!(tree.found(), want, "{governor} of {driver} at {now_khz} kHz, {preference}");
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
fn heat_begins_at_the_limit_and_ends_5_degrees_below_it() {
    let mut board = Watched::new(pi4());
    let at_c = |celsius: &str| board.after(15, &[(TEMPERATURE, &format!("{celsius}000\n"))]);
    let found = ["79", "80", "78", "76", "75", "74", "79"].map(at_c);
    assert_eq!(found, ["none", "hot", "hot", "hot", "hot", "none", "none"]);
}

#[test]
fn a_brief_dip_of_the_voltage_counts_for_10_seconds() {
    let mut board = Watched::new(pi4());
    assert_eq!(board.after(3, &[(ALARM, "1\n")]), "undervoltage");
    assert_eq!(board.after(6, &[(ALARM, "0\n")]), "undervoltage");
    assert_eq!(board.after(6, &[]), "none");
}

#[test]
fn a_core_that_has_slowed_itself_down_is_hot_for_10_seconds_and_what_was_before_the_start_does_not_count() {
    let count = "sys/devices/system/cpu/cpu3/thermal_throttle/core_throttle_count";
    let tree = pi4();
    tree.write(&[(count, "7\n")]);
    let mut board = Watched::new(tree);
    assert_eq!(board.after(3, &[]), "none");
    assert_eq!(board.after(3, &[(count, "8\n")]), "hot");
    assert_eq!(board.after(13, &[]), "none");
}

#[test]
fn a_sensor_whose_driver_is_loaded_late_is_found_within_a_minute() {
    let mut board = Watched::new(Tree::new(&[]));
    assert_eq!(board.after(10, &[]), "none");
    let late = [("sys/class/hwmon/hwmon0/name", "rpi_volt"), ("sys/class/hwmon/hwmon0/in0_lcrit_alarm", "1")];
    assert_eq!(board.after(61, &late), "undervoltage");
}

#[test]
fn changed_settings_count_at_once() {
    let mut board = Watched::new(pi4());
    assert_eq!(board.after(3, &[]), "none");
    board.hardware.set(&HardwareSettings { temperature_limit_c: 45, ..HardwareSettings::default() });
    assert_eq!(board.after(3, &[]), "hot");
}
