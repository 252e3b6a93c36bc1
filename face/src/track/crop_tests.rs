//! Crops of random pictures against the plainest reading of the format and of the interpolation.
#![allow(clippy::float_cmp, clippy::indexing_slicing, reason = "exact results of small indices")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::cast_sign_loss,
    reason = "small numbers"
)]

use super::*;
use crate::picture::Pixels;

/// Red, green and blue of a pixel that is inside the picture.
fn pixel(picture: &Picture, x: usize, y: usize) -> [i64; 3] {
    let (luma, cb, cr) = match picture.pixels {
        Pixels::Yuyv { data, stride } => {
            let row = &data[y * stride..];
            (row[2 * x], row[x / 2 * 4 + 1], row[x / 2 * 4 + 3])
        }
        Pixels::Nv12 { luma, chroma, stride } => {
            let row = &chroma[y / 2 * stride..];
            (luma[y * stride + x], row[x / 2 * 2], row[x / 2 * 2 + 1])
        }
        Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift: [right, down] } => {
            let at = (y >> down) * strides[1] + (x >> right);
            (luma[y * strides[0] + x], cb[at], cr[at])
        }
        Pixels::Grey { data, stride } => (data[y * stride + x], 128, 128),
    };
    let product = |sample: i64, factor: i64| (sample * factor).div_euclid(8192);
    let (luma, cb, cr) = (i64::from(luma), i64::from(cb) - 128, i64::from(cr) - 128);
    if picture.full_range {
        [luma + product(cr, 11485), luma + product(cb, -2819) + product(cr, -5850), luma + product(cb, 14516)]
    } else {
        let luma = product(luma - 16, 9539);
        [luma + product(cr, 13075), luma + product(cb, -3209) + product(cr, -6660), luma + product(cb, 16525)]
    }
}

/// The crop, one sample after the other.
fn plain_crop(picture: &Picture, region: &FaceBox, shape: CropShape) -> Vec<[f32; 3]> {
    let nearest = |x: i32, y: i32| {
        let [x, y] = [(x, picture.width), (y, picture.height)].map(|(at, size)| at.clamp(0, size as i32 - 1) as usize);
        pixel(picture, x, y)
    };
    let sample = |[x, y]: [i32; 2]| {
        let [left, top] = [x >> 5, y >> 5];
        let [right, down] = [x & 31, y & 31].map(i64::from);
        let corners = [
            (nearest(left, top), (32 - right) * (32 - down)),
            (nearest(left + 1, top), right * (32 - down)),
            (nearest(left, top + 1), (32 - right) * down),
            (nearest(left + 1, top + 1), right * down),
        ];
        let inside = (0..picture.width as i32).contains(&left) && (0..picture.height as i32).contains(&top);
        [0, 1, 2].map(|channel| {
            let level = corners.iter().map(|(pixel, weight)| pixel[channel] * weight).sum::<i64>().clamp(0, 255 * 1024);
            let level = if inside || shape.border == Border::Replicate { level } else { 0 };
            level as f32 * ((shape.range[1] - shape.range[0]) / (255.0 * 1024.0)) + shape.range[0]
        })
    };
    let (mapping, side) = (region.mapping(), shape.side);
    let step = mapping.step(side).map(|along| ((along * 65536.0) as i32).clamp(-MAX_STEP, MAX_STEP));
    let row = |row: usize| {
        let start = mapping.to_picture(0.0, row as f32 * (1.0 / side as f32)).map(|at| (at * 65536.0) as i32);
        let start = start.map(|start| start.saturating_add(1024));
        (0..side as i32)
            .map(move |number| [0, 1].map(|axis| start[axis].wrapping_add(step[axis].wrapping_mul(number)) >> 11))
    };
    (0..side).flat_map(row).map(sample).collect()
}

/// The samples that [`crop`] writes.
fn samples(picture: &Picture, region: &FaceBox, shape: CropShape, block: &mut Block) -> Vec<[f32; 3]> {
    let mut rows = vec![[f32::NAN; 3 * MAX_SIDE]; shape.side];
    crop(picture, region, shape, block, &mut rows);
    rows.iter().flat_map(|row| row.as_chunks().0.iter().take(shape.side)).copied().collect()
}

/// Pixels of a random format whose planes have no byte to spare, in a picture of this size.
fn pixels<'a>(random: &mut fastrand::Rng, [width, height]: [usize; 2], data: &'a [u8]) -> Pixels<'a> {
    let pad = random.usize(..20);
    let plane = |from: usize, stride: usize, row: usize, rows: usize| &data[from..from + stride * (rows - 1) + row];
    let half = |size: usize| size.div_ceil(2);
    match random.u8(..8) {
        0 | 1 => {
            let row = 4 * half(width);
            Pixels::Yuyv { data: plane(0, row + pad, row, height), stride: row + pad }
        }
        2 | 3 => {
            let (row, stride) = (2 * half(width), 2 * half(width) + pad);
            let luma = plane(0, stride, width, height);
            Pixels::Nv12 { luma, chroma: plane(7, stride, row, half(height)), stride }
        }
        4 => Pixels::Grey { data: plane(0, width + pad, width, height), stride: width + pad },
        _ => {
            let shift = [[1, 1], [1, 0], [0, 0], [2, 0], [0, 1]][random.usize(..5)];
            let [row, rows] = [width.div_ceil(1 << shift[0]), height.div_ceil(1 << shift[1])];
            let strides = [width + pad, row + random.usize(..9)];
            let chroma = |from| plane(from, strides[1], row, rows);
            Pixels::Planar {
                planes: [plane(0, strides[0], width, height), chroma(3), chroma(9)],
                strides,
                chroma_shift: shift,
            }
        }
    }
}

#[test]
fn crops_of_any_format_size_and_region_are_those_of_the_plain_reading_bit_for_bit() {
    let mut random = fastrand::Rng::with_seed(11);
    let mut block = Block::default();
    for round in 0..400 {
        let size = [random.usize(1..150), random.usize(1..150)];
        let data: Vec<u8> = (0..60_000).map(|_| random.u8(..)).collect();
        let pixels = pixels(&mut random, size, &data);
        let picture = Picture::new(size[0], size[1], pixels, random.bool()).expect("a whole picture");
        let (far, large) = ([40.0, 200.0, 1e5][random.usize(..3)], [100.0, 700.0, 5000.0, 1e6][random.usize(..4)]);
        let mut place = |size: usize| random.f32() * size as f32 + (random.f32() - 0.5) * far;
        let centre = [place(size[0]), place(size[1])];
        let angle_rad = (random.f32() - 0.5) * [0.4, 6.3][random.usize(..2)];
        let region = FaceBox { centre, size: random.f32() * large, angle_rad };
        let shapes = [([0.0, 1.0], Border::Replicate), ([-1.0, 1.0], Border::Black)];
        let (range, border) = shapes[random.usize(..2)];
        let shape = CropShape { side: [192, 128, 1, random.usize(1..=192)][random.usize(..4)], range, border };
        let wanted = plain_crop(&picture, &region, shape);
        let found = samples(&picture, &region, shape, &mut block);
        let wrong = found.iter().zip(&wanted).position(|(found, wanted)| found != wanted);
        assert_eq!((wrong, found.len()), (None, wanted.len()), "round {round}: {size:?} {region:?} {shape:?}");
    }
}

#[test]
fn a_region_of_any_size_samples_only_the_picture() {
    // All pixels have the same colour, which is not grey, and the padding of each row has other bytes.
    let data = [[90, 100, 90, 180].repeat(6), vec![0; 24]].concat().repeat(18);
    let picture = Picture::new(12, 18, Pixels::Yuyv { data: &data, stride: 48 }, true).expect("all rows are there");
    let shape = CropShape { side: MAX_SIDE, range: [0.0, 1.0], border: Border::Replicate };
    // Without a limit of the step, the first and last samples of a row would be inside at 65,879 px, and those
    // between them outside.
    for size in [0.0, 20.0, 4000.0, 65_879.125, 1e9, f32::INFINITY, f32::NAN] {
        let region = FaceBox { centre: [5.0 + size / 2.0; 2], size, angle_rad: 0.0 };
        let samples = samples(&picture, &region, shape, &mut Block::default());
        assert!(samples.iter().all(|sample| *sample == samples[0] && sample[0].is_finite()), "{size} px");
    }
}
