//! Packets as text.

use std::time::Instant;

pub use facewire_face::yaw_pitch_roll_deg;
use facewire_packet::{BLENDSHAPES, Packet, Reason};
use serde::{Serialize, Serializer};

use super::{
    receiver::Endpoint,
    tally::{Newest, Tally},
};

/// The number of coefficients that a line names.
const NAMED: usize = 4;
/// A line does not name smaller coefficients.
const NOTEWORTHY: f32 = 0.05;

/// A packet as a JSON object.
#[derive(Debug, Serialize)]
pub struct Json {
    from: Option<String>,
    state: &'static str,
    reason: &'static str,
    neutral_face: &'static str,
    sequence: u16,
    lost_before: u16,
    age_ms: f64,
    capture_us: u32,
    head_yaw_deg: f64,
    head_pitch_deg: f64,
    head_roll_deg: f64,
    head_mm: [f32; 3],
    coefficients: Coefficients,
}

/// Coefficients with their names, in the order of the packet.
#[derive(Debug)]
struct Coefficients([f32; BLENDSHAPES.len()]);

impl Serialize for Coefficients {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let values = self.0.iter().map(|value| rounded(*value, 1e5));
        serializer.collect_map(BLENDSHAPES.iter().zip(values))
    }
}

impl Json {
    /// Describes the newest packet of the tally.
    pub fn new(packet: &Packet, tally: &Tally) -> Self {
        let [yaw, pitch, roll] = yaw_pitch_roll_deg(packet.rotation).map(|deg| rounded(deg, 1e3));
        Self {
            from: tally.packets.newest.as_ref().map(|newest| newest.from.to_string()),
            state: packet.state.name(),
            reason: packet.reason.name(),
            neutral_face: packet.neutral_face.name(),
            sequence: packet.sequence,
            lost_before: tally.packets.newest.as_ref().map_or(0, |newest| newest.lost_before),
            age_ms: f64::from(packet.age_us) / 1000.0,
            capture_us: packet.capture_us,
            head_yaw_deg: yaw,
            head_pitch_deg: pitch,
            head_roll_deg: roll,
            head_mm: packet.position_mm,
            coefficients: Coefficients(packet.coefficients),
        }
    }
}

/// Rounds to the accuracy of the packet, and turns -0 into 0.
fn rounded(value: f32, steps: f64) -> f64 {
    (f64::from(value) * steps).round() / steps + 0.0
}

/// Names the state and the reason.
pub fn state(packet: &Packet) -> String {
    match packet.reason {
        Reason::None => packet.state.name().to_owned(),
        reason => format!("{}: {}", packet.state.name(), reason.name()),
    }
}

/// Describes the current state in one line.
pub fn line(listen: &Endpoint, tally: &Tally, now: Instant) -> String {
    let Some(Newest { packet, .. }) = tally.packets.newest.as_ref() else {
        return format!("waiting for packets at {listen}");
    };
    let counts = format!("lost {}  refused {}", tally.packets.lost, tally.packets.refused);
    if let Some(silence) = tally.packets.silence(now) {
        return format!("silent for {:.1} s  {counts}", silence.as_secs_f64());
    }
    let [yaw, pitch, roll] = yaw_pitch_roll_deg(packet.rotation);
    format!(
        "{}  {:.1} packets/s  {counts}  age {:.1} ms  neutral {}  yaw {yaw:.1} pitch {pitch:.1} roll {roll:.1}{}",
        state(packet),
        tally.packets.rate_hz(now),
        f64::from(packet.age_us) / 1000.0,
        packet.neutral_face.name(),
        strongest(packet)
    )
}

/// Names the strongest coefficients.
fn strongest(packet: &Packet) -> String {
    let mut named: Vec<_> = BLENDSHAPES.iter().zip(packet.coefficients).collect();
    named.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let noteworthy = named.iter().take(NAMED).filter(|(_, value)| *value >= NOTEWORTHY);
    let parts: Vec<String> = noteworthy.map(|(name, value)| format!("  {name} {value:.2}")).collect();
    parts.concat()
}

#[cfg(test)]
mod tests {
    use std::{net::SocketAddr, time::Duration};

    use facewire_packet::State;

    use super::*;

    /// A turn about one axis.
    fn about(axis: usize, degrees: f32) -> [f32; 4] {
        let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
        std::array::from_fn(|index| match index {
            3 => cos,
            index if index == axis => sin,
            _ => 0.0,
        })
    }

    fn near(got: [f32; 3], want: [f32; 3]) -> bool {
        got.iter().zip(want).all(|(got, want)| (got - want).abs() < 1e-3)
    }

    #[test]
    fn angles_have_the_signs_that_the_packet_defines() {
        assert!(near(yaw_pitch_roll_deg(about(1, 30.0)), [30.0, 0.0, 0.0]), "to the person's left");
        assert!(near(yaw_pitch_roll_deg(about(0, -20.0)), [0.0, 20.0, 0.0]), "up");
        assert!(near(yaw_pitch_roll_deg(about(2, 10.0)), [0.0, 0.0, 10.0]), "to the right shoulder");
    }

    #[test]
    fn json_names_every_coefficient_in_the_order_of_the_packet() {
        let mut tally = Tally::default();
        let mut packet = Packet { state: State::Hold, reason: Reason::Late, ..Packet::NEUTRAL };
        packet.coefficients = [0.25; 52];
        tally.count(&packet, Endpoint::Udp(SocketAddr::from(([127, 0, 0, 1], 7))), Instant::now());
        let text = serde_json::to_string(&Json::new(&packet, &tally)).unwrap_or_default();
        assert!(
            text.starts_with(
                r#"{"from":"127.0.0.1:7","state":"hold","reason":"late","neutral_face":"mean","sequence":0,"#
            ),
            "{text}"
        );
        assert!(text.ends_with(r#""noseSneerRight":0.25,"tongueOut":0.25}}"#), "{text}");
        assert_eq!(text.matches(":0.25").count(), 52);
    }

    #[test]
    fn the_line_shows_waiting_state_and_silence() {
        let listen = Endpoint::Udp(SocketAddr::from(([0, 0, 0, 0], 5252)));
        let now = Instant::now();
        let mut tally = Tally::default();
        assert_eq!(line(&listen, &tally, now), "waiting for packets at 0.0.0.0:5252");
        let mut packet = Packet { state: State::Live, age_us: 23_400, ..Packet::NEUTRAL };
        packet.coefficients[17] = 0.5;
        tally.count(&packet, listen.clone(), now);
        let want = "live  0.0 packets/s  lost 0  refused 0  age 23.4 ms  neutral mean  yaw 0.0 pitch 0.0 roll 0.0  jawOpen 0.50";
        assert_eq!(line(&listen, &tally, now), want);
        let later = now + Duration::from_millis(1500);
        assert_eq!(line(&listen, &tally, later), "silent for 1.5 s  lost 0  refused 0");
    }
}
