//! `facewire-fit expressions`: compares the expressions that `synth` draws with recorded ones: density, distribution of
//! each blendshape, asymmetry, and correlations.

use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::Args;
use facewire_face::stages::MIRRORED;
use facewire_face::{BLENDSHAPES, COEFFS};
use maud::{Markup, html};
use nalgebra::DMatrix;
use plotters::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::anatomy::enforce_limits;
use super::expression::Coefficients;
use super::options::{Curves, MixOptions, Set, mix_text};
use crate::drawing::{Axis, BLUE_INK, DrawError, ORANGE_INK, SIZE_PX, chart, svg};
use crate::output::{self, Table, figure, number};
use crate::shapes::MODELLED;
use crate::statistics::{mean, pearson};

#[derive(Debug, Args)]
#[command(after_help = "Examples:
  facewire-fit expressions expressions.html
  facewire-fit expressions speech.html --mix speech=1 --csv speech.csv
  facewire-fit expressions judge.html --set judge")]
pub struct Options {
    /// The page to write
    out: PathBuf,
    /// Number of expressions to draw
    #[arg(long, default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    count: u32,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Set of recordings to draw from and to compare with
    #[arg(long, value_enum, default_value = "train")]
    set: Set,
    /// CSV file for the drawn expressions
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    curves: Curves,
    #[command(flatten)]
    mix: MixOptions,
}

pub fn run(options: &Options) -> Result<()> {
    options.csv.iter().chain([&options.out]).try_for_each(|path| output::check(path))?;
    let moments = options.curves.moments(options.set)?;
    let mut recorded = moments.frames.clone();
    ensure!(recorded.len() > 1, "the recordings have too few frames to compare with");
    recorded.iter_mut().for_each(enforce_limits);
    let expressions = options.mix.expressions(options.set, moments)?;
    let mut rng = ChaCha8Rng::seed_from_u64(options.set.seed(options.seed));
    let sampled: Vec<Coefficients> = (0..options.count).map(|_| expressions.draw(&mut rng)).collect();
    if let Some(path) = &options.csv {
        output::write(path, table(&sampled))?;
    }
    let [recorded, sampled] = [recorded, sampled].map(|faces| Figures::of(&faces));
    print!("{}", density_table(&recorded, &sampled).text());
    println!("pairs of the sampled that are correlated above {TIED}:");
    for (one, other, correlation) in sampled.tied() {
        println!("  {} and {}: {correlation:.2}", BLENDSHAPES[one], BLENDSHAPES[other]);
    }
    let body = page(&recorded, &sampled, &mix_text(options.mix.mix(options.set)))?;
    output::write_page(&options.out, "Expressions", &CONTENTS, &[], &body)
}

fn table(faces: &[Coefficients]) -> String {
    let mut text = BLENDSHAPES.join(",") + "\n";
    for face in faces {
        text += &(face.map(|value| format!("{value:.4}")).join(",") + "\n");
    }
    text
}

/// Coefficients above these limits count as visible and as strong.
pub const VISIBLE: f64 = 0.1;
const STRONG: f64 = 0.3;
const ZERO: f64 = 0.01;
/// Two coefficients that are correlated more than this are hardly told apart by what is fitted to these expressions.
const TIED: f64 = 0.5;
const QUANTILES: [f64; 4] = [0.5, 0.75, 0.9, 0.99];

pub struct Figures {
    count: usize,
    /// Share of the expressions by their number of visible coefficients, from 0 on.
    pub densities: Vec<f64>,
    strong: f64,
    pub shapes: Vec<Marginal>,
    correlations: DMatrix<f64>,
}

pub struct Marginal {
    index: usize,
    pub zero: f64,
    pub quantiles: [f64; QUANTILES.len()],
    /// If it has two sides: their mean absolute difference and their correlation. Only the left side has them.
    pub sides: Option<[f64; 2]>,
}

impl Figures {
    pub fn of(faces: &[Coefficients]) -> Self {
        let columns: Vec<Vec<f64>> =
            (0..COEFFS).map(|index| faces.iter().map(|face| f64::from(face[index])).collect()).collect();
        let mut densities = vec![0.0; COEFFS + 1];
        for face in faces {
            densities[above(face, VISIBLE)] += 1.0 / faces.len() as f64;
        }
        Self {
            count: faces.len(),
            densities,
            strong: mean(faces.iter().map(|face| above(face, STRONG) as f64)),
            shapes: (0..MODELLED).map(|index| Marginal::of(index, &columns)).collect(),
            correlations: DMatrix::from_fn(MODELLED, MODELLED, |a, b| pearson(&columns[a], &columns[b])),
        }
    }

    pub fn visible(&self) -> f64 {
        self.densities.iter().enumerate().map(|(count, share)| count as f64 * share).sum()
    }

    /// The pairs of coefficients that are correlated above [`TIED`], but for those of both sides, and of the gaze.
    pub fn tied(&self) -> Vec<(usize, usize, f64)> {
        let is_listed =
            |index: &usize| !BLENDSHAPES[*index].ends_with("Right") && !BLENDSHAPES[*index].starts_with("eyeLook");
        let listed: Vec<usize> = (0..MODELLED).filter(is_listed).collect();
        let pairs =
            listed.iter().enumerate().flat_map(|(place, one)| listed[place + 1..].iter().map(|other| (*one, *other)));
        let correlated = pairs.map(|(one, other)| (one, other, self.correlations[(one, other)]));
        correlated.filter(|(_, _, correlation)| *correlation > TIED).collect()
    }

    /// Returns the smallest number of visible coefficients that this share of the expressions does not exceed.
    pub fn density_quantile(&self, share: f64) -> usize {
        let mut sum = 0.0;
        let reached = |own: &f64| {
            sum += own;
            sum >= share
        };
        self.densities.iter().position(reached).unwrap_or(COEFFS)
    }
}

impl Marginal {
    fn of(index: usize, columns: &[Vec<f64>]) -> Self {
        let own = &columns[index];
        let mut sorted = own.clone();
        sorted.sort_by(f64::total_cmp);
        let quantile = |share: f64| sorted[(share * (sorted.len() - 1) as f64).round() as usize];
        let other = &columns[MIRRORED[index]];
        let gap = || mean(own.iter().zip(other).map(|(left, right)| (left - right).abs()));
        Self {
            index,
            zero: mean(own.iter().map(|value| f64::from(u8::from(*value < ZERO)))),
            quantiles: QUANTILES.map(quantile),
            sides: BLENDSHAPES[index].ends_with("Left").then(|| [gap(), pearson(own, other)]),
        }
    }
}

pub fn above(face: &Coefficients, limit: f64) -> usize {
    face.iter().filter(|value| f64::from(**value) > limit).count()
}

const CELL_PX: i32 = 12;
const NAMES_PX: i32 = 130;
const ROW_PX: i32 = 14;
const RANGES_PX: u32 = 560;
const TEXT: (&str, i32) = ("sans-serif", 10);

pub fn densities(recorded: &Figures, sampled: &Figures) -> Result<String> {
    let both = [(recorded, BLUE_INK), (sampled, ORANGE_INK)];
    let percent = |figures: &Figures| -> Vec<(f64, f64)> {
        figures.densities.iter().enumerate().map(|(count, share)| (count as f64, 100.0 * share)).collect()
    };
    let most = both.iter().flat_map(|(figures, _)| percent(figures)).map(|(_, share)| share).fold(5.0, f64::max);
    let axes =
        [Axis::linear("coefficients above 0.1", [0.0, 45.0]), Axis::linear("% of the expressions", [0.0, most.ceil()])];
    svg(SIZE_PX, |area| {
        let mut chart = chart(area, &axes)?;
        for (figures, ink) in both {
            let points = percent(figures).into_iter().filter(|(count, _)| *count <= 45.0);
            chart.draw_series(LineSeries::new(points, ink.stroke_width(2)))?;
        }
        Ok(())
    })
}

/// Plots the range from the median to the 99th percentile, with a dot at the 90th: recorded (blue) above sampled.
fn ranges(recorded: &Figures, sampled: &Figures) -> Result<String> {
    let height = 2 * ROW_PX + ROW_PX * i32::try_from(MODELLED)?;
    svg((RANGES_PX, height.unsigned_abs()), |area| {
        let width = RANGES_PX.cast_signed() - NAMES_PX - 20;
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

fn matrix(values: &DMatrix<f64>) -> Result<String> {
    let size = NAMES_PX + CELL_PX * i32::try_from(MODELLED)?;
    svg((size.unsigned_abs(), size.unsigned_abs()), |area| -> Result<(), DrawError> {
        for (row, name) in (0..).zip(&BLENDSHAPES[..MODELLED]) {
            let at = NAMES_PX + row * CELL_PX;
            area.draw(&Text::new(*name, (4, at + 1), TEXT))?;
            let upright = TEXT.into_text_style(area).transform(FontTransform::Rotate270);
            area.draw(&Text::new(*name, (at + 1, NAMES_PX - 4), upright))?;
        }
        for (row, cells) in (0..).zip(values.row_iter()) {
            for (column, value) in (0..).zip(&cells) {
                let corner = (NAMES_PX + column * CELL_PX, NAMES_PX + row * CELL_PX);
                let cell = [corner, (corner.0 + CELL_PX, corner.1 + CELL_PX)];
                area.draw(&Rectangle::new(cell, colour(*value).filled()))?;
            }
        }
        Ok(())
    })
}

fn colour(value: f64) -> RGBColor {
    const ENDS: [[f64; 3]; 2] = [[33.0, 102.0, 172.0], [178.0, 24.0, 43.0]];
    let end = ENDS[usize::from(value > 0.0)];
    let [red, green, blue] = end.map(|end| (255.0 + value.abs().min(1.0) * (end - 255.0)).round() as u8);
    RGBColor(red, green, blue)
}

const COLOURS: &str = "Blue: recorded. Orange: sampled";

fn page(recorded: &Figures, sampled: &Figures, mix: &str) -> Result<Markup> {
    let difference = &sampled.correlations - &recorded.correlations;
    let maps = [&recorded.correlations, &sampled.correlations, &difference].map(matrix);
    let [recorded_map, sampled_map, difference_map] = maps;
    Ok(html! {
            p { "Sampled: " (mix) "." }
            h2 id="density" { "Density" }
            (density_table(recorded, sampled).html())
            div.figures { (figure(&densities(recorded, sampled)?, COLOURS, "Number of visible coefficients")) }
            h2 id="shapes" { "Blendshapes" }
            div.figures.large { (figure(&ranges(recorded, sampled)?, "Lines run from the median to the 99th percentile, dots are at the 90th. Blue: recorded. Orange: sampled", "Ranges")) }
            (shape_table(recorded, sampled).html())
            h2 id="sides" { "Left and right" }
            p { "The mean absolute difference of both sides, and their correlation." }
            (side_table(recorded, sampled).html())
            h2 id="correlations" { "Correlations" }
            div.figures.large {
                (figure(&recorded_map?, "Recorded: blue -1, white 0, red 1", "Correlations"))
                (figure(&sampled_map?, "Sampled", "Correlations"))
                (figure(&difference_map?, "Sampled minus recorded", "Differences of correlations"))
            }
    })
}

fn density_table(recorded: &Figures, sampled: &Figures) -> Table {
    let row = |name: &str, of: &dyn Fn(&Figures) -> String| vec![name.to_owned(), of(recorded), of(sampled)];
    let rows = [
        row("expressions", &|figures| figures.count.to_string()),
        row("coefficients above 0.1, mean", &|figures| format!("{:.1}", figures.visible())),
        row("5th percentile", &|figures| figures.density_quantile(0.05).to_string()),
        row("median", &|figures| figures.density_quantile(0.5).to_string()),
        row("95th percentile", &|figures| figures.density_quantile(0.95).to_string()),
        row("coefficients above 0.3, mean", &|figures| format!("{:.1}", figures.strong)),
        row("% at rest (none above 0.1)", &|figures| format!("{:.1}", 100.0 * figures.densities[0])),
    ];
    Table::new(["statistic", "recorded", "sampled"], rows)
}

fn row(name: &str, values: impl IntoIterator<Item = f64>) -> Vec<String> {
    [name.to_owned()].into_iter().chain(values.into_iter().map(|value| number(Some(value), 2))).collect()
}

fn shape_table(recorded: &Figures, sampled: &Figures) -> Table {
    let quantiles = ["at 0", "median", "75 %", "90 %", "99 %"].into_iter().flat_map(|quantile| [quantile, "sampled"]);
    let cells = |(one, other): (&Marginal, &Marginal)| {
        let pairs = one.quantiles.iter().zip(&other.quantiles).flat_map(|(one, other)| [*one, *other]);
        row(BLENDSHAPES[one.index], [one.zero, other.zero].into_iter().chain(pairs))
    };
    Table::new(["blendshape"].into_iter().chain(quantiles), recorded.shapes.iter().zip(&sampled.shapes).map(cells))
}

fn side_table(recorded: &Figures, sampled: &Figures) -> Table {
    let sides = recorded.shapes.iter().zip(&sampled.shapes).filter_map(|(one, other)| {
        let ([gap, r], [sampled_gap, sampled_r]) = (one.sides?, other.sides?);
        Some(row(BLENDSHAPES[one.index].trim_end_matches("Left"), [gap, sampled_gap, r, sampled_r]))
    });
    Table::new(["blendshape", "difference", "sampled", "correlation", "sampled"], sides)
}

const CONTENTS: [(&str, &str); 4] =
    [("density", "Density"), ("shapes", "Blendshapes"), ("sides", "Left and right"), ("correlations", "Correlations")];
