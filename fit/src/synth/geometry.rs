//! Geometry and interpolation for several stages.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;

use super::rig::Triangle;

/// Returns area-weighted unit normals of the vertices, and 0 for vertices without triangles.
pub fn normals(points: &[Vec3], triangles: &[Triangle]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; points.len()];
    normals_into(points, triangles, &mut sums);
    sums
}

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

pub struct SimpleMesh {
    pub vertices: Vec<u32>,
    pub triangles: Vec<Triangle>,
}

impl SimpleMesh {
    /// Merges the vertices that share a cube with sides of `cell`, in the length of the points.
    pub fn new(points: &[Vec3], triangles: &[Triangle], cell: f32) -> Self {
        let (mut vertices, mut numbers) = (Vec::new(), BTreeMap::new());
        let mut number = |vertex: u32| {
            let cube = (points[vertex as usize] / cell).floor().as_ivec3().to_array();
            *numbers.entry(cube).or_insert_with(|| {
                vertices.push(vertex);
                u32::try_from(vertices.len() - 1).unwrap_or(u32::MAX)
            })
        };
        let merged: BTreeSet<Triangle> = triangles.iter().map(|triangle| triangle.map(&mut number)).collect();
        let triangles = merged.into_iter().filter(|[a, b, c]| a != b && b != c && c != a).collect();
        Self { vertices, triangles }
    }
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
mod tests {
    use super::*;

    #[test]
    fn normals_point_to_the_side_from_which_corners_run_counter_clockwise() {
        let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];
        assert_eq!(normals(&points, &[[0, 1, 2]]), [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::ZERO]);
    }

    #[test]
    fn a_simplified_plane_is_the_same_plane_with_fewer_triangles() {
        let side = 11_u32;
        let point = |index: u32| Vec3::new((index % side) as f32, (index / side) as f32, 0.0);
        let points: Vec<Vec3> = (0..side * side).map(point).collect();
        let corners = (0..side * (side - 1)).filter(|index| index % side != side - 1);
        let triangles: Vec<Triangle> =
            corners.flat_map(|at| [[at, at + 1, at + side], [at + 1, at + side + 1, at + side]]).collect();
        let simple = SimpleMesh::new(&points, &triangles, 2.5);
        let twice_area = |[a, b, c]: [Vec3; 3]| (b - a).cross(c - a).z;
        let corner = |vertex: u32| points[simple.vertices[vertex as usize] as usize];
        let area: f32 = simple.triangles.iter().map(|triangle| twice_area(triangle.map(corner))).sum();
        assert!(simple.triangles.len() < triangles.len() / 4);
        assert!(area > 2.0 * 64.0, "{area}");
    }
}
