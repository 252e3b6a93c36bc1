//! Textures of the head.

use std::path::Path;

use anyhow::{Context, Result};
use glam::{Vec2, Vec3, Vec3A, Vec4};

use super::rig::{Rig, Triangle, smoothstep, vertices_of};

/// An image with 8 bits per channel. As in the rig, u runs right and v up, both from 0 to 1.
pub struct Texture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 4]>,
}

impl Texture {
    pub fn load(path: &Path) -> Result<Self> {
        let picture = image::open(path).with_context(|| format!("cannot read {}", path.display()))?.into_rgba8();
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        Ok(Self { width, height, pixels: picture.into_raw().as_chunks::<4>().0.to_vec() })
    }

    /// Returns the pixel at a column and a row from the top, clamped to the border.
    pub fn pixel(&self, column: usize, row: usize) -> [u8; 4] {
        self.pixels[row.min(self.height - 1) * self.width + column.min(self.width - 1)]
    }

    /// Samples the texture bilinearly, clamped to the border. Channels are 0 to 255 * 256, as stored (sRGB). Weights are
    /// integer 256ths, so that one multiplication blends two channels.
    #[inline]
    fn weighted(&self, uv: Vec2) -> Vec4 {
        let limit = Vec2::new(self.width as f32 - 1.0, self.height as f32 - 1.0);
        let position = Vec2::new(uv.x * self.width as f32, (1.0 - uv.y) * self.height as f32) - 0.5;
        let position = 256.0 * position.clamp(Vec2::ZERO, limit);
        let (x, y) = (position.x as usize, position.y as usize);
        let (column, row, right, down) = (x / 256, y / 256, x % 256, y % 256);
        let both = right * down / 256;
        let taps = [(0, 0, 256 + both - right - down), (1, 0, right - both), (0, 1, down - both), (1, 1, both)];
        let (mut red_blue, mut green_alpha) = (0, 0);
        for (dx, dy, weight) in taps {
            let pixel = u32::from_le_bytes(self.pixel(column + dx, row + dy)) as usize;
            red_blue += (pixel & 0x00FF_00FF) * weight;
            green_alpha += (pixel >> 8 & 0x00FF_00FF) * weight;
        }
        let channel = |value: usize| (value & 0xFFFF) as f32;
        Vec4::new(channel(red_blue), channel(green_alpha), channel(red_blue >> 16), channel(green_alpha >> 16))
    }

    #[inline]
    pub fn light(&self, uv: Vec2) -> Vec3A {
        linear(Vec3A::from_vec4(self.weighted(uv)) * (1.0 / (255.0 * 256.0)))
    }
}

/// Converts sRGB to linear light, both from 0 to 1. Approximates the power of 2.2 without `powf`, to within 0.01.
#[inline]
fn linear(colour: Vec3A) -> Vec3A {
    colour * colour * (Vec3A::splat(0.8) + 0.2 * colour)
}

/// Centre of the eye and radius of the iris in the texture.
const CENTRE: Vec2 = Vec2::new(0.288, 1.0 - 0.708);
const IRIS: f32 = 0.115;

/// Where the dark ring around an iris begins, relative to the radius of the iris, and how much light it takes.
const RING: (f32, f32) = (0.75, 0.6);

/// Returns the colour of an eye at an offset from the centre of the ball. The offset and the radius `iris` are relative to
/// the radius of the ball; `lightness` is that of the iris relative to the texture's.
pub fn eye_colour(texture: &Texture, offset: Vec2, [iris, lightness]: [f32; 2]) -> Vec3 {
    let colour = Vec3::from(texture.light(CENTRE + offset * (IRIS / iris)));
    let radius = offset.length() / iris;
    let iris_light = lightness * (1.0 - RING.1 * smoothstep(RING.0, 1.0, radius));
    let white = smoothstep(0.97, 1.05, radius);
    colour * (iris_light + white * (1.0 - iris_light))
}

/// Returns the offset of every eyeball vertex from its ball's centre, relative to the ball's radius, for eyes that look
/// ahead. The offset of all other vertices is 0.
pub fn ball_offsets(rig: &Rig) -> Vec<Vec3> {
    let mut offsets = vec![Vec3::ZERO; rig.neutral.len()];
    for eye in &rig.parts.eyes {
        let vertices = vertices_of(eye);
        let point = |vertex: &u32| rig.neutral[*vertex as usize];
        let least = vertices.iter().map(point).fold(Vec3::INFINITY, Vec3::min);
        let most = vertices.iter().map(point).fold(Vec3::NEG_INFINITY, Vec3::max);
        let (centre, radius) = ((least + most) / 2.0, (most.x - least.x) / 2.0);
        for vertex in &vertices {
            offsets[*vertex as usize] = (point(vertex) - centre) / radius;
        }
    }
    offsets
}

// Brows: a translucent texture over the skin, aligned with the two ends of the face's brow.
//
// A texture contains two brows, one above the other. The upper one is used for both sides.

const INK: u8 = 40;
/// Exponent on alpha, which makes brows denser: the textures show hairs smaller than the camera's pixels.
const DENSER: f32 = 0.35;
/// Landmarks at the inner and outer end of the person's left brow, and the height of its centre line above them in cm.
const ANCHORS: [(usize, f32); 2] = [(22, 0.05), (26, 0.05)];
/// A brow can cover skin in front of this depth, within this distance above and below the anchors, in cm.
const FRONT: f32 = 4.0;
const REACH: f32 = 2.6;

pub struct Brow {
    texture: Texture,
    opacity: Vec<f32>,
    /// Inner and outer end on the head at rest, and in the texture.
    on_face: [Vec2; 2],
    in_texture: [Vec2; 2],
    /// Lowest v coordinate that belongs to the upper brow.
    floor: f32,
    pub triangles: Vec<Triangle>,
}

impl Brow {
    pub fn new(texture: Texture, rig: &Rig) -> Result<Self> {
        let floor_row = upper_rows(&texture).context("a brow texture does not show two brows")?;
        let on_face = ANCHORS.map(|(index, above)| {
            let point = rig.landmark(index);
            Vec2::new(point.x.abs(), point.y + above)
        });
        let in_texture = ends(&texture, floor_row).context("a brow texture is empty")?;
        let middle = f32::midpoint(on_face[0].y, on_face[1].y);
        let near = |vertex: &u32| {
            let point = rig.neutral[*vertex as usize];
            point.z > FRONT && (point.y - middle).abs() < REACH
        };
        let face = &rig.parts.skin[..rig.parts.face];
        let triangles = face.iter().filter(|triangle| triangle.iter().all(near)).copied().collect();
        let opacity = (0..=u8::MAX).map(|alpha| (f32::from(alpha) / 255.0).powf(DENSER)).collect();
        Ok(Self {
            opacity,
            on_face,
            in_texture,
            floor: 1.0 - floor_row as f32 / texture.height as f32,
            texture,
            triangles,
        })
    }

    /// Returns the position of a vertex along the brow: 0 at the inner end, 1 at the outer end.
    pub fn along(&self, rest: Vec3) -> f32 {
        let [inner, outer] = self.on_face;
        (rest.x.abs() - inner.x) / (outer.x - inner.x)
    }

    pub fn uv(&self, rest: Vec3) -> Vec2 {
        let ([inner, outer], [from, to]) = (self.on_face, self.in_texture);
        let along = self.along(rest);
        let scale = (to.x - from.x) / (outer.x - inner.x);
        from.lerp(to, along) + Vec2::new(0.0, scale * (rest.y - inner.lerp(outer, along).y))
    }

    pub fn cover(&self, uv: Vec2) -> f32 {
        let inside = uv.x > 0.0 && uv.x < 1.0 && uv.y > self.floor && uv.y < 1.0;
        if inside { self.opacity[(self.texture.weighted(uv).w / 256.0 + 0.5) as usize] } else { 0.0 }
    }

    /// Returns whether a triangle with these texture coordinates may show a part of the brow.
    pub fn touches(&self, corners: [Vec2; 3]) -> bool {
        let [a, b, c] = corners;
        let (least, most) = (a.min(b).min(c), a.max(b).max(c));
        least.x < 1.0 && least.y < 1.0 && most.x > 0.0 && most.y > self.floor
    }
}

/// Returns a row between the upper and the lower brow.
fn upper_rows(texture: &Texture) -> Option<usize> {
    let Texture { width, height, .. } = *texture;
    let ink = |row: usize| (0..width).filter(|column| texture.pixel(*column, row)[3] > INK).count();
    let inked: Vec<bool> = (0..height).map(|row| ink(row) > 0).collect();
    let first = inked.iter().position(|inked| *inked)?;
    let last = inked.iter().rposition(|inked| *inked)?;
    // Where the brows overlap in height, no row is empty, so the emptiest row near the middle is used.
    let middle = usize::midpoint(first, last);
    let reach = (last - first) / 6;
    (middle - reach..middle + reach).min_by_key(|row| (ink(*row), row.abs_diff(middle)))
}

/// Returns inner and outer end of the upper brow.
fn ends(texture: &Texture, floor_row: usize) -> Option<[Vec2; 2]> {
    let Texture { width, height, .. } = *texture;
    let rows_of =
        |column: usize| -> Vec<usize> { (0..floor_row).filter(|row| texture.pixel(column, *row)[3] > INK).collect() };
    let columns: Vec<usize> = (0..width).filter(|column| !rows_of(*column).is_empty()).collect();
    let at = |share: f32| {
        let column = *columns.get((columns.len() as f32 * share) as usize)?;
        let rows = rows_of(column);
        let row = rows.iter().sum::<usize>() as f32 / rows.len().max(1) as f32;
        Some(Vec2::new(column as f32 / width as f32, 1.0 - row / height as f32))
    };
    Some([at(0.05)?, at(0.97)?])
}

// Skin: a texture on the face, and a smooth tone where the texture does not fit.
//
// The textures were made for another head. On scalp, neck and shoulders, and at the texture's own seams, they do not
// fit. There, vertices have a tone that is diffused from the face over the mesh. Texture and tone are blended.

/// Number of vertex rings over which texture and tone are blended.
const BLEND_RINGS: u8 = 8;
/// A triangle with a larger extent in texture coordinates spans a seam of the texture.
const SEAM: f32 = 0.04;
/// Limits of the texture in centimetres: lowest y, least z, and least z on the scalp.
const NECK: f32 = -8.5;
const BESIDE: f32 = 4.6;
const BEHIND: f32 = 7.5;
const SWEEPS: usize = 120;

pub struct Layout {
    pub share: Vec<f32>,
    neighbours: Vec<Vec<u32>>,
}

pub struct Skin {
    pub texture: Texture,
    /// Linear colour of each vertex where the texture does not fit.
    pub tone: Vec<Vec3>,
    /// Mean green of the face in linear light.
    pub lightness: f32,
}

impl Layout {
    pub fn new(rig: &Rig) -> Self {
        let neighbours = neighbours(rig);
        let mut rings: Vec<u8> = vec![BLEND_RINGS; rig.neutral.len()];
        for (index, triangle) in rig.parts.skin.iter().enumerate() {
            let back = index >= rig.parts.face;
            let [a, b, c] = triangle.map(|vertex| rig.skin_uv[vertex as usize]);
            let seam = [(a, b), (b, c), (c, a)].iter().any(|(from, to)| (*from - *to).abs().max_element() > SEAM);
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
