//! Scores each blendshape by several metrics, and averages them.

use super::{
    align::{Aligned, Pair},
    annotations::Annotations,
};
use crate::{
    paper::AgainstArkit,
    statistics::{
        Event, EventCounts, EventLimits, accuracy, count_events, deviation_of_differences, events_of, jitter_at_rest,
        mean, mse, pearson, spearman, xi,
    },
};

/// The number of metrics.
pub const METRICS: usize = 11;
/// The names of the metrics, in the order of [`Score::metrics`].
pub const NAMES: [&str; METRICS] =
    ["pearson", "spearman", "xi", "accuracy", "msd", "deviation", "jitter_at_rest", "precision", "recall", "f1", "j"];

/// Metrics in the order of [`NAMES`]. A metric that is not defined for a curve is `None`.
pub type Metrics = [Option<f64>; METRICS];

/// The scores of one blendshape.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// ARKit name.
    pub blendshape: &'static str,
    /// Whether the truth moves.
    pub moves: bool,
    /// The metrics.
    pub metrics: Metrics,
    /// The event counts, or `None` if events were annotated, but not of this blendshape.
    pub events: Option<EventCounts>,
}

/// Scores every blendshape that both recordings have.
pub fn all(aligned: &Aligned, annotations: Option<&Annotations>, limits: EventLimits) -> Vec<Score> {
    aligned.pairs.iter().map(|pair| one(pair, &aligned.times_s, annotations, limits)).collect()
}

fn one(pair: &Pair, times_s: &[f64], annotations: Option<&Annotations>, limits: EventLimits) -> Score {
    let (estimate, truth, moves) = (&pair.estimate, &pair.truth, pair.moves());
    let reference = match annotations {
        Some(annotations) => annotations.of(pair.blendshape).map(<[Event]>::to_vec),
        None => Some(events_of(times_s, truth, limits.f_min)),
    };
    let events = reference.map(|events| count_events(times_s, estimate, &events, limits));
    let found = events.filter(|events| events.reference > 0);
    let metrics = [
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
        found.and_then(|events| events.j()),
    ];
    Score { blendshape: pair.blendshape, moves, metrics, events }
}

/// Returns the paper's metrics of a blendshape. The paper reports neither jitter nor J.
pub fn paper_metrics(row: &AgainstArkit) -> Metrics {
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
        None,
    ]
}

/// Averages every metric over the blendshapes that have it.
pub fn means<'a>(scores: &(impl Iterator<Item = &'a Score> + Clone)) -> Metrics {
    core::array::from_fn(|index| {
        let values = scores.clone().filter_map(move |score| score.metrics[index]);
        values.clone().next().map(|_| mean(values))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: EventLimits = EventLimits { f_min: 0.3, tolerance_s: 0.5 };

    fn aligned(estimate: Vec<f64>, truth: Vec<f64>) -> Aligned {
        let times_s = (0..truth.len()).map(|frame| frame as f64 / 30.0).collect();
        let pairs = vec![Pair { blendshape: "jawOpen", estimate, truth }];
        Aligned { times_s, shift_frames: 0, steps_s: [1.0 / 30.0; 2], pairs, unmatched: [vec![], vec![]] }
    }

    fn metric(score: &Score, name: &str) -> Option<f64> {
        score.metrics[NAMES.iter().position(|known| *known == name).unwrap()]
    }

    #[test]
    fn a_truth_at_rest_has_jitter_and_deviation_but_no_correlation() {
        let shaken = (0..90).map(|frame| if frame % 2 == 0 { 0.0 } else { 0.1 }).collect();
        let score = &all(&aligned(shaken, vec![0.0; 90]), None, LIMITS)[0];
        assert_eq!([metric(score, "pearson"), metric(score, "f1")], [None, None]);
        assert!((metric(score, "jitter_at_rest").unwrap() - 0.1).abs() < 1e-12);
        assert!((metric(score, "msd").unwrap() - 0.005).abs() < 1e-12);
    }

    #[test]
    fn with_annotations_only_annotated_blendshapes_have_events() {
        let curve: Vec<f64> = (0..90).map(|frame| (f64::from(frame) / 10.0).sin()).collect();
        let derived = &all(&aligned(curve.clone(), curve.clone()), None, LIMITS)[0];
        assert_eq!(metric(derived, "f1"), Some(1.0));
        let none = Annotations::default();
        assert_eq!(all(&aligned(curve.clone(), curve), Some(&none), LIMITS)[0].events, None);
    }

    #[test]
    fn means_are_over_the_blendshapes_that_have_the_metric() {
        let score = |pearson| {
            let metrics = core::array::from_fn(|index| if index == 0 { pearson } else { None });
            Score { blendshape: "jawOpen", moves: true, metrics, events: None }
        };
        let scores = [score(Some(0.5)), score(None), score(Some(1.0))];
        assert_eq!(means(&scores.iter())[..2], [Some(0.75), None]);
    }
}
