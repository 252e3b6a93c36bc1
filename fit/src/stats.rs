//! Statistics of pairs (estimate, truth).

/// Pearson's correlation; 0 where one side does not move.
#[expect(clippy::needless_pass_by_value, reason = "iterators are passed by value")]
pub fn pearson(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
    let mean = |f: &dyn Fn((f64, f64)) -> f64| mean(pairs.clone().map(f));
    let (a, b) = (mean(&|p| p.0), mean(&|p| p.1));
    let covariance = mean(&|p| (p.0 - a) * (p.1 - b));
    let deviations = (mean(&|p| (p.0 - a).powi(2)) * mean(&|p| (p.1 - b).powi(2))).sqrt();
    if deviations > 1e-12 { covariance / deviations } else { 0.0 }
}

/// Mean squared error.
pub fn mse(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    mean(pairs.map(|(a, b)| (a - b).powi(2)))
}

/// Mean; 0 of nothing.
pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    if count > 0.0 { sum / count } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlation_is_one_for_a_line_and_zero_for_a_constant() {
        let line = [(1.0, 3.0), (2.0, 5.0), (4.0, 9.0)];
        assert!((pearson(line.iter().copied()) - 1.0).abs() < 1e-12);
        assert!(pearson(line.iter().map(|p| (p.0, 7.0))).abs() < 1e-12);
    }

    #[test]
    fn mean_squared_error_of_a_constant_miss_is_its_square() {
        assert!((mse([(0.0, 0.5), (1.0, 1.5)].into_iter()) - 0.25).abs() < 1e-12);
    }
}
