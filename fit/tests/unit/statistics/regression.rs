use facewire_fit::statistics::regression::*;
use nalgebra::DMatrix;

#[test]
fn what_cannot_be_tested_has_no_result() {
    let line = DMatrix::from_fn(8, 1, |row, _| row as f64);
    assert_eq!([f_statistic(0.9, 5, 4), f_statistic(0.9, 5, 0)], [None; 2], "no degree of freedom");
    assert_eq!(breusch_pagan(&[0.5; 8], &line), None, "equal squares");
    assert!(Regressors::new(line.rows(0, 3).into_owned(), &[0, 1, 2]).is_none(), "as many groups as rows");
    let too_many = vec![0.0; SHAPIRO_WILK_MAX + 1];
    assert_eq!([&[1.0, 2.0][..], &[1.0; 20], &too_many].map(shapiro_wilk), [None; 3], "few, constant, many");
}

#[test]
fn constant_and_repeated_regressors_have_no_f_and_do_not_change_the_others() {
    let regressors = DMatrix::from_fn(50, 4, |row, column| match column {
        0 => (row as f64 * 0.7).sin(),
        1 => 0.3,
        _ => (row as f64 * 1.3).cos(),
    });
    let values: Vec<f64> = (0..50).map(|row| (f64::from(row) * 0.7).sin() + 0.1 * f64::from(row % 3)).collect();
    let alone = Regressors::new(regressors.columns(0, 3).into_owned(), &[0; 50]).unwrap().partial_f(&values);
    let all = Regressors::new(regressors, &[0; 50]).unwrap().partial_f(&values);
    assert!((all[0] / alone[0] - 1.0).abs() < 1e-4 && alone[2] > 0.0, "{alone:?} {all:?}");
    assert!(all[1] + all[2] + all[3] < f64::EPSILON);
}
