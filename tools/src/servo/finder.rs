//! What keys do: they change the pulse, and take it as that of an end or of the neutral position.

use std::fmt::Write as _;

/// The pulses that keys reach, microseconds. Nearly all servos stay within them.
const REACH_US: [u16; 2] = [500, 2500];
/// Number of steps by which the keys up and down move.
const LARGE: i32 = 5;
/// An example, because a channel must follow something and the user has not said yet what.
const SOURCES: &str = "sources = { jawOpen = 1.0 }   # what the servo follows";

/// A key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Key {
    /// Moves by this number of steps.
    Move(i32),
    /// Takes the pulse as that of position 0.
    At0,
    /// Takes the pulse as that of position 1.
    At1,
    /// Takes the pulse as the neutral one.
    Neutral,
    /// Ends or begins the pulses.
    Pulses,
    /// Ends the command.
    End,
}

impl Key {
    /// The large move in this direction.
    pub fn large(direction: i32) -> Self {
        Self::Move(LARGE * direction)
    }
}

/// The pulse, and the pulses that were taken, microseconds.
#[derive(Debug)]
pub struct Finder {
    pulse_us: u16,
    step_us: u16,
    is_driven: bool,
    at_0_us: Option<u16>,
    at_1_us: Option<u16>,
    neutral_us: Option<u16>,
}

impl Finder {
    /// Begins at this pulse, which the servo gets with the first key.
    pub fn new(start_us: u16, step_us: u16) -> Self {
        let [at_0_us, at_1_us, neutral_us] = [None; 3];
        Self { pulse_us: start_us, step_us, is_driven: false, at_0_us, at_1_us, neutral_us }
    }

    /// Does what the key says. The first key that moves only begins the pulses.
    pub fn press(&mut self, key: Key) {
        match key {
            Key::Move(_) if !self.is_driven => self.is_driven = true,
            Key::Move(steps) => {
                let [least, most] = REACH_US.map(i32::from);
                let pulse_us = (i32::from(self.pulse_us) + steps * i32::from(self.step_us)).clamp(least, most);
                self.pulse_us = u16::try_from(pulse_us).unwrap_or(self.pulse_us);
            }
            Key::At0 => self.at_0_us = Some(self.pulse_us),
            Key::At1 => self.at_1_us = Some(self.pulse_us),
            Key::Neutral => self.neutral_us = Some(self.pulse_us),
            Key::Pulses => self.is_driven = !self.is_driven,
            Key::End => {}
        }
    }

    /// The pulse for the servo; `None` while it gets none.
    pub fn pulse_us(&self) -> Option<f32> {
        self.is_driven.then(|| self.pulse_us.into())
    }

    /// The pulse that was taken as the neutral one.
    pub fn neutral_us(&self) -> Option<f32> {
        self.neutral_us.map(f32::from)
    }

    /// One line about the state.
    pub fn status(&self) -> String {
        let mut text = format!("{:4} us{}", self.pulse_us, if self.is_driven { "" } else { " (no pulses)" });
        for (name, taken) in [("0", self.at_0_us), ("1", self.at_1_us), ("neutral", self.neutral_us)] {
            // Writing to a string cannot fail.
            let _ = match taken {
                Some(pulse_us) => write!(text, "   {name}: {pulse_us}"),
                None => write!(text, "   {name}: -"),
            };
        }
        text
    }

    /// The lines for the settings.
    pub fn lines(&self, channel: u8) -> String {
        let mut text = format!("[[link.channel]]\nchannel = {channel}\n{SOURCES}\n");
        for (name, taken) in [("pulse_at_0_us", self.at_0_us), ("pulse_at_1_us", self.at_1_us)] {
            let _ = taken.map_or(Ok(()), |pulse_us| writeln!(text, "{name} = {pulse_us}"));
        }
        let _ = self.neutral().map_or(Ok(()), |position| writeln!(text, "neutral = {position:.3}"));
        text
    }

    /// The neutral position between both ends.
    fn neutral(&self) -> Option<f32> {
        let [at_0, at_1, neutral] = [self.at_0_us?, self.at_1_us?, self.neutral_us?].map(f32::from);
        let position = (neutral - at_0) / (at_1 - at_0);
        position.is_finite().then(|| position.clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facewire::config;

    #[test]
    fn the_servo_gets_no_pulses_until_the_first_key_that_moves() {
        let mut finder = Finder::new(1500, 10);
        finder.press(Key::At0);
        assert_eq!(finder.pulse_us(), None);
        finder.press(Key::Move(1));
        assert_eq!(finder.pulse_us(), Some(1500.0));
        finder.press(Key::Move(-1));
        assert_eq!(finder.pulse_us(), Some(1490.0));
        finder.press(Key::Pulses);
        assert_eq!(finder.pulse_us(), None);
    }

    #[test]
    fn no_number_of_keys_leaves_the_reach() {
        let mut finder = Finder::new(1500, 100);
        for direction in [1, -1] {
            (0..50).for_each(|_| finder.press(Key::large(direction)));
            let pulse_us = finder.pulse_us().unwrap();
            assert!((500.0..=2500.0).contains(&pulse_us), "{pulse_us}");
        }
    }

    #[test]
    fn the_lines_for_the_settings_have_what_was_taken_even_if_the_servo_runs_backwards() {
        let mut finder = Finder::new(1500, 100);
        assert_eq!(finder.lines(3), format!("[[link.channel]]\nchannel = 3\n{SOURCES}\n"));
        let takes = [Key::Move(0), Key::Neutral, Key::Move(5), Key::At0, Key::Move(-15), Key::At1];
        for key in takes {
            finder.press(key);
        }
        let want = format!(
            "[[link.channel]]\nchannel = 3\n{SOURCES}\npulse_at_0_us = 2000\npulse_at_1_us = 500\nneutral = 0.333\n"
        );
        assert_eq!(finder.lines(3), want);
    }

    #[test]
    fn the_lines_are_settings_as_they_are_whatever_was_taken() {
        let mut finder = Finder::new(1500, 10);
        for key in [Key::Move(0), Key::Move(1), Key::At0, Key::Move(-2), Key::At1, Key::Neutral] {
            for kind in ["maestro", "pca9685"] {
                let text = format!("[[link]]\nkind = \"{kind}\"\n{}", finder.lines(3));
                assert!(config::parse("test", &text).is_ok(), "{text}");
            }
            finder.press(key);
        }
    }
}
