//! What CycloneDDS, another implementation of DDS, reads as a subscriber of ROS 2 would.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{collections::HashMap, env, fs::File, time::Duration};

use common::{Board, Bridge, Program, SETUP, eventually, listener, python, sending};
use facewire_packet::BLENDSHAPES;
use serde_json::Value;

/// A domain that no other test uses at the same time, in this process or in another: each has a file that its test locks.
struct Domain {
    number: String,
    _lock: File,
}

impl Domain {
    fn new() -> Self {
        // The ports of higher domains are among those that the system gives to any program.
        let taken = (1..=100).find_map(|number| {
            let path = env::temp_dir().join(format!("facewire-ros-domain-{number}"));
            // The file of another user cannot be opened.
            let lock = File::options().append(true).create(true).open(path).ok()?;
            lock.try_lock().ok()?;
            Some(Self { number: number.to_string(), _lock: lock })
        });
        taken.unwrap()
    }
}

/// Waits for a sample that this accepts.
fn sample(listener: &mut Program, what: &str, accepts: impl Fn(&Value) -> bool) -> Value {
    listener.wait_for(what, |line| {
        let (_, sample): (String, Value) = serde_json::from_str(line).ok()?;
        accepts(&sample).then_some(sample)
    })
}

/// A bridge with one board, left, and what Python needs to listen.
fn with_left(arguments: &[&str]) -> Option<(impl Fn(&str, &str) -> Program + use<>, Bridge, Board)> {
    let python = python("cyclonedds", SETUP)?;
    let domain = Domain::new();
    let ros = ["--ros", "--ros-domain", &domain.number, "--board", "left=127.0.1.1"];
    let bridge = Bridge::start(&[&ros, arguments].concat());
    let mut left = bridge.board(1);
    left.set("jawOpen", 0.25);
    left.packet.position_mm = [100.0, -50.0, 600.0];
    let listen = move |kind: &str, topic: &str| listener(&python, &["dds", &domain.number, kind, topic]);
    Some((listen, bridge, left))
}

#[test]
fn cyclonedds_reads_the_coefficients_by_arkits_names_and_in_silence_they_go_to_neutral() {
    let Some((listen, _bridge, left)) = with_left(&[]) else { return };
    let guard = sending(vec![left]);
    let mut blendshapes = listen("sensor_msgs/JointState", "/facewire/left/blendshapes");
    let jaw = |joints: &Value| joints["position"][17].as_f64().unwrap();
    let joints = sample(&mut blendshapes, "an open jaw", |joints| (jaw(joints) - 0.25).abs() < 1e-4);
    assert_eq!(joints["name"], serde_json::json!(BLENDSHAPES.as_slice()));
    assert_eq!(joints["position"].as_array().unwrap().len(), 52);
    assert_eq!(joints["header"]["frame_id"], "left_camera_optical_frame");
    drop(guard);
    sample(&mut blendshapes, "a closed jaw", |joints| jaw(joints) == 0.0);
    // On a busy machine, the bridge may read the last packets only after it has found the board silent.
    eventually("that the topic rests", || {
        blendshapes.seen.clear();
        blendshapes.read_for(Duration::from_millis(500));
        blendshapes.seen.is_empty()
    });
}

#[test]
fn cyclonedds_reads_the_pose_and_the_transform_of_the_head_with_rep_103s_axes() {
    let Some((listen, _bridge, left)) = with_left(&[]) else { return };
    let _guard = sending(vec![left]);
    let place = |of: &Value| ["x", "y", "z"].map(|axis| of[axis].as_f64().unwrap());
    let turn = |of: &Value| ["x", "y", "z", "w"].map(|axis| of[axis].as_f64().unwrap());
    let facing =
        |of: [f64; 4]| of.iter().zip([0.5, 0.5, -0.5, 0.5]).all(|(is, want): (_, f64)| (is - want).abs() < 1e-3);
    let pose = sample(&mut listen("geometry_msgs/PoseStamped", "/facewire/left/head_pose"), "a pose", |_| true);
    assert_eq!(place(&pose["pose"]["position"]), [0.1, -0.05, 0.6]);
    assert!(facing(turn(&pose["pose"]["orientation"])), "{pose}");
    let transforms = sample(&mut listen("tf2_msgs/TFMessage", "/tf"), "a transform", |_| true);
    let head = &transforms["transforms"][0];
    assert_eq!(
        (&head["child_frame_id"], &head["header"]["frame_id"]),
        (&"left_head".into(), &"left_camera_optical_frame".into())
    );
    assert_eq!(place(&head["transform"]["translation"]), [0.1, -0.05, 0.6]);
    assert!(facing(turn(&head["transform"]["rotation"])), "{head}");
}

#[test]
fn who_comes_late_learns_whether_there_is_a_face_and_sigterm_says_that_there_is_none() {
    let Some((listen, mut bridge, left)) = with_left(&[]) else { return };
    let mut face = listen("std_msgs/Bool", "/facewire/left/face");
    let guard = sending(vec![left]);
    sample(&mut face, "a face", |face| face["data"] == true);
    drop(guard);
    bridge.reads_all();
    // Diagnostics are not retained: a late subscriber does not get earlier ones.
    let mut diagnostics = listen("diagnostic_msgs/DiagnosticArray", "/diagnostics");
    sample(&mut diagnostics, "that the board is away", |report| report["status"][0]["level"] == 3);
    let mut late = listen("std_msgs/Bool", "/facewire/left/face");
    // RustDDS removes former states only every 6 s. Those that it still has come first.
    sample(&mut late, "that there is no face", |face| face["data"] == false);
    let _guard = sending(vec![bridge.board(1)]);
    sample(&mut late, "a face again", |face| face["data"] == true);
    bridge.program.signal("TERM");
    sample(&mut late, "no face", |face| face["data"] == false);
    assert!(bridge.program.ends().success());
}

#[test]
fn diagnostics_tell_of_each_board_and_of_what_was_refused() {
    let Some((listen, bridge, mut left)) = with_left(&[]) else { return };
    left.packet.visibility.mouth = 0.4;
    let mut diagnostics = listen("diagnostic_msgs/DiagnosticArray", "/diagnostics");
    let level = |report: &Value, at: usize| report["status"][at]["level"].as_u64();
    sample(&mut diagnostics, "a silent board", |report| level(report, 0) == Some(3));
    bridge.board(7).send();
    let _guard = sending(vec![left]);
    let report =
        sample(&mut diagnostics, "a live board", |report| level(report, 0) == Some(0) && level(report, 1) == Some(1));
    assert_eq!(
        (&report["status"][0]["name"], &report["status"][0]["hardware_id"]),
        (&"facewire left".into(), &"127.0.1.1".into())
    );
    assert_eq!(report["status"][0]["values"][4], serde_json::json!({"key": "covered", "value": "mouth"}));
    assert_eq!(report["status"][1]["values"][0], serde_json::json!({"key": "strangers", "value": "1"}));
}

#[test]
fn action_units_are_published_for_ros4hri_if_they_are_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("bridge.toml");
    std::fs::write(&settings, "[ros]\naction_units = true\n").unwrap();
    let Some((listen, _bridge, left)) = with_left(&["--config", settings.to_str().unwrap()]) else { return };
    let _guard = sending(vec![left]);
    let mut tracked = listen("hri_msgs/IdsList", "/humans/faces/tracked");
    sample(&mut tracked, "a face", |faces| faces["ids"] == serde_json::json!(["f0000"]));
    let mut units = listen("hri_msgs/FacialActionUnits", "/humans/faces/f0000/facs");
    let jaw = |units: &Value| units["intensity"][26].as_f64().unwrap();
    let units = sample(&mut units, "an open jaw", |units| (jaw(units) - 0.25).abs() < 1e-4);
    assert_eq!((&units["confidence"][26], &units["confidence"][25]), (&1.0.into(), &0.0.into()));
}

/// ROS 2 reads the hash of a type in the user data of writers. RustDDS 0.15 reads user data, but cannot write any. Once it can,
/// this test fails: then write the hashes, and test that they come.
#[test]
fn until_rustdds_writes_user_data_writers_are_found_without_the_hashes_of_their_types() {
    let Some(python) = python("cyclonedds", SETUP) else { return };
    let domain = Domain::new();
    let _bridge = Bridge::start(&["--ros", "--ros-domain", &domain.number]);
    let mut writers = listener(&python, &["writers", &domain.number]);
    let mut found: HashMap<String, String> = HashMap::new();
    while !["own", "rt/tf"].iter().all(|topic| found.contains_key(*topic)) {
        let (topic, user_data) = writers.wait_for("a writer", |line| serde_json::from_str(line).ok());
        found.insert(topic, user_data);
    }
    // CycloneDDS writes user data, and the listener reads it.
    assert_eq!(found["own"], "of its own");
    assert_eq!(found["rt/tf"], "");
}
