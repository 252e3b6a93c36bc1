//! The rotated crop of the feature map that a head receives.
//!
//! The arithmetic is that of MediaPipe's operators `Landmarks2TransformMatrix`, `TransformTensorBilinear` and
//! `TransformLandmarks`. The line through two rotation points is level in the crop, and the crop is 1.5 times as large as
//! the box around the head's points.

use super::feature_map::FeatureMap;
use super::refinement::{CROP_SCALE, CROP_SIZE, FEATURE_CHANNELS, FEATURE_SCALE, TARGET_ANGLE};
use super::region::bounds;

/// Maps cells of the crop to cells of the feature map: `linear * p + shift`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Transform {
    linear: [[f32; 2]; 2],
    shift: [f32; 2],
}

impl Transform {
    /// The crop around the points of the mesh whose indices are `points`, in which the line through the points `level` is
    /// level. The mesh is in samples of the backbone's input.
    pub(super) fn around(mesh: &[[f32; 3]], points: &[u16], level: [u16; 2]) -> Self {
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

    /// Maps a point of a head's output to samples of the backbone's input. A head counts four steps to a cell of its crop,
    /// as many as there are samples of the backbone's input to a cell of the feature map.
    pub(super) fn apply(&self, point: [f32; 2]) -> [f32; 2] {
        self.map(point, self.shift.map(|shift| shift / FEATURE_SCALE))
    }

    /// Rotates and scales a difference of two points like [`Transform::apply`].
    pub(super) fn turn(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let [column, row] = self.linear;
        [column[0] * x + column[1] * y, row[0] * x + row[1] * y]
    }

    /// The inverse of [`Transform::turn`]; 0 if the crop has no area.
    pub(super) fn turn_back(&self, [x, y]: [f32; 2]) -> [f32; 2] {
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

/// Rotates a point by an angle, given by its cosine and sine.
fn rotate([x, y]: [f32; 2], [cos, sin]: [f32; 2]) -> [f32; 2] {
    [cos * x - sin * y, sin * x + cos * y]
}

#[cfg(test)]
mod tests {
    use super::super::refinement::FEATURE_SIZE;
    use super::*;

    /// A mesh of four points: the corners of an upright box of 96 x 48 samples.
    fn mesh() -> Vec<[f32; 3]> {
        vec![[48.0, 48.0, 0.0], [144.0, 48.0, 0.0], [48.0, 96.0, 0.0], [144.0, 96.0, 0.0]]
    }

    #[test]
    fn centre_of_the_crop_is_the_centre_of_the_points() {
        let transform = Transform::around(&mesh(), &[0, 1, 2, 3], [0, 1]);
        let [x, y] = transform.apply([32.0, 32.0]);
        assert!((x - 96.0).abs() < 1e-4 && (y - 72.0).abs() < 1e-4);
    }

    #[test]
    fn crop_is_1_5_times_as_large_as_the_box_of_the_points() {
        let transform = Transform::around(&mesh(), &[0, 1, 2, 3], [0, 1]);
        let ([left, top], [right, bottom]) = (transform.apply([0.0, 0.0]), transform.apply([64.0, 64.0]));
        assert!((right - left - 144.0).abs() < 1e-3 && (bottom - top - 72.0).abs() < 1e-3);
    }

    #[test]
    fn turning_back_undoes_turning() {
        let mut mesh = mesh();
        mesh[1][1] = 80.0;
        let transform = Transform::around(&mesh, &[0, 1, 2, 3], [0, 1]);
        let [x, y] = transform.turn_back(transform.turn([3.0, -2.0]));
        assert!((x - 3.0).abs() < 1e-4 && (y + 2.0).abs() < 1e-4, "{x} {y}");
    }

    #[test]
    fn sampling_a_ramp_gives_its_values_at_the_cells_of_the_crop() {
        let transform = Transform::around(&mesh(), &[0, 1, 2, 3], [0, 1]);
        let cells = (0..FEATURE_SIZE * FEATURE_SIZE).map(|at| [(at % FEATURE_SIZE) as f32; FEATURE_CHANNELS]);
        let ramp: Vec<f32> = cells.flatten().collect();
        let mut row = [[0.0; FEATURE_CHANNELS]; CROP_SIZE];
        transform.sample(FeatureMap::new(&ramp), 0, row.as_flattened_mut());
        for (left, right) in row[7].into_iter().zip(row[8]) {
            assert!((right - left - 2.25).abs() < 1e-4, "one cell of the crop is 2.25 cells of the map");
            assert!((left + right - 2.0 * 23.5).abs() < 1e-3);
        }
    }
}
