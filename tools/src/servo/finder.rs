//! What keys do: they change the pulse, and take it as that of an end or of the neutral position.

/// The pulses that keys reach, microseconds. Nearly all servos stay within them.
const REACH_US: [u16; 2] = [500, 2500];
/// An example, because a channel must follow something and the user has not said yet what.
const SOURCES: &str = "sources = { jawOpen = 1.0 }   # what the servo follows";

#[derive(Clone, Copy)]
pub enum Key {
    /// Moves by this number of steps.
    Move(i32),
    /// These take the pulse as that of an end, or as the neutral one.
    At0,
    At1,
    Neutral,
    /// Ends or begins the pulses.
    Pulses,
    /// Ends the command.
    End,
}

/// The pulse, and the pulses that were taken, microseconds.
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
    pub fn new(pulse_us: u16, step_us: u16) -> Self {
        Self { pulse_us, step_us, is_driven: false, at_0_us: None, at_1_us: None, neutral_us: None }
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
        let taken = [("0", self.at_0_us), ("1", self.at_1_us), ("neutral", self.neutral_us)].map(|(name, taken)| {
            format!("   {name}: {}", taken.map_or_else(|| "-".to_owned(), |pulse_us| pulse_us.to_string()))
        });
        format!("{:4} us{}{}", self.pulse_us, if self.is_driven { "" } else { " (no pulses)" }, taken.concat())
    }

    /// The lines for the settings.
    pub fn lines(&self, channel: u8) -> String {
        let line = |name: &str, value: Option<String>| value.map(|value| format!("{name} = {value}\n"));
        let taken = [
            line("pulse_at_0_us", self.at_0_us.map(|pulse_us| pulse_us.to_string())),
            line("pulse_at_1_us", self.at_1_us.map(|pulse_us| pulse_us.to_string())),
            line("neutral", self.neutral().map(|position| format!("{position:.3}"))),
        ];
        format!("[[link.channel]]\nchannel = {channel}\n{SOURCES}\n{}", taken.into_iter().flatten().collect::<String>())
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
    fn the_servo_gets_no_pulses_until_the_first_key_that_moves_and_no_number_of_keys_leaves_the_reach() {
        let mut finder = Finder::new(1500, 100);
        let mut after = |key| {
            finder.press(key);
            finder.pulse_us()
        };
        let pulses = [Key::At0, Key::Move(1), Key::Move(-1), Key::Pulses, Key::Pulses].map(&mut after);
        assert_eq!(pulses, [None, Some(1500.0), Some(1400.0), None, Some(1400.0)]);
        for (steps, end_us) in [(5, 2500.0), (-5, 500.0)] {
            assert_eq!((0..50).filter_map(|_| after(Key::Move(steps))).last(), Some(end_us));
        }
    }

    #[test]
    fn the_lines_have_what_was_taken_even_of_a_servo_that_runs_backwards_and_load_as_settings() {
        let mut finder = Finder::new(1500, 100);
        for key in [Key::Move(0), Key::Neutral, Key::Move(5), Key::At0, Key::Move(-15), Key::At1] {
            finder.press(key);
            for kind in ["maestro", "pca9685"] {
                let text = format!("[[link]]\nkind = \"{kind}\"\n{}", finder.lines(3));
                assert!(config::parse("test", &text).is_ok(), "{text}");
            }
        }
        let taken = "pulse_at_0_us = 2000\npulse_at_1_us = 500\nneutral = 0.333\n";
        assert_eq!(finder.lines(3), format!("[[link.channel]]\nchannel = 3\n{SOURCES}\n{taken}"));
    }
}
