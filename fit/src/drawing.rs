//! Charts as SVG text: axes, scatter plots, and the face. The page's style sheet (`html/style.css`) shows black as the
//! page's text colour, so that the charts suit a dark page, too.

pub mod face;

use anyhow::{Result, anyhow};
use plotters::coord::{Shift, types::RangedCoordf64};
use plotters::prelude::*;

/// Size of a chart with axes.
pub const SIZE_PX: (u32, u32) = (360, 270);
/// Radius of the points of a scatter plot.
pub const POINT_PX: i32 = 2;
/// Colours of points, lines and bars.
pub const BLUE_INK: RGBColor = RGBColor(47, 126, 216);
pub const ORANGE_INK: RGBColor = RGBColor(230, 126, 34);

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
        Self { name, range, ticks: 6, label: with_few_decimals }
    }

    /// Returns an axis of ranks from 1 to `last`, with a logarithmic scale because the first ranks matter most.
    pub fn ranks(name: &'static str, last: usize) -> Self {
        let most = (last as f64).log10();
        Self { name, range: [0.0, most], ticks: 4, label: |power| format!("{:.0}", 10.0_f64.powf(power)) }
    }
}

pub struct Axes {
    pub x: Axis,
    pub y: Axis,
}

impl Axes {
    pub fn draw<'a, 'b>(self, area: &'a Area<'b>) -> Result<Chart<'a, 'b>, DrawError> {
        let (Self { x, y }, [x0, x1], [y0, y1]) = (&self, self.x.range, self.y.range);
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
}

/// Returns the SVG text of a chart of `size_px` that `draw` fills.
pub fn svg(size_px: (u32, u32), draw: impl FnOnce(&Area) -> Result<(), DrawError>) -> Result<String> {
    let mut text = String::new();
    let area = SVGBackend::with_string(&mut text, size_px).into_drawing_area();
    draw(&area).and_then(|()| area.present()).map_err(|error| anyhow!("cannot draw: {error}"))?;
    drop(area);
    // Plotters writes these default attributes for every point: half of a page of 60,000 points.
    Ok(text.replace(" opacity=\"1\"", "").replace(" stroke=\"none\" stroke-width=\"1\"", ""))
}

/// Draws scatter plots, the last one on top, and straight lines over them.
pub fn scatter(clouds: &[(&[(f64, f64)], RGBColor)], axes: Axes, lines: &[[(f64, f64); 2]]) -> Result<String> {
    svg(SIZE_PX, |area| {
        let mut chart = axes.draw(area)?;
        for (points, ink) in clouds {
            chart.draw_series(points.iter().map(|point| Circle::new(*point, POINT_PX, ink.filled())))?;
        }
        chart.draw_series(lines.iter().map(|line| PathElement::new(line.to_vec(), ORANGE_INK.stroke_width(2))))?;
        Ok(())
    })
}

/// Returns at most `most` of the values, evenly spaced.
pub fn subsample<T: Copy>(values: &[T], most: usize) -> Vec<T> {
    values.iter().step_by(values.len().div_ceil(most).max(1)).copied().collect()
}

/// Formats a number with as many decimals as it needs, at most two.
fn with_few_decimals(value: f64) -> String {
    format!("{}", (value * 100.0).round() / 100.0 + 0.0)
}
