//! What a receiver wants changed in the final output: left and right, gains, offsets and limits.
//!
//! Comes after the filters. The limits are applied once more at the very end, so that they hold for what is sent.

use super::COEFFS;

/// Changes of the final output. The default changes nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct Adjustments {
    /// Swaps left and right: the output is the mirror image of the wearer.
    pub mirror: bool,
    /// Changes of each coefficient, in the order of [`super::BLENDSHAPES`]. They go by the names in the output.
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

/// For each blendshape, the place in [`super::BLENDSHAPES`] of the same one on the other side of the face, or its own.
pub const MIRRORED: [usize; COEFFS] = [
    7, 8, 9, 10, 11, 12, 13, 0, 1, 2, 3, 4, 5, 6, 14, 16, 15, 17, 18, 19, 20, 22, 21, 24, 23, 26, 25, 28, 27, 30, 29,
    31, 32, 33, 34, 36, 35, 38, 37, 40, 39, 42, 41, 43, 45, 44, 46, 48, 47, 50, 49, 51,
];

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

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::solve::BLENDSHAPES;

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
        for (index, name) in BLENDSHAPES.iter().enumerate() {
            let other = match (name.strip_suffix("Left"), name.strip_suffix("Right")) {
                (Some(stem), _) => format!("{stem}Right"),
                (_, Some(stem)) => format!("{stem}Left"),
                _ => (*name).to_owned(),
            };
            let other = BLENDSHAPES.iter().position(|known| *known == other).expect("both sides");
            assert_eq!(coefficients[index], output()[other], "{name}");
        }
        assert_eq!(applied(&mirror, coefficients), output());
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
