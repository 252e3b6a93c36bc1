//! Principal components of the selected features, in which the network is trained and its weights decay.

use anyhow::Result;
use nalgebra::DMatrix;

use crate::design::{Design, Scale};

/// Components with a smaller part of the largest one's deviation are scaled as if they had that.
const LEAST_PART: f64 = 0.02;
/// Power of the deviation by which a component is divided: 1 would make small ones, which are noise, as loud as large
/// ones; 0 would leave them too faint to be learned.
const WHITENING: f64 = 0.6;

/// A linear map of standardised features onto scaled components.
pub struct Basis {
    pub features: Vec<usize>,
    /// Components x features.
    pub map: DMatrix<f32>,
}

impl Basis {
    /// The `count` largest components.
    pub fn of(design: &Design, scale: &Scale, features: Vec<usize>, count: usize) -> Result<Self> {
        let (gram, _) = design.moments(&features, scale)?;
        let eigen = gram.symmetric_eigen();
        let mut order: Vec<usize> = (0..features.len()).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        order.truncate(count);
        let deviation = |index: usize| eigen.eigenvalues[index].max(0.0).sqrt();
        let least = LEAST_PART * deviation(order[0]);
        let map = DMatrix::from_fn(order.len(), features.len(), |row, column| {
            let component = order[row];
            let divisor = deviation(component).max(least).powf(WHITENING);
            (eigen.eigenvectors[(column, component)] / divisor) as f32
        });
        Ok(Self { features, map })
    }
}
