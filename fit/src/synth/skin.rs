//! Skin: a texture on the face, and a smooth tone where the texture does not fit.
//!
//! The textures were made for another head. On scalp, neck and shoulders, and at the texture's own seams, they do not
//! fit. There, vertices have a tone that is diffused from the face over the mesh. Texture and tone are blended.

use glam::Vec3;

use super::{geometry::smoothstep, rig::Rig, texture::Texture};

/// Number of vertex rings over which texture and tone are blended.
const BLEND_RINGS: u8 = 8;
/// A triangle with a larger extent in texture coordinates spans a seam of the texture.
const SEAM: f32 = 0.04;
/// Limits of the texture in centimetres: lowest y, least z, and least z on the scalp.
const NECK: f32 = -8.5;
const BESIDE: f32 = 4.6;
const BEHIND: f32 = 7.5;
/// Number of diffusion steps of the tone.
const SWEEPS: usize = 120;

/// The part of a rig that the skin textures cover, which is the same for all skins.
pub struct Layout {
    /// Weight of the texture against the tone, for each vertex.
    pub share: Vec<f32>,
    /// Neighbours of each vertex in the skin.
    neighbours: Vec<Vec<u32>>,
}

/// A skin.
pub struct Skin {
    /// The texture.
    pub texture: Texture,
    /// Linear colour of each vertex where the texture does not fit.
    pub tone: Vec<Vec3>,
    /// Mean green of the face in linear light.
    pub lightness: f32,
}

impl Layout {
    /// Finds the part of a rig that the textures fit.
    pub fn new(rig: &Rig) -> Self {
        let neighbours = neighbours(rig);
        let mut rings: Vec<u8> = vec![BLEND_RINGS; rig.neutral.len()];
        for (index, triangle) in rig.parts.skin.iter().enumerate() {
            let back = index >= rig.parts.face;
            let seam = spans_seam(rig, triangle.map(|vertex| vertex as usize));
            for vertex in triangle.map(|vertex| vertex as usize) {
                let point = rig.neutral[vertex];
                if seam || point.y < NECK || point.z < BESIDE || (back && point.z < BEHIND) {
                    rings[vertex] = 0;
                }
            }
        }
        spread_rings(&mut rings, &neighbours);
        let share = |ring: &u8| smoothstep(0.5, f32::from(BLEND_RINGS), f32::from(*ring));
        Self { share: rings.iter().map(share).collect(), neighbours }
    }
}

fn neighbours(rig: &Rig) -> Vec<Vec<u32>> {
    let mut lists = vec![Vec::new(); rig.neutral.len()];
    for [a, b, c] in &rig.parts.skin {
        for (from, to) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
            lists[*from as usize].push(*to);
        }
    }
    for list in &mut lists {
        list.sort_unstable();
        list.dedup();
    }
    lists
}

fn spans_seam(rig: &Rig, vertices: [usize; 3]) -> bool {
    let [a, b, c] = vertices.map(|vertex| rig.skin_uv[vertex]);
    [(a, b), (b, c), (c, a)].iter().any(|(from, to)| (*from - *to).abs().max_element() > SEAM)
}

/// Sets each vertex to its distance in rings from the nearest vertex at 0, at most [`BLEND_RINGS`].
fn spread_rings(rings: &mut [u8], neighbours: &[Vec<u32>]) {
    for ring in 0..BLEND_RINGS {
        for vertex in 0..rings.len() {
            if rings[vertex] == ring {
                for next in &neighbours[vertex] {
                    let slot = &mut rings[*next as usize];
                    *slot = (*slot).min(ring + 1);
                }
            }
        }
    }
}

impl Skin {
    /// Diffuses the tone of the face over the rest of the head.
    pub fn new(texture: Texture, rig: &Rig, layout: &Layout) -> Self {
        let seen: Vec<Vec3> = rig.skin_uv.iter().map(|uv| texture.light(*uv).into()).collect();
        let sure = |vertex: &usize| layout.share[*vertex] >= 1.0 && !layout.neighbours[*vertex].is_empty();
        let known: Vec<usize> = (0..seen.len()).filter(sure).collect();
        let mean = known.iter().map(|vertex| seen[*vertex]).sum::<Vec3>() / known.len().max(1) as f32;
        let mut tone = vec![mean; seen.len()];
        for vertex in &known {
            tone[*vertex] = seen[*vertex];
        }
        let open: Vec<usize> = (0..seen.len()).filter(|vertex| layout.share[*vertex] < 1.0).collect();
        for _ in 0..SWEEPS {
            for vertex in &open {
                let around = &layout.neighbours[*vertex];
                let sum: Vec3 = around.iter().map(|next| tone[*next as usize]).sum();
                if !around.is_empty() {
                    tone[*vertex] = sum / around.len() as f32;
                }
            }
        }
        Self { texture, tone, lightness: mean.y }
    }
}
