//! `R`: the fitted regression from features to coefficients.
//!
//! A model holds one of two kinds of regression, which serve faces with and without a known neutral face: the hidden layer
//! that facewire ships, or one formula for each blendshape as in the paper ([`super::formulas`]).
//!
//! All blendshapes share the hidden layer, `h = max(0, W x + a)` and `R = V h + b`, where `x` are the selected features.
//! Unlike an affine map, it tells apart expressions that move the same points. Where the wearer's neutral face is not
//! known, displacements are measured from the mean of many neutral faces, and `a` differs. In between, the reference and
//! `a` are mixed.
//!
//! Limits: `tongueOut` is always 0, because no landmark lies on the tongue.

use facewire_engine::kernels::rows::add_rows;

use super::{
    COEFFS, SolveError,
    affine::Normalised,
    appearance::Residual,
    features::{Features, Reference, mix},
};
use crate::model::{HiddenLayer, Model, Output, Regression};

/// The shipped model, as the build script wrote it.
const EMBEDDED: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/blendshapes.bin"));
/// Largest result of a face. On rendered and real faces, results stay between -0.5 and 1.5.
const MAX_RESULT: f32 = 5.0;

/// Results of the regression, in the order of [`super::BLENDSHAPES`]: finite, not yet clamped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawCoeffs(pub [f32; COEFFS]);

impl RawCoeffs {
    /// Adds what the look of the face contributes.
    pub fn plus(mut self, residual: &Residual) -> Self {
        self.0.iter_mut().zip(&residual.0).for_each(|(value, residual)| *value += residual);
        self
    }
}

/// Whether all results can be those of a face. No range contains a NaN.
pub(super) fn are_sane(results: &[f32; COEFFS]) -> bool {
    results.iter().all(|value| (-MAX_RESULT..=MAX_RESULT).contains(value))
}

impl Model {
    /// The model that is built into the program.
    ///
    /// # Panics
    /// Never: the build script has read these bytes back.
    #[expect(clippy::expect_used, reason = "see Panics")]
    pub fn embedded() -> Self {
        Self::from_bytes(EMBEDDED).expect("the embedded model is whole")
    }

    /// Computes the coefficients of a face, measured from `reference`. Does not allocate.
    pub(crate) fn solve(&self, face: &Normalised, reference: Reference) -> Result<RawCoeffs, SolveError> {
        match (&self.regression, reference.ends()) {
            (Regression::Formulas(_), Some(ends)) => {
                let [unknown, known] = ends.map(|end| self.process(&Features::new(face, end)));
                Ok(RawCoeffs(mix(&unknown?.0, &known?.0, reference.known())))
            }
            _ => self.process(&Features::new(face, reference)),
        }
    }

    /// Computes the coefficients of a face from its features alone. Does not allocate.
    ///
    /// Formulas are for features of a neutral face that is either known or not: for a share in between, they take the
    /// nearer case.
    ///
    /// # Errors
    /// [`SolveError::Absurd`] if a result is not a number or far outside a coefficient's range.
    pub fn process(&self, features: &Features) -> Result<RawCoeffs, SolveError> {
        let raw = match &self.regression {
            Regression::HiddenLayer(layer) => layer.process(features),
            Regression::Formulas(formulas) => formulas.process(features),
        };
        if are_sane(&raw) { Ok(RawCoeffs(raw)) } else { Err(SolveError::Absurd) }
    }
}

/// Number of inputs whose values are gathered before their weighted columns are added.
const BATCH: usize = 64;

impl HiddenLayer {
    fn process(&self, features: &Features) -> [f32; COEFFS] {
        let mut hidden = mix(&self.offsets_unknown, &self.offsets_known, features.known);
        let mean_share = 1.0 - features.known;
        for (inputs, weights) in self.inputs.chunks(BATCH).zip(self.weights.chunks(BATCH)) {
            let mut values = [0.0; BATCH];
            for (value, input) in values.iter_mut().zip(inputs) {
                *value = features.get(input.feature) - mean_share * input.neutral;
            }
            add_rows(&mut hidden, weights, &values);
        }
        // `f32::max` would turn a NaN into 0.
        self.output.process(&hidden.map(|sum| if sum < 0.0 { 0.0 } else { sum }))
    }
}

impl Output {
    /// `V h + b`.
    pub(super) fn process(&self, units: &[f32]) -> [f32; COEFFS] {
        let mut out = self.offsets;
        add_rows(&mut out, &self.weights, units);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{FeatureId, Input, MAX_HIDDEN, MAX_INPUTS, ModelFile};
    use crate::solve::{Neutral, normalise};
    use crate::testing::face;

    #[test]
    fn embedded_numbers_are_those_of_the_readable_file_bit_for_bit() {
        let file =
            ModelFile::parse(include_str!("../../../models/blendshapes.toml")).expect("the shipped model is sound");
        let read = file.to_model().expect("the shipped model is sound");
        assert_eq!(read.to_bytes(), EMBEDDED);
        assert_eq!(Model::embedded(), read);
    }

    #[test]
    fn embedded_model_moves_smoothly_from_the_mean_of_many_people_to_the_neutral_face() {
        let model = Model::embedded();
        let face = normalise(&face([3.0, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face");
        let neutral = Neutral::from_points(&face.points).expect("a neutral face");
        let ends = [None, Some(&neutral)].map(|neutral| model.process(&Features::new(&face, neutral)).ok());
        // This face has few points, so that its values measured from the mean are absurd: only shares near 1 count.
        let at = |known| model.solve(&face, Reference::between(&neutral, known)).ok();
        assert_eq!([at(0.0), at(1.0)], ends);
        let near: Vec<RawCoeffs> = (980_u16..=1000).filter_map(|share| at(f32::from(share) / 1000.0)).collect();
        assert_eq!(near.len(), 21);
        let steps = near.windows(2).flat_map(|pair| pair[0].0.iter().zip(&pair[1].0).map(|(a, b)| (a - b).abs()));
        assert!(steps.clone().any(|step| step > 1e-4) && steps.fold(0.0, f32::max) < 0.05);
    }

    #[test]
    fn bytes_that_are_not_a_model_are_refused() {
        assert_eq!(Model::from_bytes(&EMBEDDED[..EMBEDDED.len() - 4]), None, "cut short");
        assert_eq!(Model::from_bytes(&[EMBEDDED, &[0; 4]].concat()), None, "too long");
        assert_eq!(Model::from_bytes(&[]), None);
    }

    const JAW_OPEN: usize = 17;
    const TONGUE_OUT: usize = 51;

    /// A layer with two hidden units, `x - 0.5` and `0.5 - x`, where `x` is that of the outer corner of the left eye.
    /// `JAW_OPEN` weights them by 2 and 3.
    fn layer() -> HiddenLayer {
        let row = |a: f32, b: f32| {
            let mut row = [0.0; MAX_HIDDEN];
            (row[0], row[MAX_HIDDEN - 1]) = (a, b);
            row
        };
        let mut output = Output { weights: vec![[0.0; COEFFS]; MAX_HIDDEN].into(), offsets: [0.0; COEFFS] };
        output.offsets[JAW_OPEN] = 0.1;
        (output.weights[0][JAW_OPEN], output.weights[MAX_HIDDEN - 1][JAW_OPEN]) = (2.0, 3.0);
        HiddenLayer {
            inputs: [Input { feature: FeatureId::from_name("x263").expect("known"), neutral: 0.2 }].into(),
            weights: [row(1.0, -1.0)].into(),
            offsets_known: [0.0; MAX_HIDDEN],
            offsets_unknown: row(-0.5, 0.5),
            output,
        }
    }

    fn features() -> Features {
        Features::new(&normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).expect("a face"), Reference::MEAN)
    }

    #[test]
    fn result_is_the_weighted_sum_of_the_positive_hidden_units() {
        let raw = layer().process(&features());
        let x = 0.7218 - 0.2;
        assert!((raw[JAW_OPEN] - (0.1 + 2.0 * (x - 0.5))).abs() < 1e-3, "{}", raw[JAW_OPEN]);
        assert!(raw.iter().enumerate().all(|(index, value)| index == JAW_OPEN || *value == 0.0));
    }

    #[test]
    fn absurd_results_and_nans_reject_the_frame() {
        let outcome = |layer| Model::of(Regression::HiddenLayer(layer)).process(&features());
        for wrong in [f32::NAN, f32::INFINITY, -7.0] {
            let mut layer = layer();
            layer.output.offsets[JAW_OPEN] = wrong;
            assert_eq!(outcome(layer), Err(SolveError::Absurd));
        }
        let mut layer = layer();
        layer.offsets_unknown[0] = f32::NAN;
        assert_eq!(outcome(layer), Err(SolveError::Absurd));
    }

    #[test]
    fn shipped_layers_never_put_the_tongue_out() {
        let model = Model::embedded();
        let Regression::HiddenLayer(layer) = model.regression else { panic!("not a hidden layer") };
        for output in model.appearance.iter().flat_map(|layer| &layer.outputs).chain([&layer.output]) {
            let tongue = output.weights.iter().map(|weights| weights[TONGUE_OUT]);
            assert!(tongue.chain([output.offsets[TONGUE_OUT]]).all(|number| number == 0.0));
        }
    }

    #[test]
    fn the_largest_layer_takes_256_kib_and_the_shipped_model_at_most_1_mib() {
        let input = Input { feature: FeatureId::from_index(0).expect("known"), neutral: 0.0 };
        let largest = HiddenLayer {
            inputs: vec![input; MAX_INPUTS].into(),
            weights: vec![[0.0; MAX_HIDDEN]; MAX_INPUTS].into(),
            ..layer()
        };
        let bytes = Model::of(Regression::HiddenLayer(largest)).size_bytes();
        assert!(bytes <= 256 * 1024, "{bytes}");
        assert!(Model::embedded().size_bytes() <= 1 << 20, "{}", Model::embedded().size_bytes());
    }
}
