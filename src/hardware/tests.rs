//! What the sensors of made-up boards show.
#![allow(clippy::unwrap_used)]

use std::fs;

use tempfile::TempDir;

use super::*;

/// A folder with the files of `/sys` and `/proc` that a board has.
pub(super) struct Tree(pub(super) TempDir);

impl Tree {
    pub(super) fn new(files: &[(&str, &str)]) -> Self {
        let tree = Self(tempfile::tempdir().unwrap());
        for (path, text) in files {
            tree.write(path, text);
        }
        tree
    }

    pub(super) fn root(&self) -> &Path {
        self.0.path()
    }

    pub(super) fn write(&self, path: &str, text: &str) {
        let path = self.root().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn found(&self) -> String {
        names(self.read().impairments())
    }

    fn read(&self) -> Readings {
        Sensors::find(self.root(), &HardwareSettings::default()).read()
    }

    /// Returns the sensor that is found, its temperature and its limit.
    fn temperature(&self) -> Option<(String, f32, f32)> {
        self.read().temperature
    }
}

fn names(found: ImpairmentSet) -> String {
    found.to_string()
}

const ZONE: &str = "sys/class/thermal/thermal_zone0";
const POLICY: &str = "sys/devices/system/cpu/cpufreq/policy0";

/// A Raspberry Pi 4: a critical trip point alone, and the alarm of its supply voltage.
fn pi4() -> Tree {
    Tree::new(&[
        ("sys/class/thermal/thermal_zone0/type", "cpu-thermal\n"),
        ("sys/class/thermal/thermal_zone0/temp", "48199\n"),
        ("sys/class/thermal/thermal_zone0/trip_point_0_type", "critical\n"),
        ("sys/class/thermal/thermal_zone0/trip_point_0_temp", "90000\n"),
        ("sys/class/hwmon/hwmon0/name", "cpu_thermal\n"),
        ("sys/class/hwmon/hwmon1/name", "rpi_volt\n"),
        ("sys/class/hwmon/hwmon1/in0_lcrit_alarm", "0\n"),
        ("sys/devices/system/cpu/cpufreq/policy0/scaling_driver", "cpufreq-dt\n"),
        ("sys/devices/system/cpu/cpufreq/policy0/scaling_governor", "ondemand\n"),
        ("sys/devices/system/cpu/cpufreq/policy0/scaling_cur_freq", "1500000\n"),
        ("sys/devices/system/cpu/cpufreq/policy0/cpuinfo_max_freq", "1800000\n"),
    ])
}

#[test]
fn a_board_without_any_sensor_is_not_impaired() {
    let tree = Tree::new(&[]);
    assert_eq!((tree.found().as_str(), tree.read().to_string().as_str()), ("none", "no temperature sensor"));
}

#[test]
fn a_raspberry_pi_is_hot_10_degrees_below_its_critical_temperature_and_shows_its_figures() {
    let tree = pi4();
    let want = "processor 48.2 °C (cpu-thermal), limit 80 °C; ondemand at 1500 of 1800 MHz; supply voltage good";
    assert_eq!((tree.found().as_str(), tree.read().to_string().as_str()), ("none", want));
    tree.write("sys/class/thermal/thermal_zone0/temp", "80100\n");
    assert_eq!(tree.found(), "hot");
}

#[test]
fn the_alarm_of_a_raspberry_pis_supply_voltage_is_an_impairment() {
    let tree = pi4();
    tree.write("sys/class/hwmon/hwmon1/in0_lcrit_alarm", "1\n");
    assert_eq!(tree.found(), "undervoltage");
    assert!(tree.read().to_string().ends_with("; supply voltage too low"));
    // Other chips have alarms of other voltages.
    tree.write("sys/class/hwmon/hwmon1/name", "ina219\n");
    assert_eq!(tree.found(), "none");
}

#[test]
fn rk3588_is_measured_at_its_big_cores_and_hot_at_its_highest_passive_trip_point() {
    let tree = Tree::new(&[]);
    for (index, (kind, temp)) in
        [("gpu-thermal", "99000"), ("soc-thermal", "60000"), ("bigcore0-thermal", "71000")].into_iter().enumerate()
    {
        let zone = format!("sys/class/thermal/thermal_zone{index}");
        tree.write(&format!("{zone}/type"), kind);
        tree.write(&format!("{zone}/temp"), temp);
        for (point, (kind, temp)) in
            [("active", "50000"), ("passive", "75000"), ("passive", "85000"), ("critical", "115000")]
                .into_iter()
                .enumerate()
        {
            tree.write(&format!("{zone}/trip_point_{point}_type"), kind);
            tree.write(&format!("{zone}/trip_point_{point}_temp"), temp);
        }
    }
    assert_eq!(tree.temperature(), Some(("bigcore0-thermal".to_owned(), 71.0, 85.0)));
    let settings = HardwareSettings { thermal_zone: "gpu-thermal".to_owned(), temperature_limit_c: 95 };
    let readings = Sensors::find(tree.root(), &settings).read();
    assert_eq!(readings.temperature, Some(("gpu-thermal".to_owned(), 99.0, 95.0)));
    assert!(readings.impairments().contains(Impairment::Hot));
}

#[test]
fn a_pc_is_measured_by_its_processor_and_not_by_the_constant_of_its_firmware() {
    let tree = Tree::new(&[
        ("sys/class/thermal/thermal_zone0/type", "acpitz"),
        ("sys/class/thermal/thermal_zone0/temp", "27800"),
        ("sys/class/thermal/thermal_zone1/type", "x86_pkg_temp"),
        ("sys/class/thermal/thermal_zone1/temp", "61000"),
        ("sys/class/thermal/thermal_zone1/trip_point_0_type", "passive"),
        ("sys/class/thermal/thermal_zone1/trip_point_0_temp", "0"),
    ]);
    assert_eq!(tree.temperature(), Some(("x86_pkg_temp".to_owned(), 61.0, USUAL)), "a trip point of 0 means nothing");
    tree.write("sys/class/hwmon/hwmon10/name", "coretemp");
    tree.write("sys/class/hwmon/hwmon10/temp1_input", "62000");
    tree.write("sys/class/hwmon/hwmon10/temp1_crit", "105000");
    assert_eq!(tree.temperature(), Some(("coretemp".to_owned(), 62.0, 95.0)));
}

/// The limit of a sensor that names none.
const USUAL: f32 = 85.0;

#[test]
fn a_sensor_that_returns_nonsense_or_an_error_is_no_heat() {
    for temp in ["-274000", "327670", "", "hot"] {
        let tree = pi4();
        tree.write(&format!("{ZONE}/temp"), temp);
        assert_eq!((tree.found(), tree.temperature()), ("none".to_owned(), None), "{temp:?}");
    }
}

#[test]
fn a_processor_that_is_slowed_down_is_hot_whatever_its_temperature_and_a_running_fan_is_not() {
    let tree = pi4();
    tree.write("sys/class/thermal/cooling_device0/type", "pwm-fan");
    tree.write("sys/class/thermal/cooling_device0/cur_state", "3");
    assert_eq!(tree.found(), "none");
    for kind in ["thermal-cpufreq-0", "cpufreq-cpu0", "Processor"] {
        tree.write("sys/class/thermal/cooling_device1/type", kind);
        tree.write("sys/class/thermal/cooling_device1/cur_state", "1");
        assert_eq!(tree.found(), "hot", "{kind}");
        assert!(tree.read().to_string().contains(", slowed down"));
    }
}

#[test]
fn governors_that_save_power_are_slow_and_those_that_follow_the_load_are_not() {
    let cases = [
        ("performance", "cpufreq-dt", "1800000", "", false),
        ("schedutil", "cpufreq-dt", "600000", "", false),
        ("ondemand", "cpufreq-dt", "600000", "", false),
        ("powersave", "cpufreq-dt", "600000", "", true),
        ("powersave", "acpi-cpufreq", "600000", "", true),
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
        tree.write(&format!("{POLICY}/scaling_governor"), governor);
        tree.write(&format!("{POLICY}/scaling_driver"), driver);
        tree.write(&format!("{POLICY}/scaling_cur_freq"), now_khz);
        if !preference.is_empty() {
            tree.write(&format!("{POLICY}/energy_performance_preference"), preference);
        }
        let want = if is_slow { "slow-governor" } else { "none" };
        assert_eq!(tree.found(), want, "{governor} of {driver} at {now_khz} kHz, {preference}");
    }
}

#[test]
fn one_slow_cluster_of_several_is_an_impairment_and_equal_clusters_are_shown_once() {
    let tree = pi4();
    for policy in [4, 6] {
        let policy = format!("sys/devices/system/cpu/cpufreq/policy{policy}");
        tree.write(&format!("{policy}/scaling_governor"), "powersave");
        tree.write(&format!("{policy}/scaling_cur_freq"), "408000");
        tree.write(&format!("{policy}/cpuinfo_max_freq"), "2400000");
    }
    assert_eq!(tree.found(), "slow-governor");
    let text = tree.read().to_string();
    assert!(text.contains("; ondemand at 1500 of 1800 MHz; powersave at 408 of 2400 MHz; supply"), "{text}");
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

    /// Lets this time pass, and returns the impairments at its end.
    fn after_s(&mut self, seconds: u64) -> String {
        for _ in 0..seconds * 20 {
            self.now_us += 50_000;
            self.hardware.poll(self.now_us);
        }
        names(self.hardware.found)
    }

    fn at_c(&mut self, celsius: i32) -> String {
        self.tree.write(&format!("{ZONE}/temp"), &format!("{celsius}000\n"));
        self.after_s(15)
    }
}

#[test]
fn heat_begins_at_the_limit_and_ends_5_degrees_below_it() {
    let mut board = Watched::new(pi4());
    let found: Vec<_> = [79, 80, 78, 76, 75, 74, 79].map(|celsius| board.at_c(celsius)).into();
    assert_eq!(found, ["none", "hot", "hot", "hot", "hot", "none", "none"]);
}

#[test]
fn a_brief_dip_of_the_voltage_counts_for_10_seconds() {
    let mut board = Watched::new(pi4());
    let alarm = "sys/class/hwmon/hwmon1/in0_lcrit_alarm";
    board.tree.write(alarm, "1\n");
    assert_eq!(board.after_s(3), "undervoltage");
    board.tree.write(alarm, "0\n");
    assert_eq!([6, 6].map(|seconds| board.after_s(seconds)), ["undervoltage", "none"]);
}

#[test]
fn a_core_that_has_slowed_itself_down_is_hot_for_10_seconds_and_what_was_before_the_start_does_not_count() {
    let tree = pi4();
    let count = "sys/devices/system/cpu/cpu3/thermal_throttle/core_throttle_count";
    tree.write(count, "7\n");
    let mut board = Watched::new(tree);
    assert_eq!(board.after_s(3), "none");
    board.tree.write(count, "8\n");
    assert_eq!([3, 13].map(|seconds| board.after_s(seconds)), ["hot", "none"]);
}

#[test]
fn a_sensor_whose_driver_is_loaded_late_is_found_within_a_minute() {
    let mut board = Watched::new(Tree::new(&[]));
    assert_eq!(board.after_s(10), "none");
    board.tree.write("sys/class/hwmon/hwmon0/name", "rpi_volt");
    board.tree.write("sys/class/hwmon/hwmon0/in0_lcrit_alarm", "1");
    assert_eq!(board.after_s(61), "undervoltage");
}

#[test]
fn changed_settings_count_at_once() {
    let mut board = Watched::new(pi4());
    assert_eq!(board.after_s(3), "none");
    board.hardware.set(&HardwareSettings { temperature_limit_c: 45, ..HardwareSettings::default() });
    assert_eq!(board.after_s(3), "hot");
}
