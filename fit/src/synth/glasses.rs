//! Glasses: two lenses in a frame, with a bridge over the nose and temples to the ears.

use core::f32::consts::TAU;

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{
    props::{Lens, Prop},
    rig::Rig,
};

/// Points of the outline of a lens.
const OUTLINE: u16 = 28;
/// Distance of the lenses from the bridge of the nose in centimetres, and their curvature towards the sides.
const BEFORE: f32 = 0.45;
const CURVE: f32 = 0.022;

/// The style of a pair of glasses. Lengths are in centimetres.
#[derive(Debug, Clone)]
pub struct Style {
    /// Half width and half height of a lens.
    half: Vec2,
    /// Exponent of the outline: 2 for an ellipse; large for a rectangle.
    corner: f32,
    /// Width of the rim.
    rim: f32,
    /// Height of the lenses above the eyes.
    lift: f32,
    colour: Vec3,
    lens: Lens,
}

impl Style {
    /// Draws a style: mostly clear lenses in a dark or coloured frame, sometimes sunglasses.
    pub fn random(rng: &mut ChaCha8Rng) -> Self {
        let hue = Vec3::new(rng.random(), rng.random(), rng.random());
        let dark: bool = rng.random_bool(0.2);
        let across = Vec2::from_angle(rng.random_range(0.0..TAU));
        let glare = if rng.random_bool(0.6) { rng.random_range(0.05..0.7) } else { 0.0 };
        Self {
            half: Vec2::new(rng.random_range(2.25..2.75), rng.random_range(1.4..2.2)),
            corner: rng.random_range(2.0..5.0),
            rim: if rng.random_bool(0.25) { 0.07 } else { rng.random_range(0.1..0.45) },
            lift: rng.random_range(-0.5..0.05),
            colour: hue.powf(2.0) * rng.random_range(0.0_f32..0.8).powi(2),
            lens: Lens {
                tint: if dark { rng.random_range(0.6..0.95) } else { rng.random_range(0.02..0.15) },
                glare: (across, rng.random_range(-3.0..3.0), rng.random_range(0.3..1.2), glare),
            },
        }
    }

    /// Returns frame and lenses, fitted to a head with the vertices `base`.
    pub fn build(&self, rig: &Rig, base: &[Vec3]) -> [Prop; 2] {
        let at = |landmark: usize| base[rig.landmarks[landmark]];
        let bridge = at(27);
        let surface = |x: f32, y: f32| Vec3::new(x, y, bridge.z + BEFORE - CURVE * x * x);
        let (mut frame, mut lenses) = (Prop::new(None), Prop::new(Some(self.lens)));
        let mut inner_ends = Vec::new();
        for (outer_corner, inner_corner, ear, side) in [(36, 39, 0, -1.0_f32), (45, 42, 16, 1.0)] {
            let eye = (at(outer_corner) + at(inner_corner)) / 2.0;
            let half = self.half.min(Vec2::new(eye.x.abs() - 0.45 - self.rim, f32::INFINITY));
            let centre = Vec2::new(eye.x, eye.y + self.lift);
            let outline = |grow: f32| {
                (0..OUTLINE)
                    .map(move |step| centre + self.outline(f32::from(step) / f32::from(OUTLINE) * TAU, half + grow))
            };
            let edge: Vec<Vec2> = outline(0.0).collect();
            let rim: Vec<Vec2> = outline(self.rim).collect();
            self.add_ring(&mut frame, [&edge, &rim].map(|line| line.iter().map(|at| surface(at.x, at.y)).collect()));
            let middle = lenses.vertex(surface(centre.x, centre.y), Vec3::ZERO);
            let edge: Vec<u32> = edge.iter().map(|at| lenses.vertex(surface(at.x, at.y), Vec3::ZERO)).collect();
            for (one, next) in edge.iter().zip(edge.iter().cycle().skip(1)) {
                lenses.triangles.push([middle, *one, *next]);
            }
            let end = Vec2::new(centre.x + side * (half.x + self.rim), centre.y + 0.4 * half.y);
            let ear = at(ear) + Vec3::new(side * 0.9, 1.0, -2.5);
            self.add_bar(&mut frame, surface(end.x, end.y), ear);
            inner_ends.push(surface(centre.x - side * (half.x + 0.5 * self.rim), centre.y + 0.35 * half.y));
        }
        if let [right, left] = inner_ends[..] {
            self.add_bar(&mut frame, right, left);
        }
        [frame, lenses]
    }

    /// Returns a point of a superellipse.
    fn outline(&self, angle: f32, half: Vec2) -> Vec2 {
        let round = Vec2::from_angle(angle);
        let stretched = |value: f32| value.signum() * value.abs().powf(2.0 / self.corner);
        half * Vec2::new(stretched(round.x), stretched(round.y))
    }

    /// Adds a band between two closed lines.
    fn add_ring(&self, frame: &mut Prop, lines: [Vec<Vec3>; 2]) {
        let [inner, outer] =
            lines.map(|line| line.into_iter().map(|point| frame.vertex(point, self.colour)).collect::<Vec<u32>>());
        let count = inner.len();
        for one in 0..count {
            let next = (one + 1) % count;
            frame.quad([inner[one], outer[one], outer[next], inner[next]]);
        }
    }

    /// Adds an upright bar between two points.
    fn add_bar(&self, frame: &mut Prop, from: Vec3, to: Vec3) {
        let half = Vec3::Y * self.rim.max(0.12) * 0.6;
        let corners = [from - half, to - half, to + half, from + half].map(|point| frame.vertex(point, self.colour));
        frame.quad(corners);
    }
}
