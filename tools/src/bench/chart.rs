//! Draws the distribution of latencies.

use std::fmt::Display;
use std::fs;
use std::path::Path;
use std::time::Duration;

use plotters::prelude::*;

use super::figures::quantile;
use facewire::cli::Failure;

const SIZE_PX: (u32, u32) = (800, 480);
/// Share of the frames that the drawing is wide enough for.
const SHOWN: f64 = 0.999;

/// Draws the share of frames over the milliseconds that they took at most.
pub fn draw(path: &Path, samples: &[Duration]) -> Result<(), Failure> {
    let mut sorted = samples.to_vec();
    sorted.sort_unstable();
    let ms = |sample: &Duration| sample.as_secs_f64() * 1000.0;
    let widest_ms = 1.1 * ms(&quantile(&sorted, SHOWN));
    let steps =
        sorted.iter().zip(1..).map(|(sample, rank)| (ms(sample), 100.0 * f64::from(rank) / sorted.len() as f64));

    let mut svg = String::new();
    let drawing = SVGBackend::with_string(&mut svg, SIZE_PX).into_drawing_area();
    let failed =
        |error: &dyn Display| Failure::failed(format!("cannot draw {}: {error}; leave out --svg", path.display()));
    drawing.fill(&WHITE).map_err(|error| failed(&error))?;
    let mut chart = ChartBuilder::on(&drawing)
        .margin(16)
        .caption("From a frame in memory to its coefficients", ("sans-serif", 20))
        .x_label_area_size(40)
        .y_label_area_size(50)
        .build_cartesian_2d(0.0..widest_ms, 0.0..100.0)
        .map_err(|error| failed(&error))?;
    let mut mesh = chart.configure_mesh();
    mesh.x_desc("milliseconds").y_desc("% of frames").draw().map_err(|error| failed(&error))?;
    let line = LineSeries::new(steps.filter(|(ms, _)| *ms <= widest_ms), BLUE.stroke_width(2));
    chart.draw_series(line).map_err(|error| failed(&error))?;
    drawing.present().map_err(|error| failed(&error))?;
    drop(chart);
    drop(drawing);
    fs::write(path, svg).map_err(|error| Failure::unwritable(path, &error))
}
