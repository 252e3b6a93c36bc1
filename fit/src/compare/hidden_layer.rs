//! The hidden layer that facewire runs as one of the kinds to compare. It is trained anew for every fold.

use anyhow::Result;
use facewire::solve::{COEFFS, MAX_HIDDEN, Response, model_file::ModelFile};

use super::{split::Split, trial::Trial};
use crate::{
    dataset::Sample,
    design::{Design, MODELLED},
    judge::{Faces, estimates, regression_ns},
    kinds::Form,
    mirror::with_mirrored,
    statistics::{mse, pearson},
    train,
};

/// The name of this kind.
pub const NAME: &str = "hidden-layer";

/// Trains the network on every fold and returns one trial per blendshape, in their order.
pub fn trials(samples: &[Sample], faces: &Faces, split: &Split, epochs: usize) -> Result<Vec<Trial>> {
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
    let cost = Cost {
        bytes: model.size_bytes() / COEFFS,
        nanoseconds: regression_ns(&model, faces, &split.held_out)? / COEFFS as f64,
        features: file.inputs.len(),
    };
    let predictions = estimates(&model, faces, &split.held_out)?;
    let all = estimated.iter().zip(predictions).enumerate();
    Ok(all.map(|(blendshape, (seen, held_out))| trial(faces, split, &cost, (blendshape, seen, held_out))).collect())
}

/// The cost per blendshape: an even share of the whole network's.
struct Cost {
    bytes: usize,
    nanoseconds: f64,
    features: usize,
}

fn train_on(samples: &[Sample], rows: &[usize], epochs: usize) -> Result<ModelFile> {
    let own: Vec<Sample> = rows.iter().map(|row| samples[*row].clone()).collect();
    let file = ModelFile::new(String::new(), String::new());
    train::fit(&Design::new(&with_mirrored(&own)?)?, epochs, file)
}

fn trial(faces: &Faces, split: &Split, cost: &Cost, fitted: (usize, &Vec<f64>, Vec<f64>)) -> Trial {
    let (blendshape, estimated, predictions) = fitted;
    let seen = split.seen.iter().zip(faces.truth(blendshape, &split.seen));
    let errors: Vec<f64> = seen.map(|(row, truth)| (estimated[*row] - truth).powi(2)).collect();
    let truth = faces.truth(blendshape, &split.held_out);
    Trial {
        kind: NAME,
        response: Response::Plain,
        form: Form::HiddenLayer,
        validation: split.mean_error(&errors),
        r: pearson(&predictions, &truth),
        mse: mse(&predictions, &truth),
        bytes: cost.bytes,
        nanoseconds: cost.nanoseconds,
        weights: MAX_HIDDEN,
        faces: split.seen.len(),
        features: cost.features,
        predictions,
        formula: None,
    }
}
