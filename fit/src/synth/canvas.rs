//! The samples of a picture with colour and depth, which are averaged to pixels at the end.
//!
//! The density of samples need not be a whole number per pixel. A pixel is the mean over its square, in which samples
//! at its edge count with the share that lies inside.

use core::ops::Range;

use glam::{Vec2, Vec3, Vec3A, Vec4};

use super::rig::Triangle;

pub const MOST_SAMPLES: f32 = 2.0;
/// Ratio of inverse depths from which on a point lies behind another part of the head, and not on the same surface.
const BEHIND: f32 = 1.03;

pub struct Canvas {
    pub grid: Grid,
    pub density: Vec2,
    size: [usize; 2],
    /// Inverse of each sample's distance, or 0 if nothing was drawn there.
    inverse_depth: Vec<f32>,
    colour: Vec<Vec4>,
    /// How much of what lies behind it hides, by what is on or before the face, from 0 to 1.
    veil: Vec<f32>,
    row: Vec<Vec4>,
    columns: Vec<Footprint>,
}

#[derive(Debug, Clone)]
struct Footprint {
    samples: Range<usize>,
    weights: [f32; 4],
}

impl Canvas {
    pub fn new(size: [usize; 2]) -> Self {
        Self {
            grid: Grid { width: 0, height: 0 },
            density: Vec2::ONE,
            size,
            inverse_depth: Vec::new(),
            colour: Vec::new(),
            veil: Vec::new(),
            row: Vec::new(),
            columns: Vec::new(),
        }
    }

    /// Clears the canvas for a picture with this many samples per side of a pixel, from 1 to [`MOST_SAMPLES`].
    pub fn clear(&mut self, density: f32) {
        let [width, height] = self.size.map(|side| (side as f32 * density.clamp(1.0, MOST_SAMPLES)).round() as usize);
        let count = width * height;
        self.grid = Grid { width, height };
        self.density = Vec2::new(width as f32 / self.size[0] as f32, height as f32 / self.size[1] as f32);
        self.inverse_depth.clear();
        self.inverse_depth.resize(count, 0.0);
        self.colour.clear();
        self.colour.resize(count, Vec4::ZERO);
        self.veil.clear();
        self.veil.resize(count, 0.0);
        self.columns = (0..self.size[0]).map(|pixel| Footprint::new(pixel, self.density.x, width)).collect();
    }

    #[inline]
    pub fn is_visible(&self, index: usize, inverse_depth: f32) -> bool {
        inverse_depth >= self.inverse_depth[index]
    }

    #[inline]
    pub fn set(&mut self, index: usize, inverse_depth: f32, colour: Vec3A) {
        self.inverse_depth[index] = inverse_depth;
        self.colour[index] = colour.extend(1.0);
    }

    /// Blends a colour over the sample, if something was drawn there.
    #[inline]
    pub fn blend(&mut self, index: usize, alpha: f32, colour: Vec3A) {
        let slot = &mut self.colour[index];
        *slot = slot.lerp(colour.extend(1.0) * slot.w, alpha);
    }

    /// Notes that this share of the sample is hidden.
    #[inline]
    pub fn hide(&mut self, index: usize, share: f32) {
        let slot = &mut self.veil[index];
        *slot = slot.max(share);
    }

    /// Returns which share is in view of a point at this position and inverse depth. Nothing is outside the picture.
    pub fn view(&self, position: Position, inverse_depth: f32) -> f32 {
        let [x, y] = position.samples().to_array();
        if !(x >= 0.0 && y >= 0.0 && x < self.grid.width as f32 && y < self.grid.height as f32) {
            return 0.0;
        }
        let index = y as usize * self.grid.width + x as usize;
        let is_behind = self.inverse_depth[index] > BEHIND * inverse_depth;
        if is_behind { 0.0 } else { 1.0 - self.veil[index] }
    }

    pub fn resolve(&mut self, pixels: &mut [[f32; 3]]) {
        let Self { grid, density, size, colour, row: mean, columns, .. } = self;
        for (number, line) in pixels.chunks_exact_mut(size[0]).enumerate() {
            let rows = Footprint::new(number, density.y, grid.height);
            mean.clear();
            mean.resize(grid.width, Vec4::ZERO);
            let lines = colour.chunks_exact(grid.width).skip(rows.samples.start).take(rows.samples.len());
            for (samples, weight) in lines.zip(rows.weights) {
                mean.iter_mut().zip(samples).for_each(|(mean, sample)| *mean += weight * *sample);
            }
            for (pixel, columns) in line.iter_mut().zip(&*columns) {
                let samples = mean[columns.samples.clone()].iter().zip(columns.weights);
                let seen: Vec4 = samples.map(|(sample, weight)| weight * *sample).sum();
                *pixel = (Vec3::from_array(*pixel) * (1.0 - seen.w) + seen.truncate()).to_array();
            }
        }
    }
}

impl Footprint {
    fn new(pixel: usize, density: f32, limit: usize) -> Self {
        let (from, to) = (pixel as f32 * density, (pixel + 1) as f32 * density);
        let first = (from + 1e-3) as usize;
        let end = ((to - 1e-3).ceil() as usize).min(limit);
        let mut weights = [0.0; 4];
        for (weight, sample) in weights.iter_mut().zip(first..end) {
            *weight = ((sample + 1) as f32).min(to) - (sample as f32).max(from);
        }
        let sum: f32 = weights.iter().sum();
        Self { samples: first..end, weights: weights.map(|weight| weight / sum) }
    }
}

// Rasterises triangles: determines which samples of a grid a triangle covers, with their barycentric coordinates.
//
// Positions are snapped to 1/256 of a sample and edge functions are integers, with the top-left rule. Of triangles
// that share an edge, exactly one covers a sample on it, so that there are neither cracks nor overlaps. Contract: no
// sample outside the grid is visited. Limits: triangles with corners more than 16,000 samples from the origin are
// skipped.

const STEPS: f32 = 256.0;
const STEP: i64 = 256;
/// Largest coordinate of a corner for which the edge functions do not overflow.
const FARTHEST: f32 = 16_000.0;
/// Adding and subtracting this number rounds an f32 below 2^22 to an integer: 1.5 x 2^23, where the spacing is 1.
const ROUNDER: f32 = 12_582_912.0;

#[derive(Debug, Clone, Copy)]
pub struct Grid {
    pub width: usize,
    pub height: usize,
}

/// A position among the samples, in 1/256 of a sample.
#[derive(Debug, Clone, Copy)]
pub struct Position([i32; 2]);

impl Position {
    /// A position that belongs to no triangle that is drawn.
    pub const NOWHERE: Self = Self([i32::MAX; 2]);

    /// Snaps a position. What is far outside of any grid, or no number, becomes [`Position::NOWHERE`].
    pub fn new(position: Vec2) -> Self {
        if !(position.x.abs() < FARTHEST && position.y.abs() < FARTHEST) {
            return Self::NOWHERE;
        }
        let rounded = position * STEPS + ROUNDER - ROUNDER;
        Self([rounded.x as i32, rounded.y as i32])
    }

    pub fn samples(self) -> Vec2 {
        Vec2::new(self.0[0] as f32, self.0[1] as f32) / STEPS
    }

    fn coordinates(self) -> [i64; 2] {
        self.0.map(i64::from)
    }
}

pub struct Coverage {
    columns: Range<usize>,
    rows: Range<usize>,
    width: usize,
    edges: [Edge; 3],
    inverse_area: f32,
}

impl Grid {
    pub fn whole(self) -> Window {
        Window { columns: 0..self.width, rows: 0..self.height, width: self.width }
    }

    pub fn around(self, positions: impl IntoIterator<Item = Position>, margin: u8) -> Window {
        let margin = i64::from(margin) * STEP;
        let (mut least, mut most) = ([i64::MAX; 2], [i64::MIN; 2]);
        for position in positions {
            let at = position.coordinates();
            least = [least[0].min(at[0] - margin), least[1].min(at[1] - margin)];
            most = [most[0].max(at[0] + margin), most[1].max(at[1] + margin)];
        }
        let range = |axis: usize, side: usize| span([least[axis], most[axis], most[axis]], 0..side);
        Window { columns: range(0, self.width), rows: range(1, self.height), width: self.width }
    }
}

#[derive(Debug, Clone)]
pub struct Window {
    columns: Range<usize>,
    rows: Range<usize>,
    width: usize,
}

impl Window {
    /// Returns the samples that a triangle may cover, or `None`, as for corners that run clockwise: it faces away.
    #[inline]
    pub fn cover(&self, corners: [Position; 3]) -> Option<Coverage> {
        if corners.iter().any(|corner| corner.0[0] == i32::MAX) {
            return None;
        }
        // The corners run clockwise from here on.
        let [a, c, b] = corners.map(Position::coordinates);
        let area = cross(a, b, c);
        if area <= 0 {
            return None;
        }
        let columns = span([a[0], b[0], c[0]], self.columns.clone());
        let rows = span([a[1], b[1], c[1]], self.rows.clone());
        if columns.is_empty() || rows.is_empty() {
            return None;
        }
        let start = [centre(columns.start), centre(rows.start)];
        // Each edge is opposite to the corner whose weight it gives.
        let edges = [Edge::new(b, c, start), Edge::new(a, b, start), Edge::new(c, a, start)];
        Some(Coverage { columns, rows, width: self.width, edges, inverse_area: 1.0 / area as f32 })
    }
}

impl Coverage {
    #[inline]
    pub fn each(self, mut sample: impl FnMut(usize, Vec3)) {
        let Self { columns, rows, width, mut edges, inverse_area } = self;
        for row in rows {
            let mut at = edges.each_ref().map(|edge| edge.value);
            for column in columns.clone() {
                if at[0] >= edges[0].least && at[1] >= edges[1].least && at[2] >= edges[2].least {
                    let weights = Vec3::new(at[0] as f32, at[1] as f32, at[2] as f32);
                    sample(row * width + column, weights * inverse_area);
                }
                for (at, edge) in at.iter_mut().zip(&edges) {
                    *at += edge.right;
                }
            }
            for edge in &mut edges {
                edge.value += edge.down;
            }
        }
    }
}

/// An edge function: twice the area between the edge and a sample, with its increments from sample to sample.
struct Edge {
    value: i64,
    right: i64,
    down: i64,
    /// Least value of a covered sample: 0 for a top or left edge, which includes its samples, and 1 otherwise.
    least: i64,
}

impl Edge {
    fn new(from: [i64; 2], to: [i64; 2], at: [i64; 2]) -> Self {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let top_left = dy < 0 || (dy == 0 && dx > 0);
        Self { value: cross(from, to, at), right: -dy * STEP, down: dx * STEP, least: i64::from(!top_left) }
    }
}

fn cross(a: [i64; 2], b: [i64; 2], c: [i64; 2]) -> i64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

pub fn centre(index: usize) -> i64 {
    i64::try_from(index).unwrap_or(0) * STEP + STEP / 2
}

/// Returns the range of samples inside `limits` whose centres lie between the smallest and the largest position.
fn span(positions: [i64; 3], limits: Range<usize>) -> Range<usize> {
    let [a, b, c] = positions;
    let first = (a.min(b).min(c) + STEP / 2 - 1).div_euclid(STEP).max(0);
    let end = (a.max(b).max(c) + STEP / 2).div_euclid(STEP).max(0);
    let whole = |value: i64| usize::try_from(value).unwrap_or(0);
    whole(first).max(limits.start)..whole(end).min(limits.end)
}

#[derive(Debug, Clone, Copy)]
pub struct Barycentric {
    pub vertices: [usize; 3],
    pub weights: Vec3,
}

impl Barycentric {
    #[inline]
    pub fn interpolate<T: Copy + core::ops::Mul<f32, Output = T> + core::ops::Add<Output = T>>(
        &self,
        of: impl Fn(usize) -> T,
    ) -> T {
        Corners(self.vertices.map(of)).at(self.weights)
    }
}

pub struct Corners<T>(pub [T; 3]);

impl<T: Copy + core::ops::Mul<f32, Output = T> + core::ops::Add<Output = T>> Corners<T> {
    #[inline]
    pub fn at(&self, weights: Vec3) -> T {
        let [a, b, c] = self.0;
        a * weights.x + b * weights.y + c * weights.z
    }
}

/// Calls `paint(number, vertices)` for every triangle that covers samples of the window. Calls the function that
/// `paint` returns for every visible sample, with the sample's index, inverse depth and barycentric coordinates.
pub fn draw<Paint: FnMut(&mut Canvas, usize, f32, Vec3)>(
    canvas: &mut Canvas,
    screen: &[(Position, f32)],
    (triangles, window): (&[Triangle], &Window),
    lift: f32,
    paint: impl Fn(usize, [usize; 3]) -> Paint,
) {
    for (number, triangle) in triangles.iter().enumerate() {
        let vertices = triangle.map(|vertex| vertex as usize);
        let [one, two, three] = vertices.map(|vertex| screen[vertex]);
        let Some(covered) = window.cover([one.0, two.0, three.0]) else { continue };
        let inverse_depths = Vec3::new(one.1, two.1, three.1) * lift;
        let mut sample = paint(number, vertices);
        covered.each(|index, weights| {
            let inverse_depth = weights.dot(inverse_depths);
            if canvas.is_visible(index, inverse_depth) {
                sample(canvas, index, inverse_depth, weights);
            }
        });
    }
}
