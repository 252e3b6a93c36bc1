//! What receivers of other programs get, read by independent libraries.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

#[path = "../../tests/common/skip.rs"]
mod skip;

use std::fs::File;
use std::io::{Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use facewire_packet::formats::dmx::{ADDRESSES, Universe};
use facewire_packet::formats::vrchat::{Eyes, Form};
use facewire_packet::formats::{Dmx, LiveLink, Vmc, Vrchat};
use facewire_packet::{BLENDSHAPES, Packet, State};
use serde_json::{Value, json};
use skip::skip;

/// The Python with the libraries of the receivers, which `scripts/setup` has made.
fn python() -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))?;
    let python = cache.join("facewire/venv-tests/bin/python");
    let imported = Command::new(&python).args(["-c", "import pylivelinkface, pythonosc, sacn, stupidArtnet"]).output();
    if imported.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    skip("the Python libraries of receivers are not there: run scripts/setup tests");
    None
}

/// A file of this test.
fn tempfile(kind: &str) -> File {
    let name = format!("{kind}_{}", std::process::id());
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    File::options().read(true).write(true).create(true).truncate(true).open(path).unwrap()
}

/// What a library finds in each datagram.
fn decoded(kind: &str, datagrams: &[Vec<u8>]) -> Option<Vec<Value>> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/receivers.py");
    let hex = |bytes: &Vec<u8>| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let lines: String = datagrams.iter().map(|bytes| format!("{kind} {}\n", hex(bytes))).collect();
    let mut file = tempfile(kind);
    file.write_all(lines.as_bytes()).unwrap();
    file.rewind().unwrap();
    let output = Command::new(python()?).arg(script).stdin(file).stderr(Stdio::inherit()).output().unwrap();
    assert!(output.status.success());
    let lines = String::from_utf8(output.stdout).unwrap();
    Some(lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect())
}

fn face(look: &[(&str, f32)]) -> Packet {
    let mut packet = Packet { state: State::Live, rotation: [0.0, 0.258_819, 0.0, 0.965_926], ..Packet::NEUTRAL };
    for (name, value) in look {
        packet.coefficients[BLENDSHAPES.iter().position(|known| known == name).unwrap()] = *value;
    }
    packet
}

/// The messages that a library finds in the bundles of a format.
fn messages(encode: impl FnOnce(&mut dyn FnMut(&[u8]))) -> Option<Vec<Value>> {
    let mut bundles = Vec::new();
    encode(&mut |bytes| bundles.push(bytes.to_vec()));
    Some(decoded("osc", &bundles)?.iter().flat_map(|bundle| bundle.as_array().unwrap().clone()).collect())
}

/// Returns the arguments of the OSC message with this address whose first argument is `name`, or of the only one.
fn arguments<'a>(messages: &'a [Value], address: &str, name: Option<&str>) -> &'a [Value] {
    let is_meant = |message: &&Value| message[0] == address && name.is_none_or(|name| message[1] == name);
    &messages.iter().find(is_meant).unwrap_or_else(|| panic!("no {address} {name:?}")).as_array().unwrap()[1..]
}

#[test]
fn python_osc_reads_the_bundles_of_vmc_and_vrchat() {
    let packet = face(&[("jawOpen", 0.5), ("mouthLeft", 0.25)]);
    let Some(vmc) = messages(|send| Vmc::new(true, true).encode(&packet, std::time::Duration::ZERO, send)) else {
        return;
    };
    assert_eq!(arguments(&vmc, "/VMC/Ext/Blend/Val", Some("JawOpen"))[1], 0.5);
    assert_eq!(arguments(&vmc, "/VMC/Ext/Bone/Pos", Some("Head")).len(), 8);
    assert_eq!(arguments(&vmc, "/VMC/Ext/OK", None), [1, 3, 0, 1]);
    assert_eq!(vmc.last().unwrap()[0], "/VMC/Ext/Blend/Apply");
    assert_eq!(vmc.iter().filter(|message| message[0] == "/VMC/Ext/Blend/Val").count(), 52);
    let mut format = Vrchat::new("FT/", Eyes::Parameters, |_| Form { number: true, bits: 2 });
    let vrchat = messages(|send| format.encode(&packet, Duration::ZERO, send)).unwrap();
    assert_eq!(arguments(&vrchat, "/avatar/parameters/FT/v2/JawOpen", None), [0.5]);
    assert_eq!(arguments(&vrchat, "/avatar/parameters/FT/v2/JawOpen2", None), [true]);
    assert_eq!(arguments(&vrchat, "/avatar/parameters/FT/v2/MouthXNegative", None), [true]);
    assert_eq!(arguments(&vrchat, "/avatar/parameters/EyeTrackingActive", None), [true]);
}

#[test]
fn pylivelinkface_reads_the_datagrams_of_live_link() {
    let packet = face(&[("jawOpen", 0.5), ("eyeLookDownRight", 1.0)]);
    let mut bytes = Vec::new();
    LiveLink::new(&"d".repeat(36), "my face", false).encode(&packet, 0, &mut |sent| bytes.extend_from_slice(sent));
    let header = bytes[..1 + 4 + 36 + 4 + 7].to_vec();
    let Some(decoded) = decoded("live-link", &[bytes, header]) else { return };
    let [face, lost] = &decoded[..] else { panic!() };
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

/// A universe whose first and last values are this.
fn universe(value: u8) -> Universe {
    let mut values = [0; ADDRESSES];
    (values[0], values[ADDRESSES - 1]) = (value, value);
    values
}

/// Returns the datagrams for values that count from 0 to `last`, and for the end of the stream.
fn shown(format: &mut Dmx, last: u8) -> Vec<Vec<u8>> {
    let mut sent = Vec::new();
    for (time, value) in (0..=last).chain([last; 3]).enumerate() {
        let (is_last, now) = (time > usize::from(last), Duration::from_millis(25 * time as u64));
        format.encode(&universe(value), is_last, now, &mut |bytes| sent.push(bytes.to_vec()));
    }
    sent
}

/// Against the standard, this receiver also reads the values of datagrams that end a stream. They equal the last values.
#[test]
fn the_python_library_sacn_takes_every_change_in_order_and_sees_the_stream_end_and_begin_again() {
    let [mut one, mut restarted] = [(); 2].map(|()| Dmx::sacn([7; 16], "head", 150, 300));
    // The second run passes the last number.
    let datagrams = [shown(&mut one, 150), shown(&mut one, 200), shown(&mut restarted, 3)].concat();
    let Some(told) = decoded("sacn", &datagrams) else { return };
    let told: Vec<Value> = told.into_iter().flat_map(|told| told.as_array().unwrap().clone()).collect();
    let availability: Vec<&Value> = told.iter().filter(|it| it[1] == "available" || it[1] == "timeout").collect();
    let (comes, goes) = (json!([300, "available"]), json!([300, "timeout"]));
    assert_eq!(availability, [&comes, &goes, &goes, &goes].repeat(3));
    let values: Vec<Value> = told.iter().filter(|it| it[1] == "head").cloned().collect();
    let want = (0..=150).chain(0..=200).chain(0..=3).map(|value| json!([300, "head", 150, universe(value).to_vec()]));
    assert!(values == want.collect::<Vec<_>>(), "{} values", values.len());
}

/// The receiver drops datagrams numbered fewer than 20 below the last one: half a second at 40 a second, if a killed sender
/// starts again.
#[test]
fn the_python_library_sacn_takes_a_sender_that_was_killed_and_begins_again_from_its_21st_datagram_on_at_the_latest() {
    let cases = [(1, 0, 1), (2, 10, 11), (3, 19, 20), (4, 20, 0), (5, 200, 0)];
    let until = |universe, last: u8| {
        let mut sent = shown(&mut Dmx::sacn([7; 16], "head", 100, universe), last);
        sent.truncate(usize::from(last) + 1);
        sent
    };
    let datagrams = cases.map(|(universe, killed_at, _)| [until(universe, killed_at), until(universe, 60)].concat());
    let Some(told) = decoded("sacn", &datagrams.concat()) else { return };
    let mut told = told.iter();
    for (universe, killed_at, dropped) in cases {
        let before = told.by_ref().take(usize::from(killed_at) + 1);
        assert!(before.into_iter().all(|told| !told.as_array().unwrap().is_empty()));
        let again: Vec<_> = told.by_ref().take(61).collect();
        let is_taken = |told: &&Value| !told.as_array().unwrap().is_empty();
        assert_eq!(again.iter().position(is_taken), Some(dropped), "universe {universe}");
        assert!(again[dropped..].iter().all(is_taken), "universe {universe}");
    }
}

/// The receiver drops what is numbered as older than the last one by up to 128.
#[test]
fn the_python_library_stupidartnet_takes_every_datagram_also_of_a_sender_that_was_killed_and_begins_again() {
    let datagrams = [shown(&mut Dmx::art_net(300), 255), shown(&mut Dmx::art_net(300), 100)].concat();
    let killed = [&datagrams[..359], &datagrams[259..]].concat();
    let Some(values) = decoded("artnet", &killed) else { return };
    let want: Vec<Value> = killed.iter().map(|bytes| json!(bytes[18..])).collect();
    assert!(values == want, "{} values", values.len());
    let elsewhere = shown(&mut Dmx::art_net(44), 0).remove(0);
    assert_eq!(decoded("artnet", &[elsewhere]).unwrap(), [Value::Null], "another universe");
}
