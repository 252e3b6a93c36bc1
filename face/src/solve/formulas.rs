//! One formula for each blendshape, `R_i = T_i(c_i(w_i x_i + b_i))`, of features `x_i` that are its own (eq. 4 to 6).
//!
//! Results are clamped to `0..=1`, as the fit does. Otherwise, squares and exponentials could become
//! arbitrarily large for faces that the fit has not seen.

use super::{COEFFS, features::Features};
use crate::model::{Cases, FEATURES, Formula, FormulaKind, FormulaSet, MAX_FORMULA_INPUTS, MAX_PRODUCTS};

/// Number of sums that are added up side by side, so that no addition waits for the one before.
const LANES: usize = 8;

impl Cases<FormulaSet> {
    pub(super) fn process(&self, features: &Features) -> [f32; COEFFS] {
        let set = if features.known.lower >= 0.5 { &self.neutral_known } else { &self.neutral_unknown };
        // The values of the inputs with mean 0 and deviation 1.
        let mut standardised = [0.0; FEATURES];
        for (value, input) in standardised.iter_mut().zip(&set.inputs) {
            *value = (features.get(input.feature) - input.mean) * input.per_deviation;
        }
        let mut coefficients = [0.0; COEFFS];
        for (coefficient, formula) in coefficients.iter_mut().zip(&set.formulas) {
            *coefficient = formula.coefficient(&standardised);
        }
        coefficients
    }
}

impl Formula {
    fn coefficient(&self, standardised: &[f32; FEATURES]) -> f32 {
        let sum = self.sum(standardised);
        if sum.is_nan() {
            // Below, `f64::min` and `f64::max` would turn it into a number.
            return sum;
        }
        let coefficient = self.response.restore(self.kind.curve(f64::from(sum)));
        #[expect(clippy::cast_possible_truncation, reason = "from 0 to 1")]
        let narrow = coefficient.clamp(0.0, 1.0) as f32;
        narrow
    }

    fn sum(&self, standardised: &[f32; FEATURES]) -> f32 {
        let mut values = [0.0; MAX_FORMULA_INPUTS];
        for (value, input) in values.iter_mut().zip(&self.inputs) {
            *value = standardised.get(usize::from(*input)).copied().unwrap_or(f32::NAN);
        }
        if self.kind == FormulaKind::LogExponential {
            values.iter_mut().take(self.inputs.len()).for_each(|value| *value = value.signum() * value.abs().ln_1p());
        }
        let linear = self.offset + dot(&self.weights, &values);
        if self.multiplied == 0 { linear } else { linear + self.product_sum(&values) }
    }

    fn product_sum(&self, values: &[f32; MAX_FORMULA_INPUTS]) -> f32 {
        let mut products = [0.0; MAX_PRODUCTS];
        let mut open = products.as_mut_slice();
        let mut factors = values.get(..self.multiplied).unwrap_or_default();
        while let [factor, later @ ..] = factors {
            let Some((row, rest)) = open.split_at_mut_checked(factors.len()) else { break };
            row.iter_mut().zip(factors).for_each(|(product, other)| *product = factor * other);
            open = rest;
            factors = later;
        }
        dot(&self.products, &products)
    }
}

/// The sum of the weighted values. Values without a weight are ignored.
fn dot(weights: &[f32], values: &[f32]) -> f32 {
    let values = values.get(..weights.len()).unwrap_or(values);
    let (weights, last_weights) = weights.as_chunks::<LANES>();
    let (values, last_values) = values.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (weights, values) in weights.iter().zip(values) {
        for (sum, (weight, value)) in sums.iter_mut().zip(weights.iter().zip(values)) {
            *sum += weight * value;
        }
    }
    let last: f32 = last_weights.iter().zip(last_values).map(|(weight, value)| weight * value).sum();
    sums.iter().sum::<f32>() + last
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{
        Correction, FeatureId, LIFT, MAX_MULTIPLIED, Model, Regression, Response, ScaledInput, product_index,
        signed_logarithm,
    };
    use crate::solve::halves::Halves;
    use crate::solve::{Neutral, Normalised, Reference, SolveError, normalise, plausible::JAW_OPEN};
    use crate::testing::face;

    /// Formulas of which only the jaw's is not 0. Their inputs are the first coordinates, halved after 0.1 was subtracted.
    fn formulas(known: Formula, unknown: Formula) -> Model {
        let set = |jaw| {
            let input = |index| ScaledInput {
                feature: FeatureId::from_index(index).expect("known"),
                mean: 0.1,
                per_deviation: 0.5,
            };
            let mut formulas: Box<[Formula]> = vec![Formula::default(); COEFFS].into();
            formulas[JAW_OPEN] = jaw;
            FormulaSet { inputs: (0..MAX_FORMULA_INPUTS).map(input).collect(), formulas }
        };
        let regression = Regression::Formulas(Cases { neutral_known: set(known), neutral_unknown: set(unknown) });
        Model { regression, appearance: None, gaze: None, eyes: None, correction: Correction::default() }
    }

    fn turned() -> Normalised {
        normalise(&face([9.0, 5.0, 0.0], 80.0, [320.0, 240.0])).expect("a face")
    }

    fn solved(jaw: Formula) -> (Result<f64, SolveError>, Vec<f64>) {
        let features = Features::new(&turned(), Reference::MEAN);
        let found = formulas(jaw.clone(), jaw).process(&features).map(|raw| raw.0[JAW_OPEN].into());
        let values = features.values()[..MAX_FORMULA_INPUTS].iter().map(|value| (f64::from(*value) - 0.1) * 0.5);
        (found, values.collect())
    }

    fn formula(kind: FormulaKind, response: Response, offset: f32) -> Formula {
        let inputs = [5, 3, 4].into();
        let weights = [0.4, -0.3, 0.2].into();
        Formula { kind, response, offset, inputs, weights, ..Formula::default() }
    }

    #[test]
    fn every_kind_and_response_computes_its_equation_and_results_are_clamped() {
        type Curve = fn(f64) -> f64;
        let same: Curve = |x| x;
        let exponential: Curve = |sum| sum.exp() - LIFT;
        let cases: [(_, _, _, Curve, Curve); 5] = [
            (FormulaKind::Affine, Response::Plain, 0.3, same, same),
            (FormulaKind::Affine, Response::SquareRoot, 0.7, same, |sum| sum * sum),
            (FormulaKind::Affine, Response::Logit, 0.3, same, |sum| (1.0 / (1.0 + (-sum).exp()) - 0.02) / 0.96),
            (FormulaKind::Exponential, Response::Plain, -0.5, same, exponential),
            (FormulaKind::LogExponential, Response::Plain, -0.5, signed_logarithm, exponential),
        ];
        for (kind, response, offset, of_value, of_sum) in cases {
            let (found, values) = solved(formula(kind, response, offset));
            let sum = 0.4 * of_value(values[5]) - 0.3 * of_value(values[3]) + 0.2 * of_value(values[4]);
            let wanted = of_sum(f64::from(offset) + sum);
            assert!(found.is_ok_and(|found| (found - wanted).abs() < 1e-6), "{kind:?} {response:?}: {wanted}");
            for (offset, clamped) in [(-9.0, Ok(0.0)), (9.0, Ok(1.0)), (f32::NAN, Err(SolveError::Absurd))] {
                assert_eq!(solved(formula(kind, response, offset)).0, clamped, "{kind:?} {response:?} {offset}");
            }
        }
    }

    #[test]
    fn products_of_as_many_features_as_allowed_have_their_own_weights() {
        for multiplied in [1, 2, 13, MAX_MULTIPLIED] {
            let weight = |index: usize| 0.1 * ((index as f32 * 0.618).fract() - 0.5);
            let products: Box<[f32]> = (0..multiplied * (multiplied + 1) / 2).map(weight).collect();
            let inputs: Box<[u16]> = (0..).take(MAX_FORMULA_INPUTS).collect();
            let weights = inputs.iter().map(|index| 0.002 * f32::from(*index)).collect();
            let kind = FormulaKind::Quadratic;
            let plain = Formula { kind, offset: 0.5, inputs, weights, ..Formula::default() };
            let (found, values) = solved(Formula { multiplied, products: products.clone(), ..plain });
            let mut wanted: f64 =
                0.5 + (0..).zip(&values).map(|(index, value)| 0.002 * f64::from(index) * value).sum::<f64>();
            for one in 0..multiplied {
                for other in one..multiplied {
                    let weight = products[product_index(other, one, multiplied)];
                    wanted += f64::from(weight) * values[one] * values[other];
                }
            }
            let found = found.expect("finite");
            assert!((0.01..0.99).contains(&wanted) && (found - wanted).abs() < 1e-5, "{multiplied}: {found} {wanted}");
        }
    }

    #[test]
    fn the_case_of_the_face_selects_the_formulas_and_a_face_that_is_known_in_part_mixes_their_results() {
        let of = |offset| formula(FormulaKind::Affine, Response::Plain, offset);
        let model = formulas(of(0.3), of(0.5));
        let face = turned();
        let features = Features::new(&face, Reference::MEAN);
        let jaw = |known| {
            model.process(&Features { known: Halves::both(known), ..features.clone() }).expect("finite").0[JAW_OPEN]
        };
        assert!((jaw(0.0) - jaw(1.0) - 0.2).abs() < 1e-6);
        let neutral = Neutral::from_points(&face.points).expect("a neutral face");
        let jaw = |known| {
            let reference = Reference::between(&neutral, known);
            model.solve(&features, reference).expect("finite").0[JAW_OPEN]
        };
        assert!((jaw(0.0) - jaw(1.0)).abs() > 0.05);
        assert!((jaw(0.25) - (0.75 * jaw(0.0) + 0.25 * jaw(1.0))).abs() < 1e-6);
    }
}
