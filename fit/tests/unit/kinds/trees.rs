use facewire_fit::kinds::trees::*;

#[test]
fn the_median_is_weighted() {
    assert!((median(vec![(3.0, 5.0), (1.0, 1.0), (2.0, 1.0)]) - 3.0).abs() < 1e-12);
}

#[test]
fn faces_that_a_tree_predicts_well_get_smaller_shares() {
    let mut shares = vec![0.25; 4];
    let odds = reweight(&mut shares, &[0.0, 0.0, 0.0, 1.0], &[0.0; 4]);
    assert!(odds.is_some_and(|odds| (odds - 1.0 / 3.0).abs() < 1e-12), "{odds:?}");
    assert!((shares[0] - 0.25 / 3.0).abs() < 1e-12 && (shares[3] - 0.25).abs() < 1e-12);
}
