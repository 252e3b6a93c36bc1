//! Simulates a webcam: blur, motion, exposure, white balance, vignette, noise, tone curve, and JPEG.

use anyhow::Result;
use glam::{Vec2, Vec3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::StandardNormal;
use turbojpeg::{Compressor, Image, PixelFormat, Subsamp};

const TONES: usize = 4096;
pub const TONE_SCALE: f32 = (TONES - 1) as f32;
/// Number of precomputed normal deviates beyond those of one row.
const NORMALS: usize = 1 << 15;
/// Narrower blur is left out, in pixels.
const LEAST_BLUR: f32 = 0.3;

#[derive(Debug, Clone)]
pub struct Effects {
    pub defocus_px: f32,
    pub motion_px: Vec2,
    /// Factor on the light, including the white balance.
    pub exposure: Vec3,
    /// Loss of light in the corners, from 0 to 1.
    pub vignette: f32,
    /// Noise: standard deviation of the photon noise at full light, and of the sensor noise.
    pub noise: [f32; 2],
    /// Exponent of the tone curve divided by the usual 1/2.2.
    pub contrast: f32,
    pub sharpening: f32,
    pub jpeg_quality: i32,
    pub chroma: Subsamp,
}

pub struct Camera {
    width: usize,
    scratch: Vec<[f32; 3]>,
    bytes: Vec<u8>,
    unsharp: Vec<u8>,
    normals: Vec<f32>,
    curve: Vec<u8>,
    contrast: f32,
    compressor: Compressor,
}

impl Camera {
    pub fn new([width, height]: [usize; 2]) -> Result<Self> {
        let rng = ChaCha8Rng::seed_from_u64(0);
        let normals = rng.sample_iter(StandardNormal).take(NORMALS + 3 * width).collect();
        let (scratch, bytes) = (vec![[0.0; 3]; width * height], vec![0; 3 * width * height]);
        let (unsharp, curve, compressor) = (Vec::new(), Vec::new(), Compressor::new()?);
        Ok(Self { width, scratch, bytes, unsharp, normals, curve, contrast: 0.0, compressor })
    }

    pub fn capture(&mut self, light: &mut [[f32; 3]], effects: &Effects, rng: &mut ChaCha8Rng) -> Result<Vec<u8>> {
        if effects.defocus_px > LEAST_BLUR {
            defocus(light, &mut self.scratch, self.width, effects.defocus_px);
        }
        if effects.motion_px.length() > 1.0 {
            smear(light, &mut self.scratch, self.width, effects.motion_px);
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

    pub fn expose(&mut self, light: &mut [[f32; 3]], effects: &Effects, rng: &mut ChaCha8Rng) {
        if self.contrast.to_bits() != effects.contrast.to_bits() {
            (self.contrast, self.curve) = (effects.contrast, tone_curve(effects.contrast));
        }
        let curve = &self.curve;
        let mut state: u32 = rng.random::<u32>() | 1;
        let height = light.len() / self.width;
        let middle = Vec2::new(self.width as f32, height as f32) / 2.0;
        let [photons, sensor] = effects.noise.map(|noise| noise * noise);
        let exposure = effects.exposure.to_array();
        let vignette = effects.vignette / middle.length_squared();
        let rows = light.chunks_exact_mut(self.width).zip(self.bytes.chunks_exact_mut(3 * self.width));
        for (row, (line, bytes)) in rows.enumerate() {
            for (column, pixel) in line.iter_mut().enumerate() {
                let kept = 1.0 - vignette * (Vec2::new(column as f32, row as f32) - middle).length_squared();
                for (value, exposure) in pixel.iter_mut().zip(exposure) {
                    *value *= exposure * kept;
                }
            }
            let noise = noise(&self.normals, &mut state, 3 * self.width);
            for (value, noise) in line.as_flattened_mut().iter_mut().zip(noise) {
                *value = TONE_SCALE * (*value + noise * (*value * photons + sensor).max(0.0).sqrt()).clamp(0.0, 1.0);
            }
            for (byte, value) in bytes.iter_mut().zip(line.as_flattened()) {
                *byte = curve[*value as usize];
            }
        }
    }

    fn sharpen(&mut self, strength: f32) {
        let stride = 3 * self.width;
        let original = &mut self.unsharp;
        original.clone_from(&self.bytes);
        let inner = stride + 3..original.len() - stride - 3;
        let from = |offset: usize| original[offset..offset + inner.len()].iter().map(|value| f32::from(*value));
        let around = from(stride).zip(from(stride + 6)).zip(from(3).zip(from(2 * stride + 3)));
        for ((out, centre), ((left, right), (above, below))) in
            self.bytes[inner.clone()].iter_mut().zip(from(stride + 3)).zip(around)
        {
            *out = byte(centre + strength * (centre - (left + right + above + below) / 4.0));
        }
    }
}

/// Returns normal deviates for a row of `count` values: a run of the table from a random place on.
pub fn noise<'a>(normals: &'a [f32], state: &mut u32, count: usize) -> &'a [f32] {
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    let first = *state as usize % (normals.len() - count);
    &normals[first..first + count]
}

/// Returns the table from linear light to bytes: a shoulder that compresses highlights, then the tone curve.
fn tone_curve(contrast: f32) -> Vec<u8> {
    let tone = |step: usize| {
        let light = 1.0 - (-1.9 * step as f32 / TONE_SCALE).exp();
        byte(255.0 * (light / 0.85).min(1.0).powf(contrast / 2.2))
    };
    (0..TONES).map(tone).collect()
}

fn byte(value: f32) -> u8 {
    (value + 0.5) as u8
}

pub fn defocus(light: &mut [[f32; 3]], scratch: &mut [[f32; 3]], width: usize, sigma: f32) {
    let kernel = gaussian(sigma);
    blur_rows(light, scratch, width, &kernel);
    blur_columns(scratch, light, width, &kernel);
}

pub fn smear(light: &mut [[f32; 3]], scratch: &mut [[f32; 3]], width: usize, path: Vec2) {
    scratch.copy_from_slice(light);
    let height = light.len() / width;
    let taps = (path.length().ceil() as usize).max(2);
    let offset = |tap: usize| (path * (tap as f32 / (taps - 1) as f32 - 0.5)).round();
    let offsets: Vec<[isize; 2]> = (0..taps).map(|tap| offset(tap).to_array().map(|step| step as isize)).collect();
    light.as_flattened_mut().fill(0.0);
    for (row, line) in light.chunks_exact_mut(width).enumerate() {
        for [dx, dy] in &offsets {
            let from = row.saturating_add_signed(*dy).min(height - 1) * width;
            add_shifted(line, &scratch[from..from + width], *dx);
        }
        line.as_flattened_mut().iter_mut().for_each(|value| *value /= taps as f32);
    }
}

/// Adds a row of pixels, moved to the left by `by`. The pixels at the border are repeated.
fn add_shifted(to: &mut [[f32; 3]], from: &[[f32; 3]], by: isize) {
    let (width, shift) = (to.len(), by.unsigned_abs().min(to.len() - 1));
    let (mut at, border, inside) =
        if by < 0 { (0..shift, 0, shift..width) } else { (width - shift..width, width - 1, 0..width - shift) };
    let add = |to: &mut [f32; 3], from: &[f32; 3]| to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
    at.by_ref().for_each(|column| add(&mut to[column], &from[border]));
    let source = if by < 0 { &from[..width - shift] } else { &from[shift..] };
    to[inside].as_flattened_mut().iter_mut().zip(source.as_flattened()).for_each(|(to, from)| *to += from);
}

/// Returns the right half of a normalised Gaussian kernel, beginning with its centre.
fn gaussian(sigma: f32) -> Vec<f32> {
    let taps = (2.5 * sigma).ceil() as usize + 1;
    let weight = |tap: usize| (-0.5 * (tap as f32 / sigma).powi(2)).exp();
    let sum = weight(0) + 2.0 * (1..taps).map(weight).sum::<f32>();
    (0..taps).map(|tap| weight(tap) / sum).collect()
}

fn blur_rows(from: &[[f32; 3]], to: &mut [[f32; 3]], width: usize, kernel: &[f32]) {
    let reach = kernel.len() - 1;
    let mut padded = vec![[0.0; 3]; width + 2 * reach];
    for (line, out) in from.chunks_exact(width).zip(to.chunks_exact_mut(width)) {
        padded[..reach].fill(line[0]);
        padded[reach..reach + width].copy_from_slice(line);
        padded[reach + width..].fill(line[width - 1]);
        let moved = |first: usize| padded[first..first + width].as_flattened();
        weigh(out.as_flattened_mut(), kernel, |tap| [moved(reach - tap), moved(reach + tap)]);
    }
}

fn blur_columns(from: &[[f32; 3]], to: &mut [[f32; 3]], width: usize, kernel: &[f32]) {
    let height = from.len() / width;
    for (row, out) in to.chunks_exact_mut(width).enumerate() {
        let line = |row: usize| from[row * width..(row + 1) * width].as_flattened();
        weigh(out.as_flattened_mut(), kernel, |tap| [line(row.saturating_sub(tap)), line((row + tap).min(height - 1))]);
    }
}

/// Sets `out` to the weighted sum of the values that are `tap` pixels before and behind, for each tap of a kernel.
fn weigh<'a>(out: &mut [f32], kernel: &[f32], around: impl Fn(usize) -> [&'a [f32]; 2]) {
    out.iter_mut().zip(around(0)[0]).for_each(|(out, value)| *out = kernel[0] * value);
    for (tap, weight) in kernel.iter().enumerate().skip(1) {
        let [before, behind] = around(tap);
        for ((out, before), behind) in out.iter_mut().zip(before).zip(behind) {
            *out += weight * (before + behind);
        }
    }
}
