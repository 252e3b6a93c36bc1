//! Agreement of two curves.

/// Variances and products of standard deviations up to this value count as 0.
const STILL: f64 = 1e-12;

/// Returns the mean, or 0 if there are no values.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    if count > 0.0 { sum / count } else { 0.0 }
}

fn differences<'a>(estimate: &'a [f64], truth: &'a [f64]) -> impl Iterator<Item = f64> + Clone + 'a {
    estimate.iter().zip(truth).map(|(a, b)| a - b)
}

/// Returns Pearson's correlation, or 0 if one side is constant.
pub fn pearson(estimate: &[f64], truth: &[f64]) -> f64 {
    let pairs = || estimate.iter().zip(truth);
    let (a, b) = (mean(pairs().map(|p| *p.0)), mean(pairs().map(|p| *p.1)));
    let covariance = mean(pairs().map(|p| (p.0 - a) * (p.1 - b)));
    let variances = [mean(pairs().map(|p| (p.0 - a).powi(2))), mean(pairs().map(|p| (p.1 - b).powi(2)))];
    let deviations = (variances[0] * variances[1]).sqrt();
    if deviations > STILL { covariance / deviations } else { 0.0 }
}

/// Returns the mean squared error. Between two trackers it is called mean squared deviation.
pub fn mse(estimate: &[f64], truth: &[f64]) -> f64 {
    mean(differences(estimate, truth).map(|difference| difference.powi(2)))
}

/// Returns the standard deviation (n - 1) of the differences: the error without its mean.
///
/// The paper does not say how it computes its column "Deviation". In some of its rows, the value exceeds the root of
/// the mean squared deviation, which this function never does by more than a factor of `sqrt(n / (n - 1))`.
pub fn deviation_of_differences(estimate: &[f64], truth: &[f64]) -> f64 {
    standard_deviation(&differences(estimate, truth).collect::<Vec<_>>())
}

/// Returns the standard deviation (n - 1), or 0 if there are fewer than two values.
pub fn standard_deviation(values: &[f64]) -> f64 {
    let centre = mean(values.iter().copied());
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    (squares / values.len().saturating_sub(1).max(1) as f64).sqrt()
}

/// Returns `1 - sqrt(MSD)`. The paper does not define the accuracy that it reports, but all fifteen rows of its table
/// agree with this definition if its MSD is truncated to three decimals.
pub fn accuracy(estimate: &[f64], truth: &[f64]) -> f64 {
    1.0 - mse(estimate, truth).sqrt()
}

/// Returns the coefficient of determination: the share of the truth's variance that the estimate explains. It is below
/// 0 if the estimate is worse than the truth's mean, and 0 if the truth is constant.
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
    fn a_constant_error_gives_its_square_as_the_mean_squared_error() {
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
