//! What receivers of other programs get: decoded with libraries that are not ours, and with the frame that
//! `docs/receivers.md` shows in all formats.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::UdpSocket;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use common::program::Run;
use common::service::{Receiver, Service};
use facewire::capture::Clip;
use facewire::config::{self, Settings};
use facewire::link::{Link, Output, Pose, Traffic};
use facewire::pipeline::Pipeline;
use facewire::playback::Playback;
use facewire_face::HeadPose;
use facewire_packet::{BLENDSHAPES, Reason, State};
use rosc::{OscPacket, OscType};
use rustix::process::Signal;
use serde_json::Value;

/// The frame of the built-in clip that the document shows: its number, the head's rotation, and where the eyes look.
const FRAME: usize = 33;
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

/// A live output of this face.
fn output(rotation: [f32; 4], coefficients: &[(&str, f32)]) -> Output {
    let mut pose = Pose { rotation, ..Pose::NEUTRAL };
    for (name, value) in coefficients {
        pose.coefficients[BLENDSHAPES.iter().position(|known| known == name).unwrap()] = *value;
    }
    let (state, reason) = (State::Live, Reason::None);
    Output { state, reason, pose, age_us: 20_000, capture_us: 5_000_000, followed: true, moving: false }
}

/// Returns the datagrams of an output by a link with these settings, in which ADDRESS stands for the receiver's.
fn datagrams(keys: &str, output: &Output) -> Vec<Vec<u8>> {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let address = socket.local_addr().unwrap().to_string();
    let settings = config::parse("test", &format!("[[link]]\n{}", keys.replace("ADDRESS", &address))).unwrap();
    let traffic = Arc::<Traffic>::default();
    let mut link = Link::open(&settings.links[0], &traffic).unwrap();
    link.send_last(&settings.links[0], output);
    let receive = |_| {
        let mut bytes = vec![0; 2048];
        let length = socket.recv(&mut bytes).unwrap();
        bytes.truncate(length);
        bytes
    };
    (0..traffic.packets.load(Relaxed)).map(receive).collect()
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

/// Writes numbers with this many digits, separated by commas.
fn list(numbers: &[f32], digits: usize) -> String {
    let mut text = String::new();
    for (index, number) in numbers.iter().enumerate() {
        let comma = if index > 0 { ", " } else { "" };
        // Adding 0 turns -0 into 0.
        let scale = 10_f32.powi(i32::try_from(digits).unwrap());
        write!(text, "{comma}{:.digits$}", (number * scale).round() / scale + 0.0).unwrap();
    }
    text
}

/// A row of the table: the receiver, then head, left eye and right eye.
fn row(receiver: &str, cells: &[String; 3]) -> String {
    format!("| {receiver} | {} |", cells.join(" | "))
}

fn json_row(output: &Output) -> String {
    let line: Value = serde_json::from_slice(&datagrams("kind = \"json\"\nto = \"udp:ADDRESS\"", output)[0]).unwrap();
    let angles = |part: &Value, names: &[&str]| {
        let angles: Vec<f32> = names.iter().map(|name| part[*name].to_string().parse().unwrap()).collect();
        list(&angles, 1)
    };
    let [left, right] = ["left", "right"].map(|eye| angles(&line["gaze"][eye], &["yaw_deg", "pitch_deg"]));
    row("`json`", &[angles(&line["head"], &["yaw_deg", "pitch_deg", "roll_deg"]), left, right])
}

fn live_link_row(output: &Output) -> String {
    let bytes = datagrams("kind = \"live-link\"\naddress = \"ADDRESS\"", output).remove(0);
    let angles: Vec<f32> =
        bytes[bytes.len() - 36..].as_chunks().0.iter().map(|angle| f32::from_be_bytes(*angle)).collect();
    row("`live-link`", &[0, 3, 6].map(|first| list(&angles[first..first + 3], 3)))
}

fn vmc_row(output: &Output) -> String {
    let bones = osc("kind = \"vmc\"\naddress = \"ADDRESS\"", output);
    row("`vmc`", &["Head", "LeftEye", "RightEye"].map(|bone| list(&bones[bone][3..], 3)))
}

fn vrchat_rows(output: &Output) -> [String; 2] {
    let found = osc("kind = \"vrchat\"\naddress = \"ADDRESS\"\nnative_eyes = true", output);
    let numbers = |names: &[&str]| list(&names.iter().map(|name| found[*name][0]).collect::<Vec<_>>(), 3);
    let eyes = &found["/tracking/eye/LeftRightPitchYaw"];
    let head = numbers(&["Head/Yaw", "Head/Pitch", "Head/Roll"]);
    let [left, right] = [["EyeLeftX", "EyeLeftY"], ["EyeRightX", "EyeRightY"]].map(|names| numbers(&names));
    [
        row("`vrchat`", &[head, left, right]),
        row("`vrchat`, native eyes", &[String::new(), list(&eyes[..2], 1), list(&eyes[2..], 1)]).replace("|  |", "| |"),
    ]
}

fn ifacialmocap_row(output: &Output) -> String {
    let keys = "kind = \"ifacialmocap\"\nlisten = \"\"\naddress = \"ADDRESS\"";
    let frame = String::from_utf8(datagrams(keys, output).remove(0)).unwrap();
    let angles = |name: &str| {
        let numbers = frame.split_once(&format!("{name}#")).unwrap().1.split('|').next().unwrap();
        let angles: Vec<f32> = numbers.split(',').take(3).map(|angle| angle.parse().unwrap()).collect();
        list(&angles, 1)
    };
    row("`ifacialmocap`", &["head", "leftEye", "rightEye"].map(angles))
}

#[test]
fn the_document_shows_the_recorded_frame_in_every_format() {
    let output = output(ROTATION, &LOOK);
    let [vrchat, native] = vrchat_rows(&output);
    let rows = [json_row(&output), live_link_row(&output), vmc_row(&output), vrchat, native, ifacialmocap_row(&output)];
    let document = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/receivers.md");
    let document = std::fs::read_to_string(document).unwrap();
    let missing: Vec<_> =
        rows.iter().filter(|row| !document.lines().any(|line| line.starts_with(row.as_str()))).collect();
    assert!(missing.is_empty(), "docs/receivers.md lacks\n{missing:#?}");
}

#[test]
fn the_recorded_frame_is_the_one_of_the_built_in_clip() {
    let settings = Settings::default();
    let Ok(pipeline) = Pipeline::load(&settings) else {
        common::skip("there are no networks: run scripts/setup");
        return;
    };
    let (mut playback, mut clip) = (Playback::new(pipeline, &settings.failsafe), Clip::once().unwrap());
    let mut pose = None;
    for _ in 0..=FRAME {
        let face = playback.find(&mut clip).unwrap().unwrap();
        pose = Some(playback.show(&face).pose);
    }
    let pose = pose.unwrap();
    let angles = |rotation| {
        let head = HeadPose::from_rotation(rotation, [0.0; 3]);
        head.yaw_pitch_roll_deg()
    };
    for (recorded, now) in angles(ROTATION).into_iter().zip(angles(pose.rotation)) {
        assert!((recorded - now).abs() < 0.5, "{recorded} {now}: {:?}", pose.rotation);
    }
    let recorded = output(ROTATION, &LOOK).pose;
    for (name, _) in LOOK {
        let place = BLENDSHAPES.iter().position(|known| *known == name).unwrap();
        let [recorded, now] = [recorded, pose].map(|pose| pose.coefficients[place]);
        assert!((recorded - now).abs() < 0.02, "{name} {recorded} {now}");
    }
}

/// Decodes datagrams with the Python libraries of the receivers: what it finds in each, as JSON.
fn decoded(python: &Path, datagrams: &[(&str, Vec<u8>)]) -> Vec<Value> {
    let mut lines = String::new();
    for (kind, bytes) in datagrams {
        write!(lines, "{kind} ").unwrap();
        for byte in bytes {
            write!(lines, "{byte:02x}").unwrap();
        }
        lines.push('\n');
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/receivers.py");
    let run = Run::fed(Command::new(python).arg(script), lines.as_bytes()).succeeded();
    run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Returns the Python with the libraries, or skips the test.
fn python() -> Option<std::path::PathBuf> {
    let python = common::python_with("pythonosc, pylivelinkface");
    if python.is_none() {
        common::skip("there is no python-osc or PyLiveLinkFace: run scripts/setup tests");
    }
    python
}

/// Returns the arguments of the OSC message with this address whose first argument is `name`, or of the only one.
fn arguments<'a>(messages: &'a [Value], address: &str, name: Option<&str>) -> &'a [Value] {
    let is_meant = |message: &&Value| message[0] == address && name.is_none_or(|name| message[1] == name);
    &messages.iter().find(is_meant).unwrap_or_else(|| panic!("no {address} {name:?}")).as_array().unwrap()[1..]
}

#[test]
fn python_osc_reads_the_bundles_of_vmc_and_vrchat() {
    let Some(python) = python() else { return };
    let output = output(ROTATION, &[("jawOpen", 0.5), ("mouthLeft", 0.25)]);
    let read = |keys: &str| {
        let datagrams: Vec<_> = datagrams(keys, &output).into_iter().map(|bytes| ("osc", bytes)).collect();
        let bundles = decoded(&python, &datagrams);
        bundles.iter().flat_map(|bundle| bundle.as_array().unwrap().clone()).collect::<Vec<_>>()
    };
    let vmc = read("kind = \"vmc\"\naddress = \"ADDRESS\"");
    assert_eq!(arguments(&vmc, "/VMC/Ext/Blend/Val", Some("JawOpen"))[1], 0.5);
    assert_eq!(arguments(&vmc, "/VMC/Ext/Bone/Pos", Some("Head")).len(), 8);
    assert_eq!(arguments(&vmc, "/VMC/Ext/OK", None), [1, 3, 0, 1]);
    assert_eq!(vmc.last().unwrap()[0], "/VMC/Ext/Blend/Apply");
    assert_eq!(vmc.iter().filter(|message| message[0] == "/VMC/Ext/Blend/Val").count(), 52);
    let vrchat = read("kind = \"vrchat\"\naddress = \"ADDRESS\"\nbits = 2\nprefix = \"FT/\"");
    assert_eq!(arguments(&vrchat, "/avatar/parameters/FT/v2/JawOpen", None), [0.5]);
    assert_eq!(arguments(&vrchat, "/avatar/parameters/FT/v2/JawOpen2", None), [true]);
    assert_eq!(arguments(&vrchat, "/avatar/parameters/FT/v2/MouthXNegative", None), [true]);
    assert_eq!(arguments(&vrchat, "/avatar/parameters/EyeTrackingActive", None), [true]);
}

#[test]
fn pylivelinkface_reads_the_datagrams_of_live_link() {
    let Some(python) = python() else { return };
    let output = output([0.0, 0.258_819, 0.0, 0.965_926], &[("jawOpen", 0.5), ("eyeLookDownRight", 1.0)]);
    let bytes = datagrams("kind = \"live-link\"\naddress = \"ADDRESS\"\nsubject = \"my face\"", &output).remove(0);
    let header = bytes[..1 + 4 + 36 + 4 + 7].to_vec();
    let [face, lost] = &decoded(&python, &[("live-link", bytes), ("live-link", header)])[..] else { panic!() };
    assert_eq!((&face["subject"], &face["fps"]), (&Value::from("my face"), &Value::from(60)));
    let value = |name: &str| face["values"][name].as_f64().unwrap();
    let near = |name, want: f64| assert!((value(name) - want).abs() < 1e-4, "{name} {}", value(name));
    near("JawOpen", 0.5);
    near("HeadYaw", -30_f64.to_radians());
    near("RightEyePitch", 35_f64.to_radians());
    near("LeftEyePitch", 0.0);
    assert_eq!(face["values"].as_object().unwrap().len(), 61);
    assert_eq!(lost, &Value::Null, "a datagram that ends after the name has no face");
}

/// Returns datagrams that reach the socket while the face is live.
fn take(socket: &UdpSocket, count: usize) -> Vec<Vec<u8>> {
    let mut bytes = [0; 2048];
    (0..count).map(|_| socket.recv(&mut bytes).map(|length| bytes[..length].to_vec()).unwrap()).collect()
}

/// Nobody reads the standard output while the service runs.
#[test]
fn a_running_service_serves_every_receiver_and_a_standard_output_that_nobody_reads_delays_none() {
    let Some(python) = python() else { return };
    let sockets = [(); 2].map(|()| {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        socket
    });
    let [live_link, vmc] = sockets.each_ref().map(|socket| socket.local_addr().unwrap());
    let others = format!(
        "[[link]]\nkind = \"live-link\"\naddress = \"{live_link}\"\n[[link]]\nkind = \"vmc\"\naddress = \"{vmc}\"\n\
         [[link]]\nkind = \"json\"\npace = \"rate\"\nrate_hz = 240\n"
    );
    let receiver = Receiver::new();
    let service = Service::start(&format!("[camera]\ndevice = \"demo\"\n{others}"), &[receiver.address()]);
    receiver.until(|packet| packet.state == State::Live);
    // By now, a pipe is full.
    (0..150).for_each(|_| _ = receiver.packet());
    let datagrams: Vec<_> = take(&sockets[0], 100).into_iter().map(|bytes| ("live-link", bytes)).collect();
    let largest = |values: &Value| values.as_object().unwrap().values().filter_map(Value::as_f64).fold(0.0, f64::max);
    let faces = decoded(&python, &datagrams);
    assert!(faces.iter().any(|face| largest(&face["values"]) > 0.1), "the face does not move");
    let bundles: Vec<_> = take(&sockets[1], 30).into_iter().map(|bytes| ("osc", bytes)).collect();
    let messages: Vec<Value> =
        decoded(&python, &bundles).into_iter().flat_map(|bundle| bundle.as_array().unwrap().clone()).collect();
    assert!(messages.iter().any(|message| message[0] == "/VMC/Ext/Blend/Apply"));
    let (run, _) = service.stop(Signal::TERM);
    let run = run.succeeded();
    assert!(run.err.contains("INFO") && !run.out.contains("INFO"), "the log goes to standard error");
    let lines: Vec<Value> = run.out.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    assert!(lines.len() > 20 && lines.len() + 1 >= run.out.lines().count(), "{} lines", lines.len());
    assert!(lines.iter().all(|line| line["coefficients"].as_object().unwrap().len() == BLENDSHAPES.len()));
}
