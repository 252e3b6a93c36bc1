//! What a direction sees of the head: depth maps, for the key light's shadow and for baked ambient occlusion.

use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;

use super::{raster::Grid, rig::Triangle};

/// Surfaces this much in front, centimetres, cast a shadow; less is the surface itself.
const BIAS_CM: f32 = 0.12;
/// ColumnSpace that ambient light is gathered from, and cells of a side of their maps.
const DIRECTIONS: u16 = 64;
const AMBIENT_SIDE: usize = 160;

/// Depths as seen from far away in one direction.
pub struct DepthMap {
    grid: Grid,
    depths: Vec<f32>,
    /// Rows: right, down, toward.
    axes: Mat3,
    corner: Vec2,
    cells_per_cm: f32,
    /// Cell and depth of every vertex.
    seen: Vec<(Vec2, f32)>,
}

impl DepthMap {
    /// A map without content, of `side` cells a side.
    pub fn new(side: usize) -> Self {
        let grid = Grid { width: side, height: side };
        let depths = vec![0.0; side * side];
        Self { grid, depths, axes: Mat3::IDENTITY, corner: Vec2::ZERO, cells_per_cm: 1.0, seen: Vec::new() }
    }

    /// Fills the map with the triangles as seen from `toward`, framing `bounds` (centre, radius).
    pub fn draw(&mut self, toward: Vec3, bounds: (Vec3, f32), points: &[Vec3], triangles: &[Triangle]) {
        let toward = toward.normalize_or(Vec3::Z);
        let right = toward.any_orthonormal_vector();
        self.axes = Mat3::from_cols(right, right.cross(toward), toward).transpose();
        let (centre, radius) = bounds;
        self.cells_per_cm = self.grid.width as f32 / (2.0 * radius);
        self.corner = (self.axes * centre).truncate() - radius;
        self.depths.fill(f32::NEG_INFINITY);
        let mut seen = core::mem::take(&mut self.seen);
        seen.clear();
        seen.extend(points.iter().map(|point| self.place(*point)));
        for [a, b, c] in triangles {
            let [(one, near), (two, middle), (three, far)] = [seen[*a as usize], seen[*b as usize], seen[*c as usize]];
            let depths = Vec3::new(near, middle, far);
            self.grid.fill([one, two, three], |index, weights| {
                self.depths[index] = self.depths[index].max(weights.dot(depths));
            });
        }
        self.seen = seen;
    }

    /// A length in cells of the map.
    pub fn cells(&self, length_cm: f32) -> f32 {
        length_cm * self.cells_per_cm
    }

    fn place(&self, point: Vec3) -> (Vec2, f32) {
        let seen = self.axes * point;
        ((seen.truncate() - self.corner) * self.cells_per_cm, seen.z)
    }

    /// Share of the neighbourhood of a point from which light comes, 0 to 1. `spread` is in cells.
    pub fn light_at(&self, point: Vec3, spread: f32) -> f32 {
        let (cell, depth) = self.place(point);
        let offsets = [-1.0, 0.0, 1.0].map(|step| step * spread);
        let taps = offsets.iter().flat_map(|dx| offsets.iter().map(move |dy| Vec2::new(*dx, *dy)));
        let open = taps.filter(|offset| self.depth_at(cell + *offset) < depth + BIAS_CM).count();
        open as f32 / 9.0
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to lie inside the map")]
    fn depth_at(&self, cell: Vec2) -> f32 {
        let inside = cell.min_element() >= 0.0 && cell.max_element() < self.grid.width as f32;
        if inside { self.depths[cell.y as usize * self.grid.width + cell.x as usize] } else { f32::NEG_INFINITY }
    }
}

/// Share of the sky that each vertex sees, 0 to 1, weighed by the cosine to its normal.
pub fn ambient_occlusion(points: &[Vec3], normals: &[Vec3], triangles: &[Triangle], bounds: (Vec3, f32)) -> Vec<f32> {
    let seen: Vec<Vec<[f32; 2]>> = (0..DIRECTIONS)
        .into_par_iter()
        .map(|index| {
            let toward = direction(index);
            let mut map = DepthMap::new(AMBIENT_SIDE);
            map.draw(toward, bounds, points, triangles);
            let one = |(point, normal): (&Vec3, &Vec3)| {
                let cosine = normal.dot(toward).max(0.0);
                if cosine > 0.0 { [cosine, cosine * map.light_at(*point + 0.1 * *normal, 0.7)] } else { [0.0; 2] }
            };
            points.iter().zip(normals).map(one).collect()
        })
        .collect();
    let share = |vertex: usize| {
        let [all, open] = seen.iter().fold([0.0; 2], |sum, map| [sum[0] + map[vertex][0], sum[1] + map[vertex][1]]);
        if all > 0.0 { open / all } else { 0.0 }
    };
    (0..points.len()).map(share).collect()
}

/// ColumnSpace spread evenly over the sphere (golden spiral).
fn direction(index: u16) -> Vec3 {
    let height = 1.0 - (2.0 * f32::from(index) + 1.0) / f32::from(DIRECTIONS);
    let around = Vec2::from_angle(f32::from(index) * 2.399_963_3) * (1.0 - height * height).sqrt();
    Vec3::new(around.x, height, around.y)
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use super::*;

    #[test]
    fn what_lies_behind_is_in_shadow_and_what_lies_beside_is_not() {
        let points = [Vec3::new(-1.0, -1.0, 2.0), Vec3::new(1.0, -1.0, 2.0), Vec3::new(0.0, 1.0, 2.0)];
        let mut map = DepthMap::new(64);
        map.draw(Vec3::Z, (Vec3::ZERO, 4.0), &points, &[[0, 1, 2]]);
        let light = |x: f32, y: f32, z: f32| map.light_at(Vec3::new(x, y, z), 1.0);
        assert_eq!([light(0.0, 0.0, 0.0), light(0.0, 0.0, 3.0), light(2.5, 0.0, 0.0)], [0.0, 1.0, 1.0]);
        assert_eq!(light(0.0, 0.0, 2.0), 1.0, "a surface does not shade itself");
        assert_eq!(light(50.0, 0.0, 0.0), 1.0, "outside the map there is light");
    }
}
