//! The chosen formulas as a model file.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use facewire_face::BLENDSHAPES;
use facewire_face::model::{FeatureId, FormulaSetTable, FormulaTable, FormulasTable, ModelFile, ScoreTable};

use super::choice::Choice;
use super::trial::{Scale, Trial};
use crate::{design::MODELLED, kinds::Formula};

/// Returns the model of the formulas that were chosen with the subjects' neutral faces known and not known. The formula of
/// a blendshape without a choice is always 0; the names of these blendshapes are printed on standard error.
pub fn model_file(known: &[Choice], unknown: &[Choice], made_by: String, fitted_on: String) -> Result<ModelFile> {
    let formulas = FormulasTable { neutral_known: set(known)?, neutral_unknown: set(unknown)? };
    Ok(ModelFile { formulas: Some(formulas), ..ModelFile::new(made_by, fitted_on) })
}

fn set(choices: &[Choice]) -> Result<FormulaSetTable> {
    let mut table = FormulaSetTable::default();
    let mut without = Vec::new();
    for name in &BLENDSHAPES[..MODELLED] {
        let choice = choices.iter().find(|choice| choice.blendshape == *name);
        let chosen = choice.and_then(|choice| choice.at(choice.chosen));
        let formula =
            if let Some((trial, (formula, scale))) = chosen.and_then(|trial| Some((trial, trial.formula.as_ref()?))) {
                add_inputs(&mut table.inputs, scale)?;
                formula_table(trial, formula, &names(scale))
            } else {
                without.push(*name);
                FormulaTable::default()
            };
        table.blendshapes.insert((*name).to_owned(), formula);
    }
    ensure!(without.len() < MODELLED, "no formula was chosen: allow more kinds, or a larger budget");
    if !without.is_empty() {
        eprintln!("always 0 in the model file, because no formula was chosen: {}", without.join(", "));
    }
    Ok(table)
}

fn names(scale: &Scale) -> Vec<String> {
    scale.features.iter().filter_map(|feature| FeatureId::from_index(*feature)).map(|id| id.to_string()).collect()
}

/// Adds mean and deviation of each feature of a formula.
fn add_inputs(inputs: &mut BTreeMap<String, [f64; 2]>, scale: &Scale) -> Result<()> {
    for (name, (mean, deviation)) in names(scale).into_iter().zip(scale.mean.iter().zip(&scale.deviation)) {
        let own = [rounded(*mean), rounded(*deviation)];
        let first = *inputs.entry(name).or_insert(own);
        ensure!(first.map(f64::to_bits) == own.map(f64::to_bits), "the formulas were fitted to different faces");
    }
    Ok(())
}

fn formula_table(trial: &Trial, formula: &Formula, names: &[String]) -> FormulaTable {
    let products =
        formula.pairs().map(|([one, other], weight)| (format!("{}*{}", names[one], names[other]), rounded(weight)));
    FormulaTable {
        kind: formula.kind,
        response: formula.response,
        score: ScoreTable { r: rounded(trial.r), mse: rounded(trial.mse) },
        offset: rounded(formula.offset),
        weights: names.iter().cloned().zip(formula.weights.iter().copied().map(rounded)).collect(),
        products: products.collect(),
    }
}

/// Rounds to seven digits, as many as the solver's single precision has.
fn rounded(value: f64) -> f64 {
    format!("{value:.6e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use facewire_face::stages::{Features, normalise};
    use facewire_face::{COEFFS, Landmarks};

    use super::*;
    use crate::{
        clip::tests::test_clip,
        compare::{
            choice::Budget,
            split::Split,
            trial::{Trial, Trials},
        },
        dataset::Sample,
        judge::{Faces, estimates},
        kinds,
    };

    const JAW_OPEN: usize = 17;

    /// The built-in clip as facewire tracks it. The truth of the jaw is the gap of the lips, stretched from 0 to 1.
    fn samples() -> Vec<Sample> {
        let gap = FeatureId::from_name("d13-14").unwrap().index();
        let sample = |(row, landmarks): (usize, Landmarks)| {
            let gap = Features::new(&normalise(&landmarks).unwrap(), None).values()[gap];
            let mut truth = [0.0; COEFFS];
            truth[JAW_OPEN] = f64::from((4.0 * gap - 0.1).clamp(0.0, 1.0));
            Sample {
                landmarks,
                truth,
                pose_deg: [0.0; 3],
                picture: row,
                subject: 0,
                neutral: row == 0,
                mirrored: false,
            }
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
        let cases = [true, false].map(|known| Faces::new(&samples, known).unwrap());
        let trials = cases.each_ref().map(|faces| {
            let runner = Trials::new(faces, &split);
            let ranks = runner.rank(JAW_OPEN, 30);
            let kinds = kinds::ALL.iter().filter(|kind| kind.form.is_formula());
            let tried = kinds.flat_map(|kind| runner.run_kind(kind, JAW_OPEN, &ranks).unwrap());
            tried.map(|tried| runner.timed(tried)).collect::<Vec<Trial>>()
        });
        assert_eq!(trials[0].len(), 4 * 3 + 2 + 3, "kinds with their responses");
        for (known, unknown) in trials[0].iter().zip(&trials[1]) {
            let file = model_file(&[choice(known)], &[choice(unknown)], String::new(), String::new()).unwrap();
            let model = ModelFile::parse(&toml::to_string(&file).unwrap()).unwrap().to_model().unwrap();
            for (trial, faces) in [known, unknown].into_iter().zip(&cases) {
                let solved = estimates(&model, faces, &split.held_out).unwrap();
                let differences =
                    solved[JAW_OPEN].iter().zip(&trial.predictions).map(|(one, other)| (one - other).abs());
                let largest = differences.fold(0.0, f64::max);
                assert!(largest < 1e-4, "{}: {largest}", trial.name());
                let most = trial.predictions.iter().fold(0.0_f64, |most, value| most.max(*value));
                let least = trial.predictions.iter().fold(1.0_f64, |least, value| least.min(*value));
                assert!(most - least > 0.1, "{}: {least} to {most}", trial.name());
            }
        }
    }

    #[test]
    fn an_export_without_any_formula_is_refused() {
        let error = model_file(&[], &[], String::new(), String::new()).unwrap_err().to_string();
        assert!(error.contains("allow more kinds"), "{error}");
    }
}
