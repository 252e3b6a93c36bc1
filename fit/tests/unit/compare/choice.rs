use std::fs;

use facewire_face::Landmarks;
use facewire_face::model::FeatureId;
use facewire_face::stages::{Features, normalise};
use facewire_fit::compare::Split;
use facewire_fit::compare::choice::*;
use facewire_fit::compare::trial::Trial;
use facewire_fit::compare::trial::Trials;
use facewire_fit::dataset::Sample;
use facewire_fit::faces::{Faces, estimates};
use facewire_fit::kinds;
use facewire_fit::kinds::Form;
use facewire_fit::output;

use crate::curves::test_clip;
use crate::dataset::sample;

fn trial(kind: &'static str, form: Form, validation: [f64; 2], bytes: usize) -> Trial {
    Trial { kind, form, validation, bytes, nanoseconds: 1.0, ..Trial::default() }
}

fn chosen(trials: Vec<Trial>) -> [Option<&'static str>; 2] {
    let choice = Choice::new("jawOpen", trials, &Budget { bytes: 100, nanoseconds: 10.0, formulas_only: false });
    [choice.chosen, choice.best_within_budget].map(|index| choice.at(index).map(|trial| trial.kind))
}

#[test]
fn the_simplest_kind_in_the_budget_within_a_standard_error_of_the_best_is_chosen() {
    let trials = |affine| {
        vec![
            trial("ols", Form::Affine, [affine, 0.1], 10),
            trial("poly", Form::Quadratic, [1.0, 0.2], 10),
            trial("gp-rbf", Form::Large, [0.5, 0.1], 10),
        ]
    };
    assert_eq!(chosen(trials(1.19)), [Some("ols"), Some("poly")]);
    assert_eq!(chosen(trials(1.21))[0], Some("poly"));
    let equal = vec![trial("ols", Form::Affine, [1.1, 0.5], 10), trial("ridge", Form::Affine, [1.0, 0.5], 10)];
    assert_eq!(chosen(equal)[0], Some("ridge"), "the better of equally simple ones");
    let costly = vec![trial("ols", Form::Affine, [2.0, 0.1], 10), trial("poly", Form::Quadratic, [1.0, 0.1], 101)];
    assert_eq!(chosen(costly), [Some("ols"), Some("ols")]);
    assert_eq!(chosen(vec![trial("gp-rbf", Form::Large, [1.0, 0.1], 1)]), [None, None]);
}

const JAW_OPEN: usize = 17;

/// The built-in clip as facewire tracks it. The truth of the jaw is the gap of the lips, stretched from 0 to 1.
fn samples() -> Vec<Sample> {
    let gap = FeatureId::from_name("d13-14").unwrap().index();
    let sample = |(row, landmarks): (usize, Landmarks)| {
        let gap = Features::new(&normalise(&landmarks).unwrap(), None).values()[gap];
        let mut sample = Sample { neutral: row == 0, ..sample(landmarks, row) };
        sample.truth[JAW_OPEN] = f64::from((4.0 * gap - 0.1).clamp(0.0, 1.0));
        sample
    };
    test_clip().into_iter().enumerate().map(sample).collect()
}

fn choice(trial: &Trial) -> Choice {
    let budget = Budget { bytes: usize::MAX, nanoseconds: f64::INFINITY, formulas_only: true };
    Choice::new("jawOpen", vec![trial.clone()], &budget)
}

#[test]
fn solver_gives_what_every_exported_kind_gives_on_a_tracked_clip() {
    let samples = samples();
    let split = Split::new(&samples, 2, true).unwrap();
    let path = tempfile::NamedTempFile::new().unwrap().into_temp_path();
    let cases = [true, false].map(|known| Faces::new(&samples, known).unwrap());
    let trials = cases.each_ref().map(|faces| {
        let runner = Trials::new(faces, &split, None);
        let ranks = runner.rank(JAW_OPEN, 30);
        let kinds = kinds::ALL.iter().filter(|kind| kind.form.is_formula());
        let tried = kinds.flat_map(|kind| runner.run_kind(kind, JAW_OPEN, &ranks).unwrap());
        tried.map(|tried| runner.timed(tried).unwrap()).collect::<Vec<Trial>>()
    });
    assert_eq!(trials[0].len(), 4 * 3 + 2 + 3, "kinds with their responses");
    for (known, unknown) in trials[0].iter().zip(&trials[1]) {
        let file = model_file(&[choice(known)], &[choice(unknown)], String::new(), String::new()).unwrap();
        output::write_model(&path, &file).unwrap();
        let lines = fs::read_to_string(&path).unwrap();
        let jaws = lines.lines().filter(|line| line.starts_with("jawOpen = { kind = ") && line.contains(" xi = "));
        assert_eq!(jaws.count(), 2, "a line for each case: {lines}");
        let model = output::read_model(&path).unwrap().to_model().unwrap();
        for (trial, faces) in [known, unknown].into_iter().zip(&cases) {
            let solved = estimates(&model, faces, &split.held_out).unwrap();
            let differences = solved[JAW_OPEN].iter().zip(&trial.predictions).map(|(one, other)| (one - other).abs());
            let largest = differences.fold(0.0, f64::max);
            assert!(largest < 1e-4, "{}: {largest}", trial.name());
            let most = trial.predictions.iter().fold(0.0_f64, |most, value| most.max(*value));
            let least = trial.predictions.iter().fold(1.0_f64, |least, value| least.min(*value));
            assert!(most - least > 0.1, "{}: {least} to {most}", trial.name());
        }
    }
}
