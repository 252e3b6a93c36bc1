//! Brows: an alpha layer over the skin, laid by three points of each texture on three points of the face.
//!
//! A texture shows two brows, one above the other; the upper one is used for both sides.

use anyhow::{Context, Result};
use glam::{Mat3, Vec2, Vec3};

use super::{
    rig::{Rig, Triangle},
    texture::Texture,
};

/// Alpha from which a pixel counts.
const INK: u8 = 40;
/// Exponent on alpha: the textures are of single hairs, which camera pixels do not show.
const DENSER: f32 = 0.65;
/// Landmarks of the person's left brow: inner end, middle, outer end; and how far above them the brow lies, cm.
const ANCHORS: [(usize, f32); 3] = [(22, -0.1), (24, 0.15), (26, 0.0)];
/// Skin in front of this, and within this range of height above the anchors' mean, may carry a brow.
const FRONT: f32 = 4.0;
const REACH: f32 = 2.6;

/// One style.
pub struct Brow {
    texture: Texture,
    /// From `(|x|, y, 1)` of the head at rest to texture coordinates.
    lay: Mat3,
    /// Lowest v that belongs to the upper brow.
    floor: f32,
    /// Skin that it may cover.
    pub triangles: Vec<Triangle>,
}

impl Brow {
    /// Lays a texture on a rig.
    pub fn new(texture: Texture, rig: &Rig) -> Result<Self> {
        let [_, height] = texture.size();
        let floor_row = upper_rows(&texture).context("a brow texture does not show two brows")?;
        let anchors = ANCHORS.map(|(index, above)| rig.landmark(index) + above * Vec3::Y);
        let from = Mat3::from_cols_array_2d(&anchors.map(|anchor| [anchor.x.abs(), anchor.y, 1.0]));
        let ends = ends(&texture, floor_row).context("a brow texture is empty")?;
        let to = Mat3::from_cols_array_2d(&ends.map(|end| [end.x, end.y, 1.0]));
        let middle = anchors.iter().map(|anchor| anchor.y).sum::<f32>() / 3.0;
        let near = |vertex: &u32| {
            let point = rig.neutral[*vertex as usize];
            point.z > FRONT && (point.y - middle).abs() < REACH
        };
        let face = &rig.parts.skin[..rig.parts.face];
        let triangles = face.iter().filter(|triangle| triangle.iter().all(near)).copied().collect();
        Ok(Self { lay: to * from.inverse(), floor: 1.0 - floor_row as f32 / height as f32, texture, triangles })
    }

    /// Where a vertex of the head at rest lies in the texture.
    pub fn place(&self, rest: Vec3) -> Vec2 {
        (self.lay * Vec3::new(rest.x.abs(), rest.y, 1.0)).truncate()
    }

    /// How much of the skin is covered there, 0 to 1.
    pub fn cover(&self, uv: Vec2) -> f32 {
        let inside = uv.x > 0.0 && uv.x < 1.0 && uv.y > self.floor && uv.y < 1.0;
        if inside { (self.texture.sample(uv).w / 255.0).powf(DENSER) } else { 0.0 }
    }
}

/// The first empty row below the upper brow: in the gap between the two.
fn upper_rows(texture: &Texture) -> Option<usize> {
    let [width, height] = texture.size();
    let ink = |row: usize| (0..width).filter(|column| texture.pixel(*column, row)[3] > INK).count();
    let inked: Vec<bool> = (0..height).map(|row| ink(row) > 0).collect();
    let first = inked.iter().position(|inked| *inked)?;
    let last = inked.iter().rposition(|inked| *inked)?;
    // The widest gap; where brows overlap in height, the emptiest row near the middle.
    let middle = usize::midpoint(first, last);
    let reach = (last - first) / 6;
    (middle - reach..middle + reach).min_by_key(|row| (ink(*row), row.abs_diff(middle)))
}

/// Inner end, middle and outer end of the upper brow.
fn ends(texture: &Texture, floor_row: usize) -> Option<[Vec2; 3]> {
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
    Some([at(0.05)?, at(0.5)?, at(0.97)?])
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
fn fraction(count: usize, share: f32) -> usize {
    (count as f32 * share) as usize
}
