//! Fits both maps of the model: features selected and weighed per blendshape, then a polynomial of the estimates.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use facewire::solve::{
    BLENDSHAPES, FeatureId,
    model_file::{BlendshapeTable, ModelFile},
};
use nalgebra::DMatrix;

use crate::{
    dataset::Sample,
    judge::{self, Faces},
    ridge::{Fit, Moments, Scale},
};

/// Features a blendshape selects. Held-out r with 24, 48, 96: 0.656, 0.667, 0.681 (neutral known).
const SELECTED: usize = 96;
/// Terms of a blendshape's polynomial beside its bias. Held-out r with 1, 6, 12, 24: 0.634, 0.664, 0.672, 0.681.
const TERMS: usize = 24;
/// Least deviation of a feature (eye distances) and of a term that earns a full weight.
const LEAST_FEATURE: f64 = 0.005;
const LEAST_TERM: f64 = 0.01;
/// The polynomial is fitted on estimates for subjects that the estimates' own fit did not see.
const FOLDS: usize = 4;
/// All blendshapes but the last, `tongueOut`, which landmarks do not show.
const MODELLED: usize = BLENDSHAPES.len() - 1;

/// Fits a model on `seen`, and scores it on the held-out subjects of `samples`.
pub fn train(seen: &[Sample], samples: &[Sample], made_by: String) -> Result<ModelFile> {
    let held_out = samples.iter().filter(|sample| sample.held_out()).count();
    let fitted_on = format!(
        "{} pictures and their mirror images; r and mse are those of {held_out} pictures of other subjects",
        samples.len() - held_out
    );
    let mut file = ModelFile::new(made_by, fitted_on);
    file.neutral_known = fit_map(&Faces::new(seen, true)?).context("neutral known")?;
    file.neutral_unknown = fit_map(&Faces::new(seen, false)?).context("neutral unknown")?;
    let model = file.to_model()?;
    let scores = |neutral_known| judge::scores(&model, &Faces::new(samples, neutral_known)?);
    fill_in(&mut file.neutral_known, &scores(true)?);
    fill_in(&mut file.neutral_unknown, &scores(false)?);
    Ok(file)
}

fn fit_map(faces: &Faces) -> Result<BTreeMap<String, BlendshapeTable>> {
    let rows: Vec<usize> = (0..faces.len()).collect();
    let folds: Vec<usize> = rows.iter().map(|row| faces.subject(*row) % FOLDS).collect();
    let (features, truth) = faces.matrices(&rows, MODELLED);
    let (linear, estimates) = fit_linear(&features, &truth, &folds)?;
    let terms = terms_of(&estimates);
    let scale = Scale::of(&terms, &truth, LEAST_TERM);
    let moments = Moments::of(&scale, &terms, &truth);
    let polynomial = moments.fit(&scale, &moments.select(TERMS));
    let tables = linear.iter().zip(&polynomial).map(|(linear, polynomial)| table(linear, polynomial));
    Ok(BLENDSHAPES.iter().map(ToString::to_string).zip(tables).collect())
}

/// Step 1, and its estimates for every row by a fit that saw neither the row nor its subject.
fn fit_linear(features: &DMatrix<f64>, truth: &DMatrix<f64>, folds: &[usize]) -> Result<(Vec<Fit>, DMatrix<f64>)> {
    let scale = Scale::of(features, truth, LEAST_FEATURE);
    let rows_of = |fold: usize| -> Vec<usize> { (0..folds.len()).filter(|row| folds[*row] == fold).collect() };
    let parts: Vec<Moments> = (0..FOLDS)
        .map(|fold| Moments::of(&scale, &features.select_rows(&rows_of(fold)), &truth.select_rows(&rows_of(fold))))
        .collect();
    let whole = Moments::sum(parts.iter()).context("no rows")?;
    let chosen = whole.select(SELECTED);
    let mut estimates = DMatrix::zeros(truth.nrows(), truth.ncols());
    for fold in 0..FOLDS {
        let others = parts.iter().enumerate().filter(|(part, _)| *part != fold).map(|(_, part)| part);
        let fits = Moments::sum(others).context("one fold only")?.fit(&scale, &chosen);
        let rows = rows_of(fold);
        let seen = features.select_rows(&rows);
        for (target, fit) in fits.iter().enumerate() {
            fit.predict(&seen).iter().zip(&rows).for_each(|(value, row)| estimates[(*row, target)] = *value);
        }
    }
    Ok((whole.fit(&scale, &chosen), estimates))
}

/// The clipped estimates and all their products, in the order of [`term_names`].
fn terms_of(estimates: &DMatrix<f64>) -> DMatrix<f64> {
    let clipped = estimates.map(|value| value.clamp(0.0, 1.0));
    let products = pairs().map(|(a, b)| clipped.column(a).component_mul(&clipped.column(b)));
    let columns: Vec<_> = clipped.column_iter().map(nalgebra::Matrix::into_owned).chain(products).collect();
    DMatrix::from_columns(&columns)
}

fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..MODELLED).flat_map(|a| (a..MODELLED).map(move |b| (a, b)))
}

fn term_names() -> Vec<String> {
    let alone = BLENDSHAPES.iter().take(MODELLED).map(ToString::to_string);
    alone.chain(pairs().map(|(a, b)| format!("{}*{}", BLENDSHAPES[a], BLENDSHAPES[b]))).collect()
}

fn table(linear: &Fit, polynomial: &Fit) -> BlendshapeTable {
    let names = term_names();
    let feature = |index: usize| FeatureId::from_index(index).map_or_else(String::new, |id| id.to_string());
    BlendshapeTable {
        linear: weights(linear, feature),
        polynomial: weights(polynomial, |index| names[index].clone()),
        ..BlendshapeTable::default()
    }
}

fn weights(fit: &Fit, name: impl Fn(usize) -> String) -> BTreeMap<String, f64> {
    let named = fit.weights.iter().map(|(index, weight)| (name(*index), round(*weight)));
    named.chain([("bias".to_owned(), round(fit.bias))]).collect()
}

/// To four decimals: far below what the weights are known to, and short to read.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

fn fill_in(tables: &mut BTreeMap<String, BlendshapeTable>, scores: &[judge::Score]) {
    for (name, score) in BLENDSHAPES.iter().zip(scores) {
        if let Some(table) = tables.get_mut(*name) {
            (table.r, table.mse) = (round(score.r), (score.mse * 1e5).round() / 1e5);
        }
    }
}
