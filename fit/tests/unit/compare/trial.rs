use facewire_fit::compare::trial::*;
use nalgebra::DMatrix;

#[test]
fn a_feature_that_repeats_a_selected_one_comes_after_one_that_adds_information() {
    // Two copies of a strong feature, and a weak feature independent of them.
    let gram = DMatrix::from_row_slice(3, 3, &[1.0, 0.99, 0.0, 0.99, 1.0, 0.0, 0.0, 0.0, 1.0]);
    let ranking = Ranking { gram, cross: DMatrix::from_column_slice(3, 1, &[0.8, 0.79, 0.2]) };
    assert_eq!(ranking.best(0, 3), [0, 2, 1]);
    assert_eq!(ranking.best(0, 2), [0, 2]);
}
