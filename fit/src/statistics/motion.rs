//! Motion of a curve while its truth rests.

/// Number of frames for which the truth has to rest before a frame counts, so that a smoothed curve has settled.
const REST_FRAMES: usize = 6;
/// Largest range of a truth at rest: too little to be visible on a face, and more than the noise of a sensor.
const REST_RANGE: f64 = 0.01;
/// Fewest frames at rest that can be judged.
const LEAST_FRAMES: usize = 10;

/// Returns the jitter at rest: the root mean square of the steps from frame to frame, over the frames at which the
/// truth has stayed within [`REST_RANGE`] for [`REST_FRAMES`]. Returns `None` if there are fewer than [`LEAST_FRAMES`]
/// of them.
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
    fn a_truth_that_never_rests_has_no_jitter_at_rest() {
        let truth: Vec<f64> = (0..60).map(|i| f64::from(i) / 60.0).collect();
        assert_eq!(jitter_at_rest(&truth, &truth), None);
    }
}
