//! Calibration and wearers, as a user meets them: the command, the service and its control socket.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use common::program::{Run, facewire, settings, text};
use common::service::{Receiver, Service};
use tempfile::TempDir;

/// A profile of a face of few points, made by hand.
const PROFILE: &str = include_str!("../fuzz/corpus/profile_file/whole.toml");

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

    fn profiles(&self) -> PathBuf {
        self.0.path().join("profiles")
    }

    fn settings(&self, camera: &str, wearer: &str) -> String {
        let folder = self.profiles();
        format!("[camera]\ndevice = '{camera}'\n[wearer]\nname = '{wearer}'\nfolder = '{}'\n", text(&folder))
    }

    /// A service of this wearer that shows the built-in clip, once it is live.
    fn service(&self, wearer: &str) -> (Service, Receiver) {
        let receiver = Receiver::new();
        let service = Service::start_with(&self.settings("demo", wearer), &[receiver.address()], |command| {
            command.env("XDG_RUNTIME_DIR", self.0.path())
        });
        receiver.live();
        (service, receiver)
    }

    /// `facewire calibrate` with these arguments, beside the service of these folders.
    fn calibrate(&self, arguments: &[&str]) -> Command {
        let mut command = facewire([&["calibrate"], arguments].concat());
        command.env("XDG_RUNTIME_DIR", self.0.path());
        command
    }
}

#[test]
fn wearers_are_checked_listed_and_deleted_without_a_service() {
    let folders = Folders::new();
    let file = settings(&folders.settings("demo", "anna"));
    let run = |arguments: &[&str]| Run::of(folders.calibrate(arguments).args(["--config", text(file.path())]));
    let list = run(&["--list"]).succeeded().out;
    assert!(list.contains("* anna") && list.contains(" 2 takes,"), "{list}");
    assert!(list.contains("  bert") && list.contains("cannot be used"), "{list}");
    for (wearer, told) in
        [("anna", "ok: anna, 2 takes"), ("bert", "facewire calibrate --wearer bert"), ("", "ok: no profile is in use")]
    {
        let file = settings(&folders.settings("demo", wearer));
        let out = Run::of(&mut facewire(["check", "--config", text(file.path())])).out;
        let line = out.lines().find(|line| line.starts_with("wearer")).unwrap();
        assert!(line.contains(told) && line.contains("FAILED") == (wearer == "bert"), "{line}");
    }
    run(&["--delete", "bert"]).succeeded();
    assert!(!folders.profiles().join("bert.toml").exists());
    assert!(run(&["--delete", "bert"]).sentence(66).contains("there is no profile"));
    assert!(run(&["--use", "anna"]).sentence(1).contains("no service runs"));
    assert_eq!(run(&["--wearer", "../../etc/passwd"]).status, Some(2));
}

#[test]
fn under_a_headset_the_profile_of_a_bare_face_has_no_effect_and_is_not_replaced_and_check_track_calibrate_and_the_service_say_so()
 {
    let folders = Folders::new();
    let file = settings(&(folders.settings("demo", "anna") + "wears = 'headset'\n"));
    let of = |arguments: &[&str]| Run::of(facewire(arguments).args(["--config", text(file.path())]));
    let check = of(&["check"]).out;
    let line = check.lines().find(|line| line.starts_with("wearer")).unwrap();
    assert!(line.contains("has no effect while it is \"headset\""), "{line}");
    let bare = settings(&(folders.settings("demo", "") + "wears = 'headset'\n"));
    let nobody = Run::of(&mut facewire(["track", "demo", "--config", text(bare.path())])).succeeded();
    let anna = of(&["track", "demo"]).succeeded();
    assert!(anna.err.contains("has no effect while it is \"headset\""), "{}", anna.err);
    assert_eq!(anna.out, nobody.out);

    let before = fs::read(folders.profiles().join("anna.toml")).unwrap();
    let refused = Run::of(folders.calibrate(&[]).args(["--config", text(file.path())]));
    assert!(refused.sentences(1).last().unwrap().contains("anna-headset"), "{}", refused.err);
    let toml = folders.settings("demo", "anna") + "wears = 'headset'\n";
    let receiver = Receiver::new();
    let service =
        Service::start_with(&toml, &[receiver.address()], |command| command.env("XDG_RUNTIME_DIR", folders.0.path()));
    receiver.live();
    let refused = Run::of(&mut folders.calibrate(&[]));
    assert!(refused.sentence(1).contains("anna-headset"), "{}", refused.err);
    assert!(service.stopped().contains("has no effect while it is"));
    assert_eq!(fs::read(folders.profiles().join("anna.toml")).unwrap(), before);
}

#[test]
fn track_applies_the_profile_of_a_wearer_and_refuses_one_that_is_not_there() {
    let folders = Folders::new();
    let file = settings(&folders.settings("demo", ""));
    let track =
        |arguments: &[&str]| Run::of(facewire(["track", "demo", "--config", text(file.path())]).args(arguments));
    let [plain, worn] = [track(&[]), track(&["--wearer", "anna"])].map(|run| run.succeeded().out);
    assert_eq!(plain.lines().count(), worn.lines().count());
    assert_ne!(plain, worn);
    assert!(track(&["--wearer", "carl"]).sentence(66).contains("facewire calibrate --wearer carl"));
    assert!(track(&["--wearer", "bert"]).sentence(65).contains("bert.toml"));
}

#[test]
fn wearer_in_use_is_changed_while_the_service_runs() {
    let folders = Folders::new();
    let (service, receiver) = folders.service("");
    let told = Run::of(&mut folders.calibrate(&["--use", "anna"])).succeeded().out;
    assert!(told.contains("the profile of anna is in use"), "{told}");
    assert!(Run::of(&mut folders.calibrate(&["--list"])).succeeded().out.contains("* anna"));
    assert!(Run::of(&mut folders.calibrate(&["--use", "bert"])).sentence(1).contains("bert.toml"));
    assert!(Run::of(&mut folders.calibrate(&["--list"])).succeeded().out.contains("* anna"), "the former one stays");
    Run::of(&mut folders.calibrate(&["--use-none"])).succeeded();
    assert!(receiver.live().len() < 100);
    let log = service.stopped();
    assert!(log.contains("wearer anna") && log.contains("wearer nobody"), "{log}");
    assert!(!folders.0.path().join("facewire/control").exists());
}

#[test]
fn calibration_shows_progress_and_ctrl_c_cancels_it() {
    let folders = Folders::new();
    let (service, _receiver) = folders.service("");
    let mut client = folders.calibrate(&["--wearer", "carl"]).stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(client.stdout.take().unwrap()).lines();
    assert!(lines.next().unwrap().unwrap().starts_with("[ 1/11] Look into the camera"));
    assert!(Run::of(&mut folders.calibrate(&[])).sentence(1).contains("another calibration is in progress"));
    client.kill().unwrap();
    client.wait().unwrap();
    service.await_log("calibration of wearer carl cancelled");
    let mut client =
        folders.calibrate(&["--wearer", "carl"]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut out = BufReader::new(client.stdout.take().unwrap());
    out.read_line(&mut String::new()).unwrap();
    // The service does not wait for the end of the calibration, which would take a minute.
    service.stopped();
    drop(out);
    let sentence = Run::ended(&client.wait_with_output().unwrap());
    assert!(sentence.err.is_empty() || sentence.err.contains("does not answer"), "{sentence:?}");
    assert!(!folders.profiles().join("carl.toml").exists());
}

#[test]
fn without_a_face_the_command_says_what_it_waits_for_and_makes_no_profile() {
    let folders = Folders::new();
    let file = settings(&folders.settings("rehearsal: live 1, no-face 600", "anna"));
    let run = Run::of(folders.calibrate(&[]).args(["--config", text(file.path())]));
    assert!(run.out.contains("waiting. No face is in the picture"), "{run:?}");
    let sentences = run.sentences(1);
    assert!(sentences.last().unwrap().starts_with("no profile was made, and any former one stays. No face"));
    let last = run.out.lines().last().unwrap();
    assert!(last.ends_with(": ended without a profile") && !run.out.contains(": done"), "{run:?}");
    assert_eq!(fs::read_to_string(folders.profiles().join("anna.toml")).unwrap(), PROFILE);
}

#[test]
fn a_few_damaged_frames_are_not_told_as_a_camera_without_pictures() {
    let folders = Folders::new();
    let file = settings(&folders.settings("rehearsal: live 1, damaged 0.3, no-face 600", "anna"));
    let mut command = folders.calibrate(&["--config", text(file.path())]);
    let mut client = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let lines = BufReader::new(client.stdout.take().unwrap()).lines().map_while(Result::ok);
    let mut told: Vec<String> = lines.take_while(|line| !line.contains("No face is in the picture")).collect();
    client.kill().unwrap();
    client.wait().unwrap();
    told.retain(|line| line.contains("No picture"));
    assert!(told.is_empty(), "{told:?}");
}

#[test]
fn damaged_profile_is_told_once_and_a_reload_that_names_one_is_refused() {
    let folders = Folders::new();
    let (service, _receiver) = folders.service("bert");
    let log = service.log();
    let told: Vec<&str> = log.lines().filter(|line| line.contains("bert.toml")).collect();
    assert!(told.len() == 1 && told[0].contains("WARN"), "{log}");
    assert!(told[0].contains("facewire calibrate --wearer bert"), "{log}");
    service.reload(&folders.settings("demo", "carl"));
    service.await_log("settings refused");
    assert!(service.log().lines().any(|line| line.contains("carl") && line.contains("ERROR")), "{}", service.log());
    service.reload(&folders.settings("demo", "anna"));
    service.await_log("settings changed: wearer");
}
