use std::f64::consts::TAU;

use facewire_fit::paper::sine::*;

#[test]
fn a_sine_of_known_delay_and_amplitude_is_measured_as_such() {
    let wave = |size: f64, delay: f64| -> Vec<f64> {
        (0..60).map(|frame| 0.5 - 0.5 * size * (TAU * (f64::from(frame) - delay) / 30.0).cos()).collect()
    };
    for (size, frames) in [(1.0, 0.0), (0.6, 2.5), (1.2, -1.0)] {
        let found = follow(&wave(size, frames), &wave(1.0, 0.0), 30);
        let delay_ms = frames * 1000.0 / 30.0;
        assert!((found.delay_ms - delay_ms).abs() < 1e-6, "{found:?}");
        assert!((found.amplitude - size).abs() < 1e-9, "{found:?}");
        assert!((found.r - (TAU * frames / 30.0).cos()).abs() < 1e-9, "{found:?}");
    }
}
