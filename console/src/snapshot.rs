//! What the pages show: the newest packet and the counts.

use std::{sync::Arc, time::Instant};

use facewire_packet::{DecodeError, Packet, Visibility};
use serde::{Serialize, Serializer};

/// Who sent a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sender {
    /// A UDP address.
    Udp(std::net::SocketAddr),
    /// The other end of the serial line.
    Line,
    /// The service on this machine, by its control socket.
    Service,
}

pub type Tally = facewire_packet::Tally<Sender>;
type Newest = facewire_packet::Newest<Sender>;

/// The counts, as shown.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    packets: u64,
    lost: u64,
    refused: u64,
    rate_hz: f64,
    fault: Option<DecodeError>,
    rival: Option<Sender>,
}

/// The newest packet and the counts at one time.
#[derive(Debug, Clone, Default)]
pub struct Snapshot {
    /// Why nothing can arrive, such as a serial port that is not plugged in.
    trouble: Option<Arc<str>>,
    counts: Counts,
    newest: Option<Newest>,
}

impl Snapshot {
    /// Returns what the tally knows.
    pub fn of(tally: &Tally, now: Instant) -> Self {
        let Tally { packets, lost, refused, fault, newest, .. } = *tally;
        let counts =
            Counts { packets, lost, refused, fault, rate_hz: tally.rate_hz(now), rival: tally.rival(now).copied() };
        Self { trouble: None, counts, newest }
    }

    /// Adds why nothing can arrive.
    pub fn with_trouble(self, trouble: Option<&str>) -> Self {
        Self { trouble: trouble.map(Into::into), ..self }
    }

    /// Returns the snapshot as JSON. Its times count from `start`.
    pub fn to_json(&self, start: Instant, now: Instant) -> String {
        let counts = &self.counts;
        let json = Json {
            trouble: self.trouble.as_deref(),
            packets: counts.packets,
            lost: counts.lost,
            refused: counts.refused,
            rate_hz: rounded(counts.rate_hz, 1e1),
            fault: counts.fault.map(|fault| fault.to_string()),
            rival: counts.rival.map(name),
            packet: self.newest.map(|newest| PacketJson::new(&newest, counts, start, now)),
        };
        // Numbers and strings always become JSON.
        serde_json::to_string(&json).unwrap_or_default()
    }
}

#[derive(Debug, Serialize)]
struct Json<'a> {
    trouble: Option<&'a str>,
    packets: u64,
    lost: u64,
    refused: u64,
    rate_hz: f64,
    fault: Option<String>,
    rival: Option<String>,
    packet: Option<PacketJson>,
}

/// The newest packet. The coefficients are in the order of the packet.
#[derive(Debug, Serialize)]
struct PacketJson {
    /// Its place among all packets that were sent since the program started, as far as is known.
    number: u64,
    /// The time of its arrival.
    time_s: f64,
    /// Time since then.
    since_ms: f64,
    from: String,
    state: &'static str,
    reason: &'static str,
    neutral_face: &'static str,
    #[serde(serialize_with = "with_parts")]
    visibility: Visibility,
    age_ms: f64,
    rotation: [f64; 4],
    angles_deg: [f64; 3],
    position_mm: [f32; 3],
    coefficients: Vec<f64>,
}

impl PacketJson {
    fn new(newest: &Newest, counts: &Counts, start: Instant, now: Instant) -> Self {
        let Newest { packet, from, at, .. } = newest;
        Self {
            number: counts.packets + counts.lost,
            time_s: rounded(at.saturating_duration_since(start).as_secs_f64(), 1e6),
            since_ms: rounded(now.saturating_duration_since(*at).as_secs_f64() * 1e3, 1e1),
            from: name(*from),
            state: packet.state.name(),
            reason: packet.reason.name(),
            neutral_face: packet.neutral_face.name(),
            visibility: packet.visibility,
            age_ms: f64::from(packet.age_us) / 1e3,
            rotation: packet.rotation.map(|part| rounded(part.into(), 1e5)),
            angles_deg: angles_deg(packet),
            position_mm: packet.position_mm,
            coefficients: packet.coefficients.iter().map(|value| rounded((*value).into(), 1e5)).collect(),
        }
    }
}

fn name(sender: Sender) -> String {
    match sender {
        Sender::Udp(address) => std::net::SocketAddr::new(address.ip().to_canonical(), address.port()).to_string(),
        Sender::Line => "the serial line".to_owned(),
        Sender::Service => "the service".to_owned(),
    }
}

fn with_parts<S: Serializer>(visibility: &Visibility, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(visibility.parts().map(|(part, value)| (part, rounded(value.into(), 1e2))))
}

/// Rounds to the accuracy of the packet, and turns -0 into 0.
fn rounded(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps + 0.0
}

/// Returns yaw, pitch and roll in degrees: yaw is positive to the person's left, pitch upwards, roll to the person's
/// right shoulder. The rotation is `Rz(roll) Rx(-pitch) Ry(yaw)`, as facewire composes it.
fn angles_deg(packet: &Packet) -> [f64; 3] {
    let [x, y, z, w] = packet.rotation.map(f64::from);
    // The columns of the rotation matrix are the axes of the head: left, up and forward, which is out of the face.
    let (left_z, forward_z) = (2.0 * (x * z - w * y), 1.0 - 2.0 * (x * x + y * y));
    let (up_x, up_y, up_z) = (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x));
    let (yaw, pitch, roll) = ((-left_z).atan2(forward_z), -up_z.clamp(-1.0, 1.0).asin(), (-up_x).atan2(up_y));
    [yaw, pitch, roll].map(|radians| rounded(radians.to_degrees(), 1e3))
}

#[cfg(test)]
mod tests {
    use facewire_packet::State;

    use super::*;

    /// The half-angle quaternion about one axis.
    fn about(axis: usize, degrees: f32) -> [f32; 4] {
        let half = degrees.to_radians() / 2.0;
        let mut rotation = [0.0, 0.0, 0.0, half.cos()];
        rotation[axis] = half.sin();
        rotation
    }

    #[test]
    fn angles_have_the_signs_of_the_packet() {
        let angles = |rotation| angles_deg(&Packet { rotation, ..Packet::NEUTRAL });
        for (rotation, want) in [
            (Packet::NEUTRAL.rotation, [0.0; 3]),
            (about(1, 30.0), [30.0, 0.0, 0.0]),
            (about(0, -20.0), [0.0, 20.0, 0.0]),
            (about(2, 10.0), [0.0, 0.0, 10.0]),
        ] {
            assert!(angles(rotation).iter().zip(want).all(|(is, want)| (is - want).abs() < 0.01), "{rotation:?}");
        }
    }

    #[test]
    fn the_json_shows_the_packet_and_the_counts() {
        let (mut tally, at) = (Tally::default(), Instant::now());
        let mut packet = Packet { state: State::Live, age_us: 20_000, ..Packet::NEUTRAL };
        packet.coefficients[17] = 0.5;
        packet.visibility.mouth = 0.2;
        tally.count(&packet, Sender::Udp(([127, 0, 0, 1], 9).into()), at);
        tally.refuse(facewire_packet::DecodeError::Checksum);
        let json: serde_json::Value = serde_json::from_str(&Snapshot::of(&tally, at).to_json(at, at)).unwrap();
        assert_eq!(json["packet"]["coefficients"][17], 0.5);
        assert_eq!(json["packet"]["state"], "live");
        assert_eq!(
            (&json["packet"]["visibility"]["mouth"], &json["packet"]["visibility"]["brows"]),
            (&0.2.into(), &1.0.into())
        );
        assert_eq!(json["packet"]["from"], "127.0.0.1:9");
        assert_eq!(json["packet"]["age_ms"], 20.0);
        assert_eq!((&json["packets"], &json["refused"]), (&1.into(), &1.into()));
        assert!(json["fault"].as_str().unwrap().contains("checksum"), "{json}");
    }
}
