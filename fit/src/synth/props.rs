//! Things on and before a face: meshes with colours, which move with the head.

use core::f32::consts::TAU;

use glam::{Mat3, Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::rig::{Rig, Triangle};

/// Segments of an ellipsoid around its axis, and from pole to pole.
const AROUND: u16 = 18;
const ALONG: u16 = 12;

#[derive(Debug, Clone, Default)]
pub struct Prop {
    pub points: Vec<Vec3>,
    pub colours: Vec<Vec3>,
    pub triangles: Vec<Triangle>,
    pub lens: Option<Lens>,
    /// For a tongue: the middle of both lips. It is moist, and the darker the farther it lies behind them.
    pub lips: Option<[Vec3; 2]>,
}

/// Returns the share of the light at a depth behind the lips. The less they are open, the faster the light falls off.
pub fn light_in_mouth([upper, lower]: [Vec3; 2], z: f32) -> f32 {
    let gap = (upper - lower).length();
    let behind = f32::midpoint(upper.z, lower.z) - z - 0.3;
    (0.3 + 0.6 * gap).min(1.0) * (-behind.max(0.0) / (1.2 + 0.6 * gap)).exp()
}

#[derive(Debug, Clone, Copy)]
pub struct Lens {
    /// Share of the light that the lens absorbs.
    pub tint: f32,
    /// Reflection of a window: its direction and offset on the lens in centimetres, its width, and its strength.
    pub glare: (Vec2, f32, f32, f32),
}

impl Lens {
    /// Returns the strength of the window's reflection at a position in the plane of the glasses.
    pub fn glare_at(&self, position: Vec2) -> f32 {
        let (across, offset, width, strength) = self.glare;
        let beyond = ((position.dot(across) - offset).abs() / width).min(1.0);
        strength * (1.0 - beyond * beyond * beyond)
    }
}

impl Prop {
    pub fn vertex(&mut self, point: Vec3, colour: Vec3) -> u32 {
        self.points.push(point);
        self.colours.push(colour);
        u32::try_from(self.points.len() - 1).unwrap_or(u32::MAX)
    }

    /// Adds a quadrilateral that is visible from both sides. The corners run around it.
    pub fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        self.triangles.extend([[a, b, c], [a, c, d], [a, c, b], [a, d, c]]);
    }

    /// Adds an ellipsoid with half axes in the columns of `axes`, and a colour for each point of the unit sphere.
    pub fn ellipsoid(&mut self, centre: Vec3, axes: Mat3, colour: impl Fn(Vec3) -> Vec3) {
        let first = u32::try_from(self.points.len()).unwrap_or(u32::MAX);
        for ring in 0..=ALONG {
            let height = f32::from(ring) / f32::from(ALONG) * core::f32::consts::PI;
            for step in 0..AROUND {
                let around = Vec2::from_angle(f32::from(step) / f32::from(AROUND) * core::f32::consts::TAU);
                let unit = Vec3::new(around.x * height.sin(), height.cos(), around.y * height.sin());
                self.vertex(centre + axes * unit, colour(unit));
            }
        }
        self.tube(first, ALONG, AROUND);
    }

    /// Joins rings of `around` vertices each, from the vertex `first` on, by triangles that are visible from outside.
    pub fn tube(&mut self, first: u32, along: u16, around: u16) {
        let at = |ring: u16, step: u16| first + u32::from(ring * around + step % around);
        for (ring, step) in (0..along).flat_map(|ring| (0..around).map(move |step| (ring, step))) {
            let [a, b, c, d] = [at(ring, step), at(ring, step + 1), at(ring + 1, step + 1), at(ring + 1, step)];
            self.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
}

const OUTLINE: u16 = 28;
/// Distance of the lenses from the bridge of the nose in centimetres, and their curvature towards the sides.
const BEFORE: f32 = 0.45;
const CURVE: f32 = 0.022;

/// The style of a pair of glasses. Lengths are in centimetres.
#[derive(Debug, Clone)]
pub struct Glasses {
    half: Vec2,
    /// Exponent of the outline: 2 for an ellipse; large for a rectangle.
    corner: f32,
    rim: f32,
    lift: f32,
    colour: Vec3,
    lens: Lens,
}

impl Glasses {
    /// Makes the lenses those of sunglasses.
    pub fn darken(&mut self, rng: &mut ChaCha8Rng) {
        self.lens.tint = rng.random_range(0.75..0.98);
    }

    /// Makes the rims thick, and lets a window show in the lenses.
    pub fn thicken(&mut self, rng: &mut ChaCha8Rng) {
        self.rim = rng.random_range(0.35..0.6);
        self.lens.glare.3 = rng.random_range(0.3..0.8);
    }

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

    pub fn build(&self, rig: &Rig, base: &[Vec3]) -> [Prop; 2] {
        let at = |landmark: usize| base[rig.landmarks[landmark]];
        let bridge = at(27);
        let surface = |x: f32, y: f32| Vec3::new(x, y, bridge.z + BEFORE - CURVE * x * x);
        let (mut frame, mut lenses) = (Prop::default(), Prop { lens: Some(self.lens), ..Prop::default() });
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

    fn outline(&self, angle: f32, half: Vec2) -> Vec2 {
        let round = Vec2::from_angle(angle);
        let stretched = |value: f32| value.signum() * value.abs().powf(2.0 / self.corner);
        half * Vec2::new(stretched(round.x), stretched(round.y))
    }

    fn add_ring(&self, frame: &mut Prop, lines: [Vec<Vec3>; 2]) {
        let [inner, outer] =
            lines.map(|line| line.into_iter().map(|point| frame.vertex(point, self.colour)).collect::<Vec<u32>>());
        let count = inner.len();
        for one in 0..count {
            let next = (one + 1) % count;
            frame.quad([inner[one], outer[one], outer[next], inner[next]]);
        }
    }

    fn add_bar(&self, frame: &mut Prop, from: Vec3, to: Vec3) {
        let half = Vec3::Y * self.rim.max(0.12) * 0.6;
        let corners = [from - half, to - half, to + half, from + half].map(|point| frame.vertex(point, self.colour));
        frame.quad(corners);
    }
}
