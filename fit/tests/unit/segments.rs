use facewire_fit::faces::Faces;
use facewire_fit::segments::*;
use facewire_fit::shapes::modelled;
use serde_json::Value;

use crate::dataset::test_faces;

/// The landmark between nose and upper lip, and the inner edge of the upper lip.
const NOSE_BASE: usize = 2;
const UPPER_LIP: usize = 13;

#[test]
fn all_features_kept_for_jaw_open_are_at_mouth_and_chin() {
    let samples = test_faces();
    let known = Faces::new(&samples, true).unwrap();
    let pictures = Pictures::new(&samples, &known).unwrap();
    let segment = &segments(&pictures, &[modelled("jawOpen").unwrap()], kept_count(2.0), 20).unwrap()[0];
    let neutral = samples.iter().find(|sample| sample.neutral).unwrap();
    let down = |landmark: usize| neutral.landmarks.0[landmark][1];
    let landmarks = tables::landmarks(segment.kept());
    assert!(landmarks.iter().all(|landmark| down(*landmark) > down(NOSE_BASE)), "{landmarks:?}");
    assert!(landmarks.iter().filter(|landmark| down(**landmark) > down(UPPER_LIP)).count() > landmarks.len() / 2);
}

#[test]
fn the_best_feature_has_rank_1_equal_ones_keep_their_order_and_overlap_counts_the_best_in_common() {
    let ranking = Ranking::new(vec![0.1, 0.9, 0.5, 0.9]);
    assert_eq!((&ranking.ranks[..], &ranking.order[..]), (&[4, 1, 3, 2][..], &[1, 3, 2, 0][..]));
    let other = Ranking::new(vec![0.1, 0.2, 0.3, 0.4]);
    assert!((ranking.overlap(&other, 2) - 0.5).abs() < 1e-12 && (ranking.overlap(&ranking, 2) - 1.0).abs() < 1e-12);
}

/// The tolerance is large because the penalty does not include the offset in scikit-learn.
#[test]
fn estimates_agree_with_scikit_learn_within_0_04() {
    let all: Value = serde_json::from_str(include_str!("../reference.json")).unwrap();
    let part = |name: &str| serde_json::from_value(all["support_vectors"][name].clone()).unwrap();
    let [values, truth, places, theirs]: [Vec<f64>; 4] = ["values", "truth", "places", "estimates"].map(part);
    let ours = estimates(&values, &truth, &places).unwrap();
    assert!(ours.iter().zip(&theirs).all(|(a, b)| (a - b).abs() < 0.04), "{ours:?} {theirs:?}");
}
