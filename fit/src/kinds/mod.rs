//! The kinds of model that the paper compares.
//!
//! A [`Kind`] is fitted to one blendshape. Faces are rows of standardised features: displacements from the wearer's
//! neutral face, with mean 0 and standard deviation 1. The truth is a coefficient from 0 to 1, or its transformation by
//! a [`Response`]. Predictions are not clamped here. Random numbers have fixed seeds, so that the same faces give the
//! same model.

mod formula;
mod memory;
mod trees;

use anyhow::{Context, Result};
use facewire_face::model::{MAX_FORMULA_INPUTS, Response};
use nalgebra::DMatrix;
use serde::Serialize;

pub use formula::Formula;
use memory::Kernel;

type Fitted = Box<dyn Predictor>;

pub struct Kind {
    pub name: &'static str,
    pub form: Form,
    pub limits: Limits,
    /// Fits the model to faces, one per row, and their truth.
    pub fit: fn(&DMatrix<f64>, &[f64]) -> Result<Fitted>,
}

pub trait Predictor: Send + Sync {
    fn predict(&self, face: &[f64]) -> f64;

    /// Returns the number of fitted weights without the constant: the degrees of freedom of the F statistic.
    fn weights(&self) -> usize;

    /// Returns the number of values that a board has to store. Each takes 4 bytes.
    fn numbers(&self) -> usize;

    /// Returns the formula of the board that computes the same, or `None` if there is none.
    fn formula(&self) -> Option<Formula> {
        None
    }
}

/// The function that a model computes. Simpler forms compare as less.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// `w f + b`, however it was fitted.
    Affine,
    /// `exp(w f + b) - c`.
    Exponential,
    /// `exp(w f + b) - c` of the features' logarithms.
    LogExponential,
    Quadratic,
    /// The hidden layer shared by all blendshapes.
    HiddenLayer,
    /// A model that stores faces or trees, and is too large or too slow for a board.
    Large,
}

impl Form {
    /// Returns whether model files can hold the model as a formula.
    pub fn is_formula(self) -> bool {
        !matches!(self, Self::HiddenLayer | Self::Large)
    }

    /// Returns the transformations of the truth to try. Forms that are nonlinear themselves need none.
    pub fn responses(self) -> &'static [Response] {
        match self {
            Self::Affine | Self::Quadratic => &[Response::Plain, Response::SquareRoot, Response::Logit],
            _ => &[Response::Plain],
        }
    }
}

/// Limits on the number of features, the best first, and of faces that a kind is fitted to.
#[derive(Clone, Copy)]
pub struct Limits {
    pub features: usize,
    pub faces: usize,
}

/// Limits of kinds whose cost is linear in the number of faces.
const WIDE: Limits = Limits { features: MAX_FORMULA_INPUTS, faces: usize::MAX };
/// Limits of kinds that pass over the features many times.
const MIDDLE: Limits = Limits { features: 24, faces: usize::MAX };
/// Limits of kinds that compare all faces with each other, or sort them.
const NARROW: Limits = Limits { features: 24, faces: 2000 };
/// Limits of kinds that solve a system of equations with one unknown per face.
const NARROWEST: Limits = Limits { features: 24, faces: 1000 };

/// All kinds that are fitted to one blendshape at a time, the simplest first.
pub const ALL: [Kind; 15] = [
    Kind { name: "ols", form: Form::Affine, limits: WIDE, fit: formula::ordinary },
    Kind { name: "ridge", form: Form::Affine, limits: WIDE, fit: formula::ridge },
    Kind { name: "pca", form: Form::Affine, limits: WIDE, fit: formula::principal_components },
    Kind { name: "pls", form: Form::Affine, limits: WIDE, fit: formula::partial_least_squares },
    Kind { name: "exp", form: Form::Exponential, limits: WIDE, fit: formula::exponential },
    Kind { name: "log-exp", form: Form::LogExponential, limits: WIDE, fit: formula::log_exponential },
    Kind { name: "poly", form: Form::Quadratic, limits: WIDE, fit: formula::quadratic },
    Kind {
        name: "gp-rbf",
        form: Form::Large,
        limits: NARROWEST,
        fit: |f, t| memory::gaussian_process(Kernel::Rbf, f, t),
    },
    Kind {
        name: "gp-matern",
        form: Form::Large,
        limits: NARROWEST,
        fit: |f, t| memory::gaussian_process(Kernel::Matern, f, t),
    },
    Kind { name: "svr-rbf", form: Form::Large, limits: NARROW, fit: support_vectors },
    Kind {
        name: "svr-poly",
        form: Form::Large,
        limits: NARROW,
        fit: |f, t| memory::support_vectors(Kernel::Polynomial, f, t),
    },
    Kind { name: "hist-gb", form: Form::Large, limits: MIDDLE, fit: trees::histogram_boosting },
    Kind { name: "gb", form: Form::Large, limits: NARROW, fit: trees::gradient_boosting },
    Kind { name: "ada", form: Form::Large, limits: NARROW, fit: trees::ada_boost },
    Kind { name: "knn", form: Form::Large, limits: NARROW, fit: memory::neighbours },
];

/// Support vector regression with a Gaussian kernel.
pub fn support_vectors(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    memory::support_vectors(Kernel::Rbf, faces, truth)
}

/// Returns what tables append to the name of a kind.
pub fn suffix(response: Response) -> &'static str {
    match response {
        Response::Plain => "",
        Response::SquareRoot => " of sqrt",
        Response::Logit => " of logit",
    }
}

/// Fits a kind to the transformed truth (eq. 6 of the paper). Predictions are transformed back.
pub fn with_response(kind: &Kind, response: Response, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    if response == Response::Plain {
        return (kind.fit)(faces, truth);
    }
    let transformed: Vec<f64> = truth.iter().map(|truth| response.transform(*truth)).collect();
    let fitted = (kind.fit)(faces, &transformed)?.formula();
    let formula = fitted.with_context(|| format!("{} is no formula, so its truth cannot be transformed", kind.name))?;
    Ok(Box::new(Formula { response, ..formula }))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use facewire_face::model::{LIFT, signed_logarithm};
    use nalgebra::DVector;

    use super::*;

    fn kind(name: &str) -> &'static Kind {
        const KINDS: &[Kind] = &ALL;
        KINDS.iter().find(|kind| kind.name == name).unwrap()
    }

    fn fit(name: &str, faces: &DMatrix<f64>, truth: &[f64]) -> Fitted {
        (kind(name).fit)(faces, truth).unwrap()
    }

    /// Returns `count` faces with features between -1 and 1, and their truth.
    fn faces(count: usize, features: usize, truth: impl Fn(&[f64]) -> f64) -> (DMatrix<f64>, Vec<f64>) {
        let mut random = fastrand::Rng::with_seed(7);
        let rows: Vec<Vec<f64>> =
            (0..count).map(|_| (0..features).map(|_| 2.0 * random.f64() - 1.0).collect()).collect();
        let truth = rows.iter().map(|row| truth(row)).collect();
        (DMatrix::from_fn(count, features, |row, column| rows[row][column]), truth)
    }

    fn row(faces: &DMatrix<f64>, index: usize) -> Vec<f64> {
        faces.row(index).iter().copied().collect()
    }

    /// Returns the share of the variance of `truth` on new faces of three features that a kind leaves unexplained.
    fn unexplained(name: &str, count: usize, truth: impl Fn(&[f64]) -> f64) -> f64 {
        let (all, truth) = faces(count + 200, 3, truth);
        let model = fit(name, &all.rows(0, count).into_owned(), &truth[..count]);
        let error = |index: usize| (model.predict(&row(&all, index)) - truth[index]).powi(2);
        let variance = DVector::from_column_slice(&truth[count..]).variance();
        (count..count + 200).map(error).sum::<f64>() / 200.0 / variance
    }

    #[test]
    fn every_kind_finds_functions_of_its_form_on_new_faces() {
        let affine = |face: &[f64]| 0.3 + 0.2 * face[0] - 0.1 * face[2];
        for name in ["ols", "pca", "pls"] {
            assert!(unexplained(name, 300, affine) < 1e-13, "{name}");
        }
        let exponential = |face: &[f64]| (-0.6 + 0.3 * face[0] - 0.2 * face[1]).exp() - LIFT;
        assert!(unexplained("exp", 300, exponential) < 1e-11);
        let logarithm =
            |face: &[f64]| (-0.6 + 0.5 * signed_logarithm(face[0]) - 0.3 * signed_logarithm(face[2])).exp() - LIFT;
        assert!(unexplained("log-exp", 300, logarithm) < 1e-11 && unexplained("exp", 300, logarithm) > 1e-5);
        let quadratic = |face: &[f64]| 0.2 + 0.1 * face[0] + 0.3 * face[0] * face[2] - 0.2 * face[1].powi(2);
        assert!(unexplained("poly", 300, quadratic) < 1e-3);
        let smooth = |face: &[f64]| (2.0 * face[0]).sin() * face[1];
        assert!(unexplained("gp-rbf", 200, smooth) < 0.01 && unexplained("gp-matern", 200, smooth) < 0.02);
        let product = |face: &[f64]| 0.5 + 0.4 * face[0] * face[1] + 0.3 * face[2];
        assert!(unexplained("svr-rbf", 300, product) < 0.03 && unexplained("svr-poly", 300, product) < 0.03);
        assert!(unexplained("knn", 2000, |face| face[0] * face[1] + face[2]) < 0.03);
        let wave = |face: &[f64]| face[0] * face[1] + (3.0 * face[2]).sin();
        for (name, count, most) in [("gb", 1500, 0.09), ("ada", 1500, 0.2), ("hist-gb", 4000, 0.03)] {
            assert!(unexplained(name, count, wave) < most, "{name}");
        }
    }

    #[test]
    fn trees_find_a_step() {
        let (faces, truth) = faces(640, 2, |face| if face[1] > 0.3 { 1.0 } else { 0.0 });
        for (name, error) in [("gb", 0.01), ("ada", 1e-9), ("hist-gb", 0.05)] {
            let model = fit(name, &faces, &truth);
            assert!(model.predict(&[0.0, 0.2]).abs() < error, "{name}");
            assert!((model.predict(&[0.0, 0.4]) - 1.0).abs() < error, "{name}");
        }
    }

    #[test]
    fn ridge_shrinks_the_weight_of_a_single_feature_by_a_thousandth_and_repeated_features_share_one() {
        let (one, truth) = faces(200, 1, |face| face[0]);
        let [line, ridge] = ["ols", "ridge"].map(|name| fit(name, &one, &truth));
        let slope = |model: &Fitted| model.predict(&[1.0]) - model.predict(&[0.0]);
        assert!((slope(&line) / slope(&ridge) - 1.0 - 0.001).abs() < 1e-6);
        let twice = DMatrix::from_fn(200, 2, |row, _| one[(row, 0)]);
        assert!((fit("ols", &twice, &truth).predict(&[0.5, 0.5]) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn degrees_of_freedom_are_those_of_the_fit() {
        let (one, truth) = faces(50, 1, |face| 0.5 * face[0]);
        assert_eq!(fit("pls", &one, &truth).weights(), 1);
        let (mut two, _) = faces(200, 2, |_| 0.0);
        let truth: Vec<f64> = two.column(1).iter().copied().collect();
        two.column_mut(1).scale_mut(0.01);
        assert_eq!(fit("pca", &two, &truth).weights(), 1, "a direction that hardly varies is left out");
        let (many, truth) = faces(500, 30, |face| face[0] * face[1] + 0.5 * face[29]);
        let model = fit("poly", &many, &truth);
        assert!((model.predict(&row(&many, 3)) - truth[3]).abs() < 0.02);
        assert_eq!(model.weights(), 30 + 24 * 25 / 2, "only the first 24 features are multiplied");
        let (narrow, truth) = faces(40, 2, |face| 0.5 + 0.04 * face[0]);
        assert_eq!(fit("svr-rbf", &narrow, &truth).weights(), 0, "a truth within the zone needs no support vectors");
    }

    #[test]
    fn the_square_of_an_affine_map_is_found_by_the_square_root() {
        let (faces, truth) = faces(100, 2, |face| (0.5 + 0.2 * face[0] - 0.1 * face[1]).powi(2));
        let model = with_response(kind("ols"), Response::SquareRoot, &faces, &truth).unwrap();
        assert!((model.predict(&[0.5, -0.5]) - 0.65_f64.powi(2)).abs() < 1e-7);
    }

    #[test]
    fn models_of_stored_faces_return_to_the_mean_far_away_and_to_the_truth_at_a_face() {
        let line = DMatrix::from_column_slice(3, 1, &[0.0, 1.0, 2.0]);
        assert!((fit("gp-rbf", &line, &[0.1, 0.2, 0.6]).predict(&[100.0]) - 0.3).abs() < 1e-12);
        let (faces, truth) = faces(100, 3, |face| face[0] * face[1]);
        assert!((fit("knn", &faces, &truth).predict(&row(&faces, 17)) - truth[17]).abs() < 1e-7);
    }

    /// The features of the faces of `fit/tests/kinds_reference.py`.
    fn reference_value(row: usize, column: usize) -> f64 {
        let index = (row * 20 + column + 1) as f64;
        2.0 * ((index * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 1.0
    }

    /// The tolerance is 1e-6, and 0.02 for boosted trees: scikit-learn 1.9.1 chooses at random among splits that explain
    /// equally much, and its own predictions differ by as much with another seed.
    #[test]
    fn kinds_predict_what_scikit_learn_predicts() {
        let expected: BTreeMap<String, Vec<f64>> =
            serde_json::from_str(include_str!("../../tests/kinds_reference.json")).unwrap();
        let faces = DMatrix::from_fn(80, 20, reference_value);
        let truth = |row: usize| {
            let x = |column| reference_value(row, column);
            0.4 + 0.2 * x(0) - 0.1 * x(1) + 0.1 * x(2) * x(3) + 0.05 * x(4).powi(2)
        };
        let truth: Vec<f64> = (0..80).map(truth).collect();
        for (name, expected) in &expected {
            let model = fit(name, &faces, &truth);
            for (row, expected) in (80..).zip(expected) {
                let face: Vec<f64> = (0..20).map(|column| reference_value(row, column)).collect();
                let tolerance = if name == "gb" { 0.02 } else { 1e-6 };
                let found = model.predict(&face);
                assert!((found - expected).abs() < tolerance, "{name}: {found} for {expected}");
            }
        }
    }
}
