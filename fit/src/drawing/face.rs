//! Draws the face as one dot per landmark.

use anyhow::Result;
use plotters::prelude::*;

use super::svg;

const SIZE_PX: (u32, u32) = (360, 400);
/// Share of the drawing's size that the face fills.
const FILLED: f64 = 0.92;
/// The background, the same on dark and light pages, because landmarks with low values are dark.
const BACKGROUND: RGBColor = RGBColor(46, 46, 58);
/// Colour of the rings around marked landmarks.
const MARK: RGBColor = RGBColor(90, 200, 250);
/// Radius of the dot of the lowest and of the highest value.
const DOT_PX: [f64; 2] = [2.0, 4.5];

/// Draws a face whose landmarks are coloured from 0 (dark) to the highest value (yellow), with rings around `marked`
/// landmarks. The person's left is at the right.
pub fn face(positions: &[[f64; 2]], values: &[f64], marked: &[usize]) -> Result<String> {
    let highest = values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let pixels = pixels(positions);
    let mut dots: Vec<_> = pixels.iter().zip(values).collect();
    dots.sort_by(|a, b| a.1.total_cmp(b.1));
    svg(SIZE_PX, |area| {
        area.fill(&BACKGROUND)?;
        for (pixel, value) in dots {
            area.draw(&Circle::new(*pixel, radius_px(value / highest), heat(value / highest).filled()))?;
        }
        for landmark in marked {
            area.draw(&Circle::new(pixels[*landmark], radius_px(1.0) + 1, MARK.stroke_width(1)))?;
        }
        Ok(())
    })
}

/// Converts positions (x to the person's left, y up) to pixels so that all of them fit in the drawing.
fn pixels(positions: &[[f64; 2]]) -> Vec<(i32, i32)> {
    let range = |axis: usize| {
        let along = positions.iter().map(|position| position[axis]);
        (along.clone().fold(f64::MAX, f64::min), along.fold(f64::MIN, f64::max))
    };
    let ((left, right), (bottom, top)) = (range(0), range(1));
    let (width, height) = (f64::from(SIZE_PX.0), f64::from(SIZE_PX.1));
    let scale = (width / (right - left)).min(height / (top - bottom)) * FILLED;
    let centre = [f64::midpoint(left, right), f64::midpoint(bottom, top)];
    let pixel = |[x, y]: &[f64; 2]| {
        let (x, y) = ((x - centre[0]) * scale, (centre[1] - y) * scale);
        ((width / 2.0 + x) as i32, (height / 2.0 + y) as i32)
    };
    positions.iter().map(pixel).collect()
}

fn radius_px(value: f64) -> i32 {
    (DOT_PX[0] + value * (DOT_PX[1] - DOT_PX[0])).round() as i32
}

/// Maps 0 to 1 to colours from black by way of purple and orange to yellow.
fn heat(value: f64) -> RGBColor {
    const STOPS: [[f64; 3]; 5] =
        [[0.0, 0.0, 4.0], [87.0, 16.0, 110.0], [188.0, 55.0, 84.0], [249.0, 142.0, 9.0], [252.0, 255.0, 164.0]];
    let position = value.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let [red, green, blue] = {
        let below = (position as usize).min(STOPS.len() - 2);
        let part = position - below as f64;
        core::array::from_fn(|c| (STOPS[below][c] + part * (STOPS[below + 1][c] - STOPS[below][c])).round() as u8)
    };
    RGBColor(red, green, blue)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_persons_left_is_drawn_at_the_right_and_up_is_up() {
        let drawing = face(&[[1.0, 1.0], [-1.0, -1.0]], &[0.0, 1.0], &[]).unwrap();
        let attribute = |mark: &str| -> Vec<i32> {
            drawing.split(mark).skip(1).map(|rest| rest.split('"').next().unwrap().parse().unwrap()).collect()
        };
        let (x, y) = (attribute(" cx=\""), attribute(" cy=\""));
        assert!(x[0] > x[1] && y[0] < y[1], "{x:?} {y:?}");
    }
}
