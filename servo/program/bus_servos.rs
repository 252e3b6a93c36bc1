//! What a link to bus servos, `facewire rest` and `facewire servo` promise, with simulated servos at a pseudo-terminal.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod bus;
#[path = "../../tests/common/mod.rs"]
mod common;

use std::fs;
use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Stdio;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bus::Bus;
use common::board::{Board, StablePath};
use common::program::{Run, facewire, settings, text};
use common::service::{DEMO, NO_CAMERA, Service};
use common::{PATIENCE, eventually};
use dynamixel2::instructions::SyncWriteData;
use facewire::config;
use facewire_servo::bus::FAMILIES;
use facewire_servo::bus::simulator::Written;
use facewire_servo::finder::{Finder, Press};
use rustix::fs::fcntl_setfl;
use rustix::process::Signal;

fn await_servos(bus: &Bus, wanted: &[(bool, f64)]) {
    eventually(&format!("{wanted:?}"), || bus.servos() == wanted);
}

/// A jaw that goes from 700 to 300 steps and rests at 600, and a neck with limits that rests at 500.
fn link(device: &Path, family: &str) -> String {
    format!(
        "[[link]]\nkind = \"bus-servo\"\ndevice = \"{}\"\nfamily = \"{family}\"\n
[[link.channel]]\nchannel = 1\nsources = {{ jawOpen = 1.0 }}\nposition_at_0 = 700\nposition_at_1 = 300\nneutral = 0.25
[[link.channel]]\nchannel = 4\nsources = {{ headYaw = 0.01 }}\noffset = 0.5\nposition_at_0 = 200\nposition_at_1 = 800
speed_per_s = 1.0\nacceleration_per_s2 = 20.0\n",
        device.display()
    )
}

/// The metrics of a service.
fn page(socket: &Path) -> String {
    let mut stream = UnixStream::connect(socket).unwrap();
    stream.write_all(b"GET /metrics HTTP/1.1\r\n\r\n").unwrap();
    io::read_to_string(stream).unwrap()
}

fn rest(toml: &str) -> Run {
    Run::of(&mut facewire(["rest", "--config", text(settings(toml).path())]))
}

#[test]
fn every_family_rests_without_a_camera_and_has_no_torque_after_the_end_and_after_a_kill_and_a_rest() {
    let (held, free) = ([(true, 600.0), (true, 500.0)], [(false, 600.0), (false, 500.0)]);
    for (family, _) in FAMILIES {
        let bus = Bus::plugged_in(family, &[1, 4]);
        let links = link(&bus.device, family);
        // The first servo takes 0.1 s for the 100 steps to its rest, so that the service is usually stopped in between. The
        // service waits until the servo is there, for a second at most, which may not be enough on a busy machine.
        bus.lock().servos[0].motor = 1000.0;
        let service = Service::start(&[NO_CAMERA, &links].concat(), &[]);
        eventually("a servo on its way", || bus.servos()[0].1 > 505.0);
        let begun = Instant::now();
        service.stop(Signal::TERM);
        eventually("no torque", || bus.servos().iter().all(|(has_torque, _)| !has_torque));
        assert!(bus.servos() == free || begun.elapsed() >= Duration::from_secs(1), "{:?}", bus.servos());
        let service = Service::start(&[NO_CAMERA, &links].concat(), &[]);
        await_servos(&bus, &held);
        let beside = rest(&links);
        assert!(beside.sentence(69).contains("another program has it open"), "beside a service nothing is released");
        service.stop(Signal::KILL);
        assert_eq!(bus.servos(), held, "a servo holds what it was told");
        // A second rest does no harm.
        for _ in 0..2 {
            assert!(rest(&links).succeeded().out.contains(": released"));
            await_servos(&bus, &free);
        }
        assert_eq!(bus.lock().strange, 0);
    }
    let bus = Bus::plugged_in("feetech-sts", &[1, 4]);
    let both = rest(&[link(Path::new("/dev/nothing"), "feetech-sts"), link(&bus.device, "feetech-sts")].concat());
    assert!(both.sentence(69).contains("/dev/nothing: there is no such"));
    assert!(both.out.contains(": released"), "what can be reached is released");
    eventually("a message to the servos", || !bus.lock().written.is_empty());
    assert_eq!(rest("").succeeded().out, "");
}

#[test]
fn servos_follow_a_face_and_a_line_that_was_unplugged_in_mid_move_begins_again_where_they_stand() {
    let (stable, bus) = (StablePath::new(), Bus::plugged_in("feetech-sts", &[1, 4]));
    symlink(&bus.device, stable.path()).unwrap();
    let service = Service::start(&[DEMO, &link(&stable.path(), "feetech-sts")].concat(), &[]);
    let moves = |bus: &Bus| {
        eventually("both servos", || bus.servos().iter().all(|(has_torque, _)| *has_torque));
        let before = bus.servos();
        eventually("the face", || bus.servos().iter().zip(&before).all(|(now, was)| (now.1 - was.1).abs() > 3.0));
    };
    moves(&bus);
    fs::remove_file(stable.path()).unwrap();
    let simulator = Arc::clone(&bus.simulator);
    drop(bus);
    service.await_log("went away");
    {
        let mut simulator = simulator.lock().unwrap();
        simulator.written.clear();
        // The motors stop in mid-move, so that each new goal can be compared with the place where its servo stands.
        simulator.servos.iter_mut().for_each(|servo| servo.motor = 0.0);
    }
    let bus = Bus::with(simulator);
    symlink(&bus.device, stable.path()).unwrap();
    for id in [1, 4] {
        let is_goal = |it: &&Written| it.id == id && it.first == 41;
        let first = || bus.lock().written.iter().find(is_goal).map(|it| (it.place - it.stood, it.speed));
        eventually("a goal", || first().is_some());
        // 60 degrees are 683 steps. The place that the service reads is a whole step.
        let (way, speed) = first().unwrap();
        assert!(way.abs() < 1.0 && (1.0..=683.0).contains(&speed), "{way} {speed}");
    }
    // The motors turn again.
    bus.lock().servos.iter_mut().for_each(|servo| servo.motor = 5000.0);
    moves(&bus);
}

#[test]
fn troubles_of_servos_are_told_once_with_what_to_do() {
    let bus = Bus::plugged_in("dynamixel-x", &[1]);
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("metrics");
    let metrics = format!("[metrics]\nlisten = \"unix:{}\"\n", socket.display());
    let service = Service::start(&[NO_CAMERA, &metrics, &link(&bus.device, "dynamixel-x")].concat(), &[]);
    service.await_log("servo 4: it does not answer: check its power and cable");
    await_servos(&bus, &[(true, 600.0)]);
    bus.lock().plug_in(4, Instant::now());
    await_servos(&bus, &[(true, 600.0), (true, 500.0)]);
    bus.lock().servos[0].alarms = 1 << 2;
    service.await_log("servo 1: it is too hot: cut its power");
    assert_eq!((service.logged("does not answer"), service.logged("too hot")), (1, 1));
    let told = page(&socket);
    for (metric, value) in [("volts", ["5", "5"]), ("celsius", ["30", "30"]), ("trouble", ["1", "0"])] {
        let shown = |id, value| format!("facewire_servo_{metric}{{link={:?},servo=\"{id}\"}} {value}\n", bus.device);
        assert!(told.contains(&shown(1, value[0])) && told.contains(&shown(4, value[1])), "{metric} in {told}");
    }
    drop(bus);
    eventually("no figures of servos that nobody reads", || !page(&socket).contains("facewire_servo_volts{"));
}

#[test]
fn the_load_of_a_servo_is_in_the_metrics_whatever_its_direction() {
    let (folder, buses) =
        (tempfile::tempdir().unwrap(), FAMILIES.iter().map(|(name, _)| Bus::plugged_in(name, &[1, 4])));
    let (socket, buses): (_, Vec<_>) = (folder.path().join("metrics"), buses.collect());
    let links: String = buses.iter().zip(FAMILIES).map(|(bus, (name, _))| link(&bus.device, name)).collect();
    let metrics = format!("[metrics]\nlisten = \"unix:{}\"\n", socket.display());
    let service = Service::start(&[NO_CAMERA, &metrics, &links].concat(), &[]);
    service.await_log("metrics at");
    // Bit 10 is the direction. An X has no load, and an SCS has its high byte first.
    let loads: [&[(usize, [u8; 2])]; 5] =
        [&[], &[(40, [0xFA, 0])], &[(40, [0xFA, 4])], &[(60, [0xFA, 4])], &[(60, [4, 0xFA])]];
    for (bus, load) in buses.iter().zip(loads) {
        load.iter().for_each(|(at, bytes)| bus.lock().servos[1].registers[*at..at + 2].copy_from_slice(bytes));
    }
    eventually("loads", || {
        let page = page(&socket);
        buses.iter().zip(loads).all(|(bus, load)| {
            let named = |metric| format!("facewire_servo_{metric}{{link={:?},servo=\"4\"}} ", bus.device);
            let has_load = page.contains(&(named("load_ratio") + "0.25\n"));
            page.contains(&named("volts")) && has_load != load.is_empty()
        })
    });
    assert_eq!(page(&socket).matches("facewire_servo_load_ratio{").count(), 2 * 4, "two servos of four families");
}

#[test]
fn keys_move_one_servo_from_where_it_stands_within_its_limits_and_its_lines_come_at_the_end() {
    // The highest place that the servo allows, and 60 degrees in steps.
    for (family, most, slow) in [("feetech-scs", 1003.0, 205.0), ("dynamixel-x", 4095.0, 683.0)] {
        let (bus, terminal) = (Bus::plugged_in(family, &[3]), Board::plugged_in());
        bus.lock().echoes = true;
        let port = terminal.port();
        fcntl_setfl(&port, rustix::fs::OFlags::empty()).unwrap();
        let end = || Stdio::from(port.try_clone().unwrap());
        let start = |id| {
            let bus = ["--bus", text(&bus.device), "--family", family, "--step", "100"];
            let command = &mut facewire(["servo", "--channel", id].into_iter().chain(bus));
            command.stdin(end()).stdout(end()).stderr(Stdio::piped()).spawn().unwrap()
        };
        for (id, alarms, want) in [("9", 0, "servo 9: it does not answer"), ("3", 1, "servo 3: its supply voltage")] {
            bus.lock().servos[0].alarms = alarms;
            let run = Run::ended(&start(id).wait_with_output().unwrap());
            assert!(run.status == Some(69) && run.err.contains(want), "{run:?}");
        }
        bus.lock().servos[0].alarms = 0;
        let mut child = start("3");
        let mut screen = String::new();
        let mut is_shown = |what: &str| {
            let mut bytes = [0; 4096];
            let length = (&terminal.master).read(&mut bytes).unwrap_or(0);
            screen += &String::from_utf8_lossy(&bytes[..length]);
            screen.contains(what)
        };
        let mut shows = |what: &str| eventually(what, || is_shown(what));
        shows(" 500 steps (no torque)");
        let press = |keys: &[&[u8]]| keys.iter().for_each(|key| (&terminal.master).write_all(key).unwrap());
        await_servos(&bus, &[(false, 500.0)]);
        press(&[b"\x1b[C", b"\x1b[C"]);
        await_servos(&bus, &[(true, 600.0)]);
        press(&[b"0"]);
        press(&[&b"\x1b[A"[..]; 8]);
        press(&[b"1"]);
        await_servos(&bus, &[(true, most)]);
        shows(&format!("1: {most}"));
        press(&[b"q"]);
        shows(&format!("position_at_0 = 600\r\nposition_at_1 = {most}\r\n"));
        eventually("the end", || child.try_wait().unwrap().is_some());
        await_servos(&bus, &[(false, most)]);
        let is_slow = |it: &Written| it.data.len() == 1 || (1.0..slow).contains(&it.speed);
        let bus = bus.lock();
        assert!(bus.written.iter().all(is_slow));
        // Until a key is pressed, the servo may be told again and again to have no torque.
        let mut told = bus.written.iter().filter(|it| it.first != 98).skip_while(|it| it.data == [0]);
        let [first, second] = [told.next(), told.next()].map(Option::unwrap);
        assert!(first.data.len() > 1 && second.data == [1], "a goal comes before the torque: {:?}", bus.written);
    }
}

#[test]
fn a_scan_lists_the_servos_of_a_line_and_moves_none() {
    for ((family, _), model) in FAMILIES.iter().zip([1200, 12, 29, 777, 1284]) {
        let bus = Bus::plugged_in(family, &[2, 5]);
        bus.lock().echoes = true;
        let mut command = facewire(["devices", "--scan", text(&bus.device)]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut progress = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        assert_eq!(progress.next().as_deref(), Some("facewire: searching at 1000000 baud by protocol 1.0"));
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap);
        for servo in ["servo 2", "servo 5"] {
            let line = lines.next().unwrap();
            let (found, place) = line.split_once(" at ").unwrap();
            assert_eq!(found, servo, "{line}");
            // A pseudo-terminal has no rate.
            assert!(place.ends_with(&format!(" baud: model {model}, family = \"{family}\"")), "{line}");
        }
        child.kill().and_then(|()| child.wait()).unwrap();
        assert!(bus.lock().written.is_empty() && bus.lock().strange == 0);
    }
}

#[test]
fn an_answer_that_an_adapter_holds_back_for_16_ms_is_awaited() {
    let bus = Bus::plugged_in("feetech-sts", &[1]);
    bus.lock().servos[0].answers_after = Some(Duration::from_millis(16));
    // On a busy machine the answer may come later than that.
    eventually("the servo", || {
        let mut command = facewire(["devices", "--scan", text(&bus.device)]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let progress = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
        // Each way of searching begins with a line. The servo speaks protocol 1.0, whose way is the first.
        assert!(progress.take(2).last().is_some());
        child.kill().and_then(|()| child.wait()).unwrap();
        io::read_to_string(child.stdout.take().unwrap()).unwrap().starts_with("servo 1 at ")
    });
}

#[test]
fn another_implementation_of_protocol_2_makes_the_same_frames_and_understands_the_answers() {
    let open =
        |device: &Path| dynamixel2::Bus::open_with_buffers(device, 57_600, vec![0; 2048], vec![0; 2048]).unwrap();
    let (board, mut random) = (Board::plugged_in(), fastrand::Rng::with_seed(2));
    let mut other = open(&board.device);
    // Unlike the maker's library, the other implementation takes no notice of a header behind another 0xFF.
    let mut bytes = || [[0xFF, 0xFF, 0xFD], [0xFD, 0, random.u8(..0xFF)], [0xFD, 0xFD, 0]][random.usize(..3)];
    for count in 1..=30 {
        let (mut ours, mut theirs) = (Vec::new(), Vec::<u8>::new());
        let goals: Vec<_> = (0..count).map(|id| (id, [(); 4].map(|()| bytes()).concat())).collect();
        FAMILIES[0].1.write_goals(&goals, &mut ours);
        other.sync_write(108, 12, goals.iter().map(|(id, data)| SyncWriteData { motor_id: *id, data })).unwrap();
        eventually("a frame", || {
            let mut bytes = [0; 2048];
            let length = (&board.master).read(&mut bytes).unwrap_or(0);
            theirs.extend(&bytes[..length]);
            theirs.len() >= ours.len()
        });
        assert_eq!(theirs, ours);
    }
    let bus = Bus::plugged_in("dynamixel-x", &[1]);
    bus.lock().servos[0].registers[150..154].copy_from_slice(&[0xFF, 0xFF, 0xFD, 0xFD]);
    let mut other = open(&bus.device);
    other.write_instruction(1, 2, 4, |parameters| parameters.copy_from_slice(&[148, 0, 6, 0])).unwrap();
    let status = other.read_status_response_deadline(Instant::now() + PATIENCE).unwrap();
    assert_eq!((status.packet_id(), status.parameters()), (1, &[0, 0, 0xFF, 0xFF, 0xFD, 0xFD][..]));
}

#[test]
fn the_lines_of_a_servo_whose_ends_were_found_load_as_settings() {
    for (kind, is_bus) in [("maestro", false), ("pca9685", false), ("bus-servo", true)] {
        let mut finder = Finder::new(1500.0, 100.0, [500.0, 2500.0], is_bus);
        for key in [Press::Move(5.0), Press::Neutral, Press::Move(5.0), Press::End(0), Press::Move(-5.0), Press::End(1)]
        {
            finder.press(key);
            let text = format!("[[link]]\nkind = \"{kind}\"\n{}", finder.lines(3));
            assert!(config::parse("test", &text).is_ok(), "{text}");
        }
    }
}
