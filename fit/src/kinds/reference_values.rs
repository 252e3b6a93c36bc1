//! Compares the kinds with scikit-learn 1.9.1 (`fit/tests/kinds_reference.py`).
//!
//! The tolerance is 1e-6, and 0.02 for boosted trees: scikit-learn chooses at random among splits that explain equally
//! much, and its own predictions differ by as much with another seed.

use std::collections::BTreeMap;

use nalgebra::DMatrix;

use super::{Kind, all};

const SEEN: usize = 80;
const NEW: usize = 5;
const FEATURES: usize = 20;

/// The features of the script's faces.
fn value(row: usize, column: usize) -> f64 {
    let index = (row * FEATURES + column + 1) as f64;
    2.0 * ((index * 12.9898).sin() * 43758.5453).rem_euclid(1.0) - 1.0
}

fn truth(row: usize) -> f64 {
    let x = |column| value(row, column);
    0.4 + 0.2 * x(0) - 0.1 * x(1) + 0.1 * x(2) * x(3) + 0.05 * x(4).powi(2)
}

#[test]
fn kinds_predict_what_scikit_learn_predicts() {
    let expected: BTreeMap<String, Vec<f64>> =
        serde_json::from_str(include_str!("../../tests/kinds_reference.json")).unwrap();
    let faces = DMatrix::from_fn(SEEN, FEATURES, value);
    let truth: Vec<f64> = (0..SEEN).map(truth).collect();
    let new: Vec<Vec<f64>> =
        (SEEN..SEEN + NEW).map(|row| (0..FEATURES).map(|column| value(row, column)).collect()).collect();
    let kinds = all();
    for (name, expected) in &expected {
        let kind: &dyn Kind = &**kinds.iter().find(|kind| kind.name() == name).unwrap();
        let model = kind.fit(&faces, &truth).unwrap();
        for (face, expected) in new.iter().zip(expected) {
            let found = model.predict(face);
            let tolerance = if name == "gb" { 0.02 } else { 1e-6 };
            assert!((found - expected).abs() < tolerance, "{name}: {found} for {expected}");
        }
    }
}
