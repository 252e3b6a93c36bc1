//! Triggers with hysteresis: what a face does, as on or off.

use std::time::{Duration, Instant};

use facewire_packet::BLENDSHAPES;

/// What a trigger watches, and how long it must last.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// The topic's last part.
    pub name: &'static str,
    /// The least of these coefficients counts, so that one side alone is no trigger.
    shapes: &'static [&'static str],
    /// At this value it goes on, and at this it goes off.
    on: f32,
    off: f32,
    /// How long the value must be above the upper threshold. A blink is over within 0.4 s.
    rise: Duration,
}

/// How long a value must be below the lower threshold.
const FALL: Duration = Duration::from_millis(300);

pub const KINDS: [Kind; 3] = [
    Kind {
        name: "smile",
        shapes: &["mouthSmileLeft", "mouthSmileRight"],
        on: 0.5,
        off: 0.3,
        rise: Duration::from_millis(200),
    },
    Kind { name: "mouth_open", shapes: &["jawOpen"], on: 0.3, off: 0.15, rise: Duration::from_millis(200) },
    Kind {
        name: "eyes_shut",
        shapes: &["eyeBlinkLeft", "eyeBlinkRight"],
        on: 0.7,
        off: 0.4,
        rise: Duration::from_millis(500),
    },
];

/// The state of a trigger.
#[derive(Debug, Clone)]
pub struct Trigger {
    kind: Kind,
    is_on: bool,
    /// Since when the value has been beyond the threshold of the other state.
    since: Option<Instant>,
}

impl Trigger {
    /// The triggers of a board, in the order of [`KINDS`].
    pub fn all() -> [Self; 3] {
        KINDS.map(|kind| Self { kind, is_on: false, since: None })
    }

    /// Takes the coefficients of now, and returns whether the trigger is on.
    pub fn update(&mut self, coefficients: &[f32], now: Instant) -> bool {
        let shape =
            |name: &&str| BLENDSHAPES.iter().position(|known| known == name).and_then(|at| coefficients.get(at));
        let value = self.kind.shapes.iter().filter_map(shape).fold(1.0, |least: f32, value| least.min(*value));
        let is_beyond = if self.is_on { value <= self.kind.off } else { value >= self.kind.on };
        if !is_beyond {
            self.since = None;
            return self.is_on;
        }
        let lasts = now.saturating_duration_since(*self.since.get_or_insert(now));
        if lasts >= if self.is_on { FALL } else { self.kind.rise } {
            self.is_on = !self.is_on;
            self.since = None;
        }
        self.is_on
    }
}

#[cfg(test)]
mod tests {
    use facewire_packet::BLENDSHAPE_COUNT;

    use super::*;

    /// What a trigger says to values 50 ms apart: when it changes, in milliseconds.
    fn changes(kind: usize, shapes: &[&str], values: impl IntoIterator<Item = f32>) -> Vec<u64> {
        let mut trigger = Trigger::all()[kind].clone();
        let (begin, mut was, mut found) = (Instant::now(), false, Vec::new());
        for (ms, value) in (0..).step_by(50).zip(values) {
            let mut coefficients = [0.0; BLENDSHAPE_COUNT];
            for shape in shapes {
                coefficients[BLENDSHAPES.iter().position(|known| known == shape).unwrap()] = value;
            }
            let is = trigger.update(&coefficients, begin + Duration::from_millis(ms));
            found.extend((is != was).then_some(ms));
            was = is;
        }
        found
    }

    fn steps(parts: &[(f32, usize)]) -> Vec<f32> {
        parts.iter().flat_map(|(value, count)| vec![*value; *count]).collect()
    }

    #[test]
    fn a_smile_of_both_sides_goes_on_after_200_ms_and_off_below_the_lower_threshold_for_300_ms() {
        let both = ["mouthSmileLeft", "mouthSmileRight"];
        let smile = steps(&[(0.0, 4), (0.6, 10), (0.4, 20), (0.2, 10)]);
        assert_eq!(changes(0, &both, smile.clone()), [400, 34 * 50 + 300]);
        assert!(changes(0, &both[..1], smile).is_empty());
    }

    #[test]
    fn a_value_that_trembles_at_a_threshold_changes_nothing() {
        let tremble = (0..200).map(|step| if step % 2 == 0 { 0.55 } else { 0.45 });
        assert!(changes(1, &["jawOpen"], tremble.clone().map(|value| value - 0.2)).is_empty());
        assert_eq!(changes(1, &["jawOpen"], tremble.map(|value| value - 0.1)), [200]);
    }

    #[test]
    fn a_blink_is_no_eyes_shut() {
        let eyes = ["eyeBlinkLeft", "eyeBlinkRight"];
        assert!(changes(2, &eyes, steps(&[(0.0, 4), (1.0, 8), (0.0, 20)])).is_empty());
        assert_eq!(changes(2, &eyes, steps(&[(0.0, 4), (1.0, 30)])), [700]);
    }
}
