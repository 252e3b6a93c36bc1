//! A person: the shape and the looks of the head, which are the same in all of the person's pictures.

use glam::{Vec2, Vec3, Vec4};
use rand::RngExt;
use rand::seq::IteratorRandom;
use rand_chacha::ChaCha8Rng;

use super::assets::{Assets, TextureChoice};
use super::rig::{Triangle, normal, piecewise, smoothstep};

/// Height of the hairline at depths z, in centimetres: nape, behind the ear, above the ear, temple, forehead.
const HAIRLINE: [(f32, f32); 7] =
    [(-6.0, -7.0), (-3.0, -5.0), (-1.5, 1.0), (0.5, 5.4), (3.0, 6.4), (6.0, 9.6), (9.0, 11.4)];
const EAR: (f32, f32) = (7.65, 5.6);
/// Distances inside the hairline at which hair begins and is full, in centimetres.
pub const HAIR_EDGE: [f32; 2] = [-0.9, 0.9];
/// Distance inside the hairline from which no skin is visible, in centimetres.
const FULL_HAIR: f32 = HAIR_EDGE[1] + 0.45;
/// The beard grows at these distances from the mouth, in centimetres.
const BEARD_REACH: [f32; 2] = [1.0, 5.0];

#[derive(Debug, Clone)]
pub struct Looks {
    pub skin: usize,
    pub brow: usize,
    pub eye: usize,
    pub tint: Vec3,
    /// Strength of the skin's specular highlight, about 1.
    pub gloss: f32,
    /// Colour of the hair and its thickness in centimetres, or `None` for a bald head.
    pub hair: Option<(Vec3, f32)>,
    /// Offset of the hairline in centimetres, positive upwards.
    pub hairline: f32,
    pub beard: f32,
    pub beard_style: BeardStyle,
    /// Depth of the wrinkles that come with an expression, from 0 to 1.
    pub wrinkles: f32,
    pub brow_colour: (Vec3, f32),
    /// Offset of the brows' inner and outer end in centimetres, positive upwards.
    pub brow_lift: [f32; 2],
    pub brow_thickness: f32,
    /// Radius of the iris relative to the eyeball's, and its lightness relative to the texture's.
    pub iris_radius: f32,
    pub iris_lightness: f32,
    pub lashes: f32,
    /// Colour of the clothes and height of their collar in centimetres.
    pub cloth: (Vec3, f32),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BeardStyle {
    Full,
    Moustache,
    Goatee,
    Stubble,
}

impl BeardStyle {
    pub fn random(rng: &mut ChaCha8Rng) -> Self {
        match rng.random_range(0..10) {
            0..5 => Self::Full,
            5..7 => Self::Moustache,
            7 => Self::Goatee,
            _ => Self::Stubble,
        }
    }

    /// Returns the density at a point of the head at rest, relative to a full beard.
    fn share(self, point: Vec3, mouth: Vec3) -> f32 {
        let offset = (point - mouth).truncate();
        let beside = smoothstep(3.4, 2.6, offset.x.abs());
        match self {
            Self::Full => 1.0,
            Self::Moustache => beside * smoothstep(-0.3, 0.3, offset.y),
            Self::Goatee => beside,
            Self::Stubble => 0.4,
        }
    }
}

pub struct Person {
    pub base: Vec<Vec3>,
    pub looks: Looks,
    pub attributes: Vec<VertexAttributes>,
    pub covers: Vec<Cover>,
    pub brow_uv: Vec<Vec2>,
    pub brow_triangles: Vec<Triangle>,
}

/// What covers a triangle of the skin. Triangles of one material are painted faster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cover {
    Cloth,
    /// Bare skin without the texture.
    Tone,
    Texture,
    Hair,
    Mixed,
}

#[derive(Debug, Clone, Copy)]
pub struct VertexAttributes {
    /// Tone in linear light, and weight of the texture against the tone.
    pub tone: Vec4,
    /// Texture coordinates, distance inside the hairline (negative on bare skin) and below the collar in centimetres.
    pub cover: Vec4,
    pub rest: Vec4,
}

impl Person {
    pub fn new(assets: &Assets, identity: &[f32], looks: Looks) -> Self {
        let rest = &assets.rig.neutral;
        let hair: Vec<f32> = rest.iter().map(|point| hair_at(*point, looks.hairline)).collect();
        let mut base = rest.clone();
        for (weight, mode) in identity.iter().zip(&assets.rig.identities) {
            base.iter_mut().zip(mode).for_each(|(point, offset)| *point += *weight * *offset);
        }
        if let Some((_, volume)) = looks.hair {
            for (point, (depth, normal)) in base.iter_mut().zip(hair.iter().zip(&assets.rest_normals)) {
                *point += *normal * volume * smoothstep(0.0, 1.6, *depth);
            }
        }
        let brow = &assets.brows[looks.brow];
        let middle = assets.rig.landmark(24).y;
        let brow_at = |point: &Vec3| {
            let [inner, outer] = looks.brow_lift;
            let lift = inner + (outer - inner) * brow.along(*point);
            let y = middle + (point.y - middle - lift) / looks.brow_thickness;
            brow.uv(Vec3::new(point.x, y, point.z))
        };
        let mouth = (assets.rig.landmark(48) + assets.rig.landmark(54)) / 2.0;
        let skin = &assets.skins[looks.skin];
        let attributes = |vertex: usize| {
            let (point, uv) = (rest[vertex], assets.rig.skin_uv[vertex]);
            // The distance below the collar, which is lower in front than at the sides.
            let collar = looks.cloth.1 + 0.06 * point.x * point.x - 0.12 * point.z.max(0.0) - point.y;
            VertexAttributes {
                tone: (skin.tone[vertex] * looks.tint).extend(assets.layout.share[vertex]),
                cover: Vec4::new(uv.x, uv.y, hair[vertex], collar),
                rest: point.extend(looks.beard * looks.beard_style.share(point, mouth) * beard_at(point, mouth)),
            }
        };
        let attributes: Vec<VertexAttributes> = (0..rest.len()).map(attributes).collect();
        let brow_uv: Vec<Vec2> = rest.iter().map(brow_at).collect();
        let cover = |triangle: &Triangle| Cover::of(triangle.map(|vertex| &attributes[vertex as usize]), &looks);
        let touched = |triangle: &&Triangle| brow.touches(triangle.map(|vertex| brow_uv[vertex as usize]));
        Self {
            covers: assets.rig.parts.skin.iter().map(cover).collect(),
            brow_triangles: brow.triangles.iter().filter(touched).copied().collect(),
            attributes,
            brow_uv,
            base,
            looks,
        }
    }
}

impl Cover {
    fn of(corners: [&VertexAttributes; 3], looks: &Looks) -> Self {
        let all = |is: fn(&VertexAttributes) -> bool| corners.iter().all(|corner| is(corner));
        let bald = looks.hair.is_none() || all(|corner| corner.cover.z <= HAIR_EDGE[0]);
        if all(|corner| corner.cover.w > 0.0) {
            Self::Cloth
        } else if looks.hair.is_some() && all(|corner| corner.cover.z >= FULL_HAIR && corner.cover.w <= 0.0) {
            Self::Hair
        } else if !bald || !all(|corner| corner.cover.w <= 0.0 && corner.rest.w <= 0.0) {
            Self::Mixed
        } else if all(|corner| corner.tone.w >= 1.0) {
            Self::Texture
        } else if all(|corner| corner.tone.w <= 0.0) {
            Self::Tone
        } else {
            Self::Mixed
        }
    }
}

fn hair_at(point: Vec3, hairline: f32) -> f32 {
    let ear = point.x.abs() > EAR.0 && point.y < EAR.1;
    if ear { -1.0 } else { point.y - piecewise(&HAIRLINE, point.z) - hairline * smoothstep(0.0, 6.0, point.z) }
}

/// Returns the density of a beard, which grows around the mouth and along the jaw, but not on the lips.
fn beard_at(point: Vec3, mouth: Vec3) -> f32 {
    let from_mouth = ((point.x - mouth.x) / 1.5).hypot(point.y - mouth.y);
    let low = 1.0 - smoothstep(mouth.y + 1.4, mouth.y + 3.2, point.y - 0.12 * point.x.abs());
    let [near, far] = BEARD_REACH;
    let neck = smoothstep(-12.0, -8.5, point.y);
    low * neck * smoothstep(near * 0.8, near * 1.3, from_mouth) * (1.0 - 0.4 * smoothstep(near, far, from_mouth))
}

/// Hair colours in linear light: black, dark and light brown, blond, red, grey.
const HAIR: [[f32; 3]; 6] = [
    [0.012, 0.010, 0.009],
    [0.045, 0.026, 0.016],
    [0.11, 0.065, 0.035],
    [0.35, 0.25, 0.13],
    [0.2, 0.07, 0.025],
    [0.3, 0.3, 0.31],
];
const DARK_SKIN: f32 = 0.16;

fn pick(rng: &mut ChaCha8Rng, list: &[usize]) -> usize {
    list.iter().choose(rng).copied().unwrap_or(0)
}

pub fn random_looks(rng: &mut ChaCha8Rng, assets: &Assets, [skins, brows, eyes]: &TextureChoice) -> Looks {
    let skin = pick(rng, skins);
    let hair = hair_colour(rng, assets.skins[skin].lightness);
    let brow = hair.min(Vec3::splat(0.12)) * rng.random_range(0.12..0.55);
    let bearded = rng.random_bool(0.3);
    Looks {
        skin,
        brow: pick(rng, brows),
        eye: pick(rng, eyes),
        tint: Vec3::new(rng.random_range(0.9..1.12), 1.0, rng.random_range(0.88..1.1)) * rng.random_range(0.75..1.2),
        gloss: rng.random_range(0.4..2.2),
        hair: rng.random_bool(0.85).then(|| (hair, rng.random_range(0.1..1.6))),
        hairline: normal(rng, 0.6, 1.5),
        beard: if bearded { rng.random_range(0.15..0.95) } else { 0.0 },
        beard_style: BeardStyle::Full,
        wrinkles: 0.0,
        brow_colour: (brow, rng.random_range(0.6..1.0)),
        // High or low, level or arched.
        brow_lift: {
            let inner = normal(rng, 0.22, 0.6);
            [inner, inner + normal(rng, 0.22, 0.5)]
        },
        brow_thickness: rng.random_range(1.0..1.9),
        iris_radius: rng.random_range(0.355..0.42),
        iris_lightness: iris_lightness(rng, assets.skins[skin].lightness),
        lashes: rng.random_range(0.05..0.5),
        cloth: (cloth_colour(rng), normal(rng, 1.0, 2.0) - 13.0),
    }
}

/// Draws the lightness of the iris: most people have dark eyes, and those with a dark skin nearly always.
fn iris_lightness(rng: &mut ChaCha8Rng, skin_lightness: f32) -> f32 {
    let dark = if skin_lightness < DARK_SKIN { 0.95 } else { 0.6 };
    if rng.random_bool(dark) { rng.random_range(0.1..0.45) } else { rng.random_range(0.45..1.0) }
}

fn cloth_colour(rng: &mut ChaCha8Rng) -> Vec3 {
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    let grey = Vec3::splat(rng.random_range(0.01..0.7));
    grey.lerp(hue * hue * 0.6, rng.random_range(0.0_f32..0.9).powi(2))
}

fn hair_colour(rng: &mut ChaCha8Rng, skin_lightness: f32) -> Vec3 {
    let black = skin_lightness < DARK_SKIN && rng.random_bool(0.8);
    let kind = if black { HAIR[0] } else { HAIR.iter().choose(rng).copied().unwrap_or_default() };
    Vec3::from_array(kind) * rng.random_range(0.7..1.4)
}
