use facewire_fit::paper::*;
use facewire_fit::statistics::{column_means, mean};

/// Catches copying errors, because a wrong digit changes the mean of a column.
#[test]
fn the_columns_have_the_averages_that_the_paper_prints() {
    let printed = |row: &AgainstArkit| [&row.events[..2], &row.agreement[..4]].concat();
    for (column, papers) in printed(&AGAINST_ARKIT_AVERAGE).into_iter().enumerate() {
        let ours = mean(AGAINST_ARKIT.iter().map(|row| printed(row)[column]));
        assert!((ours - papers).abs() < 0.0101, "column {column}: {ours}, printed {papers}");
    }
}
fn values(predictions: Vec<f64>, truth: &[f64]) -> Values {
    Fitted::new("test".to_owned(), predictions, truth, 1, [8.0, 1.0]).values
}

#[test]
fn wrong_curvature_lowers_durbin_watson_and_a_model_worse_than_the_mean_has_no_f() {
    let truth: Vec<f64> = (0..200).map(|i| f64::from(i * 77 % 200) / 200.0).collect();
    let bent = values(truth.iter().map(|value| value * value).collect(), &truth);
    assert!(bent[3].unwrap() < 0.1, "in any order of the pictures");
    let truth: Vec<f64> = (0..20).map(f64::from).collect();
    let mut worse = values(truth.iter().rev().copied().collect(), &truth);
    assert!(worse[0].unwrap() < 0.0 && worse[6].is_none());
    worse[P] = Some(2.68e-5);
    let text = table("kind", [("one", worse)]).text();
    assert!(text.contains(" 3e-5 |"), "a small p keeps its magnitude: {text}");
    assert_eq!(column_means(&[worse, [None; COLUMNS.len()]])[..7], worse[..7], "missing values are left out");
}
