//! Fits the model: selects landmarks, trains the hidden layer, and fills in the model file.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, ensure};
use facewire_face::BLENDSHAPES;
use facewire_face::model::{BlendshapeTable, Cases, FeatureId, InputTable, MAX_HIDDEN, ModelFile, ScoreTable};
use nalgebra::{DMatrix, DVector};

use crate::appearance;
use crate::dataset::{Appearances, Sample, held_out};
use crate::design::{Basis, Design, Scale, select, with_mirrored};
use crate::faces::{self, Faces};
use crate::gaze;
use crate::network::{Network, Training, TrainingData, Units, importance, number, numbers, rounded};
use crate::output;
use crate::shapes::MODELLED;

const SELECTED: usize = 140;
const COMPONENTS: usize = 300;
/// Noise on each component, and on the input that tells whether the neutral face is known. Less noise improves weak
/// blendshapes, but increases the jitter on real footage.
const NOISE: f32 = 0.2;
const KNOWN_NOISE: f32 = 0.02;
/// Smallest deviation of a feature, in eye distances, that features are scaled by.
const LEAST_FEATURE: f32 = 0.005;
pub const EPOCHS: u32 = 60;
const RATE: f32 = 2e-3;
const SEED: u64 = 1;

/// Fits the part of a model that reads landmarks, or takes it from the model file `keep`; then fits the part that reads how
/// a face looks to what the landmarks leave unexplained. The held-out subjects only serve to score the model.
pub fn train(
    samples: &[Sample],
    appearances: Option<&Appearances>,
    epochs: usize,
    keep: Option<&Path>,
    made_by: String,
) -> Result<ModelFile> {
    let held_out = held_out(samples)?.len();
    let seen = samples.len() - held_out;
    let scored = format!("r and mse are those of {held_out} pictures of other subjects");
    let mut file = if let Some(path) = keep {
        ensure!(appearances.is_some(), "--keep needs features in all datasets: render them with this version of synth");
        let file = output::read_model(path)?;
        let made_by = format!("{made_by}; landmark model: {}", file.made_by);
        let landmarks = file.fitted_on.split(';').next().unwrap_or_default();
        let fitted_on = format!("{seen} pictures; landmark model: {landmarks}; {scored}");
        ModelFile { appearance: None, made_by, fitted_on, ..file }
    } else {
        let fitted_on = format!("{seen} pictures and their mirror images; {scored}");
        fit(&Design::new(&with_mirrored(samples)?)?, epochs, ModelFile::new(made_by, fitted_on))?
    };
    if let Some(appearances) = appearances {
        file.appearance = Some(appearance::fit(samples, appearances, &file.to_model()?)?);
    }
    score(&mut file, samples, appearances)?;
    Ok(file)
}

fn score(file: &mut ModelFile, samples: &[Sample], appearances: Option<&Appearances>) -> Result<()> {
    let model = file.to_model()?;
    let scores = |known| {
        let faces = Faces::new(samples, known)?.with_appearances(appearances);
        faces::scores(&model, &faces, &faces.rows(false)?)
    };
    let [known, unknown] = [scores(true)?, scores(false)?];
    let score = |[r, mse]: &[f64; 2]| ScoreTable { r: rounded(*r, 4), mse: rounded(*mse, 5) };
    for (name, (known, unknown)) in BLENDSHAPES.iter().zip(known.iter().zip(&unknown)) {
        if let Some(table) = file.blendshapes.get_mut(*name) {
            (table.neutral_known, table.neutral_unknown) = (score(known), score(unknown));
        }
    }
    Ok(())
}

pub fn fit(design: &Design, epochs: usize, mut file: ModelFile) -> Result<ModelFile> {
    let scale = Scale::of(design, LEAST_FEATURE);
    let features = select(design, &scale, SELECTED)?;
    eprintln!("{} features of {SELECTED} landmarks selected", features.len());
    let basis = Basis::of(design, &scale, features, COMPONENTS)?;
    let data = training_data(design, &scale, &basis);
    let training = Training { hidden: MAX_HIDDEN, units: Units::Rectified, start: 1.0, rate: RATE, epochs, seed: SEED };
    let network = Network::train(&data, &training, |epoch| eprint!("\repoch {epoch} of {epochs}"));
    eprintln!();
    fill_in(&mut file, design, &scale, &basis, &network);
    file.gaze = Some(gaze::fit(design, &scale)?);
    Ok(file)
}

/// Returns the components of every face, and as the last input whether its neutral face is known.
fn training_data(design: &Design, scale: &Scale, basis: &Basis) -> TrainingData {
    let faces: Vec<usize> = (0..design.len()).collect();
    let mut inputs = &basis.map * design.columns(&faces, &basis.features, scale);
    let known = inputs.nrows();
    inputs = inputs.insert_row(known, 0.0);
    for face in &faces {
        inputs[(known, *face)] = f32::from(u8::from(design.is_known(*face)));
    }
    let mut noise = vec![NOISE; known];
    noise.push(KNOWN_NOISE);
    let truth = design.truth(&faces);
    TrainingData { inputs, noise, importance: importance(&truth), truth }
}

/// Converts the network's inputs from components back to features, which have names and units, and stores it in `file`.
fn fill_in(file: &mut ModelFile, design: &Design, scale: &Scale, basis: &Basis, network: &Network) {
    let components = basis.map.nrows();
    let mut weights: DMatrix<f32> = network.w.columns(0, components) * &basis.map;
    for (mut column, feature) in weights.column_iter_mut().zip(&basis.features) {
        column /= scale.deviation[*feature];
    }
    let means = DVector::from_iterator(basis.features.len(), basis.features.iter().map(|feature| scale.mean[*feature]));
    let unknown = &network.a - &weights * means;
    let known = &unknown + network.w.column(components);
    file.offsets = Some(Cases { neutral_known: numbers(known.iter()), neutral_unknown: numbers(unknown.iter()) });
    for (column, feature) in weights.column_iter().zip(&basis.features) {
        let table = InputTable { neutral: number(design.neutral[*feature]), weights: numbers(column.iter()) };
        file.inputs.extend(FeatureId::from_index(*feature).map(|id| (id.to_string(), table)));
    }
    file.blendshapes = blendshapes(network);
}

fn blendshapes(network: &Network) -> BTreeMap<String, BlendshapeTable> {
    let table = |index: usize| BlendshapeTable {
        offset: number(network.b[index]),
        weights: numbers(network.v.row(index).iter()),
        ..BlendshapeTable::default()
    };
    (0..MODELLED).map(|index| (BLENDSHAPES[index].to_owned(), table(index))).collect()
}
