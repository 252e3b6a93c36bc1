//! A person: the shape and the looks of the head, which are the same in all of the person's pictures.

use glam::{Vec2, Vec3, Vec4};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{
    assets::Assets,
    geometry::{piecewise, smoothstep},
    paint::{FULL_HAIR, HAIR_EDGE},
    rig::Triangle,
};

/// Height of the hairline at depths z, in centimetres: nape, behind the ear, above the ear, temple, forehead.
const HAIRLINE: [(f32, f32); 7] =
    [(-6.0, -7.0), (-3.0, -5.0), (-1.5, 1.0), (0.5, 5.4), (3.0, 6.4), (6.0, 9.6), (9.0, 11.4)];
/// Ears are beyond this distance from the middle and below this height.
const EAR: (f32, f32) = (7.65, 5.6);
/// The beard grows at these distances from the mouth, in centimetres.
const BEARD_REACH: [f32; 2] = [1.0, 5.0];

/// The random properties of a person other than the identity shape.
#[derive(Debug, Clone)]
pub struct Looks {
    /// Index of the skin.
    pub skin: usize,
    /// Index of the brows.
    pub brow: usize,
    /// Index of the eyes.
    pub eye: usize,
    /// Factor on the skin's colour.
    pub tint: Vec3,
    /// Strength of the skin's specular highlight, about 1.
    pub gloss: f32,
    /// Colour of the hair and its thickness in centimetres, or `None` for a bald head.
    pub hair: Option<(Vec3, f32)>,
    /// Offset of the hairline in centimetres, positive upwards.
    pub hairline: f32,
    /// Darkness of the beard, from 0 to 1.
    pub beard: f32,
    /// Where the beard grows.
    pub beard_style: BeardStyle,
    /// Depth of the wrinkles that come with an expression, from 0 to 1.
    pub wrinkles: f32,
    /// Colour and opacity of the brows.
    pub brow_colour: (Vec3, f32),
    /// Offset of the brows' inner and outer end in centimetres, positive upwards.
    pub brow_lift: [f32; 2],
    /// Factor on the thickness of the brows.
    pub brow_thickness: f32,
    /// Radius of the iris relative to the eyeball's.
    pub iris: f32,
    /// Opacity of the lashes.
    pub lashes: f32,
    /// Colour of the clothes and height of their collar in centimetres.
    pub cloth: (Vec3, f32),
}

/// Where a beard grows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BeardStyle {
    /// Around the mouth, and on cheeks and jaw.
    Full,
    /// Above the upper lip.
    Moustache,
    /// Around the mouth and on the chin.
    Goatee,
    /// As a full beard, but of short hairs.
    Stubble,
}

impl BeardStyle {
    /// Draws a style. Half of all beards are full ones.
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

/// A head that can be deformed by expressions.
pub struct Person {
    /// Vertices at rest.
    pub base: Vec<Vec3>,
    /// Looks of the person.
    pub looks: Looks,
    /// Attributes of each vertex of the skin.
    pub attributes: Vec<VertexAttributes>,
    /// What covers each triangle of the skin.
    pub covers: Vec<Cover>,
    /// Coordinates of each vertex in the brows' texture.
    pub brow_uv: Vec<Vec2>,
    /// The triangles that the brows touch.
    pub brow_triangles: Vec<Triangle>,
}

/// What covers a triangle of the skin. Triangles of one material are painted faster.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cover {
    /// Clothes.
    Cloth,
    /// Bare skin without the texture.
    Tone,
    /// Bare skin with the texture.
    Texture,
    /// Hair through which no skin is visible.
    Hair,
    /// Several materials, or a beard.
    Mixed,
}

/// Attributes of a vertex of the skin, packed for interpolation.
#[derive(Debug, Clone, Copy)]
pub struct VertexAttributes {
    /// Tone in linear light, and weight of the texture against the tone.
    pub tone: Vec4,
    /// Texture coordinates, distance inside the hairline (negative on bare skin) and below the collar in centimetres.
    pub cover: Vec4,
    /// Position on the rig at rest, and density of the beard.
    pub rest: Vec4,
}

impl Person {
    /// Creates a head from weights of the identity modes.
    pub fn new(assets: &Assets, identity: &[f32], looks: Looks) -> Self {
        let rest = &assets.rig.neutral;
        let hair: Vec<f32> = rest.iter().map(|point| hair_at(*point, looks.hairline)).collect();
        let mut base = rest.clone();
        for (weight, mode) in identity.iter().zip(&assets.rig.identities) {
            base.iter_mut().zip(mode).for_each(|(point, offset)| *point += *weight * *offset);
        }
        if let Some((_, volume)) = looks.hair {
            let grown = hair
                .iter()
                .zip(&assets.rest_normals)
                .map(|(depth, normal)| *normal * volume * smoothstep(0.0, 1.6, *depth));
            base.iter_mut().zip(grown).for_each(|(point, offset)| *point += offset);
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
            VertexAttributes {
                tone: (skin.tone[vertex] * looks.tint).extend(assets.layout.share[vertex]),
                cover: Vec4::new(uv.x, uv.y, hair[vertex], collar_at(point, looks.cloth.1)),
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

/// Returns the distance below the collar, which is lower in front than at the sides.
fn collar_at(point: Vec3, height: f32) -> f32 {
    height + 0.06 * point.x * point.x - 0.12 * point.z.max(0.0) - point.y
}

/// Returns the density of a beard, which grows around the mouth and along the jaw, but not on the lips.
fn beard_at(point: Vec3, mouth: Vec3) -> f32 {
    let from_mouth = ((point.x - mouth.x) / 1.5).hypot(point.y - mouth.y);
    let low = 1.0 - smoothstep(mouth.y + 1.4, mouth.y + 3.2, point.y - 0.12 * point.x.abs());
    let [near, far] = BEARD_REACH;
    let neck = smoothstep(-12.0, -8.5, point.y);
    low * neck * smoothstep(near * 0.8, near * 1.3, from_mouth) * (1.0 - 0.4 * smoothstep(near, far, from_mouth))
}
