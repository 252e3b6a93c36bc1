//! The sampler: draws subjects, and a scene for each of their pictures. All random numbers come from the subject's own
//! stream, so that a subject's pictures do not depend on other subjects.

use facewire::solve::COEFFS;
use glam::{Vec2, Vec3};
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::StandardNormal;
use turbojpeg::Subsamp;

use super::{
    acting::{Mix, random_expression},
    assets::Assets,
    backdrop::Backdrop,
    camera::Effects,
    expression::Coefficients,
    person::{Looks, Person},
    render::FACE_CM,
    scene::{Lens, Light, Lighting, Placement, Scene},
};

/// Limit on the weights of identity modes in standard deviations, beyond which heads look unnatural.
const IDENTITY_LIMIT: f32 = 2.5;
/// Standard deviation and limit of yaw, pitch and roll in degrees.
const TURN_DEG: [(f32, f32); 3] = [(16.0, 40.0), (10.0, 25.0), (7.0, 20.0)];
/// The same for the subject's neutral picture.
const NEARLY_FRONTAL_DEG: [(f32, f32); 3] = [(2.0, 5.0); 3];

/// Hair colours in linear light: black, dark and light brown, blond, red, grey.
const HAIR: [[f32; 3]; 6] = [
    [0.012, 0.010, 0.009],
    [0.045, 0.026, 0.016],
    [0.11, 0.065, 0.035],
    [0.35, 0.25, 0.13],
    [0.2, 0.07, 0.025],
    [0.3, 0.3, 0.31],
];
/// Skin of lower lightness counts as dark.
const DARK_SKIN: f32 = 0.16;

/// Indices of the textures to draw from, at least one of each kind.
pub struct TextureChoice {
    /// Skins.
    pub skins: Vec<usize>,
    /// Brows.
    pub brows: Vec<usize>,
    /// Eyes.
    pub eyes: Vec<usize>,
}

/// The distribution that pictures are drawn from.
pub struct Distribution<'a> {
    /// Textures of people.
    pub textures: TextureChoice,
    /// Frames of recordings.
    pub frames: &'a [Coefficients],
    /// Frequencies of the kinds of expressions.
    pub mix: Mix,
    /// Shapes that may be shown alone, or all if empty.
    pub shapes: Vec<usize>,
    /// Yaw and pitch of every head except in neutral pictures, to either side, instead of random angles.
    pub turn_deg: Option<[f32; 2]>,
}

/// A subject: a person with camera and room, which are the same in all of the subject's pictures.
pub struct Subject {
    /// The person.
    pub person: Person,
    /// Distance of the head from the camera in centimetres.
    pub distance: f32,
    lighting: Lighting,
    lens: Lens,
    backdrop: Backdrop,
    effects: Effects,
    rng: ChaCha8Rng,
}

/// Everything that defines one picture of a subject.
pub struct PictureSpec {
    /// The scene to render.
    pub scene: Scene,
    /// The effects of the camera.
    pub effects: Effects,
    /// Whether this is the subject's neutral picture.
    pub neutral: bool,
}

fn normal(rng: &mut ChaCha8Rng, deviation: f32, limit: f32) -> f32 {
    (rng.sample::<f32, _>(StandardNormal) * deviation).clamp(-limit, limit)
}

fn pick(rng: &mut ChaCha8Rng, list: &[usize]) -> usize {
    list.iter().choose(rng).copied().unwrap_or(0)
}

impl Subject {
    /// Draws subject `number` of a seed for pictures of `size`.
    pub fn random(assets: &Assets, textures: &TextureChoice, size: [usize; 2], [seed, number]: [u64; 2]) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(number + 1);
        let rng_ref = &mut rng;
        let spread = rng_ref.random_range(0.5..1.0);
        let identity: Vec<f32> =
            (0..assets.rig.identities.len()).map(|_| spread * normal(rng_ref, 1.0, IDENTITY_LIMIT)).collect();
        let looks = looks(rng_ref, assets, textures);
        let person = Person::new(assets, &identity, looks);
        let distance = rng_ref.random_range(38.0_f32.ln()..95.0_f32.ln()).exp();
        let face_px = rng_ref.random_range(0.28..0.55) * size[0].min(size[1]) as f32;
        let lighting = lighting(rng_ref);
        let room = lighting.ambient[0] * rng_ref.random_range(0.6..2.0);
        Self {
            backdrop: Backdrop::random(rng_ref, size, room),
            effects: effects(rng_ref),
            lens: Lens { size, focal_px: face_px * distance / FACE_CM },
            person,
            distance,
            lighting,
            rng,
        }
    }

    /// Draws the next picture of the subject: random, or neutral and nearly frontal.
    pub fn random_spec(&mut self, distribution: &Distribution, neutral: bool) -> PictureSpec {
        let rng = &mut self.rng;
        let weights = if neutral {
            [0.0; COEFFS]
        } else {
            random_expression(rng, distribution.mix, distribution.frames, &distribution.shapes)
        };
        let angles_deg =
            if neutral { NEARLY_FRONTAL_DEG } else { TURN_DEG }.map(|(deviation, limit)| normal(rng, deviation, limit));
        let angles_deg = match distribution.turn_deg {
            Some([yaw, pitch]) if !neutral => {
                [yaw.copysign(angles_deg[0]), pitch.copysign(angles_deg[1]), angles_deg[2]]
            }
            _ => angles_deg,
        };
        let position = position(rng, self.distance, &self.lens);
        let mut effects = self.effects.clone();
        effects.exposure *= rng.random_range(0.9..1.1);
        effects.motion_px = motion(rng);
        let placement = Placement { angles_deg, position };
        let scene = Scene { weights, placement, lighting: self.lighting.clone(), lens: self.lens };
        PictureSpec { scene, effects, neutral }
    }

    /// Returns a picture with a given expression and pose. `offset` is from the middle of the picture in centimetres.
    pub fn pose(&self, weights: Coefficients, angles_deg: [f32; 3], offset: Vec3) -> PictureSpec {
        let placement = Placement { angles_deg, position: offset - Vec3::new(0.0, 0.5, self.distance) };
        let scene = Scene { weights, placement, lighting: self.lighting.clone(), lens: self.lens };
        PictureSpec { scene, effects: self.effects.clone(), neutral: false }
    }

    /// Returns the backdrop.
    pub fn backdrop(&self) -> &Backdrop {
        &self.backdrop
    }

    /// Returns the random number generator, for noise.
    pub fn rng(&mut self) -> &mut ChaCha8Rng {
        &mut self.rng
    }
}

/// Draws a position at which the whole face is inside the picture.
fn position(rng: &mut ChaCha8Rng, distance: f32, lens: &Lens) -> Vec3 {
    let depth = distance * rng.random_range(0.88..1.12);
    let half = Vec2::new(lens.size[0] as f32, lens.size[1] as f32) / 2.0 * depth / lens.focal_px;
    let room = (half - Vec2::new(9.5, 11.5)).max(Vec2::ZERO);
    let beside = |rng: &mut ChaCha8Rng, room: f32| normal(rng, 0.5 * room + 0.01, room);
    let (x, y) = (beside(rng, room.x), beside(rng, room.y) - 0.5);
    Vec3::new(x, y, -depth)
}

fn motion(rng: &mut ChaCha8Rng) -> Vec2 {
    if rng.random_bool(0.25) {
        Vec2::from_angle(rng.random_range(0.0..core::f32::consts::TAU)) * rng.random_range(1.0..5.0)
    } else {
        Vec2::ZERO
    }
}

fn looks(rng: &mut ChaCha8Rng, assets: &Assets, textures: &TextureChoice) -> Looks {
    let skin = pick(rng, &textures.skins);
    let hair = hair_colour(rng, assets.skins[skin].lightness);
    let brow = hair.min(Vec3::splat(0.12)) * rng.random_range(0.12..0.55);
    let bearded = rng.random_bool(0.3);
    Looks {
        skin,
        brow: pick(rng, &textures.brows),
        eye: pick(rng, &textures.eyes),
        tint: Vec3::new(rng.random_range(0.9..1.12), 1.0, rng.random_range(0.88..1.1)) * rng.random_range(0.75..1.2),
        gloss: rng.random_range(0.4..2.2),
        hair: rng.random_bool(0.85).then(|| (hair, rng.random_range(0.1..1.6))),
        hairline: normal(rng, 0.6, 1.5),
        beard: if bearded { rng.random_range(0.15..0.95) } else { 0.0 },
        brow_colour: (brow, rng.random_range(0.6..1.0)),
        brow_lift: brow_lift(rng),
        brow_thickness: rng.random_range(1.0..1.9),
        iris: rng.random_range(0.355..0.42),
        lashes: rng.random_range(0.05..0.5),
        cloth: (cloth_colour(rng), normal(rng, 1.0, 2.0) - 13.0),
    }
}

/// Draws the offset of the brows' inner and outer end in centimetres: high or low, level or arched.
fn brow_lift(rng: &mut ChaCha8Rng) -> [f32; 2] {
    let (inner, tilt) = (normal(rng, 0.22, 0.6), normal(rng, 0.22, 0.5));
    [inner, inner + tilt]
}

/// Draws a colour for clothes. Most colours are unsaturated.
fn cloth_colour(rng: &mut ChaCha8Rng) -> Vec3 {
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    let grey = Vec3::splat(rng.random_range(0.01..0.7));
    grey.lerp(hue * hue * 0.6, rng.random_range(0.0_f32..0.9).powi(2))
}

/// Draws a hair colour. People with dark skin mostly have black hair.
fn hair_colour(rng: &mut ChaCha8Rng, skin_lightness: f32) -> Vec3 {
    let black = skin_lightness < DARK_SKIN && rng.random_bool(0.8);
    let kind = if black { HAIR[0] } else { HAIR.iter().choose(rng).copied().unwrap_or_default() };
    Vec3::from_array(kind) * rng.random_range(0.7..1.4)
}

fn direction(rng: &mut ChaCha8Rng, toward: Vec3, spread: f32) -> Vec3 {
    let away = Vec3::from_array(core::array::from_fn(|_| normal(rng, spread, 3.0)));
    (toward + away).normalize_or(Vec3::Y)
}

fn warmth(rng: &mut ChaCha8Rng) -> Vec3 {
    let warm: f32 = rng.random_range(-0.12..0.3);
    Vec3::new(1.0 + 0.5 * warm, 1.0, 1.0 - warm)
}

/// Draws a lighting, from flat and bright to a single hard lamp at the side.
fn lighting(rng: &mut ChaCha8Rng) -> Lighting {
    let flat: f32 = rng.random_range(0.15..0.95);
    let mean = warmth(rng) * (0.12 + 0.5 * flat);
    let tilt = |rng: &mut ChaCha8Rng, bias: f32| mean * (bias + normal(rng, 0.25, 0.5));
    let ambient = [mean, tilt(rng, 0.0), tilt(rng, 0.3), tilt(rng, 0.15)];
    let key = Light {
        toward: direction(rng, Vec3::new(0.0, 0.5, 1.0), 0.7),
        colour: warmth(rng) * (1.1 - 0.75 * flat) * rng.random_range(0.7..1.2),
    };
    let fill = Light {
        toward: direction(rng, Vec3::new(0.0, 0.2, 0.7), 1.0),
        colour: warmth(rng) * rng.random_range(0.0..0.35),
    };
    let rim = Light {
        toward: direction(rng, Vec3::new(0.0, 0.5, -0.8), 0.8),
        colour: warmth(rng) * rng.random_range(0.0..0.6),
    };
    Lighting { ambient, lights: vec![key, fill, rim], softness: rng.random_range(0.15..0.9) }
}

fn effects(rng: &mut ChaCha8Rng) -> Effects {
    let dark = rng.random_bool(0.15);
    let noise: f32 = if dark { rng.random_range(0.02..0.06) } else { rng.random_range(0.002..0.03) };
    Effects {
        defocus_px: if rng.random_bool(0.5) { rng.random_range(0.35..1.5) } else { 0.0 },
        motion_px: Vec2::ZERO,
        exposure: warmth(rng) * rng.random_range(0.5..1.15),
        vignette: rng.random_range(0.0..0.45),
        noise: [noise, noise * rng.random_range(0.05..0.3)],
        contrast: rng.random_range(0.85..1.2),
        sharpening: if rng.random_bool(0.4) { rng.random_range(0.2..1.0) } else { 0.0 },
        jpeg_quality: rng.random_range(45..=95),
        chroma: if rng.random() { Subsamp::Sub2x1 } else { Subsamp::Sub2x2 },
    }
}
