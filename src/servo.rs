//! Servos: what a channel of a servo board does while a face moves.
//!
//! Role: a [`Channel`] turns the face into the position of one servo, from 0 to 1, and the position into a pulse width.
//! Contract: whatever comes in, a position stays within 0 to 1, and a [`Motion`] keeps its limits of speed and
//! acceleration. A value that is not a number leaves the servo where it is. Nothing here allocates or reads a clock: the
//! time since the last step is an argument.
//! Limits: nobody knows where a servo stands that gets no pulses. With its first pulse it moves to its neutral position as
//! fast as it can.

use std::time::Instant;

use facewire_packet::{BLENDSHAPE_COUNT, Packet, Reason, State, yaw_pitch_roll_deg};

use crate::config::{AtLoss, ChannelSettings, SOURCE_COUNT, Sources};

/// Longest time that one step accounts for, seconds. After a longer pause the motion goes on as if it had been paused.
const LONGEST_STEP_S: f32 = 0.1;
/// A position this close to its target counts as there: 0.1 µs in a range of 1000 µs, where a Maestro's step is 0.25.
const ARRIVED: f32 = 1e-4;

/// The channels of a board in the order of their numbers, and when they last moved.
pub struct Board {
    pub channels: Vec<Channel>,
    pub moved_at: Option<Instant>,
}

impl Board {
    pub fn new(settings: &[ChannelSettings]) -> Self {
        let mut channels: Vec<Channel> = settings.iter().map(Channel::new).collect();
        channels.sort_by_key(|channel| channel.number);
        Self { channels, moved_at: None }
    }

    pub fn follow(&mut self, packet: &Packet, now: Instant) -> &[Channel] {
        let step_s = self.moved_at.replace(now).map_or(0.0, |before| (now - before).as_secs_f32());
        let values = values(packet.rotation, &packet.coefficients);
        self.channels.iter_mut().for_each(|channel| channel.step(packet.state, packet.reason, &values, step_s));
        &self.channels
    }
}

/// Returns the coefficients, then the angles of the head in degrees.
fn values(rotation: [f32; 4], coefficients: &[f32; BLENDSHAPE_COUNT]) -> Sources {
    let (mut values, angles_deg) = ([0.0; SOURCE_COUNT], yaw_pitch_roll_deg(rotation));
    values.iter_mut().zip(coefficients.iter().chain(&angles_deg)).for_each(|(to, from)| *to = *from);
    values
}

#[derive(Debug, Clone)]
pub struct Channel {
    pub number: u8,
    pub limits: Limits,
    settings: ChannelSettings,
    neutral: f32,
    target: f32,
    motion: Motion,
    is_released: bool,
}

impl Channel {
    pub fn new(settings: &ChannelSettings) -> Self {
        let neutral = if settings.neutral < 0.0 { settings.offset.clamp(0.0, 1.0) } else { settings.neutral };
        let limit = |value| if value > 0.0 { value } else { f32::INFINITY };
        let limits = Limits {
            speed_per_s: limit(settings.speed_per_s),
            acceleration_per_s2: limit(settings.acceleration_per_s2),
        };
        let number = u8::try_from(settings.channel).unwrap_or_default();
        let (settings, motion) = (settings.clone(), Motion::at(neutral));
        Self { number, limits, settings, neutral, target: neutral, motion, is_released: false }
    }

    /// The pulses at both ends, microseconds. The end at 1 may have the shorter pulse.
    fn ends_us(&self) -> [f32; 2] {
        [self.settings.pulse_at_0_us as f32, self.settings.pulse_at_1_us as f32]
    }

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

    /// Follows the sources for `step_s`.
    fn step(&mut self, state: State, reason: Reason, values: &Sources, step_s: f32) {
        let is_lost = state == State::Neutral;
        if is_lost {
            self.target = self.neutral;
        } else if let Some(position) = self.position(values) {
            self.target = self.settled(position);
        }
        let position = self.motion.step(self.limits, self.target, step_s);
        // A service that stops has no time to wait for a slow servo.
        let has_arrived = position.to_bits() == self.target.to_bits() || reason == Reason::Stopping;
        self.is_released = is_lost && has_arrived && self.settings.loss == AtLoss::Release;
    }

    /// The pulse for where the channel goes. `None` ends the pulses.
    pub fn target_us(&self) -> Option<f32> {
        (!self.is_released).then(|| self.pulse_us(self.target))
    }

    /// The pulse for where the channel is by now if it keeps its limits. `None` ends the pulses.
    pub fn now_us(&self) -> Option<f32> {
        (!self.is_released).then(|| self.pulse_us(self.motion.position))
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

/// Limits of a motion, in units of its range from 0 to 1. Infinity means no limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    pub speed_per_s: f32,
    pub acceleration_per_s2: f32,
}

impl Limits {
    /// A motion without limits is always at its target.
    const NONE: Self = Self { speed_per_s: f32::INFINITY, acceleration_per_s2: f32::INFINITY };
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Motion {
    position: f32,
    speed_per_s: f32,
}

impl Motion {
    fn at(position: f32) -> Self {
        Self { position, speed_per_s: 0.0 }
    }

    fn step(&mut self, limits: Limits, target: f32, step_s: f32) -> f32 {
        let target = if target.is_nan() { self.position } else { target.clamp(0.0, 1.0) };
        if limits == Limits::NONE {
            *self = Self::at(target);
        }
        if !(step_s > 0.0) {
            return self.position;
        }
        let step_s = step_s.min(LONGEST_STEP_S);
        let way = target - self.position;
        let change_per_s = limits.acceleration_per_s2 * step_s;
        let fastest = braking_speed(way.abs(), limits.acceleration_per_s2, step_s).min(limits.speed_per_s);
        let wanted = fastest.copysign(way);
        let speed_per_s = wanted.clamp(self.speed_per_s - change_per_s, self.speed_per_s + change_per_s);
        let reached = self.position + speed_per_s * step_s;
        let can_stop = self.speed_per_s.abs().max(speed_per_s.abs()) <= change_per_s;
        let is_there = can_stop && (reached - target).abs() <= ARRIVED;
        *self = if is_there {
            Self::at(target)
        } else {
            // Only steps of uneven length carry a motion beyond its range, and then by a fraction of a step.
            Self { position: reached.clamp(0.0, 1.0), speed_per_s }
        };
        self.position
    }
}

/// Returns the highest speed of this step from which the motion can still stop within `way`: v with
/// v² / 2a + v * step = way.
fn braking_speed(way: f32, acceleration_per_s2: f32, step_s: f32) -> f32 {
    if acceleration_per_s2.is_infinite() {
        return way / step_s;
    }
    let change_per_s = acceleration_per_s2 * step_s;
    (change_per_s * change_per_s + 2.0 * acceleration_per_s2 * way).sqrt() - change_per_s
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::SOURCE_NAMES;

    const STEP_S: f32 = 0.02;
    const ROUNDING: f32 = 1e-4;

    type Named<'a> = &'a [(&'a str, f32)];

    fn valued(sources: Named) -> Sources {
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
            assert_eq!(channel.pulse_us(position), pulse_us);
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
                assert!(jaw.now_us().is_some(), "{state:?}");
            }
            assert_eq!(jaw.motion, Motion::at(1.0));
            jaw.limits.speed_per_s = speed_per_s;
            let found = (0..100_usize).find(|_| {
                jaw.step(State::Neutral, reason, &values, STEP_S);
                jaw.now_us().is_none()
            });
            assert!(found.zip(steps).map_or(found == steps, |(found, want)| found.abs_diff(want) < 2), "{steps:?}");
            assert!(jaw.target == 0.5 && (steps.is_some() || jaw.motion == Motion::at(0.5)));
        }
    }

    fn wild(random: &mut fastrand::Rng) -> f32 {
        let [large, any] = [(random.f32() - 0.5) * 1e30, random.f32()];
        let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, large, 0.0, 1.0, any, any];
        values[random.usize(..values.len())]
    }

    #[test]
    fn no_step_exceeds_position_speed_or_acceleration_whatever_the_target_and_however_long_it_takes() {
        let mut random = fastrand::Rng::with_seed(1);
        for is_even in [true, false].into_iter().cycle().take(400) {
            let (speed_per_s, acceleration_per_s2) = (0.05 + 10.0 * random.f32(), 0.5 + 100.0 * random.f32());
            let limits = Limits { speed_per_s, acceleration_per_s2 };
            let (mut motion, mut target) = (Motion::at(random.f32()), 0.5);
            for _ in 0..500 {
                if random.u32(0..20) == 0 {
                    target = wild(&mut random);
                }
                let (before, step_s) = (motion, if is_even { STEP_S } else { 0.2 * random.f32() });
                motion.step(limits, target, step_s);
                let counted_s = step_s.min(LONGEST_STEP_S);
                assert!((0.0..=1.0).contains(&motion.position));
                let way = (motion.position - before.position).abs();
                assert!(way <= speed_per_s * counted_s * (1.0 + ROUNDING) + ARRIVED, "{way} {step_s} {limits:?}");
                let change_per_s = (motion.speed_per_s - before.speed_per_s).abs();
                let most_per_s = acceleration_per_s2 * counted_s * (1.0 + ROUNDING) + ROUNDING;
                assert!(!is_even || change_per_s <= most_per_s, "{change_per_s} {limits:?}");
            }
        }
    }

    #[test]
    fn a_step_arrives_without_overshoot_in_the_time_that_its_limits_allow() {
        assert_eq!(Motion::at(0.0).step(Limits::NONE, 0.7, 0.0), 0.7, "no limits take no time");
        for (speed_per_s, acceleration_per_s2, least_s, most_s) in [
            (2.0, f32::INFINITY, 0.5, 0.52),
            (f32::INFINITY, 4.0, 1.0, 1.1),
            // 0.5 s to speed up, 0.5 s to slow down, and half of the way at full speed.
            (1.0, 2.0, 1.5, 1.6),
            (f32::INFINITY, f32::INFINITY, 0.02, 0.02),
        ] {
            let limits = Limits { speed_per_s, acceleration_per_s2 };
            let (mut motion, mut time_s) = (Motion::at(0.0), 0.0);
            while motion.position < 1.0 && time_s < 10.0 {
                let before = motion.position;
                assert!(motion.step(limits, 1.0, STEP_S) >= before);
                time_s += STEP_S;
            }
            assert!((least_s - ROUNDING..=most_s + ROUNDING).contains(&time_s), "{time_s} {limits:?}");
            assert_eq!(motion, Motion::at(1.0));
        }
    }
}
