use facewire_face::model::CorrectiveTerms;
use facewire_fit::paper::corrective::*;

#[test]
fn eq_8_as_printed_and_as_a_baseline_give_what_they_give_by_hand() {
    // With k = 1/s, exp(k (t0 - t)) is 1 at 0 s, 0.607 at 0.5 s and 0.368 at 1 s after the least value.
    let values = [(0.2, 0.0), (0.9, 0.5), (0.9, 1.0), (0.1, 1.5), (0.7, 2.0), (0.8, 2.0)];
    let mut printed = PrintedShift::new(1.0, 0.05);
    let betas = values.map(|(f, t_s)| printed.step(f, t_s));
    assert_eq!(betas, [0.05, 0.9, 0.9, 0.05, 0.05, 0.8], "0.7 < 0.1 + 0.607 < 0.8");
    let mut baseline = Baseline::default();
    let at_2_per_s = [(0.2, 0.0), (0.5, 0.5), (0.9, 0.6), (0.1, 1.0)].map(|(f, t_s)| baseline.step(f, t_s));
    assert_eq!(at_2_per_s, [-0.2, -0.2, -0.9, -0.1], "0.5 < 0.2 + 0.368, and 0.9 becomes the new baseline");
}

#[test]
fn stages_of_eq_7_multiply_what_is_shifted_as_by_hand() {
    let terms = CorrectiveTerms { shift: 0.0, slope: 0.9, lift: 0.5, response: [0.0, 1.0] };
    let [raw, shifted, weighted, damped, all] = stages(&[0.6], &[-0.1], &terms);
    // g(0.5) = 0.5, 1/eta = 0.5 and gamma = 0.1.
    let wanted = [0.6, 0.5, 0.5 * 1.5, 0.5 * 1.25, 0.5 * 1.15];
    for (found, wanted) in [raw, shifted, weighted, damped, all].iter().zip(wanted) {
        assert!((found[0] - wanted).abs() < 1e-6, "{} instead of {wanted}", found[0]);
    }
}

#[test]
fn stages_as_facewire_has_them_keep_0_at_rest_and_1_at_1() {
    let terms = CorrectiveTerms { shift: 0.0, slope: 0.9, lift: 0.1, response: [0.5, 0.9] };
    let [raw, shifted, weighted, damped, all] = stages_as_used(&[0.2, 0.6, 1.0], 0.2, &terms);
    assert_eq!(raw, [0.2, 0.6, 1.0]);
    // From 0.2 to 1, 0.6 is half way.
    let wanted = [[0.0, 0.5, 1.0], [0.0, 0.5, 1.0], [0.0, 0.5, 1.0], [0.0, 0.45, 1.0]];
    for (found, wanted) in [shifted, weighted, damped, all].iter().zip(wanted) {
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} instead of {wanted:?}");
    }
}
