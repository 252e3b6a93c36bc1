//! The figures of each blendshape, and their means.

use super::{
    align::{Aligned, Pair},
    annotations::Annotations,
};
use crate::{
    paper::AgainstArkit,
    statistics::{
        EventCounts, accuracy, count_events, deviation_of_differences, jitter_at_rest, mean, mse, pearson,
        rising_edges, spearman, xi,
    },
};

/// How many figures a blendshape has.
pub const FIGURES: usize = 10;
/// Their names, in the order of [`Score::figures`].
pub const NAMES: [&str; FIGURES] =
    ["pearson", "spearman", "xi", "accuracy", "msd", "deviation", "jitter_at_rest", "precision", "recall", "f1"];

/// Figures in the order of [`NAMES`]; `None` where one cannot be had.
pub type Figures = [Option<f64>; FIGURES];

/// What counts as an event, and as finding it.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Coefficient that an expression reaches.
    pub f_min: f64,
    /// How far from its event.
    pub tolerance_s: f64,
}

/// A judged blendshape.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Its ARKit name.
    pub blendshape: &'static str,
    /// Whether the truth moves.
    pub moves: bool,
    /// Its figures.
    pub figures: Figures,
    /// Its events; `None` if others are annotated and this one is not.
    pub events: Option<EventCounts>,
}

/// Judges every blendshape that both sides have.
pub fn all(aligned: &Aligned, annotations: Option<&Annotations>, limits: Limits) -> Vec<Score> {
    aligned.pairs.iter().map(|pair| one(pair, &aligned.times_s, annotations, limits)).collect()
}

fn one(pair: &Pair, times_s: &[f64], annotations: Option<&Annotations>, limits: Limits) -> Score {
    let (estimate, truth, moves) = (&pair.estimate, &pair.truth, pair.moves());
    let reference = match annotations {
        Some(annotations) => annotations.of(pair.blendshape).map(<[f64]>::to_vec),
        None => Some(rising_edges(times_s, truth, limits.f_min)),
    };
    let events = reference.map(|events| count_events(times_s, estimate, &events, limits.f_min, limits.tolerance_s));
    let found = events.filter(|events| events.reference > 0);
    let figures = [
        moves.then(|| pearson(estimate, truth)),
        moves.then(|| spearman(estimate, truth)),
        moves.then(|| xi(estimate, truth)),
        Some(accuracy(estimate, truth)),
        Some(mse(estimate, truth)),
        Some(deviation_of_differences(estimate, truth)),
        jitter_at_rest(estimate, truth),
        found.and_then(|events| events.precision()),
        found.and_then(|events| events.recall()),
        found.and_then(|events| events.f1()),
    ];
    Score { blendshape: pair.blendshape, moves, figures, events }
}

/// The paper's figures of a blendshape; it has none for jitter.
pub fn of_paper(row: &AgainstArkit) -> Figures {
    let (events, agreement) = (row.events, row.agreement);
    [
        Some(agreement.pearson),
        Some(agreement.spearman),
        Some(agreement.xi),
        Some(agreement.accuracy),
        Some(agreement.msd),
        Some(agreement.deviation),
        None,
        Some(events.precision),
        Some(events.recall),
        Some(events.f1),
    ]
}

/// Mean of every figure over the blendshapes that have it.
pub fn means<'a>(scores: &(impl Iterator<Item = &'a Score> + Clone)) -> Figures {
    core::array::from_fn(|place| {
        let values = scores.clone().filter_map(move |score| score.figures[place]);
        values.clone().next().map(|_| mean(values))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { f_min: 0.3, tolerance_s: 0.5 };

    fn aligned(estimate: Vec<f64>, truth: Vec<f64>) -> Aligned {
        let times_s = (0..truth.len()).map(|frame| frame as f64 / 30.0).collect();
        let pairs = vec![Pair { blendshape: "jawOpen", estimate, truth }];
        Aligned { times_s, shift_frames: 0, steps_s: [1.0 / 30.0; 2], pairs, unmatched: [vec![], vec![]] }
    }

    fn figure(score: &Score, name: &str) -> Option<f64> {
        score.figures[NAMES.iter().position(|known| *known == name).unwrap()]
    }

    #[test]
    fn truth_that_rests_has_jitter_and_deviation_but_no_correlation() {
        let shaken = (0..90).map(|frame| if frame % 2 == 0 { 0.0 } else { 0.1 }).collect();
        let score = &all(&aligned(shaken, vec![0.0; 90]), None, LIMITS)[0];
        assert_eq!([figure(score, "pearson"), figure(score, "f1")], [None, None]);
        assert!((figure(score, "jitter_at_rest").unwrap() - 0.1).abs() < 1e-12);
        assert!((figure(score, "msd").unwrap() - 0.005).abs() < 1e-12);
    }

    #[test]
    fn only_annotated_blendshapes_have_events_when_some_are_annotated() {
        let curve: Vec<f64> = (0..90).map(|frame| (f64::from(frame) / 10.0).sin()).collect();
        let derived = &all(&aligned(curve.clone(), curve.clone()), None, LIMITS)[0];
        assert_eq!(figure(derived, "f1"), Some(1.0));
        let none = Annotations::default();
        assert_eq!(all(&aligned(curve.clone(), curve), Some(&none), LIMITS)[0].events, None);
    }

    #[test]
    fn mean_is_taken_over_the_blendshapes_that_have_the_figure() {
        let score = |pearson| {
            let figures = core::array::from_fn(|place| if place == 0 { pearson } else { None });
            Score { blendshape: "jawOpen", moves: true, figures, events: None }
        };
        let scores = [score(Some(0.5)), score(None), score(Some(1.0))];
        assert_eq!(means(&scores.iter())[..2], [Some(0.75), None]);
    }
}
