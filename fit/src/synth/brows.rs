//! Brows: a translucent texture over the skin, aligned with the two ends of the face's brow.
//!
//! A texture contains two brows, one above the other. The upper one is used for both sides.

use anyhow::{Context, Result};
use glam::{Vec2, Vec3, Vec4};

use super::{
    rig::{Rig, Triangle},
    texture::Texture,
};

/// Alpha above which a pixel belongs to a brow.
const INK: u8 = 40;
/// Exponent on alpha. Values below 1 make brows denser, because the textures show single hairs, which are smaller than
/// the camera's pixels.
const DENSER: f32 = 0.35;
/// Landmarks at the inner and outer end of the person's left brow, and the height of its centre line above them in cm.
const ANCHORS: [(usize, f32); 2] = [(22, 0.05), (26, 0.05)];
/// A brow can cover skin in front of this depth, within this distance above and below the anchors, in cm.
const FRONT: f32 = 4.0;
const REACH: f32 = 2.6;

/// One style of brows.
pub struct Brow {
    texture: Texture,
    /// Opacity for each alpha of the texture.
    opacity: Vec<f32>,
    /// Inner and outer end on the head at rest, and in the texture.
    on_face: [Vec2; 2],
    in_texture: [Vec2; 2],
    /// Lowest v coordinate that belongs to the upper brow.
    floor: f32,
    /// Skin that the brow can cover.
    pub triangles: Vec<Triangle>,
}

impl Brow {
    /// Aligns a texture with a rig.
    pub fn new(texture: Texture, rig: &Rig) -> Result<Self> {
        let [_, height] = texture.size();
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
        Ok(Self { opacity, on_face, in_texture, floor: 1.0 - floor_row as f32 / height as f32, texture, triangles })
    }

    /// Returns the position of a vertex along the brow: 0 at the inner end, 1 at the outer end.
    pub fn along(&self, rest: Vec3) -> f32 {
        let [inner, outer] = self.on_face;
        (rest.x.abs() - inner.x) / (outer.x - inner.x)
    }

    /// Returns the texture coordinates of a vertex of the head at rest.
    pub fn uv(&self, rest: Vec3) -> Vec2 {
        let ([inner, outer], [from, to]) = (self.on_face, self.in_texture);
        let along = self.along(rest);
        let scale = (to.x - from.x) / (outer.x - inner.x);
        from.lerp(to, along) + Vec2::new(0.0, scale * (rest.y - inner.lerp(outer, along).y))
    }

    /// Returns the opacity of the brow at a texture coordinate, from 0 to 1.
    pub fn cover(&self, uv: Vec2) -> f32 {
        let inside = uv.x > 0.0 && uv.x < 1.0 && uv.y > self.floor && uv.y < 1.0;
        if inside { self.opacity[alpha_of(self.texture.sample(uv))] } else { 0.0 }
    }

    /// Returns whether a triangle with these texture coordinates may show a part of the brow.
    pub fn touches(&self, corners: [Vec2; 3]) -> bool {
        let [a, b, c] = corners;
        let (least, most) = (a.min(b).min(c), a.max(b).max(c));
        least.x < 1.0 && least.y < 1.0 && most.x > 0.0 && most.y > self.floor
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 255")]
fn alpha_of(sample: Vec4) -> usize {
    (sample.w + 0.5) as usize
}

/// Returns a row between the upper and the lower brow.
fn upper_rows(texture: &Texture) -> Option<usize> {
    let [width, height] = texture.size();
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
    let [width, height] = texture.size();
    let rows_of =
        |column: usize| -> Vec<usize> { (0..floor_row).filter(|row| texture.pixel(column, *row)[3] > INK).collect() };
    let columns: Vec<usize> = (0..width).filter(|column| !rows_of(*column).is_empty()).collect();
    let at = |share: f32| {
        let column = *columns.get(fraction(columns.len(), share))?;
        let rows = rows_of(column);
        let row = rows.iter().sum::<usize>() as f32 / rows.len().max(1) as f32;
        Some(Vec2::new(column as f32 / width as f32, 1.0 - row / height as f32))
    };
    Some([at(0.05)?, at(0.97)?])
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
fn fraction(count: usize, share: f32) -> usize {
    (count as f32 * share) as usize
}
