//! Faces whose truth is a known function of their features.

use nalgebra::DMatrix;

use super::Kind;

/// Returns `count` faces with features between -1 and 1, and their truth.
pub fn faces(count: usize, features: usize, truth: impl Fn(&[f64]) -> f64) -> (DMatrix<f64>, Vec<f64>) {
    let mut random = fastrand::Rng::with_seed(7);
    let rows: Vec<Vec<f64>> = (0..count).map(|_| (0..features).map(|_| 2.0 * random.f64() - 1.0).collect()).collect();
    let truth = rows.iter().map(|row| truth(row)).collect();
    (DMatrix::from_fn(count, features, |row, column| rows[row][column]), truth)
}

/// Returns the largest error of a kind on the faces that it was fitted to, which have three features.
pub fn largest_error(kind: &dyn Kind, truth: impl Fn(&[f64]) -> f64) -> f64 {
    let (faces, truth) = faces(300, 3, truth);
    let errors = errors(kind, &faces, &truth, &faces, &truth);
    errors.into_iter().fold(0.0, |largest, error| error.abs().max(largest))
}

/// Returns the share of the variance of `truth` on new faces that a kind leaves unexplained.
pub fn unexplained(kind: &dyn Kind, count: usize, truth: impl Fn(&[f64]) -> f64) -> f64 {
    let (all, truth) = faces(count + 200, 3, truth);
    let (seen, new) = (all.rows(0, count).into_owned(), all.rows(count, 200).into_owned());
    let errors = errors(kind, &seen, &truth[..count], &new, &truth[count..]);
    let variance = nalgebra::DVector::from_column_slice(&truth[count..]).variance();
    errors.iter().map(|error| error.powi(2)).sum::<f64>() / 200.0 / variance
}

fn errors(kind: &dyn Kind, seen: &DMatrix<f64>, truth: &[f64], new: &DMatrix<f64>, expected: &[f64]) -> Vec<f64> {
    let model = kind.fit(seen, truth).unwrap();
    let rows = new.row_iter().map(|row| row.iter().copied().collect::<Vec<_>>());
    rows.zip(expected).map(|(face, truth)| model.predict(&face) - truth).collect()
}
