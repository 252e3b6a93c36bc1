//! Pictures as a camera would take them in poor light, from too far away, or pointed past the face.

use std::sync::LazyLock;

use facewire_face::{Picture, Pixels};

/// Exponent from light to the numbers of a picture.
const GAMMA: f32 = 2.2;
/// Luma and chroma of what lies around a picture that was made smaller.
const GREY: u8 = 128;
/// Noise of reading a pixel of a small sensor, in electrons.
const READ_NOISE: f32 = 5.0;
static NORMAL: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let mut random = fastrand::Rng::with_seed(7);
    (0..65_521).map(|_| (0..12).map(|_| random.f32()).sum::<f32>() - 6.0).collect()
});

/// `count` values of a function from 0 to 1.
fn ramp(count: usize, value: impl Fn(f32) -> f32) -> Vec<f32> {
    (0..count).map(|index| value(index as f32 / (count - 1) as f32)).collect()
}

/// A picture in full range, whose planes have the same size.
#[derive(Clone)]
pub struct Photo {
    pub width: usize,
    pub height: usize,
    pub planes: [Vec<u8>; 3],
}

impl Photo {
    pub fn of(picture: &Picture) -> Self {
        let Pixels::Planar { planes, strides: [luma_stride, chroma_stride], chroma_shift: [shift_x, shift_y] } =
            picture.pixels()
        else {
            panic!("a film is planar")
        };
        let (width, height) = (picture.width(), picture.height());
        let pixel = |plane: usize, x: usize, y: usize| match plane {
            0 => planes[0][y * luma_stride + x],
            plane => planes[plane][(y >> shift_y) * chroma_stride + (x >> shift_x)],
        };
        let stretch = |plane: usize, value: u8| {
            let (black, steps) = if plane == 0 { (16.0, 219.0) } else { (128.0, 224.0) };
            let zero = if plane == 0 { 0.0 } else { 128.0 };
            let full = (f32::from(value) - black) * 255.0 / steps + zero;
            if picture.full_range() { value } else { full.round().clamp(0.0, 255.0) as u8 }
        };
        let planes = [0, 1, 2].map(|plane| {
            let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            rows.map(|(x, y)| stretch(plane, pixel(plane, x, y))).collect()
        });
        Self { width, height, planes }
    }

    pub fn picture(&self) -> Picture<'_> {
        let planes = [&self.planes[0][..], &self.planes[1], &self.planes[2]];
        let pixels = Pixels::Planar { planes, strides: [self.width; 2], chroma_shift: [0, 0] };
        Picture::new(self.width, self.height, pixels, true).unwrap()
    }

    /// Takes the picture with `light` times the light, by a sensor whose white is `electrons` per pixel. Few electrons mean
    /// a high gain: a webcam's pixel holds some thousands, and at its highest gain of 16 some hundreds are white.
    pub fn exposed(mut self, light: f32, electrons: f32) -> Self {
        let start = NORMAL.len() / 7 * usize::from(self.planes[0][self.width]);
        let linear = ramp(256, |luma| luma.powf(GAMMA) * light);
        let noise: Vec<f32> =
            linear.iter().map(|light| (light * electrons + READ_NOISE * READ_NOISE).sqrt() / electrons).collect();
        // Over the root of the light, which is nearly proportional to luma.
        let encoded = ramp(4096, |root| (root.powf(2.0 / GAMMA) * 255.0).round());
        for (at, luma) in self.planes[0].iter_mut().enumerate() {
            let value = usize::from(*luma);
            let light = linear[value] + noise[value] * NORMAL[start.wrapping_add(at * 31) % NORMAL.len()];
            *luma = encoded[(light.clamp(0.0, 1.0).sqrt() * 4095.0) as usize] as u8;
        }
        let gain = light.powf(1.0 / GAMMA);
        for chroma in self.planes[1..].iter_mut().flatten() {
            *chroma = ((f32::from(*chroma) - 128.0) * gain + 128.0).round().clamp(0.0, 255.0) as u8;
        }
        self
    }

    /// Makes what is outside the box around the face (left, top, right, bottom), the neck and the shoulders as bright as
    /// `luma`, and adds the share `flare` of its light to the person, as a lens does.
    pub fn backlit(mut self, [left, top, right, bottom]: [f32; 4], luma: u8, flare: f32) -> Self {
        let centre = [f32::midpoint(left, right), f32::midpoint(top, bottom)];
        let radii = [(right - left) * 0.62, (bottom - top) * 0.66];
        let window = (f32::from(luma) / 255.0).powf(GAMMA);
        let lit = ramp(256, |luma| ((luma.powf(GAMMA) + flare * window).min(1.0).powf(1.0 / GAMMA) * 255.0).round());
        for y in 0..self.height {
            for x in 0..self.width {
                let at = y * self.width + x;
                let [u, v] = [(x as f32 - centre[0]) / radii[0], (y as f32 - centre[1]) / radii[1]];
                let person = u * u + v * v < 1.0 || v > 0.0 && u.abs() < 0.6 + (v - 0.8).max(0.0) * 2.0;
                self.planes[0][at] = if person { lit[usize::from(self.planes[0][at])] as u8 } else { luma };
                if !person {
                    self.planes[1][at] = 128;
                    self.planes[2][at] = 128;
                }
            }
        }
        self
    }

    /// As a camera takes it that hangs upside down.
    pub fn upside_down(&self) -> Self {
        let mut photo = self.clone();
        photo.planes.iter_mut().for_each(|plane| plane.reverse());
        photo
    }

    /// With a dark thing before a part of the face, from `part[0]` to `part[1]` of the height of its box (left, top, right,
    /// bottom).
    pub fn covered(mut self, [left, top, right, bottom]: [f32; 4], part: [f32; 2]) -> Self {
        let [from, to] = part.map(|part| (top + part * (bottom - top)).max(0.0) as usize);
        for row in (from..to.min(self.height)).map(|y| y * self.width) {
            let covered = row + left.max(0.0) as usize..row + (right as usize).min(self.width);
            self.planes[0][covered.clone()].fill(30);
            self.planes[1][covered.clone()].fill(128);
            self.planes[2][covered].fill(128);
        }
        self
    }

    /// Makes the picture `factor` times as large by averaging, in the middle of a grey one of the same size.
    pub fn smaller(&self, factor: f32) -> Self {
        let (width, height) = (self.width, self.height);
        let inner = [width, height].map(|side| (side as f32 * factor) as usize);
        let offset = [(width - inner[0]) / 2, (height - inner[1]) / 2];
        let planes = [0, 1, 2].map(|plane: usize| {
            let mut canvas = vec![GREY; width * height];
            let span = |at: usize, side: usize| {
                let end = ((at + 1) as f32 / factor).ceil() as usize;
                (at as f32 / factor) as usize..end.min(side)
            };
            for (x, y) in (0..inner[1]).flat_map(|y| (0..inner[0]).map(move |x| (x, y))) {
                let places = span(y, height).flat_map(|row| span(x, width).map(move |column| row * width + column));
                let (sum, count) =
                    places.fold((0, 0), |(sum, count), place| (sum + u32::from(self.planes[plane][place]), count + 1));
                canvas[(y + offset[1]) * width + x + offset[0]] = (sum / count.max(1)) as u8;
            }
            canvas
        });
        Self { width, height, planes }
    }

    pub fn wall(&self) -> Self {
        Self { planes: [0; 3].map(|_: usize| vec![GREY; self.width * self.height]), ..*self }
    }

    /// The part of the picture from these columns and rows on, up to these columns and rows.
    pub fn cut(&self, [left, top]: [usize; 2], [right, bottom]: [usize; 2]) -> Self {
        let (width, height) = (right - left, bottom - top);
        let planes = [0, 1, 2].map(|plane: usize| {
            let row = |y: usize| &self.planes[plane][(top + y) * self.width + left..][..width];
            (0..height).flat_map(|y| row(y).to_vec()).collect()
        });
        Self { width, height, planes }
    }
}
