//! The colour of one sample: skin with hair, beard and clothes, mouth, eyes, brows.

use glam::{Vec2, Vec3, Vec3A, Vec4Swizzles};

use super::{
    geometry::smoothstep,
    kit::Kit,
    person::Person,
    render::{Corners, Head},
    scene::Lighting,
    skin::Skin,
};

/// Colours in linear light.
const GUMS: Vec3A = Vec3A::new(0.32, 0.075, 0.07);
const TEETH: Vec3A = Vec3A::new(0.68, 0.61, 0.50);
/// What a full beard takes of the light.
const BEARD: Vec3A = Vec3A::new(0.75, 0.76, 0.74);
/// Hair begins and is full this far inside the hairline, centimetres.
const HAIR_EDGE: [f32; 2] = [-0.9, 0.9];
/// Share of the light that eyes give back, over what their textures show.
const EYE: f32 = 0.75;
/// Lashes.
pub const LASHES: Vec3A = Vec3A::splat(0.004);
/// Exponent of the glint on eyes, and its strength.
const GLINT: (f32, f32) = (400.0, 2.5);
/// Light on an eye: the lids take this share at the upper edge of the ball.
const LID_SHADE: f32 = 0.6;

/// Knows a picture's person and light.
pub struct Painter<'a> {
    kit: &'a Kit,
    person: &'a Person,
    head: &'a Head,
    lighting: &'a Lighting,
    skin: &'a Skin,
}

impl<'a> Painter<'a> {
    /// For one picture.
    pub fn new(kit: &'a Kit, person: &'a Person, head: &'a Head, lighting: &'a Lighting) -> Self {
        Self { kit, person, head, lighting, skin: &kit.skins[person.looks.skin] }
    }

    /// Skin, or what covers it.
    pub fn skin(&self, at: Corners) -> Vec3A {
        let looks = &self.person.looks;
        let diffuse = at.mix(|vertex| self.head.lit[vertex].diffuse);
        let place = at.mix(|vertex| self.person.covers[vertex].place);
        let [hair, below_collar] = [place.z, place.w];
        if below_collar > 0.0 {
            return Vec3A::from(looks.cloth.0) * diffuse;
        }
        let gloss = at.mix(|vertex| self.head.lit[vertex].gloss) * looks.gloss;
        let tone = at.mix(|vertex| self.person.covers[vertex].tone);
        let mut colour = Vec3A::from_vec4(tone);
        if tone.w > 0.0 {
            colour = colour.lerp(Vec3A::from(self.skin.texture.light(place.xy()) * looks.tint), tone.w);
        }
        if looks.beard > 0.0 {
            colour *= Vec3A::ONE - BEARD * at.mix(|vertex| self.person.covers[vertex].rest).w;
        }
        match looks.hair {
            Some((hair_colour, _)) if hair > HAIR_EDGE[0] => {
                let rest = at.mix(|vertex| self.person.covers[vertex].rest).truncate();
                let (cover, strand) = strands(rest, hair);
                let colour = colour.lerp(Vec3A::from(hair_colour) * (0.65 + 0.7 * strand), cover);
                colour * diffuse + gloss * (1.0 - 0.8 * cover)
            }
            _ => colour * diffuse + gloss,
        }
    }

    /// Gums, tongue and the hollow of the mouth.
    pub fn gums(&self, at: Corners) -> Vec3A {
        GUMS * at.mix(|vertex| self.head.lit[vertex].diffuse) + at.mix(|vertex| self.head.lit[vertex].gloss)
    }

    /// Teeth.
    pub fn teeth(&self, at: Corners) -> Vec3A {
        TEETH * at.mix(|vertex| self.head.lit[vertex].diffuse) + 1.5 * at.mix(|vertex| self.head.lit[vertex].gloss)
    }

    /// An eyeball, wet, under its lids.
    pub fn eye(&self, at: Corners) -> Vec3A {
        let offset = at.mix(|vertex| self.kit.ball_offsets[vertex]);
        let colour = EYE * self.kit.eyes[self.person.looks.eye].colour(offset.truncate(), self.person.looks.iris);
        let normal = at.mix(|vertex| self.head.normals[vertex]).normalize_or_zero();
        let point = at.mix(|vertex| self.head.points[vertex]);
        let view = -point.normalize_or_zero();
        let glint = self.lighting.lights.iter().map(|lamp| {
            let half = (lamp.toward + view).normalize_or_zero();
            lamp.colour * GLINT.1 * normal.dot(half).max(0.0).powf(GLINT.0)
        });
        let shade = 1.0 - LID_SHADE * smoothstep(-0.1, 0.6, normal.y);
        let diffuse = Vec3::from(at.mix(|vertex| self.head.lit[vertex].diffuse));
        Vec3A::from((colour * diffuse + glint.sum::<Vec3>()) * shade)
    }

    /// How much a brow covers, and its colour.
    pub fn brow(&self, at: Corners) -> (f32, Vec3A) {
        let uv: Vec2 = at.mix(|vertex| self.person.brow_uv[vertex]);
        let (colour, opacity) = self.person.looks.brow_colour;
        let alpha = self.kit.brows[self.person.looks.brow].cover(uv) * opacity;
        (alpha, Vec3A::from(colour) * at.mix(|vertex| self.head.lit[vertex].diffuse))
    }
}

/// How much hair covers the skin `depth` centimetres inside the hairline, and how bright the strand there is (0 to 1).
fn strands(rest: Vec3, depth: f32) -> (f32, f32) {
    let strand = noise(Vec3::new(rest.x * 9.0, rest.y * 1.4, rest.z * 1.4));
    (smoothstep(HAIR_EDGE[0] + 0.4, HAIR_EDGE[1], depth + 0.9 * (strand - 0.5)), strand)
}

/// Smooth noise over space, 0 to 1, of period 1.
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
