//! The samples of a picture: four to a pixel, with depth, resolved to pixels at the end.

use glam::{Vec3, Vec3A};

use super::raster::Grid;

/// Samples along a side of a pixel.
pub const SAMPLES: usize = 2;

/// Colours and depths of all samples.
pub struct Canvas {
    /// Of the samples.
    pub grid: Grid,
    /// Inverse of the distance; 0 where nothing was drawn.
    near: Vec<f32>,
    colour: Vec<Vec3A>,
}

impl Canvas {
    /// An empty canvas for pictures of this size in pixels.
    pub fn new([width, height]: [usize; 2]) -> Self {
        let grid = Grid { width: SAMPLES * width, height: SAMPLES * height };
        let count = grid.width * grid.height;
        Self { grid, near: vec![0.0; count], colour: vec![Vec3A::ZERO; count] }
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.near.fill(0.0);
    }

    /// Whether something this near would be seen.
    pub fn sees(&self, index: usize, near: f32) -> bool {
        near >= self.near[index]
    }

    /// Puts an opaque colour.
    pub fn put(&mut self, index: usize, near: f32, colour: Vec3A) {
        self.near[index] = near;
        self.colour[index] = colour;
    }

    /// Lays a colour over what is there.
    pub fn blend(&mut self, index: usize, alpha: f32, colour: Vec3A) {
        let slot = &mut self.colour[index];
        *slot = slot.lerp(colour, alpha);
    }

    /// Mean of each pixel's samples, over the backdrop that `pixels` holds.
    pub fn resolve(&self, pixels: &mut [Vec3]) {
        let width = self.grid.width;
        let rows = self.near.chunks_exact(SAMPLES * width).zip(self.colour.chunks_exact(SAMPLES * width));
        for ((near, colour), row) in rows.zip(pixels.chunks_exact_mut(width / SAMPLES)) {
            for (column, pixel) in row.iter_mut().enumerate() {
                let first = column * SAMPLES;
                let samples = [first, first + 1, first + width, first + width + 1];
                let behind = Vec3A::from(*pixel);
                let of = |index: usize| if near[index] > 0.0 { colour[index] } else { behind };
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
    fn a_pixel_half_covered_is_half_backdrop() {
        let mut canvas = Canvas::new([2, 1]);
        canvas.put(0, 0.1, Vec3A::ONE);
        canvas.put(4, 0.1, Vec3A::ONE);
        let mut pixels = [Vec3::ZERO; 2];
        canvas.resolve(&mut pixels);
        assert_eq!(pixels, [Vec3::splat(0.5), Vec3::ZERO]);
        assert!(!canvas.sees(0, 0.05) && canvas.sees(0, 0.2) && canvas.sees(1, 1e-9));
    }
}
