//! The program on made-up boards, whose `/sys` and `/proc` lie in a folder of the test.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::env;
use std::ffi::OsString;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use common::film::demo_y4m;
use common::networks::installed;
use common::program::{Run, facewire, settings, text};
use common::service::{DEMO, Receiver, Service};
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

/// The device tree of a Raspberry Pi 4, and what `facewire` says of it.
const PI4: [(&str, &str); 2] = [
    ("proc/device-tree/compatible", "raspberrypi,4-model-b\0brcm,bcm2711\0"),
    ("proc/device-tree/model", "Raspberry Pi 4 Model B Rev 1.4\0"),
];
const PI4_TOLD: &str = "pi4, recognised by \"brcm,bcm2711\" in the device tree (Raspberry Pi 4 Model B Rev 1.4)";

fn board(files: &[(&str, &str)]) -> TempDir {
    let root = tempfile::tempdir().unwrap();
    for (path, text) in files {
        let path = root.path().join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    root
}

/// Runs `facewire check` with the built-in clip on this board, and returns what it prints.
fn check(root: &TempDir, arguments: &[&str]) -> String {
    let file = settings(DEMO);
    let mut command = facewire([&["check", "--config", text(file.path())], arguments].concat());
    Run::of(command.env("FACEWIRE_SYSROOT", root.path())).succeeded().out
}

#[test]
fn the_service_says_once_with_the_remedy_that_the_board_is_hot_undervolted_and_slow() {
    let (root, receiver) = (board(&[&IMPAIRED_PI4[..], &PI4].concat()), Receiver::new());
    let service =
        Service::start_with(DEMO, &[receiver.address()], |command| command.env("FACEWIRE_SYSROOT", root.path()));
    receiver.live();
    let log = service.stopped();
    for sentence in
        ["use a stronger power supply", "add a heat sink or a fan", "write \"performance\" or \"schedutil\""]
    {
        // A lower step may have been logged as well, with the same remedy.
        let told = log.lines().filter(|line| line.contains("tracking is impaired") && line.contains(sentence));
        assert_eq!(told.count(), 1, "{sentence}: {log}");
    }
    assert!(log.lines().last().unwrap().contains(" impaired_by=undervoltage,hot,slow-governor "), "{log}");
    assert!(log.contains(&format!(" board {PI4_TOLD}\n")), "{log}");
}

#[test]
fn check_shows_the_board_its_figures_and_the_remedy_for_what_slows_it_down_and_succeeds() {
    let root = board(&[&IMPAIRED_PI4[..], &PI4].concat());
    let out = check(&root, &[]);
    let of_board: Vec<_> = out.lines().filter(|line| line.starts_with("board ")).collect();
    let figures = "processor 82.3 °C (cpu-thermal), limit 80 °C; powersave at 600 of 1800 MHz; supply voltage too low";
    let wants = [
        &format!("board     ok: {PI4_TOLD}; {figures}"),
        "board     POOR: the supply voltage",
        "board     POOR: the board is so hot",
        "board     POOR: a processor saves",
    ];
    assert_eq!(of_board.len(), wants.len(), "{out}");
    assert!(of_board.iter().zip(wants).all(|(line, want)| line.starts_with(want)), "{out}");
    let other = check(&root, &["--board", "pi-zero-2w"]);
    assert!(other.contains("ok: pi-zero-2w, because the settings say so; this is pi4 (Raspberry Pi 4"), "{other}");
    for (path, good) in [(1, "48000"), (5, "0"), (7, "ondemand")] {
        fs::write(root.path().join(IMPAIRED_PI4[path].0), good).unwrap();
    }
    let out = check(&root, &[]);
    assert!(!out.contains("POOR"), "{out}");
}

/// Returns the search path of programs with a `vcgencmd` in front that prints this text.
fn with_vcgencmd(folder: &Path, prints: &str) -> OsString {
    let program = folder.join("vcgencmd");
    fs::write(&program, format!("#!/bin/sh\n[ \"$*\" = get_throttled ] && echo '{prints}'\n")).unwrap();
    fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();
    let others = env::var_os("PATH").unwrap();
    env::join_paths([folder.to_owned()].into_iter().chain(env::split_paths(&others))).unwrap()
}

#[test]
fn the_report_has_the_board_and_its_speed_and_nothing_that_identifies_its_owner() {
    let programs = tempfile::tempdir().unwrap();
    let secrets = ["10000000d5c3b2a1", "e4:5f:01:aa:bb:cc", "pi-of-erika", "Erika"];
    let processors = "processor\t: 0\nCPU part\t: 0xd08\n\n".repeat(4) + "Serial\t\t: 10000000d5c3b2a1\n";
    let of_owner = [
        ("proc/cpuinfo", processors.as_str()),
        ("proc/device-tree/serial-number", "10000000d5c3b2a1\0"),
        ("proc/meminfo", "MemTotal:        3884376 kB\n"),
        ("proc/sys/kernel/hostname", "pi-of-erika\n"),
        ("sys/class/net/eth0/address", "e4:5f:01:aa:bb:cc\n"),
        ("sys/class/dmi/id/product_serial", "10000000d5c3b2a1\n"),
    ];
    let root = board(&[&IMPAIRED_PI4[..], &PI4, &of_owner].concat());
    let recording = programs.path().join("Erika.y4m");
    fs::write(&recording, demo_y4m(10)).unwrap();
    let link =
        "[[link]]\naddress = \"pi-of-erika:5252\"\n[camera]\ndevice = \"Camera of Erika\"\n[realtime]\nhot_cpu = 0\n";
    let file = settings(link);
    let mut command = facewire(["bench", text(&recording), "--rounds", "1", "--report", "--config", text(file.path())]);
    command.env("FACEWIRE_SYSROOT", root.path()).env("PATH", with_vcgencmd(programs.path(), "throttled=0x50000"));
    let run = Run::of(command.env("USER", "Erika").env("HOME", "/home/Erika").env("FACEWIRE_NETWORKS", installed()));
    let report = run.succeeded().out;

    for want in [
        &format!("board      {PI4_TOLD}\n"),
        "processors 4 x Cortex-A72\n",
        "memory     3793 MB\n",
        "before     processor 82.3 °C (cpu-thermal), limit 80 °C; powersave at 600 of 1800 MHz; supply voltage too low\n",
        "after      processor 82.3 °C",
        "flags      firmware flags 0x50000: nothing now, low voltage, throttled since the start\n",
        "networks.threads 2, camera 640 x 480 at 30/s in format auto\n",
        "bound      hot on CPU 0",
        " frames a second at p95, with decoding\n",
        "% of one core at 30 frames a second",
        "peak memory",
        "G multiply-adds/s, on one thread\n",
    ] {
        assert!(report.contains(want), "{want}: {report}");
    }
    for stage in ["decode ", "mesh ", "solve ", "whole "] {
        assert!(report.lines().any(|line| line.starts_with(stage)), "{stage}: {report}");
    }
    let this_host = rustix::system::uname();
    for secret in secrets.into_iter().chain([this_host.nodename().to_str().unwrap(), "/home", text(programs.path())]) {
        // A host called "vm" would be found in other words.
        let is_telling = secret.len() > 4;
        assert!(!is_telling || !report.contains(secret), "{secret}: {report}");
    }
}
