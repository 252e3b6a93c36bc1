//! A network with one hidden layer, `h = max(0, W x + a)` and `R = V h + b`, where `x` are the selected features.
//!
//! All blendshapes share the hidden layer. Where the wearer's neutral face is not known, displacements are measured from
//! the mean of many neutral faces, and `a` differs. In between, the reference and `a` are mixed. Unlike an affine map, the hidden layer tells apart expressions
//! that move the same points.

use facewire_engine::kernels::rows::add_rows;

use crate::solve::{
    COEFFS,
    features::{Features, mix},
    model::hidden_layer::{Hidden, HiddenLayer},
};

/// Number of inputs whose values are gathered before their weighted columns are added.
const BATCH: usize = 64;

impl HiddenLayer {
    pub(super) fn process(&self, features: &Features) -> [f32; COEFFS] {
        let mut raw = self.output_offsets;
        add_rows(&mut raw, &self.output_weights, &self.hidden(features));
        raw
    }

    fn hidden(&self, features: &Features) -> Hidden {
        let [known, unknown] = &self.offsets;
        let mut hidden = mix(unknown, known, features.known);
        let mean_share = 1.0 - features.known;
        for (inputs, weights) in self.inputs.chunks(BATCH).zip(self.hidden_weights.chunks(BATCH)) {
            let mut values = [0.0; BATCH];
            for (value, input) in values.iter_mut().zip(inputs) {
                *value = features.get(input.feature) - mean_share * input.neutral;
            }
            add_rows(&mut hidden, weights, &values);
        }
        // `f32::max` would turn a NaN into 0.
        hidden.map(|sum| if sum < 0.0 { 0.0 } else { sum })
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{
        AbsurdResult, FeatureId, MAX_HIDDEN, MAX_INPUTS, Model, Reference,
        model::{
            Regression,
            hidden_layer::{Input, Output},
        },
        normalise,
        test_face::face,
    };

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
        let feature = FeatureId::from_name("x263").expect("known");
        let mut outputs = vec![Output { offset: 0.0, weights: [0.0; MAX_HIDDEN] }; COEFFS];
        outputs[JAW_OPEN] = Output { offset: 0.1, weights: row(2.0, 3.0) };
        let inputs = vec![(Input { feature, neutral: 0.2 }, row(1.0, -1.0))];
        HiddenLayer::new(inputs, &[[0.0; MAX_HIDDEN], row(-0.5, 0.5)], &outputs)
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
        for wrong in [f32::NAN, f32::INFINITY, -7.0] {
            let mut layer = layer();
            layer.output_offsets[JAW_OPEN] = wrong;
            assert_eq!(Model::from(layer).process(&features()), Err(AbsurdResult));
        }
        let mut layer = layer();
        layer.offsets[1][0] = f32::NAN;
        assert_eq!(Model::from(layer).process(&features()), Err(AbsurdResult));
    }

    #[test]
    fn shipped_layer_never_puts_the_tongue_out() {
        let Regression::HiddenLayer(layer) = Model::embedded().regression else { panic!("not a hidden layer") };
        let tongue = layer.output_weights.iter().map(|weights| weights[TONGUE_OUT]);
        assert!(tongue.chain([layer.output_offsets[TONGUE_OUT]]).all(|number| number == 0.0));
    }

    #[test]
    fn the_largest_layer_takes_256_kib() {
        let feature = FeatureId::from_index(0).expect("known");
        let inputs = vec![(Input { feature, neutral: 0.0 }, [0.0; MAX_HIDDEN]); MAX_INPUTS];
        let largest = Model::from(HiddenLayer::new(inputs, &[[0.0; MAX_HIDDEN]; 2], &[])).size_bytes();
        assert!(largest <= 256 * 1024, "{largest}");
    }
}
