//! What a receiver wants changed in the final output: left and right, gains, offsets and limits.
//!
//! Comes after the filters. The limits are applied once more at the very end, so that they hold for what is sent.

use super::{BLENDSHAPES, COEFFS};

/// Changes of the final output. The default changes nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjustments {
    /// Swaps left and right: the output is the mirror image of the wearer.
    pub mirror: bool,
    /// Changes of each coefficient, in the order of [`BLENDSHAPES`]. They go by the names in the output.
    pub coefficients: [Adjustment; COEFFS],
}

/// Changes of one coefficient: `gain * value + offset`, within `min..=max`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Adjustment {
    /// Factor.
    pub gain: f32,
    /// What is added after the factor.
    pub offset: f32,
    /// Least value.
    pub min: f32,
    /// Greatest value, not below `min`.
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

/// For each blendshape, the place in [`BLENDSHAPES`] of the same one on the other side of the face, or its own.
pub const MIRRORED: [usize; COEFFS] = mirrored();

impl Adjustments {
    /// Changes the coefficients. Whoever has the pose of the head mirrors it, too.
    pub fn apply(&self, coefficients: &mut [f32; COEFFS]) {
        if self.mirror {
            let before = *coefficients;
            let mirrored = MIRRORED.iter().filter_map(|place| before.get(*place));
            coefficients.iter_mut().zip(mirrored).for_each(|(value, mirrored)| *value = *mirrored);
        }
        for (value, adjustment) in coefficients.iter_mut().zip(&self.coefficients) {
            *value = adjustment.apply(*value);
        }
    }

    /// Keeps the coefficients within their limits.
    pub fn limit(&self, coefficients: &mut [f32; COEFFS]) {
        for (value, adjustment) in coefficients.iter_mut().zip(&self.coefficients) {
            *value = adjustment.limit(*value);
        }
    }
}

impl Adjustment {
    fn apply(&self, value: f32) -> f32 {
        self.limit(self.gain * value + self.offset)
    }

    /// Not `clamp`, which panics if `min` exceeds `max`.
    fn limit(&self, value: f32) -> f32 {
        if value < self.min {
            self.min
        } else if value > self.max {
            self.max
        } else {
            value
        }
    }
}

#[allow(clippy::indexing_slicing, reason = "runs at compile time, where an index out of range is an error")]
const fn mirrored() -> [usize; COEFFS] {
    let mut places = [0; COEFFS];
    let mut place = 0;
    while place < COEFFS {
        let mut other = 0;
        while other < COEFFS && !is_mirror_image(BLENDSHAPES[place], BLENDSHAPES[other]) {
            other += 1;
        }
        places[place] = if other < COEFFS { other } else { place };
        place += 1;
    }
    places
}

/// Whether two names differ only in that one ends in `Left` and the other in `Right`.
const fn is_mirror_image(a: &str, b: &str) -> bool {
    is_left_of_right(a.as_bytes(), b.as_bytes()) || is_left_of_right(b.as_bytes(), a.as_bytes())
}

#[allow(clippy::indexing_slicing, reason = "runs at compile time, where an index out of range is an error")]
const fn is_left_of_right(left: &[u8], right: &[u8]) -> bool {
    if left.len() + 1 != right.len() || left.len() < 4 {
        return false;
    }
    let stem = left.len() - 4;
    let mut index = 0;
    while index < right.len() {
        let wanted = if index < stem { left[index] } else { b"Right"[index - stem] };
        if right[index] != wanted || (index >= stem && index < left.len() && left[index] != b"Left"[index - stem]) {
            return false;
        }
        index += 1;
    }
    true
}

#[cfg(test)]
#[allow(clippy::float_cmp, clippy::indexing_slicing)]
mod tests {
    use super::*;

    /// Coefficients that all differ.
    fn output() -> [f32; COEFFS] {
        core::array::from_fn(|index| index as f32 / 100.0)
    }

    fn applied(adjustments: &Adjustments, mut coefficients: [f32; COEFFS]) -> [f32; COEFFS] {
        adjustments.apply(&mut coefficients);
        coefficients
    }

    #[test]
    fn mirror_swaps_left_and_right_and_twice_it_changes_nothing() {
        let mirror = Adjustments { mirror: true, ..Adjustments::default() };
        let coefficients = applied(&mirror, output());
        let at = |name| BLENDSHAPES.iter().position(|known| *known == name).unwrap_or(COEFFS);
        for (one, other) in [("jawLeft", "jawRight"), ("eyeLookInLeft", "eyeLookInRight"), ("jawOpen", "jawOpen")] {
            assert_eq!(coefficients[at(one)], output()[at(other)]);
        }
        let middle = MIRRORED.iter().enumerate().filter(|(place, other)| place == *other).count();
        assert_eq!(middle, 12, "jawForward, jawOpen, browInnerUp, cheekPuff, tongueOut and seven of the mouth");
        assert_eq!(applied(&mirror, coefficients), output());
    }

    #[test]
    fn default_changes_nothing() {
        assert_eq!(applied(&Adjustments::default(), output()), output());
    }

    #[test]
    fn output_never_leaves_its_limits_and_follows_the_input_without_a_step() {
        let mut random = fastrand::Rng::with_seed(6);
        for _ in 0..1000 {
            let (min, width) = (random.f32(), random.f32());
            let max = min + (1.0 - min) * width;
            let adjustment = Adjustment { gain: 10.0 * random.f32(), offset: 2.0 * random.f32() - 1.0, min, max };
            let (x, change) = (random.f32(), 0.001);
            let [a, b] = [x, x + change].map(|x| adjustment.apply(x));
            assert!((min..=max).contains(&a) && a <= b && b - a <= 10.1 * change, "{adjustment:?} at {x}");
        }
        assert!(Adjustment::default().apply(f32::NAN).is_nan(), "a fault is not hidden");
    }
}
