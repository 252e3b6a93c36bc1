//! What receivers of other programs get: decoded with libraries that are not ours, and with the frame that
//! `docs/receivers.md` shows in all formats.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

use common::board::Board;
use common::ports::udp_port_of;
use common::program::{Run, text};
use common::service::{DEMO, NO_CAMERA, Receiver, Service};
use common::{PATIENCE, eventually, project, python_with, skip};
use facewire::config;
use facewire::link::{Link, Output, Traffic};
use facewire_packet::{BLENDSHAPES, Packet, Pose, Reason, State};
use rosc::{OscPacket, OscType};
use rustix::io::ioctl_fionread;
use rustix::process::Signal;
use serde_json::Value;

/// Frame 33 of the built-in clip, which the document shows: the head's rotation, and where the eyes look.
const ROTATION: [f32; 4] = [0.054_423, 0.119_717, 0.035_425, 0.990_682];
const LOOK: [(&str, f32); 8] = [
    ("eyeLookDownLeft", 0.235),
    ("eyeLookInLeft", 0.041),
    ("eyeLookOutLeft", 0.923),
    ("eyeLookUpLeft", 0.055),
    ("eyeLookDownRight", 0.233),
    ("eyeLookInRight", 0.920),
    ("eyeLookOutRight", 0.001),
    ("eyeLookUpRight", 0.055),
];

fn output(rotation: [f32; 4], coefficients: &[(&str, f32)]) -> Output {
    let mut pose = Pose { rotation, ..Pose::NEUTRAL };
    for (name, value) in coefficients {
        pose.coefficients[BLENDSHAPES.iter().position(|known| known == name).unwrap()] = *value;
    }
    let (state, reason) = (State::Live, Reason::None);
    Output {
        state,
        reason,
        pose,
        age_us: 20_000,
        capture_us: 5_000_000,
        followed: true,
        moving: false,
        is_puppet: false,
    }
}

/// Returns the datagrams of an output by a link with these settings, in which ADDRESS stands for the receiver's.
fn datagrams(keys: &str, output: &Output) -> Vec<Vec<u8>> {
    let receiver = Receiver::new();
    let keys = keys.replace("ADDRESS", &receiver.address());
    let settings = config::parse("test", &format!("[[link]]\n{keys}")).unwrap();
    let traffic = Arc::<Traffic>::default();
    let mut link = Link::open(&settings.links[0], &traffic).unwrap();
    link.send_last(&settings.links[0], output);
    (0..traffic.packets.load(Relaxed)).map(|_| receiver.datagram()).collect()
}

/// The numbers of every OSC message, by its address or by the name that it begins with.
fn osc(keys: &str, output: &Output) -> BTreeMap<String, Vec<f32>> {
    let mut found = BTreeMap::new();
    for datagram in datagrams(keys, output) {
        let (_, OscPacket::Bundle(bundle)) = rosc::decoder::decode_udp(&datagram).unwrap() else { panic!("no bundle") };
        for packet in bundle.content {
            let OscPacket::Message(message) = packet else { panic!("no message") };
            let name = match message.args.first() {
                Some(OscType::String(name)) => name.clone(),
                _ => message.addr.rsplit("v2/").next().unwrap().to_owned(),
            };
            found.insert(name, message.args.into_iter().filter_map(OscType::float).collect());
        }
    }
    found
}

/// Writes numbers with this many digits, separated by commas. Adding 0 turns -0 into 0.
fn list(numbers: &[f32], digits: usize) -> String {
    let scale = 10_f32.powi(i32::try_from(digits).unwrap());
    let texts = numbers.iter().map(|number| format!("{:.digits$}", (number * scale).round() / scale + 0.0));
    texts.collect::<Vec<_>>().join(", ")
}

/// The document has a row for each format: the receiver, then head, left eye and right eye.
#[test]
fn the_document_shows_the_recorded_frame_in_every_format() {
    let output = output(ROTATION, &LOOK);
    let keys = "kind = \"json\"\nto = \"udp:ADDRESS\"";
    let json: Value = serde_json::from_slice(&datagrams(keys, &output)[0]).unwrap();
    let of_json = |part: &str, names: &[&str]| {
        let angle = |name: &&str| json.pointer(&format!("{part}/{name}_deg")).unwrap().to_string().parse().unwrap();
        list(&names.iter().map(angle).collect::<Vec<f32>>(), 1)
    };
    let eyes = ["/gaze/left", "/gaze/right"].map(|eye| of_json(eye, &["yaw", "pitch"]));

    let bytes = datagrams("kind = \"live-link\"\naddress = \"ADDRESS\"", &output).remove(0);
    let angles = bytes[bytes.len() - 36..].as_chunks().0;
    let live_link: Vec<f32> = angles.iter().map(|angle| f32::from_be_bytes(*angle)).collect();

    let bones = osc("kind = \"vmc\"\naddress = \"ADDRESS\"", &output);
    let found = osc("kind = \"vrchat\"\naddress = \"ADDRESS\"\nnative_eyes = true", &output);
    let vrchat = |names: &[&str]| list(&names.iter().map(|name| found[*name][0]).collect::<Vec<_>>(), 3);
    let native = &found["/tracking/eye/LeftRightPitchYaw"];

    let keys = "kind = \"ifacialmocap\"\nlisten = \"\"\naddress = \"ADDRESS\"";
    let frame = String::from_utf8(datagrams(keys, &output).remove(0)).unwrap();
    let ifacialmocap = |name: &str| {
        let numbers = frame.split_once(&format!("{name}#")).unwrap().1.split('|').next().unwrap();
        list(&numbers.split(',').take(3).map(|angle| angle.parse().unwrap()).collect::<Vec<f32>>(), 1)
    };
    let rows = [
        ("`json`", [of_json("/head", &["yaw", "pitch", "roll"])].into_iter().chain(eyes).collect::<Vec<_>>()),
        ("`live-link`", [0, 3, 6].map(|first| list(&live_link[first..first + 3], 3)).to_vec()),
        ("`vmc`", ["Head", "LeftEye", "RightEye"].map(|bone| list(&bones[bone][3..], 3)).to_vec()),
        (
            "`vrchat`",
            [&["Head/Yaw", "Head/Pitch", "Head/Roll"][..], &["EyeLeftX", "EyeLeftY"], &["EyeRightX", "EyeRightY"]]
                .map(vrchat)
                .to_vec(),
        ),
        ("`vrchat`, native eyes |", vec![list(&native[..2], 1), list(&native[2..], 1)]),
        ("`ifacialmocap`", ["head", "leftEye", "rightEye"].map(ifacialmocap).to_vec()),
    ];
    let document = std::fs::read_to_string(project("docs/receivers.md")).unwrap();
    for (receiver, cells) in rows {
        let row = format!("| {receiver} | {} |", cells.join(" | "));
        assert!(document.lines().any(|line| line.starts_with(&row)), "docs/receivers.md lacks {row}");
    }
}

/// Decodes datagrams with the Python libraries of the receivers: what it finds in each, as JSON.
fn decoded(python: &Path, kind: &str, datagrams: &[Vec<u8>]) -> Vec<Value> {
    let hex = |bytes: &Vec<u8>| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let lines: String = datagrams.iter().map(|bytes| format!("{kind} {}\n", hex(bytes))).collect();
    let run = Run::fed(Command::new(python).arg(project("tests/receivers.py")), lines.as_bytes()).succeeded();
    run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn messages(python: &Path, bundles: &[Vec<u8>]) -> Vec<Value> {
    decoded(python, "osc", bundles).iter().flat_map(|bundle| bundle.as_array().unwrap().clone()).collect()
}

fn python() -> Option<PathBuf> {
    let python = python_with("venv-tests", "pythonosc, pylivelinkface");
    if python.is_none() {
        skip("there is no python-osc or PyLiveLinkFace: run scripts/setup tests");
    }
    python
}

/// Nobody reads the standard output while the service runs.
#[test]
fn a_running_service_serves_every_receiver_and_a_standard_output_that_nobody_reads_delays_none() {
    let Some(python) = python() else { return };
    let [live_link, vmc] = [Receiver::new(), Receiver::new()];
    let others = [
        format!("[[link]]\nkind = \"live-link\"\naddress = \"{}\"\n", live_link.address()),
        format!("[[link]]\nkind = \"vmc\"\naddress = \"{}\"\n", vmc.address()),
        "[[link]]\nkind = \"json\"\npace = \"rate\"\nrate_hz = 240\n".to_owned(),
    ];
    let (service, receiver) = Service::live(&[DEMO, &others.concat()].concat());
    // A pipe has sixteen pages, of which each holds two lines.
    let pipe = service.child.stdout.as_ref().unwrap();
    eventually("a full pipe", || ioctl_fionread(pipe).unwrap() > 40_000);
    receiver.rest();
    receiver.live_packets(30);
    let datagrams: Vec<_> = (0..100).map(|_| live_link.datagram()).collect();
    // The first datagrams may have no face and therefore no values.
    let largest = |values: &Value| {
        let values = values.as_object().into_iter().flat_map(serde_json::Map::values);
        values.filter_map(Value::as_f64).fold(0.0, f64::max)
    };
    let faces = decoded(&python, "live-link", &datagrams);
    assert!(faces.iter().any(|face| largest(&face["values"]) > 0.1), "the face does not move");
    let bundles: Vec<_> = (0..30).map(|_| vmc.datagram()).collect();
    assert!(messages(&python, &bundles).iter().any(|message| message[0] == "/VMC/Ext/Blend/Apply"));
    let run = service.stop(Signal::TERM).succeeded();
    assert!(run.err.contains("INFO") && !run.out.contains("INFO"), "the log goes to standard error");
    let lines: Vec<Value> = run.out.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    assert!(lines.len() > 20 && lines.len() + 1 >= run.out.lines().count(), "{} lines", lines.len());
    for line in &lines {
        assert_eq!(line["coefficients"].as_object().map(serde_json::Map::len), Some(BLENDSHAPES.len()), "{line}");
    }
}

/// The values of a universe and whether its datagram ends the stream, by the layouts of both protocols.
fn values(datagram: &[u8]) -> (&[u8], bool) {
    if datagram.starts_with(b"Art-Net") { (&datagram[18..], false) } else { (&datagram[126..], datagram[112] == 0x40) }
}

/// The datagrams that have come and were not taken yet.
fn waiting(node: &Receiver) -> Vec<Vec<u8>> {
    node.0.set_nonblocking(true).unwrap();
    let mut bytes = [0; 1024];
    let waiting = std::iter::from_fn(|| node.0.recv(&mut bytes).ok().map(|length| bytes[..length].to_vec())).collect();
    node.0.set_nonblocking(false).unwrap();
    waiting
}

#[test]
fn a_universe_is_sent_seldom_while_nothing_moves_and_at_most_44_times_a_second_and_it_ends_with_the_service() {
    let nodes = [Receiver::new(), Receiver::new()];
    let link = |kind, node: &Receiver| format!("[[link]]\nkind = \"{kind}\"\naddress = \"{}\"\n", node.address());
    let links = link("sacn", &nodes[0]) + &link("artnet", &nodes[1]);
    let (service, live) = Service::with_receiver(&[NO_CAMERA, &links].concat());
    // The first four follow each other at once. A busy machine can only lengthen the times from then on.
    (0..4).for_each(|_| drop(nodes.each_ref().map(Receiver::datagram)));
    let begun = Instant::now();
    nodes.iter().for_each(|node| drop(waiting(node)));
    (0..3).for_each(|_| assert_eq!(nodes.each_ref().map(|node| values(&node.datagram()).0[0]), [1; 2]));
    assert!(begun.elapsed().as_secs_f64() > 1.2, "{:?}", begun.elapsed());
    service.reload(&[DEMO, &links].concat());
    live.live();
    let begun = Instant::now();
    nodes.iter().for_each(|node| drop(waiting(node)));
    let moving: Vec<_> = (0..60).flat_map(|_| nodes.each_ref().map(Receiver::datagram)).collect();
    // The first one may have been late, while the others keep the grid of the rate.
    assert!(begun.elapsed().as_secs_f64() > 58.0 / 44.0, "{:?}", begun.elapsed());
    assert!(moving.iter().any(|bytes| values(bytes).0[..52].iter().any(|value| *value > 25)), "the face does not move");
    service.stop(Signal::TERM);
    for (node, ends) in nodes.iter().zip([3, 0]) {
        let rest = waiting(node);
        assert_eq!(rest.iter().filter(|bytes| values(bytes).1).count(), ends);
        assert!(values(rest.last().unwrap()).0[..52] == [1; 52], "the neutral face is last");
    }
}

/// What `packet/python/receiver.py` shows: whether packets come, jaw, left lid, and the rotation of the head.
#[derive(Debug)]
struct Shown {
    is_live: bool,
    values: Vec<f32>,
}

impl Shown {
    fn is_neutral(&self) -> bool {
        self.values == [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    }
}

/// The running `packet/python/receiver.py`. It is killed when the test ends.
struct PythonReceiver {
    child: Child,
    lines: Box<dyn Iterator<Item = String>>,
}

impl PythonReceiver {
    fn start(python: &Path, arguments: &[&str]) -> Self {
        let mut command = Command::new(python);
        command.arg(project("packet/python/receiver.py")).args(arguments).env("PYTHONDONTWRITEBYTECODE", "1");
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = Box::new(BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap));
        let mut receiver = Self { child, lines };
        assert!(receiver.until(|_| true)[0].is_neutral());
        receiver
    }

    /// Reads what is shown up to the first that is wanted, and returns all of it.
    fn until(&mut self, wanted: impl Fn(&Shown) -> bool) -> Vec<Shown> {
        let begun = Instant::now();
        let mut shown: Vec<Shown> = Vec::new();
        while !shown.last().is_some_and(&wanted) {
            assert!(begun.elapsed() < PATIENCE, "{:?}", shown.last());
            let line = self.lines.next().unwrap();
            let (state, values) = line.split_once(' ').unwrap();
            let values = values.split(' ').map(|value| value.parse().unwrap()).collect();
            shown.push(Shown { is_live: state == "live", values });
        }
        shown
    }
}

impl Drop for PythonReceiver {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

#[test]
fn by_udp_the_face_of_the_python_receiver_moves_and_is_neutral_after_the_program_was_killed() {
    let mut receiver = PythonReceiver::start(Path::new("python3"), &["--host", "127.0.0.1", "--port", "0"]);
    let service = Service::start(DEMO, &[format!("127.0.0.1:{}", udp_port_of(receiver.child.id()))]);
    receiver.until(|shown| shown.is_live && shown.values[0] > 0.2);
    service.stop(Signal::KILL);
    let shown = receiver.until(|shown| !shown.is_live && shown.is_neutral());
    let falls = shown.iter().filter(|shown| !shown.is_live).collect::<Vec<_>>();
    assert!(falls.is_sorted_by(|before, after| before.values[0] >= after.values[0]), "{falls:?}");
}

#[test]
fn by_a_serial_line_the_face_of_the_python_receiver_moves_whatever_else_is_on_the_line() {
    let Some(python) = python_with("venv-tests", "serial") else {
        return skip("there is no pyserial: run scripts/setup tests");
    };
    let board = Board::plugged_in();
    let mut receiver = PythonReceiver::start(&python, &["--serial", text(&board.device)]);
    let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
    packet.coefficients[17] = 0.75;
    board.send(b"Booting\r\n");
    while (receiver.until(|_| true)[0].values[0] - 0.75).abs() > 1e-3 {
        packet.sequence += 1;
        board.send(&packet.encode_frame());
    }
    receiver.until(|shown| !shown.is_live && shown.is_neutral());
}
