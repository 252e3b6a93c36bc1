//! Servos: what a channel of a servo board does while a face moves.
//!
//! Role: a [`Channel`] turns the face into the position of one servo, from 0 to 1, and the position into a pulse width.
//! An [`Operator`] may take all pulses away, or turn single channels in place of the face.
//! Contract: whatever comes in, a position stays within 0 to 1, and a [`Motion`] keeps its limits of speed and
//! acceleration. A value that is not a number leaves the servo where it is. Nothing here allocates or reads a clock: the
//! time since the last step is an argument.
//! Limits: nobody knows where a servo stands that gets no pulses. Its first pulse is that of where it was left, or of its
//! neutral position, and moves it there as fast as it can.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Instant;

use facewire_packet::{BLENDSHAPE_COUNT, Packet, Reason, State, yaw_pitch_roll_deg};

use crate::config::{AtLoss, ChannelSettings, SOURCE_COUNT, Sources};

/// Longest time that one step accounts for, seconds. After a longer pause the motion goes on as if it had been paused.
const LONGEST_STEP_S: f32 = 0.1;
/// A position this close to its target counts as there: 0.1 µs in a range of 1000 µs, where a Maestro's step is 0.25.
const ARRIVED: f32 = 1e-4;

/// What an operator wants of all servos. The control thread sets it. The sender and the threads of devices obey, whatever
/// the face does.
#[derive(Debug, Default)]
pub struct Operator {
    /// No servo gets pulses.
    pub is_released: AtomicBool,
    /// The value of `is_released` that all links were told last.
    pub told_released: AtomicBool,
    /// Until when the last word of the one who drives holds, on the monotonic clock, microseconds.
    pub driven_until_us: AtomicU64,
    /// Whether that time has not come yet, as the sender sees it.
    pub is_driven: AtomicBool,
}

/// The channels of a board in the order of their numbers, as an operator sees and turns them.
#[derive(Debug, Default)]
pub struct Dials {
    pub channels: Vec<Dial>,
    pub operator: Arc<Operator>,
}

impl Dials {
    pub fn new(settings: &[ChannelSettings], operator: &Arc<Operator>) -> Self {
        let dial = |channel: &Channel| Dial { number: channel.number, ..Dial::default() };
        Self { channels: sorted(settings).iter().map(dial).collect(), operator: Arc::clone(operator) }
    }

    /// Whether an operator keeps the board without pulses, or turns one of its channels.
    pub fn is_operated(&self) -> bool {
        let Operator { is_released, is_driven, .. } = &*self.operator;
        let is_turned = || is_driven.load(Relaxed) && self.channels.iter().any(|dial| dial.jog.get().is_some());
        !self.channels.is_empty() && (is_released.load(Relaxed) || is_turned())
    }

    pub fn has(&self, channel: u8) -> bool {
        self.channels.iter().any(|dial| dial.number == channel)
    }

    /// Turns this channel alone, or none.
    pub fn turn(&self, turned: Option<(u8, f32)>) {
        for dial in &self.channels {
            dial.jog.set(turned.filter(|(number, _)| *number == dial.number).map(|(_, position)| position));
        }
    }
}

/// A channel: where it goes, where it is by now within its limits, its pulse, and where an operator wants it.
#[derive(Debug, Default)]
pub struct Dial {
    pub number: u8,
    pub target: Number,
    pub position: Number,
    pub pulse_us: Number,
    jog: Number,
}

/// A number that threads share, or none.
#[derive(Debug)]
pub struct Number(AtomicU32);

impl Default for Number {
    fn default() -> Self {
        Self(f32::NAN.to_bits().into())
    }
}

impl Number {
    pub fn get(&self) -> Option<f32> {
        Some(f32::from_bits(self.0.load(Relaxed))).filter(|number| !number.is_nan())
    }

    fn set(&self, number: Option<f32>) {
        self.0.store(number.unwrap_or(f32::NAN).to_bits(), Relaxed);
    }
}

/// The channels of a board in the order of their numbers, and when they last moved.
pub struct Board {
    pub channels: Vec<Channel>,
    pub moved_at: Option<Instant>,
    dials: Arc<Dials>,
}

fn sorted(settings: &[ChannelSettings]) -> Vec<Channel> {
    let mut channels: Vec<Channel> = settings.iter().map(Channel::new).collect();
    channels.sort_by_key(|channel| channel.number);
    channels
}

impl Board {
    pub fn new(settings: &[ChannelSettings], dials: &Arc<Dials>) -> Self {
        let board = Self { channels: sorted(settings), moved_at: None, dials: Arc::clone(dials) };
        board.show();
        board
    }

    /// Moves the channels with the face, or as the operator wants. While one channel is turned, the others of its board
    /// go to rest.
    pub fn follow(&mut self, packet: &Packet, now: Instant) -> &[Channel] {
        let step_s = self.moved_at.replace(now).map_or(0.0, |before| (now - before).as_secs_f32());
        let (values, Dials { channels: dials, operator }) =
            (values(packet.rotation, &packet.coefficients), &*self.dials);
        let (is_released, is_driven) = (operator.is_released.load(Relaxed), operator.is_driven.load(Relaxed));
        let jog = |dial: &Dial| dial.jog.get().filter(|_| is_driven);
        let state = if dials.iter().any(|dial| jog(dial).is_some()) { State::Neutral } else { packet.state };
        for (index, channel) in self.channels.iter_mut().enumerate() {
            (channel.jog, channel.is_off) = (dials.get(index).and_then(jog), is_released);
            channel.step(state, packet.reason, &values, step_s);
        }
        self.show();
        &self.channels
    }

    fn show(&self) {
        for (dial, channel) in self.dials.channels.iter().zip(&self.channels) {
            dial.target.set(Some(channel.target));
            dial.position.set(Some(channel.motion.position));
            dial.pulse_us.set(channel.now_us().filter(|_| self.moved_at.is_some()));
        }
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
    /// Whether the last pulse was the first one after none.
    is_first: bool,
    /// Where an operator wants the channel, and whether the operator wants it without pulses.
    jog: Option<f32>,
    is_off: bool,
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
        let (is_released, is_first, jog, is_off) = (false, false, None, false);
        Self { number, limits, settings, neutral, target: neutral, motion, is_released, is_first, jog, is_off }
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
        let is_lost = self.jog.is_none() && state == State::Neutral;
        if let Some(position) = self.jog {
            self.target = position.clamp(0.0, 1.0);
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
        let position = self.motion.step(self.limits, self.target, step_s);
        // A service that stops has no time to wait for a slow servo.
        let has_arrived = position.to_bits() == self.target.to_bits() || reason == Reason::Stopping;
        self.is_released = is_lost && has_arrived && self.settings.loss == AtLoss::Release;
        self.is_first = was_released && !self.is_released;
    }

    /// The pulse for where the channel goes, for a board that moves there within the limits. The first pulse after none is
    /// that of where the servo was left, because the board would move it at once. `None` ends the pulses.
    pub fn target_us(&self) -> Option<f32> {
        if self.is_first { self.now_us() } else { (!self.is_released).then(|| self.pulse_us(self.target)) }
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

    #[test]
    fn a_jog_leaves_other_servos_at_rest_and_a_released_board_goes_on_from_where_it_was_left_within_its_limits() {
        let settings = |channel, loss| {
            let (sources, speed_per_s, pulse_at_1_us) = (valued(&[("jawOpen", 1.0)]), 1.0, 2000);
            let rest = ChannelSettings { neutral: 0.2, loss, ..ChannelSettings::default() };
            ChannelSettings { channel, sources, speed_per_s, pulse_at_1_us, ..rest }
        };
        let settings = [settings(3, AtLoss::Neutral), settings(1, AtLoss::Release)];
        let (operator, mut now) = (Arc::<Operator>::default(), Instant::now());
        let dials = Arc::new(Dials::new(&settings, &operator));
        let mut board = Board::new(&settings, &dials);
        let mut follow = |seconds: u64, jaw_open: f32| {
            let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
            packet.coefficients[17] = jaw_open;
            for _ in 0..seconds * 50 {
                now += std::time::Duration::from_millis(20);
                board.follow(&packet, now);
            }
            board.channels.iter().map(|channel| (channel.target, channel.target_us())).collect::<Vec<_>>()
        };
        assert_eq!(follow(2, 1.0), [(1.0, Some(2000.0)); 2]);
        dials.turn(Some((3, 7.0)));
        assert_eq!(follow(2, 0.0), [(0.0, Some(1000.0)); 2], "nobody drives");
        operator.is_driven.store(true, Relaxed);
        assert!(follow(2, 0.5) == [(0.2, None), (1.0, Some(2000.0))] && dials.is_operated(), "others are at rest");
        operator.is_released.store(true, Relaxed);
        assert_eq!(follow(2, 0.0), [(0.2, None), (1.0, None)]);
        dials.turn(None);
        assert!(follow(2, 0.0).iter().all(|(_, pulse_us)| pulse_us.is_none()));
        operator.is_released.store(false, Relaxed);
        now += std::time::Duration::from_millis(20);
        let first = board.follow(&Packet { state: State::Live, ..Packet::NEUTRAL }, now)[1].target_us().unwrap();
        assert!((1979.0..2000.0).contains(&first), "{first}: the first pulse is that of the place where it was left");
        now += std::time::Duration::from_millis(20);
        assert_eq!(board.follow(&Packet { state: State::Live, ..Packet::NEUTRAL }, now)[1].target_us(), Some(1000.0));
        assert!((0.95..0.97).contains(&dials.channels[1].position.get().unwrap()) && !dials.is_operated());
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
