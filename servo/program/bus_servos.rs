//! What a link to bus servos, `facewire rest` and `facewire servo` promise, with simulated servos at a pseudo-terminal.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

#[path = "../../tests/common/mod.rs"]
mod common;

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use allocation_counter::measure;
use common::board::{Board, StablePath};
use common::eventually;
use common::program::{Run, facewire, settings, text};
use common::service::{DEMO, NO_CAMERA, Service};
use facewire::config;
use facewire::link::{Link, Output, Pose, Traffic};
use facewire_packet::{Reason, State};
use facewire_servo::bus::simulator::{Simulator, Written};
use facewire_servo::finder::{Finder, Press};
use rustix::fs::fcntl_setfl;
use rustix::process::Signal;

/// Servos that run on a thread of their own until they are unplugged.
struct Bus {
    device: PathBuf,
    simulator: Arc<Mutex<Simulator>>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Bus {
    fn plugged_in(family: &str, ids: &[u8]) -> Self {
        Self::with(Arc::new(Mutex::new(Simulator::new(family, ids, Instant::now()))))
    }

    fn with(simulator: Arc<Mutex<Simulator>>) -> Self {
        let (mut board, is_over) = (Board::plugged_in(), Arc::<AtomicBool>::default());
        let (device, shared, over) = (board.device.clone(), Arc::clone(&simulator), Arc::clone(&is_over));
        let thread = thread::spawn(move || {
            while !over.load(Relaxed) {
                let mut bytes = [0; 1024];
                let length = board.master.read(&mut bytes).unwrap_or(0);
                let answers = shared.lock().unwrap().take(&bytes[..length], Instant::now());
                let _ = board.master.write_all(&answers);
                if length == 0 {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        });
        Self { device, simulator, is_over, thread: Some(thread) }
    }

    fn lock(&self) -> MutexGuard<'_, Simulator> {
        self.simulator.lock().unwrap()
    }

    fn torques(&self) -> Vec<bool> {
        self.lock().servos.iter().map(|servo| servo.has_torque()).collect()
    }

    fn positions(&self) -> Vec<f64> {
        self.lock().servos.iter().map(|servo| servo.position.round()).collect()
    }

    fn await_state(&self, torques: &[bool], positions: &[f64]) {
        eventually(&format!("{torques:?} {positions:?}"), || {
            (self.torques(), self.positions()) == (torques.to_vec(), positions.to_vec())
        });
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        self.is_over.store(true, Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// A jaw that goes from 700 to 300 steps, and rests at 500, and a neck with limits.
fn link(device: &Path, family: &str) -> String {
    format!(
        "[[link]]\nkind = \"bus-servo\"\ndevice = \"{}\"\nfamily = \"{family}\"\n
[[link.channel]]\nchannel = 1\nsources = {{ jawOpen = 1.0 }}\nposition_at_0 = 700\nposition_at_1 = 300\nneutral = 0.25
[[link.channel]]\nchannel = 4\nsources = {{ headYaw = 0.01 }}\noffset = 0.5\nposition_at_0 = 200\nposition_at_1 = 800
speed_per_s = 1.0\nacceleration_per_s2 = 20.0\n",
        device.display()
    )
}

const FAMILIES: [&str; 5] = ["dynamixel-x", "dynamixel-ax", "dynamixel-mx", "feetech-sts", "feetech-scs"];

#[test]
fn every_family_rests_without_a_camera_and_has_no_torque_after_the_end_and_after_a_kill_and_a_rest() {
    for family in FAMILIES {
        let bus = Bus::plugged_in(family, &[1, 4]);
        let links = link(&bus.device, family);
        let service = Service::start(&[NO_CAMERA, &links].concat(), &[]);
        bus.await_state(&[true; 2], &[600.0, 500.0]);
        bus.lock().servos[1].position = 700.0;
        let (_, took) = service.stop(Signal::TERM);
        bus.await_state(&[false; 2], &[600.0, 500.0]);
        assert!(took < Duration::from_secs(4), "{took:?}");
        let service = Service::start(&[NO_CAMERA, &links].concat(), &[]);
        bus.await_state(&[true; 2], &[600.0, 500.0]);
        service.stop(Signal::KILL);
        assert_eq!(bus.torques(), [true; 2], "a servo holds what it was told");
        let file = settings(&links);
        // A second rest does no harm.
        for _ in 0..2 {
            let run = Run::of(&mut facewire(["rest", "--config", text(file.path())]));
            assert!(run.status == Some(0) && run.out.contains(": released"), "{run:?}");
            bus.await_state(&[false; 2], &[600.0, 500.0]);
        }
        assert!(bus.lock().strange.is_empty());
    }
    for toml in [
        "",
        "[[link]]\nkind = \"bus-servo\"\ndevice = \"/dev/nothing\"\n[[link.channel]]\nchannel = 1\nsources = { jawOpen = 1.0 }\nposition_at_1 = 9\n",
    ] {
        let run = Run::of(&mut facewire(["rest", "--config", text(settings(toml).path())]));
        assert_eq!(
            (run.status, run.out.contains("/dev/nothing: there is no such")),
            (Some(0), !toml.is_empty()),
            "{run:?}"
        );
    }
}

#[test]
fn servos_follow_a_face_and_a_line_that_was_unplugged_in_mid_move_begins_again_where_they_stand() {
    let (stable, bus) = (StablePath::new(), Bus::plugged_in("feetech-sts", &[1, 4]));
    symlink(&bus.device, stable.path()).unwrap();
    let service = Service::start(&[DEMO, &link(&stable.path(), "feetech-sts")].concat(), &[]);
    let moves = |bus: &Bus| {
        eventually("both servos", || bus.torques() == [true; 2]);
        let before = bus.positions();
        eventually("the face", || bus.positions().iter().zip(&before).all(|(now, before)| (now - before).abs() > 3.0));
    };
    moves(&bus);
    fs::remove_file(stable.path()).unwrap();
    let simulator = Arc::clone(&bus.simulator);
    drop(bus);
    service.await_log("went away");
    simulator.lock().unwrap().written.clear();
    let bus = Bus::with(simulator);
    symlink(&bus.device, stable.path()).unwrap();
    // What was written first has a low speed.
    let first = |id| {
        let goal = |written: &&Written| written.1 == id && written.2 == 41;
        bus.lock().written.iter().find(goal).map(|written| u16::from_le_bytes([written.3[5], written.3[6]]))
    };
    eventually("goals for both", || [1, 4].iter().all(|id| first(*id).is_some()));
    assert!([1, 4].iter().all(|id| (1..=700).contains(&first(*id).unwrap())), "60 degrees are 683 steps");
    moves(&bus);
}

#[test]
fn troubles_of_servos_are_told_once_with_what_to_do() {
    let bus = Bus::plugged_in("dynamixel-x", &[1]);
    let service = Service::start(&[NO_CAMERA, &link(&bus.device, "dynamixel-x")].concat(), &[]);
    service.await_log("servo 4: it does not answer: check its power and cable");
    eventually("the other servo", || bus.torques() == [true]);
    bus.lock().plug_in(4, Instant::now());
    bus.await_state(&[true; 2], &[600.0, 500.0]);
    bus.lock().servos[0].alarms = 1 << 2;
    service.await_log("servo 1: it is too hot: cut its power");
    assert_eq!((service.logged("does not answer"), service.logged("too hot")), (1, 1));
}

#[test]
fn the_sender_hands_a_face_over_without_an_allocation() {
    let bus = Bus::plugged_in("feetech-scs", &[1, 4]);
    let settings = config::parse("test", &link(&bus.device, "feetech-scs")).unwrap();
    let mut link = Link::open(&settings.links[0], &Arc::<Traffic>::default()).unwrap();
    eventually("the port", || link.is_open());
    let mut pose = Pose::NEUTRAL;
    pose.coefficients[17] = 1.0;
    let (state, reason) = (State::Live, Reason::None);
    let output = Output { state, reason, pose, age_us: 0, capture_us: 0, followed: true, moving: false };
    let allocated = measure(|| (0..100).for_each(|_| link.send_last(&settings.links[0], &output)));
    assert_eq!(allocated.count_total, 0);
    eventually("an open jaw", || {
        link.send_last(&settings.links[0], &output);
        thread::sleep(Duration::from_millis(20));
        bus.positions() == [300.0, 500.0]
    });
}

#[test]
fn keys_move_one_servo_from_where_it_stands_within_its_limits_and_its_lines_come_at_the_end() {
    let (bus, terminal) = (Bus::plugged_in("feetech-scs", &[3]), Board::plugged_in());
    let port = terminal.port();
    fcntl_setfl(&port, rustix::fs::OFlags::empty()).unwrap();
    let end = || Stdio::from(port.try_clone().unwrap());
    let arguments = ["servo", "--channel", "3", "--bus", text(&bus.device), "--family", "feetech-scs", "--step", "100"];
    let mut child = facewire(arguments).stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
    let mut screen = String::new();
    let mut shows = |what: &str| {
        eventually(what, || {
            let mut bytes = [0; 4096];
            let length = (&terminal.master).read(&mut bytes).unwrap_or(0);
            screen += &String::from_utf8_lossy(&bytes[..length]);
            screen.contains(what)
        });
    };
    let press = |key: &[u8]| (&terminal.master).write_all(key).unwrap();
    shows(" 500 steps (no torque)");
    assert_eq!(bus.torques(), [false]);
    [b"\x1b[C", b"\x1b[C"].into_iter().for_each(|key| press(key));
    bus.await_state(&[true], &[600.0]);
    [&b"0"[..], b"\x1b[A", b"\x1b[A", b"1"].into_iter().for_each(press);
    // A servo of this family allows 20 to 1003.
    bus.await_state(&[true], &[1003.0]);
    shows("1: 1003");
    press(b"q");
    shows("position_at_0 = 600\r\nposition_at_1 = 1003\r\n");
    eventually("the end", || child.try_wait().unwrap().is_some());
    bus.await_state(&[false], &[1003.0]);
    assert!(bus.lock().servos[0].fastest <= 60.0 / 300.0 * 1023.0 + 1.0);
}

#[test]
fn a_scan_lists_the_servos_of_a_line_and_moves_none() {
    let bus = Bus::plugged_in("feetech-sts", &[2, 5]);
    let mut command = facewire(["devices", "--scan", text(&bus.device)]);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines().take(2).map(Result::unwrap);
    let want = [2, 5].map(|id| format!("servo {id} at 1000000 baud: model 777, family = \"feetech-sts\""));
    assert_eq!(lines.collect::<Vec<_>>(), want);
    child.kill().and_then(|()| child.wait()).unwrap();
    assert!(bus.lock().written.is_empty() && bus.lock().strange.is_empty());
}

#[test]
fn the_lines_of_a_servo_whose_ends_were_found_load_as_settings() {
    for (kind, is_bus) in [("maestro", false), ("pca9685", false), ("bus-servo", true)] {
        let mut finder = Finder::new(1500.0, 100.0, [500.0, 2500.0], is_bus);
        let up = Press::Move(5.0);
        for key in [up, Press::Neutral, up, Press::End(0), Press::Move(-5.0), Press::End(1)] {
            finder.press(key);
            let text = format!("[[link]]\nkind = \"{kind}\"\n{}", finder.lines(3));
            assert!(config::parse("test", &text).is_ok(), "{text}");
        }
    }
}
