//! One formula for each blendshape, `R_i = T_i(c_i(w_i x_i + b_i))`, of features `x_i` that are its own (eq. 4 to 6).
//!
//! Results are clamped to `0..=1`, as the fit does. Otherwise, squares and exponentials could become
//! arbitrarily large for faces that the fit has not seen.

use super::{COEFFS, features::Features};
use crate::model::{FEATURES, Formula, FormulaKind, FormulaSet, Formulas, MAX_FORMULA_INPUTS, MAX_PRODUCTS};

/// Number of sums that are added up side by side, so that no addition waits for the one before.
const LANES: usize = 8;

impl Formulas {
    pub(super) fn process(&self, features: &Features) -> [f32; COEFFS] {
        let set = if features.known >= 0.5 { &self.neutral_known } else { &self.neutral_unknown };
        let standardised = set.standardised(features);
        let mut coefficients = [0.0; COEFFS];
        for (coefficient, formula) in coefficients.iter_mut().zip(&set.formulas) {
            *coefficient = formula.coefficient(&standardised);
        }
        coefficients
    }
}

impl FormulaSet {
    /// The values of the inputs with mean 0 and deviation 1.
    fn standardised(&self, features: &Features) -> [f32; FEATURES] {
        let mut values = [0.0; FEATURES];
        for (value, input) in values.iter_mut().zip(&self.inputs) {
            *value = (features.get(input.feature) - input.mean) * input.per_deviation;
        }
        values
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

    /// `w x + b`.
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
            (open, factors) = (rest, later);
        }
        dot(&self.products, &products)
    }
}

/// The sum of the weighted values. Values without a weight are ignored.
fn dot(weights: &[f32], values: &[f32]) -> f32 {
    let values = values.get(..weights.len()).unwrap_or(values);
    let ((weights, last_weights), (values, last_values)) = (weights.as_chunks::<LANES>(), values.as_chunks::<LANES>());
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
        FeatureId, LIFT, MAX_MULTIPLIED, Model, Regression, Response, ScaledInput, product_index, signed_logarithm,
    };
    use crate::solve::{Neutral, Reference, SolveError, normalise};
    use crate::testing::face;

    const JAW_OPEN: usize = 17;

    /// A model in which all blendshapes but the jaw are 0. Its inputs are the coordinates of some landmarks, halved after
    /// 0.1 was subtracted.
    fn model(jaw: Formula) -> Model {
        let input = |index| ScaledInput {
            feature: FeatureId::from_index(index).expect("known"),
            mean: 0.1,
            per_deviation: 0.5,
        };
        let mut formulas: Box<[Formula]> = vec![Formula::default(); COEFFS].into();
        formulas[JAW_OPEN] = jaw;
        let set = FormulaSet { inputs: (0..MAX_FORMULA_INPUTS).map(input).collect(), formulas };
        Model::of(Regression::Formulas(Formulas { neutral_known: set.clone(), neutral_unknown: set }))
    }

    fn features() -> Features {
        Features::new(&normalise(&face([9.0, 5.0, 0.0], 80.0, [320.0, 240.0])).expect("a face"), Reference::MEAN)
    }

    /// The jaw's coefficient, and the values of the inputs in double precision.
    fn solved(jaw: Formula) -> (f64, Vec<f64>) {
        let features = features();
        let raw = model(jaw).process(&features).expect("finite");
        assert!(raw.0.iter().enumerate().all(|(index, value)| index == JAW_OPEN || *value == 0.0));
        let values = features.values()[..MAX_FORMULA_INPUTS].iter().map(|value| (f64::from(*value) - 0.1) * 0.5);
        (raw.0[JAW_OPEN].into(), values.collect())
    }

    fn formula(kind: FormulaKind, response: Response, offset: f32) -> Formula {
        let (inputs, weights) = ([5, 3, 4].into(), [0.4, -0.3, 0.2].into());
        Formula { kind, response, offset, inputs, weights, ..Formula::default() }
    }

    fn sum(values: &[f64], of: impl Fn(f64) -> f64) -> f64 {
        0.4 * of(values[5]) - 0.3 * of(values[3]) + 0.2 * of(values[4])
    }

    #[test]
    fn every_kind_and_response_computes_its_equation() {
        let (found, values) = solved(formula(FormulaKind::Affine, Response::Plain, 0.3));
        assert!((found - (0.3 + sum(&values, |value| value))).abs() < 1e-6);
        let (found, values) = solved(formula(FormulaKind::Affine, Response::SquareRoot, 0.7));
        assert!((found - (0.7 + sum(&values, |value| value)).powi(2)).abs() < 1e-6);
        let (found, values) = solved(formula(FormulaKind::Affine, Response::Logit, 0.3));
        let logistic = 1.0 / (1.0 + (-0.3 - sum(&values, |value| value)).exp());
        assert!((found - (logistic - 0.02) / 0.96).abs() < 1e-6, "{found} {logistic}");
        let (found, values) = solved(formula(FormulaKind::Exponential, Response::Plain, -0.5));
        assert!((found - ((-0.5 + sum(&values, |value| value)).exp() - LIFT)).abs() < 1e-6);
        let (found, values) = solved(formula(FormulaKind::LogExponential, Response::Plain, -0.5));
        assert!((found - ((-0.5 + sum(&values, signed_logarithm)).exp() - LIFT)).abs() < 1e-6);
    }

    #[test]
    fn products_of_as_many_features_as_allowed_have_their_own_weights() {
        for multiplied in [1, 2, 13, MAX_MULTIPLIED] {
            let weight = |index: usize| (index as f32 * 0.618).fract() - 0.5;
            let products: Box<[f32]> = (0..multiplied * (multiplied + 1) / 2).map(weight).collect();
            let inputs: Box<[u16]> = (0..).take(MAX_FORMULA_INPUTS).collect();
            let weights = inputs.iter().map(|index| 0.002 * f32::from(*index)).collect();
            let jaw = Formula {
                kind: FormulaKind::Quadratic,
                offset: 0.5,
                inputs,
                weights,
                multiplied,
                products: products.iter().map(|weight| 0.1 * weight).collect(),
                ..Formula::default()
            };
            let (found, values) = solved(jaw);
            let mut wanted: f64 =
                0.5 + (0..).zip(&values).map(|(index, value)| 0.002 * f64::from(index) * value).sum::<f64>();
            for (one, value) in values.iter().enumerate().take(multiplied) {
                for (other, factor) in values.iter().enumerate().take(multiplied).skip(one) {
                    wanted += 0.1 * f64::from(products[product_index(other, one, multiplied)]) * value * factor;
                }
            }
            assert!((0.01..0.99).contains(&wanted) && (found - wanted).abs() < 1e-5, "{multiplied}: {found} {wanted}");
        }
    }

    #[test]
    fn results_are_clamped_and_nans_reject_the_frame() {
        for kind in [FormulaKind::Affine, FormulaKind::Exponential] {
            for (offset, clamped) in [(-9.0, 0.0), (9.0, 1.0)] {
                assert!((solved(formula(kind, Response::Plain, offset)).0 - clamped).abs() < 1e-9, "{offset}");
            }
            for response in [Response::Plain, Response::SquareRoot, Response::Logit] {
                let nan = model(formula(kind, response, f32::NAN));
                assert_eq!(nan.process(&features()), Err(SolveError::Absurd), "{kind:?} {response:?}");
            }
        }
    }

    #[test]
    fn the_case_of_the_face_selects_the_formulas_and_a_face_that_is_known_in_part_mixes_their_results() {
        let of = |offset| formula(FormulaKind::Affine, Response::Plain, offset);
        let (known, mut both) = (model(of(0.3)), model(of(0.5)));
        let (Regression::Formulas(known), Regression::Formulas(all)) = (known.regression, &mut both.regression) else {
            panic!("formulas")
        };
        all.neutral_known = known.neutral_known;
        let jaw = |known| both.process(&Features { known, ..features() }).expect("finite").0[JAW_OPEN];
        assert!((jaw(0.0) - jaw(1.0) - 0.2).abs() < 1e-6);
        let face = normalise(&face([9.0, 5.0, 0.0], 80.0, [320.0, 240.0])).expect("a face");
        let neutral = Neutral::from_points(&face.points).expect("a neutral face");
        let jaw = |known| both.solve(&face, Reference::between(&neutral, known)).expect("finite").0[JAW_OPEN];
        assert!((jaw(0.0) - jaw(1.0)).abs() > 0.05);
        assert!((jaw(0.25) - (0.75 * jaw(0.0) + 0.25 * jaw(1.0))).abs() < 1e-6);
    }

    #[test]
    fn the_largest_formulas_take_256_kib() {
        let largest = Formula {
            inputs: [0; MAX_FORMULA_INPUTS].into(),
            weights: [0.0; MAX_FORMULA_INPUTS].into(),
            products: [0.0; MAX_PRODUCTS].into(),
            ..Formula::default()
        };
        let input = |index| ScaledInput {
            feature: FeatureId::from_index(index).expect("known"),
            mean: 0.0,
            per_deviation: 0.0,
        };
        let formulas = vec![largest; COEFFS].into();
        let set = FormulaSet { inputs: (0..FEATURES).map(input).collect(), formulas };
        let bytes =
            Model::of(Regression::Formulas(Formulas { neutral_known: set.clone(), neutral_unknown: set })).size_bytes();
        assert!(bytes <= 256 * 1024, "{bytes}");
    }
}
