//! What programs of others read from a broker, and what the bridge does when the broker goes.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    collections::BTreeMap,
    fs,
    net::UdpSocket,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use common::{Board, Bridge, Broker, SETUP, eventually, listener, python, sending};
use facewire_packet::{BLENDSHAPES, Packet, Reason, State};
use serde_json::Value;

const CONFIG: &str = "homeassistant/device/facewire_left/config";

/// A bridge with one board, left, that smiles.
fn with_left(broker: &Broker, arguments: &[&str]) -> (Bridge, Board) {
    let address = broker.address();
    let bridge = Bridge::start(&[&["--mqtt", &address, "--board", "left=127.0.1.1"], arguments].concat());
    let mut left = bridge.board(1);
    left.set("mouthSmileLeft", 0.8);
    left.set("mouthSmileRight", 0.75);
    (bridge, left)
}

#[test]
fn mosquitto_reads_presence_state_and_triggers_which_change_once_and_are_retained() {
    let Some(broker) = Broker::start() else { return };
    let mut listener = broker.subscribe("facewire/#");
    let (_bridge, left) = with_left(&broker, &[]);
    listener.wait_for_message("facewire/bridge/availability", |payload| payload == "online");
    listener.wait_for_message("facewire/left/availability", |payload| payload == "offline");
    let guard = sending(vec![left]);
    listener.wait_for_message("facewire/left/face", |payload| payload == "ON");
    listener.wait_for_message("facewire/left/smile", |payload| payload == "ON");
    // A busy machine may hold up the packets for so long that the board is away for a moment.
    eventually("a retained smile of a live face", || {
        let mut late = broker.subscribe("facewire/left/+");
        let retained = |topic: &str| {
            let start = format!("1 facewire/left/{topic} ");
            late.wait_for(topic, |line| line.strip_prefix(&start).map(str::to_owned))
        };
        let [state, smile] = ["state", "smile"].map(retained);
        let state: Value = serde_json::from_str(&state).unwrap();
        state == serde_json::json!({"state": "live", "reason": "none"}) && smile == "ON"
    });
    drop(guard);
    listener.wait_for_message("facewire/left/face", |payload| payload == "OFF");
    listener.wait_for_message("facewire/left/smile", |payload| payload == "OFF");
    listener.wait_for_message("facewire/left/availability", |payload| payload == "offline");
    listener.wait_for_message("facewire/left/state", |payload| payload.contains("away"));
    for part in ["availability", "face", "state", "problem", "smile", "mouth_open", "eyes_shut"] {
        let payloads = listener.payloads(&format!("facewire/left/{part}"));
        assert!(!payloads.is_empty() && payloads.windows(2).all(|pair| pair[0] != pair[1]), "{part}: {payloads:?}");
    }
    assert!(listener.payloads("facewire/left/frame").is_empty(), "the stream was not asked for");
}

#[test]
fn a_camera_that_is_unplugged_is_a_problem_with_its_reason_and_no_face() {
    let Some(broker) = Broker::start() else { return };
    let mut listener = broker.subscribe("facewire/left/#");
    let (_bridge, mut left) = with_left(&broker, &[]);
    left.packet = Packet { state: State::Neutral, reason: Reason::NoCamera, ..left.packet };
    let guard = sending(vec![left]);
    let state = listener.wait_for_json("facewire/left/state", |state| state["reason"] == "no camera");
    assert_eq!(state["state"], "neutral");
    // What changes together with the state is sent before the state changes again.
    drop(guard);
    listener.wait_for_json("facewire/left/state", |state| state["state"] == "away");
    assert_eq!(listener.payloads("facewire/left/problem"), ["ON"], "as long as the board is away, too");
    assert_eq!(listener.payloads("facewire/left/face"), ["OFF"]);
}

#[test]
fn paho_reads_the_retained_discovery_whose_topics_exist_and_whose_entities_are_complete() {
    let (Some(broker), Some(python)) = (Broker::start(), python("paho.mqtt", SETUP)) else { return };
    let (_bridge, left) = with_left(&broker, &[]);
    let _guard = sending(vec![left]);
    let mut first = broker.subscribe("facewire/left/health");
    first.wait_for_json("facewire/left/health", |health| health["packets"].as_u64() > Some(0));
    let mut listener = listener(&python, &["mqtt", &broker.port().to_string(), "#"]);
    // Each topic with its first payload, and whether that was retained.
    let mut found: BTreeMap<String, (bool, String)> = BTreeMap::new();
    let mut first_of = |topic: &str| {
        while !found.contains_key(topic) {
            let message: (bool, String, String) =
                listener.wait_for(topic, |line| Some(serde_json::from_str(line).unwrap()));
            found.entry(message.1).or_insert((message.0, message.2));
        }
        found[topic].clone()
    };
    let (retained, config) = first_of(CONFIG);
    let config: Value = serde_json::from_str(&config).unwrap();
    assert!(retained && config["dev"]["ids"][0] == "facewire_left" && config["o"]["name"] == "facewire-bridge");
    let entities = config["cmps"].as_object().unwrap();
    assert_eq!(entities.len(), 9);
    for (key, entity) in entities {
        assert_eq!(entity["unique_id"], format!("facewire_left_{key}"));
        let sources = entity["availability"].as_array().unwrap().iter().map(|place| &place["topic"]);
        for topic in sources.chain([&entity["state_topic"]]) {
            let (retained, _) = first_of(topic.as_str().unwrap());
            assert!(retained, "{key}: {topic}");
        }
        let is_binary = entity["p"] == "binary_sensor";
        let (_, payload) = first_of(entity["state_topic"].as_str().unwrap());
        match entity["value_template"].as_str() {
            None => assert!(is_binary && ["ON", "OFF"].contains(&payload.as_str())),
            Some(template) => {
                let field = template.trim_start_matches("{{ value_json.").trim_end_matches(" }}");
                assert!(!serde_json::from_str::<Value>(&payload).unwrap()[field].is_null(), "{template} in {payload}");
            }
        }
    }
}

#[test]
fn home_assistants_birth_is_answered_with_discovery_and_states_and_a_retained_one_is_no_news() {
    let Some(broker) = Broker::start() else { return };
    broker.publish("homeassistant/status", "online", &["-r"]);
    let mut listener = broker.subscribe("#");
    let (_bridge, left) = with_left(&broker, &[]);
    let _guard = sending(vec![left]);
    let config = listener.wait_for_message(CONFIG, |_| true);
    // By the time of a smile, which must last a while, the retained message has long come.
    listener.wait_for_message("facewire/left/smile", |payload| payload == "ON");
    let configs = |listener: &common::Program| {
        listener.seen.iter().filter(|line| line.starts_with(&format!("0 {CONFIG} "))).count()
    };
    assert_eq!(configs(&listener), 1);
    broker.publish("homeassistant/status", "offline", &[]);
    broker.publish("homeassistant/status", "online", &[]);
    assert_eq!(listener.wait_for_message(CONFIG, |_| true), config);
    listener.wait_for_message("facewire/left/face", |payload| payload == "ON");
    assert_eq!(configs(&listener), 2);
}

#[test]
fn an_hour_without_the_broker_takes_no_memory_and_then_everything_is_there_again() {
    let Some(mut broker) = Broker::absent() else { return };
    let (mut bridge, mut left) = with_left(&broker, &["--mqtt-stream", "60"]);
    bridge.program.wait_for_text("no broker at");
    let flood = |left: &mut Board, seconds: u32| {
        for _ in 0..seconds * 6 {
            (0..10).for_each(|_| left.send());
            thread::sleep(Duration::from_micros(100));
        }
    };
    flood(&mut left, 60);
    let before = bridge.program.resident_kb();
    flood(&mut left, 1800);
    broker.come();
    let mut listener = broker.subscribe("#");
    for _ in 0..2 {
        let guard = sending(vec![bridge.board(1)]);
        listener.wait_for_message(CONFIG, |_| true);
        listener.wait_for_message("facewire/left/face", |payload| payload == "ON");
        drop(guard);
        broker.go();
        bridge.program.wait_for_text("no broker at");
        flood(&mut left, 900);
        let after = bridge.program.resident_kb();
        assert!(after < before + 2000, "{before} kB before, {after} kB after");
        broker.come();
        listener = broker.subscribe("#");
    }
    assert_eq!(bridge.program.seen.iter().filter(|line| line.contains("no broker at")).count(), 3, "told once each");
}

#[test]
fn a_broker_that_hangs_is_left_takes_no_memory_and_is_there_again_once_it_answers() {
    let Some(broker) = Broker::start() else { return };
    let mut bridge = Bridge::start(&["--mqtt", &broker.address(), "--mqtt-stream", "60"]);
    bridge.program.wait_for_text("connected to the broker");
    let _guard = sending((1..=50).map(|last| bridge.board(last)).collect());
    bridge.program.wait_for_text("board_127_0_1_50 is new");
    let mut stream = broker.subscribe("facewire/board_127_0_1_50/frame");
    for _ in 0..60 {
        stream.wait_for_text("/frame ");
    }
    drop(stream);
    let before = bridge.program.resident_kb();
    broker.signal("STOP");
    bridge.program.wait_for_text("no broker at");
    let after = bridge.program.resident_kb();
    assert!(after < before + 4000, "{before} kB before, {after} kB after");
    broker.signal("CONT");
    bridge.program.wait_for_text("connected to the broker");
    broker.subscribe("facewire/board_127_0_1_50/face").wait_for_text("/face ON");
}

#[test]
fn the_end_is_told_by_sigterm_itself_and_after_a_kill_by_the_will() {
    let Some(broker) = Broker::start() else { return };
    for signal in ["TERM", "INT", "KILL"] {
        let mut listener = broker.subscribe("facewire/bridge/availability");
        let (mut bridge, _) = with_left(&broker, &[]);
        listener.wait_for_message("facewire/bridge/availability", |payload| payload == "online");
        bridge.program.signal(signal);
        listener.wait_for_message("facewire/bridge/availability", |payload| payload == "offline");
        assert_eq!(bridge.program.ends().success(), signal != "KILL");
        let mut late = broker.subscribe("facewire/bridge/availability");
        late.wait_for("a retained message", |line| line.starts_with("1 ").then(|| assert!(line.ends_with("offline"))));
    }
    let mut absent = Broker::absent().unwrap();
    absent.go();
    let (mut bridge, _) = with_left(&absent, &[]);
    bridge.program.wait_for_text("no broker at");
    bridge.program.signal("TERM");
    assert!(bridge.program.ends().success());
}

#[test]
fn tls_with_user_and_password_works_and_the_password_is_neither_in_argv_nor_in_the_log() {
    let Some(mut broker) = Broker::absent() else { return };
    let folder = broker.folder.path().to_owned();
    let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let run = |program: &str, arguments: &str| {
        let arguments = arguments.split(' ');
        let output = Command::new(program).args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    let (key, certificate, passwords) = (at("key.pem"), at("certificate.pem"), at("passwords"));
    let subject = "-subj /CN=localhost -addext subjectAltName=DNS:localhost -addext basicConstraints=critical,CA:FALSE";
    run("openssl", &format!("req -x509 -newkey rsa:2048 -nodes -days 2 -keyout {key} -out {certificate} {subject}"));
    run("mosquitto_passwd", &format!("-b -c {passwords} me s3cret-word"));
    broker.configure(&format!(
        "allow_anonymous false\npassword_file {passwords}\ncertfile {certificate}\nkeyfile {key}\n"
    ));
    broker.come();
    let (right, wrong) = (at("right"), at("wrong"));
    fs::write(&right, "s3cret-word\n").unwrap();
    fs::write(&wrong, "s3cret-other\n").unwrap();
    let address = format!("mqtts://me@localhost:{}", broker.port());
    let start = |password: &str, options: &[&str]| {
        Bridge::start(&[&["--mqtt", &address, "--mqtt-password-file", password], options].concat())
    };
    let trusting = ["--mqtt-ca", certificate.as_str()];
    let mut bridge = start(&right, &trusting);
    bridge.program.wait_for_text("connected to the broker");
    let argv = fs::read_to_string(format!("/proc/{}/cmdline", bridge.program.child.id())).unwrap();
    assert!(!argv.contains("s3cret") && bridge.program.seen.iter().all(|line| !line.contains("s3cret")));
    let mut refused = start(&wrong, &trusting);
    refused.program.wait_for_text("check the user in --mqtt USER@HOST and the password");
    assert!(refused.program.seen.iter().all(|line| !line.contains("s3cret")));
    start(&right, &[]).program.wait_for_text("check the host name and --mqtt-ca");
}

/// A busy machine can only lengthen the times between frames.
#[test]
fn the_stream_has_the_head_and_all_52_coefficients_and_at_most_the_rate_that_was_asked_for() {
    let Some(broker) = Broker::start() else { return };
    let mut listener = broker.subscribe("facewire/left/frame");
    let begun = Instant::now();
    let (_bridge, mut left) = with_left(&broker, &["--mqtt-stream", "10"]);
    left.packet.visibility.mouth = 0.4;
    let _guard = sending(vec![left]);
    let smiles = |frame: &Value| frame["blendshapes"]["mouthSmileLeft"] == 0.8;
    let frame = listener.wait_for_json("facewire/left/frame", smiles);
    let shapes = frame["blendshapes"].as_object().unwrap();
    assert!(shapes.len() == 52 && BLENDSHAPES.iter().all(|name| shapes.contains_key(*name)));
    assert_eq!((&frame["state"], &frame["head"]["rotation"][3]), (&Value::from("live"), &Value::from(1.0)));
    assert_eq!(
        (&frame["visibility"]["mouth"], &frame["visibility"]["left_eye"]),
        (&Value::from(0.4), &Value::from(1.0))
    );
    for _ in 0..20 {
        listener.wait_for_message("facewire/left/frame", |_| true);
    }
    assert!(begun.elapsed() > Duration::from_secs(2), "{:?}", begun.elapsed());
}

#[test]
fn strangers_and_damaged_datagrams_are_counted_and_told() {
    let Some(broker) = Broker::start() else { return };
    let mut listener = broker.subscribe("facewire/bridge/health");
    let (mut bridge, mut left) = with_left(&broker, &[]);
    bridge.program.wait_for_text("connected to the broker");
    let mut stranger = bridge.board(9);
    left.send();
    stranger.send();
    stranger.send_bytes(b"hello");
    bridge.program.wait_for_text("packets refused because their board has no name: 1, the last from 127.0.1.9");
    bridge.program.wait_for_text("damaged datagrams: 1, the last from 127.0.1.9: 5 bytes instead of");
    let is_counted = |health: &Value| health["strangers"] == 1 && health["damaged"] == 1;
    listener.wait_for_json("facewire/bridge/health", is_counted);
}

#[test]
fn of_50_boards_at_60_packets_a_second_nothing_is_lost_that_is_not_counted() {
    let Some(broker) = Broker::start() else { return };
    let address = broker.address();
    let mut bridge = Bridge::start(&["--mqtt", &address]);
    bridge.program.wait_for_text("connected to the broker");
    let mut boards: Vec<Board> = (1..=50).map(|last| bridge.board(last)).collect();
    for _ in 0..180 {
        boards.iter_mut().for_each(Board::send);
        thread::sleep(Duration::from_micros(16_667));
    }
    // Lost packets show in the number of the next packet. This next packet is not lost, because no other is waiting.
    bridge.reads_all();
    boards.iter_mut().for_each(Board::send);
    for (board, last) in boards.iter().zip(1..) {
        let health = format!("facewire/board_127_0_1_{last}/health");
        let mut one = broker.subscribe(&health);
        let sent = u64::from(board.packet.sequence);
        let is_all = |counts: &Value| {
            let [packets, lost] = ["packets", "lost"].map(|key| counts[key].as_u64().unwrap());
            packets + lost == sent
        };
        one.wait_for_json(&health, is_all);
    }
}

#[test]
fn a_port_that_is_taken_is_an_error_and_an_interface_that_is_away_is_waited_for() {
    let mut bridge = Bridge::start(&["--ros", "--ros-domain", "99", "--interface", "nothere"]);
    bridge.program.wait_for_text("check network and --interface. Trying again");
    bridge.program.signal("TERM");
    assert!(bridge.program.ends().success());
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let arguments = ["--ros", "--udp", &taken.local_addr().unwrap().to_string()];
    let output = Command::new(env!("CARGO_BIN_EXE_facewire-bridge")).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("give --udp another address"));
}
