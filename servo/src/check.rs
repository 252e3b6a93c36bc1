//! Channels that a board cannot follow, and what to give instead.

use std::fmt::Display;
use std::ops::RangeInclusive;

use crate::ChannelSettings;
use crate::bus::{Family, MOST_SERVOS, Unit};
use crate::dmx::{Encoding, PULSES_US};
use crate::maestro::{ACCELERATION_UNIT_US_PER_S2, SPEED_UNIT_US_PER_S};
use crate::pca9685::{CHANNELS, Period};

const PULSES: [&str; 2] = ["link.channel.pulse_at_0_us", "link.channel.pulse_at_1_us"];
const POSITIONS: [&str; 2] = ["link.channel.position_at_0", "link.channel.position_at_1"];

/// What boards of a kind can do.
pub struct Capabilities {
    name: &'static str,
    /// The numbers of channels.
    channels: RangeInclusive<u32>,
    /// Whether channels have addresses and values by DMX.
    is_dmx: bool,
    /// Whether the ends are places of bus servos, in the unit of the settings. Otherwise they are pulses.
    is_bus: bool,
    /// The longest pulse in microseconds, or the highest place in the unit of the settings.
    highest_end: f32,
    /// Least limits of speed and acceleration that the board can keep, in the unit of its ends.
    least_limits: [f32; 2],
}

impl Capabilities {
    /// The values of a universe stand for pulses, and a channel of 16 bits takes two addresses.
    pub const DMX: Self = Self {
        name: "universe",
        channels: 1..=512,
        is_dmx: true,
        is_bus: false,
        highest_end: 65_535.0,
        least_limits: [0.0; 2],
    };

    /// Maestros with 12 channels or more, which have the command for several targets, make longer pulses.
    #[must_use]
    pub fn maestro(has_multiple_targets: bool) -> Self {
        let highest_end = if has_multiple_targets { 4080.0 } else { 3280.0 };
        let least_limits = [SPEED_UNIT_US_PER_S, ACCELERATION_UNIT_US_PER_S2];
        Self { name: "Maestro", channels: 0..=23, is_dmx: false, highest_end, least_limits, ..Self::DMX }
    }

    /// A pulse of a PCA9685 ends within the period.
    #[must_use]
    pub fn pca9685(period: Period) -> Self {
        let (highest_end, channels) = (period.longest_pulse_us().floor(), 0..=u32::from(CHANNELS) - 1);
        Self { name: "PCA9685", channels, is_dmx: false, highest_end, ..Self::DMX }
    }

    /// Bus servos of a family, whose ends have this unit.
    #[must_use]
    pub fn bus_servo(family: &Family, unit: Unit) -> Self {
        let step = unit.step(family);
        let (highest_end, least_limits) = (f32::from(family.most_steps) * step, family.units.map(|it| it * step));
        Self { name: family.name, channels: 0..=252, is_dmx: false, is_bus: true, highest_end, least_limits }
    }
}

/// A setting that cannot work: its key, its value, and what to give instead.
#[derive(Debug)]
pub struct Fault {
    pub key: &'static str,
    pub value: String,
    pub expected: String,
}

/// Returns the faults of the channels of one board. Sources are checked only if all of them could be read.
#[must_use]
pub fn faults(board: &Capabilities, channels: &[ChannelSettings], has_sources: bool) -> Vec<Fault> {
    let mut check = Check { board, faults: Vec::new() };
    for (index, channel) in channels.iter().enumerate() {
        check.number(channel, channels.get(..index).unwrap_or_default());
        if has_sources {
            check.sources(channel);
        }
        check.motion(channel);
    }
    let is_one_too_many = board.is_bus && channels.len() > MOST_SERVOS;
    let expected = format!("at most {MOST_SERVOS} servos on one line, and others another line and link");
    check.need(!is_one_too_many, "link.channel", channels.len(), expected);
    check.faults
}

/// Returns a note if the sum of a channel can leave 0 to 1 and is limited, which may be intended.
#[must_use]
pub fn limited(channel: &ChannelSettings) -> Option<String> {
    let [least, most] = channel.range();
    let sum = format!("the sum of its sources goes from {least} to {most} and is limited to 0 to 1");
    (least < 0.0 || most > 1.0).then(|| format!("{sum}; with smaller numbers it would use its whole range"))
}

struct Check<'a> {
    board: &'a Capabilities,
    faults: Vec<Fault>,
}

impl Check<'_> {
    fn need(&mut self, is_good: bool, key: &'static str, value: impl Display, expected: String) {
        if !is_good {
            self.faults.push(Fault { key, value: value.to_string(), expected });
        }
    }

    fn number(&mut self, channel: &ChannelSettings, earlier: &[ChannelSettings]) {
        let Capabilities { name, channels, .. } = self.board;
        let (key, number, is_dmx) = ("link.channel.channel", channel.channel, self.board.is_dmx);
        let overlaps = |other: &&ChannelSettings| {
            let [one, other] = [channel.addresses(), other.addresses()];
            if is_dmx { one.start < other.end && other.start < one.end } else { one.start == other.start }
        };
        if let Some(other) = earlier.iter().find(overlaps) {
            let [taken, wanted] = [other, channel].map(|it| (it.channel, it.addresses().end - 1));
            let expected = if is_dmx && taken != wanted {
                let list = |(first, last): (u32, u32)| {
                    if first == last { first.to_string() } else { format!("{first} and {last}") }
                };
                let why = format!("channel {} takes {}, and this one {}", taken.0, list(taken), list(wanted));
                format!("addresses that no earlier channel takes: {why}")
            } else {
                "a number that no earlier channel of this board has".to_owned()
            };
            self.need(false, key, number, expected);
        }
        let [first, last] = [*channels.start(), *channels.end()];
        let (last, two) =
            if is_dmx && channel.dmx.width() > 1 { (last - 1, ", and one of 16 bits takes two") } else { (last, "") };
        let expected = format!("{first} to {last}: these are the channels of a {name}{two}");
        self.need((first..=last).contains(&number), key, number, expected);
    }

    fn sources(&mut self, channel: &ChannelSettings) {
        let label = channel.label();
        if channel.used_sources().next().is_none() {
            let expected = format!("at least one source for channel {label}, such as {{ jawOpen = 1.0 }}");
            return self.need(false, "link.channel.sources", "{}", expected);
        }
        let [least, most] = channel.range();
        let sum = format!("its sum goes from {least} to {most}, so that it always stays at one end");
        let expected = format!("another offset for channel {label}: {sum}");
        self.need(least < 1.0 && most > 0.0, "link.channel.offset", channel.offset, expected);
    }

    fn motion(&mut self, channel: &ChannelSettings) {
        let ChannelSettings { pulse_at_0_us, pulse_at_1_us, .. } = *channel;
        let label = channel.label();
        let Capabilities { name, is_dmx, is_bus, highest_end, least_limits: [least_speed, least_acceleration], .. } =
            *self.board;
        let (end, ends, why) = if is_bus {
            let ends = [channel.position_at_0, channel.position_at_1];
            ("place", ends, format!("a servo of {name} goes no further"))
        } else {
            let ends = [pulse_at_0_us, pulse_at_1_us].map(|pulse_us| pulse_us as f32);
            ("pulse", ends, format!("the {name} cannot make a longer pulse"))
        };
        let keys = if is_bus { POSITIONS } else { PULSES };
        for (key, at) in keys.into_iter().zip(ends) {
            self.need(at <= highest_end, key, at, format!("at most {highest_end:.0} for channel {label}: {why}"));
            let [least_us, most_us] = PULSES_US;
            let values =
                format!("the lowest value is {least_us} µs and the highest {most_us}, unless dmx = \"microseconds\"");
            let is_value = !is_dmx || channel.dmx == Encoding::Microseconds;
            let expected = format!("{least_us} to {most_us} for channel {label}: {values}");
            self.need(is_value || (least_us as f32..=most_us as f32).contains(&at), key, at, expected);
        }
        let (at_0, span) = (keys[0].trim_start_matches("link.channel."), (ends[0] - ends[1]).abs());
        let expected = format!("another {end} than {at_0} for channel {label}: the servo would not move");
        self.need(span != 0.0, keys[1], ends[1], expected);
        let limits = [
            ("link.channel.speed_per_s", channel.speed_per_s, least_speed),
            ("link.channel.acceleration_per_s2", channel.acceleration_per_s2, least_acceleration),
        ];
        // A board that counts limits in units cannot keep one below a unit.
        for (key, limit, least) in limits.into_iter().filter(|_| span > 0.0) {
            let rounded_up = (least / span * 1000.0).ceil() / 1000.0;
            let expected = format!("0 or at least {rounded_up:.3} for channel {label}: the {name} cannot keep less");
            self.need(limit <= 0.0 || limit * span >= least, key, limit, expected);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{bus::FAMILIES, channel::tests::valued};

    fn jaw(channel: u32) -> ChannelSettings {
        ChannelSettings { channel, sources: valued(&[("jawOpen", 1.0)]), ..ChannelSettings::default() }
    }

    fn told(board: &Capabilities, channels: &[ChannelSettings]) -> String {
        let fault = |Fault { key, value, expected }| format!("{key} = {value}: give {expected}");
        faults(board, channels, true).into_iter().map(fault).collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn what_a_board_cannot_follow_is_refused_with_key_value_and_remedy() {
        let with = |change: fn(&mut ChannelSettings)| {
            let mut channel = jaw(3);
            change(&mut channel);
            channel
        };
        for (channel, want) in [
            (jaw(3), ""),
            (jaw(24), "link.channel.channel = 24: give 0 to 23: these are the channels of a Maestro"),
            (with(|it| it.sources.fill(0.0)), "link.channel.sources = {}: give at least one source for channel 3"),
            (with(|it| it.offset = 1.0), "link.channel.offset = 1: give another offset for channel 3: its sum goes"),
            (with(|it| it.pulse_at_1_us = 3281), "link.channel.pulse_at_1_us = 3281: give at most 3280 for channel 3"),
            (with(|it| it.pulse_at_0_us = 2000), "link.channel.pulse_at_1_us = 2000: give another pulse than"),
            (with(|it| it.speed_per_s = 0.02), "link.channel.speed_per_s = 0.02: give 0 or at least 0.025 for"),
            (with(|it| it.speed_per_s = 0.025), ""),
            (with(|it| it.acceleration_per_s2 = 0.3), "link.channel.acceleration_per_s2 = 0.3: give 0 or at least"),
            (with(|it| it.acceleration_per_s2 = 0.313), ""),
            (
                with(|it| {
                    it.name = "left brow".to_owned();
                    it.offset = 1.0;
                }),
                "link.channel.offset = 1: give another offset for channel 3 (left brow): its sum goes",
            ),
        ] {
            let told = told(&Capabilities::maestro(false), &[channel]);
            assert!(told.starts_with(want) && told.is_empty() == want.is_empty(), "{want}: {told}");
        }
        let slow_or_late = [with(|it| it.speed_per_s = 0.02), with(|it| it.pulse_at_0_us = 2600)];
        for (board, want) in [
            (Capabilities::maestro(false), "speed_per_s = 0.02"),
            (Capabilities::pca9685(Period::new(400, 25_000_000)), "pulse_at_0_us = 2600"),
        ] {
            let told = slow_or_late.each_ref().map(|channel| told(&board, std::slice::from_ref(channel))).concat();
            assert!(told.starts_with(&format!("link.channel.{want}: give")) && !told.contains('\n'), "{told}");
        }
        let served = |position_at_0, position_at_1, speed_per_s| {
            let board = Capabilities::bus_servo(FAMILIES[3].1, Unit::Degrees);
            let channel = ChannelSettings { position_at_0, position_at_1, speed_per_s, ..jaw(252) };
            told(&board, &[channel])
        };
        for (channel, want) in [
            (served(0.0, 359.9, 1.0), ""),
            (
                served(90.0, 361.0, 1.0),
                "link.channel.position_at_1 = 361: give at most 360 for channel 252: a servo of",
            ),
            (
                served(90.0, 90.0, 1.0),
                "link.channel.position_at_1 = 90: give another place than position_at_0 for chan",
            ),
            (served(80.0, 90.0, 0.4), "link.channel.speed_per_s = 0.4: give 0 or at least 0.440 for channel 252: the"),
        ] {
            assert!(channel.starts_with(want) && channel.is_empty() == want.is_empty(), "{want}: {channel}");
        }
        let line: Vec<_> = (1..=31).map(|id| ChannelSettings { position_at_1: 100.0, ..jaw(id) }).collect();
        let told_of_line = told(&Capabilities::bus_servo(Family::DYNAMIXEL_X, Unit::Steps), &line);
        assert!(told_of_line.starts_with("link.channel = 31: give at most 30 servos on one line"), "{told_of_line}");
        let twice = "link.channel.channel = 3: give a number that no earlier channel of this board has";
        assert_eq!(told(&Capabilities::maestro(false), &[jaw(3), jaw(3)]), twice);
        let wide = ChannelSettings { dmx: Encoding::Bits16, ..jaw(3) };
        assert_eq!(told(&Capabilities::maestro(false), &[wide, jaw(4)]), "", "the form is that of DMX alone");
        assert!(faults(&Capabilities::maestro(false), &[with(|it| it.sources.fill(0.0))], false).is_empty());
    }

    #[test]
    fn channels_of_a_universe_overlap_neither_each_other_nor_its_end_and_keep_within_its_values() {
        let form = |channel, dmx| ChannelSettings { dmx, ..jaw(channel) };
        let pulse = |pulse_at_1_us, dmx| ChannelSettings { pulse_at_1_us, ..form(1, dmx) };
        let (one, two) = (Encoding::Bits8, Encoding::Bits16);
        for (channels, want) in [
            (&[form(1, one), form(2, two), form(4, one), form(511, two)][..], ""),
            (&[jaw(0)], "link.channel.channel = 0: give 1 to 512: these are the channels of a universe"),
            (&[form(512, one)], ""),
            (&[form(512, two)], "link.channel.channel = 512: give 1 to 511: these are the channels of a universe, and"),
            (
                &[form(10, two), form(11, one)],
                "link.channel.channel = 11: give addresses that no earlier channel takes: channel 10",
            ),
            (
                &[form(11, one), form(10, two)],
                "link.channel.channel = 10: give addresses that no earlier channel takes: channel 11",
            ),
            (&[form(9, one), form(9, one)], "link.channel.channel = 9: give a number that no earlier channel"),
            (&[pulse(2100, one)], "link.channel.pulse_at_1_us = 2100: give 1000 to 2000 for channel 1: the lowest"),
            (&[pulse(2100, Encoding::Microseconds)], ""),
        ] {
            let told = told(&Capabilities::DMX, channels);
            assert!(told.starts_with(want) && told.is_empty() == want.is_empty(), "{want}: {told}");
        }
    }
}
