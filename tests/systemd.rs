//! `facewire run` under a service manager, which a socket simulates here, and the units of all programs.
//!
//! The tests wait for states, not for times: the machine may be busy.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::{self, Receiver as Channel};
use std::thread;
use std::time::{Duration, Instant};

use common::program::{Run, text};
use common::service::{DEMO, NO_CAMERA, Receiver, Service};
use common::stuck::Stuck;
use common::{PATIENCE, eventually, project};
use facewire_packet::State;
use rustix::process::Signal;
use tempfile::TempDir;

/// The period of the watchdog, in microseconds. The service pings twice in each period.
const WATCHDOG_US: &str = "400000";
/// Long enough for a ping to be due.
const PING_PERIODS: Duration = Duration::from_millis(500);

/// A service with its manager's socket and a receiver of its packets.
struct Unit {
    folder: TempDir,
    messages: Channel<String>,
    receiver: Receiver,
    service: Service,
}

impl Unit {
    fn start(toml: &str) -> Self {
        let (folder, receiver) = (tempfile::tempdir().unwrap(), Receiver::new());
        let notify = folder.path().join("notify");
        let messages = listen(UnixDatagram::bind(&notify).unwrap());
        let service = Service::start_with(toml, &[receiver.address()], |command| {
            command.env("NOTIFY_SOCKET", notify).env("WATCHDOG_USEC", WATCHDOG_US)
        });
        Self { folder, messages, receiver, service }
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
            self.service.signal(Signal::USR1);
            self.messages_until("STATUS=")
        };
        // An earlier status may have been on its way.
        ask();
        ask();
        thread::sleep(PING_PERIODS);
        ask().iter().any(|message| message == "WATCHDOG=1")
    }
}

/// Takes every message at once, as a manager does: a service waits until its message is taken.
fn listen(socket: UnixDatagram) -> Channel<String> {
    let (messages, taken) = mpsc::channel();
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(length) = socket.recv(&mut bytes) {
            let message = str::from_utf8(&bytes[..length]).unwrap().trim().to_owned();
            if messages.send(message).is_err() {
                break;
            }
        }
    });
    taken
}

/// Waits until a socket answers, or until it does not any more.
fn await_socket(path: &Path, answers: bool) {
    eventually("the change of the socket", || UnixStream::connect(path).is_ok() == answers);
}

#[test]
fn without_a_camera_the_service_is_ready_says_that_it_is_blind_and_serves_the_watchdog() {
    let unit = Unit::start(NO_CAMERA);
    assert_eq!(unit.messages_until("READY=1"), ["READY=1"], "before anything else");
    let status = unit.messages_until("STATUS=").pop().unwrap();
    assert!(status.starts_with("STATUS=blind, because no camera is called /dev/video99"), "{status}");
    (0..5).for_each(|_| drop(unit.messages_until("WATCHDOG=1")));
    unit.service.signal(Signal::TERM);
    unit.messages_until("STOPPING=1");
}

/// The hot loop may take 10 s for a frame, and 3 s to wait for the next. A busy machine takes longer to notice.
#[test]
fn a_stuck_inference_gets_no_more_watchdog_pings_and_the_face_goes_neutral() {
    let mut unit = Unit::start(DEMO);
    unit.receiver.live();
    assert!(unit.serves_watchdog());
    let stuck = Stuck::computing(unit.service.thread("fw-hot"));
    unit.receiver.until_state(State::Neutral);
    let begun = Instant::now();
    while unit.serves_watchdog() {
        assert!(begun.elapsed() < Duration::from_mins(1), "the watchdog is served although the inference is stuck");
    }
    drop(stuck);
    unit.messages_until("WATCHDOG=1");
    unit.service.signal(Signal::USR1);
    unit.messages_until("STATUS=fps=");
    assert!(unit.service.stopped().contains(" faces="));
}

#[test]
fn bad_settings_are_refused_with_all_their_faults_and_the_face_stays_live() {
    let (service, receiver) = Service::live(DEMO);
    service.reload("[camera]\nfps = 0\n[send]\nrate = 1\n");
    service.await_log("settings refused: the current ones stay");
    receiver.rest();
    receiver.live();
    let log = service.stopped();
    assert!(log.contains("camera.fps = 0: give a whole number from 1 to 240"), "{log}");
    assert!(log.contains("send.rate is not a setting"), "{log}");
    assert_eq!(log.matches("camera opened").count(), 1, "{log}");
}

/// The hot loop waits 20 s for a frame and takes the new settings only then, though they allow 0.1 s from then on.
#[test]
fn a_reload_while_the_camera_is_silent_keeps_the_watchdog_served_and_the_metrics_and_the_next_reload_at_once() {
    let silent = |rest: &str| format!("[camera]\ndevice = \"rehearsal: silent 3600\"\n{rest}");
    let unit = Unit::start(DEMO);
    unit.receiver.live();
    unit.service.change(&silent("stall_timeout_ms = 20000\n"));
    unit.receiver.until_state(State::Neutral);
    let socket = unit.folder.path().join("metrics");
    let metrics = format!("[metrics]\nlisten = \"unix:{}\"\n", text(&socket));
    unit.service.reload(&silent(&["stall_timeout_ms = 100\n", &metrics].concat()));
    unit.service.await_log("settings changed: camera, metrics");
    await_socket(&socket, true);
    unit.service.reload("[camera]\nfps = 0\n");
    unit.service.await_log("settings refused: the current ones stay");
    // More than twice 0.1 s, and the second that the service adds.
    for _ in 0..4 {
        assert!(unit.serves_watchdog());
    }
    let log = unit.service.stopped();
    let is_lost = ["no camera: ", "camera lost: "].iter().any(|word| log.contains(word));
    assert!(!is_lost, "the hot loop waited all the while: {log}");
}

#[test]
fn networks_that_are_not_there_are_refused_whole() {
    let (service, _receiver) = Service::with_receiver(NO_CAMERA);
    service.await_log("no camera");
    service.reload(&[DEMO, "[networks]\nfolder = \"/nowhere\"\n"].concat());
    service.await_log("settings refused: the current ones stay");
    let log = service.stopped();
    assert!(log.contains("looked in /nowhere"), "{log}");
    assert!(!log.contains("camera opened"), "the camera setting was good, but not all were: {log}");
}

#[test]
fn good_settings_are_taken_by_the_running_service_and_real_time_only_by_a_restart() {
    let (service, receiver) = Service::with_receiver(NO_CAMERA);
    service.await_log("no camera");
    service.change(&[DEMO, "[networks]\nthreads = 2\n[smoothing]\nmouth_ms = 0\n"].concat());
    assert_eq!(service.logged("settings changed: camera, networks, smoothing"), 1, "{}", service.log());
    receiver.live();
    let folder = tempfile::tempdir().unwrap();
    let metrics = folder.path().join("metrics.sock");
    service.change(&format!("{NO_CAMERA}[metrics]\nlisten = \"unix:{}\"\n", text(&metrics)));
    await_socket(&metrics, true);
    receiver.until_state(State::Neutral);
    service.change(NO_CAMERA);
    await_socket(&metrics, false);
    assert!(!metrics.exists());
    service.reload(&[NO_CAMERA, "[log]\nlevel = \"warn\"\n[realtime]\npriority = 1\n"].concat());
    service.await_log("[realtime] takes effect at the next start");
    let log = service.stopped();
    assert!(!log.contains("stopped: frames="), "the last line has level info: {log}");
}

/// Copies the units and their drop-ins.
fn copy_units(to: &Path) {
    for folder in ["", "facewire.service.d"] {
        fs::create_dir_all(to.join(folder)).unwrap();
        let entries = fs::read_dir(project("systemd").join(folder)).unwrap().map(|entry| entry.unwrap().path());
        for file in entries.filter(|path| path.is_file()) {
            fs::copy(&file, to.join(folder).join(file.file_name().unwrap())).unwrap();
        }
    }
}

#[test]
fn each_unit_keeps_the_directives_that_protect_the_machine_and_the_robot_and_gets_none_that_undoes_one() {
    let folder = tempfile::tempdir().unwrap();
    let check = || Run::of(Command::new(project("systemd/check")).arg("--names").arg(folder.path()));
    copy_units(folder.path());
    check().succeeded();
    for (unit, line, replacement, complaint) in [
        ("facewire.service", "NoNewPrivileges=yes\n", "", "lacks NoNewPrivileges=yes"),
        ("facewire.service", "IPAddressDeny=any\n", "", "lacks IPAddressDeny=any"),
        ("facewire.service", "MemoryDenyWriteExecute=yes\n", "#\n", "lacks MemoryDenyWriteExecute=yes"),
        ("facewire.service", "ProtectHome=yes\n", "ProtectHome=read-only\n", "lacks ProtectHome=yes"),
        ("facewire.service", "WatchdogSec=5s\n", "", "lacks WatchdogSec=5s"),
        ("facewire-console.service", "UMask=0077\n", "UMask=0077\nBindPaths=/home\n", "must not have BindPaths=/home"),
        ("facewire-camera.service", "DeviceAllow=char-media rw\n", "", "lacks DeviceAllow=char-media rw"),
        ("facewire-bridge.service", "[Install]\n", "PrivateUsers=no\n[Install]\n", "must not have PrivateUsers=no"),
        ("facewire-helper@.service", "CapabilityBoundingSet=\n", "", "lacks CapabilityBoundingSet="),
        ("facewire-helper.socket", "SocketMode=0660\n", "SocketMode=0666\n", "must not have SocketMode=0666"),
        (
            "facewire.service.d/serial-only.conf",
            "RestrictAddressFamilies=\nRestrictAddressFamilies=AF_UNIX\n",
            "RestrictAddressFamilies=AF_UNIX\nRestrictAddressFamilies=\n",
            "lacks RestrictAddressFamilies=",
        ),
    ] {
        let path = folder.path().join(unit);
        let whole = fs::read_to_string(&path).unwrap();
        assert_eq!(whole.matches(line).count(), 1, "{unit}: {line}");
        fs::write(&path, whole.replace(line, replacement)).unwrap();
        let run = check();
        assert!(
            run.status == Some(1) && run.err.contains(&format!("{unit} {complaint}")),
            "{unit} {line}: {}",
            run.err
        );
        fs::write(&path, whole).unwrap();
    }
}

/// Directives of the service that the helper leaves out of what it runs.
const LEFT_OUT: [(&str, &str); 7] = [
    ("Type", "a command that ends by itself tells the manager nothing"),
    ("ExecStart", "the helper runs a command of its own"),
    ("ExecStopPost", "servos that the service moves would be released"),
    ("ExecReload", "a command is not reloaded"),
    ("Restart", "a command runs once"),
    ("Watchdog", "a command does not serve the watchdog"),
    ("RuntimeDirectory", "the sockets of the service would be removed with it"),
];

/// The directives of the sections `[Service]`, in their order. Addresses stand alone, as systemd-run takes them.
fn directives(unit: &str) -> Vec<String> {
    let (mut is_service, mut directives) = (false, Vec::new());
    for line in unit.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        if line.starts_with('[') {
            is_service = line == "[Service]";
        } else if is_service {
            match line.split_once('=').unwrap() {
                (name @ ("IPAddressAllow" | "IPAddressDeny"), value) if !value.is_empty() => {
                    directives.extend(value.split_whitespace().map(|word| format!("{name}={word}")));
                }
                _ => directives.push(line.to_owned()),
            }
        }
    }
    directives
}

#[test]
fn what_the_helper_runs_is_confined_by_the_unit_of_the_service_and_its_drop_ins_or_not_run() {
    let folder = tempfile::tempdir().unwrap();
    let program = |name: &str, code: &str| {
        let path = folder.path().join(name);
        fs::write(&path, format!("#!/bin/sh\n{code}\n")).unwrap();
        fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
    };
    let unit = folder.path().join("unit");
    program("systemctl", &format!("[ \"$*\" = 'cat facewire.service' ] && cat '{}'", text(&unit)));
    program("systemd-run", "printf '%s\\n' \"$@\"");
    let ask = || {
        let path = format!("{}:/usr/bin:/bin", folder.path().display());
        Run::fed(Command::new(project("systemd/facewire-helper")).env("PATH", path), b"devices\n")
    };
    assert_eq!(ask().out, "", "without the unit nothing is run");

    let mut whole = fs::read_to_string(project("systemd/facewire.service")).unwrap();
    for drop_in in fs::read_dir(project("systemd/facewire.service.d")).unwrap() {
        whole.push_str(&fs::read_to_string(drop_in.unwrap().path()).unwrap());
    }
    let is_left_out = |line: &String| LEFT_OUT.iter().any(|(name, _)| line.starts_with(name));
    let (left_out, mut wanted): (Vec<String>, Vec<String>) = directives(&whole).into_iter().partition(is_left_out);
    for (name, _) in LEFT_OUT {
        assert!(left_out.iter().any(|line| line.starts_with(name)), "the unit has no {name}");
    }
    // As an operator may write it.
    whole.push_str("[Service]\n  Environment = A=1 \\\n B=2  \n; Nice=1\n[Unit]\nBefore=a.service\n");
    wanted.push("Environment=A=1   B=2".to_owned());
    fs::write(unit, whole).unwrap();
    let run = ask().out;
    let passed: Vec<&str> = run.lines().filter_map(|line| line.strip_prefix("--property=")).collect();
    assert_eq!(passed[..2], ["RuntimeMaxSec=55", "User=facewire"]);
    assert_eq!(passed[2..], wanted);
    assert!(run.ends_with("\n/usr/bin/facewire\ndevices\n--json\n"), "{run}");
}
