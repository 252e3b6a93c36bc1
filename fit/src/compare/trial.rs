//! One kind of model, fitted to one blendshape on every part of the pictures.

use std::{hint::black_box, time::Instant};

use anyhow::{Context, Result};
use facewire::solve::BLENDSHAPES;
use nalgebra::DMatrix;
use serde::Serialize;

use super::{
    ranking::{LEAST_DEVIATION, Moments, Ranking},
    split::Split,
};
use crate::{
    judge::Faces,
    kinds::{Form, Kind, Limits, Predictor, Response, with_response},
    statistics::{mse, pearson},
};

const SEED: u64 = 1;
/// Faces that the time is taken on, and passes over them, of which the fastest is the least disturbed.
const TIMED: usize = 100;
const TIMED_PASSES: usize = 7;
/// Memory of a number, and of the index of a feature.
const NUMBER_BYTES: usize = 4;
const INDEX_BYTES: usize = 2;

/// How a kind did on a blendshape.
#[derive(Debug, Clone, Serialize)]
pub struct Trial {
    /// Its kind.
    pub kind: &'static str,
    /// What is made of the truth before the fit.
    pub response: Response,
    /// What it computes.
    pub form: Form,
    /// Mean squared error on seen pictures by fits without their subjects, and its standard error.
    pub validation: [f64; 2],
    /// Pearson's correlation on held-out pictures.
    pub r: f64,
    /// Mean squared error on held-out pictures.
    pub mse: f64,
    /// Memory on a board.
    pub bytes: usize,
    /// Time for one face on this machine.
    pub nanoseconds: f64,
    /// Fitted weights beside the constant.
    pub weights: usize,
    /// Faces that it was fitted to.
    pub faces: usize,
    /// Features that it looks at.
    pub features: usize,
    /// Its coefficient for every held-out picture.
    #[serde(skip)]
    pub predictions: Vec<f64>,
}

impl Trial {
    /// Kind and response in words.
    pub fn name(&self) -> String {
        format!("{}{}", self.kind, self.response.suffix())
    }
}

/// Pictures to fit, and where to look in them. The last is of all seen ones.
pub struct Bench<'a> {
    /// What the solver sees of them.
    pub faces: &'a Faces<'a>,
    /// Which are for what.
    pub split: &'a Split,
    trainings: Vec<(Vec<usize>, Ranking)>,
}

impl<'a> Bench<'a> {
    /// Takes the moments of all features, once for each fold.
    pub fn new(faces: &'a Faces, split: &'a Split) -> Self {
        let moments: Vec<Moments> = (0..split.folds).map(|fold| Moments::of(faces, &split.validation(fold))).collect();
        let sum = |without: Option<usize>| {
            let kept = moments.iter().enumerate().filter(|(fold, _)| Some(*fold) != without);
            kept.fold(Moments::none(), |sum, (_, moments)| sum.with(moments)).standardised()
        };
        let folds = (0..split.folds).map(|fold| (split.training(fold), sum(Some(fold))));
        Self { faces, split, trainings: folds.chain([(split.seen.clone(), sum(None))]).collect() }
    }

    /// Most telling features of a blendshape, by fold and then for all seen pictures.
    pub fn rank(&self, blendshape: usize, count: usize) -> Vec<Vec<usize>> {
        self.trainings.iter().map(|(_, ranking)| ranking.best(blendshape, count)).collect()
    }

    /// Tries a kind with every response that suits it.
    pub fn try_kind(&self, kind: &dyn Kind, blendshape: usize, ranks: &[Vec<usize>]) -> Result<Vec<Tried>> {
        let responses = Response::tried_with(kind.form());
        responses.iter().map(|response| self.run(kind, *response, blendshape, ranks)).collect()
    }

    /// The trial, with the time of its model taken now.
    pub fn timed(&self, tried: Tried) -> Trial {
        let nanoseconds = tried.model.nanoseconds(self.faces, &self.split.held_out);
        Trial { nanoseconds, ..tried.trial }
    }

    fn run(&self, kind: &dyn Kind, response: Response, blendshape: usize, ranks: &[Vec<usize>]) -> Result<Tried> {
        let fit = |training: usize| {
            let job = Job { bench: self, training, blendshape, features: &ranks[training] };
            job.fit(kind, response)
        };
        let mut errors = vec![0.0; self.faces.len()];
        for fold in 0..self.split.folds {
            let rows = self.split.validation(fold);
            let estimates = fit(fold)?.estimates(self.faces, &rows);
            let truth = self.faces.truth(blendshape, &rows);
            let squares = estimates.iter().zip(truth).map(|(estimate, truth)| (estimate - truth).powi(2));
            rows.iter().zip(squares).for_each(|(row, square)| errors[*row] = square);
        }
        let errors: Vec<f64> = self.split.seen.iter().map(|row| errors[*row]).collect();
        let fitted = fit(self.split.folds)?;
        let truth = self.faces.truth(blendshape, &self.split.held_out);
        let predictions = fitted.estimates(self.faces, &self.split.held_out);
        let features = fitted.scale.features.len();
        let trial = Trial {
            kind: kind.name(),
            response,
            form: kind.form(),
            validation: self.split.mean_error(&errors),
            r: pearson(&predictions, &truth),
            mse: mse(&predictions, &truth),
            bytes: NUMBER_BYTES * fitted.numbers() + INDEX_BYTES * features,
            nanoseconds: f64::INFINITY,
            weights: fitted.model.weights(),
            faces: fitted.faces,
            features,
            predictions,
        };
        Ok(Tried { trial, model: fitted })
    }
}

/// A trial whose time is yet to be taken.
pub struct Tried {
    trial: Trial,
    model: Fitted,
}

/// A blendshape to be fitted on one part of the pictures.
struct Job<'a> {
    bench: &'a Bench<'a>,
    training: usize,
    blendshape: usize,
    features: &'a [usize],
}

impl Job<'_> {
    fn fit(&self, kind: &dyn Kind, response: Response) -> Result<Fitted> {
        let Limits { features, faces } = kind.limits();
        let rows = sample(&self.bench.trainings[self.training].0, faces);
        let features = &self.features[..features.min(self.features.len())];
        let scale = Scale::of(self.bench.faces, &rows, features);
        let matrix = scale.matrix(self.bench.faces, &rows);
        let truth = self.bench.faces.truth(self.blendshape, &rows);
        let model = with_response(kind, response, &matrix, &truth)
            .with_context(|| format!("{} cannot be fitted to {}", kind.name(), BLENDSHAPES[self.blendshape]))?;
        Ok(Fitted { model, scale, faces: rows.len() })
    }
}

/// At most `most` of the rows, the same ones each time.
fn sample(rows: &[usize], most: usize) -> Vec<usize> {
    let mut rows = rows.to_vec();
    if rows.len() > most {
        fastrand::Rng::with_seed(SEED).shuffle(&mut rows);
        rows.truncate(most);
    }
    rows
}

/// Features, and mean and deviation of each.
struct Scale {
    features: Vec<usize>,
    mean: Vec<f64>,
    deviation: Vec<f64>,
}

impl Scale {
    fn of(faces: &Faces, rows: &[usize], features: &[usize]) -> Self {
        let moments = |feature: &usize| {
            let values = rows.iter().map(|row| f64::from(faces.values(*row)[*feature]));
            let column = nalgebra::DVector::from_iterator(rows.len(), values);
            (column.mean(), column.variance().sqrt().max(LEAST_DEVIATION))
        };
        let (mean, deviation) = features.iter().map(moments).unzip();
        Self { features: features.to_vec(), mean, deviation }
    }

    fn standardised(&self, faces: &Faces, row: usize) -> impl Iterator<Item = f64> {
        let values = faces.values(row);
        let scale = self.mean.iter().zip(&self.deviation);
        self.features
            .iter()
            .zip(scale)
            .map(|(feature, (mean, deviation))| (f64::from(values[*feature]) - mean) / deviation)
    }

    fn matrix(&self, faces: &Faces, rows: &[usize]) -> DMatrix<f64> {
        let values = rows.iter().flat_map(|row| self.standardised(faces, *row));
        DMatrix::from_row_iterator(rows.len(), self.features.len(), values)
    }
}

/// A model with the scale of its features.
struct Fitted {
    model: Box<dyn Predictor>,
    scale: Scale,
    faces: usize,
}

impl Fitted {
    /// Coefficients of some pictures.
    fn estimates(&self, faces: &Faces, rows: &[usize]) -> Vec<f64> {
        let one = |row: &usize| {
            let face: Vec<f64> = self.scale.standardised(faces, *row).collect();
            self.model.predict(&face).clamp(0.0, 1.0)
        };
        rows.iter().map(one).collect()
    }

    /// Numbers to be kept: of the model, and of the scale of its features where it cannot be taken into the weights.
    fn numbers(&self) -> usize {
        let scale = if self.model.needs_scale() { 2 * self.scale.features.len() } else { 0 };
        self.model.numbers() + scale
    }

    fn nanoseconds(&self, faces: &Faces, rows: &[usize]) -> f64 {
        let rows = &rows[..rows.len().min(TIMED)];
        let mut timed: Vec<Vec<f64>> = rows.iter().map(|row| self.scale.standardised(faces, *row).collect()).collect();
        let mut pass = || {
            let start = Instant::now();
            for (face, row) in timed.iter_mut().zip(rows) {
                if self.model.needs_scale() {
                    face.iter_mut().zip(self.scale.standardised(faces, *row)).for_each(|(slot, value)| *slot = value);
                }
                black_box(self.model.predict(black_box(face)));
            }
            start.elapsed().as_secs_f64() * 1e9 / timed.len() as f64
        };
        (0..TIMED_PASSES).map(|_| pass()).fold(f64::INFINITY, f64::min)
    }
}
