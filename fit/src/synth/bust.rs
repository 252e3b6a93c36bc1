//! Extends the rig, whose mesh ends at the shoulders, downwards and outwards, so that the bust does not float in the
//! picture.

use std::collections::{HashMap, HashSet};

use glam::Vec3;

use super::rig::{Rig, Triangle};

/// The rim of the shoulders lies below this height in centimetres. Higher rims are inside mouth and eyes.
const RIM: f32 = -11.0;
/// Rings of vertices below the rim: distance below it in centimetres, and scale of width and depth.
const RINGS: [(f32, [f32; 2]); 4] = [(2.5, [1.2, 1.12]), (5.5, [1.75, 1.25]), (11.0, [2.15, 1.4]), (120.0, [2.2, 1.5])];

/// Adds the body to a rig.
pub fn extend(rig: &mut Rig) {
    let edges = rim(&rig.parts.skin, &rig.neutral);
    let mut order: Vec<u32> = edges.iter().flatten().copied().collect();
    order.sort_unstable();
    order.dedup();
    let mut above: HashMap<u32, u32> = order.iter().map(|vertex| (*vertex, *vertex)).collect();
    for (down, scale) in RINGS {
        let below: HashMap<u32, u32> =
            order.iter().map(|vertex| (*vertex, rig.add_below(*vertex as usize, down, scale))).collect();
        for [a, b] in &edges {
            let [upper_a, upper_b, lower_a, lower_b] = [above[a], above[b], below[a], below[b]];
            rig.parts.skin.extend([[upper_b, upper_a, lower_a], [upper_b, lower_a, lower_b]]);
        }
        above = below;
    }
}

/// Returns the boundary edges of the shoulders, directed like the triangles that they belong to.
fn rim(triangles: &[Triangle], points: &[Vec3]) -> Vec<[u32; 2]> {
    let directed = || triangles.iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]);
    let all: HashSet<[u32; 2]> = directed().collect();
    let low = |[a, b]: &[u32; 2]| points[*a as usize].y < RIM && points[*b as usize].y < RIM;
    directed().filter(|[a, b]| !all.contains(&[*b, *a])).filter(low).collect()
}

impl Rig {
    /// Adds a vertex below another one. No expression moves it.
    fn add_below(&mut self, vertex: usize, down: f32, [wider, deeper]: [f32; 2]) -> u32 {
        let point = self.neutral[vertex];
        self.neutral.push(Vec3::new(point.x * wider, RIM.min(point.y) - down, point.z * deeper));
        self.skin_uv.push(self.skin_uv[vertex]);
        self.identities.iter_mut().for_each(|mode| mode.push(mode[vertex]));
        u32::try_from(self.neutral.len() - 1).unwrap_or(u32::MAX)
    }
}
