//! Textures of the head.

use std::path::Path;

use anyhow::{Context, Result};
use glam::{Vec2, Vec3A, Vec4};

/// An image with 8 bits per channel. As in the rig, u runs right and v up, both from 0 to 1.
pub struct Texture {
    width: usize,
    height: usize,
    pixels: Vec<[u8; 4]>,
}

impl Texture {
    /// Loads a PNG or JPEG file. Images without alpha are opaque.
    pub fn load(path: &Path) -> Result<Self> {
        let picture = image::open(path).with_context(|| format!("cannot read {}", path.display()))?.into_rgba8();
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        Ok(Self { width, height, pixels: picture.into_raw().as_chunks::<4>().0.to_vec() })
    }

    /// Returns width and height.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Returns the pixel at a column and a row from the top, clamped to the border.
    pub fn pixel(&self, column: usize, row: usize) -> [u8; 4] {
        self.pixels[row.min(self.height - 1) * self.width + column.min(self.width - 1)]
    }

    /// Samples the texture bilinearly, clamped to the border. Channels are 0 to 255 as stored (sRGB). Weights are
    /// integer 256ths, so that one multiplication blends two channels.
    #[inline]
    pub fn sample(&self, uv: Vec2) -> Vec4 {
        self.weighted(uv) * (1.0 / 256.0)
    }

    /// Samples the texture as [`Texture::sample`] does. Channels are 0 to 255 * 256.
    #[inline]
    fn weighted(&self, uv: Vec2) -> Vec4 {
        let limit = Vec2::new(self.width as f32 - 1.0, self.height as f32 - 1.0);
        let position = Vec2::new(uv.x * self.width as f32, (1.0 - uv.y) * self.height as f32) - 0.5;
        let position = 256.0 * position.clamp(Vec2::ZERO, limit);
        let (x, y) = (index(position.x), index(position.y));
        let (column, row, right, down) = (x / 256, y / 256, x % 256, y % 256);
        let both = right * down / 256;
        let taps = [(0, 0, 256 + both - right - down), (1, 0, right - both), (0, 1, down - both), (1, 1, both)];
        let (mut red_blue, mut green_alpha) = (0, 0);
        for (dx, dy, weight) in taps {
            let pixel = u32::from_le_bytes(self.pixel(column + dx, row + dy)) as usize;
            red_blue += (pixel & 0x00FF_00FF) * weight;
            green_alpha += (pixel >> 8 & 0x00FF_00FF) * weight;
        }
        let channel = |value: usize| (value & 0xFFFF) as f32;
        Vec4::new(channel(red_blue), channel(green_alpha), channel(red_blue >> 16), channel(green_alpha >> 16))
    }

    /// Samples the texture in linear light, from 0 to 1.
    #[inline]
    pub fn light(&self, uv: Vec2) -> Vec3A {
        linear(Vec3A::from_vec4(self.weighted(uv)) * (1.0 / (255.0 * 256.0)))
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the picture before")]
fn index(value: f32) -> usize {
    value as usize
}

/// Converts sRGB to linear light, both from 0 to 1. Approximates the power of 2.2 without `powf`, to within 0.01.
#[inline]
pub fn linear(colour: Vec3A) -> Vec3A {
    colour * colour * (Vec3A::splat(0.8) + 0.2 * colour)
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use glam::Vec3;

    use super::*;

    fn two_by_one() -> Texture {
        Texture { width: 2, height: 1, pixels: vec![[0, 0, 0, 255], [200, 100, 0, 255]] }
    }

    #[test]
    fn samples_are_interpolated_between_pixel_centres_and_clamped() {
        let texture = two_by_one();
        assert_eq!(texture.sample(Vec2::new(0.5, 0.5)).truncate(), Vec3::new(100.0, 50.0, 0.0));
        assert_eq!(texture.sample(Vec2::new(-3.0, 7.0)).truncate(), Vec3::ZERO);
        assert_eq!(texture.sample(Vec2::new(9.0, -7.0)).x, 200.0);
    }

    #[test]
    fn black_and_white_are_unchanged_in_linear_light() {
        assert_eq!(linear(Vec3A::ONE), Vec3A::ONE);
        assert_eq!(linear(Vec3A::ZERO), Vec3A::ZERO);
        assert!((linear(Vec3A::splat(0.5)).x - 0.5_f32.powf(2.2)).abs() < 0.01);
    }
}
