//! Feature selection (`S` in eq. 4 of the paper) for one blendshape, on the pictures of the fit only.
//!
//! Forward selection by partial correlation: each next feature explains most of the variance that the previous ones
//! leave. Plain correlation would select the same few points many times over.

use facewire::solve::FEATURES;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::{design::MODELLED, judge::Faces};

/// The smallest deviation, in eye distances, that a feature is scaled by.
pub const LEAST_DEVIATION: f64 = 0.001;
/// Noise assumed in each feature, relative to its variance. Without it, a feature that nearly repeats others could be
/// selected for its tiny remainder.
const NOISE: f64 = 0.003;
/// Number of pictures whose products one thread adds up at a time.
const BLOCK: usize = 2048;

/// Sums and sums of products of the features and of the truth.
/// Sums and sums of products of features, and of features with the truth.
pub struct Moments {
    count: f64,
    sum: DVector<f64>,
    gram: DMatrix<f64>,
    truth_sum: DVector<f64>,
    cross: DMatrix<f64>,
}

impl Moments {
    /// Sums over some pictures.
    pub fn of(faces: &Faces, rows: &[usize]) -> Self {
        let part = |rows: &[usize]| {
            let columns = DMatrix::from_fn(FEATURES, rows.len(), |feature, row| faces.values(rows[row])[feature]);
            let truth = faces.truths(rows).rows(0, MODELLED).into_owned();
            let transposed = columns.transpose();
            Self {
                count: rows.len() as f64,
                sum: columns.map(f64::from).column_sum(),
                truth_sum: truth.column_sum(),
                cross: transposed.map(f64::from).tr_mul(&truth.transpose()),
                gram: (columns * transposed).map(f64::from),
            }
        };
        // Added up in order, so that the same pictures give the same sums.
        let parts: Vec<Self> = rows.par_chunks(BLOCK).map(part).collect();
        parts.iter().fold(Self::none(), Self::with)
    }

    /// Returns the sums over no pictures.
    pub fn none() -> Self {
        let (sum, truth_sum) = (DVector::zeros(FEATURES), DVector::zeros(MODELLED));
        let (gram, cross) = (DMatrix::zeros(FEATURES, FEATURES), DMatrix::zeros(FEATURES, MODELLED));
        Self { count: 0.0, sum, gram, truth_sum, cross }
    }

    /// Adds the sums over further pictures.
    pub fn with(mut self, other: &Self) -> Self {
        self.count += other.count;
        self.sum += &other.sum;
        self.gram += &other.gram;
        self.truth_sum += &other.truth_sum;
        self.cross += &other.cross;
        self
    }

    /// Computes the covariances of the standardised features with each other and with the truth.
    pub fn standardised(mut self) -> Ranking {
        let (mean, truth_mean) = (self.sum / self.count, self.truth_sum / self.count);
        self.gram /= self.count;
        self.gram.ger(-1.0, &mean, &mean, 1.0);
        self.cross /= self.count;
        self.cross.ger(-1.0, &mean, &truth_mean, 1.0);
        let deviation = self.gram.diagonal().map(|variance| variance.max(0.0).sqrt().max(LEAST_DEVIATION));
        for (index, deviation) in deviation.iter().enumerate() {
            self.gram.row_mut(index).scale_mut(1.0 / deviation);
            self.gram.column_mut(index).scale_mut(1.0 / deviation);
            self.cross.row_mut(index).scale_mut(1.0 / deviation);
        }
        Ranking { gram: self.gram, cross: self.cross }
    }
}

/// Covariances that rank the features for any blendshape.
pub struct Ranking {
    gram: DMatrix<f64>,
    cross: DMatrix<f64>,
}

impl Ranking {
    /// Returns the `count` best features for a blendshape, by pivoted Cholesky decomposition. `rest` is the part of
    /// each feature's variance that the selected features do not explain, `covariance` the same of its covariance with
    /// the truth.
    pub fn best(&self, blendshape: usize, count: usize) -> Vec<usize> {
        let mut rest = self.gram.diagonal().add_scalar(NOISE);
        let mut covariance = self.cross.column(blendshape).into_owned();
        let mut chosen: Vec<usize> = Vec::new();
        let mut factors: Vec<DVector<f64>> = Vec::new();
        for _ in 0..count {
            let gain = |feature: &usize| covariance[*feature].powi(2) / rest[*feature];
            let open = (0..rest.len()).filter(|feature| rest[*feature] > NOISE / 2.0 && !chosen.contains(feature));
            let Some(best) = open.max_by(|a, b| gain(a).total_cmp(&gain(b))) else { break };
            let mut factor = self.gram.column(best).into_owned();
            for known in &factors {
                factor.axpy(-known[best], known, 1.0);
            }
            factor /= rest[best].sqrt();
            covariance.axpy(-covariance[best] / rest[best].sqrt(), &factor, 1.0);
            rest.zip_apply(&factor, |rest, own| *rest -= own * own);
            factors.push(factor);
            chosen.push(best);
        }
        chosen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_feature_that_repeats_a_selected_one_comes_after_one_that_adds_information() {
        // Two copies of a strong feature, and a weak feature independent of them.
        let gram = DMatrix::from_row_slice(3, 3, &[1.0, 0.99, 0.0, 0.99, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let ranking = Ranking { gram, cross: DMatrix::from_column_slice(3, 1, &[0.8, 0.79, 0.2]) };
        assert_eq!(ranking.best(0, 3), [0, 2, 1]);
        assert_eq!(ranking.best(0, 2), [0, 2]);
    }
}
