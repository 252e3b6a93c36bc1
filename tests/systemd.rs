//! `facewire run` under a service manager, played here by a socket, and what `systemd/` installs.
//!
//! Times have wide margins: the machine may be busy.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{self, Receiver as Channel};
use std::thread;
use std::time::{Duration, Instant};

use common::program::{Run, facewire, text};
use common::service::Receiver;
use common::stuck::{Stuck, thread_called};
use facewire_packet::State;
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

const DEMO: &str = "[camera]\ndevice = \"demo\"\n";
const NO_CAMERA: &str = "[camera]\ndevice = \"/dev/video99\"\n";
/// Longer than anything here takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

/// A service with its manager's socket and its settings. It is killed when the test ends.
struct Unit {
    folder: TempDir,
    words: Channel<String>,
    receiver: Receiver,
    child: Child,
}

impl Unit {
    /// Starts it with these settings and a link to the receiver.
    fn start(toml: &str) -> Self {
        let (folder, receiver) = (tempfile::tempdir().unwrap(), Receiver::new());
        let words = listen(UnixDatagram::bind(folder.path().join("notify")).unwrap());
        write_settings(folder.path(), toml, &receiver);
        let child = facewire(["run", "--config", text(&folder.path().join("facewire.toml"))])
            .env("NOTIFY_SOCKET", folder.path().join("notify"))
            .env("WATCHDOG_USEC", "400000")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        Self { folder, words, receiver, child }
    }

    /// Gives it other settings and tells it to read them.
    fn reload(&self, toml: &str) {
        write_settings(self.folder.path(), toml, &self.receiver);
        self.signal(Signal::HUP);
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// The next word to the manager.
    fn word(&self) -> String {
        self.words.recv_timeout(PATIENCE).unwrap()
    }

    /// The words up to the first that begins so.
    fn words_until(&self, beginning: &str) -> Vec<String> {
        let begun = Instant::now();
        let mut words = vec![self.word()];
        while !words.last().unwrap().starts_with(beginning) {
            assert!(begun.elapsed() < PATIENCE, "no {beginning}: {words:?}");
            words.push(self.word());
        }
        words
    }

    /// Stops it; what it logged.
    fn stop(mut self) -> String {
        self.signal(Signal::TERM);
        let child = std::mem::replace(&mut self.child, Command::new("true").spawn().unwrap());
        Run::ended(&child.wait_with_output().unwrap()).succeeded().err
    }
}

impl Drop for Unit {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// Takes every word as it comes, as a manager does: a service whose words are not taken waits.
fn listen(socket: UnixDatagram) -> Channel<String> {
    let (words, taken) = mpsc::channel();
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(length) = socket.recv(&mut bytes) {
            let word = str::from_utf8(bytes.get(..length).unwrap()).unwrap().trim().to_owned();
            if words.send(word).is_err() {
                break;
            }
        }
    });
    taken
}

fn write_settings(folder: &Path, toml: &str, receiver: &Receiver) {
    let link = format!("[[link]]\naddress = \"{}\"\n", receiver.address());
    fs::write(folder.join("facewire.toml"), [toml, &link].concat()).unwrap();
}

fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn without_a_camera_the_service_is_ready_says_that_it_is_blind_and_serves_the_watchdog() {
    let unit = Unit::start(NO_CAMERA);
    assert_eq!(unit.words_until("READY=1"), ["READY=1"], "before anything else");
    let status = unit.words_until("STATUS=").pop().unwrap();
    assert!(status.starts_with("STATUS=blind, because no camera is called /dev/video99"), "{status}");
    for _ in 0..5 {
        unit.words_until("WATCHDOG=1");
    }
    unit.signal(Signal::TERM);
    unit.words_until("STOPPING=1");
}

#[test]
fn a_service_at_work_serves_the_watchdog_and_writes_its_status_when_asked() {
    let unit = Unit::start(DEMO);
    unit.receiver.until(|packet| packet.state == State::Live);
    for _ in 0..5 {
        unit.words_until("WATCHDOG=1");
    }
    unit.signal(Signal::USR1);
    unit.words_until("STATUS=fps=");
    let log = unit.stop();
    assert!(log.contains(" faces="), "{log}");
}

/// The longest that a hot loop may take for a frame is 10 s.
const LONGEST_FRAME: Duration = Duration::from_secs(10);

#[test]
fn a_stuck_inference_gets_no_more_watchdog_pings_and_the_face_goes_neutral() {
    let mut unit = Unit::start(DEMO);
    unit.receiver.until(|packet| packet.state == State::Live);
    let _stuck = Stuck::stop(thread_called(&mut unit.child, "fw-hot"));
    unit.receiver.until(|packet| packet.state == State::Neutral);
    let begun = Instant::now();
    while unit.words.recv_timeout(LONGEST_FRAME).is_ok() {
        assert!(begun.elapsed() < 4 * LONGEST_FRAME, "the watchdog is served although the inference is stuck");
    }
}

#[test]
fn bad_settings_are_refused_with_all_their_faults_and_the_face_stays_live() {
    let unit = Unit::start(DEMO);
    unit.receiver.until(|packet| packet.state == State::Live);
    unit.reload("[camera]\nfps = 0\n[send]\nrate = 1\n");
    let packets: Vec<_> = (0..60).map(|_| unit.receiver.packet()).collect();
    assert!(packets[30..].iter().any(|packet| packet.state == State::Live));
    let log = unit.stop();
    assert!(log.contains("camera.fps = 0: give a whole number from 1 to 240"), "{log}");
    assert!(log.contains("send.rate is not a setting"), "{log}");
    assert!(log.contains("settings refused: the current ones stay"), "{log}");
    assert_eq!(log.matches("camera opened").count(), 1, "{log}");
}

/// The hot loop waits for a frame, for longer than the new settings allow, and takes them only then.
#[test]
fn a_reload_while_the_camera_is_silent_keeps_the_watchdog_served_and_the_metrics_and_the_next_reload_at_once() {
    let silent = |rest: &str| format!("[camera]\ndevice = \"rehearsal: live 1, silent 60\"\n{rest}");
    let unit = Unit::start(&silent("stall_timeout_ms = 20000\n"));
    unit.receiver.until(|packet| packet.state == State::Live);
    unit.receiver.until(|packet| packet.state == State::Neutral);
    let socket = unit.folder.path().join("metrics");
    let metrics = format!("[metrics]\nlisten = \"unix:{}\"\n", text(&socket));
    unit.reload(&silent(&["stall_timeout_ms = 100\n", &metrics].concat()));
    let end = Instant::now() + Duration::from_secs(6);
    while Instant::now() < end {
        let word = unit.words.recv_timeout(Duration::from_secs(2));
        assert!(word.is_ok(), "no sign of life for 2 s");
    }
    assert!(UnixStream::connect(&socket).is_ok());
    unit.reload("[camera]\nfps = 0\n");
    thread::sleep(Duration::from_secs(1));
    let log = unit.stop();
    assert!(log.contains("settings changed: camera, metrics"), "{log}");
    assert!(log.contains("settings refused: the current ones stay"), "{log}");
}

#[test]
fn networks_that_are_not_there_are_refused_whole() {
    let unit = Unit::start(NO_CAMERA);
    unit.words_until("STATUS=blind");
    unit.reload(&[DEMO, "[networks]\nfolder = \"/nowhere\"\n"].concat());
    thread::sleep(Duration::from_secs(1));
    let log = unit.stop();
    assert!(log.contains("looked in /nowhere") && log.contains("the current ones stay"), "{log}");
    assert!(!log.contains("camera opened"), "the camera setting was good, but not all were: {log}");
}

#[test]
fn good_settings_are_taken_by_the_running_service() {
    let unit = Unit::start(NO_CAMERA);
    unit.words_until("STATUS=blind");
    unit.reload(&[DEMO, "[networks]\nthreads = 2\n[solver]\nsmoothing_ms = 0\n"].concat());
    unit.receiver.until(|packet| packet.state == State::Live);
    unit.reload(NO_CAMERA);
    unit.receiver.until(|packet| packet.state == State::Neutral);
    let log = unit.stop();
    assert!(log.contains("settings changed: camera, networks, solver"), "{log}");
}

#[test]
fn links_change_while_the_service_runs() {
    let unit = Unit::start(NO_CAMERA);
    let other = Receiver::new();
    unit.receiver.packet();
    unit.reload(&format!("{NO_CAMERA}[[link]]\naddress = \"{}\"\n", other.address()));
    let sequence = other.packet().sequence;
    assert!(sequence > 0, "numbering goes on");
    unit.receiver.until(|packet| packet.sequence > sequence);
}

#[test]
fn metrics_open_and_close_while_the_service_runs() {
    let unit = Unit::start(NO_CAMERA);
    unit.words_until("STATUS=blind");
    let path = unit.folder.path().join("metrics.sock");
    let wait_for = |is_there: bool| {
        let begun = Instant::now();
        while UnixStream::connect(&path).is_ok() != is_there {
            assert!(begun.elapsed() < PATIENCE, "{is_there}");
            thread::sleep(Duration::from_millis(20));
        }
    };
    unit.reload(&format!("{NO_CAMERA}[metrics]\nlisten = \"unix:{}\"\n", text(&path)));
    wait_for(true);
    unit.reload(NO_CAMERA);
    wait_for(false);
    assert!(!path.exists());
    let log = unit.stop();
    assert_eq!(log.matches("settings changed: metrics").count(), 2, "{log}");
}

#[test]
fn the_log_level_changes_at_once_and_real_time_only_by_a_restart() {
    let unit = Unit::start(NO_CAMERA);
    unit.words_until("STATUS=blind");
    unit.reload(&[NO_CAMERA, "[log]\nlevel = \"warn\"\n[realtime]\npriority = 1\n"].concat());
    thread::sleep(Duration::from_secs(1));
    let log = unit.stop();
    assert!(log.contains("[realtime] takes effect at the next start"), "{log}");
    assert!(!log.contains("stopped: frames="), "of level info: {log}");
}

#[test]
fn the_installed_configuration_is_the_default_one() {
    let defaults = Run::of(&mut facewire(["defaults"])).succeeded().out;
    let installed = fs::read_to_string(project("systemd/facewire.toml")).unwrap();
    assert!(installed == defaults, "renew it: facewire defaults > systemd/facewire.toml");
}

#[test]
fn the_unit_is_correct_and_exposes_no_more_than_it_did() {
    let checked = Run::of(&mut Command::new(project("systemd/check"))).succeeded();
    if checked.out.contains("skipped") {
        common::skip(&checked.out);
    }
}

/// A rule that matches any webcam or any adapter would move its name to whichever device was plugged in last.
#[test]
fn udev_rules_give_no_device_a_name_and_keep_modemmanager_away_from_boards() {
    let file = fs::read_to_string(project("systemd/99-facewire.rules")).unwrap();
    let rules: Vec<&str> = file.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).collect();
    assert!(rules.iter().all(|rule| !rule.contains("SYMLINK") && !rule.contains("NAME")), "{rules:?}");
    for vendor in ["2341", "2a03", "239a", "2e8a", "303a", "1b4f", "2886", "1ffb", "16c0"] {
        let of_vendor = |rule: &&&str| rule.contains("ATTRS{idVendor}==") && rule.contains(vendor);
        let rule = rules.iter().find(of_vendor).unwrap_or_else(|| panic!("no rule for {vendor}"));
        assert!(rule.starts_with("SUBSYSTEM==\"tty\"") && rule.ends_with("ENV{ID_MM_DEVICE_IGNORE}=\"1\""), "{rule}");
    }
    for adapter in ["0403", "1a86", "10c4", "067b"] {
        assert!(rules.iter().all(|rule| !rule.contains(adapter)), "a modem may be behind an adapter of {adapter}");
    }
}

/// All text below a folder of the project.
fn sources(folder: &Path) -> String {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let text = |path: PathBuf| match path.extension().and_then(|ending| ending.to_str()) {
        None if path.is_dir() => sources(&path),
        Some("rs") => fs::read_to_string(path).unwrap(),
        _ => String::new(),
    };
    entries.map(text).collect()
}

#[test]
fn every_fault_of_the_table_names_tests_and_they_exist() {
    let table = fs::read_to_string(project("docs/service.md")).unwrap();
    let tests = [project("src"), project("tests")].map(|folder| sources(&folder)).concat();
    let rows: Vec<&str> = table.lines().filter(|line| line.matches('|').count() == 5).skip(2).collect();
    assert!(rows.len() >= 20, "{rows:?}");
    for row in rows {
        let names: Vec<&str> = row.rsplit('|').nth(1).unwrap().split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "{row}");
        for name in names {
            let is_case = project("tests/guest/cases").join(name).exists();
            assert!(is_case || tests.contains(&format!("fn {name}()")), "{name}");
        }
    }
}

#[test]
fn installing_puts_everything_in_place_and_keeps_a_configuration_that_is_there() {
    let dest = tempfile::tempdir().unwrap();
    let networks = tempfile::tempdir().unwrap();
    fs::write(networks.path().join("mesh.onnx"), "").unwrap();
    fs::write(networks.path().join("libonnxruntime.so"), "").unwrap();
    let at = |path: &str| dest.path().join(path);
    let install = |options: &[&str]| {
        let mut command = Command::new(project("systemd/install"));
        command.args(["--dest", text(dest.path()), "--networks", text(networks.path())]);
        Run::of(command.args(["--binary", env!("CARGO_BIN_EXE_facewire")]).args(options)).succeeded()
    };

    install(&[]);
    assert_eq!(fs::metadata(at("usr/bin/facewire")).unwrap().permissions().mode() & 0o777, 0o755);
    for file in [
        "usr/lib/facewire/networks/mesh.onnx",
        "usr/lib/facewire/networks/libonnxruntime.so",
        "usr/lib/systemd/system/facewire.service",
        "usr/lib/udev/rules.d/99-facewire.rules",
        "usr/share/doc/facewire/service.md",
    ] {
        assert_eq!(fs::metadata(at(file)).unwrap().permissions().mode() & 0o777, 0o644, "{file}");
    }
    let configuration = at("etc/facewire/facewire.toml");
    assert_eq!(fs::read(&configuration).unwrap(), fs::read(project("systemd/facewire.toml")).unwrap());

    fs::write(&configuration, "# mine\n").unwrap();
    install(&[]);
    install(&["--uninstall"]);
    assert_eq!(fs::read_to_string(&configuration).unwrap(), "# mine\n");
    assert!(!at("usr/bin/facewire").exists() && !at("usr/lib/facewire").exists());
}
