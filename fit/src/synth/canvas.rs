//! The samples of a picture with colour and depth, which are averaged to pixels at the end.
//!
//! The density of samples need not be a whole number per pixel. A pixel is the mean over its square, in which samples
//! at its edge count with the share that lies inside.

use core::ops::Range;

use glam::{Vec2, Vec3, Vec3A, Vec4};

use super::raster::Grid;

/// Largest number of samples per side of a pixel.
pub const MOST_SAMPLES: f32 = 2.0;

/// Colours and depths of all samples.
pub struct Canvas {
    /// The grid of samples.
    pub grid: Grid,
    /// Samples per pixel along x and y.
    pub density: Vec2,
    size: [usize; 2],
    /// Inverse of each sample's distance, or 0 if nothing was drawn there.
    inverse_depth: Vec<f32>,
    /// Colour and coverage (0 or 1) of each sample.
    colour: Vec<Vec4>,
    /// Samples averaged over the height of one row of pixels.
    row: Vec<Vec4>,
    columns: Vec<Footprint>,
}

/// The samples that one pixel covers along one axis.
#[derive(Debug, Clone)]
struct Footprint {
    samples: Range<usize>,
    /// Weight of each sample. The weights sum to 1.
    weights: [f32; 4],
}

impl Canvas {
    /// Creates an empty canvas for pictures of this size in pixels.
    pub fn new(size: [usize; 2]) -> Self {
        Self {
            grid: Grid { width: 0, height: 0 },
            density: Vec2::ONE,
            size,
            inverse_depth: Vec::new(),
            colour: Vec::new(),
            row: Vec::new(),
            columns: Vec::new(),
        }
    }

    /// Clears the canvas for a picture with this many samples per side of a pixel, from 1 to [`MOST_SAMPLES`].
    pub fn clear(&mut self, density: f32) {
        let [width, height] = self.size.map(|side| whole((side as f32 * density.clamp(1.0, MOST_SAMPLES)).round()));
        let count = width * height;
        self.grid = Grid { width, height };
        self.density = Vec2::new(width as f32 / self.size[0] as f32, height as f32 / self.size[1] as f32);
        self.inverse_depth.clear();
        self.inverse_depth.resize(count, 0.0);
        self.colour.clear();
        self.colour.resize(count, Vec4::ZERO);
        self.columns = (0..self.size[0]).map(|pixel| Footprint::new(pixel, self.density.x, width)).collect();
    }

    /// Returns whether a surface at this depth is in front of the sample.
    #[inline]
    pub fn is_visible(&self, index: usize, inverse_depth: f32) -> bool {
        inverse_depth >= self.inverse_depth[index]
    }

    /// Sets the sample to an opaque colour.
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

    /// Averages the samples of each pixel, over the backdrop in `pixels`.
    pub fn resolve(&mut self, pixels: &mut [[f32; 3]]) {
        let Self { grid, density, size, colour, row: mean, columns, .. } = self;
        for (number, line) in pixels.chunks_exact_mut(size[0]).enumerate() {
            let rows = Footprint::new(number, density.y, grid.height);
            mean.clear();
            mean.resize(grid.width, Vec4::ZERO);
            for (samples, weight) in colour[rows.range(grid.width)].chunks_exact(grid.width).zip(rows.weights) {
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
        let first = whole(from + 1e-3);
        let end = whole((to - 1e-3).ceil()).min(limit);
        let mut weights = [0.0; 4];
        for (weight, sample) in weights.iter_mut().zip(first..end) {
            *weight = ((sample + 1) as f32).min(to) - (sample as f32).max(from);
        }
        let sum: f32 = weights.iter().sum();
        Self { samples: first..end, weights: weights.map(|weight| weight / sum) }
    }

    /// Returns the range of samples if each is a row of `width`.
    fn range(&self, width: usize) -> Range<usize> {
        self.samples.start * width..self.samples.end * width
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positions in a picture")]
fn whole(value: f32) -> usize {
    value as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_covered_pixel_is_half_backdrop() {
        let mut canvas = Canvas::new([2, 1]);
        canvas.clear(2.0);
        canvas.set(0, 0.1, Vec3A::ONE);
        canvas.set(4, 0.1, Vec3A::ONE);
        let mut pixels = [[0.0; 3], [0.25; 3]];
        canvas.resolve(&mut pixels);
        assert_eq!(pixels, [[0.5; 3], [0.25; 3]]);
        assert!(!canvas.is_visible(0, 0.05) && canvas.is_visible(0, 0.2) && canvas.is_visible(1, 1e-9));
    }

    #[test]
    fn nothing_is_blended_where_nothing_was_drawn() {
        let mut canvas = Canvas::new([1, 1]);
        canvas.clear(1.0);
        canvas.blend(0, 0.5, Vec3A::ONE);
        let mut pixels = [[0.25; 3]];
        canvas.resolve(&mut pixels);
        assert_eq!(pixels, [[0.25; 3]]);
    }

    #[test]
    fn at_any_density_an_even_surface_stays_even_and_an_edge_stays_in_its_place() {
        for density in [1.0, 1.25, 1.37, 1.5, 1.8, 2.0] {
            let mut canvas = Canvas::new([40, 30]);
            canvas.clear(density);
            let Grid { width, height } = canvas.grid;
            for index in (0..width * height).filter(|index| (index % width) as f32 + 0.5 < width as f32 / 4.0) {
                canvas.set(index, 0.1, Vec3A::ONE);
            }
            let mut pixels = vec![[0.0; 3]; 40 * 30];
            canvas.resolve(&mut pixels);
            let brightness: f32 = pixels.iter().map(|pixel| pixel[0]).sum::<f32>() / 30.0;
            assert!((brightness - 10.0).abs() < 0.51, "{density}: {brightness}");
            assert!((pixels[5][0] - 1.0).abs() < 1e-5 && pixels[15][0] < 1e-5, "{density}");
        }
    }
}
