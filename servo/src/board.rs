//! The channels of a board together, and what an operator may do with them in place of the face.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Instant;

use facewire_packet::{Packet, State};

use crate::channel::{Channel, ChannelSettings, values};

/// What an operator wants of all servos. The control thread sets it. The sender and the threads of devices obey, whatever
/// the face does.
#[derive(Debug, Default)]
pub struct Operator {
    /// No servo gets pulses but the one that is jogged.
    pub is_released: AtomicBool,
    /// The value of `is_released` that all links have received last.
    pub released_at_links: AtomicBool,
    /// When the last line of the client that drives expires: time of the monotonic clock, microseconds.
    pub driven_until_us: AtomicU64,
    /// Whether that time has not come yet, as the sender sees it.
    pub is_driven: AtomicBool,
}

/// The channels of a board in the order of their numbers, as an operator sees and jogs them.
#[derive(Debug, Default)]
pub struct Dials {
    pub channels: Vec<Dial>,
    pub operator: Arc<Operator>,
    /// Whether the channels stay where they are while an operator drives, but for one that is jogged.
    is_still: AtomicBool,
    /// Whether the board has acknowledged the operator's release, as far as such a board can.
    has_released: AtomicBool,
}

impl Dials {
    pub fn new(settings: &[ChannelSettings], operator: &Arc<Operator>) -> Self {
        let dial = |channel: &Channel| {
            let name = channel.settings.name.clone();
            Dial { number: channel.number, name, ..Dial::default() }
        };
        let channels = sorted(settings).iter().map(dial).collect();
        // Whoever drives while settings bring a new board has said nothing about it yet.
        let is_still = AtomicBool::new(true);
        Self { channels, operator: Arc::clone(operator), is_still, has_released: AtomicBool::new(false) }
    }

    /// Whether the board has acknowledged the operator's release.
    #[must_use]
    pub fn has_released(&self) -> bool {
        self.has_released.load(Relaxed)
    }

    /// Records whether the board has acknowledged the operator's release. What it does is known only while its device is open
    /// and takes messages.
    pub fn note_released(&self, has_released: bool) {
        self.has_released.store(has_released, Relaxed);
    }

    /// Whether an operator keeps the board without pulses, or jogs one of its channels.
    pub fn is_operated(&self) -> bool {
        !self.channels.is_empty() && (self.operator.is_released.load(Relaxed) || self.has_jog())
    }

    /// Whether an operator keeps all channels without pulses.
    pub fn is_off(&self) -> bool {
        self.operator.is_released.load(Relaxed) && !self.has_jog()
    }

    fn has_jog(&self) -> bool {
        self.operator.is_driven.load(Relaxed) && self.channels.iter().any(|dial| dial.jog.get().is_some())
    }

    pub fn has(&self, channel: u16) -> bool {
        self.channels.iter().any(|dial| dial.number == channel)
    }

    /// Lets the channels begin where those of the board are that this one replaces, and keeps them still if those are.
    pub fn begin_at(&self, other: &Self) {
        for dial in &self.channels {
            let same = other.channels.iter().find(|same| same.number == dial.number);
            dial.start.set(same.and_then(|same| same.left.get().or(same.start.get())));
        }
        // A channel that was jogged stays where it is, too: its position may be another place now.
        let is_jogged = other.channels.iter().any(|dial| dial.jog.get().is_some());
        self.keep_still(is_jogged || other.is_still.load(Relaxed));
    }

    /// Keeps the channels where they are while an operator drives, or not.
    pub fn keep_still(&self, is_still: bool) {
        self.is_still.store(is_still, Relaxed);
    }

    /// Moves this channel alone to a position in place of the face, or none.
    pub fn jog(&self, jog: Option<(u16, f32)>) {
        for dial in &self.channels {
            dial.jog.set(jog.filter(|(number, _)| *number == dial.number).map(|(_, position)| position));
        }
    }
}

/// What is known of a channel: the position where it goes, where it is by now within its limits, and the place of that, in
/// microseconds of a pulse or steps of a bus servo. `jog` is the position where an operator wants it.
#[derive(Debug, Default)]
pub struct Dial {
    pub number: u16,
    /// What people call the servo. It may be empty.
    pub name: String,
    pub target: Number,
    pub position: Number,
    pub place: Number,
    /// The position that a bus servo reported last.
    pub measured: Number,
    /// What a bus servo tells of itself, in the order of [`HEALTH`](crate::bus::HEALTH).
    pub health: [Number; 4],
    jog: Number,
    /// The last place of the channel, also while it has no pulses.
    left: Number,
    /// Where the channel begins, in place of its neutral position, as a place.
    start: Number,
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

    pub(crate) fn set(&self, number: Option<f32>) {
        self.0.store(number.unwrap_or(f32::NAN).to_bits(), Relaxed);
    }
}

/// The channels of a board in the order of their numbers, and when they last moved.
pub struct Board {
    pub channels: Vec<Channel>,
    pub moved_at: Option<Instant>,
    /// Whether an operator keeps the channels without pulses, as of the last step.
    pub(crate) is_off: bool,
    pub(crate) dials: Arc<Dials>,
}

fn sorted(settings: &[ChannelSettings]) -> Vec<Channel> {
    let mut channels: Vec<Channel> = settings.iter().map(Channel::new).collect();
    channels.sort_by_key(|channel| channel.number);
    channels
}

impl Board {
    pub fn new(settings: &[ChannelSettings], dials: &Arc<Dials>) -> Self {
        let board = Self { channels: sorted(settings), moved_at: None, is_off: false, dials: Arc::clone(dials) };
        board.show();
        board
    }

    /// Moves the channels with the face, or as the operator wants. While one channel is jogged, the others of its board
    /// go to rest, or stay without pulses if the operator has released them, or where they are if they are to be still.
    pub fn follow(&mut self, packet: &Packet, now: Instant) -> &[Channel] {
        if self.moved_at.is_none() {
            self.begin();
        }
        let step_s = self.moved_at.replace(now).map_or(0.0, |before| (now - before).as_secs_f32());
        let values = values(packet.rotation, &packet.coefficients);
        let Dials { channels: dials, operator, .. } = &*self.dials;
        let is_released = operator.is_released.load(Relaxed);
        let is_driven = operator.is_driven.load(Relaxed);
        let jog = |dial: &Dial| dial.jog.get().filter(|_| is_driven);
        let has_jog = dials.iter().any(|dial| jog(dial).is_some());
        self.is_off = is_released && !has_jog;
        let is_still = is_driven && self.dials.is_still.load(Relaxed);
        let state = if has_jog { State::Neutral } else { packet.state };
        for (index, channel) in self.channels.iter_mut().enumerate() {
            channel.jog = dials.get(index).and_then(jog);
            channel.is_off = is_released && channel.jog.is_none();
            channel.is_still = is_still && channel.jog.is_none();
            channel.step(state, packet.reason, &values, step_s);
        }
        self.show();
        &self.channels
    }

    fn begin(&mut self) {
        for (dial, channel) in self.dials.channels.iter().zip(&mut self.channels) {
            if let Some(place) = dial.start.get() {
                channel.rest_at(place);
                dial.left.set(Some(place));
                dial.start.set(None);
            }
        }
    }

    fn show(&self) {
        for (dial, channel) in self.dials.channels.iter().zip(&self.channels) {
            dial.target.set(Some(channel.target));
            dial.position.set(Some(channel.motion.position));
            let place = channel.place_now().filter(|_| self.moved_at.is_some());
            dial.place.set(place);
            if place.is_some() {
                dial.left.set(place);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AtLoss, channel::tests::valued};

    #[test]
    fn a_board_with_other_settings_goes_on_from_where_the_one_that_it_replaces_was() {
        let operator = Arc::<Operator>::default();
        let slow = |channel, pulse_at_1_us| {
            let sources = valued(&[("jawOpen", 1.0)]);
            ChannelSettings { channel, sources, speed_per_s: 1.0, pulse_at_1_us, ..ChannelSettings::default() }
        };
        let begun = Instant::now();
        let mut open = Packet { state: State::Live, ..Packet::NEUTRAL };
        open.coefficients[17] = 1.0;
        let before = Arc::new(Dials::new(&[slow(1, 2000), slow(2, 2000)], &operator));
        let mut board = Board::new(&[slow(1, 2000), slow(2, 2000)], &before);
        for step in 0..=4 {
            board.follow(&open, begun + step * std::time::Duration::from_millis(100));
        }
        assert_eq!(before.channels[0].place.get().map(f32::round), Some(1400.0));
        let settings = [slow(1, 1800), slow(3, 2000)];
        let after = Arc::new(Dials::new(&settings, &operator));
        after.begin_at(&before);
        let mut board = Board::new(&settings, &after);
        let place = |board: &mut Board, ms| {
            board.follow(&open, begun + std::time::Duration::from_millis(ms));
            [0, 1].map(|channel| after.channels[channel].place.get().unwrap().round())
        };
        assert_eq!(place(&mut board, 400), [1400.0, 1000.0], "a new channel begins at its neutral position");
        assert_eq!(place(&mut board, 500), [1480.0, 1100.0]);
    }

    #[test]
    fn a_board_that_is_jogged_stays_where_it_is_when_a_reload_replaces_it() {
        let settings = |pulse_at_1_us| {
            let rest = ChannelSettings { channel: 1, neutral: 0.5, pulse_at_1_us, ..ChannelSettings::default() };
            [ChannelSettings { sources: valued(&[("jawOpen", 1.0)]), ..rest }]
        };
        let operator = Arc::<Operator>::default();
        operator.is_driven.store(true, Relaxed);
        let mut now = Instant::now();
        let mut place = |board: &mut Board, dials: &Dials| {
            for _ in 0..200 {
                now += std::time::Duration::from_millis(20);
                board.follow(&Packet { state: State::Live, ..Packet::NEUTRAL }, now);
            }
            dials.channels[0].place.get()
        };
        let before = Arc::new(Dials::new(&settings(2000), &operator));
        let mut board = Board::new(&settings(2000), &before);
        before.jog(Some((1, 1.0)));
        assert_eq!(place(&mut board, &before), Some(2000.0));
        let after = Arc::new(Dials::new(&settings(2100), &operator));
        after.begin_at(&before);
        let mut board = Board::new(&settings(2100), &after);
        assert_eq!(place(&mut board, &after), Some(2000.0), "it has left the hand");
        operator.is_driven.store(false, Relaxed);
        assert_eq!(place(&mut board, &after), Some(1000.0), "it follows the face again");
    }

    #[test]
    fn a_board_that_is_new_while_an_operator_drives_stays_at_rest_and_follows_the_face_afterwards() {
        let settings = [ChannelSettings {
            channel: 1,
            sources: valued(&[("jawOpen", 1.0)]),
            pulse_at_1_us: 2000,
            neutral: 0.5,
            ..ChannelSettings::default()
        }];
        let operator = Arc::<Operator>::default();
        operator.is_driven.store(true, Relaxed);
        let dials = Arc::new(Dials::new(&settings, &operator));
        let mut board = Board::new(&settings, &dials);
        let mut open = Packet { state: State::Live, ..Packet::NEUTRAL };
        open.coefficients[17] = 1.0;
        let mut now = Instant::now();
        let mut place = || {
            now += std::time::Duration::from_millis(100);
            board.follow(&open, now);
            dials.channels[0].place.get()
        };
        assert_eq!([place(), place()], [Some(1500.0); 2]);
        operator.is_driven.store(false, Relaxed);
        assert_eq!([place(), place()], [Some(2000.0); 2]);
    }

    #[test]
    fn a_released_board_that_reloads_replace_goes_on_from_where_it_was_left() {
        let settings = [ChannelSettings {
            channel: 1,
            sources: valued(&[("jawOpen", 1.0)]),
            speed_per_s: 1.0,
            pulse_at_1_us: 2000,
            ..ChannelSettings::default()
        }];
        let operator = Arc::<Operator>::default();
        let mut now = Instant::now();
        let mut open = Packet { state: State::Live, ..Packet::NEUTRAL };
        open.coefficients[17] = 1.0;
        let mut dials = Arc::new(Dials::new(&settings, &operator));
        let mut board = Board::new(&settings, &dials);
        for _ in 0..=4 {
            now += std::time::Duration::from_millis(100);
            board.follow(&open, now);
        }
        operator.is_released.store(true, Relaxed);
        board.follow(&open, now);
        assert_eq!(dials.channels[0].place.get(), None);
        // The second of these boards never moves, and the third one is off as well.
        for moves in [true, false, true] {
            let next = Arc::new(Dials::new(&settings, &operator));
            next.begin_at(&dials);
            dials = next;
            board = Board::new(&settings, &dials);
            if moves {
                board.follow(&open, now);
            }
        }
        operator.is_released.store(false, Relaxed);
        board.follow(&open, now);
        assert_eq!(dials.channels[0].place.get().map(f32::round), Some(1400.0));
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
        // The driver wants the servos that it does not jog to follow the face.
        dials.keep_still(false);
        let mut board = Board::new(&settings, &dials);
        let mut follow = |seconds: u64, jaw_open: f32| {
            let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
            packet.coefficients[17] = jaw_open;
            for _ in 0..seconds * 50 {
                now += std::time::Duration::from_millis(20);
                board.follow(&packet, now);
            }
            board.channels.iter().map(|channel| (channel.target, channel.target_place())).collect::<Vec<_>>()
        };
        assert_eq!(follow(2, 1.0), [(1.0, Some(2000.0)); 2]);
        dials.jog(Some((3, 7.0)));
        assert_eq!(follow(2, 0.0), [(0.0, Some(1000.0)); 2], "nobody drives");
        operator.is_driven.store(true, Relaxed);
        assert!(follow(2, 0.5) == [(0.2, None), (1.0, Some(2000.0))] && dials.is_operated(), "others are at rest");
        operator.is_released.store(true, Relaxed);
        dials.jog(None);
        assert!(follow(2, 0.0).iter().all(|(_, pulse_us)| pulse_us.is_none()));
        operator.is_released.store(false, Relaxed);
        now += std::time::Duration::from_millis(20);
        let first = board.follow(&Packet { state: State::Live, ..Packet::NEUTRAL }, now)[1].target_place().unwrap();
        assert!((1979.0..2000.0).contains(&first), "{first}: the first pulse is that of the place where it was left");
        now += std::time::Duration::from_millis(20);
        assert_eq!(
            board.follow(&Packet { state: State::Live, ..Packet::NEUTRAL }, now)[1].target_place(),
            Some(1000.0)
        );
        assert!((0.95..0.97).contains(&dials.channels[1].position.get().unwrap()) && !dials.is_operated());
    }

    #[test]
    fn a_jog_of_a_channel_without_a_limit_of_speed_takes_two_seconds_from_end_to_end_on_every_board() {
        let limited = |channel, speed_per_s| ChannelSettings { channel, speed_per_s, ..ChannelSettings::default() };
        let settings = [limited(1, 0.0), limited(2, 2.0)];
        let operator = Arc::<Operator>::default();
        let dials = Arc::new(Dials::new(&settings, &operator));
        dials.keep_still(false);
        let mut board = Board::new(&settings, &dials);
        let mut now = Instant::now();
        operator.is_driven.store(true, Relaxed);
        // Boards that keep the limits of the settings by themselves get the target, and others the place on the way there.
        for (channel, second, at_once) in [(0, 1500.0, false), (1, 2000.0, true)] {
            dials.jog(Some((settings[channel].channel as u16, 1.0)));
            let mut places = (0..=100).map(|_| {
                now += std::time::Duration::from_millis(20);
                let moved = &board.follow(&Packet::NEUTRAL, now)[channel];
                [moved.target_place(), moved.place_now()].map(|place| place.unwrap().round())
            });
            let [target, _] = places.next().unwrap();
            assert_eq!(target == 2000.0, at_once, "{target}");
            let [_, after_a_second] = places.nth(49).unwrap();
            assert!((after_a_second - second).abs() <= 10.0, "{after_a_second}");
            assert_eq!(places.last(), Some([2000.0; 2]));
        }
        dials.jog(None);
        now += std::time::Duration::from_millis(20);
        let resting = board.follow(&Packet::NEUTRAL, now)[0].target_place();
        assert_eq!(resting, Some(1000.0), "the face moves it without a limit");
    }

    #[test]
    fn a_released_servo_that_is_jogged_gets_pulses_alone_from_where_it_was_left_until_the_jog_ends() {
        let settings = [1, 2].map(|channel| ChannelSettings { channel, neutral: 0.5, ..ChannelSettings::default() });
        let operator = Arc::<Operator>::default();
        let dials = Arc::new(Dials::new(&settings, &operator));
        let mut board = Board::new(&settings, &dials);
        let mut now = Instant::now();
        let mut places = |steps| {
            for _ in 0..steps {
                now += std::time::Duration::from_millis(20);
                board.follow(&Packet { state: State::Live, ..Packet::NEUTRAL }, now);
            }
            (dials.channels.iter().map(|dial| dial.place.get()).collect::<Vec<_>>(), board.is_off && dials.is_off())
        };
        operator.is_released.store(true, Relaxed);
        dials.jog(Some((2, 1.0)));
        assert_eq!(places(10), (vec![None; 2], true), "nobody drives");
        operator.is_driven.store(true, Relaxed);
        let (first, is_off) = places(1);
        assert!(first[0].is_none() && (1500.0..=1520.0).contains(&first[1].unwrap()) && !is_off, "{first:?}");
        assert_eq!(places(200), (vec![None, Some(2000.0)], false));
        dials.jog(Some((1, 0.5)));
        assert_eq!(places(200), (vec![Some(1500.0), None], false));
        dials.jog(None);
        assert_eq!(places(1), (vec![None; 2], true));
    }

    #[test]
    fn a_board_that_is_to_be_still_stays_where_it_is_with_or_without_pulses_while_an_operator_drives() {
        let slow = |channel, loss| {
            let sources = valued(&[("jawOpen", 1.0)]);
            ChannelSettings { channel, sources, speed_per_s: 1.0, loss, ..ChannelSettings::default() }
        };
        let settings = [slow(1, AtLoss::Neutral), slow(2, AtLoss::Release)];
        let operator = Arc::<Operator>::default();
        let dials = Arc::new(Dials::new(&settings, &operator));
        let mut board = Board::new(&settings, &dials);
        let mut now = Instant::now();
        let mut places = |state, jaw_open, steps| {
            let mut packet = Packet { state, ..Packet::NEUTRAL };
            packet.coefficients[17] = jaw_open;
            for _ in 0..steps {
                now += std::time::Duration::from_millis(20);
                board.follow(&packet, now);
            }
            [0, 1].map(|index: usize| dials.channels[index].place.get().map(f32::round))
        };
        dials.keep_still(true);
        assert_eq!(places(State::Live, 1.0, 26), [Some(1500.0); 2], "nobody drives");
        operator.is_driven.store(true, Relaxed);
        for (state, jaw_open) in [(State::Live, 1.0), (State::Live, 0.0), (State::Neutral, 0.0)] {
            assert_eq!(places(state, jaw_open, 50), [Some(1500.0); 2], "{state:?}");
        }
        operator.is_released.store(true, Relaxed);
        assert_eq!(places(State::Live, 1.0, 1), [None; 2]);
        operator.is_released.store(false, Relaxed);
        assert_eq!(places(State::Live, 1.0, 50), [None; 2], "it stays released");
        operator.is_driven.store(false, Relaxed);
        assert_eq!(places(State::Neutral, 0.0, 100), [Some(1000.0), None]);
        operator.is_driven.store(true, Relaxed);
        assert_eq!(places(State::Live, 1.0, 50), [Some(1000.0), None], "it had no pulses without a face");
        dials.jog(Some((2, 0.5)));
        assert_eq!(places(State::Live, 1.0, 100), [Some(1000.0), Some(1500.0)]);
    }
}
