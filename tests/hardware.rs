//! The program on made-up boards, whose `/sys` and `/proc` lie in a folder of the test.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;

use common::program::{Run, facewire, settings, text};
use common::service::{Receiver, Service};
use facewire_packet::State;
use rustix::process::Signal;
use tempfile::TempDir;

/// A Raspberry Pi 4 that is too hot, has a weak power supply, and saves power.
const IMPAIRED_PI4: [(&str, &str); 10] = [
    ("sys/class/thermal/thermal_zone0/type", "cpu-thermal\n"),
    ("sys/class/thermal/thermal_zone0/temp", "82300\n"),
    ("sys/class/thermal/thermal_zone0/trip_point_0_type", "critical\n"),
    ("sys/class/thermal/thermal_zone0/trip_point_0_temp", "90000\n"),
    ("sys/class/hwmon/hwmon1/name", "rpi_volt\n"),
    ("sys/class/hwmon/hwmon1/in0_lcrit_alarm", "1\n"),
    ("sys/devices/system/cpu/cpufreq/policy0/scaling_driver", "cpufreq-dt\n"),
    ("sys/devices/system/cpu/cpufreq/policy0/scaling_governor", "powersave\n"),
    ("sys/devices/system/cpu/cpufreq/policy0/scaling_cur_freq", "600000\n"),
    ("sys/devices/system/cpu/cpufreq/policy0/cpuinfo_max_freq", "1800000\n"),
];

/// Returns a folder with these files.
fn board(files: &[(&str, &str)]) -> TempDir {
    let root = tempfile::tempdir().unwrap();
    for (path, text) in files {
        let path = root.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    root
}

#[test]
fn the_service_says_once_with_the_remedy_that_the_board_is_hot_undervolted_and_slow() {
    let (root, receiver) = (board(&IMPAIRED_PI4), Receiver::new());
    let service = Service::start_with("[camera]\ndevice = \"demo\"\n", &[receiver.address()], |command| {
        command.env("FACEWIRE_SYSROOT", root.path()).stderr(std::process::Stdio::piped())
    });
    receiver.until(|packet| packet.state == State::Live);
    let (run, _) = service.stop(Signal::TERM);
    let log = run.succeeded().err;
    for sentence in
        ["use a stronger power supply", "add a heat sink or a fan", "write \"performance\" or \"schedutil\""]
    {
        assert_eq!(log.matches(sentence).count(), 1, "{sentence}: {log}");
    }
    assert!(log.lines().last().unwrap().contains(" impaired_by=undervoltage,hot,slow-governor "), "{log}");
}

#[test]
fn check_shows_the_figures_of_the_board_and_the_remedy_for_what_slows_it_down_and_succeeds() {
    let root = board(&IMPAIRED_PI4);
    let file = settings("[camera]\ndevice = \"demo\"\n");
    let check = || {
        let mut command = facewire(["check", "--config", text(file.path())]);
        Run::of(command.env("FACEWIRE_SYSROOT", root.path())).succeeded().out
    };
    let out = check();
    let of_board: Vec<_> = out.lines().filter(|line| line.starts_with("board ")).collect();
    let figures = "processor 82.3 °C (cpu-thermal), limit 80 °C; powersave at 600 of 1800 MHz; supply voltage too low";
    assert!(of_board[0].starts_with("board     ok: ") && of_board[0].ends_with(figures), "{out}");
    let poor = [
        "board     POOR: the supply voltage",
        "board     POOR: the board is so hot",
        "board     POOR: a processor saves",
    ];
    assert_eq!(of_board.len(), 1 + poor.len(), "{out}");
    assert!(of_board[1..].iter().zip(poor).all(|(line, want)| line.starts_with(want)), "{out}");

    for (path, good) in [(1, "48000"), (5, "0"), (7, "ondemand")] {
        fs::write(root.path().join(IMPAIRED_PI4[path].0), good).unwrap();
    }
    assert!(!check().contains("POOR"), "{}", check());
}

#[test]
fn the_board_is_recognised_and_told_by_run_and_check_unless_the_settings_name_another_one() {
    let root = board(&IMPAIRED_PI4);
    fs::create_dir_all(root.path().join("proc/device-tree")).unwrap();
    fs::write(root.path().join("proc/device-tree/compatible"), "raspberrypi,4-model-b\0brcm,bcm2711\0").unwrap();
    fs::write(root.path().join("proc/device-tree/model"), "Raspberry Pi 4 Model B Rev 1.4\0").unwrap();
    let told = "pi4, recognised by \"brcm,bcm2711\" in the device tree (Raspberry Pi 4 Model B Rev 1.4)";
    let check = |arguments: &[&str], toml: &str| {
        let file = settings(&["[camera]\ndevice = \"demo\"\n", toml].concat());
        let mut command = facewire([&["check", "--config", text(file.path())], arguments].concat());
        Run::of(command.env("FACEWIRE_SYSROOT", root.path())).succeeded().out
    };
    assert!(check(&[], "").contains(&format!("board     ok: {told}; processor")), "{}", check(&[], ""));
    let other = check(&["--board", "pi-zero-2w"], "");
    assert!(other.contains("ok: pi-zero-2w, because the settings say so; this is pi4 (Raspberry Pi 4"), "{other}");

    let receiver = Receiver::new();
    let service = Service::start_with("[camera]\ndevice = \"demo\"\n", &[receiver.address()], |command| {
        command.env("FACEWIRE_SYSROOT", root.path()).stderr(std::process::Stdio::piped())
    });
    receiver.packet();
    let log = service.stop(Signal::TERM).0.succeeded().err;
    assert!(log.contains(&format!(" board {told}\n")), "{log}");
}
