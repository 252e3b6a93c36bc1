//! Servos: what a channel of a servo board does while a face moves.
//!
//! Role: a [`Channel`] turns the face into the position of one servo, from 0 to 1, and the position into a pulse width.
//! Contract: whatever comes in, a position stays within 0 to 1, and a [`Motion`] keeps its limits of speed and
//! acceleration. A value that is not a number leaves the servo where it is. Nothing here allocates or reads a clock: the
//! time since the last step is an argument.
//! Limits: nobody knows where a servo stands that gets no pulses. With its first pulse it moves to its neutral position as
//! fast as it can.

mod motion;

use facewire_face::yaw_pitch_roll_deg;
use facewire_packet::{BLENDSHAPE_COUNT, Reason, State};

use crate::config::{AtLoss, ChannelSettings, SOURCE_COUNT};
pub use motion::{Limits, Motion};

/// What channels follow: the coefficients, then the angles of the head in degrees, in the order of
/// [`SOURCE_NAMES`](crate::config::SOURCE_NAMES), and how far they can be trusted.
#[derive(Debug, Clone, Copy)]
pub struct ChannelInput {
    pub state: State,
    pub reason: Reason,
    pub values: [f32; SOURCE_COUNT],
}

impl ChannelInput {
    pub fn new(state: State, reason: Reason, rotation: [f32; 4], coefficients: &[f32; BLENDSHAPE_COUNT]) -> Self {
        let mut values = [0.0; SOURCE_COUNT];
        let angles_deg = yaw_pitch_roll_deg(rotation);
        values.iter_mut().zip(coefficients.iter().chain(&angles_deg)).for_each(|(to, from)| *to = *from);
        Self { state, reason, values }
    }
}

/// The pulses of a channel, microseconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pulses {
    /// Where the channel goes.
    pub target_us: f32,
    /// Where it is by now if it keeps its limits.
    pub now_us: f32,
}

/// A channel and its motion.
#[derive(Debug, Clone)]
pub struct Channel {
    pub number: u8,
    pub limits: Limits,
    settings: ChannelSettings,
    neutral: f32,
    target: f32,
    motion: Motion,
}

impl Channel {
    /// A channel that rests at its neutral position.
    pub fn new(settings: &ChannelSettings) -> Self {
        let neutral = if settings.neutral < 0.0 { settings.offset.clamp(0.0, 1.0) } else { settings.neutral };
        let limit = |value| if value > 0.0 { value } else { f32::INFINITY };
        Self {
            number: u8::try_from(settings.channel).unwrap_or_default(),
            limits: Limits {
                speed_per_s: limit(settings.speed_per_s),
                acceleration_per_s2: limit(settings.acceleration_per_s2),
            },
            settings: settings.clone(),
            neutral,
            target: neutral,
            motion: Motion::at(neutral),
        }
    }

    /// The pulses at both ends, microseconds. The end at 1 may have the shorter pulse.
    fn ends_us(&self) -> [f32; 2] {
        [self.settings.pulse_at_0_us as f32, self.settings.pulse_at_1_us as f32]
    }

    /// How far the pulse changes from end to end, microseconds.
    pub fn span_us(&self) -> f32 {
        let [at_0_us, at_1_us] = self.ends_us();
        (at_1_us - at_0_us).abs()
    }

    fn pulse_us(&self, position: f32) -> f32 {
        let [at_0_us, at_1_us] = self.ends_us();
        at_0_us + (at_1_us - at_0_us) * if position.is_nan() { 0.5 } else { position.clamp(0.0, 1.0) }
    }

    /// Notes that the servo stands where this pulse has moved it. It goes on from there, or from the nearer end.
    pub fn rest_at(&mut self, pulse_us: f32) {
        let [at_0_us, at_1_us] = self.ends_us();
        let position = (pulse_us - at_0_us) / (at_1_us - at_0_us);
        if !position.is_nan() {
            self.motion = Motion::at(position.clamp(0.0, 1.0));
        }
    }

    /// Follows the input for `step_s`. Returns `None` if the servo gets no pulses.
    pub fn step(&mut self, input: &ChannelInput, step_s: f32) -> Option<Pulses> {
        let is_lost = input.state == State::Neutral;
        if is_lost {
            self.target = self.neutral;
        } else if let Some(position) = self.position(&input.values) {
            self.target = self.settled(position);
        }
        let position = self.motion.step(self.limits, self.target, step_s);
        // A service that stops has no time to wait for a slow servo.
        let has_arrived = position.to_bits() == self.target.to_bits() || input.reason == Reason::Stopping;
        let is_released = is_lost && has_arrived && self.settings.loss == AtLoss::Release;
        (!is_released).then(|| Pulses { target_us: self.pulse_us(self.target), now_us: self.pulse_us(position) })
    }

    /// Returns the weighted sum of the sources, or `None` if they give no number.
    fn position(&self, values: &[f32; SOURCE_COUNT]) -> Option<f32> {
        let used = self.settings.sources.0.iter().zip(values).filter(|(gain, _)| **gain != 0.0);
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
mod tests {
    use super::*;
    use crate::config::{SOURCE_NAMES, Sources};

    type Named<'a> = &'a [(&'a str, f32)];

    fn valued(sources: Named) -> [f32; SOURCE_COUNT] {
        let mut values = [0.0; SOURCE_COUNT];
        for (name, value) in sources {
            values[SOURCE_NAMES.iter().position(|source| source == name).unwrap()] = *value;
        }
        values
    }

    fn channel(sources: Named, offset: f32, dead_zone: f32, loss: AtLoss) -> Channel {
        let sources = Sources(valued(sources));
        Channel::new(&ChannelSettings { sources, offset, dead_zone, neutral: 0.5, loss, ..ChannelSettings::default() })
    }

    fn input(state: State, sources: Named) -> ChannelInput {
        let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
        ChannelInput { state, reason, values: valued(sources) }
    }

    /// Where the channel goes for these values of the sources.
    fn target(channel: &mut Channel, sources: Named) -> f32 {
        channel.step(&input(State::Live, sources), 0.02).unwrap();
        channel.target
    }

    #[test]
    fn the_sources_are_the_coefficients_and_the_angles_of_the_head_in_degrees() {
        // 20 degrees about the vertical axis: the head turns to the person's left.
        let (sin, cos) = 10.0_f32.to_radians().sin_cos();
        let mut coefficients = [0.0; BLENDSHAPE_COUNT];
        coefficients[17] = 0.25;
        let input = ChannelInput::new(State::Live, Reason::None, [0.0, sin, 0.0, cos], &coefficients);
        let wanted = valued(&[("jawOpen", 0.25), ("headYaw", 20.0)]);
        assert!(input.values.iter().zip(wanted).all(|(got, want)| (got - want).abs() < 1e-4), "{:?}", input.values);
    }

    #[test]
    fn a_position_is_the_weighted_sum_of_its_sources() {
        let mut jaw = channel(&[("jawOpen", 0.8), ("mouthClose", -0.5), ("headYaw", 0.01)], 0.1, 0.0, AtLoss::Neutral);
        let position = target(&mut jaw, &[("jawOpen", 1.0), ("mouthClose", 0.6), ("headYaw", 20.0)]);
        assert!((position - 0.8).abs() < 1e-6, "{position}");
        assert!((target(&mut jaw, &[("tongueOut", f32::NAN)]) - 0.1).abs() < 1e-6, "a source without a gain");
    }

    #[test]
    fn pulses_may_run_backwards_and_never_leave_their_ends() {
        let settings = ChannelSettings { pulse_at_0_us: 2000, pulse_at_1_us: 1000, ..ChannelSettings::default() };
        let mut channel = Channel::new(&settings);
        assert!((channel.pulse_us(0.25) - 1750.0).abs() < 1e-3);
        for wild in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -3.0, 7.0, 1e30] {
            assert!((1000.0..=2000.0).contains(&channel.pulse_us(wild)), "{wild}");
            channel.rest_at(wild);
            assert!((0.0..=1.0).contains(&channel.motion.position()), "{wild}");
        }
        channel.rest_at(1750.0);
        assert!((channel.motion.position() - 0.25).abs() < 1e-6);
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
        let wild = ChannelInput::new(State::Live, Reason::None, [f32::NAN; 4], &[f32::INFINITY; BLENDSHAPE_COUNT]);
        jaw.step(&wild, 0.02).unwrap();
        assert!((0.0..=1.0).contains(&jaw.motion.position()));
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
        for (loss, pulse_us) in [(AtLoss::Neutral, Some(1500.0)), (AtLoss::Release, None)] {
            let mut jaw = channel(&[("jawOpen", 1.0)], 0.0, 0.0, loss);
            for state in [State::Live, State::Hold, State::Decay] {
                assert!(jaw.step(&input(state, &[("jawOpen", 0.9)]), 0.02).is_some(), "{state:?}");
            }
            let pulses = jaw.step(&input(State::Neutral, &[("jawOpen", 0.9)]), 0.02);
            assert_eq!(pulses.map(|pulses| pulses.now_us), pulse_us);
            assert_eq!((jaw.target, jaw.motion), (0.5, Motion::at(0.5)));
        }
    }

    #[test]
    fn a_slow_servo_is_released_when_it_has_arrived_or_when_the_service_stops() {
        let mut neck = channel(&[("jawOpen", 1.0)], 0.0, 0.0, AtLoss::Release);
        assert_eq!(target(&mut neck, &[("jawOpen", 1.0)]), 1.0);
        neck.limits.speed_per_s = 1.0;
        let mut input = input(State::Neutral, &[]);
        let steps = (0..100).find(|_| neck.step(&input, 0.02).is_none()).unwrap();
        assert!((24..=26).contains(&steps), "{steps} steps of 20 ms for half of the range");
        neck.motion = Motion::at(1.0);
        input.reason = Reason::Stopping;
        assert_eq!(neck.step(&input, 0.02), None);
    }
}
