//! Measures the light on a face and its place in the picture, from about a thousand samples of luma.
//!
//! Contract: [`Look::at`] does not allocate, and takes the same time for every size of picture.

use facewire_face::stages::bounds;
use facewire_face::{Face, FaceBox, MESH, Picture, Pixels};

/// Columns and rows of the samples of the whole picture, and of those of the box around the face.
const PICTURE_GRID: [usize; 2] = [24, 18];
const FACE_GRID: [usize; 2] = [12, 12];
/// One landmark in this many is a sample of the face.
const LANDMARK_STEP: usize = 4;
/// A landmark is cut off if it lies nearer to the border of the picture than this part of the face's size. The network
/// moves points that would be far outside to the border.
const BORDER: f32 = 0.02;
/// Black of video range, and its steps from black to white; white of full range.
const VIDEO_BLACK: f32 = 16.0;
const VIDEO_STEPS: f32 = 219.0;
const WHITE: f32 = 255.0;
/// Number of classes of roughness. The last one holds all greater values.
const ROUGHNESSES: usize = 64;
/// Median of the roughness `|a - 2b + c|` of three neighbours whose noise has a deviation of 1: that of a normal variable
/// of variance `1 + 4 + 1`.
const MEDIAN_ROUGHNESS: f32 = 0.6745 * 2.449_49;
/// Noise of a picture that was rounded to whole numbers, or smoothed by compression.
const LEAST_NOISE: f32 = 0.5;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    pub picture: Light,
    pub face: Option<FaceLook>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceLook {
    pub light: Light,
    /// Mean brightness of the picture outside the box around the face.
    pub surroundings: f32,
    /// Longer side of the face, in pixels and as a part of the longer side of the picture.
    pub size_px: f32,
    pub size: f32,
    /// Share of the face that is outside the picture or at its border, from 0 to 1.
    pub cut_off: f32,
    /// [`Appearance::score`](facewire_face::Appearance::score); infinite for landmarks that come without it.
    pub score: f32,
    /// Clockwise angle of the line through the eyes, from -180 to 180 degrees.
    pub roll_deg: f32,
}

/// Light in a part of a picture, on a scale from 0 (black) to 255 (white) whatever the range of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Light {
    pub brightness: f32,
    /// Standard deviation of what is shown, without the noise.
    pub contrast: f32,
    /// Standard deviation of the noise between neighbouring pixels, at least 0.5.
    pub noise: f32,
}

impl Look {
    pub fn at(picture: &Picture, face: Option<Face>) -> Self {
        let size = picture.size_px();
        let points = face.map(|face| face.landmarks.0.iter().take(MESH).map(|[x, y, _]| [*x, *y]));
        let face_box = points.clone().map(bounds);
        let mut all = Samples::NONE;
        let mut around = Samples::NONE;
        for point in grid([[0.0; 2], size], PICTURE_GRID) {
            let Some([luma, roughness]) = sample(picture, point) else { continue };
            all.add(luma);
            all.add_roughness(roughness);
            if !face_box.is_some_and(|face_box| contains(face_box, point)) {
                around.add(luma);
            }
        }
        let all = all.light(picture);
        // Without a sample, the face fills the picture.
        let surroundings = if around.count == 0 { all.brightness } else { around.light(picture).brightness };
        let face = face.zip(points).zip(face_box).map(|((face, points), [min, max])| {
            let size_px = (max[0] - min[0]).max(max[1] - min[1]);
            let inside = [[BORDER * size_px; 2], size.map(|side| side - BORDER * size_px)];
            let mut samples = Samples::NONE;
            let mut cut_off = 0;
            let mut count = 0;
            for point in points.step_by(LANDMARK_STEP) {
                count += 1;
                cut_off += u32::from(!contains(inside, point));
                sample(picture, point).iter().for_each(|[luma, _]| samples.add(*luma));
            }
            for point in grid([min, max], FACE_GRID) {
                sample(picture, point).iter().for_each(|[_, roughness]| samples.add_roughness(*roughness));
            }
            let light = samples.light(picture);
            let size = size_px / size[0].max(size[1]);
            let cut_off = cut_off as f32 / count.max(1) as f32;
            let score = face.appearance.map_or(f32::INFINITY, |appearance| appearance.score);
            let roll_deg = FaceBox::following(face.landmarks).map_or(0.0, |region| region.angle_rad.to_degrees());
            FaceLook { light, surroundings, size_px, size, cut_off, score, roll_deg }
        });
        Self { picture: all, face }
    }
}

type Box2 = [[f32; 2]; 2];

fn contains([min, max]: Box2, [x, y]: [f32; 2]) -> bool {
    (min[0]..max[0]).contains(&x) && (min[1]..max[1]).contains(&y)
}

fn grid([min, max]: Box2, [columns, rows]: [usize; 2]) -> impl Iterator<Item = [f32; 2]> {
    let at = |index: usize, count: usize, min: f32, max: f32| min + (max - min) * (index as f32 + 0.5) / count as f32;
    (0..rows).flat_map(move |row| {
        (0..columns).map(move |column| [at(column, columns, min[0], max[0]), at(row, rows, min[1], max[1])])
    })
}

/// Returns the luma of a pixel, and how much it deviates from the line through its neighbours in the row. Returns `None`
/// outside the picture.
fn sample(picture: &Picture, point: [f32; 2]) -> Option<[u8; 2]> {
    let (plane, stride, step) = match picture.pixels() {
        Pixels::Yuyv { data, stride } => (data, stride, 2),
        Pixels::Nv12 { luma: plane, stride, .. }
        | Pixels::Planar { planes: [plane, ..], strides: [stride, _], .. }
        | Pixels::Grey { data: plane, stride } => (plane, stride, 1),
        // Green is near to luma.
        Pixels::Packed { data, stride, step, rgb } => (data.get(rgb[1]..)?, stride, step),
    };
    if !contains([[0.0; 2], picture.size_px()], point) {
        return None;
    }
    let [x, y] = picture.in_rows(point.map(f32::floor)).map(|at| at as usize);
    let luma = |x: usize| plane.get(y * stride + x.min(picture.width() - 1) * step).copied();
    let [before, here, after] = [luma(x.saturating_sub(1))?, luma(x)?, luma(x + 1)?];
    let roughness = (u16::from(before) + u16::from(after)).abs_diff(2 * u16::from(here));
    Some([here, u8::try_from(roughness).unwrap_or(u8::MAX)])
}

/// Sums over samples of luma, and the number of samples of each roughness.
struct Samples {
    sum: u32,
    squares: u32,
    count: u32,
    roughnesses: [u16; ROUGHNESSES],
}

impl Samples {
    const NONE: Self = Self { sum: 0, squares: 0, count: 0, roughnesses: [0; ROUGHNESSES] };

    fn add(&mut self, luma: u8) {
        let luma = u32::from(luma);
        self.sum += luma;
        self.squares += luma * luma;
        self.count += 1;
    }

    fn add_roughness(&mut self, roughness: u8) {
        if let Some(count) = self.roughnesses.get_mut(usize::from(roughness).min(ROUGHNESSES - 1)) {
            *count += 1;
        }
    }

    fn light(&self, picture: &Picture) -> Light {
        let (black, gain) = if picture.full_range() { (0.0, 1.0) } else { (VIDEO_BLACK, WHITE / VIDEO_STEPS) };
        let count = self.count.max(1) as f32;
        let mean = self.sum as f32 / count;
        let noise = self.median_roughness() / MEDIAN_ROUGHNESS;
        let variance = self.squares as f32 / count - mean * mean - noise * noise;
        Light {
            brightness: ((mean - black) * gain).clamp(0.0, WHITE),
            contrast: variance.max(0.0).sqrt() * gain,
            noise: (noise * gain).max(LEAST_NOISE),
        }
    }

    /// The median, as if the samples of each class were spread evenly over it.
    fn median_roughness(&self) -> f32 {
        let mut left = self.roughnesses.iter().map(|count| f32::from(*count)).sum::<f32>() / 2.0;
        for (roughness, count) in self.roughnesses.iter().enumerate() {
            let count = f32::from(*count);
            if count >= left {
                return (roughness as f32 - 0.5 + left / count.max(1.0)).max(0.0);
            }
            left -= count;
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 192;

    fn grey(data: &[u8], full_range: bool) -> Picture<'_> {
        Picture::new(SIDE, SIDE, Pixels::Grey { data, stride: SIDE }, full_range).unwrap()
    }

    #[test]
    fn every_format_and_range_gives_the_same_brightness() {
        let luma = vec![126; SIDE * SIDE];
        let yuyv: Vec<u8> = luma.iter().flat_map(|luma| [*luma, 30]).collect();
        for pixels in [
            Pixels::Grey { data: &luma, stride: SIDE },
            Pixels::Yuyv { data: &yuyv, stride: 2 * SIDE },
            Pixels::Nv12 { luma: &luma, chroma: &yuyv, stride: SIDE },
            Pixels::Planar { planes: [&luma, &yuyv, &yuyv], strides: [SIDE; 2], chroma_shift: [1, 1] },
        ] {
            let picture = |full_range| Picture::new(SIDE, SIDE, pixels, full_range).unwrap();
            let [full, video] = [true, false].map(|range| Look::at(&picture(range), None).picture.brightness);
            assert!((full - 126.0).abs() < 0.1 && (video - 128.1).abs() < 0.1, "{pixels:?}");
        }
    }

    #[test]
    fn noise_and_contrast_are_told_apart() {
        let mut random = fastrand::Rng::with_seed(7);
        let mut normal = || (0..12).map(|_| random.f32()).sum::<f32>() - 6.0;
        // Steps of 64 pixels between 90 and 150 have a deviation of 30.
        let step = |x: usize| if (x / 64).is_multiple_of(2) { 90.0 } else { 150.0 };
        let pixels: Vec<u8> =
            (0..SIDE * SIDE).map(|at| (step((at % SIDE) + at / SIDE) + 8.0 * normal()).round() as u8).collect();
        let light = Look::at(&grey(&pixels, true), None).picture;
        assert!((light.noise - 8.0).abs() < 1.0 && (light.contrast - 30.0).abs() < 2.0, "{light:?}");
        let plain = vec![7; SIDE * SIDE];
        let light = Look::at(&grey(&plain, true), None).picture;
        assert_eq!(light, Light { brightness: 7.0, contrast: 0.0, noise: LEAST_NOISE });
    }
}
