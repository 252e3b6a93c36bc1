//! The sampler: draws subjects, and a scene for each of their pictures. Every subject and every picture has a
//! stream of random numbers of its own, so that pictures depend neither on other subjects nor on pictures drawn before.

use std::sync::Arc;

use facewire_face::COEFFS;
use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::acting::Expressions;
use super::assets::{Assets, TextureChoice};
use super::camera::Effects;
use super::expression::Coefficients;
use super::occluders::{Behind, Occluder};
use super::person::{Person, random_looks};
use super::props::Prop;
use super::rig::normal;
use super::scene::{Backdrop, FACE_CM, Lens, Placement, Scene, random_effects, random_lighting};
use super::shade::Lighting;
use super::tongue::Tongue;
use super::variety::{Condition, Conditions, Factor, Without};

/// Limit on the weights of identity modes in standard deviations, beyond which heads look unnatural.
const IDENTITY_LIMIT: f32 = 2.5;
/// Standard deviation and limit of yaw, pitch and roll in degrees.
const TURN_DEG: [(f32, f32); 3] = [(16.0, 40.0), (10.0, 25.0), (7.0, 20.0)];
/// The same for the subject's neutral picture.
const NEARLY_FRONTAL_DEG: [(f32, f32); 3] = [(2.0, 5.0); 3];

/// Parts of a subject's random numbers from which its conditions and its tongue are drawn.
const CONDITIONS: u64 = u16::MAX as u64;
const TONGUE: u64 = CONDITIONS - 1;
/// Bits of the streams from which a picture's occluders, and the direction of its tongue, are drawn.
const OCCLUDERS: u64 = 1 << 63;
const TONGUE_DIRECTION: u64 = 1 << 62;

pub struct Variety {
    pub textures: TextureChoice,
    pub without: Without,
    pub condition: Option<Condition>,
    /// Share of pictures in which something covers a part of the face, if no condition is forced.
    pub covered: f64,
}

pub struct Distribution {
    pub variety: Variety,
    pub expressions: Expressions,
    /// Yaw and pitch of every head except in neutral pictures, to either side, instead of random angles.
    pub turn_deg: Option<[f32; 2]>,
}

pub struct Subject {
    pub person: Person,
    /// Distance of the head from the camera in centimetres.
    pub distance: f32,
    lighting: Lighting,
    lens: Lens,
    pub backdrop: Backdrop,
    effects: Effects,
    conditions: Conditions,
    worn: Vec<Arc<Prop>>,
    skin: Vec3,
    tongue: Tongue,
    number: u64,
    pub rng: ChaCha8Rng,
}

pub struct PictureSpec {
    pub scene: Scene,
    pub effects: Effects,
    pub neutral: bool,
}

impl Subject {
    pub fn random(assets: &Assets, variety: &Variety, size: [usize; 2], [seed, number]: [u64; 2]) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream(number, 0));
        let (rng_ref, without) = (&mut rng, &variety.without);
        let spread = rng_ref.random_range(0.5..1.0);
        let mut identity: Vec<f32> =
            (0..assets.rig.identities.len()).map(|_| spread * normal(rng_ref, 1.0, IDENTITY_LIMIT)).collect();
        let mut looks = random_looks(rng_ref, assets, &variety.textures);
        let mut distance = rng_ref.random_range(38.0_f32.ln()..95.0_f32.ln()).exp();
        let mut share = rng_ref.random_range(0.3..0.7);
        let mut lighting = random_lighting(rng_ref);
        let room = lighting.ambient[0] * rng_ref.random_range(0.6..2.0);
        let mut backdrop = Backdrop::random(rng_ref, size, room);
        let effects = random_effects(rng_ref);
        let mut conditions_rng = on_stream(&rng, stream(number, CONDITIONS));
        let conditions = Conditions::random(&mut conditions_rng, variety.condition, without, variety.covered);
        let mut tongue_rng = on_stream(&ChaCha8Rng::seed_from_u64(seed), stream(number, TONGUE));
        without.simplify_person(&mut identity, &mut looks);
        without.simplify_size(&mut share, &mut distance);
        without.simplify_lighting(&mut lighting);
        if without.takes(Factor::Backdrop) {
            backdrop.flatten();
        }
        conditions.apply_to_looks(&mut looks);
        conditions.apply_to_lighting(&mut lighting);
        let face_px = share * size[0].min(size[1]) as f32;
        let mut lens = Lens { size, focal_px: face_px * distance / FACE_CM };
        lens.focal_px = conditions.focal_px(&lens, distance);
        let person = Person::new(assets, &identity, looks);
        let glasses = conditions.glasses.as_ref().map(|style| style.build(&assets.rig, &person.base).map(Arc::new));
        // The lightness is that of the skin's green in linear light.
        let green = assets.skins[person.looks.skin].lightness;
        Self {
            worn: glasses.into_iter().flatten().collect(),
            skin: Vec3::new(green.powf(0.6), green, 0.75 * green) * person.looks.tint,
            tongue: Tongue::random(&mut tongue_rng),
            conditions,
            lens,
            person,
            backdrop,
            effects,
            distance,
            lighting,
            number,
            rng,
        }
    }

    /// Begins a picture, whose random numbers do not depend on those of other pictures. The first one has the number 0.
    pub fn begin(&mut self, picture: u64) {
        self.rng.set_stream(stream(self.number, picture + 1));
        self.rng.set_word_pos(0);
    }

    pub fn random_spec(&mut self, assets: &Assets, distribution: &Distribution, neutral: bool) -> PictureSpec {
        let rng = &mut self.rng;
        let weights = if neutral { [0.0; COEFFS] } else { distribution.expressions.draw(rng) };
        let ranges = if neutral { NEARLY_FRONTAL_DEG } else { TURN_DEG };
        let mut angles_deg = ranges.map(|(deviation, limit)| normal(rng, deviation, limit));
        if let Some([yaw, pitch]) = distribution.turn_deg.filter(|_| !neutral) {
            angles_deg = [yaw.copysign(angles_deg[0]), pitch.copysign(angles_deg[1]), angles_deg[2]];
        }
        let mut position = position(rng, self.distance, &self.lens);
        let mut effects = self.effects.clone();
        effects.exposure *= rng.random_range(0.9..1.1);
        effects.motion_px = motion(rng);
        let without = &distribution.variety.without;
        without.simplify_pose(&mut angles_deg, &mut position, self.distance);
        without.simplify_effects(&mut effects);
        self.conditions.apply_to_effects(&mut effects);
        let (props, tongue) = self.props(assets, &self.rng);
        let props = if neutral { self.worn.clone() } else { props };
        let placement = Placement { angles_deg, position };
        let scene = Scene { weights, placement, lighting: self.lighting.clone(), lens: self.lens, props, tongue };
        PictureSpec { scene, effects, neutral }
    }

    /// Returns what is on and before the face, and where the tongue points to, drawn from streams beside that of `rng`.
    fn props(&self, assets: &Assets, rng: &ChaCha8Rng) -> (Vec<Arc<Prop>>, Tongue) {
        let tongue = self.tongue.aimed(&mut on_stream(rng, rng.get_stream() | TONGUE_DIRECTION));
        let mut rng = on_stream(rng, rng.get_stream() | OCCLUDERS);
        let mut props = self.worn.clone();
        let (share, occluders) = self.conditions.covered;
        if rng.random_bool(share) {
            let hair = self.person.looks.hair.map_or(Vec3::splat(0.03), |(colour, _)| colour);
            let behind = Behind { rig: &assets.rig, base: &self.person.base, skin: self.skin, hair };
            let occluder = Occluder::random(&mut rng, occluders);
            props.insert(0, Arc::new(occluder.build(&mut rng, &behind)));
        }
        (props, tongue)
    }

    /// Returns a picture with a given expression and pose. `offset` is from the middle of the picture in centimetres.
    pub fn pose(&self, assets: &Assets, weights: Coefficients, angles_deg: [f32; 3], offset: Vec3) -> PictureSpec {
        let placement = Placement { angles_deg, position: offset - Vec3::new(0.0, 0.5, self.distance) };
        let mut rng = self.rng.clone();
        rng.set_word_pos(0);
        let (props, tongue) = self.props(assets, &rng);
        let scene = Scene { weights, placement, lighting: self.lighting.clone(), lens: self.lens, props, tongue };
        let mut effects = self.effects.clone();
        self.conditions.apply_to_effects(&mut effects);
        PictureSpec { scene, effects, neutral: false }
    }
}

/// Returns the same generator on another stream, at the same position.
fn on_stream(rng: &ChaCha8Rng, stream: u64) -> ChaCha8Rng {
    let mut rng = rng.clone();
    rng.set_stream(stream);
    rng
}

/// Returns the stream of random numbers of a subject (part 0) or of one of its pictures (parts from 1 on).
fn stream(number: u64, part: u64) -> u64 {
    ((number + 1) << 16) + part
}

fn position(rng: &mut ChaCha8Rng, distance: f32, lens: &Lens) -> Vec3 {
    let depth = distance * rng.random_range(0.88..1.12);
    let half = Vec2::new(lens.size[0] as f32, lens.size[1] as f32) / 2.0 * depth / lens.focal_px;
    let room = (half - Vec2::new(9.5, 11.5)).max(Vec2::ZERO);
    let beside = |rng: &mut ChaCha8Rng, room: f32| normal(rng, 0.5 * room + 0.01, room);
    let (x, y) = (beside(rng, room.x), beside(rng, room.y) - 0.5);
    Vec3::new(x, y, -depth)
}

fn motion(rng: &mut ChaCha8Rng) -> Vec2 {
    if rng.random_bool(0.15) {
        Vec2::from_angle(rng.random_range(0.0..core::f32::consts::TAU)) * rng.random_range(1.0..4.0)
    } else {
        Vec2::ZERO
    }
}
