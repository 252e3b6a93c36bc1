//! The sampler: who is seen, and how, in each picture. Everything is drawn from the subject's own seed, so that a
//! subject's pictures are the same whatever else is drawn.

use facewire::solve::COEFFS;
use glam::{Vec2, Vec3};
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::StandardNormal;
use turbojpeg::Subsamp;

use super::{
    acting::{Mix, random_expression},
    backdrop::Backdrop,
    camera::Effects,
    expression::Coefficients,
    kit::Kit,
    person::{Looks, Person},
    scene::{Lens, Light, Lighting, Placement, Shot},
};

/// Width of a face in front, centimetres: for the size that it has in the picture.
const FACE_CM: f32 = 14.5;
/// Beyond this many deviations identities look like nobody.
const IDENTITY_LIMIT: f32 = 2.5;
/// Yaw, pitch and roll: standard deviation, and bounds, degrees.
const TURN_DEG: [(f32, f32); 3] = [(16.0, 40.0), (10.0, 25.0), (7.0, 20.0)];
/// The same for the subject's neutral picture.
const NEARLY_FRONTAL_DEG: [(f32, f32); 3] = [(2.0, 5.0); 3];

/// Colours of hair, linear: black, dark and light brown, blond, red, grey.
const HAIR: [[f32; 3]; 6] = [
    [0.012, 0.010, 0.009],
    [0.045, 0.026, 0.016],
    [0.11, 0.065, 0.035],
    [0.35, 0.25, 0.13],
    [0.2, 0.07, 0.025],
    [0.3, 0.3, 0.31],
];
/// Lightness of skin below this is dark.
const DARK_SKIN: f32 = 0.16;

/// Numbers of the textures that people may have; at least one of each kind.
pub struct Wardrobe {
    /// Of skins.
    pub skins: Vec<usize>,
    /// Of brows.
    pub brows: Vec<usize>,
    /// Of eyes.
    pub eyes: Vec<usize>,
}

/// What may be drawn.
pub struct Choice<'a> {
    /// Looks of people.
    pub wardrobe: Wardrobe,
    /// Frames of recordings.
    pub frames: &'a [Coefficients],
    /// Kinds of expressions.
    pub mix: Mix,
    /// Shapes that may show alone, instead of all.
    pub shapes: Vec<usize>,
    /// Yaw and pitch of every head that is not the subject's neutral one, to either side, in place of turns at random.
    pub turn_deg: Option<[f32; 2]>,
}

/// A subject: person, camera and room, which stay the same over the subject's pictures.
pub struct Subject {
    /// The person.
    pub person: Person,
    /// Distance of the head, centimetres.
    pub distance: f32,
    lighting: Lighting,
    lens: Lens,
    backdrop: Backdrop,
    effects: Effects,
    rng: ChaCha8Rng,
}

/// One picture to be taken.
pub struct Take {
    /// What it shows.
    pub shot: Shot,
    /// How the camera sees it.
    pub effects: Effects,
    /// The subject's neutral picture.
    pub neutral: bool,
}

fn normal(rng: &mut ChaCha8Rng, deviation: f32, limit: f32) -> f32 {
    (rng.sample::<f32, _>(StandardNormal) * deviation).clamp(-limit, limit)
}

fn pick(rng: &mut ChaCha8Rng, list: &[usize]) -> usize {
    list.iter().choose(rng).copied().unwrap_or(0)
}

impl Subject {
    /// Draws subject `number` of a seed, for pictures of `size`.
    pub fn random(kit: &Kit, wardrobe: &Wardrobe, size: [usize; 2], [seed, number]: [u64; 2]) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(number + 1);
        let rng_ref = &mut rng;
        let spread = rng_ref.random_range(0.5..1.0);
        let identity: Vec<f32> =
            (0..kit.rig.identities.len()).map(|_| spread * normal(rng_ref, 1.0, IDENTITY_LIMIT)).collect();
        let looks = looks(rng_ref, kit, wardrobe);
        let person = Person::new(kit, &identity, looks);
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

    /// The next picture of the subject: neutral and nearly frontal, or at random.
    pub fn take(&mut self, choice: &Choice, neutral: bool) -> Take {
        let rng = &mut self.rng;
        let weights =
            if neutral { [0.0; COEFFS] } else { random_expression(rng, choice.mix, choice.frames, &choice.shapes) };
        let angles_deg =
            if neutral { NEARLY_FRONTAL_DEG } else { TURN_DEG }.map(|(deviation, limit)| normal(rng, deviation, limit));
        let angles_deg = match choice.turn_deg {
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
        let shot = Shot { weights, placement, lighting: self.lighting.clone(), lens: self.lens };
        Take { shot, effects, neutral }
    }

    /// A picture with a given expression and place; `offset` is from the middle of the picture, centimetres.
    pub fn pose(&self, weights: Coefficients, angles_deg: [f32; 3], offset: Vec3) -> Take {
        let placement = Placement { angles_deg, position: offset - Vec3::new(0.0, 0.5, self.distance) };
        let shot = Shot { weights, placement, lighting: self.lighting.clone(), lens: self.lens };
        Take { shot, effects: self.effects.clone(), neutral: false }
    }

    /// What stands behind.
    pub fn backdrop(&self) -> &Backdrop {
        &self.backdrop
    }

    /// For noise.
    pub fn rng(&mut self) -> &mut ChaCha8Rng {
        &mut self.rng
    }
}

/// Somewhere in the picture, with the whole face inside.
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

fn looks(rng: &mut ChaCha8Rng, kit: &Kit, wardrobe: &Wardrobe) -> Looks {
    let skin = pick(rng, &wardrobe.skins);
    let hair = hair_colour(rng, kit.skins[skin].lightness);
    let brow = hair.min(Vec3::splat(0.12)) * rng.random_range(0.12..0.55);
    let bearded = rng.random_bool(0.3);
    Looks {
        skin,
        brow: pick(rng, &wardrobe.brows),
        eye: pick(rng, &wardrobe.eyes),
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

/// Of the inner and the outer end, centimetres: high or low, level or arched.
fn brow_lift(rng: &mut ChaCha8Rng) -> [f32; 2] {
    let (inner, tilt) = (normal(rng, 0.22, 0.6), normal(rng, 0.22, 0.5));
    [inner, inner + tilt]
}

/// Mostly dull.
fn cloth_colour(rng: &mut ChaCha8Rng) -> Vec3 {
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    let grey = Vec3::splat(rng.random_range(0.01..0.7));
    grey.lerp(hue * hue * 0.6, rng.random_range(0.0_f32..0.9).powi(2))
}

/// Dark skin has mostly black hair.
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

/// From flat and bright to one hard lamp at the side.
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
