mod align;

use facewire_fit::evaluate::align::{Aligned, Annotations, Pair};
use facewire_fit::evaluate::*;
use facewire_fit::statistics::EventLimits;

const LIMITS: EventLimits = EventLimits { f_min: 0.3, tolerance_s: 0.5 };

fn aligned(estimate: Vec<f64>, truth: Vec<f64>) -> Aligned {
    let times_s = (0..truth.len()).map(|frame| frame as f64 / 30.0).collect();
    let pairs = vec![Pair { blendshape: "jawOpen", estimate, truth }];
    Aligned { times_s, shift_frames: 0, steps_s: [1.0 / 30.0; 2], pairs, unmatched: [vec![], vec![]] }
}

fn metric(score: &Score, name: &str) -> Option<f64> {
    score.metrics[COLUMNS.iter().position(|(known, ..)| *known == name).unwrap()]
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
