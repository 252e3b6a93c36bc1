//! Regression on the nearest neighbours by brute force, because a k-d tree is no faster in 24 dimensions.

use anyhow::Result;
use nalgebra::DMatrix;

use super::{Form, Kind, Limits, NARROW, Predictor, gaussian_process::squared_distance};

/// Number of neighbours, each weighted by the inverse of its distance.
const NEIGHBOURS: usize = 8;
/// Squared distance below which two faces count as the same.
const SAME: f64 = 1e-18;

/// The weighted mean of the nearest faces.
pub struct Neighbours;

struct Fitted {
    /// One column per face.
    faces: DMatrix<f64>,
    truth: Vec<f64>,
}

impl Kind for Neighbours {
    fn name(&self) -> &'static str {
        "knn"
    }

    fn form(&self) -> Form {
        Form::Large
    }

    fn limits(&self) -> Limits {
        NARROW
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        Ok(Box::new(Fitted { faces: faces.transpose(), truth: truth.to_vec() }))
    }
}

impl Predictor for Fitted {
    fn predict(&self, face: &[f64]) -> f64 {
        let distances = self.faces.column_iter().map(|other| squared_distance(other.iter(), face));
        let mut found: Vec<(f64, f64)> = distances.zip(self.truth.iter().copied()).collect();
        if found.len() > NEIGHBOURS {
            found.select_nth_unstable_by(NEIGHBOURS, |a, b| a.0.total_cmp(&b.0));
            found.truncate(NEIGHBOURS);
        }
        let weighted = found.iter().map(|(squared, truth)| (squared.max(SAME).sqrt().recip(), truth));
        let add = |(weights, sum): (f64, f64), (weight, truth)| (weights + weight, sum + weight * truth);
        let (weights, sum) = weighted.fold((0.0, 0.0), add);
        sum / weights
    }

    /// The effective degrees of freedom of a smoother: faces divided by neighbours.
    fn weights(&self) -> usize {
        self.truth.len() / NEIGHBOURS
    }

    fn numbers(&self) -> usize {
        self.faces.len() + self.truth.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, unexplained};

    #[test]
    fn the_prediction_for_a_seen_face_is_its_truth() {
        let (faces, truth) = faces(100, 3, |face| face[0] * face[1]);
        let model = Neighbours.fit(&faces, &truth).unwrap();
        let row: Vec<f64> = faces.row(17).iter().copied().collect();
        assert!((model.predict(&row) - truth[17]).abs() < 1e-7);
    }

    #[test]
    fn a_nonlinear_function_is_found_from_many_faces() {
        assert!(unexplained(&Neighbours, 2000, |face| face[0] * face[1] + face[2]) < 0.03);
    }
}
