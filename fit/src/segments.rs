//! `facewire-fit select`: the paper's segmentation (eq. 4), the selection of features by correlation, for inspection.
//!
//! For every blendshape, the features (coordinates and distances, as displacements from the subject's neutral face) are
//! ranked by their correlation with the coefficient, and the best few percent are kept. Two other rankings check this
//! one: by partial F and by support vectors. The F of a single feature orders features like r squared, so it would be
//! no check. The partial F, which controls for the subject, the head's pose and all other blendshapes, distinguishes
//! features that move with this blendshape from those that move with others that usually accompany it. The model that
//! facewire runs shares its features among all blendshapes and selects them in another way (`design.rs`).

pub mod tables;

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use facewire_face::BLENDSHAPES;
use facewire_face::model::MEASURES;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::compare::Split;
use crate::dataset::{self, Sample};
use crate::faces::Faces;
use crate::shapes::{MODELLED, modelled};
use crate::statistics::{Regressors, f_regression, mean, pearson, r_squared, spearman, standard_deviation, subsample};
use crate::{kinds, output};

#[derive(Debug, Args)]
pub struct SelectArgs {
    /// Landmarks with true coefficients (npz archive with names.json beside it)
    dataset: PathBuf,
    /// A blendshape to rank features for; may be repeated [default: all]
    #[arg(long, value_name = "NAME", value_parser = modelled)]
    blendshape: Vec<usize>,
    /// The page to write
    #[arg(long, value_name = "FILE", default_value = "segments.html")]
    out: PathBuf,
    /// CSV file for all scores and ranks
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Percentage of the features to keep
    #[arg(long, default_value_t = 2.0, value_parser = percentile)]
    percentile: f64,
    /// Largest number of pictures to fit support vectors to, and to judge them by
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(20..=5000))]
    svr_rows: u32,
}

fn percentile(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (0.1..=50.0).contains(number));
    number.ok_or_else(|| "not a number from 0.1 to 50".to_owned())
}

pub fn run(args: &SelectArgs) -> Result<()> {
    args.csv.iter().chain([&args.out]).try_for_each(|path| output::check(path))?;
    let samples = dataset::load(&args.dataset)?;
    let (known, unknown) = (Faces::new(&samples, true)?, Faces::new(&samples, false)?);
    let pictures = Pictures::new(&samples, &known)?;
    let kept = kept_count(args.percentile);
    let segments = segments(&pictures, &args.blendshape, kept, args.svr_rows as usize)?;
    print!("{}", tables::summary(&segments).text());
    if let Some(path) = &args.csv {
        tables::write_csv(path, &segments).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let names: Vec<String> = segments.iter().map(|own| BLENDSHAPES[own.blendshape].to_owned()).collect();
    let body = tables::page(&pictures, &unknown, &segments, &args.dataset)?;
    let contents = [("all", "All blendshapes"), ("guide", "How to read it")];
    output::write_page(&args.out, "Segmentation", &contents, &names, &body)
}

pub fn kept_count(percentile: f64) -> usize {
    (MEASURES as f64 * percentile / 100.0).ceil() as usize
}

pub fn segments(pictures: &Pictures, wanted: &[usize], kept: usize, most_rows: usize) -> Result<Vec<Segment>> {
    let moving = pictures.known.moving(wanted, &[&pictures.seen, &pictures.held_out])?;
    let (r, partial_f) = (pictures.correlations(&moving), pictures.partial_f(&moving)?);
    let mut segments = Vec::new();
    for (index, (blendshape, (r, partial_f))) in moving.iter().zip(r.into_iter().zip(partial_f)).enumerate() {
        eprint!("\rsupport vectors: blendshape {} of {} ", index + 1, moving.len());
        let f_alone = r.iter().map(|r| f_regression(*r, pictures.seen.len())).collect();
        let r2 = scores(pictures, *blendshape, most_rows)?;
        let rankings = [r.iter().map(|r| r.abs()).collect(), partial_f, r2].map(Ranking::new);
        segments.push(Segment { blendshape: *blendshape, r, f_alone, rankings, count: kept });
    }
    eprintln!();
    Ok(segments)
}

const NAMES: [&str; 3] = ["r", "F", "SVR"];
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

#[derive(Debug, Clone, PartialEq)]
pub struct Ranking {
    pub scores: Vec<f64>,
    /// Rank of each feature, from 1. Of features with equal scores, the first has the better rank.
    pub ranks: Vec<usize>,
    pub order: Vec<usize>,
}

impl Ranking {
    pub fn new(scores: Vec<f64>) -> Self {
        let mut order: Vec<usize> = (0..scores.len()).collect();
        order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        let mut ranks = vec![0; scores.len()];
        order.iter().enumerate().for_each(|(index, feature)| ranks[*feature] = index + 1);
        Self { scores, ranks, order }
    }

    /// Returns the share of the best `count` features that are also among the best `count` of another ranking.
    pub fn overlap(&self, other: &Self, count: usize) -> f64 {
        let best = self.order.iter().take(count);
        best.filter(|feature| other.ranks[**feature] <= count).count() as f64 / count as f64
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    pub blendshape: usize,
    pub r: Vec<f64>,
    /// F of each feature alone, which has the order of `r` squared.
    pub f_alone: Vec<f64>,
    pub rankings: [Ranking; NAMES.len()],
    pub count: usize,
}

impl Segment {
    /// Returns the features that are kept: those with the highest correlation, best first.
    pub fn kept(&self) -> &[usize] {
        &self.rankings[0].order[..self.count]
    }

    pub fn keeps(&self, feature: usize) -> bool {
        self.rankings[0].ranks[feature] <= self.count
    }

    pub fn agreements(&self) -> [f64; 2 * PAIRS.len()] {
        core::array::from_fn(|index| {
            let (a, b) = PAIRS[index % PAIRS.len()];
            let (one, other) = (&self.rankings[a], &self.rankings[b]);
            if index < PAIRS.len() { one.overlap(other, self.count) } else { spearman(&one.scores, &other.scores) }
        })
    }
}

const ANGLES: usize = 3;

/// Pictures of subjects that the fit may see, to rank features on, and held-out ones to judge support vectors by.
pub struct Pictures<'a> {
    samples: &'a [Sample],
    pub known: &'a Faces<'a>,
    pub seen: Vec<usize>,
    pub held_out: Vec<usize>,
}

impl<'a> Pictures<'a> {
    pub fn new(samples: &'a [Sample], known: &'a Faces<'a>) -> Result<Self> {
        let held_out = known.rows(false)?;
        let seen: Vec<usize> = (0..samples.len()).filter(|row| !samples[*row].held_out()).collect();
        Ok(Self { samples, known, seen, held_out })
    }

    /// Takes a split into pictures that a fit may see, and held-out ones.
    pub fn of_split(samples: &'a [Sample], known: &'a Faces<'a>, split: &Split) -> Self {
        Self { samples, known, seen: split.seen.clone(), held_out: split.held_out.clone() }
    }

    pub fn feature(&self, feature: usize, rows: &[usize]) -> Vec<f64> {
        rows.iter().map(|row| f64::from(self.known.values(*row)[feature])).collect()
    }

    pub fn correlations(&self, blendshapes: &[usize]) -> Vec<Vec<f64>> {
        let truths: Vec<Vec<f64>> = blendshapes.iter().map(|shape| self.known.truth(*shape, &self.seen)).collect();
        let of = |feature: usize| {
            let values = self.feature(feature, &self.seen);
            truths.iter().map(|truth| pearson(&values, truth)).collect()
        };
        transposed(&(0..MEASURES).into_par_iter().map(of).collect::<Vec<Vec<f64>>>(), blendshapes.len())
    }

    /// Returns the partial F of every feature, controlling for the subject, the true pose and all other blendshapes.
    pub fn partial_f(&self, blendshapes: &[usize]) -> Result<Vec<Vec<f64>>> {
        let held = DMatrix::from_fn(self.seen.len(), MODELLED + ANGLES, |row, column| {
            let sample = &self.samples[self.seen[row]];
            if column < MODELLED { sample.truth[column] } else { sample.pose_deg[column - MODELLED] }
        });
        let subjects: Vec<usize> = self.seen.iter().map(|row| self.samples[*row].subject).collect();
        let regressors = Regressors::new(held, &subjects).context("too few pictures of each subject")?;
        let of = |feature: usize| {
            let all = regressors.partial_f(&self.feature(feature, &self.seen));
            blendshapes.iter().map(|shape| all[*shape]).collect()
        };
        Ok(transposed(&(0..MEASURES).into_par_iter().map(of).collect::<Vec<Vec<f64>>>(), blendshapes.len()))
    }
}

fn transposed(rows: &[Vec<f64>], columns: usize) -> Vec<Vec<f64>> {
    (0..columns).map(|column| rows.iter().map(|row| row[column]).collect()).collect()
}

// The ranking by support vectors: how well a support vector regression with a Gaussian kernel predicts the coefficient
// from a single feature.
//
// The importance of a feature in a regression on all features would tell little, because neighbouring landmarks move
// alike and each of them is dispensable.

/// Coefficient above which a picture shows the expression.
const SHOWS: f64 = 0.05;

/// Returns R2 of a regression on each feature, fitted to at most `most` pictures and judged on at most as many of
/// held-out subjects. At least half of these pictures show the expression, if there are enough of them.
fn scores(pictures: &Pictures, blendshape: usize, most: usize) -> Result<Vec<f64>> {
    let [fitted, judged] = [&pictures.seen, &pictures.held_out].map(|rows| bounded(pictures, blendshape, rows, most));
    let [own, other] = [&fitted, &judged].map(|rows| pictures.known.truth(blendshape, rows));
    let score = |feature: usize| {
        let (own_values, other_values) = (pictures.feature(feature, &fitted), pictures.feature(feature, &judged));
        Ok(r_squared(&estimates(&own_values, &own, &other_values)?, &other))
    };
    (0..MEASURES).into_par_iter().map(score).collect()
}

/// Returns at most `most` rows, evenly spaced by coefficient among those that show the expression, and the rest.
fn bounded(pictures: &Pictures, blendshape: usize, rows: &[usize], most: usize) -> Vec<usize> {
    let mut by_truth: Vec<_> = rows.iter().copied().zip(pictures.known.truth(blendshape, rows)).collect();
    by_truth.sort_by(|a, b| a.1.total_cmp(&b.1));
    let sorted: Vec<usize> = by_truth.iter().map(|(row, _)| *row).collect();
    let (rests, shows) = sorted.split_at(by_truth.partition_point(|(_, truth)| *truth < SHOWS));
    let showing = subsample(shows, (most / 2).max(most.saturating_sub(rests.len())));
    [subsample(rests, most - showing.len()), showing].concat()
}

pub fn estimates(values: &[f64], truth: &[f64], others: &[f64]) -> Result<Vec<f64>> {
    let (centre, deviation) = (mean(values.iter().copied()), standard_deviation(values).max(f64::EPSILON));
    let scaled = |value: &f64| (value - centre) / deviation;
    let faces = DMatrix::from_iterator(values.len(), 1, values.iter().map(scaled));
    let fitted = kinds::support_vectors(&faces, truth)?;
    Ok(others.iter().map(|value| fitted.predict(&[scaled(value)])).collect())
}
