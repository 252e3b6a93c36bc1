//! Simulates a webcam: blur, motion, exposure, white balance, vignette, noise, tone curve, and JPEG.

use anyhow::Result;
use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::StandardNormal;
use turbojpeg::{Compressor, Image, PixelFormat, Subsamp};

/// Number of entries in the table of the tone curve.
const TONES: usize = 4096;
/// Number of precomputed normal deviates: few enough to stay in the cache.
const NORMALS: usize = 1 << 12;
/// Narrower blur is left out, in pixels.
const LEAST_BLUR: f32 = 0.3;

/// Camera effects of one picture.
#[derive(Debug, Clone)]
pub struct Effects {
    /// Standard deviation of the defocus in pixels.
    pub defocus_px: f32,
    /// Motion during the exposure in pixels.
    pub motion_px: Vec2,
    /// Factor on the light, including the white balance.
    pub exposure: Vec3,
    /// Loss of light in the corners, from 0 to 1.
    pub vignette: f32,
    /// Noise: standard deviation of the photon noise at full light, and of the sensor noise.
    pub noise: [f32; 2],
    /// Exponent of the tone curve divided by the usual 1/2.2.
    pub contrast: f32,
    /// Strength of the sharpening that cameras apply.
    pub sharpening: f32,
    /// JPEG quality from 1 to 100.
    pub jpeg_quality: i32,
    /// Chroma subsampling.
    pub chroma: Subsamp,
}

/// A camera with buffers for pictures of one size.
pub struct Camera {
    width: usize,
    scratch: Vec<Vec3>,
    bytes: Vec<u8>,
    normals: Vec<f32>,
    compressor: Compressor,
}

impl Camera {
    /// Creates a camera for pictures of this size.
    pub fn new([width, height]: [usize; 2]) -> Result<Self> {
        let rng = ChaCha8Rng::seed_from_u64(0);
        let normals = rng.sample_iter(StandardNormal).take(NORMALS).collect();
        let (scratch, bytes) = (vec![Vec3::ZERO; width * height], vec![0; 3 * width * height]);
        Ok(Self { width, scratch, bytes, normals, compressor: Compressor::new()? })
    }

    /// Converts linear light to a JPEG image. Overwrites `light`.
    pub fn capture(&mut self, light: &mut [Vec3], effects: &Effects, rng: &mut ChaCha8Rng) -> Result<Vec<u8>> {
        if effects.defocus_px > LEAST_BLUR {
            self.defocus(light, effects.defocus_px);
        }
        if effects.motion_px.length() > 1.0 {
            self.smear(light, effects.motion_px);
        }
        self.expose(light, effects, rng);
        if effects.sharpening > 0.0 {
            self.sharpen(effects.sharpening);
        }
        self.compressor.set_quality(effects.jpeg_quality)?;
        self.compressor.set_subsamp(effects.chroma)?;
        let (width, height) = (self.width, light.len() / self.width);
        let image = Image { pixels: self.bytes.as_slice(), width, pitch: 3 * width, height, format: PixelFormat::RGB };
        Ok(self.compressor.compress_to_vec(image)?)
    }

    /// Applies a Gaussian blur to rows and then to columns.
    fn defocus(&mut self, light: &mut [Vec3], sigma: f32) {
        let kernel = gaussian(sigma);
        blur(light, &mut self.scratch, self.width, &kernel, [1, 0]);
        blur(&self.scratch, light, self.width, &kernel, [0, 1]);
    }

    /// Applies motion blur: averages along the path.
    fn smear(&mut self, light: &mut [Vec3], path: Vec2) {
        self.scratch.copy_from_slice(light);
        let (width, height) = (self.width, light.len() / self.width);
        let taps = whole(path.length().ceil()).max(2);
        let offset = |tap: usize| (path * (tap as f32 / (taps - 1) as f32 - 0.5)).round();
        let offsets: Vec<[isize; 2]> = (0..taps).map(|tap| [offset(tap).x, offset(tap).y].map(signed)).collect();
        for (index, pixel) in light.iter_mut().enumerate() {
            let (column, row) = (index % width, index / width);
            let at = |[dx, dy]: &[isize; 2]| {
                let x = column.saturating_add_signed(*dx).min(width - 1);
                let y = row.saturating_add_signed(*dy).min(height - 1);
                self.scratch[y * width + x]
            };
            *pixel = offsets.iter().map(at).sum::<Vec3>() / taps as f32;
        }
    }

    /// Converts light to bytes: exposure, vignette, noise, and tone curve.
    fn expose(&mut self, light: &[Vec3], effects: &Effects, rng: &mut ChaCha8Rng) {
        let curve = tone_curve(effects.contrast);
        let mut state: u32 = rng.random::<u32>() | 1;
        let height = light.len() / self.width;
        let middle = Vec2::new(self.width as f32, height as f32) / 2.0;
        let [photons, sensor] = effects.noise;
        for (row, (line, bytes)) in
            light.chunks_exact(self.width).zip(self.bytes.chunks_exact_mut(3 * self.width)).enumerate()
        {
            for (column, (pixel, bytes)) in line.iter().zip(bytes.as_chunks_mut::<3>().0).enumerate() {
                let far = (Vec2::new(column as f32, row as f32) - middle).length_squared() / middle.length_squared();
                let seen = *pixel * effects.exposure * (1.0 - effects.vignette * far);
                let spread = (seen * (photons * photons) + sensor * sensor).max(Vec3::ZERO);
                let noise = draw(&self.normals, &mut state);
                let value = seen + noise * Vec3::new(spread.x.sqrt(), spread.y.sqrt(), spread.z.sqrt());
                *bytes = value.to_array().map(|value| curve[whole(value.clamp(0.0, 1.0) * (TONES - 1) as f32)]);
            }
        }
    }

    /// Sharpens by adding the difference of each pixel from the mean of its four neighbours.
    fn sharpen(&mut self, strength: f32) {
        let original = self.bytes.clone();
        let stride = 3 * self.width;
        for index in stride + 3..original.len() - stride - 3 {
            let at = |index: usize| f32::from(original[index]);
            let around = at(index - 3) + at(index + 3) + at(index - stride) + at(index + stride);
            self.bytes[index] = byte(at(index) + strength * (at(index) - around / 4.0));
        }
    }
}

/// Returns the next three normal deviates.
fn draw(normals: &[f32], state: &mut u32) -> Vec3 {
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    Vec3::from_array([0, 10, 20].map(|shift| normals[(*state >> shift) as usize % NORMALS]))
}

/// Returns the right half of a normalised Gaussian kernel, beginning with its centre.
fn gaussian(sigma: f32) -> Vec<f32> {
    let taps = whole((2.5 * sigma).ceil()) + 1;
    let weight = |tap: usize| (-0.5 * (tap as f32 / sigma).powi(2)).exp();
    let sum = weight(0) + 2.0 * (1..taps).map(weight).sum::<f32>();
    (0..taps).map(|tap| weight(tap) / sum).collect()
}

fn blur(from: &[Vec3], to: &mut [Vec3], width: usize, kernel: &[f32], [across, down]: [usize; 2]) {
    let height = from.len() / width;
    for (index, pixel) in to.iter_mut().enumerate() {
        let (column, row) = (index % width, index / width);
        let at = |tap: usize, forward: bool| {
            let moved = |index: usize, by: usize, side: usize| {
                if forward { (index + by).min(side - 1) } else { index.saturating_sub(by) }
            };
            from[moved(row, tap * down, height) * width + moved(column, tap * across, width)]
        };
        let pairs = kernel.iter().enumerate().skip(1).map(|(tap, weight)| *weight * (at(tap, true) + at(tap, false)));
        *pixel = kernel[0] * from[index] + pairs.sum::<Vec3>();
    }
}

/// Returns the table from linear light to bytes: a shoulder that compresses highlights, then the tone curve.
fn tone_curve(contrast: f32) -> Vec<u8> {
    let tone = |step: usize| {
        let light = 1.0 - (-1.9 * step as f32 / (TONES - 1) as f32).exp();
        byte(255.0 * (light / 0.85).min(1.0).powf(contrast / 2.2))
    };
    (0..TONES).map(tone).collect()
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
fn byte(value: f32) -> u8 {
    (value + 0.5) as u8
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small numbers, not negative")]
fn whole(value: f32) -> usize {
    value as usize
}

#[expect(clippy::cast_possible_truncation, reason = "offsets of some pixels")]
fn signed(value: f32) -> isize {
    value as isize
}
