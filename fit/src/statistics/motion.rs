//! How much a curve moves where it should rest.

/// So many frames the truth has to rest before a frame counts: by then a smoothed curve has arrived too.
const REST_FRAMES: usize = 6;
/// Widest range of a truth that rests: under what shows on a face, above the noise of a sensor.
const REST_RANGE: f64 = 0.01;
/// Fewer frames at rest say nothing.
const LEAST_FRAMES: usize = 10;

/// Jitter at rest: root mean square of the step from frame to frame, over the frames where the truth has stayed
/// within [`REST_RANGE`] for [`REST_FRAMES`]. `None` if there are fewer than [`LEAST_FRAMES`] of them.
pub fn jitter_at_rest(estimate: &[f64], truth: &[f64]) -> Option<f64> {
    let windows = truth.windows(REST_FRAMES).zip(estimate.windows(REST_FRAMES));
    let at_rest = windows.filter(|(truth, _)| range(truth) <= REST_RANGE);
    let steps: Vec<f64> = at_rest.map(|(_, estimate)| estimate[REST_FRAMES - 1] - estimate[REST_FRAMES - 2]).collect();
    let squares: f64 = steps.iter().map(|step| step.powi(2)).sum();
    (steps.len() >= LEAST_FRAMES).then(|| (squares / steps.len() as f64).sqrt())
}

fn range(values: &[f64]) -> f64 {
    let (least, most) = values.iter().fold((f64::MAX, f64::MIN), |(a, b), value| (a.min(*value), b.max(*value)));
    most - least
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_frames_at_rest_count() {
        let truth: Vec<f64> = (0..60).map(|i| if i < 30 { 0.0 } else { f64::from(i - 30) / 30.0 }).collect();
        let shaken: Vec<f64> = (0..60).map(|i| truth[i] + if i % 2 == 0 { 0.01 } else { -0.01 }).collect();
        let jitter = jitter_at_rest(&shaken, &truth).unwrap();
        assert!((jitter - 0.02).abs() < 1e-12, "{jitter}");
    }

    #[test]
    fn truth_that_never_rests_has_no_jitter_at_rest() {
        let truth: Vec<f64> = (0..60).map(|i| f64::from(i) / 60.0).collect();
        assert_eq!(jitter_at_rest(&truth, &truth), None);
    }
}
