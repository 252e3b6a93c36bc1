//! The board: which one it is, its identifier, and what the kernel tells of its temperature, supply voltage and clock rates.
//! It also describes serial ports, what makes tracking poor, on the board or in front of the camera, a name server out of
//! reach, and files in a wrong encoding, with the remedies.
//!
//! [`Hardware`] turns the readings of the [`Sensors`] into impairments with hysteresis for the service.
//! All files are readable by everybody. A Raspberry Pi's flags of a reduced clock rate are not among them:
//! `get_throttled` in `/sys` makes the kernel log a warning with a stack trace, and kernels since 2025 do not have it. Low
//! voltage is in `rpi_volt`, which the kernel asks the firmware for every 2 s, and a Pi that slows down because of heat
//! shows it in its temperature.

mod encoding;
mod impairment;
mod machine;
mod network;
mod ports;
mod refusal;
mod sensors;

use std::path::PathBuf;

pub use self::encoding::{WrongEncoding, is_utf16, utf8};
pub use self::impairment::{Impairment, ImpairmentSet, Impairments};
pub use self::machine::{Flags, Machine, memory_mb, processors, system};
pub use self::network::{machine_id, name_server_remedy};
pub use self::ports::{Attached, UsbId, attached, latency_remedy, links_to, restarts};
pub use self::refusal::{i2c_refusal, serial_refusal};
pub use self::sensors::{HardwareSettings, Sensors};

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
        let (throttle_count, found) = (sensors.throttle_count(), ImpairmentSet::default());
        Self { root, settings, sensors, next_poll_us: 0, next_search_us: 0, throttle_count, until_us: [0; 3], found }
    }

    /// Reads the sensors if it is time to. Returns the impairments of [`Hardware::FINDS`] if they are others than before.
    pub fn poll(&mut self, settings: &HardwareSettings, now_us: u64) -> Option<ImpairmentSet> {
        if now_us < self.next_poll_us {
            return None;
        }
        self.next_poll_us = now_us + POLL_US;
        if now_us >= self.next_search_us || self.settings != *settings {
            self.next_search_us = now_us + SEARCH_US;
            self.settings.clone_from(settings);
            self.sensors = Sensors::find(&self.root, settings);
        }
        let before = self.found;
        let below_limit_c = if before.contains(Impairment::Hot) { HYSTERESIS_C } else { 0.0 };
        let (_, mut seen) = self.sensors.read(below_limit_c);
        let count = self.sensors.throttle_count();
        if count > std::mem::replace(&mut self.throttle_count, count) {
            seen.set(Impairment::Hot, true);
        }
        for (impairment, until_us) in Self::FINDS.into_iter().zip(&mut self.until_us) {
            if seen.contains(impairment) {
                *until_us = now_us + HOLD_US;
            }
            self.found.set(impairment, now_us < *until_us);
        }
        (self.found != before).then_some(self.found)
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
            files.iter().for_each(|(path, text)| tree.write_file(path, text));
            tree
        }

        pub(super) fn root(&self) -> &Path {
            self.0.path()
        }

        fn write_file(&self, path: &str, text: &str) {
            let path = self.root().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }

        /// Writes files of sensors, each given as `path=text` without the folder that its kind of sensor is in.
        fn write(&self, files: &str) {
            for (path, text) in files.split_whitespace().map(|file| file.split_once('=').unwrap()) {
                let (sensor, _) = path.split_once('/').unwrap();
                let folder = match sensor.trim_end_matches(|c: char| c.is_ascii_digit()) {
                    "thermal_zone" | "cooling_device" => "class/thermal",
                    "hwmon" => "class/hwmon",
                    "policy" => "devices/system/cpu/cpufreq",
                    _ => "devices/system/cpu",
                };
                self.write_file(&format!("sys/{folder}/{path}"), &format!("{text}\n"));
            }
        }
    }

    /// A Raspberry Pi 4: a critical trip point alone, and the alarm of its supply voltage.
    const PI4: &str = "thermal_zone0/type=cpu-thermal thermal_zone0/temp=48199 thermal_zone0/trip_point_0_type=critical
        thermal_zone0/trip_point_0_temp=90000 hwmon0/name=cpu_thermal hwmon1/name=rpi_volt hwmon1/in0_lcrit_alarm=0
        policy0/scaling_driver=cpufreq-dt policy0/scaling_governor=ondemand policy0/scaling_cur_freq=1500000
        policy0/cpuinfo_max_freq=1800000";
    const RK3588: &str = "thermal_zone0/type=gpu-thermal thermal_zone0/temp=99000 thermal_zone1/type=soc-thermal
        thermal_zone1/temp=60000 thermal_zone2/type=bigcore0-thermal thermal_zone2/temp=71000
        thermal_zone2/trip_point_0_type=active thermal_zone2/trip_point_0_temp=50000
        thermal_zone2/trip_point_1_type=passive thermal_zone2/trip_point_1_temp=75000
        thermal_zone2/trip_point_2_type=passive thermal_zone2/trip_point_2_temp=85000
        thermal_zone2/trip_point_3_type=critical thermal_zone2/trip_point_3_temp=115000";
    const PSTATE: &str = "policy0/scaling_driver=intel_pstate policy0/scaling_governor=powersave
        policy0/scaling_cur_freq=700000 policy0/cpuinfo_max_freq=1800000";
    /// A PC whose firmware reports a constant temperature, and a trip point of 0, which means nothing.
    const PC: &str = "thermal_zone0/type=acpitz thermal_zone0/temp=27800 thermal_zone1/type=x86_pkg_temp
        thermal_zone1/temp=61000 thermal_zone1/trip_point_0_type=passive thermal_zone1/trip_point_0_temp=0";

    #[test]
    fn sensors_show_their_figures_and_what_they_mean() {
        let good = "processor 48.2 °C (cpu-thermal), limit 80 °C; ondemand at 1500 of 1800 MHz; supply voltage good";
        let coretemp = "hwmon10/name=coretemp hwmon10/temp1_input=62000 hwmon10/temp1_crit=105000";
        let slow =
            "policy4/scaling_governor=powersave policy4/scaling_cur_freq=408000 policy4/cpuinfo_max_freq=2400000";
        let slow_shown = "; ondemand at 1500 of 1800 MHz; powersave at 408 of 2400 MHz; supply";
        let cases = [
            ("", "", "none", "no temperature sensor"),
            (PI4, "", "none", good),
            (PI4, "thermal_zone0/temp=79900", "none", "processor 79.9 °C"),
            (PI4, "thermal_zone0/temp=80100", "hot", "processor 80.1 °C"),
            // Sensors that are not ready return nonsense.
            (PI4, "thermal_zone0/temp=-274000", "none", "no temperature sensor"),
            (PI4, "hwmon1/in0_lcrit_alarm=1", "undervoltage", "; supply voltage too low"),
            // Other chips have alarms of other voltages.
            (PI4, "hwmon1/in0_lcrit_alarm=1 hwmon1/name=ina219", "none", "1800 MHz"),
            (PI4, "cooling_device1/type=pwm-fan cooling_device1/cur_state=3", "none", good),
            (PI4, "cooling_device1/type=thermal-cpufreq-0 cooling_device1/cur_state=1", "hot", ", slowed down"),
            (PI4, slow, "slow-governor", slow_shown),
            // Governors that save power are slow, and those that follow the load are not.
            (PI4, "policy0/scaling_cur_freq=600000", "none", "; ondemand at 600 of 1800 MHz"),
            (PI4, "policy0/scaling_governor=powersave policy0/scaling_driver=intel_cpufreq", "slow-governor", ""),
            (PI4, "policy0/scaling_governor=conservative", "none", "; conservative at 1500 of 1800 MHz"),
            (PI4, "policy0/scaling_governor=userspace policy0/scaling_cur_freq=1000000", "slow-governor", ""),
            (PSTATE, "policy0/energy_performance_preference=balance_performance", "none", "; powersave at 700"),
            (PSTATE, "policy0/energy_performance_preference=power", "slow-governor", ""),
            (RK3588, "", "none", "processor 71.0 °C (bigcore0-thermal), limit 85 °C"),
            (PC, "", "none", "processor 61.0 °C (x86_pkg_temp), limit 85 °C"),
            (PC, coretemp, "none", "processor 62.0 °C (coretemp), limit 95 °C"),
        ];
        let read = |files: [&str; 2], settings| {
            let tree = Tree::new(&[]);
            files.iter().for_each(|files| tree.write(files));
            let (line, impairments) = Sensors::find(tree.root(), &settings).read(0.0);
            (line, impairments.to_string())
        };
        for (board, files, found, shown) in cases {
            let (line, impairments) = read([board, files], HardwareSettings::default());
            assert!(impairments == found && line.contains(shown), "{files}: {impairments}, {line}");
        }
        let settings = HardwareSettings { thermal_zone: "gpu-thermal".to_owned(), temperature_limit_c: 95 };
        let want = ("processor 99.0 °C (gpu-thermal), limit 95 °C".to_owned(), "hot".to_owned());
        assert_eq!(read([RK3588, ""], settings), want);
    }

    /// The hardware of a board as the service watches it, and the time.
    struct Watched(Tree, Hardware, u64, HardwareSettings);

    impl Watched {
        fn new(files: &str) -> Self {
            let tree = Tree::new(&[]);
            tree.write(files);
            let hardware = Hardware::new(tree.root().to_owned(), HardwareSettings::default());
            Self(tree, hardware, 1_000_000_000, HardwareSettings::default())
        }

        /// Lets this time pass after the files have changed, and returns the impairments at its end.
        fn after(&mut self, seconds: u64, files: &str) -> String {
            let Self(tree, hardware, now_us, settings) = self;
            tree.write(files);
            for _ in 0..seconds * 20 {
                *now_us += 50_000;
                hardware.poll(settings, *now_us);
            }
            hardware.found.to_string()
        }
    }

    #[test]
    fn heat_begins_at_the_limit_ends_5_degrees_below_it_and_passes_with_a_sensor_that_goes_away() {
        let mut board = Watched::new(PI4);
        let at_c = |celsius: &str| board.after(15, &format!("thermal_zone0/temp={celsius}000"));
        let found = ["79", "80", "78", "76", "75", "74", "79", "80"].map(at_c);
        assert_eq!(found, ["none", "hot", "hot", "hot", "hot", "none", "none", "hot"]);
        fs::remove_file(board.0.root().join("sys/class/thermal/thermal_zone0/temp")).unwrap();
        assert_eq!(board.after(15, ""), "none");
    }

    #[test]
    fn what_was_seen_counts_for_10_seconds_and_a_sensor_that_comes_late_within_a_minute() {
        let mut board = Watched::new(&format!("{PI4} cpu3/thermal_throttle/core_throttle_count=7"));
        assert_eq!(board.after(3, ""), "none", "what a core did before the start does not count");
        assert_eq!(board.after(3, "cpu3/thermal_throttle/core_throttle_count=8"), "hot");
        assert_eq!(board.after(13, "hwmon1/in0_lcrit_alarm=1"), "undervoltage");
        assert_eq!(board.after(6, "hwmon1/in0_lcrit_alarm=0"), "undervoltage");
        assert_eq!(board.after(6, ""), "none");
        board.3.temperature_limit_c = 45;
        assert_eq!(board.after(3, ""), "hot", "changed settings count at once");
        let mut board = Watched::new("");
        assert_eq!(board.after(10, ""), "none");
        assert_eq!(board.after(61, "hwmon0/name=rpi_volt hwmon0/in0_lcrit_alarm=1"), "undervoltage");
    }
}
