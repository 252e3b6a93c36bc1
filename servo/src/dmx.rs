//! DMX: the channels of servos, or the whole face, as the values of a universe.
//!
//! A node that moves servos, such as FPP, turns the lowest value into its shortest pulse and the highest into its longest,
//! which are 1000 and 2000 µs unless somebody changes them, or uses the value as the pulse itself. It reads 0 as "no data", so
//! a channel that has no pulse without a face is 0. Other nodes take 0 for a place at the end of the range, so [`AtStop`] says
//! what they get while an operator has stopped the servos.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use facewire_packet::Packet;

use crate::{Board, ChannelSettings, Dials, SOURCE_NAMES};

/// The values of a universe in the order of their addresses, which count from 1.
pub type Universe = [u8; 512];

/// The pulses of the lowest and the highest value, µs.
pub const PULSES_US: [u32; 2] = [1000, 2000];

/// How a DMX channel represents a pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// 1 to 255.
    Bits8,
    /// 1 to 65535 at two addresses, of which the first has the upper 8 bits.
    Bits16,
    /// The pulse in microseconds, at two addresses as well.
    Microseconds,
}

/// What a node gets while an operator has stopped the servos. No value takes the power from them at every node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AtStop {
    /// The last values, so that nothing moves, whatever the node takes 0 for.
    Hold,
    /// [`ChannelSettings::stop_value`] of each channel.
    Value,
    /// Nothing more: the stream ends, and the node does what its own settings say.
    End,
}

/// How often the end of a stream is sent, because datagrams get lost.
const ENDS: u8 = 3;

impl Encoding {
    /// How many addresses a channel takes.
    #[must_use]
    pub fn width(self) -> u32 {
        if self == Self::Bits8 { 1 } else { 2 }
    }

    fn value(self, pulse_us: f32) -> u16 {
        let [least_us, most_us] = PULSES_US.map(|pulse_us| pulse_us as f32);
        let position = ((pulse_us - least_us) / (most_us - least_us)).clamp(0.0, 1.0);
        match self {
            Self::Bits8 => 1 + (position * 254.0).round() as u16,
            Self::Bits16 => 1 + (position * 65_534.0).round() as u16,
            Self::Microseconds => pulse_us.round().max(1.0) as u16,
        }
    }
}

impl ChannelSettings {
    /// The addresses of the channel in a universe.
    #[must_use]
    pub fn addresses(&self) -> Range<u32> {
        self.channel..self.channel + self.dmx.width()
    }

    /// The channels of the whole face, from address 1: each coefficient, and each angle of the head from -90 to 90 degrees.
    #[must_use]
    pub fn whole_face(dmx: Encoding) -> Vec<Self> {
        let channel = |(index, name): (usize, &&str)| {
            let mut channel = Self { channel: 1 + index as u32 * dmx.width(), dmx, ..Self::default() };
            let (gain, offset) = if name.starts_with("head") { (1.0 / 180.0, 0.5) } else { (1.0, 0.0) };
            channel.offset = offset;
            channel.sources.iter_mut().skip(index).take(1).for_each(|source| *source = gain);
            channel
        };
        SOURCE_NAMES.iter().enumerate().map(channel).collect()
    }
}

/// The channels of one universe, and their values.
pub struct Values {
    board: Board,
    universe: Universe,
    at_stop: AtStop,
    /// Whether the universe has values of a face, which can be held.
    is_known: bool,
    /// How often the end of the stream was sent since the operator stopped the servos.
    ends: u8,
}

impl Values {
    /// Without channels, the universe has the [whole face](ChannelSettings::whole_face) in the encoding `whole_face`.
    #[must_use]
    pub fn new(channels: &[ChannelSettings], whole_face: Encoding, at_stop: AtStop, dials: &Arc<Dials>) -> Self {
        let face = if channels.is_empty() { ChannelSettings::whole_face(whole_face) } else { channels.to_vec() };
        Self { board: Board::new(&face, dials), universe: [0; 512], at_stop, is_known: false, ends: 0 }
    }

    /// Moves the channels with the face, within their limits. Addresses that no channel has are 0. Returns the universe, and
    /// whether its stream ends; or `None` if the node is to get nothing now.
    pub fn follow(&mut self, packet: &Packet, now: Instant) -> Option<(&Universe, bool)> {
        self.board.follow(packet, now);
        let is_off = self.board.is_off;
        self.ends = if is_off { self.ends } else { 0 };
        match self.at_stop {
            // A service that starts while the servos are stopped does not know where they stand.
            AtStop::Hold | AtStop::End if is_off && !self.is_known => None,
            AtStop::Hold if is_off => Some((&self.universe, false)),
            AtStop::End if is_off && self.ends >= ENDS => None,
            AtStop::End if is_off => {
                self.ends += 1;
                Some((&self.universe, true))
            }
            AtStop::Hold | AtStop::Value | AtStop::End => Some((self.write(), false)),
        }
    }

    /// Writes the values of all channels into the universe. While an operator has stopped all servos but one, the others have
    /// what the node gets of stopped servos: if nobody knows their last values, those of the places where they rest.
    fn write(&mut self) -> &Universe {
        let was_known = self.is_known;
        self.is_known |= !self.board.is_off;
        for channel in &self.board.channels {
            let settings = &channel.settings;
            let of_pulse = |pulse_us| settings.dmx.value(pulse_us);
            let value = match self.at_stop {
                _ if !channel.is_off => channel.place_now().map_or(0, of_pulse),
                AtStop::Value => settings.stop_value as u16,
                AtStop::Hold | AtStop::End if was_known => continue,
                AtStop::Hold | AtStop::End => of_pulse(channel.place(channel.motion.position)),
            };
            let value = value.to_be_bytes();
            let bytes = if settings.dmx.width() == 1 { &value[1..] } else { &value };
            let first = settings.channel.saturating_sub(1) as usize;
            self.universe.iter_mut().skip(first).zip(bytes).for_each(|(to, from)| *to = *from);
        }
        &self.universe
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{AtLoss, Operator, channel::tests::valued};
    use facewire_packet::{Reason, State};
    use std::sync::atomic::Ordering::Relaxed;
    use std::time::Duration;

    fn channel(channel: u32, dmx: Encoding) -> ChannelSettings {
        ChannelSettings { channel, dmx, sources: valued(&[("jawOpen", 1.0)]), ..ChannelSettings::default() }
    }

    fn face(state: State, jaw_open: f32) -> Packet {
        let mut packet = Packet { state, ..Packet::NEUTRAL };
        packet.coefficients[17] = jaw_open;
        packet
    }

    #[test]
    fn a_stop_holds_the_last_values_or_ends_the_stream_or_sends_the_values_of_the_settings_and_nothing_moves_before() {
        let channels = [ChannelSettings { stop_value: 7, ..channel(1, Encoding::Bits8) }];
        for (at_stop, while_stopped, at_a_start) in [
            (AtStop::Hold, [Some((255, false)); 4], None),
            (AtStop::End, [Some((255, true)), Some((255, true)), Some((255, true)), None], None),
            (AtStop::Value, [Some((7, false)); 4], Some((7, false))),
        ] {
            let operator = Arc::<Operator>::default();
            operator.is_released.store(true, Relaxed);
            let dials = Arc::new(Dials::new(&channels, &operator));
            let mut values = Values::new(&channels, Encoding::Bits16, at_stop, &dials);
            let mut now = Instant::now();
            let mut shown = |jaw_open| {
                now += Duration::from_millis(25);
                let shown = values.follow(&face(State::Live, jaw_open), now);
                shown.map(|(universe, ends)| (universe[0], ends))
            };
            assert_eq!(shown(1.0), at_a_start, "{at_stop:?}: nobody knows where the servos stand");
            for _ in 0..2 {
                operator.is_released.store(false, Relaxed);
                assert_eq!(shown(1.0), Some((255, false)), "{at_stop:?}");
                operator.is_released.store(true, Relaxed);
                assert_eq!([0.0, 0.5, 0.2, 0.9].map(&mut shown), while_stopped, "{at_stop:?}");
            }
        }
    }

    #[test]
    fn a_jog_of_a_stopped_servo_leaves_the_others_of_the_universe_as_they_are_or_at_rest_if_nobody_knows_how_they_are()
    {
        let channels =
            [1, 2].map(|number| ChannelSettings { neutral: 0.5, stop_value: 7, ..channel(number, Encoding::Bits8) });
        for (at_stop, at_a_start, after_a_face) in
            [(AtStop::Hold, 128, 255), (AtStop::End, 128, 255), (AtStop::Value, 7, 7)]
        {
            let operator = Arc::<Operator>::default();
            let dials = Arc::new(Dials::new(&channels, &operator));
            // The driver wants the servos that it does not jog to follow the face.
            dials.keep_still(false);
            let mut values = Values::new(&channels, Encoding::Bits16, at_stop, &dials);
            let mut now = Instant::now();
            let mut shown = |is_released| {
                operator.is_released.store(is_released, Relaxed);
                now += Duration::from_secs(1);
                values.follow(&face(State::Live, 1.0), now).map(|(universe, ends)| (universe[0], universe[1], ends))
            };
            operator.is_driven.store(true, Relaxed);
            dials.jog(Some((2, 0.5)));
            assert_eq!(shown(true), Some((at_a_start, 128, false)), "{at_stop:?}");
            dials.jog(None);
            assert_eq!(shown(false), Some((255, 255, false)), "{at_stop:?}");
            dials.jog(Some((2, 1.0)));
            assert_eq!(shown(true), Some((after_a_face, 255, false)), "{at_stop:?}");
        }
    }

    fn values(channels: &[ChannelSettings]) -> (Values, Arc<Operator>) {
        let operator = Arc::<Operator>::default();
        let dials = Arc::new(Dials::new(channels, &operator));
        (Values::new(channels, Encoding::Bits16, AtStop::Value, &dials), operator)
    }

    #[test]
    fn a_pulse_is_a_value_of_8_or_16_bits_or_itself_with_the_upper_byte_first_and_is_never_0() {
        let ends =
            |pulse_at_0_us, pulse_at_1_us, it: ChannelSettings| ChannelSettings { pulse_at_0_us, pulse_at_1_us, ..it };
        let channels = [
            channel(1, Encoding::Bits8),
            channel(2, Encoding::Bits16),
            channel(511, Encoding::Microseconds),
            ends(1750, 1250, channel(300, Encoding::Bits8)),
        ];
        let (mut values, _) = values(&channels);
        for (jaw_open, want, of_narrow) in [
            (-1.0, [1, 0, 1, 0x03, 0xE8], 192),
            (0.5, [128, 0x80, 0x00, 0x05, 0xDC], 128),
            (f32::INFINITY, [255, 0xFF, 0xFF, 0x07, 0xD0], 65),
            (f32::NAN, [255, 0xFF, 0xFF, 0x07, 0xD0], 65),
        ] {
            let (universe, _) = values.follow(&face(State::Live, jaw_open), Instant::now()).unwrap();
            assert_eq!([0, 1, 2, 510, 511].map(|place: usize| universe[place]), want, "{jaw_open}");
            assert_eq!((universe[299], universe.iter().filter(|value| **value > 0).count() <= 6), (of_narrow, true));
        }
        assert_eq!([0.0, 64.0, 999.0, 1e9].map(|us| Encoding::Bits16.value(us)), [1, 1, 1, 65_535]);
        assert_eq!([f32::NAN, -5.0, 1e9].map(|us| Encoding::Microseconds.value(us)), [1, 1, 65_535]);
    }

    #[test]
    fn a_channel_is_0_once_the_face_is_lost_only_if_it_is_to_be_released_and_on_the_word_of_an_operator() {
        let release = ChannelSettings { loss: AtLoss::Release, ..channel(2, Encoding::Bits8) };
        let (mut values, operator) = values(&[channel(1, Encoding::Bits8), release]);
        let mut now = Instant::now();
        let mut first_two = |state, reason| {
            now += Duration::from_millis(25);
            let (universe, _) = values.follow(&Packet { reason, ..face(state, 1.0) }, now).unwrap();
            [universe[0], universe[1]]
        };
        assert_eq!(first_two(State::Live, Reason::None), [255, 255]);
        assert_eq!(first_two(State::Decay, Reason::NoFace), [255, 255]);
        assert_eq!(first_two(State::Neutral, Reason::NoFace), [1, 0]);
        assert_eq!(first_two(State::Live, Reason::None), [255, 255]);
        operator.is_released.store(true, Relaxed);
        assert_eq!(first_two(State::Live, Reason::None), [0, 0]);
    }

    #[test]
    fn a_slow_channel_moves_by_as_much_as_its_limit_allows() {
        let (mut values, _) = values(&[ChannelSettings { speed_per_s: 1.0, ..channel(7, Encoding::Bits8) }]);
        let begun = Instant::now();
        let shown: Vec<u8> = (0..5)
            .map(|step| values.follow(&face(State::Live, 1.0), begun + step * Duration::from_millis(100)).unwrap().0[6])
            .collect();
        // Within the first step no time has passed.
        assert_eq!(shown, [1, 26, 52, 77, 103]);
    }

    #[test]
    fn the_whole_face_has_55_channels_from_address_1_without_gaps_and_a_straight_head_in_their_middle() {
        for (encoding, last) in [(Encoding::Bits8, 55), (Encoding::Bits16, 110)] {
            let face = ChannelSettings::whole_face(encoding);
            assert!(face.windows(2).all(|pair| pair[0].addresses().end == pair[1].channel));
            assert_eq!((face[0].channel, face[54].addresses().end), (1, last + 1));
        }
        let (mut values, _) = values(&[]);
        let (universe, _) = values.follow(&face(State::Live, 1.0), Instant::now()).unwrap();
        assert_eq!((&universe[34..36], &universe[104..112]), (&[255, 255][..], &[128, 0, 128, 0, 128, 0, 0, 0][..]));
        assert_eq!(universe[..2], [0, 1]);
    }
}
