//! Charts of the report.

use anyhow::Result;
use plotters::prelude::*;

use crate::drawing::{Axes, Axis, BLUE_INK, ORANGE_INK, POINT_PX, SIZE_PX, scatter, subsample, svg};

/// Number of points in a scatter plot: enough to see its shape, and few enough for fifty plots on a page.
const CLOUD: usize = 300;
/// Number of these points with the largest coefficients.
const LARGEST: usize = 200;

/// Plots estimate against truth, with a diagonal.
pub fn fit(pairs: &[(f64, f64)]) -> Result<String> {
    let points: Vec<_> = thinned(pairs).into_iter().map(|(estimate, truth)| (truth, estimate)).collect();
    let axes = Axes { x: Axis::linear("truth", [0.0, 1.0]), y: Axis::linear("estimate", [0.0, 1.0]) };
    scatter(&[(&points, BLUE_INK)], axes, &[[(0.0, 0.0), (1.0, 1.0)]])
}

pub fn residuals(pairs: &[(f64, f64)]) -> Result<String> {
    let points: Vec<_> = thinned(pairs).into_iter().map(|(estimate, truth)| (estimate, truth - estimate)).collect();
    let axes = Axes { x: Axis::linear("estimate", [0.0, 1.0]), y: Axis::linear("residual", [-1.0, 1.0]) };
    scatter(&[(&points, BLUE_INK)], axes, &[[(0.0, 0.0), (1.0, 0.0)]])
}

/// Plots the displacement against the truth for a landmark that follows the blendshape (blue) and one that does not
/// (orange).
pub fn movements(follows: &[(f64, f64)], rests: &[(f64, f64)]) -> Result<String> {
    let largest = follows.iter().chain(rests).map(|(_, moved)| moved.abs()).fold(0.0, f64::max);
    let axes = Axes { x: Axis::linear("truth", [0.0, 1.0]), y: Axis::linear("displacement", [-largest, largest]) };
    let half = |points: &[(f64, f64)]| subsample(&thinned(points), CLOUD / 2);
    scatter(&[(&half(rests), ORANGE_INK), (&half(follows), BLUE_INK)], axes, &[])
}

/// Returns at most [`CLOUD`] points: those with the largest coordinates, and a sample of the others. A plain sample
/// would mostly show zeros, because most blendshapes are 0 in most pictures.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| b.0.max(b.1).total_cmp(&a.0.max(a.1)));
    let (largest, others) = sorted.split_at(sorted.len().min(LARGEST));
    [largest.to_vec(), subsample(others, CLOUD - LARGEST)].concat()
}

/// Plots truth and estimates of all pictures, both in the order of the truth.
pub fn ranked(pairs: &[(f64, f64)]) -> Result<String> {
    let mut pairs = pairs.to_vec();
    pairs.sort_by(|a, b| a.1.total_cmp(&b.1));
    let pairs = subsample(&pairs, CLOUD);
    let percent = |index: usize| 100.0 * index as f64 / pairs.len() as f64;
    let axes =
        Axes { x: Axis::linear("% of pictures, by truth", [0.0, 100.0]), y: Axis::linear("coefficient", [0.0, 1.0]) };
    svg(SIZE_PX, |area| {
        let mut chart = axes.draw(area)?;
        let points = pairs.iter().enumerate().map(|(index, pair)| (percent(index), pair.0));
        chart.draw_series(points.map(|point| Circle::new(point, POINT_PX, BLUE_INK.filled())))?;
        let line = pairs.iter().enumerate().map(|(index, pair)| (percent(index), pair.1));
        chart.draw_series(LineSeries::new(line, ORANGE_INK.stroke_width(2)))?;
        Ok(())
    })
}

/// Plots the autocorrelation by lag, with the 95 % limits of uncorrelated values.
pub fn autocorrelation(lags: &[f64], values: usize) -> Result<String> {
    let last = lags.len() as f64;
    let axes = Axes { x: Axis::linear("lag", [0.0, last]), y: Axis::linear("autocorrelation", [-0.5, 1.0]) };
    let limit = 1.96 / (values as f64).sqrt();
    svg(SIZE_PX, |area| {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scatter_plot_has_no_more_points_than_a_page_can_carry() {
        let pairs: Vec<_> = (0..5000).map(|i| (f64::from(i) / 5000.0, 0.5)).collect();
        let drawing = fit(&pairs).unwrap();
        assert!((LARGEST..=CLOUD).contains(&drawing.matches("<circle").count()));
    }
}
