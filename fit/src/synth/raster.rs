//! Rasterises triangles: determines which samples of a grid a triangle covers, with their barycentric coordinates.
//!
//! Positions are snapped to 1/256 of a sample and edge functions are integers, with the top-left rule. Of triangles
//! that share an edge, exactly one covers a sample on it, so that there are neither cracks nor overlaps. Contract: no
//! sample outside the grid is visited. Limits: triangles with corners more than 16,000 samples from the origin are
//! skipped.

use glam::{Vec2, Vec3};

/// Number of subpixel positions per sample.
const STEPS: f32 = 256.0;
const STEP: i64 = 256;
/// Largest coordinate of a corner for which the edge functions do not overflow.
const FARTHEST: f32 = 16_000.0;
/// Adding and subtracting this number rounds an f32 below 2^22 to an integer: 1.5 x 2^23, where the spacing is 1.
const ROUNDER: f32 = 12_582_912.0;

/// A grid of samples. Sample (0, 0) has its centre at (0.5, 0.5).
#[derive(Debug, Clone, Copy)]
pub struct Grid {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Grid {
    /// Calls `sample(index, barycentric coordinates)` for every sample that the triangle covers. Triangles whose
    /// corners run clockwise in the picture face away and are skipped.
    pub fn fill(self, corners: [Vec2; 3], mut sample: impl FnMut(usize, Vec3)) {
        let farthest = corners[0].abs().max(corners[1].abs()).max(corners[2].abs());
        if !(farthest.max_element() < FARTHEST) || (corners[0] + corners[1] + corners[2]).is_nan() {
            return;
        }
        let [a, b, c] = [snap(corners[0]), snap(corners[1]), snap(corners[2])];
        let area = cross(a, b, c);
        if area >= 0 {
            return;
        }
        let inverse = 1.0 / -area as f32;
        self.fill_clockwise([a, c, b], |index, [one, three, two]| sample(index, Vec3::new(one, two, three) * inverse));
    }

    fn fill_clockwise(self, [a, b, c]: [[i64; 2]; 3], mut sample: impl FnMut(usize, [f32; 3])) {
        let columns = span([a[0], b[0], c[0]], self.width);
        let rows = span([a[1], b[1], c[1]], self.height);
        let start = [centre(columns.start), centre(rows.start)];
        // Each edge is opposite to the corner whose weight it gives.
        let mut edges = [Edge::new(b, c, start), Edge::new(c, a, start), Edge::new(a, b, start)];
        for row in rows {
            let mut at = [edges[0].value, edges[1].value, edges[2].value];
            for column in columns.clone() {
                if at[0] >= edges[0].least && at[1] >= edges[1].least && at[2] >= edges[2].least {
                    sample(row * self.width + column, [at[0] as f32, at[1] as f32, at[2] as f32]);
                }
                at[0] += edges[0].right;
                at[1] += edges[1].right;
                at[2] += edges[2].right;
            }
            for edge in &mut edges {
                edge.value += edge.down;
            }
        }
    }
}

/// An edge function: twice the area between the edge and a sample, with its increments from sample to sample.
struct Edge {
    value: i64,
    right: i64,
    down: i64,
    /// Least value of a covered sample: 0 for a top or left edge, which includes its samples, and 1 otherwise.
    least: i64,
}

impl Edge {
    fn new(from: [i64; 2], to: [i64; 2], at: [i64; 2]) -> Self {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let top_left = dy < 0 || (dy == 0 && dx > 0);
        Self { value: cross(from, to, at), right: -dy * STEP, down: dx * STEP, least: i64::from(!top_left) }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "positions are bounded by FARTHEST")]
fn snap(position: Vec2) -> [i64; 2] {
    let rounded = position * STEPS + ROUNDER - ROUNDER;
    [rounded.x as i64, rounded.y as i64]
}

fn cross(a: [i64; 2], b: [i64; 2], c: [i64; 2]) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn centre(index: usize) -> i64 {
    i64::try_from(index).unwrap_or(0) * STEP + STEP / 2
}

/// Returns the range of samples whose centres lie between the smallest and the largest position.
fn span(positions: [i64; 3], side: usize) -> core::ops::Range<usize> {
    let [a, b, c] = positions;
    let first = (a.min(b).min(c) + STEP / 2 - 1).div_euclid(STEP).max(0);
    let end = (a.max(b).max(c) + STEP / 2).div_euclid(STEP).max(first);
    let clamp = |value: i64| usize::try_from(value).unwrap_or(0).min(side);
    clamp(first)..clamp(end)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { width: 40, height: 30 };

    fn coverage(triangles: &[[Vec2; 3]]) -> Vec<u32> {
        let mut counts = vec![0; GRID.width * GRID.height];
        for corners in triangles {
            GRID.fill(*corners, |index, _| counts[index] += 1);
        }
        counts
    }

    /// Returns a fan of triangles around a centre inside the grid, whose rim is outside of it.
    fn fan(centre: Vec2, blades: u8) -> Vec<[Vec2; 3]> {
        let rim = |blade: u8| {
            let angle = f32::from(blade) / f32::from(blades) * core::f32::consts::TAU;
            centre + 90.0 * Vec2::from_angle(angle)
        };
        (0..blades).map(|blade| [centre, rim((blade + 1) % blades), rim(blade)]).collect()
    }

    #[test]
    fn triangles_that_share_edges_cover_every_sample_exactly_once() {
        for (centre, blades) in [(Vec2::new(20.5, 15.5), 8), (Vec2::new(13.37, 11.11), 7), (Vec2::new(20.0, 15.0), 64)]
        {
            let counts = coverage(&fan(centre, blades));
            assert!(counts.iter().all(|count| *count == 1), "{centre}, {blades} blades");
        }
    }

    #[test]
    fn samples_on_a_shared_edge_belong_to_one_triangle() {
        let square = [Vec2::new(4.5, 4.5), Vec2::new(12.5, 4.5), Vec2::new(12.5, 12.5), Vec2::new(4.5, 12.5)];
        let counts = coverage(&[[square[0], square[2], square[1]], [square[0], square[3], square[2]]]);
        assert_eq!(counts.iter().sum::<u32>(), 64);
        assert!(counts.iter().all(|count| *count <= 1));
    }

    #[test]
    fn triangles_outside_the_grid_and_invalid_corners_are_skipped() {
        let far = [Vec2::new(-500.0, -500.0), Vec2::new(-400.0, 900.0), Vec2::new(-300.0, 10.0)];
        let invalid = [Vec2::new(f32::NAN, 0.0), Vec2::new(1e9, 3.0), Vec2::new(0.0, 20.0)];
        assert!(coverage(&[far, invalid]).iter().all(|count| *count == 0));
    }

    #[test]
    fn weights_interpolate_the_position_and_sum_to_one() {
        let corners = [Vec2::new(2.0, 2.0), Vec2::new(5.0, 25.0), Vec2::new(35.0, 7.0)];
        GRID.fill(corners, |index, weights| {
            let position = corners[0] * weights.x + corners[1] * weights.y + corners[2] * weights.z;
            let expected = Vec2::new((index % GRID.width) as f32 + 0.5, (index / GRID.width) as f32 + 0.5);
            assert!((weights.element_sum() - 1.0).abs() < 1e-4 && (position - expected).length() < 0.01);
        });
    }

    #[test]
    fn only_triangles_that_face_the_camera_are_drawn() {
        let seen = [Vec2::new(2.0, 2.0), Vec2::new(5.0, 25.0), Vec2::new(35.0, 7.0)];
        let mut counts = [0; 2];
        GRID.fill(seen, |_, _| counts[0] += 1);
        GRID.fill([seen[0], seen[2], seen[1]], |_, _| counts[1] += 1);
        assert!(counts[0] > 100 && counts[1] == 0);
    }
}
