//! VRChat, by the avatar parameters of VRCFaceTracking v2 and VRChat's own addresses for eyes.
//!
//! Only what has changed is sent, because VRChat takes each message on its main thread; and everything once a second,
//! because the wearer may change the avatar, or a datagram be lost.

mod parameters;

use std::time::{Duration, Instant};

use facewire_packet::State;
use rosc::{OscPacket, OscType};

use self::parameters::{Face, Group, PARAMETERS, Parameter};
use super::{
    Format, Output,
    gaze::Gaze,
    osc::{Bundles, message, set, set_bool},
};
use crate::config::{ParameterChoice, VrchatSettings};

/// Time after which everything is sent again.
const REFRESH: Duration = Duration::from_secs(1);
/// Smallest change that is sent: half a step of the 8 bits with which VRChat shows parameters to other players.
const STEP: f32 = 0.004;
/// The status of the tracking. These names have no prefix.
const STATUS: [&str; 3] = ["EyeTrackingActive", "ExpressionTrackingActive", "LipTrackingActive"];
/// From this value on, all bits of a binary parameter are set.
const FULL: f32 = 0.99999;

/// Returns the names of all parameters.
pub fn parameter_names() -> impl Iterator<Item = &'static str> {
    PARAMETERS.iter().map(|parameter| parameter.name)
}

/// The messages of an avatar.
#[derive(Debug)]
pub struct Vrchat {
    values: Vec<Value>,
    status: [Flag; STATUS.len()],
    native_eyes: Option<[Numbers; 2]>,
    bundles: Bundles,
    gaze: Gaze,
    refreshed: Option<Instant>,
}

impl Vrchat {
    pub fn new(settings: &VrchatSettings) -> Self {
        let wanted = PARAMETERS.iter().filter_map(|parameter| Value::new(parameter, settings));
        let native = [("/tracking/eye/EyesClosedAmount", 1), ("/tracking/eye/LeftRightPitchYaw", 4)];
        Self {
            values: wanted.collect(),
            status: STATUS.map(|name| Flag::new(format!("/avatar/parameters/{name}"))),
            native_eyes: settings.native_eyes.then(|| native.map(|(address, count)| Numbers::new(address, count))),
            bundles: Bundles::new(),
            gaze: Gaze::default(),
            refreshed: None,
        }
    }

    /// Encodes the output at a moment.
    fn encode_at(&mut self, now: Instant, output: &Output, send: &mut dyn FnMut(&[u8])) {
        let all = self.refreshed.is_none_or(|refreshed| now.duration_since(refreshed) >= REFRESH);
        if all {
            self.refreshed = Some(now);
        }
        self.gaze.follow(&output.pose.coefficients);
        let face = Face::new(&output.pose, &self.gaze);
        let is_tracked = matches!(output.state, State::Live | State::Hold);
        let mut out = Sink { all, bundles: &mut self.bundles, send };
        self.status.iter_mut().for_each(|flag| flag.follow(is_tracked, &mut out));
        self.values.iter_mut().for_each(|value| value.follow((value.compute)(&face), &mut out));
        if let Some([closed, direction]) = &mut self.native_eyes {
            let [left_blink, _, _, _, _, _, _, right_blink, ..] = output.pose.coefficients;
            closed.follow(&[0.5 * (left_blink + right_blink)], 1.0, &mut out);
            let angles = [self.gaze.left, self.gaze.right].map(|eye| [0.0 - eye.pitch, 0.0 - eye.yaw]);
            let [left, right] = angles.map(|eye| eye.map(f32::to_degrees));
            direction.follow([left, right].as_flattened(), 45.0, &mut out);
        }
        self.bundles.flush(send);
    }
}

impl Format for Vrchat {
    fn encode(&mut self, output: &Output, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        self.encode_at(Instant::now(), output, send);
    }
}

/// Bundles messages and sends the bundles.
struct Sink<'a, 'b> {
    /// Whether to send what has not changed, too.
    all: bool,
    bundles: &'a mut Bundles,
    send: &'a mut (dyn FnMut(&[u8]) + 'b),
}

impl Sink<'_, '_> {
    fn add(&mut self, message: &OscPacket) {
        self.bundles.add(message, self.send);
    }
}

/// A message with some numbers, and the numbers that were sent last.
#[derive(Debug)]
struct Numbers {
    message: OscPacket,
    sent: [f32; 4],
}

impl Numbers {
    /// A message with this number of values, none of which has been sent yet.
    fn new(address: &str, count: usize) -> Self {
        Self { message: message(address, vec![OscType::Float(0.0); count]), sent: [f32::NAN; 4] }
    }

    /// Sends the numbers if one has changed by a step of `scale`.
    fn follow(&mut self, numbers: &[f32], scale: f32, out: &mut Sink<'_, '_>) {
        let is_same = self.sent.iter().zip(numbers).all(|(sent, now)| (sent - now).abs() < STEP * scale);
        if out.all || !is_same {
            self.sent.iter_mut().zip(numbers).for_each(|(sent, now)| *sent = *now);
            set(&mut self.message, numbers);
            out.add(&self.message);
        }
    }
}

/// A message with a truth value, and the value that was sent last.
#[derive(Debug)]
struct Flag {
    message: OscPacket,
    sent: Option<bool>,
}

impl Flag {
    fn new(address: String) -> Self {
        Self { message: message(address, vec![OscType::Bool(false)]), sent: None }
    }

    fn follow(&mut self, value: bool, out: &mut Sink<'_, '_>) {
        if out.all || self.sent != Some(value) {
            self.sent = Some(value);
            set_bool(&mut self.message, value);
            out.add(&self.message);
        }
    }
}

/// A parameter as one number, as bits, or both.
#[derive(Debug)]
struct Value {
    compute: fn(&Face) -> f32,
    number: Option<Numbers>,
    /// The sign, and the bits from the lowest on.
    bits: Option<(Flag, Vec<Flag>)>,
}

impl Value {
    /// Returns `None` if the settings do not want the parameter.
    fn new(parameter: &Parameter, settings: &VrchatSettings) -> Option<Self> {
        let is_wanted = match parameter.group {
            Group::Shape => settings.shapes,
            Group::Compound => settings.compounds,
            Group::Head => settings.head,
        };
        let general = ParameterChoice { number: settings.floats, bits: settings.bits };
        let choice = settings.parameters.of(parameter.name, general);
        let ParameterChoice { number, bits } = choice.filter(|_| is_wanted || settings.parameters.names_any())?;
        let address = format!("/avatar/parameters/{}v2/{}", settings.prefix.as_str(), parameter.name);
        let flag = |ending: &str| Flag::new(format!("{address}{ending}"));
        let bits = (bits > 0)
            .then(|| (flag("Negative"), (0..bits).map(|bit| flag(&(1_u32 << bit).to_string())).collect::<Vec<_>>()));
        let number = number.then(|| Numbers::new(&address, 1));
        (number.is_some() || bits.is_some()).then_some(Self { compute: parameter.value, number, bits })
    }

    fn follow(&mut self, value: f32, out: &mut Sink<'_, '_>) {
        if let Some(number) = &mut self.number {
            number.follow(&[value], 1.0, out);
        }
        if let Some((negative, bits)) = &mut self.bits {
            let whole = binary(value, bits.len());
            negative.follow(value < 0.0, out);
            (0..).zip(bits).for_each(|(bit, flag)| flag.follow(whole >> bit & 1 == 1, out));
        }
    }
}

/// Returns the size of a value in this many bits.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the value lies from 0 to 1")]
fn binary(value: f32, bits: usize) -> u32 {
    let size = value.abs();
    if size > FULL { u32::MAX } else { (size * (1_u32 << bits.min(31)) as f32) as u32 }
}

#[cfg(test)]
mod tests;
