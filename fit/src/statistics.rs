//! Statistics of curves and of regressions, by which estimates are judged.
//!
//! The functions take slices, with the estimate before the truth. Tests compare each of them with `SciPy`, statsmodels
//! or scikit-learn (`fit/tests/reference.py` makes the values, `reference_values.rs` compares).

mod agreement;
mod events;
#[cfg(test)]
mod reference_values;
mod regression;

use serde::Serialize;

pub use agreement::{
    ErrorParts, Interval, Moments, accuracy, deviation_of_differences, draw, jitter_at_rest, mean, mse,
};
pub use agreement::{pearson, r_squared, spearman, standard_deviation, xi};
pub use events::{Event, EventCounts, EventLimits, count_events, events_of};
pub use regression::{ColumnSpace, Regressors, SHAPIRO_WILK_MAX, shapiro_wilk};
pub use regression::{autocorrelation, breusch_pagan, durbin_watson, f_regression, f_statistic};

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TestResult {
    pub statistic: f64,
    /// The p value: the probability of a statistic at least as large under the null hypothesis.
    pub p: f64,
}
