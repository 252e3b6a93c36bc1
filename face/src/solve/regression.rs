//! `R`: the fitted regression from features to coefficients, and what the look of a face adds to it.
//!
//! A model holds either one formula for each blendshape as in the paper ([`super::formulas`]), or a hidden layer, which
//! tells apart expressions that move the same points. facewire ships one of each. A linear layer reads the mesh network's
//! feature map and adds what no landmark shows, such as a puffed cheek. `tongueOut` is always 0.

use facewire_engine::kernels::rows::{add_byte_rows, add_rows};

use super::features::{Features, Reference};
use super::halves::{Halves, half_of};
use super::{COEFFS, Coefficients, SolveError, filter::towards};
use crate::model::{APPEARANCE_UNITS, AppearanceLayer, Cases, HiddenLayer, Model, Output, Regression};
use crate::track::Appearance;

const EMBEDDED: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/blendshapes.bin"));
const EMBEDDED_FORMULAS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/formulas.bin"));
/// Largest result of a face. On rendered and real faces, results stay between -0.5 and 1.5.
const MAX_RESULT: f32 = 5.0;

/// Which of the built-in models solves the coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Method {
    /// A network with a hidden layer, which also reads how the skin looks.
    Network,
    /// One formula of a few distances and landmarks for each coefficient, as in the paper. It is simpler, and less accurate.
    Paper,
}

impl Method {
    /// Every method with its name in the settings.
    pub const NAMES: &[(&str, Self)] = &[("network", Self::Network), ("paper", Self::Paper)];
}

impl Model {
    /// The model that is built into the program.
    #[expect(clippy::expect_used, clippy::missing_panics_doc, reason = "the build script wrote these bytes")]
    pub fn embedded() -> Self {
        Self::from_bytes(EMBEDDED).expect("the embedded model is whole")
    }

    /// The formulas of the paper that are built into the program. The gaze is read as by [`Model::embedded`].
    #[expect(clippy::expect_used, clippy::missing_panics_doc, reason = "the build script wrote these bytes")]
    pub fn embedded_formulas() -> Self {
        Self::from_bytes(EMBEDDED_FORMULAS).expect("the embedded formulas are whole").with_gaze()
    }

    /// The built-in model of this method.
    pub fn of(method: Method) -> Self {
        match method {
            Method::Network => Self::embedded(),
            Method::Paper => Self::embedded_formulas(),
        }
    }

    /// Formulas that have no way of their own to read the gaze, as a file of them may, read it as [`Model::embedded`] does. Any
    /// other model stays as it is.
    #[must_use]
    pub fn with_gaze(self) -> Self {
        let Self { regression: Regression::Formulas(_), gaze: None, eyes: None, .. } = &self else { return self };
        let Self { gaze, eyes, .. } = Self::embedded();
        Self { gaze, eyes, ..self }
    }

    /// Returns the reference that this model can use. A formula may mix features of both halves of the face, so with formulas
    /// the upper half counts only as far as the lower half is known.
    pub(crate) fn reference_for<'a>(&self, reference: Reference<'a>) -> Reference<'a> {
        match self.regression {
            Regression::HiddenLayer(_) => reference,
            Regression::Formulas(_) => reference.of_lower_half(),
        }
    }

    /// Computes the coefficients of a face by its features from the mean of many people, measured from `reference`. Does not
    /// allocate.
    pub(crate) fn solve(&self, from_mean: &Features, reference: Reference) -> Result<Coefficients, SolveError> {
        match (&self.regression, reference.neutral) {
            (Regression::HiddenLayer(layer), _) => sane(layer.process(from_mean, reference)),
            // Both halves are known alike: `reference_for` sees to it.
            (Regression::Formulas(_), Some(neutral)) if reference.known.lower < 1.0 => {
                let unknown = self.process(from_mean)?;
                let known = self.process(&from_mean.clone().measured_from(Reference::between(neutral, 1.0)))?;
                Ok(Coefficients(towards(unknown.0, known.0, reference.known.lower)))
            }
            (Regression::Formulas(_), _) => self.process(&from_mean.clone().measured_from(reference)),
        }
    }

    /// Computes the coefficients of a face from its features alone. For a neutral face that is known in part, formulas take
    /// the nearer case. A result that no coefficient has is [`SolveError::Absurd`]. Does not allocate.
    pub fn process(&self, features: &Features) -> Result<Coefficients, SolveError> {
        sane(match &self.regression {
            Regression::HiddenLayer(layer) => layer.process(features, features.remaining()),
            Regression::Formulas(formulas) => formulas.process(features),
        })
    }

    /// Computes what the look of a face adds to the regression, or `None` if it is not known or the model does not read it.
    /// `known` is the share of the wearer's neutral face in the reference. Does not allocate.
    pub fn residual(&self, appearance: Option<&Appearance>, known: f32) -> Result<Option<Coefficients>, SolveError> {
        self.residual_by_halves(appearance, Halves::both(known))
    }

    /// The same for a neutral face whose halves are known unlike.
    pub(crate) fn residual_by_halves(
        &self,
        appearance: Option<&Appearance>,
        known: Halves<f32>,
    ) -> Result<Option<Coefficients>, SolveError> {
        let both = self.appearance.as_ref().zip(appearance);
        both.map(|(layer, appearance)| sane(layer.process(appearance, known))).transpose()
    }
}

/// Returns the results if all can be those of a face. No range contains a NaN.
fn sane(results: [f32; COEFFS]) -> Result<Coefficients, SolveError> {
    let are_sane = results.iter().all(|value| (-MAX_RESULT..=MAX_RESULT).contains(value));
    if are_sane { Ok(Coefficients(results)) } else { Err(SolveError::Absurd) }
}

/// Number of inputs whose values are gathered before their weighted columns are added.
const BATCH: usize = 64;

impl HiddenLayer {
    fn process(&self, features: &Features, reference: Reference) -> [f32; COEFFS] {
        let mut hidden = towards(self.offsets_unknown, self.offsets_known, reference.known.mean());
        for (inputs, weights) in self.inputs.chunks(BATCH).zip(self.weights.as_chunks().0.chunks(BATCH)) {
            let mut values = [0.0; BATCH];
            for (value, input) in values.iter_mut().zip(inputs) {
                *value = features.displacement(input.feature, input.neutral, reference);
            }
            add_rows(&mut hidden, weights, &values);
        }
        // `f32::max` would turn a NaN into 0.
        self.output.process(&hidden.map(|sum| if sum < 0.0 { 0.0 } else { sum }))
    }
}

impl AppearanceLayer {
    fn process(&self, appearance: &Appearance, shares: Halves<f32>) -> [f32; COEFFS] {
        let mut hidden = [0.0; APPEARANCE_UNITS];
        add_byte_rows(&mut hidden, self.weights.as_chunks().0, appearance.skin.as_flattened());
        for ((unit, scale), offset) in hidden.iter_mut().zip(&self.scales).zip(&self.offsets) {
            *unit = *unit * scale + offset;
        }
        let Cases { neutral_known: known, neutral_unknown: unknown } = &self.outputs;
        if shares.upper == 0.0 {
            return unknown.process(&hidden);
        }
        let known = known.process(&hidden);
        if shares == Halves::both(1.0) {
            return known;
        }
        let mut out = unknown.process(&hidden);
        for (place, (value, known)) in out.iter_mut().zip(known).enumerate() {
            *value += shares.of(half_of(place)) * (known - *value);
        }
        out
    }
}

impl Output {
    fn process(&self, units: &[f32]) -> [f32; COEFFS] {
        let mut out = self.offsets;
        add_rows(&mut out, self.weights.as_chunks().0, units);
        out
    }
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation)]
mod tests {
    use super::*;
    use crate::model::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, FeatureId, InputTable, ModelFile};
    use crate::solve::{Camera, Filters, Neutral, Profile, Shaping, Solver, normalise, plausible::JAW_OPEN};
    use crate::testing::face;
    use crate::track::Face;

    const SHIPPED: &str = include_str!("../../models/blendshapes.toml");
    const SHIPPED_FORMULAS: &str = include_str!("../../models/formulas.toml");
    const CHEEK_PUFF: usize = 46;

    #[test]
    fn embedded_numbers_are_those_of_the_readable_files_bit_for_bit() {
        for (text, bytes, most) in [(SHIPPED, EMBEDDED, 1 << 20), (SHIPPED_FORMULAS, EMBEDDED_FORMULAS, 1 << 14)] {
            assert_eq!(ModelFile::parse(text).and_then(|file| file.to_model()).expect("sound").to_bytes(), bytes);
            assert!(bytes.len() <= most, "{}", bytes.len());
        }
        assert_eq!(Model::from_bytes(&EMBEDDED[..EMBEDDED.len() - 4]), None, "cut short");
        assert_eq!(Model::from_bytes(&[EMBEDDED, &[0; 4]].concat()), None, "too long");
    }

    #[test]
    fn embedded_formulas_read_the_gaze_as_the_network_does_and_nothing_else_of_the_picture() {
        let [network, formulas] = [Model::embedded(), Model::embedded_formulas()];
        assert!(matches!(formulas.regression, Regression::Formulas(_)) && formulas.gaze.is_some());
        assert_eq!((formulas.gaze, formulas.eyes, formulas.appearance), (network.gaze, network.eyes, None));
    }

    #[test]
    fn a_file_of_formulas_without_tables_of_the_gaze_reads_it_as_the_embedded_ones_do() {
        let of = |text| ModelFile::parse(text).and_then(|file| file.to_model()).expect("sound");
        assert!(of(SHIPPED_FORMULAS).with_gaze() == Model::embedded_formulas());
        let mut own = of(SHIPPED_FORMULAS);
        own.gaze = Model::embedded().gaze;
        let mut network = Model::embedded();
        (network.gaze, network.eyes) = (None, None);
        for model in [own, network] {
            assert!(model.clone().with_gaze() == model, "it has a way of its own, or is no set of formulas");
        }
    }

    /// Features near those of a face at rest, of which this share of the neutral face is known.
    fn features(known: f32) -> Features {
        let mut values = core::array::from_fn(|index| 0.02 * (index as f32).sin());
        for (name, table) in ModelFile::parse(SHIPPED).expect("sound").inputs {
            values[FeatureId::from_name(&name).expect("known").index()] += (1.0 - known) * table.neutral as f32;
        }
        Features { values, known: Halves::both(known) }
    }

    #[test]
    fn result_is_the_weighted_sum_of_the_positive_hidden_units() {
        let file = ModelFile::parse(SHIPPED).expect("sound");
        let offsets = file.offsets.expect("a hidden layer");
        for known in [0.0, 0.25, 1.0] {
            let features = features(known as f32);
            let value = |name: &str| f64::from(features.get(FeatureId::from_name(name).expect("known")));
            let unit = |(unit, (known_offset, unknown_offset)): (usize, (&f64, &f64))| {
                let input = |(name, table): (&String, &InputTable)| {
                    (value(name) - (1.0 - known) * table.neutral) * table.weights[unit]
                };
                let sum: f64 = file.inputs.iter().map(input).sum();
                (sum + known * known_offset + (1.0 - known) * unknown_offset).max(0.0)
            };
            let pairs = offsets.neutral_known.iter().zip(&offsets.neutral_unknown);
            let hidden: Vec<f64> = pairs.enumerate().map(unit).collect();
            let raw = Model::embedded().process(&features).map(|raw| raw.0[JAW_OPEN]);
            let table = &file.blendshapes["jawOpen"];
            let want =
                table.offset + table.weights.iter().zip(&hidden).map(|(weight, unit)| weight * unit).sum::<f64>();
            assert!(raw.is_ok_and(|raw| (f64::from(raw) - want).abs() < 1e-3), "{known}: {raw:?} in place of {want}");
        }
    }

    #[test]
    fn absurd_results_and_nans_reject_the_frame() {
        let solved = |change: &dyn Fn(&mut HiddenLayer)| {
            let mut model = Model::embedded();
            let Regression::HiddenLayer(layer) = &mut model.regression else { panic!("the shipped model is a layer") };
            change(layer);
            model.process(&features(0.0)).map(drop)
        };
        assert_eq!(solved(&|_| ()), Ok(()));
        for wrong in [f32::NAN, f32::INFINITY, -1e6] {
            assert_eq!(solved(&|layer| layer.output.offsets[JAW_OPEN] = wrong), Err(SolveError::Absurd), "{wrong}");
            assert_eq!(solved(&|layer| layer.offsets_unknown[0] = wrong.abs()), Err(SolveError::Absurd), "{wrong}");
        }
    }

    /// A layer with one unit, `0.01 * 50 x - 1`, where `x` is the second value of the first landmark. `cheekPuff` is
    /// `0.1 + 0.4 h` where the neutral face is known, and `0.3 h` where it is not.
    fn appearance_layer() -> AppearanceLayer {
        let output = |weight, offset| {
            let mut output = Output { weights: vec![0.0; APPEARANCE_UNITS * COEFFS].into(), offsets: [0.0; COEFFS] };
            output.weights[3 * COEFFS + CHEEK_PUFF] = weight;
            output.offsets[CHEEK_PUFF] = offset;
            output
        };
        let mut weights = vec![0; APPEARANCE_UNITS * APPEARANCE_LANDMARKS.len() * APPEARANCE_CHANNELS];
        let mut scales = [1.0; APPEARANCE_UNITS];
        let mut offsets = [0.0; APPEARANCE_UNITS];
        weights[APPEARANCE_UNITS + 3] = 50;
        scales[3] = 0.01;
        offsets[3] = -1.0;
        let outputs = Cases { neutral_known: output(0.4, 0.1), neutral_unknown: output(0.3, 0.0) };
        AppearanceLayer { weights: weights.into(), scales, offsets, outputs }
    }

    fn appearance(value: f32) -> Appearance {
        let mut appearance = Appearance::zero();
        appearance.skin[0][1] = value;
        appearance
    }

    #[test]
    fn residual_is_the_weighted_sum_of_the_units_and_values_that_are_not_finite_reject_the_frame() {
        let model = Model { appearance: Some(appearance_layer()), ..Model::embedded() };
        let residual = |value, known| model.residual(Some(&appearance(value)), known);
        for x in [6.0, 1.0] {
            let unit = 0.5 * x - 1.0;
            for (known, want) in [(1.0, 0.1 + 0.4 * unit), (0.0, 0.3 * unit), (0.25, 0.025 + 0.325 * unit)] {
                let found = residual(x, known).expect("finite").expect("a layer").0[CHEEK_PUFF];
                assert!((found - want).abs() < 1e-5, "{x}, {known}: {found} in place of {want}");
            }
        }
        for wrong in [f32::NAN, f32::INFINITY, 1e9] {
            assert_eq!(residual(wrong, 1.0), Err(SolveError::Absurd), "{wrong}");
        }
    }

    #[test]
    fn solver_adds_the_residual_which_landmarks_alone_do_not_have() {
        let landmarks = face([0.0; 3], 80.0, [320.0, 240.0]);
        let camera = Camera::new([640.0, 480.0], 60.0);
        // The face has few points, so only displacements from itself are sensible.
        let neutral = Neutral::from_points(&normalise(&landmarks).expect("a face").points).ok();
        let model = Model { appearance: Some(appearance_layer()), ..Model::embedded() };
        let mut solver = Solver::new(model, Profile { neutral, ..Profile::default() }, Shaping::only(Filters::OFF));
        let [alone, both] = [None, Some(&appearance(6.0))].map(|appearance| {
            let face = Face { landmarks: &landmarks, appearance };
            solver.solve(face, &camera, 0).expect("a face").raw.0[CHEEK_PUFF]
        });
        assert!((both - alone - 0.9).abs() < 1e-5, "{alone} {both}");
    }
}
