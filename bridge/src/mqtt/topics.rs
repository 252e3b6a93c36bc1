//! What is published: topics, their payloads, and Home Assistant's discovery.
//!
//! A topic is sent when its payload has changed, and not sooner than [`AT_LEAST`] after the last time, because Home Assistant
//! keeps every state in its database. A message that finds no room stays unsent, and its newest state is offered again.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use facewire_packet::{BLENDSHAPES, Face, Packet, Reason, yaw_pitch_roll_deg};
use rumqttc::{AsyncClient, QoS};
use serde_json::{Value, json};

use crate::{
    fleet::{Board, Fleet, Shared},
    settings::BRIDGE,
    trigger::{KINDS, Trigger},
};

/// The first part of the topics of Home Assistant.
const HOME_ASSISTANT: &str = "homeassistant";
pub const OFFLINE: &str = "offline";
const ONLINE: &str = "online";
/// The least time between two messages of a topic.
const AT_LEAST: Duration = Duration::from_millis(500);
/// The least time between two messages of health, whose numbers change all the time.
const HEALTH: Duration = Duration::from_secs(10);

/// The topic that says whether the bridge runs.
pub fn bridge_availability(namespace: &str) -> String {
    format!("{namespace}/{BRIDGE}/availability")
}

/// A retained topic, and what was sent to it over this connection.
struct Retained {
    topic: String,
    at_least: Duration,
    sent: Option<(String, Instant)>,
}

impl Retained {
    fn new(topic: String) -> Self {
        let at_least = if topic.ends_with("/health") { HEALTH } else { AT_LEAST };
        Self { topic, at_least, sent: None }
    }

    /// Sends the payload if it has changed and the last one is old enough. Returns whether there was no room.
    fn offer(&mut self, payload: &str, now: Instant, client: &AsyncClient) -> bool {
        let is_old = |at: &Instant| now.saturating_duration_since(*at) >= self.at_least;
        if !self.sent.as_ref().is_none_or(|(sent, at)| *sent != payload && is_old(at)) {
            return false;
        }
        let is_full = client.try_publish(&self.topic, QoS::AtMostOnce, true, payload).is_err();
        if !is_full {
            self.sent = Some((payload.to_owned(), now));
        }
        is_full
    }
}

/// A board's retained topics.
struct Topics {
    /// What Home Assistant shows, which never changes.
    config: Option<(Retained, String)>,
    /// In the order of [`board_states`].
    states: Vec<Retained>,
    triggers: [Trigger; 3],
    /// The packets that the stream has seen.
    streamed: u64,
}

/// Publishes the fleet.
pub struct Publisher {
    namespace: String,
    is_discovered: bool,
    /// The bridge's availability and health.
    bridge: [Retained; 2],
    boards: Vec<Topics>,
    /// Messages that found no room and were replaced or sent later.
    deferred: u64,
    /// Packets that the stream has left out.
    skipped: u64,
}

impl Publisher {
    pub fn new(namespace: &str, is_discovered: bool) -> Self {
        let bridge = ["availability", "health"].map(|part| Retained::new(format!("{namespace}/{BRIDGE}/{part}")));
        Self { namespace: namespace.to_owned(), is_discovered, bridge, boards: Vec::new(), deferred: 0, skipped: 0 }
    }

    /// Begins a connection, whose broker may know nothing.
    pub fn begin(&mut self, client: &AsyncClient) {
        self.forget();
        if self.is_discovered {
            let _ = client.try_subscribe(format!("{HOME_ASSISTANT}/status"), QoS::AtMostOnce);
        }
    }

    /// Makes everything that is retained be sent again.
    pub fn forget(&mut self) {
        let boards = self.boards.iter_mut();
        let of_boards = boards
            .flat_map(|Topics { config, states, .. }| states.iter_mut().chain(config.iter_mut().map(|it| &mut it.0)));
        of_boards.chain(&mut self.bridge).for_each(|retained| retained.sent = None);
    }

    /// Sends what has changed.
    pub fn publish_changes(&mut self, shared: &Shared, client: &AsyncClient, now: Instant) {
        let mut fleet = shared.lock();
        for board in fleet.boards.iter().skip(self.boards.len()) {
            self.boards.push(topics(&self.namespace, &board.name, self.is_discovered));
        }
        let bridge = self.bridge_states(&fleet, now);
        let mut boards = Vec::with_capacity(self.boards.len());
        for (at, topics) in self.boards.iter_mut().enumerate() {
            let (Some(face), Some(board)) = (fleet.face(at, now), fleet.boards.get(at)) else { continue };
            boards.push(board_states(board, &face, &mut topics.triggers, now));
        }
        drop(fleet);
        let mut deferred = 0;
        let mut offer = |retained: &mut Retained, payload: &str| {
            deferred += u64::from(retained.offer(payload, now, client));
        };
        self.bridge.iter_mut().zip(&bridge).for_each(|(retained, payload)| offer(retained, payload));
        for (topics, states) in self.boards.iter_mut().zip(&boards) {
            topics.config.iter_mut().for_each(|(retained, payload)| offer(retained, payload));
            topics.states.iter_mut().zip(states).for_each(|(retained, payload)| offer(retained, payload));
        }
        self.deferred += deferred;
    }

    /// Sends the newest face of each board that has a new one.
    pub fn stream(&mut self, shared: &Shared, client: &AsyncClient, now: Instant) {
        let mut frames = Vec::new();
        let mut fleet = shared.lock();
        for (at, topics) in self.boards.iter_mut().enumerate() {
            let (Some(face), Some(board)) = (fleet.face(at, now), fleet.boards.get(at)) else { continue };
            if let Some(missed) = board.missed_since(&mut topics.streamed) {
                self.skipped += missed;
                frames.push((format!("{}/{}/frame", self.namespace, board.name), *board.packet(), face));
            }
        }
        drop(fleet);
        for (topic, packet, face) in frames {
            let payload = frame(&packet, &face).to_string();
            self.deferred += u64::from(client.try_publish(topic, QoS::AtMostOnce, false, payload).is_err());
        }
    }

    fn bridge_states(&self, fleet: &Fleet, now: Instant) -> [String; 2] {
        let here = fleet.boards.iter().filter(|board| board.is_here(now)).count();
        let counts = fleet.counts;
        let health = json!({
            "boards": fleet.boards.len(), "here": here, "strangers": counts.strangers, "surplus": counts.surplus,
            "damaged": counts.damaged, "mqtt_deferred": self.deferred, "stream_skipped": self.skipped,
        });
        [ONLINE.to_owned(), health.to_string()]
    }
}

fn topics(namespace: &str, name: &str, is_discovered: bool) -> Topics {
    let [smile, mouth_open, eyes_shut] = KINDS.map(|kind| kind.name);
    let parts = ["availability", "face", "state", "problem", smile, mouth_open, eyes_shut, "health"];
    Topics {
        config: is_discovered.then(|| discovery(namespace, name)),
        states: parts.map(|part| Retained::new(format!("{namespace}/{name}/{part}"))).into(),
        triggers: Trigger::all(),
        streamed: 0,
    }
}

fn on_off(is_on: bool) -> String {
    if is_on { "ON" } else { "OFF" }.to_owned()
}

fn board_states(board: &Board, face: &Face, triggers: &mut [Trigger; 3], now: Instant) -> [String; 8] {
    let (packet, tally, is_here) = (board.packet(), &board.tally, board.is_here(now));
    let (state, reason) = if is_here { (packet.state.name(), packet.reason.name()) } else { ("away", "silent") };
    let is_problem = !is_here || matches!(packet.reason, Reason::NoCamera | Reason::Late | Reason::BadResult);
    let [smile, mouth_open, eyes_shut] =
        triggers.each_mut().map(|trigger| on_off(trigger.update(&face.coefficients, now)));
    let health = json!({
        "packets_per_s": tally.rate_hz(now).round(), "packets": tally.packets, "lost": tally.lost,
        "damaged": tally.refused, "two_senders": tally.rival(now).is_some(),
    });
    [
        if is_here { ONLINE } else { OFFLINE }.to_owned(),
        on_off(board.has_face(now)),
        json!({ "state": state, "reason": reason }).to_string(),
        on_off(is_problem),
        smile,
        mouth_open,
        eyes_shut,
        health.to_string(),
    ]
}

/// The whole face, as a program would read it.
fn frame(packet: &Packet, face: &Face) -> Value {
    let rounded = |value: f32| (f64::from(value) * 1e4).round() / 1e4;
    let values = face.coefficients.map(rounded);
    let [yaw, pitch, roll] = yaw_pitch_roll_deg(face.rotation).map(rounded);
    json!({
        "sequence": packet.sequence, "state": packet.state.name(), "reason": packet.reason.name(),
        "visibility": packet.visibility.parts().map(|(part, value)| (part, rounded(value))).collect::<BTreeMap<_, _>>(),
        "head": {
            "rotation": face.rotation.map(rounded), "position_mm": packet.position_mm, "yaw_deg": yaw,
            "pitch_deg": pitch, "roll_deg": roll,
        },
        "blendshapes": BLENDSHAPES.into_iter().zip(values).collect::<BTreeMap<_, _>>(),
    })
}

const DIAGNOSTIC: (&str, &str) = ("entity_category", "diagnostic");

/// Home Assistant's entities: key, name, the last part of the topic, the field of its JSON, and what is special to it.
const ENTITIES: [(&str, &str, &str, Option<&str>, &[(&str, &str)]); 9] = [
    ("face", "Face", "face", None, &[("device_class", "occupancy")]),
    ("smile", "Smile", "smile", None, &[]),
    ("mouth_open", "Mouth open", "mouth_open", None, &[]),
    ("eyes_shut", "Eyes shut", "eyes_shut", None, &[]),
    ("problem", "Problem", "problem", None, &[("device_class", "problem"), DIAGNOSTIC]),
    ("state", "State", "state", Some("state"), &[DIAGNOSTIC]),
    ("reason", "Reason", "state", Some("reason"), &[DIAGNOSTIC]),
    ("rate", "Packet rate", "health", Some("packets_per_s"), &[("unit_of_measurement", "Hz"), DIAGNOSTIC]),
    ("lost", "Lost packets", "health", Some("lost"), &[("state_class", "total_increasing"), DIAGNOSTIC]),
];

/// What Home Assistant is told of a board: the topic and the payload.
fn discovery(namespace: &str, name: &str) -> (Retained, String) {
    let (id, version) = (format!("{namespace}_{name}"), env!("CARGO_PKG_VERSION"));
    let topic = |part: &str| format!("{namespace}/{name}/{part}");
    let component = |(key, title, part, field, special): (&str, &str, &str, Option<&str>, &[(&str, &str)])| {
        // While the bridge runs, a board that is away is a problem and not unknown.
        let of_board = !matches!(key, "problem" | "state" | "reason");
        let needed =
            [bridge_availability(namespace), topic("availability")].into_iter().take(1 + usize::from(of_board));
        let mut fields =
            serde_json::Map::from_iter(special.iter().map(|(key, value)| ((*key).to_owned(), json!(value))));
        fields.extend(field.map(|field| ("value_template".to_owned(), json!(format!("{{{{ value_json.{field} }}}}")))));
        let common = json!({
            "p": if field.is_some() { "sensor" } else { "binary_sensor" }, "name": title, "state_topic": topic(part),
            "unique_id": format!("{id}_{key}"), "availability_mode": "all",
            "availability": needed.map(|topic| json!({ "topic": topic })).collect::<Value>(),
        });
        fields.extend(common.as_object().cloned().unwrap_or_default());
        (key.to_owned(), Value::Object(fields))
    };
    let payload = json!({
        "dev": { "ids": [&id], "name": format!("{namespace} {name}"), "mf": "facewire", "sw": version },
        "o": { "name": "facewire-bridge", "sw": version },
        "cmps": serde_json::Map::from_iter(ENTITIES.map(component)),
    });
    (Retained::new(format!("{HOME_ASSISTANT}/device/{id}/config")), payload.to_string())
}

#[cfg(test)]
mod tests {
    use rumqttc::MqttOptions;

    use super::*;

    /// The only place in the queue is taken, so that whatever is to be sent finds no room.
    #[test]
    fn a_payload_is_sent_once_and_another_half_a_second_later_or_ten_seconds_of_health() {
        for (topic, at_least_ms) in [("facewire/left/smile", 500), ("facewire/left/health", 10_000)] {
            let (client, _events) = AsyncClient::new(MqttOptions::new("test", "localhost", 1883), 1);
            let mut retained = Retained::new(topic.to_owned());
            let begin = Instant::now();
            let mut is_sent =
                |payload: &str, ms: u64| retained.offer(payload, begin + Duration::from_millis(ms), &client);
            assert!(!is_sent("ON", 0), "there is room for the first");
            assert!(!is_sent("ON", 3_600_000), "it has not changed");
            assert!(!is_sent("OFF", at_least_ms - 1), "it is too early");
            assert!(is_sent("OFF", at_least_ms), "{topic}");
        }
    }
}
