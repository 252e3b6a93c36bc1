//! Finds the ends of a servo: keys change its place, and take it as that of an end or as the neutral one.

/// The pulses that keys reach, microseconds. Nearly all servos stay within them.
pub const REACH_US: [f32; 2] = [500.0, 2500.0];
/// An example, because a channel must follow something and the user has not said yet what.
const SOURCES: &str = "sources = { jawOpen = 1.0 }   # what the servo follows";

/// What a key does.
#[derive(Debug, Clone, Copy)]
pub enum Press {
    /// Moves by this number of steps. The first one only begins to drive the servo.
    Move(f32),
    /// Takes the place as that of position 0 or 1.
    End(usize),
    Neutral,
    /// Releases the servo, or drives it.
    Toggle,
}

/// The place of a servo, and the places that were taken: those of both ends, and the neutral one. A place is a pulse in
/// microseconds, or the position of a bus servo in steps.
pub struct Finder {
    place: f32,
    step: f32,
    reach: [f32; 2],
    is_driven: bool,
    taken: [Option<f32>; 3],
    is_bus: bool,
}

impl Finder {
    /// Begins at this place, to which the servo goes with the first key.
    #[must_use]
    pub fn new(place: f32, step: f32, reach: [f32; 2], is_bus: bool) -> Self {
        Self { place, step, reach, is_driven: false, taken: [None; 3], is_bus }
    }

    pub fn press(&mut self, press: Press) {
        match press {
            Press::Move(steps) if std::mem::replace(&mut self.is_driven, true) => {
                let [least, most] = self.reach;
                self.place = (self.place + steps * self.step).clamp(least, most);
            }
            Press::Move(_) => {}
            Press::End(end) => self.taken.iter_mut().skip(end).take(1).for_each(|taken| *taken = Some(self.place)),
            Press::Neutral => self.taken[2] = Some(self.place),
            Press::Toggle => self.is_driven = !self.is_driven,
        }
    }

    /// The place for the servo; `None` while it is released.
    #[must_use]
    pub fn place(&self) -> Option<f32> {
        self.is_driven.then_some(self.place)
    }

    #[must_use]
    pub fn neutral(&self) -> Option<f32> {
        self.taken[2]
    }

    #[must_use]
    pub fn status(&self) -> String {
        let taken = ["0", "1", "neutral"].iter().zip(self.taken).map(|(name, taken)| {
            format!("   {name}: {}", taken.map_or_else(|| "-".to_owned(), |place| place.to_string()))
        });
        let (unit, released) = if self.is_bus { ("steps", " (no torque)") } else { ("us", " (no pulses)") };
        format!("{:4} {unit}{}{}", self.place, if self.is_driven { "" } else { released }, taken.collect::<String>())
    }

    /// The lines of the settings.
    #[must_use]
    pub fn lines(&self, channel: u8) -> String {
        let mut lines = format!("[[link.channel]]\nchannel = {channel}\n{SOURCES}\n");
        let keys = if self.is_bus { ["position_at_0", "position_at_1"] } else { ["pulse_at_0_us", "pulse_at_1_us"] };
        for (key, taken) in keys.iter().zip(self.taken) {
            lines.extend(taken.map(|place| format!("{key} = {place}\n")));
        }
        if let [Some(at_0), Some(at_1), Some(neutral)] = self.taken
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

    #[test]
    fn the_servo_is_released_until_the_first_key_that_moves_and_no_number_of_keys_leaves_the_reach() {
        let mut finder = Finder::new(1500.0, 100.0, REACH_US, false);
        let mut after = |key| {
            finder.press(key);
            finder.place()
        };
        let keys = [Press::End(0), Press::Move(1.0), Press::Move(-1.0), Press::Toggle, Press::Toggle];
        assert_eq!(keys.map(&mut after), [None, Some(1500.0), Some(1400.0), None, Some(1400.0)]);
        for (steps, end) in [(5.0, 2500.0), (-5.0, 500.0)] {
            assert_eq!((0..50).filter_map(|_| after(Press::Move(steps))).last(), Some(end));
        }
    }

    #[test]
    fn the_lines_have_what_was_taken_even_of_a_servo_that_runs_backwards() {
        for (is_bus, taken) in [
            (false, "pulse_at_0_us = 2000\npulse_at_1_us = 500\nneutral = 0.333\n"),
            (true, "position_at_0 = 2000\nposition_at_1 = 500\nneutral = 0.333\n"),
        ] {
            let mut finder = Finder::new(1500.0, 100.0, REACH_US, is_bus);
            let down = Press::Move(-5.0);
            for key in [down, Press::Neutral, Press::Move(5.0), Press::End(0), down, down, down, Press::End(1)] {
                finder.press(key);
            }
            assert_eq!(finder.lines(3), format!("[[link.channel]]\nchannel = 3\n{SOURCES}\n{taken}"));
        }
    }
}
