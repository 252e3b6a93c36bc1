//! The feature map of the mesh network, and the rotated crop of it that a head receives.
//!
//! Positions count cells, and whole numbers are centres of cells. Outside its cells the map counts as 0. The arithmetic
//! is that of MediaPipe's operators `Landmarks2TransformMatrix`, `TransformTensorBilinear` and `TransformLandmarks`.

use facewire_engine::kernels::rows::add_pair;

use super::refinement::{CROP_SCALE, CROP_SIZE, FEATURE_CHANNELS, FEATURE_SCALE, FEATURE_SIZE, TARGET_ANGLE};

pub(super) type Cell = [f32; FEATURE_CHANNELS];

/// Least and greatest coordinates of points.
pub fn bounds(points: impl Iterator<Item = [f32; 2]>) -> [[f32; 2]; 2] {
    points.fold([[f32::INFINITY; 2], [f32::NEG_INFINITY; 2]], |[min, max], [x, y]| {
        [[min[0].min(x), min[1].min(y)], [max[0].max(x), max[1].max(y)]]
    })
}

/// A map of 48 x 48 cells, row by row.
#[derive(Debug, Clone, Copy)]
pub(super) struct FeatureMap<'a>(&'a [Cell]);

impl<'a> FeatureMap<'a> {
    pub(super) fn new(values: &'a [f32]) -> Self {
        Self(values.as_chunks().0)
    }

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
    let right_weight = column - left;
    let bottom_weight = row - top;
    let at = top as usize * FEATURE_SIZE + left as usize;
    let pair = |row_weight: f32| [(1.0 - right_weight) * row_weight, right_weight * row_weight];
    [(at, pair(1.0 - bottom_weight)), (at + FEATURE_SIZE, pair(bottom_weight))]
}

/// Maps cells of the crop to cells of the feature map: `linear * p + shift`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Transform {
    linear: [[f32; 2]; 2],
    shift: [f32; 2],
}

impl Transform {
    /// The crop around `points` of the mesh, in samples of the backbone's input, in which a line through `level` is level.
    pub(crate) fn around(mesh: &[[f32; 3]], points: &[u16], level: [u16; 2]) -> Self {
        let point = |index: u16| {
            mesh.get(usize::from(index))
                .map_or([0.0; 2], |point| [point[0], point[1]].map(|value| value * FEATURE_SCALE))
        };
        let [from, to] = level.map(point);
        let angle = TARGET_ANGLE - (to[1] - from[1]).atan2(to[0] - from[0]);
        let (sin, cos) = angle.sin_cos();
        let [min, max] = bounds(points.iter().map(|&index| rotate(point(index), [cos, sin])));
        let centre = rotate([f32::midpoint(min[0], max[0]), f32::midpoint(min[1], max[1])], [cos, -sin]);
        let [width, height] = [max[0] - min[0], max[1] - min[1]].map(|size| size * CROP_SCALE / CROP_SIZE as f32);
        let linear = [[cos * width, sin * height], [-sin * width, cos * height]];
        let half = CROP_SIZE as f32 / 2.0;
        let shift =
            [centre[0] - (linear[0][0] + linear[0][1]) * half, centre[1] - (linear[1][0] + linear[1][1]) * half];
        Self { linear, shift }
    }

    /// Maps a point of a head's output, which counts four steps to a cell, to samples of the backbone's input.
    pub(crate) fn apply(&self, point: [f32; 2]) -> [f32; 2] {
        self.map(point, self.shift.map(|shift| shift / FEATURE_SCALE))
    }

    /// Rotates and scales a difference of two points like [`Transform::apply`].
    pub(super) fn turn(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let [column, row] = self.linear;
        [column[0] * x + column[1] * y, row[0] * x + row[1] * y]
    }

    /// The inverse of [`Transform::turn`]; 0 if the crop has no area.
    pub(crate) fn turn_back(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let [column, row] = self.linear;
        let area = column[0] * row[1] - column[1] * row[0];
        let inverse = if area == 0.0 { 0.0 } else { 1.0 / area };
        [(row[1] * x - column[1] * y) * inverse, (column[0] * y - row[0] * x) * inverse]
    }

    fn map(&self, point: [f32; 2], shift: [f32; 2]) -> [f32; 2] {
        let [x, y] = self.turn(point);
        [x + shift[0], y + shift[1]]
    }

    /// Samples the feature map into one row of a head's input (16 x 16 cells).
    pub(super) fn sample(&self, map: FeatureMap, row: usize, crop_row: &mut [f32]) {
        for (column, cell) in crop_row.as_chunks_mut::<FEATURE_CHANNELS>().0.iter_mut().enumerate() {
            let centre = [column as f32 + 0.5, row as f32 + 0.5];
            map.sample(self.map(centre, self.shift).map(|position| position - 0.5), cell);
        }
    }
}

fn rotate([x, y]: [f32; 2], [cos, sin]: [f32; 2]) -> [f32; 2] {
    [cos * x - sin * y, sin * x + cos * y]
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A map whose values are `column + 100 row`.
    pub(in crate::track) fn map() -> Vec<f32> {
        let value = |at: usize| (at % FEATURE_SIZE + 100 * (at / FEATURE_SIZE)) as f32;
        (0..FEATURE_SIZE * FEATURE_SIZE).flat_map(|at| [value(at); FEATURE_CHANNELS]).collect()
    }

    #[test]
    fn values_between_cells_are_interpolated_and_outside_the_map_they_are_0() {
        let map = map();
        let inside = [[0.0, 0.0], [10.25, 3.5], [47.0, 47.0], [47.0, 0.5], [46.75, 20.0]];
        let outside = [[-0.1, 5.0], [47.1, 5.0], [5.0, -0.1], [5.0, 47.1], [f32::NAN, 5.0], [5.0, f32::INFINITY]];
        let wanted = inside.map(|[x, y]| x + 100.0 * y).into_iter().chain([0.0; 6]);
        for (position, wanted) in inside.into_iter().chain(outside).zip(wanted) {
            let mut cell = [7.0; FEATURE_CHANNELS];
            FeatureMap::new(&map).sample(position, &mut cell);
            assert!(cell.iter().all(|value| (value - wanted).abs() < 1e-2), "{position:?}: {}", cell[0]);
        }
    }
}
