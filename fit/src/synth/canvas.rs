//! The samples of a picture, four per pixel, with colour and depth. They are averaged to pixels at the end.

use glam::{Vec3, Vec3A};

use super::raster::Grid;

/// Samples per side of a pixel.
pub const SAMPLES: usize = 2;

/// Colours and depths of all samples.
pub struct Canvas {
    /// The grid of samples.
    pub grid: Grid,
    /// Inverse of each sample's distance, or 0 if nothing was drawn there.
    inverse_depth: Vec<f32>,
    colour: Vec<Vec3A>,
}

impl Canvas {
    /// Creates an empty canvas for pictures of this size in pixels.
    pub fn new([width, height]: [usize; 2]) -> Self {
        let grid = Grid { width: SAMPLES * width, height: SAMPLES * height };
        let count = grid.width * grid.height;
        Self { grid, inverse_depth: vec![0.0; count], colour: vec![Vec3A::ZERO; count] }
    }

    /// Clears all samples.
    pub fn clear(&mut self) {
        self.inverse_depth.fill(0.0);
    }

    /// Returns whether a surface at this depth is in front of the sample.
    pub fn is_visible(&self, index: usize, inverse_depth: f32) -> bool {
        inverse_depth >= self.inverse_depth[index]
    }

    /// Sets the sample to an opaque colour.
    pub fn set(&mut self, index: usize, inverse_depth: f32, colour: Vec3A) {
        self.inverse_depth[index] = inverse_depth;
        self.colour[index] = colour;
    }

    /// Blends a colour over the sample.
    pub fn blend(&mut self, index: usize, alpha: f32, colour: Vec3A) {
        let slot = &mut self.colour[index];
        *slot = slot.lerp(colour, alpha);
    }

    /// Averages the samples of each pixel, over the backdrop in `pixels`.
    pub fn resolve(&self, pixels: &mut [Vec3]) {
        let width = self.grid.width;
        let rows = self.inverse_depth.chunks_exact(SAMPLES * width).zip(self.colour.chunks_exact(SAMPLES * width));
        for ((inverse_depth, colour), row) in rows.zip(pixels.chunks_exact_mut(width / SAMPLES)) {
            for (column, pixel) in row.iter_mut().enumerate() {
                let first = column * SAMPLES;
                let samples = [first, first + 1, first + width, first + width + 1];
                let behind = Vec3A::from(*pixel);
                let of = |index: usize| if inverse_depth[index] > 0.0 { colour[index] } else { behind };
                let [a, b, c, d] = samples;
                *pixel = Vec3::from(of(a) + of(b) + of(c) + of(d)) / (SAMPLES * SAMPLES) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_half_covered_pixel_is_half_backdrop() {
        let mut canvas = Canvas::new([2, 1]);
        canvas.set(0, 0.1, Vec3A::ONE);
        canvas.set(4, 0.1, Vec3A::ONE);
        let mut pixels = [Vec3::ZERO; 2];
        canvas.resolve(&mut pixels);
        assert_eq!(pixels, [Vec3::splat(0.5), Vec3::ZERO]);
        assert!(!canvas.is_visible(0, 0.05) && canvas.is_visible(0, 0.2) && canvas.is_visible(1, 1e-9));
    }
}
