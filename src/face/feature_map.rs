//! Samples the feature map of the mesh network by bilinear interpolation.
//!
//! Positions count cells, and whole numbers are centres of cells. Outside its cells the map counts as 0.

use facewire_engine::kernels::rows::add_pair;

use super::refinement::{FEATURE_CHANNELS, FEATURE_SIZE};

/// The values of a map at one position.
pub(super) type Cell = [f32; FEATURE_CHANNELS];

/// A map of 48 x 48 cells, row by row.
#[derive(Debug, Clone, Copy)]
pub(super) struct FeatureMap<'a>(&'a [Cell]);

impl<'a> FeatureMap<'a> {
    /// The map with these values, cell by cell.
    pub(super) fn new(values: &'a [f32]) -> Self {
        Self(values.as_chunks().0)
    }

    /// Writes the values at a position.
    pub(super) fn sample(self, position: [f32; 2], cell: &mut Cell) {
        *cell = [0.0; FEATURE_CHANNELS];
        for (at, weights) in taps(position) {
            if let Some(pair) = self.0.get(at..).and_then(<[_]>::first_chunk) {
                add_pair(cell, pair, weights);
            }
        }
    }
}

/// Two neighbouring cells of a map: the left one, and the weights of both.
type Taps = (usize, [f32; 2]);

/// The upper and the lower pair of the cells around a position. The weights of a position outside the map are 0.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be inside the map")]
fn taps([column, row]: [f32; 2]) -> [Taps; 2] {
    const LAST: f32 = (FEATURE_SIZE - 1) as f32;
    if !((0.0..=LAST).contains(&column) && (0.0..=LAST).contains(&row)) {
        return [(0, [0.0; 2]); 2];
    }
    // The last cell of a row is the right one of a pair.
    let [left, top] = [column, row].map(|position| position.floor().min(LAST - 1.0));
    let (right_weight, bottom_weight) = (column - left, row - top);
    let at = top as usize * FEATURE_SIZE + left as usize;
    let pair = |row_weight: f32| [(1.0 - right_weight) * row_weight, right_weight * row_weight];
    [(at, pair(1.0 - bottom_weight)), (at + FEATURE_SIZE, pair(bottom_weight))]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The value at a position of a map whose values are `column + 100 row`.
    fn value(position: [f32; 2]) -> f32 {
        let value = |at: usize| (at % FEATURE_SIZE + 100 * (at / FEATURE_SIZE)) as f32;
        let cells: Vec<f32> = (0..FEATURE_SIZE * FEATURE_SIZE).flat_map(|at| [value(at); FEATURE_CHANNELS]).collect();
        let mut cell = [7.0; FEATURE_CHANNELS];
        FeatureMap::new(&cells).sample(position, &mut cell);
        assert!(cell.iter().all(|other| (other - cell[0]).abs() < 1e-6));
        cell[0]
    }

    #[test]
    fn values_between_cells_are_interpolated_and_those_of_the_edges_are_exact() {
        for [x, y] in [[0.0, 0.0], [10.25, 3.5], [47.0, 47.0], [47.0, 0.5], [46.75, 20.0]] {
            assert!((value([x, y]) - (x + 100.0 * y)).abs() < 1e-2, "{x} {y}");
        }
    }

    #[test]
    fn positions_outside_the_map_and_numbers_that_are_not_finite_give_0() {
        for outside in [[-0.1, 5.0], [47.1, 5.0], [5.0, -0.1], [5.0, 47.1], [f32::NAN, 5.0], [5.0, f32::INFINITY]] {
            assert!(value(outside).abs() < f32::EPSILON, "{outside:?}");
        }
    }
}
