//! Draws rooms and cameras: the lighting of a subject, and the effects of its camera.

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use turbojpeg::Subsamp;

use super::{
    camera::Effects,
    sample::normal,
    scene::{Light, Lighting},
};

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
    Lighting {
        ambient,
        lights: vec![key, fill, rim],
        shadows: rng.random_bool(SHADOWED),
        softness: rng.random_range(0.15..0.9),
    }
}

/// Draws the effects of a camera.
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
