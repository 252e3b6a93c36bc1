//! Leads the output over a change of the solver's parts without a step.
//!
//! When a part is replaced, such as a filter or what is known of the wearer, the next output would jump, for example in
//! the middle of a blink. Instead, the output stays where it was in the frame of the change, and the difference to
//! the new values fades away afterwards.

use nalgebra::UnitQuaternion;

use super::{
    COEFFS, HeadPose, Smoothed,
    filter::{LONGEST_STEP_S, add, difference, passed},
};

/// Time after which 63 % of the difference has gone, seconds.
const TIME_CONSTANT_S: f32 = 0.1;
/// Share of the difference that nobody sees any more.
const INVISIBLE: f32 = 1e-4;

/// The last output, and the difference that a change has made.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Crossfade {
    last: Option<(Smoothed, HeadPose)>,
    is_due: bool,
    difference: Option<Difference>,
}

/// An old output minus a new one, and the share of it that is left.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Difference {
    coefficients: [f32; COEFFS],
    rotation: UnitQuaternion<f32>,
    position_mm: [f32; 3],
    left: f32,
}

impl Crossfade {
    /// The next output begins where the last one ended.
    pub(super) fn begin(&mut self) {
        self.is_due = true;
    }

    /// Leads the output of a frame that was captured `dt_s` seconds after the last one. After a long gap there is nothing
    /// to lead from.
    pub(super) fn step(&mut self, smoothed: &mut Smoothed, head: &mut HeadPose, dt_s: f32) {
        let is_gap = !(0.0..=LONGEST_STEP_S).contains(&dt_s);
        if core::mem::take(&mut self.is_due) {
            self.difference = self.last.map(|(last, last_head)| Difference::between(&last, &last_head, smoothed, head));
        } else if let Some(difference) = &mut self.difference {
            difference.left *= 1.0 - passed(dt_s, TIME_CONSTANT_S);
        }
        self.difference = self.difference.filter(|difference| !is_gap && difference.left > INVISIBLE);
        if let Some(difference) = &self.difference {
            difference.add_to(smoothed, head);
        }
        self.last = Some((*smoothed, *head));
    }
}

impl Difference {
    fn between(old: &Smoothed, old_head: &HeadPose, new: &Smoothed, new_head: &HeadPose) -> Self {
        Self {
            coefficients: difference(old.0, new.0),
            rotation: old_head.rotation() * new_head.rotation().inverse(),
            position_mm: difference(old_head.position_mm, new_head.position_mm),
            left: 1.0,
        }
    }

    fn add_to(&self, smoothed: &mut Smoothed, head: &mut HeadPose) {
        for (value, difference) in smoothed.0.iter_mut().zip(self.coefficients) {
            *value = (*value + self.left * difference).clamp(0.0, 1.0);
        }
        let rotation = self.rotation.powf(self.left) * head.rotation();
        let mut position_mm = head.position_mm;
        add(&mut position_mm, self.left, self.position_mm);
        *head = HeadPose::from_rotation(rotation.coords.into(), position_mm);
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;

    const FRAME_S: f32 = 1.0 / 30.0;

    fn output(value: f32, roll_deg: f32) -> (Smoothed, HeadPose) {
        let half = (0.5 * roll_deg).to_radians();
        let rotation = [0.0, 0.0, half.sin(), half.cos()];
        (Smoothed([value; COEFFS]), HeadPose::from_rotation(rotation, [value, 0.0, 600.0]))
    }

    fn step(crossfade: &mut Crossfade, value: f32, roll_deg: f32, dt_s: f32) -> (f32, f32) {
        let (mut smoothed, mut head) = output(value, roll_deg);
        crossfade.step(&mut smoothed, &mut head, dt_s);
        (smoothed.0.into_iter().fold(0.0, f32::max), head.yaw_pitch_roll_deg()[2])
    }

    #[test]
    fn change_makes_no_step_and_its_difference_fades_within_a_second() {
        let mut crossfade = Crossfade::default();
        step(&mut crossfade, 0.9, 170.0, FRAME_S);
        crossfade.begin();
        let mut last = (0.9, 170.0);
        for frame in 0..30_u8 {
            let next = step(&mut crossfade, 0.2, 150.0, FRAME_S);
            let allowed = if frame == 0 { 1e-3 } else { 0.3 * (last.0 - 0.2) + 1e-3 };
            assert!((last.0 - next.0).abs() <= allowed, "frame {frame}: {last:?} to {next:?}");
            assert!((last.1 - next.1).abs() <= 7.0);
            last = next;
        }
        assert!((last.0 - 0.2).abs() < 1e-3 && (last.1 - 150.0).abs() < 0.1, "{last:?}");
        // A second change before the first has faded makes no step either.
        crossfade.begin();
        step(&mut crossfade, 0.9, 0.0, FRAME_S);
        let before = step(&mut crossfade, 0.9, 0.0, FRAME_S);
        crossfade.begin();
        let after = step(&mut crossfade, 0.1, 0.0, FRAME_S);
        assert!((before.0 - after.0).abs() < 1e-3);
    }

    #[test]
    fn without_a_change_or_after_a_gap_values_pass() {
        let mut crossfade = Crossfade::default();
        for (value, dt_s) in [(0.1, 0.0), (0.7, FRAME_S), (0.3, 1.0)] {
            assert_eq!(step(&mut crossfade, value, 0.0, dt_s).0, value);
        }
        crossfade.begin();
        assert_eq!(step(&mut crossfade, 1.0, 0.0, 2.0).0, 1.0);
        assert_eq!(step(&mut crossfade, 0.5, 0.0, FRAME_S).0, 0.5);
    }
}
