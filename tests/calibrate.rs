//! Calibration and wearers, as a user meets them: the command, the service and its control socket.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use common::program::{Run, facewire, settings, text};
use common::service::{Receiver, Service};
use facewire_packet::State;
use rustix::process::Signal;
use tempfile::TempDir;

/// A profile of a face of few points, made by hand.
const PROFILE: &str = include_str!("../fuzz/corpus/profile_file/whole.toml");

/// Folders of profiles and of sockets.
struct Folders(TempDir);

impl Folders {
    /// Folders with the profiles of anna and, damaged, of bert.
    fn new() -> Self {
        let folders = Self(tempfile::tempdir().unwrap());
        fs::create_dir(folders.profiles()).unwrap();
        fs::write(folders.profiles().join("anna.toml"), PROFILE).unwrap();
        fs::write(folders.profiles().join("bert.toml"), &PROFILE[..PROFILE.len() / 2]).unwrap();
        folders
    }

    fn profiles(&self) -> std::path::PathBuf {
        self.0.path().join("profiles")
    }

    fn run(&self) -> &Path {
        self.0.path()
    }

    /// Settings with this camera and wearer.
    fn settings(&self, camera: &str, wearer: &str) -> String {
        let folder = self.profiles();
        format!("[camera]\ndevice = '{camera}'\n[wearer]\nname = '{wearer}'\nfolder = '{}'\n", text(&folder))
    }

    /// A service that shows the built-in clip, once it is live.
    fn service(&self, camera: &str) -> (Service, Receiver) {
        let receiver = Receiver::new();
        let settings = self.settings(camera, "");
        let service = Service::start_with(&settings, &[receiver.address()], |command| {
            command.env("XDG_RUNTIME_DIR", self.run()).stderr(Stdio::piped())
        });
        receiver.until(|packet| packet.state == State::Live);
        (service, receiver)
    }

    /// `facewire calibrate` with these arguments, beside the service of these folders.
    fn calibrate(&self, arguments: &[&str]) -> Command {
        let mut command = facewire(["calibrate"].into_iter().chain(arguments.iter().copied()));
        command.env("XDG_RUNTIME_DIR", self.run());
        command
    }
}

#[test]
fn wearers_are_listed_and_deleted_without_a_service() {
    let folders = Folders::new();
    let file = settings(&folders.settings("demo", "anna"));
    let run = |arguments: &[&str]| Run::of(folders.calibrate(arguments).args(["--config", text(file.path())]));
    let list = run(&["--list"]).succeeded().out;
    assert!(list.contains("* anna") && list.contains(" 2 of 11 takes"), "{list}");
    assert!(list.contains("  bert") && list.contains("cannot be used"), "{list}");
    run(&["--delete", "bert"]).succeeded();
    assert!(!folders.profiles().join("bert.toml").exists());
    assert!(run(&["--delete", "bert"]).sentence(66).contains("there is no profile"));
    assert!(run(&["--use", "anna"]).sentence(1).contains("no service runs"));
    assert_eq!(run(&["--wearer", "../../etc/passwd"]).status, Some(2));
}

#[test]
fn check_says_which_profile_is_in_use_and_whether_it_loads() {
    let folders = Folders::new();
    let check = |wearer| {
        let file = settings(&folders.settings("demo", wearer));
        let run = Run::of(&mut facewire(["check", "--config", text(file.path())]));
        run.out.lines().find(|line| line.starts_with("wearer")).unwrap_or_else(|| panic!("{run:?}")).to_owned()
    };
    assert!(check("anna").contains("ok: anna, 2 of 11 takes"));
    assert!(check("bert").contains("FAILED") && check("bert").contains("facewire calibrate --wearer bert"));
    assert!(check("").contains("ok: nobody's profile"));
}

#[test]
fn track_applies_the_profile_of_a_wearer_and_refuses_one_that_is_not_there() {
    let folders = Folders::new();
    let file = settings(&folders.settings("demo", ""));
    let track = |arguments: &[&str]| {
        let arguments = ["track", "demo", "--config", text(file.path())].into_iter().chain(arguments.iter().copied());
        Run::of(&mut facewire(arguments))
    };
    let [plain, worn] = [track(&[]), track(&["--wearer", "anna"])].map(|run| run.succeeded().out);
    assert_eq!(plain.lines().count(), worn.lines().count());
    assert_ne!(plain, worn);
    assert!(track(&["--wearer", "carl"]).sentence(66).contains("facewire calibrate --wearer carl"));
    assert!(track(&["--wearer", "bert"]).sentence(65).contains("bert.toml"));
}

#[test]
fn wearer_in_use_is_changed_while_the_service_runs() {
    let folders = Folders::new();
    let (service, receiver) = folders.service("demo");
    let told = Run::of(&mut folders.calibrate(&["--use", "anna"])).succeeded().out;
    assert!(told.contains("the profile of anna is in use"), "{told}");
    assert!(Run::of(&mut folders.calibrate(&["--list"])).succeeded().out.contains("* anna"));
    assert!(Run::of(&mut folders.calibrate(&["--use", "bert"])).sentence(1).contains("bert.toml"));
    assert!(Run::of(&mut folders.calibrate(&["--list"])).succeeded().out.contains("* anna"), "the former one stays");
    Run::of(&mut folders.calibrate(&["--use-none"])).succeeded();
    assert!(receiver.until(|packet| packet.state == State::Live).len() < 100);
    let (run, _) = service.stop(Signal::TERM);
    assert!(run.err.contains("wearer anna") && run.err.contains("wearer nobody"), "{}", run.err);
    assert!(!folders.run().join("facewire/control").exists());
}

#[test]
fn calibration_shows_progress_and_ctrl_c_cancels_it() {
    let folders = Folders::new();
    let (service, _receiver) = folders.service("demo");
    let mut client = folders.calibrate(&["--wearer", "carl"]).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(client.stdout.take().unwrap()).lines();
    assert!(lines.next().unwrap().unwrap().starts_with("[ 1/11] Look into the camera"));
    assert!(Run::of(&mut folders.calibrate(&[])).sentence(1).contains("another calibration is in progress"));
    client.kill().unwrap();
    client.wait().unwrap();
    // As soon as the service has noticed, another one begins.
    loop {
        let mut client = folders.calibrate(&["--wearer", "carl"]).stdout(Stdio::piped()).spawn().unwrap();
        let first = BufReader::new(client.stdout.take().unwrap()).lines().next();
        client.kill().unwrap();
        client.wait().unwrap();
        if first.is_some() {
            break;
        }
    }
    let (run, _) = service.stop(Signal::TERM);
    assert!(run.err.contains("calibration of wearer carl cancelled"), "{}", run.err);
    assert!(!folders.profiles().join("carl.toml").exists());
}

#[test]
fn service_that_is_stopped_ends_at_once_in_spite_of_a_calibration() {
    let folders = Folders::new();
    let (service, _receiver) = folders.service("demo");
    let mut client = folders.calibrate(&[]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut out = BufReader::new(client.stdout.take().unwrap());
    out.read_line(&mut String::new()).unwrap();
    let (run, took) = service.stop(Signal::TERM);
    assert_eq!(run.status, Some(0), "{}", run.err);
    assert!(took < Duration::from_secs(10), "{took:?}");
    drop(out);
    let sentence = Run::ended(&client.wait_with_output().unwrap());
    assert!(sentence.err.is_empty() || sentence.err.contains("does not answer"), "{sentence:?}");
}

#[test]
fn without_a_face_the_command_says_what_it_waits_for_and_makes_no_profile() {
    let folders = Folders::new();
    let file = settings(&folders.settings("rehearsal: live 1, no-face 600", "anna"));
    let run = Run::of(folders.calibrate(&[]).args(["--config", text(file.path())]));
    assert!(run.out.contains("waiting. No face is in the picture"), "{run:?}");
    let sentences = run.sentences(1);
    assert!(sentences.last().unwrap().starts_with("no profile was made, and the former one stays. No face"));
    assert_eq!(fs::read_to_string(folders.profiles().join("anna.toml")).unwrap(), PROFILE);
}

#[test]
fn damaged_profile_is_told_once_and_a_reload_that_names_one_is_refused() {
    let folders = Folders::new();
    let receiver = Receiver::new();
    let link = format!("[[link]]\naddress = \"{}\"\n", receiver.address());
    let file = settings(&(folders.settings("demo", "bert") + &link));
    let mut command = facewire(["run", "--config", text(file.path())]);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    let mut until = |wanted: &str| {
        let mut said = String::new();
        while !said.contains(wanted) {
            said.clear();
            assert!(log.read_line(&mut said).unwrap() > 0, "the log ends before {wanted:?}");
        }
        said
    };
    let warning = until("bert.toml");
    assert!(warning.contains("WARN") && warning.contains("facewire calibrate --wearer bert"), "{warning}");
    receiver.until(|packet| packet.state == State::Live);
    let reload = |wearer| {
        fs::write(file.path(), folders.settings("demo", wearer) + &link).unwrap();
        rustix::process::kill_process(rustix::process::Pid::from_child(&child), Signal::HUP).unwrap();
    };
    reload("carl");
    assert!(until("carl").contains("ERROR"));
    until("settings refused");
    reload("anna");
    until("settings changed: wearer");
    child.kill().unwrap();
    child.wait().unwrap();
}
