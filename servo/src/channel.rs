//! A channel: from the face to the position of one servo, and to its pulse.

use facewire_packet::{BLENDSHAPE_COUNT, BLENDSHAPES, Reason, State, yaw_pitch_roll_deg};

use crate::{Limits, dmx::Encoding, motion::Motion};

/// Angles of the head, degrees: yaw to the person's left, pitch upwards, roll to the person's right shoulder.
const ANGLES: [&str; 3] = ["headYaw", "headPitch", "headRoll"];
pub const SOURCE_COUNT: usize = BLENDSHAPE_COUNT + ANGLES.len();
/// The names of all sources: those of the coefficients, then those of the angles.
pub const SOURCE_NAMES: [&str; SOURCE_COUNT] = {
    let mut names = [""; SOURCE_COUNT];
    let (coefficients, angles) = names.split_at_mut(BLENDSHAPE_COUNT);
    coefficients.copy_from_slice(&BLENDSHAPES);
    angles.copy_from_slice(&ANGLES);
    names
};

/// Highest speed of a jog of a channel without a limit of its own: from one end to the other in 2 s. Whoever jogs may not
/// know yet where the servo binds.
const JOG_SPEED_PER_S: f32 = 0.5;

/// A number for each source. In the settings of a channel it is how much the source moves the channel: per unit of a
/// coefficient, and per degree of an angle.
pub type Sources = [f32; SOURCE_COUNT];

/// What a channel does once the face is lost and the channel is back at neutral. A released servo gets no more pulses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtLoss {
    Neutral,
    Release,
}

/// What moves a channel, and how far and how fast it goes.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelSettings {
    pub channel: u32,
    /// What people call the servo. It may be empty.
    pub name: String,
    pub sources: Sources,
    pub offset: f32,
    pub pulse_at_0_us: u32,
    pub pulse_at_1_us: u32,
    /// The ends of a bus servo, in place of pulses.
    pub position_at_0: f32,
    pub position_at_1: f32,
    /// Below 0 stands for the position of the neutral face.
    pub neutral: f32,
    /// 0 stands for no limit.
    pub speed_per_s: f32,
    pub acceleration_per_s2: f32,
    pub dead_zone: f32,
    pub loss: AtLoss,
    /// How DMX carries the pulse. Other boards ignore it.
    pub dmx: Encoding,
    /// The value that DMX carries while an operator has stopped the servos, if the link has [`AtStop::Value`](crate::dmx::AtStop).
    pub stop_value: u32,
}

impl Default for ChannelSettings {
    fn default() -> Self {
        Self {
            channel: 0,
            name: String::new(),
            sources: [0.0; SOURCE_COUNT],
            offset: 0.0,
            pulse_at_0_us: 1000,
            pulse_at_1_us: 2000,
            position_at_0: 0.0,
            position_at_1: 0.0,
            neutral: -1.0,
            speed_per_s: 0.0,
            acceleration_per_s2: 0.0,
            dead_zone: 0.0,
            loss: AtLoss::Neutral,
            dmx: Encoding::Bits8,
            stop_value: 0,
        }
    }
}

impl ChannelSettings {
    /// The number of the channel, and its name if it has one, such as "3 (left brow)".
    #[must_use]
    pub fn label(&self) -> String {
        let Self { channel, name, .. } = self;
        if name.is_empty() { channel.to_string() } else { format!("{channel} ({name})") }
    }

    pub fn used_sources(&self) -> impl Iterator<Item = (&'static str, f32)> {
        SOURCE_NAMES.into_iter().zip(self.sources).filter(|(_, gain)| *gain != 0.0)
    }

    pub(crate) fn limits(&self) -> Limits {
        let limit = |value| if value > 0.0 { value } else { f32::INFINITY };
        Limits { speed_per_s: limit(self.speed_per_s), acceleration_per_s2: limit(self.acceleration_per_s2) }
    }

    /// Returns the least and the greatest position that the sum can have before it is limited, for coefficients from 0 to 1
    /// and angles of the head up to 90 degrees.
    pub fn range(&self) -> [f32; 2] {
        let at = |end: fn(f32, f32) -> f32| {
            let term = |(name, gain): (&str, f32)| {
                if name.starts_with("head") { end(-90.0 * gain, 90.0 * gain) } else { end(0.0, gain) }
            };
            self.offset + self.used_sources().map(term).sum::<f32>()
        };
        [at(f32::min), at(f32::max)]
    }
}

/// Returns the coefficients, then the angles of the head in degrees.
pub fn values(rotation: [f32; 4], coefficients: &[f32; BLENDSHAPE_COUNT]) -> Sources {
    let (mut values, angles_deg) = ([0.0; SOURCE_COUNT], yaw_pitch_roll_deg(rotation));
    values.iter_mut().zip(coefficients.iter().chain(&angles_deg)).for_each(|(to, from)| *to = *from);
    values
}

#[derive(Debug, Clone)]
pub struct Channel {
    pub number: u16,
    pub limits: Limits,
    pub(crate) settings: ChannelSettings,
    neutral: f32,
    /// Both ends: pulses in microseconds, or steps of a bus servo. The end at 1 may be the lower one.
    pub(crate) ends: [f32; 2],
    pub(crate) target: f32,
    pub(crate) motion: Motion,
    is_released: bool,
    /// Whether the last pulse was the first one after none.
    is_first: bool,
    /// Where an operator wants the channel, and whether the operator wants it without pulses.
    pub(crate) jog: Option<f32>,
    pub(crate) is_off: bool,
    /// Whether the channel stays where it is, with or without pulses.
    pub(crate) is_still: bool,
}

impl Channel {
    pub fn new(settings: &ChannelSettings) -> Self {
        let neutral = if settings.neutral < 0.0 { settings.offset.clamp(0.0, 1.0) } else { settings.neutral };
        let (limits, number) = (settings.limits(), u16::try_from(settings.channel).unwrap_or_default());
        let ends = [settings.pulse_at_0_us as f32, settings.pulse_at_1_us as f32];
        let (settings, motion, target) = (settings.clone(), Motion::at(neutral), neutral);
        let (is_released, is_first, jog, is_off, is_still) = (false, false, None, false, false);
        Self { number, limits, settings, neutral, ends, target, motion, is_released, is_first, jog, is_off, is_still }
    }

    /// How far apart the ends are.
    pub fn span(&self) -> f32 {
        let [at_0, at_1] = self.ends;
        (at_1 - at_0).abs()
    }

    pub(crate) fn place(&self, position: f32) -> f32 {
        let [at_0, at_1] = self.ends;
        at_0 + (at_1 - at_0) * if position.is_nan() { 0.5 } else { position.clamp(0.0, 1.0) }
    }

    /// The position at which a servo is at this place. It is below 0 or above 1 beyond the ends.
    pub(crate) fn position_at(&self, place: f32) -> f32 {
        let [at_0, at_1] = self.ends;
        (place - at_0) / (at_1 - at_0)
    }

    /// Notes that the servo stands at this place. It goes on from there, or from the nearer end.
    pub fn rest_at(&mut self, place: f32) {
        let position = self.position_at(place);
        if !position.is_nan() {
            self.motion = Motion::at(position.clamp(0.0, 1.0));
        }
    }

    /// Follows the sources for `step_s`.
    pub(crate) fn step(&mut self, state: State, reason: Reason, values: &Sources, step_s: f32) {
        let is_lost = self.jog.is_none() && state == State::Neutral;
        if let Some(position) = self.jog {
            self.target = position.clamp(0.0, 1.0);
        } else if self.is_still {
            self.target = self.motion.position;
        } else if is_lost {
            self.target = self.neutral;
        } else if let Some(position) = self.position(values) {
            self.target = self.settled(position);
        }
        let was_released = self.is_released;
        if self.is_off {
            (self.is_released, self.is_first, self.motion) = (true, false, Motion::at(self.motion.position));
            return;
        }
        let mut limits = self.limits;
        if self.is_slowed() {
            limits.speed_per_s = limits.speed_per_s.min(JOG_SPEED_PER_S);
        }
        let position = self.motion.step(limits, self.target, step_s);
        // A service that stops has no time to wait for a slow servo.
        let has_arrived = position.to_bits() == self.target.to_bits() || reason == Reason::Stopping;
        if !self.is_still {
            self.is_released = is_lost && has_arrived && self.settings.loss == AtLoss::Release;
        }
        self.is_first = was_released && !self.is_released;
    }

    /// Whether [`JOG_SPEED_PER_S`] limits the channel, of which boards do not know.
    fn is_slowed(&self) -> bool {
        self.jog.is_some() && self.settings.speed_per_s <= 0.0
    }

    /// The place where the channel goes, for a board that moves there within the limits. The first place after none is
    /// where the servo was left, because the board would move it at once. `None` releases the servo.
    pub fn target_place(&self) -> Option<f32> {
        if self.is_first || self.is_slowed() {
            self.place_now()
        } else {
            (!self.is_released).then(|| self.place(self.target))
        }
    }

    /// The place where the channel is by now if it keeps its limits. `None` releases the servo.
    pub fn place_now(&self) -> Option<f32> {
        (!self.is_released).then(|| self.place(self.motion.position))
    }

    /// Returns the weighted sum of the sources, or `None` if they give no number.
    fn position(&self, values: &Sources) -> Option<f32> {
        let used = self.settings.sources.iter().zip(values).filter(|(gain, _)| **gain != 0.0);
        let sum = self.settings.offset + used.map(|(gain, value)| gain * value).sum::<f32>();
        (!sum.is_nan()).then(|| sum.clamp(0.0, 1.0))
    }

    /// Returns where the channel goes. The ends are always reached, so that a dead zone does not keep a lid from closing.
    fn settled(&self, position: f32) -> f32 {
        if position <= 0.0 || position >= 1.0 {
            return position;
        }
        let dead_zone = self.settings.dead_zone;
        self.target.clamp(position - dead_zone, position + dead_zone)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const STEP_S: f32 = 0.02;

    pub(crate) type Named<'a> = &'a [(&'a str, f32)];

    pub(crate) fn valued(sources: Named) -> Sources {
        let mut values = [0.0; SOURCE_COUNT];
        for (name, value) in sources {
            values[SOURCE_NAMES.iter().position(|source| source == name).unwrap()] = *value;
        }
        values
    }

    fn channel(sources: Named, offset: f32, dead_zone: f32, loss: AtLoss) -> Channel {
        let sources = valued(sources);
        Channel::new(&ChannelSettings { sources, offset, dead_zone, neutral: 0.5, loss, ..ChannelSettings::default() })
    }

    fn target(channel: &mut Channel, sources: Named) -> f32 {
        channel.step(State::Live, Reason::None, &valued(sources), STEP_S);
        channel.target
    }

    #[test]
    fn a_position_is_the_weighted_sum_of_coefficients_and_angles_of_the_head_in_degrees() {
        // 20 degrees about the vertical axis: the head turns to the person's left.
        let (sin, cos) = 10.0_f32.to_radians().sin_cos();
        let mut coefficients = [0.0; BLENDSHAPE_COUNT];
        (coefficients[17], coefficients[18], coefficients[51]) = (1.0, 0.6, f32::NAN);
        let values = values([0.0, sin, 0.0, cos], &coefficients);
        let mut jaw = channel(&[("jawOpen", 0.8), ("mouthClose", -0.5), ("headYaw", 0.01)], 0.1, 0.0, AtLoss::Neutral);
        jaw.step(State::Live, Reason::None, &values, STEP_S);
        assert!((jaw.target - 0.8).abs() < 1e-6, "{}: a source without a gain counts for nothing", jaw.target);
        for (jaw_open, want) in [(f32::INFINITY, 1.0), (f32::NAN, 1.0), (-1e30, 0.0), (f32::NAN, 0.0)] {
            assert_eq!(target(&mut jaw, &[("jawOpen", jaw_open)]), want, "what is no number changes nothing");
        }
    }

    #[test]
    fn pulses_may_run_backwards_and_never_leave_their_ends() {
        let settings = ChannelSettings { pulse_at_0_us: 2000, pulse_at_1_us: 1000, ..ChannelSettings::default() };
        let mut channel = Channel::new(&settings);
        for (position, pulse_us) in [(0.25, 1750.0), (f32::NAN, 1500.0), (-3.0, 2000.0), (f32::INFINITY, 1000.0)] {
            assert_eq!(channel.place(position), pulse_us);
        }
        for (pulse_us, position) in [(1750.0, 0.25), (f32::NAN, 0.25), (f32::INFINITY, 0.0), (-1e30, 1.0)] {
            channel.rest_at(pulse_us);
            assert_eq!(channel.motion, Motion::at(position));
        }
    }

    #[test]
    fn trembling_within_the_dead_zone_moves_nothing_and_the_ends_are_reached_nevertheless() {
        let mut lid = channel(&[("eyeBlinkLeft", 1.0)], 0.0, 0.02, AtLoss::Neutral);
        let mut blink = |value| target(&mut lid, &[("eyeBlinkLeft", value)]);
        let _begin = [0.3, 0.285, 0.315].map(&mut blink);
        let rest = blink(0.3);
        assert_eq!([0.285, 0.31, 0.3, 0.319].map(&mut blink), [rest; 4]);
        assert!((blink(0.4) - 0.38).abs() < 1e-6);
        assert_eq!([0.0, 1.0, 0.99].map(blink), [0.0, 1.0, 1.0]);
    }

    #[test]
    fn without_a_face_a_channel_goes_to_neutral_and_stays_there_or_is_released_when_it_has_arrived_or_must_stop() {
        let values = valued(&[("jawOpen", 1.0)]);
        for (loss, speed_per_s, reason, steps) in [
            (AtLoss::Neutral, f32::INFINITY, Reason::NoFace, None),
            (AtLoss::Release, f32::INFINITY, Reason::NoFace, Some(0)),
            // 0.5 s for half of the range.
            (AtLoss::Release, 1.0, Reason::NoFace, Some(25)),
            (AtLoss::Release, 1.0, Reason::Stopping, Some(0)),
        ] {
            let mut jaw = channel(&[("jawOpen", 1.0)], 0.0, 0.0, loss);
            for state in [State::Live, State::Hold, State::Decay] {
                jaw.step(state, Reason::None, &values, STEP_S);
                assert!(jaw.place_now().is_some(), "{state:?}");
            }
            assert_eq!(jaw.motion, Motion::at(1.0));
            jaw.limits.speed_per_s = speed_per_s;
            let found = (0..100_usize).find(|_| {
                jaw.step(State::Neutral, reason, &values, STEP_S);
                jaw.place_now().is_none()
            });
            assert!(found.zip(steps).map_or(found == steps, |(found, want)| found.abs_diff(want) < 2), "{steps:?}");
            assert!(jaw.target == 0.5 && (steps.is_some() || jaw.motion == Motion::at(0.5)));
        }
    }
}
