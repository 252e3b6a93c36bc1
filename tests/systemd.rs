//! `facewire run` under a service manager, which a socket plays here, and the files that `systemd/` installs.
//!
//! The tests wait for states, not for times: the machine may be busy.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::mpsc::{self, Receiver as Channel};
use std::sync::{Arc, Mutex};
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

/// The period of the watchdog, in microseconds. The service pings twice in each period.
const WATCHDOG_US: &str = "400000";
/// Long enough for a ping to be due.
const PING_PERIODS: Duration = Duration::from_millis(500);

/// A service with its manager's socket, its settings, its log so far, and a receiver of its packets. The service is
/// killed when the test ends.
struct Unit {
    folder: TempDir,
    messages: Channel<String>,
    log: Arc<Mutex<String>>,
    receiver: Receiver,
    child: Child,
}

impl Unit {
    /// Starts a service with these settings and a link to the receiver.
    fn start(toml: &str) -> Self {
        let (folder, receiver) = (tempfile::tempdir().unwrap(), Receiver::new());
        let messages = listen(UnixDatagram::bind(folder.path().join("notify")).unwrap());
        write_settings(folder.path(), toml, &receiver);
        let mut child = facewire(["run", "--config", text(&folder.path().join("facewire.toml"))])
            .env("NOTIFY_SOCKET", folder.path().join("notify"))
            .env("WATCHDOG_USEC", WATCHDOG_US)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let log = collect_lines(child.stderr.take().unwrap());
        Self { folder, messages, log, receiver, child }
    }

    /// Writes other settings and tells the service to read them.
    fn reload(&self, toml: &str) {
        write_settings(self.folder.path(), toml, &self.receiver);
        self.signal(Signal::HUP);
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Messages to the manager, up to and including the first that begins like this.
    fn messages_until(&self, beginning: &str) -> Vec<String> {
        let begun = Instant::now();
        let mut messages: Vec<String> = Vec::new();
        while !messages.last().is_some_and(|message| message.starts_with(beginning)) {
            assert!(begun.elapsed() < PATIENCE, "no {beginning}: {messages:?}");
            messages.push(self.messages.recv_timeout(PATIENCE).unwrap());
        }
        messages
    }

    /// Whether the service serves the watchdog. The service looks after the watchdog before it answers a request for its
    /// status, so a ping that is due comes between the answers to two requests, however slow the machine is.
    fn serves_watchdog(&self) -> bool {
        let ask = || {
            self.signal(Signal::USR1);
            self.messages_until("STATUS=")
        };
        // An earlier status may have been on its way.
        ask();
        ask();
        thread::sleep(PING_PERIODS);
        ask().iter().any(|message| message == "WATCHDOG=1")
    }

    /// Waits until the log contains this text.
    fn await_log(&self, text: &str) {
        let begun = Instant::now();
        while !self.log.lock().unwrap().contains(text) {
            assert!(begun.elapsed() < PATIENCE, "no {text}: {}", self.log.lock().unwrap());
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// Stops the service and returns its log.
    fn stop(mut self) -> String {
        self.signal(Signal::TERM);
        let ended = self.child.wait().unwrap();
        // The thread that reads the log lets go of it at the log's end.
        while Arc::strong_count(&self.log) > 1 {
            thread::sleep(Duration::from_millis(1));
        }
        let log = self.log.lock().unwrap().clone();
        assert!(ended.success() && !log.contains("panicked"), "{ended}: {log}");
        log
    }
}

impl Drop for Unit {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// Takes every message at once, as a manager does: a service waits until its message is taken.
fn listen(socket: UnixDatagram) -> Channel<String> {
    let (messages, taken) = mpsc::channel();
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(length) = socket.recv(&mut bytes) {
            let message = str::from_utf8(bytes.get(..length).unwrap()).unwrap().trim().to_owned();
            if messages.send(message).is_err() {
                break;
            }
        }
    });
    taken
}

/// Collects lines as they come, on a thread that ends with the last line.
fn collect_lines(log: ChildStderr) -> Arc<Mutex<String>> {
    let lines = Arc::new(Mutex::new(String::new()));
    let collected = Arc::clone(&lines);
    thread::spawn(move || {
        for line in BufReader::new(log).lines() {
            *collected.lock().unwrap() += &(line.unwrap() + "\n");
        }
    });
    lines
}

fn write_settings(folder: &Path, toml: &str, receiver: &Receiver) {
    let link = format!("[[link]]\naddress = \"{}\"\n", receiver.address());
    fs::write(folder.join("facewire.toml"), [toml, &link].concat()).unwrap();
}

/// Waits until a socket answers, or until it does not any more.
fn await_socket(path: &Path, answers: bool) {
    let begun = Instant::now();
    while UnixStream::connect(path).is_ok() != answers {
        assert!(begun.elapsed() < PATIENCE, "{} answers: {}", path.display(), !answers);
        thread::sleep(Duration::from_millis(20));
    }
}

fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn without_a_camera_the_service_is_ready_says_that_it_is_blind_and_serves_the_watchdog() {
    let unit = Unit::start(NO_CAMERA);
    assert_eq!(unit.messages_until("READY=1"), ["READY=1"], "before anything else");
    let status = unit.messages_until("STATUS=").pop().unwrap();
    assert!(status.starts_with("STATUS=blind, because no camera is called /dev/video99"), "{status}");
    for _ in 0..5 {
        unit.messages_until("WATCHDOG=1");
    }
    unit.signal(Signal::TERM);
    unit.messages_until("STOPPING=1");
}

#[test]
fn a_service_at_work_serves_the_watchdog_and_writes_its_status_when_asked() {
    let unit = Unit::start(DEMO);
    unit.receiver.until(|packet| packet.state == State::Live);
    for _ in 0..5 {
        unit.messages_until("WATCHDOG=1");
    }
    unit.signal(Signal::USR1);
    unit.messages_until("STATUS=fps=");
    let log = unit.stop();
    assert!(log.contains(" faces="), "{log}");
}

/// The hot loop may take 10 s for a frame, and 3 s to wait for the next.
#[test]
fn a_stuck_inference_gets_no_more_watchdog_pings_and_the_face_goes_neutral() {
    let mut unit = Unit::start(DEMO);
    unit.receiver.until(|packet| packet.state == State::Live);
    assert!(unit.serves_watchdog());
    let stuck = Stuck::computing(thread_called(&mut unit.child, "fw-hot"));
    unit.receiver.until(|packet| packet.state == State::Neutral);
    let begun = Instant::now();
    while unit.serves_watchdog() {
        assert!(begun.elapsed() < PATIENCE, "the watchdog is served although the inference is stuck");
    }
    drop(stuck);
    unit.messages_until("WATCHDOG=1");
}

#[test]
fn bad_settings_are_refused_with_all_their_faults_and_the_face_stays_live() {
    let unit = Unit::start(DEMO);
    unit.receiver.until(|packet| packet.state == State::Live);
    unit.reload("[camera]\nfps = 0\n[send]\nrate = 1\n");
    unit.await_log("settings refused");
    unit.receiver.rest();
    unit.receiver.until(|packet| packet.state == State::Live);
    let log = unit.stop();
    assert!(log.contains("camera.fps = 0: give a whole number from 1 to 240"), "{log}");
    assert!(log.contains("send.rate is not a setting"), "{log}");
    assert!(log.contains("settings refused: the current ones stay"), "{log}");
    assert_eq!(log.matches("camera opened").count(), 1, "{log}");
}

/// The hot loop waits 20 s for a frame and takes the new settings only then, though they allow 0.1 s from then on.
#[test]
fn a_reload_while_the_camera_is_silent_keeps_the_watchdog_served_and_the_metrics_and_the_next_reload_at_once() {
    let silent = |rest: &str| format!("[camera]\ndevice = \"rehearsal: live 1, silent 60\"\n{rest}");
    let unit = Unit::start(&silent("stall_timeout_ms = 20000\n"));
    unit.receiver.until(|packet| packet.state == State::Live);
    unit.receiver.until(|packet| packet.state == State::Neutral);
    let socket = unit.folder.path().join("metrics");
    let metrics = format!("[metrics]\nlisten = \"unix:{}\"\n", text(&socket));
    unit.reload(&silent(&["stall_timeout_ms = 100\n", &metrics].concat()));
    unit.await_log("settings changed: camera, metrics");
    await_socket(&socket, true);
    unit.reload("[camera]\nfps = 0\n");
    unit.await_log("settings refused: the current ones stay");
    // More than twice 0.1 s, and the second that the service adds.
    for _ in 0..4 {
        assert!(unit.serves_watchdog());
    }
    let log = unit.stop();
    assert!(!log.contains("camera lost"), "the hot loop waited all the while: {log}");
}

#[test]
fn networks_that_are_not_there_are_refused_whole() {
    let unit = Unit::start(NO_CAMERA);
    unit.messages_until("STATUS=blind");
    unit.reload(&[DEMO, "[networks]\nfolder = \"/nowhere\"\n"].concat());
    unit.await_log("settings refused: the current ones stay");
    let log = unit.stop();
    assert!(log.contains("looked in /nowhere"), "{log}");
    assert!(!log.contains("camera opened"), "the camera setting was good, but not all were: {log}");
}

#[test]
fn good_settings_are_taken_by_the_running_service() {
    let unit = Unit::start(NO_CAMERA);
    unit.messages_until("STATUS=blind");
    unit.reload(&[DEMO, "[networks]\nthreads = 2\n[smoothing]\nmouth_ms = 0\n"].concat());
    unit.receiver.until(|packet| packet.state == State::Live);
    unit.reload(NO_CAMERA);
    unit.receiver.until(|packet| packet.state == State::Neutral);
    let log = unit.stop();
    assert!(log.contains("settings changed: camera, networks, smoothing"), "{log}");
}

#[test]
fn links_change_while_the_service_runs() {
    let unit = Unit::start(NO_CAMERA);
    let other = Receiver::new();
    let mut packets = vec![unit.receiver.packet()];
    unit.reload(&format!("{NO_CAMERA}[[link]]\naddress = \"{}\"\n", other.address()));
    assert_eq!(other.packet().sequence, 0, "each link numbers its own packets");
    packets.extend(unit.receiver.rest());
    packets.push(unit.receiver.packet());
    let sequences: Vec<u16> = packets.iter().map(|packet| packet.sequence).collect();
    assert!(
        sequences.iter().zip(0..).all(|(sequence, number)| *sequence == number),
        "the other link goes on: {sequences:?}"
    );
}

#[test]
fn metrics_open_and_close_while_the_service_runs() {
    let unit = Unit::start(NO_CAMERA);
    unit.messages_until("STATUS=blind");
    let path = unit.folder.path().join("metrics.sock");
    unit.reload(&format!("{NO_CAMERA}[metrics]\nlisten = \"unix:{}\"\n", text(&path)));
    await_socket(&path, true);
    unit.reload(NO_CAMERA);
    await_socket(&path, false);
    assert!(!path.exists());
    let log = unit.stop();
    assert_eq!(log.matches("settings changed: metrics").count(), 2, "{log}");
}

#[test]
fn the_log_level_changes_at_once_and_real_time_only_by_a_restart() {
    let unit = Unit::start(NO_CAMERA);
    unit.messages_until("STATUS=blind");
    unit.reload(&[NO_CAMERA, "[log]\nlevel = \"warn\"\n[realtime]\npriority = 1\n"].concat());
    unit.await_log("[realtime] takes effect at the next start");
    let log = unit.stop();
    assert!(!log.contains("stopped: frames="), "the last line has level info: {log}");
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
    fs::write(networks.path().join("mesh.fwnet"), "").unwrap();
    let at = |path: &str| dest.path().join(path);
    let install = |options: &[&str]| {
        let mut command = Command::new(project("systemd/install"));
        command.args(["--dest", text(dest.path()), "--networks", text(networks.path())]);
        Run::of(command.args(["--binary", env!("CARGO_BIN_EXE_facewire")]).args(options)).succeeded()
    };

    install(&[]);
    assert_eq!(fs::metadata(at("usr/bin/facewire")).unwrap().permissions().mode() & 0o777, 0o755);
    for file in [
        "usr/lib/facewire/networks/mesh.fwnet",
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
