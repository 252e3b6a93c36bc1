//! Computes the colour of one sample: skin with hair, beard and clothes; mouth, eyes, and brows.

use glam::{Vec2, Vec3, Vec3A, Vec4Swizzles};

use super::{
    assets::Assets,
    geometry::smoothstep,
    person::Person,
    render::{Barycentric, Head},
    scene::Lighting,
    skin::Skin,
};

/// Colours in linear light.
const GUMS: Vec3A = Vec3A::new(0.32, 0.075, 0.07);
const TEETH: Vec3A = Vec3A::new(0.68, 0.61, 0.50);
/// Share of the light that a full beard absorbs.
const BEARD: Vec3A = Vec3A::new(0.75, 0.76, 0.74);
/// Distances inside the hairline at which hair begins and is full, in centimetres.
const HAIR_EDGE: [f32; 2] = [-0.9, 0.9];
/// Factor on the colour of eye textures.
const EYE: f32 = 0.75;
/// Colour of the lashes.
pub const LASHES: Vec3A = Vec3A::splat(0.004);
/// Exponent and strength of the specular highlight on eyes.
const GLINT: (f32, f32) = (400.0, 2.5);
/// Share of the light that the lids keep from the upper edge of the eyeball.
const LID_SHADE: f32 = 0.6;

/// Paints one picture of a person.
pub struct Painter<'a> {
    assets: &'a Assets,
    person: &'a Person,
    head: &'a Head,
    lighting: &'a Lighting,
    skin: &'a Skin,
}

impl<'a> Painter<'a> {
    /// Creates a painter for one picture.
    pub fn new(assets: &'a Assets, person: &'a Person, head: &'a Head, lighting: &'a Lighting) -> Self {
        Self { assets, person, head, lighting, skin: &assets.skins[person.looks.skin] }
    }

    /// Returns the colour of skin, hair or clothes.
    pub fn skin(&self, at: Barycentric) -> Vec3A {
        let looks = &self.person.looks;
        let diffuse = at.interpolate(|vertex| self.head.lit[vertex].diffuse);
        let cover = at.interpolate(|vertex| self.person.attributes[vertex].cover);
        let [hair, below_collar] = [cover.z, cover.w];
        if below_collar > 0.0 {
            return Vec3A::from(looks.cloth.0) * diffuse;
        }
        let gloss = at.interpolate(|vertex| self.head.lit[vertex].gloss) * looks.gloss;
        let tone = at.interpolate(|vertex| self.person.attributes[vertex].tone);
        let mut colour = Vec3A::from_vec4(tone);
        if tone.w > 0.0 {
            colour = colour.lerp(Vec3A::from(self.skin.texture.light(cover.xy()) * looks.tint), tone.w);
        }
        if looks.beard > 0.0 {
            colour *= Vec3A::ONE - BEARD * at.interpolate(|vertex| self.person.attributes[vertex].rest).w;
        }
        match looks.hair {
            Some((hair_colour, _)) if hair > HAIR_EDGE[0] => {
                let rest = at.interpolate(|vertex| self.person.attributes[vertex].rest).truncate();
                let (opacity, strand) = strands(rest, hair);
                let colour = colour.lerp(Vec3A::from(hair_colour) * (0.65 + 0.7 * strand), opacity);
                colour * diffuse + gloss * (1.0 - 0.8 * opacity)
            }
            _ => colour * diffuse + gloss,
        }
    }

    /// Returns the colour of gums, tongue and the inside of the mouth.
    pub fn gums(&self, at: Barycentric) -> Vec3A {
        GUMS * at.interpolate(|vertex| self.head.lit[vertex].diffuse)
            + at.interpolate(|vertex| self.head.lit[vertex].gloss)
    }

    /// Returns the colour of teeth.
    pub fn teeth(&self, at: Barycentric) -> Vec3A {
        TEETH * at.interpolate(|vertex| self.head.lit[vertex].diffuse)
            + 1.5 * at.interpolate(|vertex| self.head.lit[vertex].gloss)
    }

    /// Returns the colour of a wet eyeball in the shade of its lids.
    pub fn eye(&self, at: Barycentric) -> Vec3A {
        let offset = at.interpolate(|vertex| self.assets.ball_offsets[vertex]);
        let colour = EYE * self.assets.eyes[self.person.looks.eye].colour(offset.truncate(), self.person.looks.iris);
        let normal = at.interpolate(|vertex| self.head.normals[vertex]).normalize_or_zero();
        let point = at.interpolate(|vertex| self.head.points[vertex]);
        let view = -point.normalize_or_zero();
        let glint = self.lighting.lights.iter().map(|lamp| {
            let half = (lamp.toward + view).normalize_or_zero();
            lamp.colour * GLINT.1 * normal.dot(half).max(0.0).powf(GLINT.0)
        });
        let shade = 1.0 - LID_SHADE * smoothstep(-0.1, 0.6, normal.y);
        let diffuse = Vec3::from(at.interpolate(|vertex| self.head.lit[vertex].diffuse));
        Vec3A::from((colour * diffuse + glint.sum::<Vec3>()) * shade)
    }

    /// Returns the opacity of a brow and its colour.
    pub fn brow(&self, at: Barycentric) -> (f32, Vec3A) {
        let uv: Vec2 = at.interpolate(|vertex| self.person.brow_uv[vertex]);
        let (colour, opacity) = self.person.looks.brow_colour;
        let alpha = self.assets.brows[self.person.looks.brow].cover(uv) * opacity;
        (alpha, Vec3A::from(colour) * at.interpolate(|vertex| self.head.lit[vertex].diffuse))
    }
}

/// Returns the opacity of hair `depth` centimetres inside the hairline, and the brightness of the strand (0 to 1).
fn strands(rest: Vec3, depth: f32) -> (f32, f32) {
    let strand = noise(Vec3::new(rest.x * 9.0, rest.y * 1.4, rest.z * 1.4));
    (smoothstep(HAIR_EDGE[0] + 0.4, HAIR_EDGE[1], depth + 0.9 * (strand - 0.5)), strand)
}

/// Returns smooth noise over space, from 0 to 1, with one random value per unit cell.
fn noise(at_point: Vec3) -> f32 {
    let cell = at_point.floor();
    let offset = at_point - cell;
    let share = offset * offset * (3.0 - 2.0 * offset);
    let at = |dx: f32, dy: f32, dz: f32| hash(cell + Vec3::new(dx, dy, dz));
    let row = |dy: f32, dz: f32| lerp(at(0.0, dy, dz), at(1.0, dy, dz), share.x);
    let plane = |dz: f32| lerp(row(0.0, dz), row(1.0, dz), share.y);
    lerp(plane(0.0), plane(1.0), share.z)
}

fn lerp(from: f32, to: f32, share: f32) -> f32 {
    from + (to - from) * share
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "cells are small whole numbers; wraps")]
fn hash(cell: Vec3) -> f32 {
    let [x, y, z] = [cell.x, cell.y, cell.z].map(|value| value as i32 as u32);
    let mixed = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ z.wrapping_mul(0xC2B2_AE3D);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2C1B_3C6D);
    (mixed >> 8) as f32 / 16_777_216.0
}
