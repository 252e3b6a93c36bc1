use facewire_fit::paper::hardware::quantile;

#[test]
fn a_quantile_is_the_value_below_which_the_share_lies() {
    let values: Vec<f64> = (0..=100).map(f64::from).collect();
    assert_eq!([0.0, 0.5, 0.95, 1.0].map(|share| quantile(&values, share)), [0.0, 50.0, 95.0, 100.0]);
    assert!(quantile(&[], 0.5).is_nan());
}
