//! What keys do: they change the pulse, and take it as that of an end or of the neutral position.

use crossterm::event::KeyCode;

/// The pulses that keys reach, microseconds. Nearly all servos stay within them.
const REACH_US: [f32; 2] = [500.0, 2500.0];
/// Number of steps by which the keys up and down move.
const LARGE: f32 = 5.0;
/// An example, because a channel must follow something and the user has not said yet what.
const SOURCES: &str = "sources = { jawOpen = 1.0 }   # what the servo follows";

/// The pulse, and the pulses that were taken, microseconds: those of both ends, and the neutral one.
pub struct Finder {
    pulse_us: f32,
    step_us: f32,
    is_driven: bool,
    taken_us: [Option<f32>; 3],
}

impl Finder {
    /// Begins at this pulse, which the servo gets with the first key.
    pub fn new(pulse_us: u16, step_us: u16) -> Self {
        Self { pulse_us: pulse_us.into(), step_us: step_us.into(), is_driven: false, taken_us: [None; 3] }
    }

    pub fn press(&mut self, key: KeyCode) {
        let [at_0, at_1, neutral] = &mut self.taken_us;
        match key {
            KeyCode::Left => self.step(-1.0),
            KeyCode::Right => self.step(1.0),
            KeyCode::Down => self.step(-LARGE),
            KeyCode::Up => self.step(LARGE),
            KeyCode::Char('0') => *at_0 = Some(self.pulse_us),
            KeyCode::Char('1') => *at_1 = Some(self.pulse_us),
            KeyCode::Char('n') => *neutral = Some(self.pulse_us),
            KeyCode::Char(' ') => self.is_driven = !self.is_driven,
            _ => {}
        }
    }

    /// Moves by this number of steps. The first key that moves only begins the pulses.
    fn step(&mut self, steps: f32) {
        if std::mem::replace(&mut self.is_driven, true) {
            let [least, most] = REACH_US;
            self.pulse_us = (self.pulse_us + steps * self.step_us).clamp(least, most);
        }
    }

    /// The pulse for the servo; `None` while it gets none.
    pub fn pulse_us(&self) -> Option<f32> {
        self.is_driven.then_some(self.pulse_us)
    }

    pub fn neutral_us(&self) -> Option<f32> {
        self.taken_us[2]
    }

    pub fn status(&self) -> String {
        let taken = ["0", "1", "neutral"].iter().zip(self.taken_us).map(|(name, taken)| {
            format!("   {name}: {}", taken.map_or_else(|| "-".to_owned(), |pulse_us| pulse_us.to_string()))
        });
        let pulses = if self.is_driven { "" } else { " (no pulses)" };
        format!("{:4} us{pulses}{}", self.pulse_us, taken.collect::<String>())
    }

    pub fn lines(&self, channel: u8) -> String {
        let mut lines = format!("[[link.channel]]\nchannel = {channel}\n{SOURCES}\n");
        for (name, taken) in ["pulse_at_0_us", "pulse_at_1_us"].iter().zip(self.taken_us) {
            lines.extend(taken.map(|pulse_us| format!("{name} = {pulse_us}\n")));
        }
        if let [Some(at_0), Some(at_1), Some(neutral)] = self.taken_us
            && at_0 != at_1
        {
            let position = ((neutral - at_0) / (at_1 - at_0)).clamp(0.0, 1.0);
            lines += &format!("neutral = {position:.3}\n");
        }
        lines
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
        let keys = [KeyCode::Char('0'), KeyCode::Right, KeyCode::Left, KeyCode::Char(' '), KeyCode::Char(' ')];
        assert_eq!(keys.map(&mut after), [None, Some(1500.0), Some(1400.0), None, Some(1400.0)]);
        for (key, end_us) in [(KeyCode::Up, 2500.0), (KeyCode::Down, 500.0)] {
            assert_eq!((0..50).filter_map(|_| after(key)).last(), Some(end_us));
        }
    }

    #[test]
    fn the_lines_have_what_was_taken_even_of_a_servo_that_runs_backwards_and_load_as_settings() {
        let mut finder = Finder::new(1500, 100);
        let [neutral, at_0, at_1] = ['n', '0', '1'].map(KeyCode::Char);
        let down = KeyCode::Down;
        for key in [KeyCode::Left, neutral, KeyCode::Up, at_0, down, down, down, at_1] {
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
