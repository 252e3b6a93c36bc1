//! Statistics of curves and of regressions, by which estimates are judged.
//!
//! The functions take slices, with the estimate before the truth. Tests compare each of them with `SciPy`, statsmodels
//! or scikit-learn (`fit/tests/reference.py` makes the values, `reference_values.rs` compares).

mod agreement;
mod bootstrap;
mod events;
mod moments;
mod motion;
mod normality;
mod partial;
mod ranks;
#[cfg(test)]
mod reference_values;
mod regression;
mod residuals;

use serde::Serialize;

pub use agreement::{accuracy, deviation_of_differences, mean, mse, pearson, r_squared, standard_deviation};
pub use bootstrap::{Interval, draw};
pub use events::{Event, EventCounts, EventLimits, count_events, events_of};
pub use moments::{ErrorParts, Moments};
pub use motion::jitter_at_rest;
pub use normality::{SHAPIRO_WILK_MAX, shapiro_wilk};
pub use partial::Regressors;
pub use ranks::{spearman, xi};
pub use regression::{ColumnSpace, f_regression, f_statistic};
pub use residuals::{autocorrelation, breusch_pagan, durbin_watson};

/// The result of a statistical test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TestResult {
    /// The statistic.
    pub statistic: f64,
    /// The p value: the probability of a statistic at least as large under the null hypothesis.
    pub p: f64,
}
