//! Charts of the page of expressions.

use anyhow::Result;
use facewire::solve::BLENDSHAPES;
use plotters::prelude::*;

use super::figures::Figures;
use crate::{
    design::MODELLED,
    drawing::{Axes, Axis, BLUE_INK, DrawError, ORANGE_INK, SIZE_PX, svg},
};

/// Size of a cell of a heat map, and room for the names beside the cells.
const CELL_PX: i32 = 12;
const NAMES_PX: i32 = 130;
/// Height of a row of the chart of ranges, and its width.
const ROW_PX: i32 = 14;
const RANGES_PX: u32 = 560;
const TEXT: (&str, i32) = ("sans-serif", 10);

/// Plots the distribution of the number of visible coefficients: recorded (blue) and sampled (orange).
pub fn densities(recorded: &Figures, sampled: &Figures) -> Result<String> {
    let both = [(recorded, BLUE_INK), (sampled, ORANGE_INK)];
    let percent = |figures: &Figures| -> Vec<(f64, f64)> {
        figures.densities.iter().enumerate().map(|(count, share)| (count as f64, 100.0 * share)).collect()
    };
    let most = both.iter().flat_map(|(figures, _)| percent(figures)).map(|(_, share)| share).fold(5.0, f64::max);
    let axes = Axes {
        x: Axis::linear("coefficients above 0.1", [0.0, 45.0]),
        y: Axis::linear("% of the expressions", [0.0, most.ceil()]),
    };
    svg(SIZE_PX, |area| {
        let mut chart = axes.draw(area)?;
        for (figures, ink) in both {
            let points = percent(figures).into_iter().filter(|(count, _)| *count <= 45.0);
            chart.draw_series(LineSeries::new(points, ink.stroke_width(2)))?;
        }
        Ok(())
    })
}

/// Plots the range from the median to the 99th percentile of every blendshape, with a dot at the 90th: recorded (blue)
/// above sampled (orange).
pub fn ranges(recorded: &Figures, sampled: &Figures) -> Result<String> {
    let height = 2 * ROW_PX + ROW_PX * i32::try_from(MODELLED)?;
    svg((RANGES_PX, height.unsigned_abs()), |area| {
        let width = RANGES_PX.cast_signed() - NAMES_PX - 20;
        #[expect(clippy::cast_possible_truncation, reason = "pixels")]
        let x = |value: f64| NAMES_PX + (value * f64::from(width)) as i32;
        for tenths in [0, 2, 4, 6, 8, 10] {
            let value = f64::from(tenths) / 10.0;
            area.draw(&PathElement::new([(x(value), 0), (x(value), height - ROW_PX)], BLACK.mix(0.15)))?;
            area.draw(&Text::new(format!("{value:.1}"), (x(value) - 8, height - ROW_PX), TEXT))?;
        }
        for (row, name) in (0..).zip(&BLENDSHAPES[..MODELLED]) {
            area.draw(&Text::new(*name, (4, row * ROW_PX + 2), TEXT))?;
        }
        for (figures, ink, offset) in [(recorded, BLUE_INK, 4), (sampled, ORANGE_INK, 9)] {
            for (row, shape) in (0..).zip(&figures.shapes) {
                let y = row * ROW_PX + offset;
                let [median, _, high, highest] = shape.quantiles;
                area.draw(&PathElement::new([(x(median), y), (x(highest), y)], ink.stroke_width(2)))?;
                area.draw(&Circle::new((x(high), y), 3, ink.filled()))?;
            }
        }
        Ok(())
    })
}

/// Draws a matrix of numbers from -1 (blue) to 1 (red) for all pairs of blendshapes.
pub fn matrix(values: &[Vec<f64>]) -> Result<String> {
    let size = NAMES_PX + CELL_PX * i32::try_from(MODELLED)?;
    svg((size.unsigned_abs(), size.unsigned_abs()), |area| -> Result<(), DrawError> {
        for (row, name) in (0..).zip(&BLENDSHAPES[..MODELLED]) {
            let at = NAMES_PX + row * CELL_PX;
            area.draw(&Text::new(*name, (4, at + 1), TEXT))?;
            let upright = TEXT.into_text_style(area).transform(FontTransform::Rotate270);
            area.draw(&Text::new(*name, (at + 1, NAMES_PX - 4), upright))?;
        }
        for (row, cells) in (0..).zip(values) {
            for (column, value) in (0..).zip(cells) {
                let corner = (NAMES_PX + column * CELL_PX, NAMES_PX + row * CELL_PX);
                let cell = [corner, (corner.0 + CELL_PX, corner.1 + CELL_PX)];
                area.draw(&Rectangle::new(cell, colour(*value).filled()))?;
            }
        }
        Ok(())
    })
}

/// Maps -1 to 1 to colours from blue by way of white to red.
fn colour(value: f64) -> RGBColor {
    const ENDS: [[f64; 3]; 2] = [[33.0, 102.0, 172.0], [178.0, 24.0, 43.0]];
    let end = ENDS[usize::from(value > 0.0)];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "colours")]
    let [red, green, blue] = end.map(|end| (255.0 + value.abs().min(1.0) * (end - 255.0)).round() as u8);
    RGBColor(red, green, blue)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_run_from_blue_by_way_of_white_to_red() {
        assert_eq!(
            [-2.0, 0.0, 1.0].map(colour),
            [RGBColor(33, 102, 172), RGBColor(255, 255, 255), RGBColor(178, 24, 43)]
        );
    }

    #[test]
    fn a_matrix_has_a_cell_and_two_names_for_every_pair_of_names() {
        let drawing = matrix(&vec![vec![0.5; MODELLED]; MODELLED]).expect("a drawing");
        assert_eq!(drawing.matches("<rect").count(), MODELLED * MODELLED);
        assert_eq!(drawing.matches("<text").count(), 2 * MODELLED);
    }
}
