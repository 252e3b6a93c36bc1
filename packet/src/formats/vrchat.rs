//! VRChat, by the avatar parameters of VRCFaceTracking v2 and VRChat's own addresses for eyes.
//!
//! Only what has changed is sent, because VRChat takes each message on its main thread; and everything once a second,
//! because the wearer may change the avatar, or a datagram may be lost.

mod parameters;

use std::time::Duration;

use self::parameters::Face;
pub use self::parameters::{Group, PARAMETERS, Parameter};
use super::angles::Gaze;
use super::osc::{Bundles, Message};
use crate::Packet;

const REFRESH: Duration = Duration::from_secs(1);
/// Smallest change that is sent: half a step of the 8 bits with which VRChat shows parameters to other players.
const STEP: f32 = 0.004;
/// Smallest change of an eye's angle that is sent, degrees.
const STEP_DEG: f32 = 45.0 * STEP;
const EYE_STATUS: &str = "EyeTrackingActive";
/// The status of the tracking. These names have no prefix.
const STATUS: [&str; 3] = [EYE_STATUS, "ExpressionTrackingActive", "LipTrackingActive"];
const FULL: f32 = 0.99999;

/// How a parameter is sent. The default is not at all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Form {
    /// Whether it is sent as one number.
    pub number: bool,
    /// As how many truth values it is sent, each a bit of the number, besides one for its sign.
    pub bits: u32,
}

/// Where lids and gaze go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Eyes {
    /// Nowhere: another program sends the eyes that a headset tracks.
    Nowhere,
    /// To the parameters of the avatar.
    Parameters,
    /// To VRChat's own addresses, too.
    Native,
}

/// Writes the messages that have changed.
pub struct Vrchat {
    entries: Vec<Entry>,
    bundles: Bundles,
    refreshed: Option<Duration>,
    gaze: Gaze,
}

impl Vrchat {
    /// Makes the format. `prefix` stands before the name of each parameter, and `form_of` says how each is sent,
    /// except those of eyes that go nowhere.
    pub fn new(prefix: &str, eyes: Eyes, form_of: impl Fn(&Parameter) -> Form) -> Self {
        let mut entries = Vec::new();
        let is_sent = |is_of_eyes: bool| eyes != Eyes::Nowhere || !is_of_eyes;
        for name in STATUS.into_iter().filter(|name| is_sent(*name == EYE_STATUS)) {
            let address = format!("/avatar/parameters/{name}");
            entries.push(Entry::truth(&address, |face| face.is_tracked));
        }
        for parameter in PARAMETERS.iter().filter(|parameter| is_sent(parameter.is_of_eyes())) {
            add(&mut entries, parameter, prefix, form_of(parameter));
        }
        if eyes == Eyes::Native {
            entries.push(Entry::new("/tracking/eye/EyesClosedAmount", "f", |face| [face.eyes_closed(), 0.0, 0.0, 0.0]));
            entries.push(Entry::new("/tracking/eye/LeftRightPitchYaw", "ffff", Face::eye_angles_deg));
        }
        Self { entries, bundles: Bundles::new(true), refreshed: None, gaze: Gaze::default() }
    }

    /// Sends what has changed at this time since the format was made.
    pub fn encode(&mut self, packet: &Packet, now: Duration, send: &mut dyn FnMut(&[u8])) {
        self.gaze.follow(&packet.coefficients);
        let is_refreshed = self.refreshed.is_none_or(|refreshed| now.saturating_sub(refreshed) >= REFRESH);
        if is_refreshed {
            self.refreshed = Some(now);
        }
        let face = Face::new(packet, self.gaze);
        for entry in &mut self.entries {
            if entry.follow(&face, is_refreshed) {
                self.bundles.add(&entry.message, send);
            }
        }
        self.bundles.flush(send);
    }
}

/// The parameters that a link sends, each as a number or with its count of bits. An empty list stands for all.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Parameters(Vec<(String, u32)>);

/// Most bits of a binary parameter.
pub const MOST_BITS: u32 = 8;

impl Parameters {
    /// Describes for error messages what [`Parameters::parse`] accepts.
    pub const EXPECTED: &'static str = "\"\", or names of parameters of VRCFaceTracking v2 with commas between them, each \
                                        with up to 8 bits, such as \"JawOpen, SmileFrown:4\"";

    /// Reads names with commas between them, each with a colon and its bits if it is binary. Returns `None` for bits that
    /// are not a number from 0 to [`MOST_BITS`]. Whether names exist is not judged.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let entry = |entry: &str| {
            let (name, bits) = entry.split_once(':').unwrap_or((entry, "0"));
            Some((name.to_owned(), bits.parse().ok().filter(|bits| *bits <= MOST_BITS)?))
        };
        let entries = text.split(',').map(str::trim).filter(|entry| !entry.is_empty());
        entries.map(entry).collect::<Option<_>>().map(Self)
    }

    /// Whether the list names any parameter. An empty list stands for all.
    #[must_use]
    pub fn names_any(&self) -> bool {
        !self.0.is_empty()
    }

    /// Returns the names in their order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|(name, _)| name.as_str())
    }

    /// Returns the form of this parameter, which is empty if it is not listed; `None` if the list is empty.
    #[must_use]
    pub fn form_of(&self, name: &str) -> Option<Form> {
        let named = self.0.iter().find(|(named, _)| *named == name);
        let form = named.map(|(_, bits)| Form { number: *bits == 0, bits: *bits });
        self.names_any().then(|| form.unwrap_or_default())
    }
}

fn add(entries: &mut Vec<Entry>, parameter: &'static Parameter, prefix: &str, Form { number, bits }: Form) {
    let address = format!("/avatar/parameters/{prefix}v2/{}", parameter.name);
    if number {
        entries.push(Entry::new(&address, "f", |face| [parameter.value(face), 0.0, 0.0, 0.0]));
    }
    if bits > 0 {
        entries.push(Entry::truth(&format!("{address}Negative"), |face| parameter.value(face) < 0.0));
    }
    for bit in 0..bits {
        let address = format!("{address}{}", 1_u32 << bit);
        entries.push(Entry::truth(&address, move |face| has_bit(parameter.value(face), bits, bit)));
    }
}

/// Whether bit number `bit` is set in the size of a value, coded in `bits` bits. From [`FULL`] on, all bits are set.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a size from 0 to 1 in at most 31 bits")]
fn has_bit(value: f32, bits: u32, bit: u32) -> bool {
    let size = value.abs();
    let whole = if size > FULL { u32::MAX } else { (size * (1_u32 << bits.min(31)) as f32) as u32 };
    whole >> bit & 1 == 1
}

/// A message with up to four numbers, what they are for a face, and what was sent last. A truth value is 0 or 1.
struct Entry {
    message: Message,
    /// The types of the arguments.
    types: &'static str,
    numbers: Box<dyn Fn(&Face) -> [f32; 4] + Send>,
    sent: [f32; 4],
}

impl Entry {
    fn new(address: &str, types: &'static str, numbers: impl Fn(&Face) -> [f32; 4] + Send + 'static) -> Self {
        Self { message: Message::new(address, types, "", &[]), types, numbers: Box::new(numbers), sent: [f32::NAN; 4] }
    }

    fn truth(address: &str, is_true: impl Fn(&Face) -> bool + Send + 'static) -> Self {
        Self::new(address, "F", move |face| [is_true(face).into(), 0.0, 0.0, 0.0])
    }

    /// Takes the numbers of a face. Returns whether to send them: they are refreshed, or a step away from those before.
    fn follow(&mut self, face: &Face, is_refreshed: bool) -> bool {
        let (numbers, count) = ((self.numbers)(face), self.types.len());
        let step = if count > 1 { STEP_DEG } else { STEP };
        if !is_refreshed && self.sent.iter().zip(numbers).all(|(sent, now)| (sent - now).abs() < step) {
            return false;
        }
        self.sent = numbers;
        if self.types == "F" {
            self.message.set_bool(numbers[0] > 0.5);
        } else {
            self.message.set(numbers.get(..count).unwrap_or_default());
        }
        true
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
mod tests {
    use std::collections::BTreeMap;

    use rosc::OscType;

    use super::super::osc::received;
    use super::super::testing::{face, near, sent};
    use super::*;
    use crate::State;

    type Messages = BTreeMap<String, Vec<OscType>>;

    const NUMBERS: Form = Form { number: true, bits: 0 };

    fn messages(format: &mut Vrchat, now_ms: u64, packet: &Packet) -> Messages {
        let datagrams = sent(|send| format.encode(packet, Duration::from_millis(now_ms), send));
        received(&datagrams).into_iter().map(|message| (message.addr, message.args)).collect()
    }

    /// Returns what a new format sends first.
    fn first(prefix: &str, form_of: impl Fn(&Parameter) -> Form, packet: &Packet) -> Messages {
        messages(&mut Vrchat::new(prefix, Eyes::Parameters, form_of), 0, packet)
    }

    #[test]
    fn parameters_follow_the_formulas_of_vrcfacetracking() {
        let smile = face(&[("mouthSmileLeft", 0.5), ("mouthFrownLeft", 0.1), ("mouthStretchLeft", 0.3)]);
        let brow = face(&[("browInnerUp", 0.5), ("browOuterUpLeft", 1.0), ("browDownLeft", 0.2)]);
        let eyes = face(&[("eyeBlinkLeft", 0.2), ("eyeWideLeft", 0.4), ("eyeSquintRight", 0.3)]);
        let [mouth, jaw] = [[("mouthLeft", 0.3), ("jawRight", 0.7)], [("mouthClose", 0.5), ("jawOpen", 0.3)]];
        let mouth = face(&[&mouth[..], &jaw, &[("mouthFunnel", 0.4)]].concat());
        let lips = face(&[("mouthUpperUpLeft", 0.4), ("mouthLowerDownRight", 0.8), ("mouthRollUpper", 0.9)]);
        for (packet, names, want) in [
            (&smile, ["MouthCornerPullLeft", "MouthCornerSlantLeft", "SmileFrownLeft"], [0.5, 0.5, 0.4]),
            (&smile, ["SmileSadLeft", "SmileFrown", "SmileFrownRight"], [0.2, 0.2, 0.0]),
            (&brow, ["BrowUpLeft", "BrowExpressionLeft", "BrowInnerUpRight"], [0.8, 0.55, 0.5]),
            (&eyes, ["EyeLidLeft", "EyeOpenLeft", "EyeOpenRight"], [0.7, 0.8, 1.0]),
            (&eyes, ["EyeClosed", "EyeWide", "EyesSquint"], [0.1, 0.4, 0.3]),
            (&mouth, ["MouthX", "JawX", "MouthClosed"], [-0.3, 0.7, 0.3]),
            (&mouth, ["LipFunnelUpperLeft", "LipFunnelLowerRight", "MouthUpperLeft"], [0.4, 0.4, 0.3]),
            // 1 - 0.4^(1/6)
            (&lips, ["MouthOpen", "LipSuckUpperLeft", "LipSuckUpperRight"], [0.3, 0.141_63, 0.9]),
        ] {
            let sent = first("", |_| NUMBERS, packet);
            let found = names.map(|name| sent[&format!("/avatar/parameters/v2/{name}")][0].clone().float().unwrap());
            assert!(near(&found, &want), "{names:?} {found:?}");
        }
        for extreme in [0.0, 1.0] {
            let look = crate::BLENDSHAPES.map(|name| (name, extreme));
            let numbers =
                first("", |_| NUMBERS, &face(&look)).into_values().filter_map(|value| value[0].clone().float());
            assert!(numbers.into_iter().all(|number| number.abs() <= 1.0), "{extreme}");
        }
    }

    #[test]
    fn binary_parameters_have_a_sign_and_bits_and_a_list_limits_what_is_sent() {
        let bits = |bits| Form { number: false, bits };
        let (all, jaw): (fn(&_) -> _, fn(&_) -> _) =
            (|_| 3, |parameter: &Parameter| if parameter.name == "JawOpen" { 2 } else { 0 });
        for (bits_of, prefix, look, name, set, count) in [
            (all, "", ("jawOpen", 0.63), "v2/JawOpen", ["1", "4"].as_slice(), 4),
            (all, "", ("jawOpen", 1.0), "v2/JawOpen", &["1", "2", "4"], 4),
            (all, "", ("jawLeft", 0.5), "v2/JawX", &["4", "Negative"], 4),
            (jaw, "FT/", ("jawOpen", 0.5), "FT/v2/JawOpen", &["2"], 3),
            (jaw, "", ("jawLeft", 1.0), "v2/JawX", &[], 0),
        ] {
            let sent = first(prefix, |parameter| bits(bits_of(parameter)), &face(&[look]));
            let endings = sent.iter().filter_map(|(address, value)| {
                Some((address.strip_prefix("/avatar/parameters/")?.strip_prefix(name)?, value[0].clone().bool()?))
            });
            assert_eq!(endings.clone().count(), count, "{name}");
            assert_eq!(endings.filter(|(_, bit)| *bit).map(|(ending, _)| ending).collect::<Vec<_>>(), set, "{name}");
        }
    }

    #[test]
    fn eyes_that_a_headset_tracks_are_not_sent_and_nothing_else_is_missing() {
        let sent = |eyes| messages(&mut Vrchat::new("FT/", eyes, |_| Form { number: true, bits: 2 }), 0, &face(&[]));
        let (native, nowhere) = (sent(Eyes::Native), sent(Eyes::Nowhere));
        let missing: Vec<&str> =
            native.keys().filter(|name| !nowhere.contains_key(*name)).map(String::as_str).collect();
        let is_of_eyes = |name: &&str| {
            let begins = ["parameters/EyeTracking", "parameters/FT/v2/Eye"].map(|begin| format!("/avatar/{begin}"));
            name.starts_with("/tracking/eye/") || begins.iter().any(|begin| name.starts_with(begin.as_str()))
        };
        assert_eq!(missing, native.keys().map(String::as_str).filter(is_of_eyes).collect::<Vec<_>>());
        // Lids and gaze as a number and three truth values each, the status, and two native addresses.
        assert_eq!(missing.len(), 4 * 22 + 1 + 2, "{missing:?}");
    }

    #[test]
    fn only_changes_are_sent_and_everything_once_a_second_and_the_status_is_false_without_a_face() {
        let (mut format, all) = (Vrchat::new("", Eyes::Parameters, |_| NUMBERS), STATUS.len() + PARAMETERS.len());
        for (ms, state, jaw_open, count, status) in [
            (0, State::Live, 0.0, all, Some(true)),
            (16, State::Hold, 0.0, 0, None),
            (33, State::Live, 0.1, 1, None),
            // Less than a step.
            (999, State::Live, 0.103, 0, None),
            (1000, State::Live, 0.103, all, Some(true)),
            (1016, State::Decay, 0.103, STATUS.len(), Some(false)),
        ] {
            let messages = messages(&mut format, ms, &Packet { state, ..face(&[("jawOpen", jaw_open)]) });
            let found =
                messages.get("/avatar/parameters/EyeTrackingActive").map(|value| value[0] == OscType::Bool(true));
            assert_eq!((messages.len(), found), (count, status), "{ms} ms");
        }
    }
}
