//! Charts as SVG text: axes, scatter plots, and the face. The page's style sheet (`output/style.css`) shows black as the
//! page's text colour, so that the charts suit a dark page, too.

use anyhow::{Context, Result, anyhow};
use facewire_face::LANDMARKS;
use nalgebra::DMatrix;
use plotters::coord::{Shift, types::RangedCoordf64};
use plotters::prelude::*;
use rayon::prelude::*;

use crate::faces::Faces;
use crate::statistics::{ColumnSpace, mean, pearson};

pub const SIZE_PX: (u32, u32) = (360, 270);
pub const POINT_PX: i32 = 2;
pub const BLUE_INK: RGBColor = RGBColor(47, 126, 216);
pub const ORANGE_INK: RGBColor = RGBColor(230, 126, 34);
pub const GREEN_INK: RGBColor = RGBColor(39, 174, 96);
pub const PURPLE_INK: RGBColor = RGBColor(155, 89, 182);
pub const GREY_INK: RGBColor = RGBColor(140, 150, 165);

pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub type DrawError = DrawingAreaErrorKind<std::io::Error>;
pub type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

pub struct Axis {
    name: &'static str,
    range: [f64; 2],
    ticks: usize,
    label: fn(f64) -> String,
}

impl Axis {
    pub fn linear(name: &'static str, range: [f64; 2]) -> Self {
        Self { name, range, ticks: 6, label: |value| ((value * 100.0).round() / 100.0 + 0.0).to_string() }
    }

    /// Returns an axis of ranks from 1 to `last`, with a logarithmic scale because the first ranks matter most.
    pub fn ranks(name: &'static str, last: usize) -> Self {
        let most = (last as f64).log10();
        Self { name, range: [0.0, most], ticks: 4, label: |power| format!("{:.0}", 10.0_f64.powf(power)) }
    }
}

/// Draws two axes, x and y.
pub fn chart<'a, 'b>(area: &'a Area<'b>, [x, y]: &[Axis; 2]) -> Result<Chart<'a, 'b>, DrawError> {
    let ([x0, x1], [y0, y1]) = (x.range, y.range);
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .margin_right(18)
        .x_label_area_size(36)
        .y_label_area_size(44)
        .build_cartesian_2d(x0..x1, y0..y1)?;
    let mut mesh = chart.configure_mesh();
    mesh.disable_mesh().x_labels(x.ticks).y_labels(y.ticks).x_desc(x.name).y_desc(y.name);
    let (label_x, label_y) = (|value: &f64| (x.label)(*value), |value: &f64| (y.label)(*value));
    mesh.x_label_formatter(&label_x).y_label_formatter(&label_y);
    mesh.label_style(("sans-serif", 13)).axis_desc_style(("sans-serif", 14)).draw()?;
    Ok(chart)
}

pub fn svg(size_px: (u32, u32), draw: impl FnOnce(&Area) -> Result<(), DrawError>) -> Result<String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, size_px).into_drawing_area();
    draw(&area).and_then(|()| area.present()).map_err(|error| anyhow!("cannot draw: {error}"))?;
    drop(area);
    // Plotters writes these default attributes for every point: half of a page of 60,000 points.
    Ok(text.replace(" opacity=\"1\"", "").replace(" stroke=\"none\" stroke-width=\"1\"", ""))
}

/// Draws scatter plots, the last one on top, and straight lines over them.
pub fn scatter(clouds: &[(&[(f64, f64)], RGBColor)], axes: &[Axis; 2], lines: &[[(f64, f64); 2]]) -> Result<String> {
    svg(SIZE_PX, |area| {
        let mut chart = chart(area, axes)?;
        for (points, ink) in clouds {
            chart.draw_series(points.iter().map(|point| Circle::new(*point, POINT_PX, ink.filled())))?;
        }
        chart.draw_series(lines.iter().map(|line| PathElement::new(line.to_vec(), ORANGE_INK.stroke_width(2))))?;
        Ok(())
    })
}

/// What a chart shows of a sequence of points.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    Dots,
    Line,
    Dashes,
    /// The area within the points.
    Area,
}

pub struct Curve {
    pub points: Vec<(f64, f64)>,
    pub ink: RGBColor,
    pub mark: Mark,
}

impl Curve {
    pub fn new(mark: Mark, ink: RGBColor, points: Vec<(f64, f64)>) -> Self {
        Self { points, ink, mark }
    }
}

/// Draws curves in one chart, the last one on top.
pub fn curves(curves: &[Curve], axes: &[Axis; 2]) -> Result<String> {
    svg(SIZE_PX, |area| {
        let mut chart = chart(area, axes)?;
        for Curve { points, ink, mark } in curves {
            let points = points.iter().copied();
            match mark {
                Mark::Dots => {
                    chart.draw_series(points.map(|point| Circle::new(point, POINT_PX, ink.filled())))?;
                }
                Mark::Line => {
                    chart.draw_series(LineSeries::new(points, ink.stroke_width(2)))?;
                }
                Mark::Dashes => {
                    chart.draw_series(DashedLineSeries::new(points, 5, 4, ink.stroke_width(1)))?;
                }
                Mark::Area => {
                    chart.draw_series([Polygon::new(points.collect::<Vec<_>>(), ink.mix(0.2).filled())])?;
                }
            }
        }
        Ok(())
    })
}

// The face as one dot per landmark.

const FACE_PX: (u32, u32) = (360, 400);
const FILLED: f64 = 0.92;
/// The background, the same on dark and light pages, because landmarks with low values are dark.
const BACKGROUND: RGBColor = RGBColor(46, 46, 58);
const MARK: RGBColor = RGBColor(90, 200, 250);
const DOT_PX: [f64; 2] = [2.0, 4.5];

/// Draws a face whose landmarks are coloured from 0 (dark) to the highest value (yellow), with rings around `marked`
/// landmarks. The person's left is at the right.
pub fn face(positions: &[[f64; 2]], values: &[f64], marked: &[usize]) -> Result<String> {
    let highest = values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let pixels = pixels(positions);
    let mut dots: Vec<_> = pixels.iter().zip(values).collect();
    dots.sort_by(|a, b| a.1.total_cmp(b.1));
    svg(FACE_PX, |area| {
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

fn pixels(positions: &[[f64; 2]]) -> Vec<(i32, i32)> {
    let range = |axis: usize| {
        let along = positions.iter().map(|position| position[axis]);
        (along.clone().fold(f64::MAX, f64::min), along.fold(f64::MIN, f64::max))
    };
    let ((left, right), (bottom, top)) = (range(0), range(1));
    let (width, height) = (f64::from(FACE_PX.0), f64::from(FACE_PX.1));
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

/// How strongly each landmark moves with a blendshape, as in the paper's figure of the correlation with `JawOpen`.
pub struct LandmarkMotion {
    /// Mean position of each landmark in eye distances: x to the person's left, y up.
    pub positions: Vec<[f64; 2]>,
    /// Displacement from the neutral face: a row per picture, three columns per landmark.
    displacements: DMatrix<f64>,
    column_spaces: Vec<ColumnSpace>,
}

impl LandmarkMotion {
    /// Collects the motion in pictures `rows`. The first features of a face are the coordinates of its landmarks.
    pub fn new(known: &Faces, unknown: &Faces, rows: &[usize]) -> Result<Self> {
        let mean_of = |column: usize| mean(rows.iter().map(|row| f64::from(unknown.values(*row)[column])));
        let positions = (0..LANDMARKS).map(|landmark| [3 * landmark, 3 * landmark + 1].map(mean_of)).collect();
        let displacement = |row: usize, column: usize| f64::from(known.values(rows[row])[column]);
        let displacements = DMatrix::from_fn(rows.len(), 3 * LANDMARKS, displacement);
        let of = |landmark: usize| ColumnSpace::of(&displacements.columns(3 * landmark, 3).into_owned());
        let column_spaces = (0..LANDMARKS).into_par_iter().map(of).collect::<Option<_>>();
        Ok(Self { positions, displacements, column_spaces: column_spaces.context("the landmarks do not move")? })
    }

    /// Returns the multiple correlation, from 0 to 1, of each landmark's three coordinates with the truth.
    pub fn correlations(&self, truth: &[f64]) -> Vec<f64> {
        self.column_spaces.iter().map(|own| own.explain(truth).map_or(0.0, f64::sqrt)).collect()
    }

    /// Returns pairs (truth, displacement) of a landmark along the axis that correlates best with the truth.
    pub fn movement(&self, landmark: usize, truth: &[f64]) -> Vec<(f64, f64)> {
        let axes = [0, 1, 2].map(|axis| self.displacements.column(3 * landmark + axis).iter().copied().collect());
        let most = |a: &Vec<f64>, b: &Vec<f64>| pearson(a, truth).abs().total_cmp(&pearson(b, truth).abs());
        let along = axes.into_iter().max_by(most).unwrap_or_default();
        truth.iter().copied().zip(along).collect()
    }
}
