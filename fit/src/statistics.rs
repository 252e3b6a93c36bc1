//! The statistics by which estimates are judged: of curves and of regressions.
//!
//! Plain functions of slices; pairs are `(estimate, truth)` in this order. Each is held to values of `SciPy`,
//! statsmodels and scikit-learn (`fit/tests/reference.py` makes them, `reference_values.rs` compares).

mod agreement;
mod events;
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
pub use events::{EventCounts, count_events, rising_edges};
pub use motion::jitter_at_rest;
pub use normality::{SHAPIRO_WILK_MOST, shapiro_wilk};
pub use partial::Together;
pub use ranks::{spearman, xi};
pub use regression::{Directions, f_regression, f_statistic};
pub use residuals::{autocorrelation, breusch_pagan, durbin_watson};

/// A test statistic, and how probable one so large is if nothing is the matter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Tested {
    /// The statistic.
    pub statistic: f64,
    /// Its p value.
    pub p: f64,
}
