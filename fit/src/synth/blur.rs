//! Blurs pictures in linear light: defocus and motion. `scratch` is as large as the picture.

use glam::Vec2;

use super::camera::whole;

/// Applies a Gaussian blur to rows and then to columns.
pub fn defocus(light: &mut [[f32; 3]], scratch: &mut [[f32; 3]], width: usize, sigma: f32) {
    let kernel = gaussian(sigma);
    blur_rows(light, scratch, width, &kernel);
    blur_columns(scratch, light, width, &kernel);
}

/// Applies motion blur: averages along the path.
pub fn smear(light: &mut [[f32; 3]], scratch: &mut [[f32; 3]], width: usize, path: Vec2) {
    scratch.copy_from_slice(light);
    let height = light.len() / width;
    let taps = whole(path.length().ceil()).max(2);
    let offset = |tap: usize| (path * (tap as f32 / (taps - 1) as f32 - 0.5)).round();
    let offsets: Vec<[isize; 2]> = (0..taps).map(|tap| [offset(tap).x, offset(tap).y].map(signed)).collect();
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
    let taps = whole((2.5 * sigma).ceil()) + 1;
    let weight = |tap: usize| (-0.5 * (tap as f32 / sigma).powi(2)).exp();
    let sum = weight(0) + 2.0 * (1..taps).map(weight).sum::<f32>();
    (0..taps).map(|tap| weight(tap) / sum).collect()
}

/// Blurs along rows. The pixels at the border are repeated.
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

/// Blurs along columns. The pixels at the border are repeated.
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

#[expect(clippy::cast_possible_truncation, reason = "offsets of some pixels")]
fn signed(value: f32) -> isize {
    value as isize
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 24;

    /// Returns a picture that is black but for one pixel.
    fn point(column: usize, row: usize) -> Vec<[f32; 3]> {
        let mut light = vec![[0.0; 3]; WIDTH * 16];
        light[row * WIDTH + column] = [1.0; 3];
        light
    }

    /// Returns the mean position of the light and its sum.
    fn centre(light: &[[f32; 3]]) -> [f32; 3] {
        let weighed = |weight: fn(usize) -> f32| -> f32 {
            light.iter().enumerate().map(|(index, pixel)| weight(index) * pixel[1]).sum()
        };
        let sum = weighed(|_| 1.0);
        [weighed(|index| (index % WIDTH) as f32) / sum, weighed(|index| (index / WIDTH) as f32) / sum, sum]
    }

    #[test]
    fn blur_neither_moves_nor_loses_light() {
        let mut scratch = vec![[0.0; 3]; WIDTH * 16];
        for (column, row) in [(10, 7), (12, 8)] {
            let (mut defocused, mut smeared) = (point(column, row), point(column, row));
            defocus(&mut defocused, &mut scratch, WIDTH, 1.3);
            smear(&mut smeared, &mut scratch, WIDTH, Vec2::new(4.0, -2.0));
            for light in [defocused, smeared] {
                let [x, y, sum] = centre(&light);
                assert!((x - column as f32).abs() < 0.01 && (y - row as f32).abs() < 0.01, "{x} {y}");
                assert!((sum - 1.0).abs() < 1e-4 && light[row * WIDTH + column][0] < 0.5);
            }
        }
    }

    #[test]
    fn an_even_picture_stays_even_up_to_its_border() {
        let mut scratch = vec![[0.0; 3]; WIDTH * 16];
        let mut light = vec![[0.5; 3]; WIDTH * 16];
        defocus(&mut light, &mut scratch, WIDTH, 1.3);
        smear(&mut light, &mut scratch, WIDTH, Vec2::new(-3.0, 5.0));
        assert!(light.as_flattened().iter().all(|value| (value - 0.5).abs() < 1e-5));
    }
}
