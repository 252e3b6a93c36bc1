//! The Shapiro-Wilk test for normal residuals, by Royston's approximation.
//!
//! Coefficients: P. Royston, "Approximating the Shapiro-Wilk W-test for non-normality" (1992) and algorithm AS R94
//! (1995).

use statrs::distribution::{ContinuousCDF, Normal};

use super::{TestResult, mean};

/// Largest sample for which Royston's approximation holds.
pub const SHAPIRO_WILK_MAX: usize = 5000;
/// Smallest sample that can deviate from normality.
const FEWEST: usize = 3;
/// Up to this sample size, only the last weight is corrected, and above it the last two.
const FEW: usize = 5;
/// Up to this sample size, `ln(1 - W)` is transformed in another way.
const SMALL: usize = 11;

/// Corrections of the last weight and of the weight before it: polynomials in `1 / sqrt(n)`.
const LAST: [f64; 6] = [0.0, 0.221_157, -0.147_981, -2.071_19, 4.434_685, -2.706_056];
const BEFORE_LAST: [f64; 6] = [0.0, 0.042_981, -0.293_762, -1.752_461, 5.682_633, -3.582_633];
/// For samples up to [`SMALL`], polynomials in n: a bound, the mean, and the logarithm of the standard deviation.
const SMALL_BOUND: [f64; 2] = [-2.273, 0.459];
const SMALL_MEAN: [f64; 4] = [0.544, -0.399_78, 0.025_054, -6.714e-4];
const SMALL_DEVIATION: [f64; 4] = [1.3822, -0.778_57, 0.062_767, -0.002_032_2];
/// For larger samples, the same mean and logarithm of the standard deviation as polynomials in ln n.
const LARGE_MEAN: [f64; 4] = [-1.5861, -0.310_82, -0.083_751, 0.003_891_5];
const LARGE_DEVIATION: [f64; 3] = [-0.4803, -0.082_676, 0.003_030_2];

/// Returns W, which is 1 for a sample that looks normal, and its p value. Returns `None` for fewer than 3 or more than
/// [`SHAPIRO_WILK_MAX`] values, and for constant values.
pub fn shapiro_wilk(values: &[f64]) -> Option<TestResult> {
    if !(FEWEST..=SHAPIRO_WILK_MAX).contains(&values.len()) {
        return None;
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let centre = mean(sorted.iter().copied());
    let squares: f64 = sorted.iter().map(|value| (value - centre).powi(2)).sum();
    let span: f64 = weights(sorted.len())?.iter().zip(&sorted).map(|(weight, value)| weight * (value - centre)).sum();
    if !(squares > 0.0) {
        return None;
    }
    let statistic = (span.powi(2) / squares).min(1.0);
    Some(TestResult { statistic, p: p_of(statistic, sorted.len())? })
}

/// Returns the weights of the sorted values: an antisymmetric vector of length 1.
fn weights(count: usize) -> Option<Vec<f64>> {
    let normal = Normal::standard();
    let n = count as f64;
    let score = |rank: usize| normal.inverse_cdf((rank as f64 - 0.375) / (n + 0.25));
    let mut weights: Vec<f64> = (1..=count).map(score).collect();
    let squares: f64 = weights.iter().map(|score| score.powi(2)).sum();
    let corrected: &[&[f64]] = match count {
        FEWEST => return Some(vec![-0.5_f64.sqrt(), 0.0, 0.5_f64.sqrt()]),
        ..=FEW => &[&LAST],
        _ => &[&LAST, &BEFORE_LAST],
    };
    let ends: Vec<(f64, f64)> = corrected
        .iter()
        .zip(weights.iter().rev())
        .map(|(terms, score)| (*score, score / squares.sqrt() + polynomial(terms, n.sqrt().recip())))
        .collect();
    let rest_of_scores = squares - 2.0 * ends.iter().map(|(score, _)| score.powi(2)).sum::<f64>();
    let rest_of_weights = 1.0 - 2.0 * ends.iter().map(|(_, weight)| weight.powi(2)).sum::<f64>();
    let scale = (rest_of_scores / rest_of_weights).sqrt();
    for weight in &mut weights {
        *weight /= scale;
    }
    for (index, (_, weight)) in ends.iter().enumerate() {
        *weights.get_mut(index)? = -weight;
        *weights.get_mut(count - 1 - index)? = *weight;
    }
    Some(weights)
}

fn p_of(w: f64, count: usize) -> Option<f64> {
    use core::f64::consts::{FRAC_PI_3, PI};
    if count == FEWEST {
        return Some((6.0 / PI * (w.sqrt().asin() - FRAC_PI_3)).max(0.0));
    }
    let (n, y) = (count as f64, (1.0 - w).ln());
    let (y, centre, log_deviation) = if count > SMALL {
        (y, polynomial(&LARGE_MEAN, n.ln()), polynomial(&LARGE_DEVIATION, n.ln()))
    } else {
        let above = polynomial(&SMALL_BOUND, n) - y;
        if above <= 0.0 {
            return Some(0.0);
        }
        (-above.ln(), polynomial(&SMALL_MEAN, n), polynomial(&SMALL_DEVIATION, n))
    };
    Some(Normal::new(centre, log_deviation.exp()).ok()?.sf(y))
}

fn polynomial(terms: &[f64], x: f64) -> f64 {
    terms.iter().rev().fold(0.0, |sum, term| sum * x + term)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_are_antisymmetric_and_of_length_one() {
        for count in [3, 4, 5, 6, 11, 12, 500] {
            let weights = weights(count).unwrap();
            let length: f64 = weights.iter().map(|weight| weight.powi(2)).sum();
            assert!((length - 1.0).abs() < 1e-9, "{count}: {length}");
            assert!(weights.iter().zip(weights.iter().rev()).all(|(a, b)| (a + b).abs() < 1e-9));
        }
    }

    #[test]
    fn samples_that_are_too_small_too_large_or_constant_are_not_tested() {
        assert_eq!(shapiro_wilk(&[1.0, 2.0]), None);
        assert_eq!(shapiro_wilk(&[1.0; 20]), None);
        assert_eq!(shapiro_wilk(&vec![0.0; SHAPIRO_WILK_MAX + 1]), None);
    }
}
