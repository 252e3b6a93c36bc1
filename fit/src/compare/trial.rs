//! Trials: one kind of model, fitted to one blendshape on every fold.

use std::{hint::black_box, time::Instant};

use anyhow::{Context, Result};
use facewire::solve::{BLENDSHAPES, Correction, Response};
use nalgebra::DMatrix;
use serde::Serialize;

use super::{
    ranking::{LEAST_DEVIATION, Moments, Ranking},
    split::Split,
};
use crate::{
    judge::Faces,
    kinds::{Form, Formula, Kind, Limits, Predictor, suffix, suited_to, with_response},
    statistics::{mse, pearson},
};

const SEED: u64 = 1;
/// Number of faces to time, and number of passes over them. The fastest pass counts, because other load disturbs it
/// least.
const TIMED: usize = 100;
const TIMED_PASSES: usize = 7;
/// Bytes of a number, and of the index of a feature.
const NUMBER_BYTES: usize = 4;
const INDEX_BYTES: usize = 2;

/// The result of one kind of model on one blendshape.
#[derive(Debug, Clone, Serialize)]
pub struct Trial {
    /// Name of the kind.
    pub kind: &'static str,
    /// Transformation of the truth before the fit.
    pub response: Response,
    /// What the model computes.
    pub form: Form,
    /// Cross-validated mean squared error on the seen pictures, and its standard error.
    pub validation: [f64; 2],
    /// Pearson's correlation on held-out pictures.
    pub r: f64,
    /// Mean squared error on held-out pictures.
    pub mse: f64,
    /// Memory on a board.
    pub bytes: usize,
    /// Time for one face on this machine.
    pub nanoseconds: f64,
    /// Number of fitted weights, without the constant.
    pub weights: usize,
    /// Number of faces that the model was fitted to.
    pub faces: usize,
    /// Number of features that the model uses.
    pub features: usize,
    /// Predicted coefficient of every held-out picture.
    #[serde(skip)]
    pub predictions: Vec<f64>,
    /// The formula that the board can run, with its features.
    #[serde(skip)]
    pub formula: Option<(Formula, Scale)>,
}

impl Trial {
    /// Returns the name of kind and response.
    pub fn name(&self) -> String {
        format!("{}{}", self.kind, suffix(self.response))
    }
}

/// The pictures of each fold with their ranked features, on which kinds are tried.
pub struct Trials<'a> {
    /// Features of all pictures.
    pub faces: &'a Faces<'a>,
    /// The split of the pictures.
    pub split: &'a Split,
    /// Training pictures and ranking for each fold. The last entry is for all seen pictures.
    trainings: Vec<(Vec<usize>, Ranking)>,
}

impl<'a> Trials<'a> {
    /// Computes the moments of all features, once for each fold.
    pub fn new(faces: &'a Faces, split: &'a Split) -> Self {
        let moments: Vec<Moments> = (0..split.folds).map(|fold| Moments::of(faces, &split.validation(fold))).collect();
        let sum = |without: Option<usize>| {
            let kept = moments.iter().enumerate().filter(|(fold, _)| Some(*fold) != without);
            kept.fold(Moments::none(), |sum, (_, moments)| sum.with(moments)).standardised()
        };
        let folds = (0..split.folds).map(|fold| (split.training(fold), sum(Some(fold))));
        Self { faces, split, trainings: folds.chain([(split.seen.clone(), sum(None))]).collect() }
    }

    /// Returns the best features for a blendshape: for each fold, then for all seen pictures.
    pub fn rank(&self, blendshape: usize, count: usize) -> Vec<Vec<usize>> {
        self.trainings.iter().map(|(_, ranking)| ranking.best(blendshape, count)).collect()
    }

    /// Tries a kind with every response that suits it.
    pub fn run_kind(&self, kind: &dyn Kind, blendshape: usize, ranks: &[Vec<usize>]) -> Result<Vec<UntimedTrial>> {
        suited_to(kind.form()).iter().map(|response| self.run(kind, *response, blendshape, ranks)).collect()
    }

    /// Times the model of a trial.
    pub fn timed(&self, tried: UntimedTrial) -> Trial {
        let nanoseconds = tried.model.nanoseconds(self.faces, &self.split.held_out);
        let formula = tried.model.model.formula().map(|formula| (formula, tried.model.scale));
        Trial { nanoseconds, formula, ..tried.trial }
    }

    fn run(
        &self,
        kind: &dyn Kind,
        response: Response,
        blendshape: usize,
        ranks: &[Vec<usize>],
    ) -> Result<UntimedTrial> {
        let fit = |training: usize| {
            let job = Job { trials: self, training, blendshape, features: &ranks[training] };
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
            bytes: NUMBER_BYTES * fitted.model.numbers() + INDEX_BYTES * features,
            nanoseconds: f64::INFINITY,
            weights: fitted.model.weights(),
            faces: fitted.faces,
            features,
            predictions,
            formula: None,
        };
        Ok(UntimedTrial { trial, model: fitted })
    }
}

/// A trial whose model has not been timed yet.
pub struct UntimedTrial {
    trial: Trial,
    model: Fitted,
}

/// The fit of one blendshape on one fold.
struct Job<'a> {
    trials: &'a Trials<'a>,
    training: usize,
    blendshape: usize,
    features: &'a [usize],
}

impl Job<'_> {
    fn fit(&self, kind: &dyn Kind, response: Response) -> Result<Fitted> {
        let Limits { features, faces } = kind.limits();
        let rows = sample(&self.trials.trainings[self.training].0, faces);
        let features = &self.features[..features.min(self.features.len())];
        let scale = Scale::of(self.trials.faces, &rows, features);
        let matrix = scale.matrix(self.trials.faces, &rows);
        let truth = self.trials.faces.truth(self.blendshape, &rows);
        let model = with_response(kind, response, &matrix, &truth)
            .with_context(|| format!("{} cannot be fitted to {}", kind.name(), BLENDSHAPES[self.blendshape]))?;
        Ok(Fitted { model, scale, blendshape: self.blendshape, faces: rows.len() })
    }
}

/// Returns at most `most` of the rows, always the same ones.
fn sample(rows: &[usize], most: usize) -> Vec<usize> {
    let mut rows = rows.to_vec();
    if rows.len() > most {
        fastrand::Rng::with_seed(SEED).shuffle(&mut rows);
        rows.truncate(most);
    }
    rows
}

/// The features of a model, with the mean and standard deviation of each. They are the same for all models that are fitted
/// to all faces.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    pub features: Vec<usize>,
    pub mean: Vec<f64>,
    pub deviation: Vec<f64>,
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

/// A fitted model with the scale of its features.
struct Fitted {
    model: Box<dyn Predictor>,
    scale: Scale,
    blendshape: usize,
    faces: usize,
}

impl Fitted {
    /// Predicts the coefficients of some pictures, after the corrective terms.
    fn estimates(&self, faces: &Faces, rows: &[usize]) -> Vec<f64> {
        let terms = Correction::default().0[self.blendshape];
        let one = |row: &usize| {
            let face: Vec<f64> = self.scale.standardised(faces, *row).collect();
            f64::from(terms.correct(self.model.predict(&face).clamp(0.0, 1.0) as f32, 0.0, 1.0))
        };
        rows.iter().map(one).collect()
    }

    fn nanoseconds(&self, faces: &Faces, rows: &[usize]) -> f64 {
        let rows = &rows[..rows.len().min(TIMED)];
        let timed: Vec<Vec<f64>> = rows.iter().map(|row| self.scale.standardised(faces, *row).collect()).collect();
        let pass = || {
            let start = Instant::now();
            for face in &timed {
                black_box(self.model.predict(black_box(face)));
            }
            start.elapsed().as_secs_f64() * 1e9 / timed.len() as f64
        };
        (0..TIMED_PASSES).map(|_| pass()).fold(f64::INFINITY, f64::min)
    }
}
