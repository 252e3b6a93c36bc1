//! Lights vertices: ambient light, lamps with a soft shadow, and specular highlights.
//!
//! Vertices are about as dense as pixels, so light is computed per vertex and interpolated. Subsurface scattering is
//! approximated by a wrapped cosine with a wider wrap for red, because skin transmits more red than blue light.

use glam::{Mat3, Vec2, Vec3, Vec3A};
use rayon::prelude::*;

use super::canvas::{Grid, Position};
use super::rig::Triangle;

/// Wrap of the cosine on skin, and on other materials.
const SKIN_WRAP: Vec3 = Vec3::new(0.42, 0.17, 0.11);
const HARD_WRAP: Vec3 = Vec3::splat(0.08);
const FRESNEL: f32 = 0.03;
const SKY_GLOSS: f32 = 0.02;
/// Vertices that face away further than this (cosine) are invisible and not lit.
const HIDDEN: f32 = -0.35;

#[derive(Debug, Clone, Copy)]
pub struct Light {
    pub toward: Vec3,
    /// Colour in linear light, about 0 to 1.
    pub colour: Vec3,
}

#[derive(Debug, Clone)]
pub struct Lighting {
    /// Ambient light as spherical harmonics of degree 0 and 1: its mean, and its gradient along x, y and z.
    pub ambient: [Vec3; 4],
    pub lights: Vec<Light>,
    /// Whether the first of `lights` casts shadows.
    pub shadows: bool,
    /// Width of the penumbra in centimetres.
    pub softness: f32,
}

impl Lighting {
    pub fn ambient(&self, normal: Vec3) -> Vec3 {
        let [mean, x, y, z] = self.ambient;
        (mean + normal.x * x + normal.y * y + normal.z * z).max(Vec3::ZERO)
    }
}

#[derive(Debug, Clone, Copy, Default)]
pub struct VertexLight {
    pub diffuse: Vec3A,
    pub gloss: Vec3A,
}

#[derive(Debug, Clone, Copy)]
pub struct Surface {
    pub point: Vec3,
    pub normal: Vec3,
    pub sky: f32,
    pub skin: bool,
}

pub fn shade(lighting: &Lighting, shadow: &DepthMap, surface: &Surface) -> VertexLight {
    let view = -surface.point.normalize_or_zero();
    if surface.normal.dot(view) < HIDDEN {
        return VertexLight::default();
    }
    let sky = lighting.ambient(surface.normal) * surface.sky;
    let mut lit = VertexLight { diffuse: sky.into(), gloss: Vec3A::ZERO };
    let dark = if surface.skin { -SKIN_WRAP.x } else { -HARD_WRAP.x };
    for (index, lamp) in lighting.lights.iter().enumerate() {
        if surface.normal.dot(lamp.toward) <= dark {
            continue;
        }
        let open = if index == 0 && lighting.shadows {
            let lifted = surface.point + 0.15 * surface.normal;
            shadow.light_at(lifted, lighting.softness * shadow.cells_per_cm) * surface.sky.sqrt().sqrt()
        } else {
            surface.sky.sqrt()
        };
        add_lamp(&mut lit, lamp, surface, view, open);
    }
    lit.gloss += Vec3A::from(lighting.ambient(-view.reflect(surface.normal)) * surface.sky * SKY_GLOSS);
    lit
}

fn add_lamp(lit: &mut VertexLight, lamp: &Light, surface: &Surface, view: Vec3, open: f32) {
    let wrap = if surface.skin { SKIN_WRAP } else { HARD_WRAP };
    let cosine = surface.normal.dot(lamp.toward);
    lit.diffuse += Vec3A::from(lamp.colour * open * ((wrap + cosine) / (1.0 + wrap)).max(Vec3::ZERO));
    if cosine > 0.0 {
        let half = (lamp.toward + view).normalize_or_zero();
        let grazing = 1.0 - half.dot(view).max(0.0);
        let square = grazing * grazing;
        let grazing = FRESNEL + (1.0 - FRESNEL) * square * square * grazing;
        let share = open * grazing * cosine * highlight(surface.normal.dot(half).max(0.0));
        lit.gloss += Vec3A::from(lamp.colour * share);
    }
}

/// Returns the sum of two normalised Blinn-Phong lobes: 0.7 with exponent 12, and 0.3 with exponent 42.
fn highlight(cosine: f32) -> f32 {
    let square = cosine * cosine;
    let fourth = square * square;
    let eighth = fourth * fourth;
    let wide = eighth * fourth;
    let narrow = eighth * eighth * eighth * eighth * eighth * square;
    0.7 * 20.0 / 8.0 * wide + 0.3 * 50.0 / 8.0 * narrow
}

/// Surfaces cast a shadow on points that are further behind than this, in centimetres, so not on themselves.
const BIAS_CM: f32 = 0.12;
/// Number of directions for ambient occlusion, and cells per side of their maps.
const DIRECTIONS: u16 = 64;
const AMBIENT_SIDE: usize = 160;

/// Depths of the head, as seen from an infinite distance in one direction.
pub struct DepthMap {
    grid: Grid,
    depths: Vec<f32>,
    /// Rows: right, down, and towards the viewer.
    axes: Mat3,
    corner: Vec2,
    cells_per_cm: f32,
    seen: Vec<(Position, f32)>,
}

impl DepthMap {
    pub fn new(side: usize) -> Self {
        let grid = Grid { width: side, height: side };
        let depths = vec![0.0; side * side];
        Self { grid, depths, axes: Mat3::IDENTITY, corner: Vec2::ZERO, cells_per_cm: 1.0, seen: Vec::new() }
    }

    /// Draws the triangles as seen from the direction `toward`. The map covers `bounds` (centre, radius).
    pub fn draw(
        &mut self,
        toward: Vec3,
        bounds: (Vec3, f32),
        points: impl IntoIterator<Item = Vec3>,
        triangles: &[Triangle],
    ) {
        let toward = toward.normalize_or(Vec3::Z);
        let right = toward.any_orthonormal_vector();
        self.axes = Mat3::from_cols(right, right.cross(toward), toward).transpose();
        let (centre, radius) = bounds;
        self.cells_per_cm = self.grid.width as f32 / (2.0 * radius);
        self.corner = (self.axes * centre).truncate() - radius;
        self.depths.fill(f32::NEG_INFINITY);
        let mut seen = core::mem::take(&mut self.seen);
        seen.clear();
        seen.extend(
            points.into_iter().map(|point| self.project(point)).map(|(cell, depth)| (Position::new(cell), depth)),
        );
        let window = self.grid.whole();
        for [a, b, c] in triangles {
            let [(one, near), (two, middle), (three, far)] = [seen[*a as usize], seen[*b as usize], seen[*c as usize]];
            let depths = Vec3::new(near, middle, far);
            let Some(covered) = window.cover([one, two, three]) else { continue };
            covered.each(|index, weights| self.depths[index] = self.depths[index].max(weights.dot(depths)));
        }
        self.seen = seen;
    }

    fn project(&self, point: Vec3) -> (Vec2, f32) {
        let seen = self.axes * point;
        ((seen.truncate() - self.corner) * self.cells_per_cm, seen.z)
    }

    /// Returns the share of the light that reaches a point, from 0 to 1, sampled over `spread` cells around it.
    pub fn light_at(&self, point: Vec3, spread: f32) -> f32 {
        let (cell, depth) = self.project(point);
        let offsets = [-1.0, 0.0, 1.0].map(|step| step * spread);
        let taps = offsets.iter().flat_map(|dx| offsets.iter().map(move |dy| Vec2::new(*dx, *dy)));
        let open = taps.filter(|offset| self.depth_at(cell + *offset) < depth + BIAS_CM).count();
        open as f32 / 9.0
    }

    fn depth_at(&self, cell: Vec2) -> f32 {
        let inside = cell.min_element() >= 0.0 && cell.max_element() < self.grid.width as f32;
        if inside { self.depths[cell.y as usize * self.grid.width + cell.x as usize] } else { f32::NEG_INFINITY }
    }
}

/// Returns the cosine-weighted share of the sky that is visible from each vertex, from 0 to 1.
pub fn ambient_occlusion(points: &[Vec3], normals: &[Vec3], triangles: &[Triangle], bounds: (Vec3, f32)) -> Vec<f32> {
    let seen_from = |index: u16| {
        let toward = direction(index);
        let mut map = DepthMap::new(AMBIENT_SIDE);
        map.draw(toward, bounds, points.iter().copied(), triangles);
        let one = |(point, normal): (&Vec3, &Vec3)| {
            let cosine = normal.dot(toward).max(0.0);
            if cosine > 0.0 { [cosine, cosine * map.light_at(*point + 0.1 * *normal, 0.7)] } else { [0.0; 2] }
        };
        points.iter().zip(normals).map(one).collect()
    };
    let seen: Vec<Vec<[f32; 2]>> = (0..DIRECTIONS).into_par_iter().map(seen_from).collect();
    let share = |vertex: usize| {
        let [all, open] = seen.iter().fold([0.0; 2], |sum, map| [sum[0] + map[vertex][0], sum[1] + map[vertex][1]]);
        if all > 0.0 { open / all } else { 0.0 }
    };
    (0..points.len()).map(share).collect()
}

/// Returns one of the directions, which are evenly distributed over the sphere (Fibonacci lattice).
fn direction(index: u16) -> Vec3 {
    let height = 1.0 - (2.0 * f32::from(index) + 1.0) / f32::from(DIRECTIONS);
    let around = Vec2::from_angle(f32::from(index) * 2.399_963_3) * (1.0 - height * height).sqrt();
    Vec3::new(around.x, height, around.y)
}
