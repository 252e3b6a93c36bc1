use facewire_fit::compare::trial::*;
use nalgebra::DMatrix;

/// Two copies of a strong feature of the first blendshape, and one independent of them that only the second one needs much.
fn ranking(candidates: &[usize]) -> Ranking {
    let gram = DMatrix::from_row_slice(3, 3, &[1.0, 0.99, 0.0, 0.99, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let cross = DMatrix::from_column_slice(3, 2, &[0.8, 0.79, 0.2, 0.0, 0.0, 0.03]);
    Ranking { gram, cross, candidates: candidates.into() }
}

#[test]
fn a_feature_that_repeats_a_selected_one_comes_after_one_that_adds_information() {
    assert_eq!(ranking(&[0, 1, 2]).best(&[0], 3), [0, 2, 1]);
    assert_eq!(ranking(&[0, 1, 2]).best(&[0], 2), [0, 2]);
    assert_eq!(ranking(&[1, 2]).best(&[0], 2), [1, 2], "candidates alone");
}

#[test]
fn blendshapes_count_alike_in_a_choice_for_several() {
    assert_eq!(ranking(&[0, 1, 2]).best(&[0, 1], 2), [2, 0]);
}
