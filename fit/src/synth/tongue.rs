//! A tongue for `tongueOut`, for which the rig has no shape. It is built around a line from the back of the mouth over
//! the lower lip. Lower teeth, lower lip and chin push this line up where they are in its way.

use core::f32::consts::TAU;

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::props::Prop;
use super::rig::{Rig, normal, piecewise, smoothstep, vertices_of};

/// Rings of vertices along the tongue, and vertices of a ring.
const RINGS: u16 = 36;
const AROUND: u16 = 40;
/// Length of the tongue behind the lower lip in centimetres. No picture shows its back end.
const BEHIND_LIP: f32 = 3.5;
/// A coefficient, and how far the tip is then in front of the lower lip in centimetres. At 0, there is no tongue.
const JUST_OUT: (f32, f32) = (0.3, 0.7);
/// Lips with a smaller gap are shut, and let no tongue pass, in centimetres.
const SHUT: f32 = 0.2;
/// Largest half width, as a share of the distance of the mouth's corners.
const MOST_OF_MOUTH: f32 = 0.37;

/// How a tongue looks, and where it points to. Lengths are in centimetres.
#[derive(Debug, Clone, Copy)]
pub struct Tongue {
    pub half_width: f32,
    pub half_height: f32,
    /// Length in front of the lower lip at a coefficient of 1, along the tongue.
    pub length: f32,
    /// Length of the round tip, and the exponent of its outline: 2 for an ellipse, less if it is pointed.
    pub tip: (f32, f32),
    pub groove: f32,
    pub colour: Vec3,
    /// Strength of the pale coat in the middle.
    pub coat: f32,
    /// Seed of the bumps on its surface.
    pub bumps: u64,
    /// Angle to the person's left, and how far it hangs down, in radians.
    pub aim: Vec2,
}

impl Tongue {
    pub fn random(rng: &mut ChaCha8Rng) -> Self {
        let dark = Vec3::new(0.32, 0.065, 0.075);
        let pale = Vec3::new(0.6, 0.21, 0.2);
        let pointed: f32 = rng.random();
        Self {
            half_width: rng.random_range(1.3..2.1),
            half_height: rng.random_range(0.32..0.55),
            length: rng.random_range(2.8..4.0),
            tip: (1.0 + 1.3 * pointed, 2.3 - 0.7 * pointed),
            groove: rng.random_range(0.0..0.6),
            colour: dark.lerp(pale, rng.random()) * rng.random_range(0.75..1.1),
            coat: rng.random_range(0.0..0.5),
            bumps: rng.random(),
            aim: Vec2::ZERO,
        }
    }

    /// Returns the same tongue with a direction of one picture.
    pub fn aimed(self, rng: &mut ChaCha8Rng) -> Self {
        let down = if rng.random_bool(0.08) { -0.35..0.6 } else { 0.6..1.4 };
        Self { aim: Vec2::new(normal(rng, 0.16, 0.5), rng.random_range(down)), ..self }
    }

    /// Returns the tongue in the mouth of a head, as far out as the coefficient says, unless the lips are shut.
    pub fn build(&self, rig: &Rig, below: &[u32], head: &[Vec3], out: f32) -> Option<Prop> {
        let [upper, lower, right, left] = [62, 66, 60, 64].map(|landmark| head[rig.landmarks[landmark]]);
        let gap = upper.y - lower.y;
        if out <= 0.0 || gap < SHUT {
            return None;
        }
        let mouth = right.distance(left);
        let half_width = self.half_width.min(MOST_OF_MOUTH * mouth);
        let half_height = self.half_height.min(0.2 + 0.3 * gap);
        // The lower lip rises towards its corners, and the tongue with it.
        let rise = (f32::midpoint(right.y, left.y) - lower.y).max(0.0) * (2.0 * half_width / mouth).powi(2);
        let reach = piecewise(&[(0.0, -BEHIND_LIP), JUST_OUT, (1.0, self.length)], out);
        let mut prop = Prop { lips: Some([upper, lower]), ..Prop::default() };
        let mut bumps = ChaCha8Rng::seed_from_u64(self.bumps);
        let lowered = 0.8 * smoothstep(JUST_OUT.0, 0.0, out);
        let mut centre = lower + Vec3::new(0.0, 0.7 * half_height - lowered + 0.1 * BEHIND_LIP, -BEHIND_LIP);
        let mut before = -BEHIND_LIP;
        for ring in 0..=RINGS {
            let to_tip = (reach + BEHIND_LIP) * (1.0 - f32::from(ring) / f32::from(RINGS)).powf(1.6);
            let along = reach - to_tip;
            let sideways = self.aim.x * smoothstep(-0.5, 1.5, along);
            let down = 0.1 + (self.aim.y * (0.4 + 0.6 * out) - 0.1) * smoothstep(-0.3, 2.2, along);
            let (side, ahead) = (Vec2::from_angle(sideways), Vec2::from_angle(down));
            let forward = Vec3::new(side.y * ahead.x, -ahead.y, side.x * ahead.x);
            let across = Vec3::new(side.x, 0.0, -side.y);
            let up = forward.cross(across);
            centre += (along - before) * forward;
            before = along;
            let round = |length: f32, power: f32| {
                let inside = (1.0 - to_tip / length).max(0.0);
                (1.0 - inside.powf(power)).max(0.0).powf(1.0 / power)
            };
            let width = half_width * round(self.tip.0, self.tip.1);
            let height = half_height * (0.5 + 0.5 * smoothstep(0.0, 2.5, to_tip)) * round(0.4, 2.0);
            let bend = rise + (0.1 * half_width - rise) * smoothstep(0.0, 1.5, along);
            let bend = |x: f32| bend * (x / half_width).powi(2);
            if along > -1.2 {
                let under = |vertex: &u32| {
                    let offset = head[*vertex as usize] - centre;
                    let (x, near) = (offset.dot(across), offset.dot(forward).abs() < 0.25);
                    if near && x.abs() < 0.8 * width { offset.dot(up) + 0.8 * height - bend(x) } else { 0.0 }
                };
                centre += below.iter().map(under).fold(0.0, f32::max).min(0.5) * up;
            }
            for step in 0..AROUND {
                let unit = Vec2::from_angle(f32::from(step) / f32::from(AROUND) * TAU);
                let x = width * unit.x;
                let top = unit.y.max(0.0);
                let middle = (-(x / (0.3 * half_width)).powi(2)).exp() * top * smoothstep(0.2, 1.5, to_tip);
                let bump: f32 = bumps.random_range(-1.0..1.0);
                let y = height * (unit.y - self.groove * middle) + bend(x) + 0.012 * bump * top;
                let coat = self.coat * top * (1.0 - 0.6 * middle) * smoothstep(0.3, 3.0, to_tip);
                let pale = self.colour.lerp(Vec3::new(0.66, 0.4, 0.37), coat);
                prop.vertex(centre + x * across + y * up, pale * (1.0 + 0.05 * bump - 0.3 * self.groove * middle));
            }
        }
        prop.tube(0, RINGS, AROUND);
        Some(prop)
    }
}

/// Returns the share of the light that a tongue leaves to a point of the lip or chin near it.
pub fn light_beside(tongue: &Prop, point: Vec3) -> f32 {
    let nearest = tongue.points.iter().step_by(7).map(|own| own.distance_squared(point)).fold(f32::INFINITY, f32::min);
    1.0 - 0.55 * (-nearest / 0.35).exp()
}

/// Returns the vertices that a tongue lies upon: lower teeth, lower lip and chin, which go down when the jaw opens.
pub fn below_tongue(rig: &Rig) -> Vec<u32> {
    let solid = vertices_of(&[&rig.parts.skin[..rig.parts.face], &rig.parts.teeth].concat());
    let lip = rig.landmark(66);
    let jaw = rig.shape("jawOpen").map_or(&[][..], |shape| &rig.shapes[shape].moves);
    let most = jaw.iter().map(|(_, offset)| -offset.y).fold(0.0, f32::max);
    let is_below = |(vertex, offset): &&(u32, Vec3)| {
        let from_lip = rig.neutral[*vertex as usize] - lip;
        let near = from_lip.x.abs() < 2.5 && from_lip.y > -4.0 && from_lip.z > -1.5;
        near && -offset.y > 0.7 * most && solid.binary_search(vertex).is_ok()
    };
    jaw.iter().filter(is_below).map(|(vertex, _)| *vertex).collect()
}
