//! Rank correlations.

use super::pearson;

/// Seed of the random order of equal estimates.
const SEED: u64 = 1;

/// Returns Spearman's correlation: Pearson's correlation of the ranks, with the mean rank for equal values. Returns 0
/// if one side is constant.
pub fn spearman(estimate: &[f64], truth: &[f64]) -> f64 {
    pearson(&mean_ranks(estimate), &mean_ranks(truth))
}

/// Returns Chatterjee's correlation (2021, eq. 1.2): 1 if the truth is a function of the estimate, about 0 if they are
/// independent, and 0 if the truth is constant.
///
/// Equal estimates are put in a random order, as the definition requires, which is the same in every run. In order of
/// time, a curve that rests at 0 would seem to follow any truth that changes slowly.
pub fn xi(estimate: &[f64], truth: &[f64]) -> f64 {
    let count = estimate.len().min(truth.len());
    let mut order: Vec<usize> = (0..count).collect();
    fastrand::Rng::with_seed(SEED).shuffle(&mut order);
    order.sort_by(|a, b| estimate[*a].total_cmp(&estimate[*b]));
    let mut sorted = truth[..count].to_vec();
    sorted.sort_by(f64::total_cmp);
    let at_most: Vec<f64> = truth[..count].iter().map(|y| sorted.partition_point(|other| other <= y) as f64).collect();
    let at_least = truth[..count].iter().map(|y| (count - sorted.partition_point(|other| other < y)) as f64);
    let steps: f64 = order.windows(2).map(|pair| (at_most[pair[1]] - at_most[pair[0]]).abs()).sum();
    let n = count as f64;
    let scale: f64 = at_least.map(|least| least * (n - least)).sum::<f64>() * 2.0;
    if scale > 0.0 { 1.0 - n * steps / scale } else { 0.0 }
}

/// Returns ranks from 1, with the mean rank for equal values.
fn mean_ranks(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let below = |value: &f64| sorted.partition_point(|other| other < value);
    let not_above = |value: &f64| sorted.partition_point(|other| other <= value);
    values.iter().map(|value| (below(value) + not_above(value) + 1) as f64 / 2.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_values_share_their_mean_rank() {
        assert_eq!(mean_ranks(&[0.2, 0.1, 0.2, 0.9]), [2.5, 1.0, 2.5, 4.0]);
    }

    #[test]
    fn a_nonlinear_function_of_the_estimate_has_a_high_xi_without_linear_correlation() {
        let estimate: Vec<f64> = (-500..=500).map(|i| f64::from(i) / 500.0).collect();
        let truth: Vec<f64> = estimate.iter().map(|x| x * x).collect();
        assert!(pearson(&estimate, &truth).abs() < 1e-9);
        assert!(xi(&estimate, &truth) > 0.98);
    }

    #[test]
    fn an_estimate_at_rest_has_no_xi_with_a_truth_that_moves_slowly() {
        let truth: Vec<f64> = (0..1000).map(|i| (f64::from(i) / 100.0).sin()).collect();
        assert!(xi(&[0.0; 1000], &truth).abs() < 0.1);
    }
}
