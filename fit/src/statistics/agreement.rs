//! How far two curves agree.

/// Product of deviations below which a side counts as still.
const STILL: f64 = 1e-12;

/// Mean; 0 of nothing.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    if count > 0.0 { sum / count } else { 0.0 }
}

fn differences<'a>(estimate: &'a [f64], truth: &'a [f64]) -> impl Iterator<Item = f64> + Clone + 'a {
    estimate.iter().zip(truth).map(|(a, b)| a - b)
}

/// Pearson's correlation; 0 where one side does not move.
pub fn pearson(estimate: &[f64], truth: &[f64]) -> f64 {
    let pairs = || estimate.iter().zip(truth);
    let (a, b) = (mean(pairs().map(|p| *p.0)), mean(pairs().map(|p| *p.1)));
    let covariance = mean(pairs().map(|p| (p.0 - a) * (p.1 - b)));
    let variances = [mean(pairs().map(|p| (p.0 - a).powi(2))), mean(pairs().map(|p| (p.1 - b).powi(2)))];
    let deviations = (variances[0] * variances[1]).sqrt();
    if deviations > STILL { covariance / deviations } else { 0.0 }
}

/// Mean squared error; against another tracker it is called mean squared deviation.
pub fn mse(estimate: &[f64], truth: &[f64]) -> f64 {
    mean(differences(estimate, truth).map(|difference| difference.powi(2)))
}

/// Standard deviation (n - 1) of the differences: what is left of the error once its mean is taken off.
///
/// The paper does not say how its column "Deviation" is made; in some of its rows it exceeds the root of the mean
/// squared deviation, which this one never does by more than `sqrt(n / (n - 1))`.
pub fn deviation_of_differences(estimate: &[f64], truth: &[f64]) -> f64 {
    standard_deviation(&differences(estimate, truth).collect::<Vec<_>>())
}

/// Standard deviation (n - 1); 0 of fewer than two values.
pub fn standard_deviation(values: &[f64]) -> f64 {
    let centre = mean(values.iter().copied());
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    (squares / values.len().saturating_sub(1).max(1) as f64).sqrt()
}

/// `1 - sqrt(MSD)`. The paper reports an accuracy and does not define it; all fifteen rows of its table agree with
/// this definition, if its MSD is cut off after three decimals.
pub fn accuracy(estimate: &[f64], truth: &[f64]) -> f64 {
    1.0 - mse(estimate, truth).sqrt()
}

/// Coefficient of determination: the part of the truth's variance that the estimate explains. Below 0 it is worse
/// than the truth's mean; 0 where the truth does not move.
pub fn r_squared(estimate: &[f64], truth: &[f64]) -> f64 {
    let centre = mean(truth.iter().copied());
    let variance = mean(truth.iter().map(|value| (value - centre).powi(2)));
    if variance > STILL { 1.0 - mse(estimate, truth) / variance } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper::{AGAINST_ARKIT, AgainstArkit};

    #[test]
    fn correlation_is_one_for_a_line_and_zero_for_a_constant() {
        let line = [1.0, 2.0, 4.0];
        assert!((pearson(&line, &[3.0, 5.0, 9.0]) - 1.0).abs() < 1e-12);
        assert!(pearson(&line, &[7.0; 3]).abs() < 1e-12);
    }

    #[test]
    fn mean_squared_error_of_a_constant_miss_is_its_square() {
        assert!((mse(&[0.0, 1.0], &[0.5, 1.5]) - 0.25).abs() < 1e-12);
        assert!((accuracy(&[0.0, 1.0], &[0.5, 1.5]) - 0.5).abs() < 1e-12);
        assert!(deviation_of_differences(&[0.0, 1.0], &[0.5, 1.5]) < 1e-12);
    }

    #[test]
    fn accuracy_is_defined_as_the_papers_table_implies() {
        for AgainstArkit { blendshape, agreement, .. } in &AGAINST_ARKIT {
            let (most, least) = (1.0 - agreement.msd.sqrt(), 1.0 - (agreement.msd + 0.001).sqrt());
            let rounding = 0.0005;
            let implied = least - rounding..=most + rounding;
            assert!(implied.contains(&agreement.accuracy), "{blendshape}: {} in {implied:?}", agreement.accuracy);
        }
    }
}
