//! Drawings as SVG text. Black in them is the page's text colour, so they follow a dark page (`style.css`).

use anyhow::{Result, anyhow};
use plotters::{coord::Shift, prelude::*};

use super::diagnostics::evenly;

const SIZE_PX: (u32, u32) = (360, 270);
const FACE_PX: (u32, u32) = (360, 400);
/// Points of a cloud: enough to see its shape, few enough for a page of fifty.
const CLOUD: usize = 300;
/// So many of them are those with the largest coefficients.
const LARGEST: usize = 200;
const POINT_PX: i32 = 2;
/// Points of clouds, lines through them, and bars.
const BLUE_INK: RGBColor = RGBColor(47, 126, 216);
const ORANGE_INK: RGBColor = RGBColor(230, 126, 34);
/// Behind the face, on dark and light pages: points that do not move with the blendshape are dark.
const FACE_GROUND: RGBColor = RGBColor(46, 46, 58);
/// Dots of the face: radius by correlation.
const DOT_PX: [f64; 2] = [2.0, 4.5];

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// What the axes show and how far they go.
struct Axes {
    x: (&'static str, [f64; 2]),
    y: (&'static str, [f64; 2]),
}

/// Points about a line from the lower left to the upper right: estimate against truth.
pub fn fit(pairs: &[(f64, f64)]) -> Result<String> {
    let points: Vec<_> = telling(pairs).into_iter().map(|(estimate, truth)| (truth, estimate)).collect();
    let axes = Axes { x: ("truth", [0.0, 1.0]), y: ("estimate", [0.0, 1.0]) };
    clouds(&[(&points, BLUE_INK)], axes, Some([(0.0, 0.0), (1.0, 1.0)]))
}

/// Residuals over estimates.
pub fn residuals(pairs: &[(f64, f64)]) -> Result<String> {
    let points: Vec<_> = telling(pairs).into_iter().map(|(estimate, truth)| (estimate, truth - estimate)).collect();
    let axes = Axes { x: ("estimate", [0.0, 1.0]), y: ("residual", [-1.0, 1.0]) };
    clouds(&[(&points, BLUE_INK)], axes, Some([(0.0, 0.0), (1.0, 0.0)]))
}

/// How far a landmark that follows the blendshape moves with the truth (blue), and one that does not (orange).
pub fn movements(follows: &[(f64, f64)], rests: &[(f64, f64)]) -> Result<String> {
    let largest = follows.iter().chain(rests).map(|(_, moved)| moved.abs()).fold(0.0, f64::max);
    let axes = Axes { x: ("truth", [0.0, 1.0]), y: ("displacement", [-largest, largest]) };
    let half = |points: &[(f64, f64)]| evenly(&telling(points), CLOUD / 2);
    clouds(&[(&half(rests), ORANGE_INK), (&half(follows), BLUE_INK)], axes, None)
}

/// The [`CLOUD`] points that tell most: those with the largest coordinates, and some of the others. In most pictures
/// most blendshapes are 0.
fn telling(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| b.0.max(b.1).total_cmp(&a.0.max(a.1)));
    let (largest, others) = sorted.split_at(sorted.len().min(LARGEST));
    [largest.to_vec(), evenly(others, CLOUD - LARGEST)].concat()
}

/// Truth and estimates of all pictures, both in the order of the truth.
pub fn ranked(pairs: &[(f64, f64)]) -> Result<String> {
    let mut pairs = pairs.to_vec();
    pairs.sort_by(|a, b| a.1.total_cmp(&b.1));
    let pairs = evenly(&pairs, CLOUD);
    let place = |index: usize| 100.0 * index as f64 / pairs.len() as f64;
    let axes = Axes { x: ("% of pictures, by truth", [0.0, 100.0]), y: ("coefficient", [0.0, 1.0]) };
    drawn(SIZE_PX, |area| {
        let mut chart = axes.draw(area)?;
        let points = pairs.iter().enumerate().map(|(index, pair)| (place(index), pair.0));
        chart.draw_series(points.map(|point| Circle::new(point, POINT_PX, BLUE_INK.filled())))?;
        let line = pairs.iter().enumerate().map(|(index, pair)| (place(index), pair.1));
        chart.draw_series(LineSeries::new(line, ORANGE_INK.stroke_width(2)))?;
        Ok(())
    })
}

/// Autocorrelation by lag, between the lines that 95 % of unrelated values stay within.
pub fn autocorrelation(lags: &[f64], values: usize) -> Result<String> {
    let last = lags.len() as f64;
    let axes = Axes { x: ("lag", [0.0, last]), y: ("autocorrelation", [-0.5, 1.0]) };
    let limit = 1.96 / (values as f64).sqrt();
    drawn(SIZE_PX, |area| {
        let mut chart = axes.draw(area)?;
        let bar = |(lag, value): (usize, &f64)| {
            PathElement::new(vec![(lag as f64, 0.0), (lag as f64, *value)], BLUE_INK.stroke_width(5))
        };
        chart.draw_series(lags.iter().enumerate().skip(1).map(bar))?;
        for level in [-limit, limit] {
            chart.draw_series(LineSeries::new([(0.0, level), (last, level)], ORANGE_INK.stroke_width(1)))?;
        }
        Ok(())
    })
}

/// A face whose landmarks are coloured by a value, from 0 (dark) to the highest of them (yellow). The person's left is
/// at the right.
pub fn face(places: &[[f64; 2]], values: &[f64]) -> Result<String> {
    let highest = values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let range = |axis: usize| {
        let along = places.iter().map(|place| place[axis]);
        (along.clone().fold(f64::MAX, f64::min), along.fold(f64::MIN, f64::max))
    };
    let ((left, right), (bottom, top)) = (range(0), range(1));
    let scale = (f64::from(FACE_PX.0) / (right - left)).min(f64::from(FACE_PX.1) / (top - bottom)) * 0.92;
    let centre = [f64::midpoint(left, right), f64::midpoint(bottom, top)];
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    let pixel = |[x, y]: [f64; 2]| {
        let (x, y) = ((x - centre[0]) * scale, (centre[1] - y) * scale);
        ((f64::from(FACE_PX.0) / 2.0 + x) as i32, (f64::from(FACE_PX.1) / 2.0 + y) as i32)
    };
    let mut dots: Vec<_> = places.iter().zip(values).collect();
    dots.sort_by(|a, b| a.1.total_cmp(b.1));
    drawn(FACE_PX, |area| {
        area.fill(&FACE_GROUND)?;
        for (place, value) in dots {
            area.draw(&Circle::new(pixel(*place), radius_px(value / highest), heat(value / highest).filled()))?;
        }
        Ok(())
    })
}

#[expect(clippy::cast_possible_truncation, reason = "a few pixels")]
fn radius_px(value: f64) -> i32 {
    (DOT_PX[0] + value * (DOT_PX[1] - DOT_PX[0])).round() as i32
}

/// Black by way of purple and orange to yellow.
fn heat(value: f64) -> RGBColor {
    const STOPS: [[f64; 3]; 5] =
        [[0.0, 0.0, 4.0], [87.0, 16.0, 110.0], [188.0, 55.0, 84.0], [249.0, 142.0, 9.0], [252.0, 255.0, 164.0]];
    let place = value.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 4, and colours")]
    let [red, green, blue] = {
        let below = (place as usize).min(STOPS.len() - 2);
        let part = place - below as f64;
        core::array::from_fn(|c| (STOPS[below][c] + part * (STOPS[below + 1][c] - STOPS[below][c])).round() as u8)
    };
    RGBColor(red, green, blue)
}

fn clouds(clouds: &[(&[(f64, f64)], RGBColor)], axes: Axes, line: Option<[(f64, f64); 2]>) -> Result<String> {
    drawn(SIZE_PX, |area| {
        let mut chart = axes.draw(area)?;
        for (points, ink) in clouds {
            chart.draw_series(points.iter().map(|point| Circle::new(*point, POINT_PX, ink.filled())))?;
        }
        chart.draw_series(line.map(|line| PathElement::new(line.to_vec(), ORANGE_INK.stroke_width(2))))?;
        Ok(())
    })
}

type Chart<'a, 'b> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<plotters::coord::types::RangedCoordf64, plotters::coord::types::RangedCoordf64>,
>;

impl Axes {
    fn draw<'a, 'b>(self, area: &'a Area<'b>) -> Result<Chart<'a, 'b>, Failed> {
        let ((x_name, [x0, x1]), (y_name, [y0, y1])) = (self.x, self.y);
        let mut chart = ChartBuilder::on(area)
            .margin(8)
            .margin_right(18)
            .x_label_area_size(36)
            .y_label_area_size(44)
            .build_cartesian_2d(x0..x1, y0..y1)?;
        let mut mesh = chart.configure_mesh();
        mesh.disable_mesh().x_labels(6).y_labels(6).x_desc(x_name).y_desc(y_name);
        mesh.x_label_formatter(&|x| label(*x)).y_label_formatter(&|y| label(*y));
        mesh.label_style(("sans-serif", 13)).axis_desc_style(("sans-serif", 14)).draw()?;
        Ok(chart)
    }
}

type Failed = DrawingAreaErrorKind<std::io::Error>;

fn drawn(size_px: (u32, u32), draw: impl FnOnce(&Area) -> Result<(), Failed>) -> Result<String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, size_px).into_drawing_area();
    draw(&area).and_then(|()| area.present()).map_err(|error| anyhow!("cannot draw: {error}"))?;
    drop(area);
    // Of a page of sixty thousand points, these defaults would be half.
    Ok(text.replace(" opacity=\"1\"", "").replace(" stroke=\"none\" stroke-width=\"1\"", ""))
}

/// With the decimals it needs, up to two.
fn label(value: f64) -> String {
    format!("{}", (value * 100.0).round() / 100.0 + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cloud_has_no_more_points_than_a_page_can_carry() {
        let pairs: Vec<_> = (0..5000).map(|i| (f64::from(i) / 5000.0, 0.5)).collect();
        let drawing = fit(&pairs).unwrap();
        assert!((LARGEST..=CLOUD).contains(&drawing.matches("<circle").count()));
    }

    #[test]
    fn persons_left_is_drawn_at_the_right_and_the_brow_above_the_chin() {
        let drawing = face(&[[1.0, 1.0], [-1.0, -1.0]], &[0.0, 1.0]).unwrap();
        let place = |mark: &str| -> Vec<i32> {
            drawing.split(mark).skip(1).map(|rest| rest.split('"').next().unwrap().parse().unwrap()).collect()
        };
        let (x, y) = (place(" cx=\""), place(" cy=\""));
        assert!(x[0] > x[1] && y[0] < y[1], "{x:?} {y:?}");
    }

    #[test]
    fn heat_runs_from_dark_to_yellow() {
        assert_eq!([heat(-1.0), heat(2.0)], [RGBColor(0, 0, 4), RGBColor(252, 255, 164)]);
    }
}
