//! What eclipse-zenoh and rosbags read, as nodes with rmw_zenoh would. CONTRIBUTING.md has the command.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    collections::HashSet,
    path::PathBuf,
    time::{Duration, SystemTime},
};

use common::{Board, Bridge, Program, Sending, listener, ports::HeldPort, python, sending};
use facewire_packet::BLENDSHAPES;
use serde_json::{Value, json};

/// A place for a router.
struct Graph {
    python: PathBuf,
    port: HeldPort,
}

impl Graph {
    fn new() -> Option<Self> {
        let python = python("zenoh, rosbags", "CONTRIBUTING.md says how to install them")?;
        Some(Self { python, port: HeldPort::new() })
    }

    fn port(&self) -> String {
        self.port.address().port().to_string()
    }

    fn router(&self) -> Program {
        let mut router = listener(&self.python, &["router", &self.port()]);
        router.wait_for_text("listens");
        router
    }

    fn listen(&self, kind: &str, topic: &str) -> Program {
        listener(&self.python, &["zenoh", &self.port(), "7", kind, topic])
    }

    /// A bridge with one board, left, that sends.
    fn bridge(&self, arguments: &[&str]) -> (Bridge, Sending) {
        let router = self.port.address().to_string();
        let ros = ["--ros-zenoh", &router, "--ros-domain", "7", "--board", "left=127.0.1.1"];
        let bridge = Bridge::start(&[&ros, arguments].concat());
        let mut left: Board = bridge.board(1);
        left.set("jawOpen", 0.25);
        left.packet.position_mm = [100.0, -50.0, 600.0];
        (bridge, sending(vec![left]))
    }
}

/// Waits for a message that this accepts, and returns it with its number, its time and its writer.
fn message(listener: &mut Program, what: &str, accepts: impl Fn(&Value) -> bool) -> (Value, i64, i64, String) {
    listener.wait_for(what, |line| {
        let message: (Value, i64, i64, String) = serde_json::from_str(line).ok()?;
        accepts(&message.0).then_some(message)
    })
}

/// Waits for a token that came or went, and returns its parts after the node's.
fn token(router: &mut Program, kind: &str, text: &str) -> Vec<String> {
    router.wait_for(text, |line| {
        let (found, key): (String, String) = serde_json::from_str(line).ok()?;
        (found == kind && key.contains(text)).then(|| key.split('/').map(str::to_owned).collect())
    })
}

#[test]
fn every_topic_is_read_under_the_hash_and_by_the_definition_of_its_type() {
    let Some(graph) = Graph::new() else { return };
    let _router = graph.router();
    let folder = tempfile::tempdir().unwrap();
    let settings = folder.path().join("bridge.toml");
    std::fs::write(&settings, "[ros]\naction_units = true\n").unwrap();
    let (_bridge, _sending) = graph.bridge(&["--config", settings.to_str().unwrap()]);
    let read = |kind: &str, topic: &str, accepts: &dyn Fn(&Value) -> bool| {
        message(&mut graph.listen(kind, topic), topic, accepts).0
    };
    let is_open = |jaw: &Value| (jaw.as_f64().unwrap() - 0.25).abs() < 1e-4;
    let place = |of: &Value| ["x", "y", "z"].map(|axis| of[axis].as_f64().unwrap());
    let opens = |joints: &Value| is_open(&joints["position"][17]);
    let joints = read("sensor_msgs/JointState", "/facewire/left/blendshapes", &opens);
    assert_eq!(joints["name"], json!(BLENDSHAPES.as_slice()));
    assert_eq!(joints["header"]["frame_id"], "left_camera_optical_frame");
    let pose = read("geometry_msgs/PoseStamped", "/facewire/left/head_pose", &|_| true);
    assert_eq!(place(&pose["pose"]["position"]), [0.1, -0.05, 0.6]);
    let transforms = read("tf2_msgs/TFMessage", "/tf", &|_| true);
    let head = &transforms["transforms"][0];
    assert_eq!(head["child_frame_id"], "left_head");
    assert_eq!(place(&head["transform"]["translation"]), [0.1, -0.05, 0.6]);
    let report = read("diagnostic_msgs/DiagnosticArray", "/diagnostics", &|_| true);
    assert_eq!(report["status"][0]["hardware_id"], "127.0.1.1");
    read("hri_msgs/IdsList", "/humans/faces/tracked", &|faces| faces["ids"] == json!(["f0000"]));
    read("hri_msgs/FacialActionUnits", "/humans/faces/f0000/facs", &|units| is_open(&units["intensity"][26]));
}

#[test]
fn attachments_count_the_messages_of_each_writer_and_tell_their_time() {
    let Some(graph) = Graph::new() else { return };
    let _router = graph.router();
    let (_bridge, _sending) = graph.bridge(&[]);
    let mut writers = HashSet::new();
    for (kind, topic) in [("sensor_msgs/JointState", "blendshapes"), ("geometry_msgs/PoseStamped", "head_pose")] {
        let mut messages = graph.listen(kind, &format!("/facewire/left/{topic}"));
        let (_, first, before_ns, writer) = message(&mut messages, "a message", |_| true);
        let (_, second, after_ns, same) = message(&mut messages, "the next", |_| true);
        assert_eq!((second, &same), (first + 1, &writer));
        let now_ns = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_nanos();
        assert!(before_ns < after_ns && u128::try_from(after_ns).unwrap() < now_ns);
        assert!(writers.insert(writer), "each writer has an identifier of its own");
    }
}

#[test]
fn tokens_tell_of_the_node_and_its_writers_until_sigterm_and_who_comes_late_learns_of_the_face() {
    let Some(graph) = Graph::new() else { return };
    let mut router = graph.router();
    let (mut bridge, _sending) = graph.bridge(&[]);
    let node = token(&mut router, "PUT", "/NN/");
    assert_eq!((&*node[1], &node[3..]), ("7", &["0", "0", "NN", "%", "%", "facewire_bridge"].map(str::to_owned)[..]));
    let face = token(&mut router, "PUT", "%facewire%left%face");
    assert_eq!((&face[2], &*face[12]), (&node[2], ":1:,1:,:,:,,"));
    let mut late = graph.listen("std_msgs/Bool", "/facewire/left/face");
    message(&mut late, "a face", |face| face["data"] == true);
    assert_eq!(late.seen.len(), 1, "the last state alone");
    bridge.program.signal("TERM");
    message(&mut late, "no face", |face| face["data"] == false);
    token(&mut router, "DELETE", "%facewire%left%face");
    assert!(bridge.program.ends().success());
}

#[test]
fn a_router_that_is_away_is_waited_for_at_the_start_until_sigterm_and_later() {
    let Some(graph) = Graph::new() else { return };
    let (mut bridge, _sending) = graph.bridge(&[]);
    bridge.program.wait_for_text("no Zenoh router at tcp/127.0.0.1");
    bridge.program.signal("TERM");
    assert!(bridge.program.ends().success());
    let (mut bridge, _sending) = graph.bridge(&[]);
    bridge.program.wait_for_text("no Zenoh router at tcp/127.0.0.1");
    let router = graph.router();
    bridge.program.wait_for_text("connected to the Zenoh router");
    let mut face = graph.listen("std_msgs/Bool", "/facewire/left/face");
    message(&mut face, "a face", |face| face["data"] == true);
    drop(router);
    bridge.program.wait_for_text("waiting for the Zenoh router");
    let _router = graph.router();
    bridge.program.wait_for_text("connected to the Zenoh router");
    let mut blendshapes = graph.listen("sensor_msgs/JointState", "/facewire/left/blendshapes");
    message(&mut blendshapes, "an open jaw", |joints| joints["position"][17].as_f64().unwrap() > 0.2);
    let mut late = graph.listen("std_msgs/Bool", "/facewire/left/face");
    message(&mut late, "a face", |face| face["data"] == true);
}

#[test]
fn a_router_that_stands_still_takes_no_memory_and_does_not_keep_the_bridge_from_ending() {
    let Some(graph) = Graph::new() else { return };
    let router = graph.router();
    let mut bridge = Bridge::start(&["--ros-zenoh", &graph.port.address().to_string()]);
    bridge.program.wait_for_text("connected to the Zenoh router");
    let _sending = sending((1..=50).map(|last| bridge.board(last)).collect());
    bridge.program.wait_for_text("is new, from 127.0.1.50");
    bridge.program.read_for(Duration::from_secs(1));
    let before = bridge.program.resident_kb();
    router.signal("STOP");
    // By then, the connection is full.
    bridge.program.read_for(Duration::from_secs(3));
    let after = bridge.program.resident_kb();
    assert!(after < before + 4000, "{before} kB before, {after} kB after");
    bridge.program.signal("TERM");
    assert!(bridge.program.ends().success());
}
