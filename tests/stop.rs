//! What an operator's release promises: a board that can be reached has no pulses, and every other one is named.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use common::eventually;
use common::maestro::{Maestro, Model};
use common::program::{Run, facewire, text};
use common::service::{NO_CAMERA, Service};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::process::Signal;
use serde_json::Value;
use tempfile::TempDir;

fn link(device: &Path) -> String {
    link_of(device, &[0])
}

fn link_of(device: &Path, channels: &[u16]) -> String {
    let channel = |number| format!("[[link.channel]]\nchannel = {number}\nsources = {{ jawOpen = 1 }}\n");
    let channels: String = channels.iter().map(channel).collect();
    format!("[[link]]\nkind = \"maestro\"\ndevice = \"{}\"\n{channels}", device.display())
}

/// Whether words name this board: `/dev/pts/1`, not `/dev/pts/12`.
fn names(words: &str, device: &Path) -> bool {
    words.split(text(device)).skip(1).any(|rest| !rest.starts_with(|next: char| next.is_ascii_digit()))
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
        let names = kept.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        // A hidden one is still being written.
        names.filter(|name| !name.starts_with('.')).collect()
    }

    /// A command of the program that finds what the service keeps.
    fn command(&self, name: &str) -> Command {
        let mut command = facewire([name, "--config", text(&self.service.settings())]);
        command.env("STATE_DIRECTORY", self.folder.path().join("state"));
        command
    }

    fn connect(&self) -> UnixStream {
        UnixStream::connect(self.folder.path().join("facewire/control")).unwrap()
    }

    fn ask(&self, request: &str) -> Value {
        let mut stream = self.connect();
        let mut line = String::new();
        // Whoever is slow among many clients may be turned away.
        let _ = writeln!(stream, "{request}").and_then(|()| BufReader::new(stream).read_line(&mut line));
        serde_json::from_str(&line).unwrap_or_default()
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
            assert!(names(refusal, device), "{refusal}");
        }
        assert!(refusal.contains("Switch the supply of these servos off"), "{refusal}");
        let is_good = !names(refusal, &good.device);
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
fn a_maestro_that_has_lost_commands_has_not_acknowledged_a_release() {
    // It does not know the command that sets several targets, and says so in each answer.
    let small = Maestro::plugged_in(Model::MICRO_6);
    let link = link_of(&small.device, &[0, 1])
        .replace("kind = \"maestro\"\n", "kind = \"maestro\"\nmultiple_targets = true\n");
    let head = Head::start(&[link]);
    eventually("an answer of the board", || {
        let answer = head.release();
        let refusal = answer["refused"].as_str().unwrap_or_else(|| panic!("nothing was released: {answer}"));
        refusal.contains("it received a command that it does not know")
    });
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

#[test]
fn a_board_and_a_channel_that_the_settings_name_no_more_have_no_pulses_after_a_reload_and_after_a_rest() {
    let [kept, removed, new] = [(); 3].map(|()| Maestro::plugged_in(Model::MINI_24));
    let head = Head::start(&[link_of(&kept.device, &[0, 1]), link(&removed.device)]);
    eventually("pulses", || [kept.pulse_us(0), kept.pulse_us(1), removed.pulse_us(0)].iter().all(Option::is_some));
    let settings = |device: &Path| [NO_CAMERA, &link(device)].concat();
    head.service.change(&settings(&kept.device));
    eventually("the release of the board", || removed.pulse_us(0).is_none());
    eventually("the release of the channel", || kept.pulse_us(1).is_none() && kept.pulse_us(0).is_some());
    eventually("the kept settings", || {
        let state = head.folder.path().join("state");
        head.kept()
            .iter()
            .any(|name| fs::read_to_string(state.join(name)).is_ok_and(|text| text == settings(&kept.device)))
    });
    // The service is started again with other settings than it had.
    fs::write(head.service.settings(), settings(&new.device)).unwrap();
    head.service.signal(Signal::KILL);
    eventually("both boards", || {
        let out = Run::of(&mut head.command("rest")).out;
        [&new, &kept].iter().all(|board| out.contains(&format!("{}: released", text(&board.device))))
    });
    assert_eq!(kept.pulse_us(0), None);
}

#[test]
fn a_release_is_kept_for_the_next_start_although_the_disk_holds_up_a_reload_or_profiles_go_elsewhere() {
    let maestro = Maestro::plugged_in(Model::MINI_24);
    let links = link(&maestro.device);
    let head = Head::start(std::slice::from_ref(&links));
    let [profiles, model] = ["profiles", "model.toml"].map(|name| head.folder.path().join(name));
    let settings = format!("{NO_CAMERA}{links}[wearer]\nfolder = {profiles:?}\n");
    head.service.change(&settings);
    // Whoever reads the model waits for ever.
    mknodat(CWD, &model, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    let before = head.service.logged("reading the settings again");
    head.service.reload(&format!("{settings}[solver]\nmodel = {model:?}\n"));
    eventually("the reload", || head.service.logged("reading the settings again") > before);
    eventually("the release", || head.release()["done"].is_string());
    eventually("what is kept", || head.kept().iter().any(|name| name.starts_with("released@")));
}

/// What goes on while an operator presses STOP.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Trouble {
    Nothing,
    BoardHangs,
    PortPulled,
    IdleClients,
    HammeringClients,
    LargeRequests,
    NoRoomOnDisk,
    BrokenSettings,
}

const TROUBLES: [Trouble; 8] = [
    Trouble::Nothing,
    Trouble::BoardHangs,
    Trouble::PortPulled,
    Trouble::IdleClients,
    Trouble::HammeringClients,
    Trouble::LargeRequests,
    Trouble::NoRoomOnDisk,
    Trouble::BrokenSettings,
];

#[test]
fn stop_at_the_control_socket_is_done_or_names_the_board_within_300_ms_whatever_else_goes_on() {
    for trouble in TROUBLES {
        let good = Maestro::plugged_in(Model::MINI_24);
        let takes_commands = trouble != Trouble::BoardHangs;
        let mut other = Some(Maestro::plugged_in(Model { takes_commands, ..Model::MINI_24 }));
        let device = other.as_ref().unwrap().device.clone();
        let head = Head::start(&[&good.device, &device].map(|device| link(device)));
        eventually("a pulse", || good.pulse_us(0).is_some());
        let is_named = matches!(trouble, Trouble::BoardHangs | Trouble::PortPulled);
        let is_over = AtomicBool::new(false);
        thread::scope(|scope| {
            match trouble {
                Trouble::PortPulled => drop(other.take()),
                // More than there are places for. Whoever is turned away comes back.
                Trouble::IdleClients => (0..100).for_each(|_| {
                    scope.spawn(|| {
                        while !is_over.load(Relaxed) {
                            let _ = head.connect().read(&mut [0]);
                        }
                    });
                }),
                Trouble::HammeringClients => (0..60).for_each(|_| {
                    scope.spawn(|| {
                        while !is_over.load(Relaxed) {
                            head.ask("{\"do\":\"status\"}");
                        }
                    });
                }),
                Trouble::LargeRequests => drop(scope.spawn(|| {
                    let mut driver = head.connect();
                    let values: Vec<_> =
                        facewire_packet::BLENDSHAPES.iter().map(|name| format!("\"{name}\":1")).collect();
                    let face = format!("{{\"coefficients\":{{{}}}}}", values.join(","));
                    writeln!(driver, "{{\"do\":\"drive\"}}").unwrap();
                    let mut goes_on = true;
                    while goes_on {
                        goes_on = writeln!(driver, "{face}").is_ok() && !is_over.load(Relaxed);
                    }
                })),
                Trouble::NoRoomOnDisk => {
                    let state = head.folder.path().join("state");
                    eventually("the kept settings", || !head.kept().is_empty());
                    fs::remove_dir_all(&state).unwrap();
                    fs::write(state, "").unwrap();
                }
                Trouble::BrokenSettings => {
                    head.service.reload("[link");
                    head.service.await_log("settings refused");
                }
                Trouble::Nothing | Trouble::BoardHangs => {}
            }
            // A busy machine may delay one answer or another, but not all.
            eventually(&format!("{trouble:?}: a release within 300 ms"), || {
                head.ask("{\"do\":\"release\",\"on\":false}");
                let begun = Instant::now();
                let answer = head.release();
                let took = begun.elapsed();
                let refusal = answer["refused"].as_str().unwrap_or_default();
                assert!(!names(refusal, &device) || refusal.contains("Switch the supply of these servos off"));
                let is_answered = is_named || answer["done"].is_string();
                let is_right = is_answered && names(refusal, &device) == is_named && !names(refusal, &good.device);
                is_right && good.pulse_us(0).is_none() && took < Duration::from_millis(300)
            });
            is_over.store(true, Relaxed);
        });
    }
}

#[test]
fn a_rest_is_done_or_names_the_board_whatever_else_goes_on() {
    for trouble in TROUBLES {
        let good = Maestro::plugged_in(Model::MINI_24);
        let takes_commands = trouble != Trouble::BoardHangs;
        let mut other = Some(Maestro::plugged_in(Model { takes_commands, ..Model::MINI_24 }));
        let device = other.as_ref().unwrap().device.clone();
        let mut head = Head::start(&[&good.device, &device].map(|device| link(device)));
        eventually("a pulse", || good.pulse_us(0).is_some());
        eventually("the kept settings", || !head.kept().is_empty());
        match trouble {
            Trouble::PortPulled => drop(other.take()),
            Trouble::NoRoomOnDisk => {
                let state = head.folder.path().join("state");
                fs::remove_dir_all(&state).unwrap();
                fs::write(state, "").unwrap();
            }
            Trouble::BrokenSettings => fs::write(head.service.settings(), "[link").unwrap(),
            // Clients have nothing to do with it.
            Trouble::IdleClients | Trouble::HammeringClients | Trouble::LargeRequests => continue,
            Trouble::Nothing | Trouble::BoardHangs => {}
        }
        head.service.signal(Signal::KILL);
        head.service.child.wait().unwrap();
        let is_named = matches!(trouble, Trouble::BoardHangs | Trouble::PortPulled);
        let is_broken = trouble == Trouble::BrokenSettings;
        let status = if is_broken {
            78
        } else if is_named {
            69
        } else {
            0
        };
        let released = format!("{}: released", text(&good.device));
        // A busy machine may let a board be late at one try or another, which is named then.
        eventually(&format!("{trouble:?}: a rest that reaches every board but the one in trouble"), || {
            let run = Run::of(&mut head.command("rest"));
            let is_released = run.out.contains(&released);
            // Being late may change whom it names, but it never makes a success of a failure.
            assert!(run.status != Some(0) || (is_released && status == 0), "{trouble:?}: {run:?}");
            let told: Vec<&str> = run.err.lines().filter(|line| !line.contains("still trying")).collect();
            assert!(is_released || names(&told.join("\n"), &good.device), "{trouble:?}: {run:?}");
            assert!(!is_released || good.pulse_us(0).is_none(), "{trouble:?}: {run:?}");
            let last = told.last().copied().unwrap_or_default();
            let is_told = run.status == Some(status) && (is_broken || names(last, &device) == is_named);
            // It is named while it is tried on.
            let is_warned = run.err.contains(&format!("still trying: link {}", text(&device)));
            let is_right = is_released && is_told && (is_warned || trouble != Trouble::BoardHangs);
            if !is_right {
                eprintln!("{trouble:?}: {run:?}");
            }
            is_right
        });
    }
}
