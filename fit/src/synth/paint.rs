//! Computes the colour of one sample: skin with hair, beard and clothes; mouth, eyes, and brows.

use std::sync::LazyLock;

use glam::{Vec2, Vec3, Vec3A, Vec4Swizzles};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::assets::Assets;
use super::canvas::{Barycentric, Corners};
use super::person::{Cover, HAIR_EDGE, Person};
use super::rig::smoothstep;
use super::shade::{Lighting, VertexLight};
use super::textures::{Skin, Texture, eye_colour};

/// Colours in linear light.
pub const GUMS: Vec3A = Vec3A::new(0.32, 0.075, 0.07);
pub const TEETH: Vec3A = Vec3A::new(0.68, 0.61, 0.50);
/// Share of the light that a full beard absorbs.
const BEARD: Vec3A = Vec3A::new(0.75, 0.76, 0.74);
/// Factor on the specular highlight of hair, compared to skin's.
const HAIR_GLOSS: f32 = 0.2;
const EYE: f32 = 0.75;
pub const LASHES: Vec3A = Vec3A::splat(0.004);
/// Exponent and strength of the specular highlight on eyes.
const GLINT: (i32, f32) = (400, 2.5);
/// Share of the light that the lids keep from the upper edge of the eyeball.
const LID_SHADE: f32 = 0.6;

pub struct Painter<'a> {
    assets: &'a Assets,
    person: &'a Person,
    points: &'a [Vec3],
    normals: &'a [Vec3],
    lit: &'a [VertexLight],
    lighting: &'a Lighting,
    skin: &'a Skin,
    tint: Vec3A,
}

pub enum SkinPaint<'a> {
    /// The same material everywhere, so that the colours of the corners are interpolated.
    Plain(Corners<Vec3A>),
    Textured {
        texture: &'a Texture,
        uv: Corners<Vec2>,
        diffuse: Corners<Vec3A>,
        gloss: Corners<Vec3A>,
    },
    Hair {
        colour: Vec3A,
        rest: Corners<Vec3>,
        diffuse: Corners<Vec3A>,
        gloss: Corners<Vec3A>,
    },
    Mixed {
        painter: &'a Painter<'a>,
        vertices: [usize; 3],
    },
}

impl SkinPaint<'_> {
    #[inline]
    pub fn colour(&self, weights: Vec3) -> Vec3A {
        match self {
            Self::Plain(colours) => colours.at(weights),
            Self::Textured { texture, uv, diffuse, gloss } => {
                texture.light(uv.at(weights)) * diffuse.at(weights) + gloss.at(weights)
            }
            Self::Hair { colour, rest, diffuse, gloss } => {
                *colour * strand_light(strand(rest.at(weights))) * diffuse.at(weights) + gloss.at(weights)
            }
            Self::Mixed { painter, vertices } => painter.mixed_skin(Barycentric { vertices: *vertices, weights }),
        }
    }
}

impl<'a> Painter<'a> {
    pub fn new(
        assets: &'a Assets,
        person: &'a Person,
        (points, normals, lit): (&'a [Vec3], &'a [Vec3], &'a [VertexLight]),
        lighting: &'a Lighting,
    ) -> Self {
        let (skin, tint) = (&assets.skins[person.looks.skin], person.looks.tint.into());
        Self { assets, person, points, normals, lit, lighting, skin, tint }
    }

    #[inline]
    pub fn skin(&self, cover: Cover, vertices: [usize; 3]) -> SkinPaint<'_> {
        let (looks, lit) = (&self.person.looks, |vertex: usize| &self.lit[vertex]);
        let attributes = |vertex: usize| &self.person.attributes[vertex];
        match cover {
            Cover::Cloth => {
                let cloth = Vec3A::from(looks.cloth.0);
                SkinPaint::Plain(Corners(vertices.map(|vertex| cloth * lit(vertex).diffuse)))
            }
            Cover::Tone => SkinPaint::Plain(Corners(vertices.map(|vertex| {
                let tone = Vec3A::from_vec4(attributes(vertex).tone);
                tone * lit(vertex).diffuse + looks.gloss * lit(vertex).gloss
            }))),
            Cover::Texture => SkinPaint::Textured {
                texture: &self.skin.texture,
                uv: Corners(vertices.map(|vertex| attributes(vertex).cover.xy())),
                diffuse: Corners(vertices.map(|vertex| self.tint * lit(vertex).diffuse)),
                gloss: Corners(vertices.map(|vertex| looks.gloss * lit(vertex).gloss)),
            },
            Cover::Hair => SkinPaint::Hair {
                colour: Vec3A::from(looks.hair.map_or(Vec3::ZERO, |(colour, _)| colour)),
                rest: Corners(vertices.map(|vertex| attributes(vertex).rest.truncate())),
                diffuse: Corners(vertices.map(|vertex| lit(vertex).diffuse)),
                gloss: Corners(vertices.map(|vertex| HAIR_GLOSS * looks.gloss * lit(vertex).gloss)),
            },
            Cover::Mixed => SkinPaint::Mixed { painter: self, vertices },
        }
    }

    fn mixed_skin(&self, at: Barycentric) -> Vec3A {
        let looks = &self.person.looks;
        let diffuse = at.interpolate(|vertex| self.lit[vertex].diffuse);
        let cover = at.interpolate(|vertex| self.person.attributes[vertex].cover);
        let [hair, below_collar] = [cover.z, cover.w];
        if below_collar > 0.0 {
            return Vec3A::from(looks.cloth.0) * diffuse;
        }
        let gloss = at.interpolate(|vertex| self.lit[vertex].gloss) * looks.gloss;
        let tone = at.interpolate(|vertex| self.person.attributes[vertex].tone);
        let mut colour = Vec3A::from_vec4(tone);
        if tone.w > 0.0 {
            colour = colour.lerp(self.skin.texture.light(cover.xy()) * self.tint, tone.w);
        }
        let rest = at.interpolate(|vertex| self.person.attributes[vertex].rest);
        if rest.w > 0.0 {
            colour *= Vec3A::ONE - BEARD * (rest.w * strand_light(strand(rest.truncate()))).min(1.0);
        }
        match looks.hair {
            Some((hair_colour, _)) if hair > HAIR_EDGE[0] => {
                let strand = strand(rest.truncate());
                let opacity = smoothstep(HAIR_EDGE[0] + 0.4, HAIR_EDGE[1], hair + 0.9 * (strand - 0.5));
                let colour = colour.lerp(Vec3A::from(hair_colour) * strand_light(strand), opacity);
                colour * diffuse + gloss * (1.0 - (1.0 - HAIR_GLOSS) * opacity)
            }
            _ => colour * diffuse + gloss,
        }
    }

    pub fn eye(&self, at: Barycentric) -> Vec3A {
        let offset = at.interpolate(|vertex| self.assets.ball_offsets[vertex]);
        let looks = &self.person.looks;
        let colour = EYE
            * eye_colour(&self.assets.eyes[looks.eye], offset.truncate(), [looks.iris_radius, looks.iris_lightness]);
        let normal = at.interpolate(|vertex| self.normals[vertex]).normalize_or_zero();
        let point = at.interpolate(|vertex| self.points[vertex]);
        let view = -point.normalize_or_zero();
        let glint = self.lighting.lights.iter().map(|lamp| {
            let half = (lamp.toward + view).normalize_or_zero();
            lamp.colour * GLINT.1 * normal.dot(half).max(0.0).powi(GLINT.0)
        });
        let shade = 1.0 - LID_SHADE * smoothstep(-0.1, 0.6, normal.y);
        let diffuse = Vec3::from(at.interpolate(|vertex| self.lit[vertex].diffuse));
        Vec3A::from((colour * diffuse + glint.sum::<Vec3>()) * shade)
    }

    pub fn brow(&self, at: Barycentric) -> (f32, Vec3A) {
        let uv: Vec2 = at.interpolate(|vertex| self.person.brow_uv[vertex]);
        let (colour, opacity) = self.person.looks.brow_colour;
        let alpha = self.assets.brows[self.person.looks.brow].cover(uv) * opacity;
        (alpha, Vec3A::from(colour) * at.interpolate(|vertex| self.lit[vertex].diffuse))
    }
}

fn strand(rest: Vec3) -> f32 {
    noise(Vec3::new(rest.x * 9.0, rest.y * 1.4, rest.z * 1.4))
}

fn strand_light(strand: f32) -> f32 {
    0.65 + 0.7 * strand
}

/// Cells of the noise along x, y and z, after which it repeats: 7 centimetres of hair.
const CELLS: [usize; 3] = [64, 8, 8];
const ORIGIN: f32 = 1024.0;
static NOISE: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    (0..CELLS.iter().product()).map(|_| rng.random()).collect()
});

fn noise(at_point: Vec3) -> f32 {
    // Whole numbers are rounded down, because no point lies below -ORIGIN.
    let at_point = at_point + ORIGIN;
    let cell = at_point.as_uvec3();
    let offset = at_point - cell.as_vec3();
    let share = offset * offset * (3.0 - 2.0 * offset);
    let wrapped = |cell: u32, cells: usize| [cell as usize % cells, (cell as usize + 1) % cells];
    let [x, y, z] = [wrapped(cell.x, CELLS[0]), wrapped(cell.y, CELLS[1]), wrapped(cell.z, CELLS[2])];
    let lerp = |[from, to]: [f32; 2], share: f32| from + (to - from) * share;
    let row = |y: usize, z: usize| {
        let row = &NOISE[(z * CELLS[1] + y) * CELLS[0]..][..CELLS[0]];
        lerp(x.map(|x| row[x]), share.x)
    };
    let plane = |z: usize| lerp(y.map(|y| row(y, z)), share.y);
    lerp(z.map(plane), share.z)
}
