//! Trials: one kind of model, fitted to one blendshape on every fold.

use anyhow::{Context, Result};
use facewire_face::model::{Correction, FEATURES, FormulaScoreTable, MAX_HIDDEN, ModelFile, Response};
use facewire_face::{BLENDSHAPES, COEFFS};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use serde::Serialize;

use super::Split;
use crate::dataset::Sample;
use crate::design::{Design, with_mirrored};
use crate::faces::{Faces, estimates, fastest_ns, regression_ns};
use crate::kinds::{Form, Formula, INDEX_BYTES, Kind, Limits, NUMBER_BYTES, Predictor, suffix, with_response};
use crate::paper;
use crate::shapes::MODELLED;
use crate::statistics::{mse, pearson};
use crate::train;

const SEED: u64 = 1;
/// Number of faces to time.
const TIMED: usize = 100;

#[derive(Debug, Clone, Default, Serialize)]
pub struct Trial {
    pub kind: &'static str,
    pub response: Response,
    pub form: Form,
    /// Cross-validated mean squared error on the seen pictures, and its standard error.
    pub validation: [f64; 2],
    pub r: f64,
    pub mse: f64,
    pub bytes: usize,
    pub nanoseconds: f64,
    pub weights: usize,
    pub faces: usize,
    pub features: usize,
    #[serde(skip)]
    pub score: FormulaScoreTable,
    #[serde(skip)]
    pub predictions: Vec<f64>,
    #[serde(skip)]
    pub formula: Option<(Formula, Scale)>,
}

impl Trial {
    pub fn name(&self) -> String {
        format!("{}{}", self.kind, suffix(self.response))
    }

    /// Returns the trial of the hidden layer with `estimated` for seen pictures and `predictions` for held-out ones.
    fn judged(faces: &Faces, split: &Split, blendshape: usize, estimated: &[f64], predictions: Vec<f64>) -> Self {
        let seen = split.seen.iter().zip(faces.truth(blendshape, &split.seen));
        let errors: Vec<f64> = seen.map(|(row, truth)| (estimated[*row] - truth).powi(2)).collect();
        let truth = faces.truth(blendshape, &split.held_out);
        let score = paper::score(&predictions, &truth);
        Self {
            kind: HIDDEN_LAYER,
            form: Form::HiddenLayer,
            validation: split.mean_error(&errors),
            r: pearson(&predictions, &truth),
            mse: mse(&predictions, &truth),
            score,
            nanoseconds: f64::INFINITY,
            weights: MAX_HIDDEN,
            faces: split.seen.len(),
            predictions,
            ..Self::default()
        }
    }
}

/// The pictures of each fold with their ranked features, on which kinds are tried.
pub struct Trials<'a> {
    pub faces: &'a Faces<'a>,
    pub split: &'a Split,
    /// Training pictures and ranking for each fold. The last entry is for all seen pictures.
    trainings: Vec<(Vec<usize>, Ranking)>,
}

impl<'a> Trials<'a> {
    /// Prepares trials in which the models of all blendshapes together choose from so many features, or from all.
    pub fn new(faces: &'a Faces, split: &'a Split, features: Option<usize>) -> Self {
        let moments: Vec<Moments> = (0..split.folds).map(|fold| Moments::of(faces, &split.validation(fold))).collect();
        let sum = |without: Option<usize>| {
            let kept = moments.iter().enumerate().filter(|(fold, _)| Some(*fold) != without);
            let ranking = kept.fold(Moments::none(), |sum, (_, moments)| sum.with(moments)).standardised();
            features.into_iter().fold(ranking, Ranking::sharing)
        };
        let folds = (0..split.folds).map(|fold| (split.training(fold), sum(Some(fold))));
        Self { faces, split, trainings: folds.chain([(split.seen.clone(), sum(None))]).collect() }
    }

    /// Returns the best features for a blendshape: for each fold, then for all seen pictures.
    pub fn rank(&self, blendshape: usize, count: usize) -> Vec<Vec<usize>> {
        self.trainings.iter().map(|(_, ranking)| ranking.best(&[blendshape], count)).collect()
    }

    /// Tries a kind with every response. The trials have no times yet.
    pub fn run_kind(&self, kind: &Kind, blendshape: usize, ranks: &[Vec<usize>]) -> Result<Vec<(Trial, Fitted)>> {
        kind.form.responses().iter().map(|response| self.run(kind, *response, blendshape, ranks)).collect()
    }

    pub fn timed(&self, (trial, model): (Trial, Fitted)) -> Result<Trial> {
        let nanoseconds = model.nanoseconds(self.faces, &self.split.held_out)?;
        let formula = model.model.formula().map(|formula| (formula, model.scale));
        Ok(Trial { nanoseconds, formula, ..trial })
    }

    fn run(&self, kind: &Kind, response: Response, blendshape: usize, ranks: &[Vec<usize>]) -> Result<(Trial, Fitted)> {
        let fit = |training: usize| self.fit(kind, response, blendshape, (training, &ranks[training]));
        let mut estimated = vec![0.0; self.faces.len()];
        for fold in 0..self.split.folds {
            let rows = self.split.validation(fold);
            let estimates = fit(fold)?.estimates(self.faces, &rows);
            rows.iter().zip(estimates).for_each(|(row, estimate)| estimated[*row] = estimate);
        }
        let fitted = fit(self.split.folds)?;
        let predictions = fitted.estimates(self.faces, &self.split.held_out);
        let features = fitted.scale.features.len();
        let trial = Trial {
            kind: kind.name,
            response,
            form: kind.form,
            bytes: NUMBER_BYTES * fitted.model.numbers() + INDEX_BYTES * features,
            weights: fitted.model.weights(),
            faces: fitted.faces,
            features,
            ..Trial::judged(self.faces, self.split, blendshape, &estimated, predictions)
        };
        Ok((trial, fitted))
    }

    fn fit(
        &self,
        kind: &Kind,
        response: Response,
        blendshape: usize,
        (training, ranked): (usize, &[usize]),
    ) -> Result<Fitted> {
        let Limits { features, faces } = kind.limits;
        let rows = sample(&self.trainings[training].0, faces);
        let scale = Scale::of(self.faces, &rows, &ranked[..features.min(ranked.len())]);
        let truth = self.faces.truth(blendshape, &rows);
        let model = with_response(kind, response, &scale.matrix(self.faces, &rows), &truth)
            .with_context(|| format!("{} cannot be fitted to {}", kind.name, BLENDSHAPES[blendshape]))?;
        Ok(Fitted { model, scale, blendshape, faces: rows.len() })
    }
}

fn sample(rows: &[usize], most: usize) -> Vec<usize> {
    let mut rows = rows.to_vec();
    if rows.len() > most {
        fastrand::Rng::with_seed(SEED).shuffle(&mut rows);
        rows.truncate(most);
    }
    rows
}

/// The features of a model with their means and deviations, the same for all models that are fitted to all faces.
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
        let features = self.features.iter().zip(self.mean.iter().zip(&self.deviation));
        features.map(|(feature, (mean, deviation))| (f64::from(values[*feature]) - mean) / deviation)
    }

    fn matrix(&self, faces: &Faces, rows: &[usize]) -> DMatrix<f64> {
        let values = rows.iter().flat_map(|row| self.standardised(faces, *row));
        DMatrix::from_row_iterator(rows.len(), self.features.len(), values)
    }
}

pub struct Fitted {
    model: Box<dyn Predictor>,
    scale: Scale,
    blendshape: usize,
    faces: usize,
}

impl Fitted {
    pub fn estimates(&self, faces: &Faces, rows: &[usize]) -> Vec<f64> {
        let terms = Correction::default().0[self.blendshape];
        let one = |row: &usize| {
            let face: Vec<f64> = self.scale.standardised(faces, *row).collect();
            f64::from(terms.correct(self.model.predict(&face).clamp(0.0, 1.0) as f32, 0.0, 1.0))
        };
        rows.iter().map(one).collect()
    }

    fn nanoseconds(&self, faces: &Faces, rows: &[usize]) -> Result<f64> {
        let rows = &rows[..rows.len().min(TIMED)];
        let timed: Vec<Vec<f64>> = rows.iter().map(|row| self.scale.standardised(faces, *row).collect()).collect();
        fastest_ns(&timed, |face| Ok(self.model.predict(face)))
    }
}

// Feature selection (`S` in eq. 4 of the paper) for one blendshape, on the pictures of the fit only.
//
// Forward selection by partial correlation: each next feature explains most of the variance that the previous ones
// leave. Plain correlation would select the same few points many times over.

/// The smallest deviation, in eye distances, that a feature is scaled by.
const LEAST_DEVIATION: f64 = 0.001;
/// Assumed noise, relative to the variance. Without it, a tiny remainder of a repeated feature could be selected.
const NOISE: f64 = 0.003;
const BLOCK: usize = 2048;

struct Moments {
    count: f64,
    sum: DVector<f64>,
    gram: DMatrix<f64>,
    truth_sum: DVector<f64>,
    cross: DMatrix<f64>,
}

impl Moments {
    fn of(faces: &Faces, rows: &[usize]) -> Self {
        let part = |rows: &[usize]| {
            let columns = DMatrix::from_fn(FEATURES, rows.len(), |feature, row| faces.values(rows[row])[feature]);
            let truth = faces.truths(rows).rows(0, MODELLED).into_owned();
            let transposed = columns.transpose();
            Self {
                count: rows.len() as f64,
                sum: columns.map(f64::from).column_sum(),
                truth_sum: truth.column_sum(),
                cross: transposed.map(f64::from).tr_mul(&truth.transpose()),
                gram: (columns * transposed).map(f64::from),
            }
        };
        // Added up in order, so that the same pictures give the same sums.
        let parts: Vec<Self> = rows.par_chunks(BLOCK).map(part).collect();
        parts.iter().fold(Self::none(), Self::with)
    }

    fn none() -> Self {
        let (sum, truth_sum) = (DVector::zeros(FEATURES), DVector::zeros(MODELLED));
        let (gram, cross) = (DMatrix::zeros(FEATURES, FEATURES), DMatrix::zeros(FEATURES, MODELLED));
        Self { count: 0.0, sum, gram, truth_sum, cross }
    }

    fn with(mut self, other: &Self) -> Self {
        self.count += other.count;
        self.sum += &other.sum;
        self.gram += &other.gram;
        self.truth_sum += &other.truth_sum;
        self.cross += &other.cross;
        self
    }

    fn standardised(mut self) -> Ranking {
        let (mean, truth_mean) = (self.sum / self.count, self.truth_sum / self.count);
        self.gram /= self.count;
        self.gram.ger(-1.0, &mean, &mean, 1.0);
        self.cross /= self.count;
        self.cross.ger(-1.0, &mean, &truth_mean, 1.0);
        let deviation = self.gram.diagonal().map(|variance| variance.max(0.0).sqrt().max(LEAST_DEVIATION));
        for (index, deviation) in deviation.iter().enumerate() {
            self.gram.row_mut(index).scale_mut(1.0 / deviation);
            self.gram.column_mut(index).scale_mut(1.0 / deviation);
            self.cross.row_mut(index).scale_mut(1.0 / deviation);
        }
        Ranking { gram: self.gram, cross: self.cross, candidates: (0..FEATURES).collect() }
    }
}

pub struct Ranking {
    pub gram: DMatrix<f64>,
    pub cross: DMatrix<f64>,
    /// The features to choose from.
    pub candidates: Vec<usize>,
}

impl Ranking {
    /// Leaves only the `count` features that are best for all blendshapes together.
    fn sharing(mut self, count: usize) -> Self {
        self.candidates = self.best(&(0..MODELLED).collect::<Vec<_>>(), count);
        self
    }

    /// Returns the `count` best features for blendshapes, which count alike, by pivoted Cholesky decomposition. `rest` is
    /// the part of each feature's variance that the selected features do not explain, `covariances` the same of its
    /// covariances with the truth.
    pub fn best(&self, blendshapes: &[usize], count: usize) -> Vec<usize> {
        let mut rest = self.gram.diagonal().add_scalar(NOISE);
        let mut covariances = self.cross.select_columns(blendshapes);
        for mut column in covariances.column_iter_mut() {
            column /= column.norm().max(f64::MIN_POSITIVE);
        }
        let mut chosen: Vec<usize> = Vec::new();
        let mut factors: Vec<DVector<f64>> = Vec::new();
        for _ in 0..count {
            let gain = |feature: &usize| covariances.row(*feature).norm_squared() / rest[*feature];
            let is_open = |feature: &&usize| rest[**feature] > NOISE / 2.0 && !chosen.contains(feature);
            let open = self.candidates.iter().filter(is_open).copied();
            let Some(best) = open.max_by(|a, b| gain(a).total_cmp(&gain(b))) else { break };
            let mut factor = self.gram.column(best).into_owned();
            for known in &factors {
                factor.axpy(-known[best], known, 1.0);
            }
            factor /= rest[best].sqrt();
            for mut column in covariances.column_iter_mut() {
                column.axpy(-column[best] / rest[best].sqrt(), &factor, 1.0);
            }
            rest.zip_apply(&factor, |rest, own| *rest -= own * own);
            factors.push(factor);
            chosen.push(best);
        }
        chosen
    }
}

pub const HIDDEN_LAYER: &str = "hidden-layer";

/// Trains the network on every fold. Returns a trial per blendshape, with an even share of the cost.
pub fn hidden_layer_trials(samples: &[Sample], faces: &Faces, split: &Split, epochs: usize) -> Result<Vec<Trial>> {
    let mut estimated = vec![vec![0.0; samples.len()]; MODELLED];
    for fold in 0..split.folds {
        eprintln!("hidden layer without fold {} of {}", fold + 1, split.folds);
        let model = train_on(samples, &split.training(fold), epochs)?.to_model()?;
        let rows = split.validation(fold);
        for (all, own) in estimated.iter_mut().zip(estimates(&model, faces, &rows)?) {
            rows.iter().zip(own).for_each(|(row, value)| all[*row] = value);
        }
    }
    eprintln!("hidden layer on all seen pictures");
    let file = train_on(samples, &split.seen, epochs)?;
    let model = file.to_model()?;
    let bytes = model.to_bytes().len() / COEFFS;
    let nanoseconds = regression_ns(&model, faces, &split.held_out)? / COEFFS as f64;
    let predictions = estimates(&model, faces, &split.held_out)?;
    let trial = |(blendshape, (seen, held_out)): (usize, (&Vec<f64>, Vec<f64>))| {
        let trial = Trial::judged(faces, split, blendshape, seen, held_out);
        Trial { bytes, nanoseconds, features: file.inputs.len(), ..trial }
    };
    Ok(estimated.iter().zip(predictions).enumerate().map(trial).collect())
}

fn train_on(samples: &[Sample], rows: &[usize], epochs: usize) -> Result<ModelFile> {
    let own: Vec<Sample> = rows.iter().map(|row| samples[*row].clone()).collect();
    let file = ModelFile::new(String::new(), String::new());
    train::fit(&Design::new(&with_mirrored(&own)?)?, epochs, file)
}
