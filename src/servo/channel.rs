//! One channel of a servo board: from the face to a position, and from a position to a pulse.

use facewire_packet::{Reason, State};

use super::motion::{Limits, Motion};
use super::sources::Gains;
use crate::config::ChannelSettings;
use crate::link::Output;

/// The pulses at both ends of a channel, microseconds. The end at 1 may have the shorter pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ends {
    /// Pulse at position 0.
    pub at_0_us: f32,
    /// Pulse at position 1.
    pub at_1_us: f32,
}

impl Ends {
    /// Returns the pulse at a position.
    #[must_use]
    pub fn pulse_us(self, position: f32) -> f32 {
        let position = if position.is_nan() { 0.5 } else { position.clamp(0.0, 1.0) };
        self.at_0_us + (self.at_1_us - self.at_0_us) * position
    }

    /// How far the pulse changes from end to end, microseconds.
    #[must_use]
    pub fn span_us(self) -> f32 {
        (self.at_1_us - self.at_0_us).abs()
    }
}

/// What a channel does once the face is lost and has moved to neutral.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtLoss {
    /// It holds its neutral position.
    Neutral,
    /// It goes to its neutral position, and its servo then gets no more pulses.
    Release,
}

/// How the position of a channel follows the face.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    /// The weight of each source.
    pub gains: Gains,
    /// The position if all sources are 0.
    pub offset: f32,
    /// Changes of the position up to this size are ignored.
    pub dead_zone: f32,
    /// The position without a face.
    pub neutral: f32,
}

impl Mapping {
    /// Returns the position for these values of the sources, or `None` if they give no number.
    fn position(&self, values: &Gains) -> Option<f32> {
        let products =
            self.gains.iter().zip(values).filter(|(gain, _)| **gain != 0.0).map(|(gain, value)| gain * value);
        let sum = self.offset + products.sum::<f32>();
        (!sum.is_nan()).then(|| sum.clamp(0.0, 1.0))
    }

    /// Returns where a channel that is held at `held` goes. The ends are always reached, so that a dead zone does not keep
    /// a lid from closing.
    fn settled(&self, held: f32, position: f32) -> f32 {
        if position <= 0.0 || position >= 1.0 {
            return position;
        }
        held.clamp(position - self.dead_zone, position + self.dead_zone)
    }
}

/// What a channel is to do now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Where the channel goes.
    pub target: f32,
    /// Where it is by now if the servo keeps up.
    pub position: f32,
    /// Whether the servo gets no pulses.
    pub is_released: bool,
}

/// A channel and its motion.
#[derive(Debug, Clone)]
pub struct Channel {
    /// Its number on the board.
    pub number: u8,
    /// The pulses at its ends.
    pub ends: Ends,
    /// Its limits.
    pub limits: Limits,
    mapping: Mapping,
    loss: AtLoss,
    target: f32,
    motion: Motion,
}

impl Channel {
    /// A channel that rests at its neutral position.
    #[must_use]
    pub fn new(settings: &ChannelSettings) -> Self {
        let number = u8::try_from(settings.servo.channel).unwrap_or_default();
        let (mapping, loss) = (settings.mapping(), settings.servo.loss);
        let (target, motion) = (mapping.neutral, Motion::at(mapping.neutral));
        Self { number, ends: settings.ends(), limits: settings.limits(), mapping, loss, target, motion }
    }

    /// Follows the output, whose sources have these values, for `step_s`.
    pub fn step(&mut self, output: &Output, values: &Gains, step_s: f32) -> Step {
        let is_lost = output.state == State::Neutral;
        if is_lost {
            self.target = self.mapping.neutral;
        } else if let Some(position) = self.mapping.position(values) {
            self.target = self.mapping.settled(self.target, position);
        }
        let position = self.motion.step(self.limits, self.target, step_s);
        // A service that stops has no time to wait for a slow servo.
        let has_arrived = position.to_bits() == self.target.to_bits() || output.reason == Reason::Stopping;
        Step { target: self.target, position, is_released: is_lost && has_arrived && self.loss == AtLoss::Release }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::config::{ServoSettings, Sources};
    use crate::link::Pose;
    use crate::servo::{SOURCE_COUNT, SOURCE_NAMES, values};

    const ENDS: Ends = Ends { at_0_us: 2000.0, at_1_us: 1000.0 };

    fn gains(sources: &[(&str, f32)]) -> Gains {
        let mut gains = [0.0; SOURCE_COUNT];
        for (name, gain) in sources {
            gains[SOURCE_NAMES.iter().position(|source| source == name).unwrap()] = *gain;
        }
        gains
    }

    fn channel(sources: &[(&str, f32)], offset: f32, dead_zone: f32, loss: AtLoss) -> Channel {
        let mut settings = ChannelSettings { sources: Sources(gains(sources)), ..ChannelSettings::default() };
        settings.servo = ServoSettings { offset, dead_zone, neutral: 0.5, loss, ..settings.servo };
        Channel::new(&settings)
    }

    fn output(state: State, sources: &[(&str, f32)]) -> (Output, Gains) {
        let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
        let output =
            Output { state, reason, pose: Pose::NEUTRAL, age_us: 0, capture_us: 0, followed: false, moving: false };
        (output, gains(sources))
    }

    /// The target for these values of the sources.
    fn target(channel: &mut Channel, sources: &[(&str, f32)]) -> f32 {
        let (output, values) = output(State::Live, sources);
        channel.step(&output, &values, 0.02).target
    }

    #[test]
    fn a_position_is_the_weighted_sum_of_its_sources() {
        let mut jaw = channel(&[("jawOpen", 0.8), ("mouthClose", -0.5), ("headYaw", 0.01)], 0.1, 0.0, AtLoss::Neutral);
        let position = target(&mut jaw, &[("jawOpen", 1.0), ("mouthClose", 0.6), ("headYaw", 20.0)]);
        assert!((position - 0.8).abs() < 1e-6, "{position}");
        assert!((target(&mut jaw, &[]) - 0.1).abs() < 1e-6);
    }

    #[test]
    fn pulses_may_run_backwards_and_never_leave_their_ends() {
        assert!((ENDS.pulse_us(0.25) - 1750.0).abs() < 1e-3);
        for wild in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -3.0, 7.0, 1e30] {
            assert!((1000.0..=2000.0).contains(&ENDS.pulse_us(wild)), "{wild}");
        }
    }

    #[test]
    fn whatever_comes_in_the_position_stays_in_its_range_and_what_is_no_number_changes_nothing() {
        let mut random = fastrand::Rng::with_seed(3);
        let mut jaw = channel(&[("jawOpen", 4.0), ("headPitch", -0.3)], 0.2, 0.01, AtLoss::Neutral);
        for _ in 0..10_000 {
            let wild = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30 * (random.f32() - 0.5), random.f32()];
            let before = jaw.target;
            let [jaw_open, pitch] = [0, 0].map(|_| wild[random.usize(0..wild.len())]);
            let position = target(&mut jaw, &[("jawOpen", jaw_open), ("headPitch", pitch)]);
            assert!((0.0..=1.0).contains(&position));
            assert!(!jaw_open.is_nan() && !pitch.is_nan() || position.to_bits() == before.to_bits());
        }
        let mut pose = Pose { rotation: [f32::NAN; 4], ..Pose::NEUTRAL };
        pose.coefficients[0] = f32::INFINITY;
        let (output, _) = output(State::Live, &[]);
        assert!((0.0..=1.0).contains(&jaw.step(&output, &values(&pose), 0.02).position));
    }

    #[test]
    fn a_source_without_a_gain_does_not_count_even_if_it_is_no_number() {
        let mut jaw = channel(&[("jawOpen", 1.0)], 0.0, 0.0, AtLoss::Neutral);
        assert!((target(&mut jaw, &[("jawOpen", 0.7), ("tongueOut", f32::NAN)]) - 0.7).abs() < 1e-6);
    }

    #[test]
    fn trembling_within_the_dead_zone_moves_nothing_and_the_ends_are_reached_nevertheless() {
        let mut lid = channel(&[("eyeBlinkLeft", 1.0)], 0.0, 0.02, AtLoss::Neutral);
        let mut blink = |value| target(&mut lid, &[("eyeBlinkLeft", value)]);
        let _begin = [0.3, 0.285, 0.315].map(&mut blink);
        let rest = blink(0.3);
        for trembling in [0.285, 0.31, 0.3, 0.319] {
            assert_eq!(blink(trembling).to_bits(), rest.to_bits(), "{trembling}");
        }
        assert!((blink(0.4) - 0.38).abs() < 1e-6);
        assert_eq!([0.0, 1.0, 0.99].map(blink), [0.0, 1.0, 1.0]);
    }

    #[test]
    fn without_a_face_a_channel_goes_to_neutral_and_stays_there_or_is_released() {
        for (loss, is_released) in [(AtLoss::Neutral, false), (AtLoss::Release, true)] {
            let mut jaw = channel(&[("jawOpen", 1.0)], 0.0, 0.0, loss);
            for state in [State::Live, State::Hold, State::Decay] {
                let (output, values) = output(state, &[("jawOpen", 0.9)]);
                assert!(!jaw.step(&output, &values, 0.02).is_released, "{state:?}");
            }
            let (output, values) = output(State::Neutral, &[("jawOpen", 0.9)]);
            assert_eq!(jaw.step(&output, &values, 0.02), Step { target: 0.5, position: 0.5, is_released });
        }
    }

    #[test]
    fn a_slow_servo_is_released_when_it_has_arrived_or_when_the_service_stops() {
        let mut neck = channel(&[("jawOpen", 1.0)], 0.0, 0.0, AtLoss::Release);
        assert_eq!(target(&mut neck, &[("jawOpen", 1.0)]), 1.0);
        neck.limits.speed_per_s = 1.0;
        let (mut output, values) = output(State::Neutral, &[]);
        let steps = (0..100).find(|_| neck.step(&output, &values, 0.02).is_released).unwrap();
        assert!((24..=26).contains(&steps), "{steps} steps of 20 ms for half of the range");
        neck.motion = Motion::at(1.0);
        output.reason = Reason::Stopping;
        assert!(neck.step(&output, &values, 0.02).is_released);
    }
}
