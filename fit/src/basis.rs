//! Principal components of the selected features. The network is trained on them, and its weights decay in this basis.

use anyhow::Result;
use nalgebra::DMatrix;

use crate::design::{Design, Scale};

/// The smallest deviation that a component is scaled by, relative to the largest component's.
const MIN_RELATIVE_DEVIATION: f64 = 0.02;
/// Each component is divided by its deviation to this power. With 1, the small components, which are noise, would count
/// as much as the large ones; with 0, the network would hardly learn from them.
const WHITENING: f64 = 0.6;

/// A linear map from standardised features to scaled principal components.
pub struct Basis {
    pub features: Vec<usize>,
    /// Components x features.
    pub map: DMatrix<f32>,
}

impl Basis {
    /// Computes the `count` largest components.
    pub fn of(design: &Design, scale: &Scale, features: Vec<usize>, count: usize) -> Result<Self> {
        let (gram, _) = design.moments(&features, scale)?;
        let eigen = gram.symmetric_eigen();
        let mut order: Vec<usize> = (0..features.len()).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        order.truncate(count);
        let deviation = |index: usize| eigen.eigenvalues[index].max(0.0).sqrt();
        let least = MIN_RELATIVE_DEVIATION * deviation(order[0]);
        let map = DMatrix::from_fn(order.len(), features.len(), |row, column| {
            let component = order[row];
            let divisor = deviation(component).max(least).powf(WHITENING);
            (eigen.eigenvectors[(column, component)] / divisor) as f32
        });
        Ok(Self { features, map })
    }
}
