//! The background of a picture: a gradient with soft and sharp shapes, like a room that is out of focus.

use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::geometry::smoothstep;

/// Pixels of the picture per cell of the backdrop.
const CELL: usize = 6;
/// Largest number of shapes.
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
    /// Generates a random backdrop for pictures of `size`. `light` is the mean light of the room.
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

    /// Makes the backdrop even, with the mean of its colours.
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
