//! The choice of the kind of model for a blendshape.

use facewire::solve::Response;
use serde::Serialize;

use super::trial::Trial;
use crate::kinds::Form;

/// Limits on the cost of the model of one blendshape.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Budget {
    /// Memory.
    pub bytes: usize,
    /// Time for one face on this machine.
    pub nanoseconds: f64,
    /// Whether only formulas are allowed.
    #[serde(skip)]
    pub formulas_only: bool,
}

impl Budget {
    /// Returns whether the model can run on a board within the budget.
    pub fn allows(&self, trial: &Trial) -> bool {
        let runs = trial.form.runs_on_board() && (trial.formula.is_some() || !self.formulas_only);
        runs && trial.bytes <= self.bytes && trial.nanoseconds <= self.nanoseconds
    }
}

/// The trials of one blendshape. Choices are indices into `trials`.
#[derive(Debug, Clone, Serialize)]
pub struct Choice {
    /// ARKit name of the blendshape.
    pub blendshape: &'static str,
    /// All trials, in the order of the kinds.
    pub trials: Vec<Trial>,
    /// The simplest trial within the budget whose validation error is within one standard error of the best trial's.
    pub chosen: Option<usize>,
    /// The trial with the least validation error within the budget.
    pub best_within_budget: Option<usize>,
    /// The trial with the least validation error.
    pub best: Option<usize>,
    /// The trial with the least validation error among affine maps of the features to the untransformed truth.
    pub linear: Option<usize>,
}

impl Choice {
    /// Chooses among the trials of a blendshape.
    pub fn new(blendshape: &'static str, trials: Vec<Trial>, budget: &Budget) -> Self {
        let least = |keep: &dyn Fn(&Trial) -> bool| {
            let kept = trials.iter().enumerate().filter(|(_, trial)| keep(trial));
            kept.min_by(|a, b| a.1.validation[0].total_cmp(&b.1.validation[0])).map(|(index, _)| index)
        };
        let best_within_budget = least(&|trial| budget.allows(trial));
        let chosen = best_within_budget.and_then(|best| {
            let most = trials[best].validation.iter().sum();
            let tied = |trial: &Trial| budget.allows(trial) && trial.validation[0] <= most;
            let simplest = trials.iter().filter(|trial| tied(trial)).map(simplicity).min()?;
            least(&|trial| tied(trial) && simplicity(trial) == simplest)
        });
        let best = least(&|_| true);
        let linear = least(&|trial| simplicity(trial) == (Form::Affine, Response::Plain));
        Self { blendshape, trials, chosen, best_within_budget, best, linear }
    }

    /// Returns the trial with this index.
    pub fn at(&self, index: Option<usize>) -> Option<&Trial> {
        self.trials.get(index?)
    }
}

/// Returns a key that orders trials from simple to complex.
fn simplicity(trial: &Trial) -> (Form, Response) {
    (trial.form, trial.response)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(kind: &'static str, form: Form, validation: [f64; 2], bytes: usize) -> Trial {
        Trial {
            kind,
            response: Response::Plain,
            form,
            validation,
            r: 0.0,
            mse: 0.0,
            bytes,
            nanoseconds: 1.0,
            weights: 1,
            faces: 1,
            features: 1,
            predictions: Vec::new(),
            formula: None,
        }
    }

    fn chosen(trials: Vec<Trial>) -> [Option<&'static str>; 4] {
        let choice = Choice::new("jawOpen", trials, &Budget { bytes: 100, nanoseconds: 10.0, formulas_only: false });
        [choice.chosen, choice.best_within_budget, choice.best, choice.linear]
            .map(|index| choice.at(index).map(|trial| trial.kind))
    }

    #[test]
    fn the_simpler_kind_within_a_standard_error_of_the_best_is_chosen() {
        let trials = |affine| {
            vec![
                trial("ols", Form::Affine, [affine, 0.1], 10),
                trial("poly", Form::Quadratic, [1.0, 0.2], 10),
                trial("gp-rbf", Form::Large, [0.5, 0.1], 10),
            ]
        };
        assert_eq!(chosen(trials(1.19)), [Some("ols"), Some("poly"), Some("gp-rbf"), Some("ols")]);
        assert_eq!(chosen(trials(1.21))[0], Some("poly"));
    }

    #[test]
    fn among_equally_simple_kinds_the_better_is_chosen() {
        let trials = vec![trial("ols", Form::Affine, [1.1, 0.5], 10), trial("ridge", Form::Affine, [1.0, 0.5], 10)];
        assert_eq!(chosen(trials)[0], Some("ridge"));
    }

    #[test]
    fn a_kind_over_the_budget_is_not_chosen() {
        let trials = vec![trial("ols", Form::Affine, [2.0, 0.1], 10), trial("poly", Form::Quadratic, [1.0, 0.1], 101)];
        assert_eq!(chosen(trials), [Some("ols"), Some("ols"), Some("poly"), Some("ols")]);
        assert_eq!(chosen(vec![trial("gp-rbf", Form::Large, [1.0, 0.1], 1)])[..2], [None, None]);
    }
}
