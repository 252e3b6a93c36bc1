//! The scene of one picture: expression and pose of a head, its lighting, and the lens.
//!
//! In world coordinates, the camera is at the origin, with x to the right in the picture (the left of a person who
//! faces the camera), y up, and z towards the camera. Units are centimetres.

use std::ops::Range;
use std::sync::Arc;

use glam::{Mat3, Quat, Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use turbojpeg::Subsamp;

use super::camera::Effects;
use super::expression::{Coefficients, head_rotation};
use super::props::Prop;
use super::rig::{normal, smoothstep};
use super::shade::{Light, Lighting};
use super::tongue::Tongue;

pub const PIVOT: Vec3 = Vec3::new(0.0, -1.0, 3.0);
/// Width of a face seen from the front in centimetres.
pub const FACE_CM: f32 = 14.5;
/// The approximate position of the tip of the nose.
const NOSE: Vec3 = Vec3::new(0.0, 0.4, 13.0);
const SHOULDERS: f32 = 0.25;

#[derive(Debug, Clone, Copy)]
pub struct Lens {
    pub size: [usize; 2],
    pub focal_px: f32,
}

#[derive(Debug, Clone, Copy)]
pub struct Placement {
    /// Yaw to the person's left, pitch nodding down, and roll to the right shoulder. All are 0 when facing the camera.
    pub angles_deg: [f32; 3],
    pub position: Vec3,
}

#[derive(Debug, Clone)]
pub struct Scene {
    pub weights: Coefficients,
    pub placement: Placement,
    pub lighting: Lighting,
    pub lens: Lens,
    pub props: Vec<Arc<Prop>>,
    pub tongue: Tongue,
}

impl Scene {
    pub fn nose(&self) -> Option<Vec2> {
        let mut tip = [NOSE];
        self.placement.place(&mut tip, [0.0]);
        self.lens.project(tip[0]).map(|(pixel, _)| pixel)
    }
}

impl Lens {
    /// Projects a point to its pixel position and inverse depth. Returns `None` for points at or behind the camera.
    pub fn project(&self, point: Vec3) -> Option<(Vec2, f32)> {
        let inverse_depth = 1.0 / -point.z;
        let centre = Vec2::new(self.size[0] as f32, self.size[1] as f32) / 2.0;
        let offset = self.focal_px * inverse_depth * Vec2::new(point.x, -point.y);
        (point.z < -1.0).then(|| (centre + offset, inverse_depth))
    }
}

impl Placement {
    fn rotations(&self) -> [Mat3; 2] {
        let [yaw, pitch, roll] = self.angles_deg;
        let facing = Mat3::from_quat(Quat::from_rotation_arc(Vec3::Z, (-self.position).normalize_or(Vec3::Z)));
        [1.0, SHOULDERS].map(|share| facing * head_rotation(share * yaw, share * pitch, share * roll))
    }

    /// Moves points of the rig to the world. `shoulder` is the weight of the shoulders' rotation for each point.
    pub fn place(&self, points: &mut [Vec3], shoulder: impl IntoIterator<Item = f32>) {
        let [head, body] = self.rotations();
        for (point, share) in points.iter_mut().zip(shoulder) {
            let offset = *point - PIVOT;
            let turned = head * offset;
            let blended = if share > 0.0 { turned.lerp(body * offset, share) } else { turned };
            *point = self.position + blended;
        }
    }
}

fn direction(rng: &mut ChaCha8Rng, toward: Vec3, spread: f32) -> Vec3 {
    let away = Vec3::from_array(core::array::from_fn(|_| normal(rng, spread, 3.0)));
    (toward + away).normalize_or(Vec3::Y)
}

fn warmth(rng: &mut ChaCha8Rng) -> Vec3 {
    let warm: f32 = rng.random_range(-0.12..0.3);
    Vec3::new(1.0 + 0.5 * warm, 1.0, 1.0 - warm)
}

/// Share of the rooms whose key light casts shadows on the face. In the others it is soft.
const SHADOWED: f64 = 0.6;

/// Draws a lighting, from flat and bright to a single hard lamp at the side.
pub fn random_lighting(rng: &mut ChaCha8Rng) -> Lighting {
    let flat: f32 = rng.random_range(0.15..0.95);
    let mean = warmth(rng) * (0.12 + 0.5 * flat);
    let tilt = |rng: &mut ChaCha8Rng, bias: f32| mean * (bias + normal(rng, 0.25, 0.5));
    let ambient = [mean, tilt(rng, 0.0), tilt(rng, 0.3), tilt(rng, 0.15)];
    let mut lamp = |toward: [f32; 3], spread: f32, share: f32, strength: Range<f32>| Light {
        toward: direction(rng, toward.into(), spread),
        colour: warmth(rng) * share * rng.random_range(strength),
    };
    let key = lamp([0.0, 0.5, 1.0], 0.7, 1.1 - 0.75 * flat, 0.7..1.2);
    let fill = lamp([0.0, 0.2, 0.7], 1.0, 1.0, 0.0..0.35);
    let rim = lamp([0.0, 0.5, -0.8], 0.8, 1.0, 0.0..0.6);
    let (lights, shadows) = (vec![key, fill, rim], rng.random_bool(SHADOWED));
    Lighting { ambient, lights, shadows, softness: rng.random_range(0.15..0.9) }
}

pub fn random_effects(rng: &mut ChaCha8Rng) -> Effects {
    let noise: f32 = rng.random_range(0.002..0.025);
    Effects {
        defocus_px: if rng.random_bool(0.4) { rng.random_range(0.35..1.3) } else { 0.0 },
        motion_px: Vec2::ZERO,
        exposure: warmth(rng) * rng.random_range(0.65..1.15),
        vignette: rng.random_range(0.0..0.3),
        noise: [noise, noise * rng.random_range(0.05..0.3)],
        contrast: rng.random_range(0.85..1.2),
        sharpening: if rng.random_bool(0.4) { rng.random_range(0.2..1.0) } else { 0.0 },
        jpeg_quality: rng.random_range(60..=95),
        chroma: if rng.random() { Subsamp::Sub2x1 } else { Subsamp::Sub2x2 },
    }
}

// The background of a picture: a gradient with soft and sharp shapes, like a room that is out of focus.

const CELL: usize = 6;
const SHAPES: u8 = 14;

#[derive(Debug, Clone)]
pub struct Backdrop {
    size: [usize; 2],
    cells: Vec<Vec3>,
}

struct Shape {
    centre: Vec2,
    half: Vec2,
    turn: Vec2,
    round: bool,
    edge: f32,
    colour: Vec3,
    opacity: f32,
}

impl Backdrop {
    pub fn random(rng: &mut ChaCha8Rng, size: [usize; 2], light: Vec3) -> Self {
        let size = size.map(|side| side.div_ceil(CELL) + 1);
        let wall = random_colour(rng) * light;
        let slope = Vec2::from_angle(rng.random_range(0.0..core::f32::consts::TAU)) * rng.random_range(0.0..0.6);
        let count = if rng.random_bool(0.25) { 0 } else { rng.random_range(2..=SHAPES) };
        let shapes: Vec<Shape> = (0..count).map(|_| Shape::random(rng, light)).collect();
        let cell = |index: usize| {
            let position = Vec2::new((index % size[0]) as f32, (index / size[0]) as f32);
            let position = position / size[0] as f32 - Vec2::new(0.5, 0.5 * size[1] as f32 / size[0] as f32);
            let start = wall * (1.0 + slope.dot(position)).max(0.1);
            shapes.iter().fold(start, |colour, shape| colour.lerp(shape.colour, shape.cover(position)))
        };
        Self { cells: (0..size[0] * size[1]).map(cell).collect(), size }
    }

    pub fn flatten(&mut self) {
        let mean = self.cells.iter().sum::<Vec3>() / self.cells.len().max(1) as f32;
        self.cells.fill(mean);
    }

    pub fn fill(&self, width: usize, pixels: &mut [[f32; 3]]) {
        for (row, line) in pixels.chunks_exact_mut(width).enumerate() {
            let (upper, down) = (row / CELL, (row % CELL) as f32 / CELL as f32);
            for (cell, run) in line.chunks_mut(CELL).enumerate() {
                let at = |dx: usize, dy: usize| self.cells[(upper + dy) * self.size[0] + cell + dx];
                let (left, right) = (at(0, 0).lerp(at(0, 1), down), at(1, 0).lerp(at(1, 1), down));
                let step = (right - left) / CELL as f32;
                let mut colour = left;
                for pixel in run {
                    *pixel = colour.to_array();
                    colour += step;
                }
            }
        }
    }
}

/// Returns a colour for a wall or an object in linear light. Most colours are unsaturated.
fn random_colour(rng: &mut ChaCha8Rng) -> Vec3 {
    let level = rng.random_range(0.02_f32..0.9).powf(1.4);
    let hue = Vec3::new(rng.random(), rng.random(), rng.random());
    level * Vec3::ONE.lerp(2.0 * hue, rng.random_range(0.0_f32..0.8).powi(2))
}

impl Shape {
    fn random(rng: &mut ChaCha8Rng, light: Vec3) -> Self {
        let lamp = rng.random_bool(0.08);
        Self {
            centre: Vec2::new(rng.random_range(-0.6..0.6), rng.random_range(-0.6..0.6)),
            half: Vec2::new(rng.random_range(0.02..0.35), rng.random_range(0.02..0.4)),
            turn: Vec2::from_angle(if rng.random_bool(0.7) { 0.0 } else { rng.random_range(-0.6..0.6) }),
            round: rng.random_bool(0.35),
            edge: rng.random_range(0.01..0.12),
            colour: random_colour(rng) * light * if lamp { 4.0 } else { 1.0 },
            opacity: rng.random_range(0.4..1.0),
        }
    }

    fn cover(&self, position: Vec2) -> f32 {
        let offset = self.turn.rotate(position - self.centre).abs() - self.half;
        let beyond = if self.round {
            (((offset + self.half) / self.half).length() - 1.0) * self.half.min_element()
        } else {
            offset.max_element()
        };
        self.opacity * (1.0 - smoothstep(-self.edge, self.edge, beyond))
    }
}
