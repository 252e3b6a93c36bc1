//! A person: the shape of the head and what it looks like, the same in all of the person's pictures.

use glam::{Vec2, Vec3, Vec4};

use super::{
    geometry::{piecewise, smoothstep},
    kit::Kit,
};

/// Height of the hairline by depth (z, y), centimetres: nape, behind the ear, above it, temple, forehead.
const HAIRLINE: [(f32, f32); 7] =
    [(-6.0, -7.0), (-3.0, -5.0), (-1.5, 1.0), (0.5, 5.4), (3.0, 6.4), (6.0, 9.6), (9.0, 11.4)];
/// Ears stick out beyond this half width, below this height.
const EAR: (f32, f32) = (7.65, 5.6);
/// The beard grows on skin at this distance around the mouth, centimetres.
const BEARD_REACH: [f32; 2] = [1.0, 5.0];

/// What is drawn at random of a person, beside the identity.
#[derive(Debug, Clone)]
pub struct Looks {
    /// Which skin, brows and eyes of the kit.
    pub skin: usize,
    /// Style of brows.
    pub brow: usize,
    /// Colour of eyes.
    pub eye: usize,
    /// Factor on the skin's colour.
    pub tint: Vec3,
    /// Strength of the highlight on skin; about 1.
    pub gloss: f32,
    /// Colour of hair and how far it stands out, centimetres; none for a bald head.
    pub hair: Option<(Vec3, f32)>,
    /// How much higher than usual the hairline is, centimetres.
    pub hairline: f32,
    /// Darkness of a beard, 0 to 1.
    pub beard: f32,
    /// Colour of the brows, and how opaque they are.
    pub brow_colour: (Vec3, f32),
    /// How much higher than usual the brows are at their inner and at their outer end, centimetres.
    pub brow_lift: [f32; 2],
    /// How much thicker the brows are (1 as drawn).
    pub brow_thickness: f32,
    /// Radius of the iris over that of the eyeball.
    pub iris: f32,
    /// How opaque the lashes are.
    pub lashes: f32,
    /// Colour of the clothes and height of their collar, centimetres.
    pub cloth: (Vec3, f32),
}

/// A head, ready to be moved.
pub struct Person {
    /// Vertices at rest.
    pub base: Vec<Vec3>,
    /// What it looks like.
    pub looks: Looks,
    /// What covers each vertex.
    pub covers: Vec<Cover>,
    /// Where the brows' texture lies.
    pub brow_uv: Vec<Vec2>,
}

/// What a vertex of the skin carries, packed for interpolation.
#[derive(Debug, Clone, Copy)]
pub struct Cover {
    /// Tone (linear), and share of the texture against it.
    pub tone: Vec4,
    /// Place in the texture, how far inside the hair (centimetres, negative on bare skin), how far below the collar.
    pub place: Vec4,
    /// Position on the rig at rest, and density of the beard.
    pub rest: Vec4,
}

impl Person {
    /// Makes the head with the given weights of the identity modes.
    pub fn new(kit: &Kit, identity: &[f32], looks: Looks) -> Self {
        let rest = &kit.rig.neutral;
        let hair: Vec<f32> = rest.iter().map(|point| hair_at(*point, looks.hairline)).collect();
        let mut base = rest.clone();
        for (weight, mode) in identity.iter().zip(&kit.rig.identities) {
            base.iter_mut().zip(mode).for_each(|(point, offset)| *point += *weight * *offset);
        }
        if let Some((_, volume)) = looks.hair {
            let grown = hair
                .iter()
                .zip(&kit.rest_normals)
                .map(|(depth, normal)| *normal * volume * smoothstep(0.0, 1.6, *depth));
            base.iter_mut().zip(grown).for_each(|(point, offset)| *point += offset);
        }
        let brow = &kit.brows[looks.brow];
        let middle = kit.rig.landmark(24).y;
        let brow_at = |point: &Vec3| {
            let [inner, outer] = looks.brow_lift;
            let lift = inner + (outer - inner) * brow.along(*point);
            let y = middle + (point.y - middle - lift) / looks.brow_thickness;
            brow.place(Vec3::new(point.x, y, point.z))
        };
        let mouth = (kit.rig.landmark(48) + kit.rig.landmark(54)) / 2.0;
        let skin = &kit.skins[looks.skin];
        let cover = |vertex: usize| {
            let (point, uv) = (rest[vertex], kit.rig.skin_uv[vertex]);
            Cover {
                tone: (skin.tone[vertex] * looks.tint).extend(kit.layout.share[vertex]),
                place: Vec4::new(uv.x, uv.y, hair[vertex], collar_at(point, looks.cloth.1)),
                rest: point.extend(looks.beard * beard_at(point, mouth)),
            }
        };
        Self { covers: (0..rest.len()).map(cover).collect(), brow_uv: rest.iter().map(brow_at).collect(), base, looks }
    }
}

fn hair_at(point: Vec3, hairline: f32) -> f32 {
    let ear = point.x.abs() > EAR.0 && point.y < EAR.1;
    if ear { -1.0 } else { point.y - piecewise(&HAIRLINE, point.z) - hairline * smoothstep(0.0, 6.0, point.z) }
}

/// Lower in front than at the sides, as collars are.
fn collar_at(point: Vec3, height: f32) -> f32 {
    height + 0.06 * point.x * point.x - 0.12 * point.z.max(0.0) - point.y
}

/// Around the mouth and along the jaw, not on the lips.
fn beard_at(point: Vec3, mouth: Vec3) -> f32 {
    let from_mouth = ((point.x - mouth.x) / 1.5).hypot(point.y - mouth.y);
    let low = 1.0 - smoothstep(mouth.y + 1.4, mouth.y + 3.2, point.y - 0.12 * point.x.abs());
    let [near, far] = BEARD_REACH;
    let neck = smoothstep(-12.0, -8.5, point.y);
    low * neck * smoothstep(near * 0.8, near * 1.3, from_mouth) * (1.0 - 0.4 * smoothstep(near, far, from_mouth))
}
