use facewire_fit::tune::measure::*;

fn wave(delay: f64) -> Vec<f64> {
    (0..300).map(|frame| 0.5 + 0.5 * ((f64::from(frame) - delay) * 0.25).sin()).collect()
}

#[test]
fn delay_between_frames_is_found_by_both_measures() {
    for delay in [0.0, 0.4, 1.0, 2.7] {
        let (raw, filtered) = (wave(1.5), wave(1.5 + delay));
        let sums = Sums::of([&raw, &filtered, &wave(0.0)], &[], core::slice::from_ref(&(0..300)));
        assert!((sums.lag_ms() - delay * 1000.0 / FPS).abs() < 3.0, "{delay}: {}", sums.lag_ms());
        // At the turning points the curve passes some values at once.
        assert!((sums.same_value_ms() - delay * 1000.0 / FPS).abs() < 6.0, "{delay}: {}", sums.same_value_ms());
    }
}

#[test]
fn jitter_is_the_ratio_of_the_deviations_of_the_last_two_seconds() {
    let raw: Vec<f64> = (0..75).map(|frame| if frame < 15 { 5.0 } else { f64::from(frame % 2) }).collect();
    let filtered: Vec<f64> = raw.iter().map(|value| 0.3 * value + 7.0).collect();
    let sums = Sums::of([&raw, &filtered, &raw], core::slice::from_ref(&(0..75)), &[]);
    assert!((sums.jitter() - 0.3).abs() < 1e-9 && (sums.deviations()[0] - 0.5).abs() < 1e-9);
}
