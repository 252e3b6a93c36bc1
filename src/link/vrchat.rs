//! VRChat, by the avatar parameters of VRCFaceTracking v2 and VRChat's own addresses for eyes.
//!
//! Only what has changed is sent, because VRChat takes each message on its main thread; and everything once a second,
//! because the wearer may change the avatar, or a datagram may be lost.

mod parameters;

use std::time::{Duration, Instant};

use facewire_packet::State;

use self::parameters::{Face, Formula, Group, PARAMETERS, Parameter};
use super::angles::Gaze;
use super::osc::{Bundles, Message};
use super::{Format, Output};
use crate::config::VrchatSettings;

const REFRESH: Duration = Duration::from_secs(1);
/// Smallest change that is sent: half a step of the 8 bits with which VRChat shows parameters to other players.
const STEP: f32 = 0.004;
/// Smallest change of an eye's angle that is sent, degrees.
const STEP_DEG: f32 = 45.0 * STEP;
/// The status of the tracking. These names have no prefix.
const STATUS: [&str; 3] = ["EyeTrackingActive", "ExpressionTrackingActive", "LipTrackingActive"];
const FULL: f32 = 0.99999;

pub fn parameter_names() -> impl Iterator<Item = &'static str> {
    PARAMETERS.iter().map(|parameter| parameter.name.as_str())
}

#[derive(Debug)]
pub struct Vrchat {
    entries: Vec<Entry>,
    bundles: Bundles,
    refreshed: Option<Instant>,
}

impl Vrchat {
    pub fn new(settings: &VrchatSettings) -> Self {
        let mut entries = Vec::new();
        for name in STATUS {
            let address = format!("/avatar/parameters/{name}");
            entries.push(Entry::truth(&address, Formula::IS_TRACKED, |value, _, _| value > 0.5, 0, 0));
        }
        PARAMETERS.iter().for_each(|parameter| add(&mut entries, parameter, settings));
        if settings.native_eyes {
            entries.push(Entry::number("/tracking/eye/EyesClosedAmount", &[Formula::EYES_CLOSED]));
            entries.push(Entry::number("/tracking/eye/LeftRightPitchYaw", &Formula::EYE_ANGLES_DEG));
        }
        Self { entries, bundles: Bundles::new(true), refreshed: None }
    }

    fn encode_at(&mut self, now: Instant, output: &Output, gaze: Gaze, send: &mut dyn FnMut(&[u8])) {
        let is_refreshed = self.refreshed.is_none_or(|refreshed| now.duration_since(refreshed) >= REFRESH);
        if is_refreshed {
            self.refreshed = Some(now);
        }
        let face = Face::new(&output.pose, gaze, matches!(output.state, State::Live | State::Hold));
        for entry in &mut self.entries {
            if entry.follow(&face, is_refreshed) {
                self.bundles.add(&entry.message, send);
            }
        }
        self.bundles.flush(send);
    }
}

impl Format for Vrchat {
    fn encode(&mut self, output: &Output, gaze: Gaze, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        self.encode_at(Instant::now(), output, gaze, send);
    }
}

/// Adds the parameter as one number, as bits, or both, if the settings want it.
fn add(entries: &mut Vec<Entry>, Parameter { name, group, formula }: &Parameter, settings: &VrchatSettings) {
    let is_wanted = match group {
        Group::Shape => settings.shapes,
        Group::Compound => settings.compounds,
        Group::Head => settings.head,
    };
    let choice = settings.parameters.of(name, (settings.floats, settings.bits));
    let Some((number, bits)) = choice.filter(|_| is_wanted || settings.parameters.names_any()) else { return };
    let address = format!("/avatar/parameters/{}v2/{name}", settings.prefix);
    if number {
        entries.push(Entry::number(&address, &[*formula]));
    }
    if bits > 0 {
        entries.push(Entry::truth(&format!("{address}Negative"), *formula, |value, _, _| value < 0.0, 0, 0));
    }
    for bit in 0..bits {
        entries.push(Entry::truth(&format!("{address}{}", 1_u32 << bit), *formula, has_bit, bits, bit));
    }
}

/// Whether bit number `bit` is set in the size of a value, coded in `bits` bits. From [`FULL`] on, all bits are set.
fn has_bit(value: f32, bits: u32, bit: u32) -> bool {
    let size = value.abs();
    let whole = if size > FULL { u32::MAX } else { (size * (1_u32 << bits.min(31)) as f32) as u32 };
    whole >> bit & 1 == 1
}

/// A message, and the numbers that were sent last. A truth value is 0 or 1.
#[derive(Debug)]
struct Entry {
    message: Message,
    formulas: Vec<Formula>,
    /// Makes a truth value of the number, with the number of bits and the bit that it stands for.
    truth: Option<(fn(f32, u32, u32) -> bool, u32, u32)>,
    sent: [f32; 4],
}

impl Entry {
    fn number(address: &str, formulas: &[Formula]) -> Self {
        let message = Message::new(address, &"f".repeat(formulas.len()), "", &[]);
        Self { message, formulas: formulas.to_vec(), truth: None, sent: [f32::NAN; 4] }
    }

    fn truth(address: &str, formula: Formula, is_true: fn(f32, u32, u32) -> bool, bits: u32, bit: u32) -> Self {
        let (message, truth) = (Message::new(address, "F", "", &[]), Some((is_true, bits, bit)));
        Self { message, formulas: vec![formula], truth, sent: [f32::NAN; 4] }
    }

    /// Takes the numbers of a face. Returns whether to send them: they are refreshed, or a step away from those before.
    fn follow(&mut self, face: &Face, is_refreshed: bool) -> bool {
        let mut numbers = [0.0; 4];
        numbers.iter_mut().zip(&self.formulas).for_each(|(number, formula)| *number = formula.value(face));
        if let (Some((is_true, bits, bit)), [number, ..]) = (self.truth, &mut numbers) {
            *number = is_true(*number, bits, bit).into();
        }
        let step = if self.formulas.len() > 1 { STEP_DEG } else { STEP };
        if !is_refreshed && self.sent.iter().zip(numbers).all(|(sent, now)| (sent - now).abs() < step) {
            return false;
        }
        self.sent = numbers;
        match self.truth {
            Some(_) => self.message.set_bool(numbers[0] > 0.5),
            None => self.message.set(numbers.get(..self.formulas.len()).unwrap_or_default()),
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rosc::OscType;

    use super::*;
    use crate::config::LinkKind;
    use crate::link::Pose;
    use crate::link::osc::received;
    use crate::link::testing::{encoded, face, kind, near};

    type Messages = BTreeMap<String, Vec<OscType>>;

    fn open(keys: &str) -> Vrchat {
        let LinkKind::Vrchat(settings) = kind("vrchat", keys) else { unreachable!() };
        Vrchat::new(&settings)
    }

    fn messages(format: &mut Vrchat, now: Instant, output: &Output) -> Messages {
        let (mut datagrams, mut gaze) = (Vec::new(), Gaze::default());
        gaze.follow(&output.pose.coefficients);
        format.encode_at(now, output, gaze, &mut |bytes| datagrams.push(bytes.to_vec()));
        received(&datagrams).into_iter().map(|message| (message.addr, message.args)).collect()
    }

    /// Returns what a new link with these settings sends first.
    fn first(keys: &str, output: &Output) -> Messages {
        messages(&mut open(keys), Instant::now(), output)
    }

    /// The documented bytes of `v2/JawOpen` = 0.5, and of a status that is true.
    #[test]
    fn messages_have_the_documented_bytes() {
        let bytes = encoded(&mut open(""), &face(&[("jawOpen", 0.5)])).concat();
        let jaw = b"\0\0\0\x28/avatar/parameters/v2/JawOpen\0\0\0,f\0\0\x3f\0\0\0";
        let status = b"\0\0\0\x2c/avatar/parameters/EyeTrackingActive\0\0\0\0,T\0\0";
        for wanted in [&jaw[..], status] {
            assert_eq!(bytes.windows(wanted.len()).filter(|window| *window == wanted).count(), 1, "{wanted:?}");
        }
    }

    #[test]
    fn parameters_follow_the_formulas_of_vrcfacetracking() {
        let smile = face(&[("mouthSmileLeft", 0.5), ("mouthFrownLeft", 0.1), ("mouthStretchLeft", 0.3)]);
        let brow = face(&[("browInnerUp", 0.5), ("browOuterUpLeft", 1.0), ("browDownLeft", 0.2)]);
        let lids = face(&[("eyeBlinkLeft", 0.2), ("eyeWideLeft", 0.4), ("eyeSquintRight", 0.3)]);
        let [mouth, jaw] = [[("mouthLeft", 0.3), ("jawRight", 0.7)], [("mouthClose", 0.5), ("jawOpen", 0.3)]];
        let mouth = face(&[&mouth[..], &jaw, &[("mouthFunnel", 0.4)]].concat());
        let lips = face(&[("mouthUpperUpLeft", 0.4), ("mouthLowerDownRight", 0.8), ("mouthRollUpper", 0.9)]);
        for (output, names, want) in [
            (&smile, ["MouthCornerPullLeft", "MouthCornerSlantLeft", "SmileFrownLeft"], [0.5, 0.5, 0.4]),
            (&smile, ["SmileSadLeft", "SmileFrown", "SmileFrownRight"], [0.2, 0.2, 0.0]),
            (&brow, ["BrowUpLeft", "BrowExpressionLeft", "BrowInnerUpRight"], [0.8, 0.55, 0.5]),
            (&lids, ["EyeLidLeft", "EyeOpenLeft", "EyeOpenRight"], [0.7, 0.8, 1.0]),
            (&lids, ["EyeClosed", "EyeWide", "EyesSquint"], [0.1, 0.4, 0.3]),
            (&mouth, ["MouthX", "JawX", "MouthClosed"], [-0.3, 0.7, 0.3]),
            (&mouth, ["LipFunnelUpperLeft", "LipFunnelLowerRight", "MouthUpperLeft"], [0.4, 0.4, 0.3]),
            // 1 - 0.4^(1/6)
            (&lips, ["MouthOpen", "LipSuckUpperLeft", "LipSuckUpperRight"], [0.3, 0.141_63, 0.9]),
        ] {
            let sent = first("", output);
            let found = names.map(|name| sent[&format!("/avatar/parameters/v2/{name}")][0].clone().float().unwrap());
            assert!(near(&found, &want), "{names:?} {found:?}");
        }
    }

    #[test]
    fn binary_parameters_have_a_sign_and_bits() {
        for (look, name, want) in [
            (("jawOpen", 0.63), "JawOpen", [false, true, false, true]),
            (("jawOpen", 1.0), "JawOpen", [false, true, true, true]),
            (("jawLeft", 0.5), "JawX", [true, false, false, true]),
        ] {
            let mut messages = first("bits = 3\nfloats = false\n", &face(&[look]));
            let sent = ["Negative", "1", "2", "4", "", "8"]
                .map(|ending| messages.remove(&format!("/avatar/parameters/v2/{name}{ending}")));
            let want = want.map(|bit| Some(vec![OscType::Bool(bit)]));
            assert_eq!(sent[..], [&want[..], &[None, None]].concat());
        }
    }

    #[test]
    fn a_list_of_parameters_limits_what_is_sent() {
        let messages = first("parameters = \"JawOpen, SmileFrown:2\"\nprefix = \"FT/\"\n", &face(&[]));
        let addresses: Vec<_> = messages.keys().filter_map(|it| it.strip_prefix("/avatar/parameters/")).collect();
        let mut want = STATUS.to_vec();
        want.extend(["FT/v2/JawOpen", "FT/v2/SmileFrown1", "FT/v2/SmileFrown2", "FT/v2/SmileFrownNegative"]);
        want.sort_unstable();
        assert_eq!(addresses, want);
    }

    #[test]
    fn only_changes_are_sent_and_everything_once_a_second_and_the_status_is_false_without_a_face() {
        let (mut format, begun, all) = (open(""), Instant::now(), STATUS.len() + PARAMETERS.len());
        for (ms, state, jaw_open, count, status) in [
            (0, State::Live, 0.0, all, Some(true)),
            (16, State::Hold, 0.0, 0, None),
            (33, State::Live, 0.1, 1, None),
            // Less than a step.
            (999, State::Live, 0.103, 0, None),
            (1000, State::Live, 0.103, all, Some(true)),
            (1016, State::Decay, 0.103, STATUS.len(), Some(false)),
        ] {
            let output = Output { state, ..face(&[("jawOpen", jaw_open)]) };
            let messages = messages(&mut format, begun + Duration::from_millis(ms), &output);
            let found =
                messages.get("/avatar/parameters/EyeTrackingActive").map(|value| value[0] == OscType::Bool(true));
            assert_eq!((messages.len(), found), (count, status), "{ms} ms");
        }
    }

    #[test]
    fn every_value_lies_between_minus_1_and_1() {
        for extreme in [0.0, 1.0] {
            let pose = Pose { coefficients: [extreme; 52], rotation: [0.0, 1.0, 0.0, 0.0], ..Pose::NEUTRAL };
            for (address, arguments) in first("", &Output { pose, ..face(&[]) }) {
                let value = arguments[0].clone().float().unwrap_or_default();
                let most = if address.contains("Head") { 2.0 } else { 1.0 };
                assert!(value.abs() <= most, "{address} {value}");
            }
        }
    }
}
