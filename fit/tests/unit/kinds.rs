mod trees;

use std::collections::BTreeMap;

use facewire_face::model::{LIFT, signed_logarithm};
use facewire_fit::kinds::*;
use nalgebra::DMatrix;
use nalgebra::DVector;

fn named(name: &str) -> Kind {
    ALL.into_iter().find(|kind| kind.name == name).unwrap()
}

fn fit(name: &str, faces: &DMatrix<f64>, truth: &[f64]) -> Fitted {
    (named(name).fit)(faces, truth).unwrap()
}

fn faces(count: usize, features: usize, truth: impl Fn(&[f64]) -> f64) -> (DMatrix<f64>, Vec<f64>) {
    let mut random = fastrand::Rng::with_seed(7);
    let rows: Vec<Vec<f64>> = (0..count).map(|_| (0..features).map(|_| 2.0 * random.f64() - 1.0).collect()).collect();
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
fn kinds_without_an_exact_reference_find_functions_of_their_form_on_new_faces() {
    let exponential = |face: &[f64]| (-0.6 + 0.3 * face[0] - 0.2 * face[1]).exp() - LIFT;
    assert!(unexplained("exp", 300, exponential) < 1e-11);
    let logarithm =
        |face: &[f64]| (-0.6 + 0.5 * signed_logarithm(face[0]) - 0.3 * signed_logarithm(face[2])).exp() - LIFT;
    assert!(unexplained("log-exp", 300, logarithm) < 1e-11 && unexplained("exp", 300, logarithm) > 1e-5);
    let product = |face: &[f64]| 0.5 + 0.4 * face[0] * face[1] + 0.3 * face[2];
    assert!(unexplained("svr-rbf", 300, product) < 0.03 && unexplained("svr-poly", 300, product) < 0.03);
    let wave = |face: &[f64]| face[0] * face[1] + (3.0 * face[2]).sin();
    for (name, count, most) in [("gb", 1500, 0.09), ("ada", 1500, 0.2), ("hist-gb", 4000, 0.03)] {
        assert!(unexplained(name, count, wave) < most, "{name}");
    }
}

#[test]
fn degrees_of_freedom_are_those_of_the_fit() {
    let (one, truth) = faces(50, 1, |face| 0.5 * face[0]);
    let twice = DMatrix::from_fn(50, 2, |row, _| one[(row, 0)]);
    let estimate = fit("ols", &twice, &truth).predict(&[0.5, 0.5]);
    assert!((estimate - 0.25).abs() < 1e-6, "repeated features share a weight");
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

fn reference_value(row: usize, column: usize) -> f64 {
    let index = (row * 20 + column + 1) as f64;
    2.0 * ((index * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 1.0
}

/// The tolerance is 1e-6, and 0.02 for boosted trees: scikit-learn 1.9.1 chooses at random among splits that explain
/// equally much, and its own predictions differ by as much with another seed.
#[test]
fn kinds_predict_what_scikit_learn_predicts() {
    let expected: BTreeMap<String, Vec<f64>> = serde_json::from_str(include_str!("../kinds_reference.json")).unwrap();
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

#[test]
fn a_formula_takes_as_many_features_as_its_bytes_allow() {
    for (name, bytes, features) in
        [("ols", 100, 16), ("poly", 100, 5), ("poly", 1, 1), ("ols", usize::MAX, 64), ("knn", 1, 24)]
    {
        assert_eq!(named(name).within(bytes).limits.features, features, "{name} in {bytes} bytes");
    }
}
