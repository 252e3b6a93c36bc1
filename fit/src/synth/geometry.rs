//! Geometry and interpolation for several stages.

use glam::Vec3;

use super::rig::Triangle;

/// Returns area-weighted unit normals of the vertices, and 0 for vertices without triangles.
pub fn normals(points: &[Vec3], triangles: &[Triangle]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; points.len()];
    normals_into(points, triangles, &mut sums);
    sums
}

/// Computes [`normals`] in place.
pub fn normals_into(points: &[Vec3], triangles: &[Triangle], sums: &mut [Vec3]) {
    sums.fill(Vec3::ZERO);
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| points[vertex as usize]);
        let normal = (b - a).cross(c - a);
        for vertex in triangle {
            sums[*vertex as usize] += normal;
        }
    }
    for normal in sums {
        *normal = normal.normalize_or_zero();
    }
}

/// Returns the vertices of some triangles in ascending order, without duplicates.
pub fn vertices_of(triangles: &[Triangle]) -> Vec<u32> {
    let mut vertices = triangles.concat();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

/// Interpolates smoothly from 0 at `from` to 1 at `to`.
pub fn smoothstep(from: f32, to: f32, value: f32) -> f32 {
    let share = ((value - from) / (to - from)).clamp(0.0, 1.0);
    share * share * (3.0 - 2.0 * share)
}

/// Interpolates linearly between points in ascending order. The function is constant outside of them.
pub fn piecewise(points: &[(f32, f32)], at: f32) -> f32 {
    let between = points.windows(2).find(|pair| at <= pair[1].0);
    match (between, points.last()) {
        (Some(pair), _) => {
            let share = ((at - pair[0].0) / (pair[1].0 - pair[0].0)).clamp(0.0, 1.0);
            pair[0].1 + share * (pair[1].1 - pair[0].1)
        }
        (None, Some(last)) => last.1,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use super::*;

    #[test]
    fn normals_point_to_the_side_from_which_corners_run_counter_clockwise() {
        let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];
        assert_eq!(normals(&points, &[[0, 1, 2]]), [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::ZERO]);
    }

    #[test]
    fn piecewise_is_linear_between_and_constant_beyond() {
        let points = [(0.0, 1.0), (2.0, 3.0), (3.0, 0.0)];
        assert_eq!([-1.0, 1.0, 2.5, 9.0].map(|at| piecewise(&points, at)), [1.0, 2.0, 1.5, 0.0]);
    }
}
