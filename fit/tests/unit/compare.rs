mod choice;
mod trial;

use std::collections::BTreeSet;

use facewire_face::Landmarks;
use facewire_fit::compare::trial::HIDDEN_LAYER;
use facewire_fit::compare::*;
use facewire_fit::dataset::{self, Sample};
use facewire_fit::faces::Faces;
use facewire_fit::shapes::{index_of, modelled};

use crate::reference;

fn to_kinds(kinds: [&str; 2]) -> FitOptions {
    FitOptions::to_kinds(kinds.map(str::to_owned).into())
}

#[test]
fn unknown_kinds_are_refused_with_the_known_ones_and_so_is_the_tongue() {
    let error = to_kinds(["ols", "lasso"]).kinds().err().unwrap().to_string();
    assert!(error.contains("lasso") && error.contains("ridge") && error.contains(HIDDEN_LAYER), "{error}");
    assert!(modelled("tongueOut").is_err());
}

#[test]
fn the_jaw_of_unseen_subjects_is_found_by_an_affine_model_and_better_by_a_quadratic_one() {
    let Some(path) = reference::shared("dataset/train.npz") else { return };
    let samples = dataset::load(&path).unwrap();
    let faces = Faces::new(&samples, true).unwrap();
    let split = Split::new(&samples, 3, false).unwrap();
    let options = FitOptions { blendshapes: vec![index_of("jawOpen")], ..to_kinds(["ols", "poly"]) };
    let tried = options.run_trials(&samples, &faces, &split, &options.kinds().unwrap()).unwrap();
    let of = |kind: &str| tried[0].1.iter().find(|trial| trial.name() == kind).unwrap();
    assert!(of("ols").r > 0.93 && of("poly").mse < of("ols").mse, "{:?}", [of("ols").mse, of("poly").mse]);
    let [validation, error] = of("ols").validation;
    assert!((validation - of("ols").mse).abs() < 4.0 * error, "{validation} {error}");
}

fn samples(subjects: usize, each: usize) -> Vec<Sample> {
    let sample = |row: usize| Sample { subject: row / each, ..crate::dataset::sample(Landmarks::zero(), row) };
    (0..subjects * each).map(sample).collect()
}

#[test]
fn no_subject_is_in_two_folds() {
    let samples = samples(32, 3);
    let split = Split::new(&samples, 3, false).unwrap();
    let subjects = |rows: &[usize]| rows.iter().map(|row| samples[*row].subject).collect::<BTreeSet<_>>();
    assert!(subjects(&split.seen).is_disjoint(&subjects(&split.held_out)));
    for fold in 0..3 {
        let (training, validation) = (split.training(fold), split.validation(fold));
        assert!(subjects(&training).is_disjoint(&subjects(&validation)));
        assert_eq!(training.len() + validation.len(), split.seen.len());
    }
}

#[test]
fn pictures_of_one_subject_are_split_evenly_and_too_few_subjects_for_the_folds_are_refused() {
    let split = Split::new(&samples(1, 400), 3, false).unwrap();
    assert!(split.one_subject && split.held_out.len() == 100);
    assert!((0..3).all(|fold| split.validation(fold).len().abs_diff(100) < 3));
    assert!(Split::new(&samples(9, 2), 30, false).is_err() && Split::new(&samples(32, 2), 1, false).is_err());
}

#[test]
fn an_error_that_all_pictures_of_a_subject_share_counts_once() {
    let apart = Split::new(&samples(1, 400), 3, true).unwrap();
    let together = Split::new(&samples(100, 4), 3, false).unwrap();
    let of_subject = |split: &Split| split.seen.iter().map(|row| (row / 4 % 2) as f64).collect::<Vec<_>>();
    let [mean, error] = together.mean_error(&of_subject(&together));
    // Of the 88 seen subjects, 38 have odd numbers.
    let deviation = |mean: f64| (mean * (1.0 - mean)).sqrt();
    assert!((mean - 38.0 / 88.0).abs() < 1e-9, "{mean}");
    assert!((error - deviation(mean) / 88_f64.sqrt()).abs() < 1e-6, "{error}");
    let [mean, error] = apart.mean_error(&of_subject(&apart));
    assert!((error - deviation(mean) / 300_f64.sqrt()).abs() < 1e-6, "{error}");
}
