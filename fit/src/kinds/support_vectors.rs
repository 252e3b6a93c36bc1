//! Support vector regression with an epsilon-insensitive loss.
//!
//! The offset is a feature that is 1 in every face, and so is part of the penalty. The dual problem then has no
//! equality constraint and is solved by coordinate descent (Hsieh et al., 2008). `smartcore` has the usual form, but
//! uses a wrong diagonal with the polynomial kernel, and its model borrows its parameters.

use anyhow::Result;
use nalgebra::{DMatrix, DVector};

use super::{
    Form, Kind, Limits, NARROW, Predictor,
    formula::dot,
    gaussian_process::{squared_distance, squared_distances},
};

/// Errors up to this size cost nothing (epsilon).
const ZONE: f64 = 0.05;
/// Largest multiplier (the cost C).
const MOST: f64 = 1.0;
/// Largest number of passes over the faces, and the largest change of a multiplier in a pass that counts as converged.
const PASSES: usize = 200;
const CONVERGED: f64 = 1e-4;
/// Degree of the polynomial kernel.
const DEGREE: i32 = 3;

/// Support vector regression with one of two kernels, scaled as by scikit-learn's default.
#[derive(Clone, Copy)]
pub enum SupportVectors {
    /// `exp(-d2 / n)` with n features.
    Rbf,
    /// `(f g / n + 1)^3` with n features.
    Polynomial,
}

struct Fitted {
    kernel: SupportVectors,
    /// One column per face.
    faces: DMatrix<f64>,
    multipliers: Vec<f64>,
    centre: f64,
}

impl Kind for SupportVectors {
    fn name(&self) -> &'static str {
        match self {
            Self::Rbf => "svr-rbf",
            Self::Polynomial => "svr-poly",
        }
    }

    fn form(&self) -> Form {
        Form::Large
    }

    fn limits(&self) -> Limits {
        NARROW
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let centre = DVector::from_column_slice(truth).mean();
        let centred: Vec<f64> = truth.iter().map(|truth| truth - centre).collect();
        let multipliers = multipliers(&self.matrix(faces), &centred);
        let kept: Vec<usize> = (0..truth.len()).filter(|row| multipliers[*row] != 0.0).collect();
        let faces = faces.select_rows(&kept).transpose();
        let multipliers = kept.iter().map(|row| multipliers[*row]).collect();
        Ok(Box::new(Fitted { kernel: *self, faces, multipliers, centre }))
    }
}

impl SupportVectors {
    /// Returns the kernel of all pairs of faces.
    fn matrix(self, faces: &DMatrix<f64>) -> DMatrix<f64> {
        let features = faces.ncols() as f64;
        match self {
            Self::Rbf => squared_distances(faces).map(|squared| rbf(squared, features)),
            Self::Polynomial => (faces * faces.transpose()).map(|product| polynomial(product, features)),
        }
    }

    fn value<'a>(self, kept: impl IntoIterator<Item = &'a f64>, face: &[f64]) -> f64 {
        let features = face.len() as f64;
        match self {
            Self::Rbf => rbf(squared_distance(kept, face), features),
            Self::Polynomial => polynomial(dot(kept, face), features),
        }
    }
}

/// The kernel with an added 1 for the offset.
fn rbf(squared: f64, features: f64) -> f64 {
    (-squared / features).exp() + 1.0
}

fn polynomial(product: f64, features: f64) -> f64 {
    (product / features + 1.0).powi(DEGREE) + 1.0
}

/// Solves the dual: minimises `m' K m / 2 - y' m + zone |m|` with each multiplier within [`MOST`] of 0.
fn multipliers(kernel: &DMatrix<f64>, truth: &[f64]) -> Vec<f64> {
    let mut multipliers = vec![0.0_f64; truth.len()];
    let mut estimates = DVector::<f64>::zeros(truth.len());
    for _ in 0..PASSES {
        let mut largest = 0.0_f64;
        for (index, multiplier) in multipliers.iter_mut().enumerate() {
            let own = kernel[(index, index)];
            let best: f64 = own * *multiplier - estimates[index] + truth[index];
            let next = (best.signum() * (best.abs() - ZONE).max(0.0) / own).clamp(-MOST, MOST);
            let change = next - *multiplier;
            if change != 0.0 {
                estimates.axpy(change, &kernel.column(index), 1.0);
                *multiplier = next;
                largest = largest.max(change.abs());
            }
        }
        if largest < CONVERGED {
            break;
        }
    }
    multipliers
}

impl Predictor for Fitted {
    fn predict(&self, face: &[f64]) -> f64 {
        let kept = self.faces.column_iter().zip(&self.multipliers);
        self.centre + kept.map(|(other, multiplier)| multiplier * self.kernel.value(other.iter(), face)).sum::<f64>()
    }

    fn weights(&self) -> usize {
        self.multipliers.len()
    }

    fn numbers(&self) -> usize {
        self.faces.len() + self.multipliers.len() + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, unexplained};

    #[test]
    fn a_nonlinear_function_is_found_to_about_the_zone() {
        let truth = |face: &[f64]| 0.5 + 0.4 * face[0] * face[1] + 0.3 * face[2];
        assert!(unexplained(&SupportVectors::Rbf, 300, truth) < 0.03);
        assert!(unexplained(&SupportVectors::Polynomial, 300, truth) < 0.03);
    }

    #[test]
    fn the_multipliers_minimise_the_dual() {
        let (faces, truth) = faces(60, 3, |face| face[0] * face[1]);
        let kernel = SupportVectors::Rbf.matrix(&faces);
        let dual = |multipliers: &DVector<f64>| {
            let truth = DVector::from_column_slice(&truth);
            multipliers.dot(&(&kernel * multipliers)) / 2.0 - truth.dot(multipliers) + ZONE * multipliers.lp_norm(1)
        };
        let found = DVector::from_vec(multipliers(&kernel, &truth));
        for index in 0..60 {
            for step in [-0.01, 0.01] {
                let mut other = found.clone();
                other[index] = (other[index] + step).clamp(-MOST, MOST);
                assert!(dual(&other) >= dual(&found) - 1e-5, "{index} {step}");
            }
        }
    }

    #[test]
    fn a_truth_within_the_zone_needs_no_support_vectors() {
        let (faces, truth) = faces(40, 2, |face| 0.5 + 0.04 * face[0]);
        assert_eq!(SupportVectors::Rbf.fit(&faces, &truth).unwrap().weights(), 0);
    }
}
