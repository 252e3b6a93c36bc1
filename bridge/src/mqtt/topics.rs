//! What is published: topics, their payloads, and Home Assistant's discovery.
//!
//! A topic is sent when its payload has changed, and not sooner than [`AT_LEAST`] after the last time, because Home Assistant
//! keeps every state in its database. A message that finds no room stays unsent, and its newest state is offered again.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use facewire_packet::{BLENDSHAPES, Face, Reason, yaw_pitch_roll_deg};
use rumqttc::{AsyncClient, QoS};
use serde_json::{Value, json};

use crate::{
    fleet::{Board, Fleet, Shared},
    settings::{BRIDGE, Mqtt},
    trigger::{KINDS, Trigger},
};

pub const OFFLINE: &str = "offline";
const ONLINE: &str = "online";
/// The least time between two messages of a topic.
const AT_LEAST: Duration = Duration::from_millis(500);
/// The least time between two messages of health, whose numbers change all the time.
const HEALTH: Duration = Duration::from_secs(10);

/// The topic that says whether the bridge runs.
pub fn bridge_availability(prefix: &str) -> String {
    format!("{prefix}/{BRIDGE}/availability")
}

/// A retained topic, and what was sent to it over this connection.
struct Retained {
    topic: String,
    sent: Option<(String, Instant)>,
}

impl Retained {
    fn new(topic: String) -> Self {
        Self { topic, sent: None }
    }

    /// Sends the payload if it has changed and the last one is old enough. Returns whether there was no room.
    fn offer(&mut self, payload: String, at_least: Duration, now: Instant, client: &AsyncClient) -> bool {
        let is_due = self
            .sent
            .as_ref()
            .is_none_or(|(sent, at)| *sent != payload && now.saturating_duration_since(*at) >= at_least);
        if !is_due {
            return false;
        }
        let is_full = client.try_publish(&self.topic, QoS::AtMostOnce, true, payload.as_str()).is_err();
        if !is_full {
            self.sent = Some((payload, now));
        }
        is_full
    }
}

/// The topics of a board or of the bridge.
struct Topics {
    /// What Home Assistant shows, which never changes.
    config: Option<(Retained, String)>,
    states: Vec<Retained>,
    triggers: [Trigger; 3],
    /// The packets that the stream has seen.
    streamed: u64,
}

/// Publishes the fleet.
pub struct Publisher {
    settings: Mqtt,
    bridge: Topics,
    boards: Vec<Topics>,
    /// Messages that found no room and were replaced or sent later.
    deferred: u64,
    /// Packets that the stream has left out.
    skipped: u64,
}

impl Publisher {
    pub fn new(settings: &Mqtt) -> Self {
        let states = ["availability", "health"].map(|part| Retained::new(topic(settings, BRIDGE, part)));
        let config = config(settings, BRIDGE, &bridge_entities(settings));
        let bridge = Topics { config, states: states.into(), triggers: Trigger::all(settings), streamed: 0 };
        Self { settings: settings.clone(), bridge, boards: Vec::new(), deferred: 0, skipped: 0 }
    }

    /// Begins a connection, whose broker may know nothing.
    pub fn begin(&mut self, client: &AsyncClient) {
        self.forget();
        if !self.settings.discovery.is_empty() {
            let _ = client.try_subscribe(format!("{}/status", self.settings.discovery), QoS::AtMostOnce);
        }
    }

    /// Makes everything that is retained be sent again.
    pub fn forget(&mut self) {
        for topics in self.boards.iter_mut().chain([&mut self.bridge]) {
            let config = topics.config.as_mut().map(|(config, _)| config);
            config.into_iter().chain(&mut topics.states).for_each(|retained| retained.sent = None);
        }
    }

    /// Sends what has changed.
    pub fn publish_changes(&mut self, shared: &Shared, client: &AsyncClient, now: Instant) {
        let mut fleet = shared.lock();
        for at in self.boards.len()..fleet.boards.len() {
            if let Some(board) = fleet.boards.get(at) {
                self.boards.push(board_topics(&self.settings, &board.name));
            }
        }
        let mut all = vec![self.bridge_states(&fleet, now)];
        for (at, topics) in self.boards.iter_mut().enumerate() {
            let (Some(face), Some(board)) = (fleet.face(at, now), fleet.boards.get(at)) else { continue };
            all.push(board_states(board, &face, &mut topics.triggers, now));
        }
        drop(fleet);
        for (topics, states) in [&mut self.bridge].into_iter().chain(&mut self.boards).zip(all) {
            if let Some((config, payload)) = &mut topics.config {
                self.deferred += u64::from(config.offer(payload.clone(), AT_LEAST, now, client));
            }
            for (retained, payload) in topics.states.iter_mut().zip(states) {
                let at_least = if retained.topic.ends_with("/health") { HEALTH } else { AT_LEAST };
                self.deferred += u64::from(retained.offer(payload, at_least, now, client));
            }
        }
    }

    /// Sends the newest face of each board that has a new one.
    pub fn stream(&mut self, shared: &Shared, client: &AsyncClient, now: Instant) {
        let mut frames = Vec::new();
        let mut fleet = shared.lock();
        for (at, topics) in self.boards.iter_mut().enumerate() {
            let Some(face) = fleet.face(at, now) else { continue };
            let Some(board) = fleet.boards.get(at) else { continue };
            if let Some(missed) = board.missed_since(&mut topics.streamed) {
                self.skipped += missed;
                frames.push((topic(&self.settings, &board.name, "frame"), frame(board, &face)));
            }
        }
        drop(fleet);
        for (topic, frame) in frames {
            self.deferred += u64::from(client.try_publish(topic, QoS::AtMostOnce, false, frame.to_string()).is_err());
        }
    }

    fn bridge_states(&self, fleet: &Fleet, now: Instant) -> Vec<String> {
        let here = fleet.boards.iter().filter(|board| board.is_here(now)).count();
        let counts = fleet.counts;
        let health = json!({
            "boards": fleet.boards.len(), "here": here, "strangers": counts.strangers, "surplus": counts.surplus,
            "damaged": counts.damaged, "mqtt_deferred": self.deferred, "stream_skipped": self.skipped,
        });
        vec![ONLINE.to_owned(), health.to_string()]
    }
}

fn topic(settings: &Mqtt, board: &str, part: &str) -> String {
    format!("{}/{board}/{part}", settings.prefix)
}

fn on_off(is_on: bool) -> String {
    if is_on { "ON" } else { "OFF" }.to_owned()
}

/// The topics of a board, in the order of [`board_states`].
fn board_topics(settings: &Mqtt, name: &str) -> Topics {
    let [smile, mouth_open, eyes_shut] = KINDS.map(|kind| kind.name);
    let parts = ["availability", "face", "state", "problem", smile, mouth_open, eyes_shut, "health"];
    Topics {
        config: config(settings, name, &board_entities(settings, name)),
        states: parts.map(|part| Retained::new(topic(settings, name, part))).into(),
        triggers: Trigger::all(settings),
        streamed: 0,
    }
}

fn board_states(board: &Board, face: &Face, triggers: &mut [Trigger; 3], now: Instant) -> Vec<String> {
    let (packet, is_here) = (board.packet(), board.is_here(now));
    let (state, reason) = if is_here { (packet.state.name(), packet.reason.name()) } else { ("away", "silent") };
    let is_problem = !is_here || matches!(packet.reason, Reason::NoCamera | Reason::Late | Reason::BadResult);
    let health = json!({
        "packets_per_s": board.tally.rate_hz(now).round(), "packets": board.tally.packets, "lost": board.tally.lost,
        "damaged": board.tally.refused, "two_senders": board.tally.rival(now).is_some(),
    });
    let mut states = vec![
        if is_here { ONLINE } else { OFFLINE }.to_owned(),
        on_off(board.has_face(now)),
        json!({ "state": state, "reason": reason }).to_string(),
        on_off(is_problem),
    ];
    states.extend(triggers.iter_mut().map(|trigger| on_off(trigger.update(&face.coefficients, now))));
    states.push(health.to_string());
    states
}

/// The whole face, as a program would read it.
fn frame(board: &Board, face: &Face) -> Value {
    let packet = board.packet();
    let rounded = |value: f32| (f64::from(value) * 1e4).round() / 1e4;
    let values = face.coefficients.map(rounded);
    let [yaw, pitch, roll] = yaw_pitch_roll_deg(face.rotation).map(rounded);
    json!({
        "sequence": packet.sequence, "state": packet.state.name(), "reason": packet.reason.name(),
        "head": {
            "rotation": face.rotation.map(rounded), "position_mm": packet.position_mm, "yaw_deg": yaw,
            "pitch_deg": pitch, "roll_deg": roll,
        },
        "blendshapes": BLENDSHAPES.into_iter().zip(values).collect::<BTreeMap<_, _>>(),
    })
}

/// An entity of Home Assistant: its key, and what is special to it.
type Entity = (&'static str, Value);

fn board_entities(settings: &Mqtt, name: &str) -> Vec<Entity> {
    let of = |part: &str| topic(settings, name, part);
    let diagnostic = |title: &str, part: &str, field: &str| {
        json!({ "p": "sensor", "name": title, "state_topic": of(part), "entity_category": "diagnostic",
                "value_template": format!("{{{{ value_json.{field} }}}}") })
    };
    let mut rate = diagnostic("Packet rate", "health", "packets_per_s");
    let mut lost = diagnostic("Lost packets", "health", "lost");
    if let (Some(rate), Some(lost)) = (rate.as_object_mut(), lost.as_object_mut()) {
        rate.extend([
            ("unit_of_measurement".to_owned(), "Hz".into()),
            ("state_class".to_owned(), "measurement".into()),
        ]);
        lost.insert("state_class".to_owned(), "total_increasing".into());
    }
    let mut entities = vec![
        (
            "face",
            json!({ "p": "binary_sensor", "name": "Face", "device_class": "occupancy", "state_topic": of("face") }),
        ),
        (
            "problem",
            json!({ "p": "binary_sensor", "name": "Problem", "device_class": "problem",
                            "entity_category": "diagnostic", "state_topic": of("problem") }),
        ),
        ("state", diagnostic("State", "state", "state")),
        ("reason", diagnostic("Reason", "state", "reason")),
        ("rate", rate),
        ("lost", lost),
    ];
    entities
        .extend(KINDS.map(|kind| {
            (kind.name, json!({ "p": "binary_sensor", "name": kind.title, "state_topic": of(kind.name) }))
        }));
    entities
}

fn bridge_entities(settings: &Mqtt) -> Vec<Entity> {
    let counter = |key, title: &str| {
        (
            key,
            json!({ "p": "sensor", "name": title, "state_topic": topic(settings, BRIDGE, "health"),
                      "entity_category": "diagnostic", "value_template": format!("{{{{ value_json.{key} }}}}") }),
        )
    };
    vec![
        counter("here", "Boards here"),
        counter("strangers", "Packets of strangers"),
        counter("surplus", "Packets of boards too many"),
        counter("damaged", "Damaged datagrams"),
    ]
}

/// The discovery of a device with these entities, unless it is off.
fn config(settings: &Mqtt, name: &str, entities: &[Entity]) -> Option<(Retained, String)> {
    let Mqtt { discovery, prefix, .. } = settings;
    if discovery.is_empty() {
        return None;
    }
    let id = format!("{prefix}_{name}").replace(|character: char| !character.is_ascii_alphanumeric(), "_");
    let (version, is_board) = (env!("CARGO_PKG_VERSION"), name != BRIDGE);
    let mut components = serde_json::Map::new();
    for (key, entity) in entities {
        let mut entity = entity.clone();
        if let Some(fields) = entity.as_object_mut() {
            fields.insert("unique_id".to_owned(), format!("{id}_{key}").into());
            // Where the bridge runs, a board that is away is a problem and not unknown.
            let needs_board = is_board && !matches!(*key, "problem" | "state" | "reason");
            let places = [BRIDGE, name].into_iter().take(1 + usize::from(needs_board));
            let topics: Vec<Value> =
                places.map(|place| json!({ "topic": topic(settings, place, "availability") })).collect();
            fields.insert("availability".to_owned(), topics.into());
            fields.insert("availability_mode".to_owned(), "all".into());
        }
        components.insert((*key).to_owned(), entity);
    }
    let payload = json!({
        "dev": { "ids": [&id], "name": format!("{prefix} {name}"), "mf": "facewire", "sw": version },
        "o": { "name": "facewire-bridge", "sw": version },
        "cmps": components,
    });
    Some((Retained::new(format!("{discovery}/device/{id}/config")), payload.to_string()))
}
