//! The last stages: what a receiver wants changed, and what hides that a part of the solver was replaced.

use nalgebra::UnitQuaternion;

use super::filter::{LONGEST_STEP_S, add, difference, passed};
use super::{COEFFS, Coefficients, HeadPose};

/// Changes of the final output, after the filters. The default changes nothing.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Adjustments {
    /// Swaps left and right: the output is the mirror image of the wearer.
    pub mirror: bool,
    /// Changes of each coefficient, in the order of [`super::BLENDSHAPES`]. They go by the names in the output.
    pub coefficients: [Adjustment; COEFFS],
}

/// Changes of one coefficient: `gain * value + offset`, within `min..=max`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs, reason = "the formula tells the fields")]
pub struct Adjustment {
    pub gain: f32,
    pub offset: f32,
    pub min: f32,
    pub max: f32,
}

impl Default for Adjustment {
    fn default() -> Self {
        Self { gain: 1.0, offset: 0.0, min: 0.0, max: 1.0 }
    }
}

impl Default for Adjustments {
    fn default() -> Self {
        Self { mirror: false, coefficients: [Adjustment::default(); COEFFS] }
    }
}

/// For each blendshape, the place in [`super::BLENDSHAPES`] of the same one on the other side of the face, or its own.
pub const MIRRORED: [usize; COEFFS] = [
    7, 8, 9, 10, 11, 12, 13, 0, 1, 2, 3, 4, 5, 6, 14, 16, 15, 17, 18, 19, 20, 22, 21, 24, 23, 26, 25, 28, 27, 30, 29,
    31, 32, 33, 34, 36, 35, 38, 37, 40, 39, 42, 41, 43, 45, 44, 46, 48, 47, 50, 49, 51,
];

impl Adjustments {
    /// Changes the coefficients. The caller has to mirror the pose of the head.
    pub fn apply(&self, coefficients: &mut [f32; COEFFS]) {
        if self.mirror {
            let before = *coefficients;
            let mirrored = MIRRORED.iter().filter_map(|place| before.get(*place));
            coefficients.iter_mut().zip(mirrored).for_each(|(value, mirrored)| *value = *mirrored);
        }
        for (value, adjustment) in coefficients.iter_mut().zip(&self.coefficients) {
            *value = adjustment.gain * *value + adjustment.offset;
        }
        self.limit(coefficients);
    }

    /// Keeps the coefficients within their limits. Not with `clamp`, which panics if `min` exceeds `max`.
    pub fn limit(&self, coefficients: &mut [f32; COEFFS]) {
        for (value, Adjustment { min, max, .. }) in coefficients.iter_mut().zip(&self.coefficients) {
            if *value < *min {
                *value = *min;
            } else if *value > *max {
                *value = *max;
            }
        }
    }
}

/// Time after which 63 % of the difference has gone, seconds.
const TIME_CONSTANT_S: f32 = 0.1;
/// Share of the difference that nobody sees any more.
const INVISIBLE: f32 = 1e-4;

/// Leads the output over a change of the solver's parts without a step: the difference to the new values fades.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Crossfade {
    last: Option<(Coefficients, HeadPose)>,
    /// Whether the next output begins where the last one ended.
    pub(super) is_due: bool,
    difference: Option<Difference>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Difference {
    coefficients: [f32; COEFFS],
    rotation: UnitQuaternion<f32>,
    position_mm: [f32; 3],
    left: f32,
}

impl Crossfade {
    /// Leads the output of a frame that was captured `dt_s` seconds after the last one. After a long gap there is nothing
    /// to lead from.
    pub(super) fn step(&mut self, coefficients: &mut Coefficients, head: &mut HeadPose, dt_s: f32) {
        let is_gap = !(0.0..=LONGEST_STEP_S).contains(&dt_s);
        if core::mem::take(&mut self.is_due) {
            self.difference = self.last.map(|(last, last_head)| Difference {
                coefficients: difference(last.0, coefficients.0),
                rotation: last_head.rotation() * head.rotation().inverse(),
                position_mm: difference(last_head.position_mm, head.position_mm),
                left: 1.0,
            });
        } else if let Some(difference) = &mut self.difference {
            difference.left *= 1.0 - passed(dt_s, TIME_CONSTANT_S);
        }
        self.difference = self.difference.filter(|difference| !is_gap && difference.left > INVISIBLE);
        if let Some(difference) = &self.difference {
            for (value, difference_of) in coefficients.0.iter_mut().zip(difference.coefficients) {
                *value = (*value + difference.left * difference_of).clamp(0.0, 1.0);
            }
            let rotation = difference.rotation.powf(difference.left) * head.rotation();
            add(&mut head.position_mm, difference.left, difference.position_mm);
            *head = HeadPose::from_rotation(rotation.coords.into(), head.position_mm);
        }
        self.last = Some((*coefficients, *head));
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::solve::BLENDSHAPES;

    #[test]
    fn mirror_swaps_left_and_right() {
        let mirror = Adjustments { mirror: true, ..Adjustments::default() };
        let before: [f32; COEFFS] = core::array::from_fn(|index| index as f32 / 100.0);
        let mut after = before;
        mirror.apply(&mut after);
        for (index, name) in BLENDSHAPES.iter().enumerate() {
            let other = name.replace("Left", "?").replace("Right", "Left").replace('?', "Right");
            let other = BLENDSHAPES.iter().position(|known| *known == other).expect("both sides");
            assert_eq!(after[index], before[other], "{name}");
        }
    }

    #[test]
    fn output_never_leaves_its_limits_and_follows_the_input_without_a_step() {
        let mut random = fastrand::Rng::with_seed(6);
        let apply = |adjustment: Adjustment, x| {
            let mut values = [x; COEFFS];
            Adjustments { mirror: false, coefficients: [adjustment; COEFFS] }.apply(&mut values);
            values[0]
        };
        for _ in 0..1000 {
            let min = random.f32();
            let width = random.f32();
            let max = min + (1.0 - min) * width;
            let adjustment = Adjustment { gain: 10.0 * random.f32(), offset: 2.0 * random.f32() - 1.0, min, max };
            let x = random.f32();
            let change = 0.001;
            let [a, b] = [x, x + change].map(|x| apply(adjustment, x));
            assert!((min..=max).contains(&a) && a <= b && b - a <= 10.1 * change, "{adjustment:?} at {x}");
        }
        assert!(apply(Adjustment::default(), f32::NAN).is_nan(), "a fault is not hidden");
    }
}
