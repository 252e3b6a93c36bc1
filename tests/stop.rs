//! What an operator's release promises: a board that can be reached has no pulses, and every other one is named.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;

use common::eventually;
use common::maestro::{Maestro, Model};
use common::program::{Run, facewire, text};
use common::service::{NO_CAMERA, Service};
use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;

fn link(device: &Path) -> String {
    format!(
        "[[link]]\nkind = \"maestro\"\ndevice = \"{}\"\n[[link.channel]]\nsources = {{ jawOpen = 1 }}\n",
        device.display()
    )
}

/// A service with a control socket, and what it keeps.
struct Head {
    service: Service,
    folder: TempDir,
}

impl Head {
    fn start(links: &[String]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let service = Service::start_with(&[NO_CAMERA, &links.concat()].concat(), &[], |command| {
            command.env("XDG_RUNTIME_DIR", folder.path()).env("STATE_DIRECTORY", folder.path().join("state"))
        });
        service.await_log("control socket at");
        Self { service, folder }
    }

    /// What the service keeps.
    fn kept(&self) -> Vec<String> {
        let kept = fs::read_dir(self.folder.path().join("state")).into_iter().flatten();
        kept.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    /// A command of the program that finds what the service keeps.
    fn command(&self, name: &str) -> Command {
        let mut command = facewire([name, "--config", text(&self.service.settings())]);
        command.env("STATE_DIRECTORY", self.folder.path().join("state"));
        command
    }

    fn ask(&self, request: &str) -> Value {
        let mut stream = UnixStream::connect(self.folder.path().join("facewire/control")).unwrap();
        writeln!(stream, "{request}").unwrap();
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap()
    }

    fn release(&self) -> Value {
        self.ask("{\"do\":\"release\",\"on\":true}")
    }
}

#[test]
fn a_release_is_done_only_once_every_board_has_acknowledged_it_and_names_those_that_have_not() {
    let good = Maestro::plugged_in(Model::MINI_24);
    let silent = Maestro::plugged_in(Model { takes_commands: false, ..Model::MINI_24 });
    let absent = Path::new("/dev/no-maestro");
    let head = Head::start(&[&good.device, &silent.device, absent].map(link));
    eventually("a pulse", || good.pulse_us(0).is_some());
    eventually("the good board is released", || {
        let answer = head.release();
        let refusal = answer["refused"].as_str().unwrap_or_else(|| panic!("two boards were not reached: {answer}"));
        for device in [&silent.device, absent] {
            assert!(refusal.contains(text(device)), "{refusal}");
        }
        assert!(refusal.contains("Switch the supply of these servos off"), "{refusal}");
        let is_good = !refusal.contains(text(&good.device));
        assert!(!is_good || good.pulse_us(0).is_none(), "what is not named has no pulses");
        is_good
    });
    let status = head.ask("{\"do\":\"status\"}");
    let released: Vec<_> = (0..3).map(|link| status["status"]["links"][link]["released"].clone()).collect();
    assert_eq!(released, [true, false, false], "{status}");
    assert!(status["status"]["released_unix_s"].as_u64() > Some(1_700_000_000), "{status}");
    assert!(head.ask("{\"do\":\"release\",\"on\":false}")["done"].is_string());
    eventually("a pulse again", || good.pulse_us(0).is_some());
}

#[test]
fn a_service_that_starts_again_says_that_servos_are_released_and_another_service_does_not_obey() {
    let maestro = Maestro::plugged_in(Model::MINI_24);
    let other = Maestro::plugged_in(Model::MINI_24);
    let head = Head::start(&[link(&maestro.device)]);
    eventually("the release", || head.release()["done"].is_string());
    assert_eq!(maestro.pulse_us(0), None);
    let status = head.service.status();
    assert!(status.contains("servos=released"), "{status}");
    let beside = Service::start_with(&[NO_CAMERA, &link(&other.device)].concat(), &[], |command| {
        command.env("STATE_DIRECTORY", head.folder.path().join("state"))
    });
    eventually("a pulse of the other service", || other.pulse_us(0).is_some());
    drop(beside);
    // The service starts again, as after a crash.
    head.service.signal(Signal::KILL);
    let log = head.folder.path().join("log");
    let mut child = head.command("run").stderr(fs::File::create(&log).unwrap()).spawn().unwrap();
    eventually("a word", || {
        let log = fs::read_to_string(&log).unwrap();
        log.contains("an operator released all servos") && log.contains("link opened")
    });
    assert_eq!(maestro.pulse_us(0), None);
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_rest_releases_servos_by_the_last_good_settings_if_the_present_ones_have_faults() {
    let maestro = Maestro::plugged_in(Model::MINI_24);
    let head = Head::start(&[link(&maestro.device)]);
    eventually("a pulse", || maestro.pulse_us(0).is_some());
    let settings = head.service.settings();
    let rest = || Run::of(&mut head.command("rest"));
    eventually("the kept settings", || head.kept().iter().any(|name| name.starts_with("settings@")));
    head.service.signal(Signal::KILL);
    for fault in ["[camera]\nfps = 0\n", "[link"] {
        let text = fs::read_to_string(&settings).unwrap();
        fs::write(&settings, text + fault).unwrap();
        eventually("the board", || rest().out.contains(": released"));
        let run = rest();
        assert_eq!((run.status, maestro.pulse_us(0)), (Some(78), None), "{run:?}");
    }
}
