//! Statistics of ranks.

use super::pearson;

/// Seed of the order in which equal estimates are taken.
const SEED: u64 = 1;

/// Spearman's correlation: Pearson's of the ranks, equal values sharing their mean rank; 0 where one side is still.
pub fn spearman(estimate: &[f64], truth: &[f64]) -> f64 {
    pearson(&mean_ranks(estimate), &mean_ranks(truth))
}

/// Chatterjee's correlation (2021, eq. 1.2): 1 where the truth is a function of the estimate, about 0 where they are
/// independent. 0 where the truth does not move.
///
/// Equal estimates are taken in a random order, as the definition asks, always the same: in their order in time, a
/// curve that rests at 0 would seem to follow whatever the truth does slowly.
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

/// Ranks from 1, equal values sharing their mean rank.
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
    fn any_function_of_the_estimate_has_a_high_xi_though_no_linear_correlation() {
        let estimate: Vec<f64> = (-500..=500).map(|i| f64::from(i) / 500.0).collect();
        let truth: Vec<f64> = estimate.iter().map(|x| x * x).collect();
        assert!(pearson(&estimate, &truth).abs() < 1e-9);
        assert!(xi(&estimate, &truth) > 0.98);
    }

    #[test]
    fn estimate_that_rests_while_the_truth_moves_slowly_has_no_xi() {
        let truth: Vec<f64> = (0..1000).map(|i| (f64::from(i) / 100.0).sin()).collect();
        assert!(xi(&[0.0; 1000], &truth).abs() < 0.1);
    }
}
