//! What the look of a face adds to the regression: expressions that move no landmark, such as a puffed cheek or a lip that
//! is rolled in.
//!
//! A linear layer, `h = s W x + a`, and a residual `V h + b`, where `x` are the values of the mesh network's feature map
//! at some landmarks. The regression is fitted first, and the layer to what the regression leaves unexplained.
//! Landmarks from a file come without these values; the stage is then left out.
//!
//! The map carries more of the camera's noise than the landmarks do. The filters smooth the sum.

use facewire_engine::kernels::rows::add_byte_rows;

use super::{COEFFS, SolveError, features::mix, regression::are_sane};
use crate::model::{APPEARANCE_UNITS, AppearanceLayer, Model};
use crate::track::Appearance;

/// What is added to the results of the regression, in the order of [`super::BLENDSHAPES`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual(pub [f32; COEFFS]);

impl Model {
    /// Computes the residual of a face. Returns `None` if it is not known how the face looks, or if the model does not read
    /// it. `known` is the share of the wearer's neutral face in the reference. Does not allocate.
    ///
    /// # Errors
    /// [`SolveError::Absurd`] if a residual is not a number or larger than any coefficient.
    pub fn residual(&self, appearance: Option<&Appearance>, known: f32) -> Result<Option<Residual>, SolveError> {
        let (Some(layer), Some(appearance)) = (&self.appearance, appearance) else { return Ok(None) };
        let residual = layer.process(appearance, known);
        if are_sane(&residual.0) { Ok(Some(residual)) } else { Err(SolveError::Absurd) }
    }
}

impl AppearanceLayer {
    /// Computes the residual of a face.
    fn process(&self, appearance: &Appearance, share: f32) -> Residual {
        let mut hidden = [0.0; APPEARANCE_UNITS];
        add_byte_rows(&mut hidden, &self.weights, appearance.0.as_flattened());
        for ((unit, scale), offset) in hidden.iter_mut().zip(&self.scales).zip(&self.offsets) {
            *unit = *unit * scale + offset;
        }
        let [known, unknown] = &self.outputs;
        Residual(match share {
            0.0 => unknown.process(&hidden),
            1.0 => known.process(&hidden),
            share => mix(&unknown.process(&hidden), &known.process(&hidden), share),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, Output};
    use crate::solve::{Camera, FilterKind, Filters, Neutral, Profile, Shaping, Solver, normalise};
    use crate::testing::face;
    use crate::track::{Face, Landmarks};

    const CHEEK_PUFF: usize = 46;

    /// A layer with one unit, `0.01 * 50 x - 1`, where `x` is the second value of the first landmark. `cheekPuff` is
    /// `0.1 + 0.4 h` where the neutral face is known, and `0.3 h` where it is not.
    fn test_layer() -> AppearanceLayer {
        let output = |weight, offset| {
            let (mut weights, mut offsets) = (vec![[0.0; COEFFS]; APPEARANCE_UNITS], [0.0; COEFFS]);
            (weights[3][CHEEK_PUFF], offsets[CHEEK_PUFF]) = (weight, offset);
            Output { weights: weights.into(), offsets }
        };
        let mut weights = vec![[0; APPEARANCE_UNITS]; APPEARANCE_LANDMARKS.len() * APPEARANCE_CHANNELS];
        let (mut scales, mut offsets) = ([1.0; APPEARANCE_UNITS], [0.0; APPEARANCE_UNITS]);
        (weights[1][3], scales[3], offsets[3]) = (50, 0.01, -1.0);
        AppearanceLayer { weights: weights.into(), scales, offsets, outputs: [output(0.4, 0.1), output(0.3, 0.0)] }
    }

    /// The appearance whose second value at the first landmark is `value`, and whose other values are 0.
    fn appearance(value: f32) -> Appearance {
        let mut appearance = Appearance::zero();
        assert_eq!(appearance.0[0].len(), APPEARANCE_CHANNELS);
        appearance.0[0][1] = value;
        appearance
    }

    fn solver() -> Solver {
        let model = Model { appearance: Some(test_layer()), ..Model::embedded() };
        // The face has few points, so only displacements from itself are sensible.
        let seen = normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).expect("a face");
        let neutral = Neutral::from_points(&seen.points).ok();
        let shaping = Shaping::only(Filters::uniform(FilterKind::GatedAverage, 0.18));
        Solver::new(model, Profile { neutral, ..Profile::default() }, shaping)
    }

    #[test]
    fn residual_is_the_weighted_sum_of_the_units() {
        let layer = test_layer();
        let at = |value, known: f32| layer.process(&appearance(value), known).0[CHEEK_PUFF];
        // The unit is 0.01 * 50 x - 1; its weight is 0.4 or 0.3, with an offset of 0.1 or 0.
        for x in [6.0, 1.0] {
            let unit = 0.5 * x - 1.0;
            assert!((at(x, 1.0) - (0.1 + 0.4 * unit)).abs() < 1e-5, "{x}");
            assert!((at(x, 0.0) - 0.3 * unit).abs() < 1e-5, "{x}");
            assert!((at(x, 0.25) - (0.025 + 0.325 * unit)).abs() < 1e-5, "{x}");
        }
    }

    #[test]
    fn solver_adds_the_residual_and_leaves_the_stage_out_for_landmarks_alone() {
        let mut solver = solver();
        let landmarks: Landmarks = face([0.0; 3], 80.0, [320.0, 240.0]);
        let camera = Camera::new([640.0, 480.0], 60.0);
        let alone = solver.solve(&landmarks, &camera, 0).expect("a face").raw.0;
        let seen = appearance(6.0);
        let face = Face { landmarks: &landmarks, appearance: Some(&seen) };
        let raw = solver.solve(face, &camera, 0).expect("a face").raw.0;
        assert!((raw[CHEEK_PUFF] - alone[CHEEK_PUFF] - 0.9).abs() < 1e-5);
        let others = |raw: [f32; COEFFS]| [&raw[..CHEEK_PUFF], &raw[CHEEK_PUFF + 1..]].concat();
        assert_eq!(others(raw), others(alone));
    }

    #[test]
    fn values_that_are_not_finite_reject_the_frame_and_leave_no_trace() {
        let landmarks = face([0.0; 3], 80.0, [320.0, 240.0]);
        let camera = Camera::new([640.0, 480.0], 60.0);
        let solve = |values: &[f32]| {
            let mut solver = solver();
            let step = |(frame, value): (u64, &f32)| {
                let seen = appearance(*value);
                let face = Face { landmarks: &landmarks, appearance: Some(&seen) };
                solver.solve(face, &camera, frame * 33_333).map(|solution| solution.raw)
            };
            (0..).zip(values).map(step).collect::<Vec<_>>()
        };
        for wrong in [f32::NAN, f32::INFINITY, 1e9] {
            let found = solve(&[6.0, wrong, 6.1]);
            assert_eq!(found[1], Err(SolveError::Absurd), "{wrong}");
            assert!(found[2].is_ok_and(|raw| raw.0.iter().all(|value| value.is_finite())));
        }
    }
}
