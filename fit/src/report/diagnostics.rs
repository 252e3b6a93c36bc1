//! The statistics of the paper's tables, for one model of one blendshape.

use nalgebra::DMatrix;

use crate::{
    drawing::subsample,
    fitted::Fitted,
    statistics::{
        SHAPIRO_WILK_MAX, TestResult, breusch_pagan, durbin_watson, f_statistic, mse, pearson, r_squared, shapiro_wilk,
        xi,
    },
};

/// Statistics of a model on the judged pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagnostics {
    /// Coefficient of determination.
    pub r_squared: f64,
    /// Chatterjee's correlation.
    pub xi: f64,
    /// Mean squared error.
    pub mse: f64,
    /// Pearson's correlation.
    pub pearson: f64,
    /// Durbin-Watson statistic of the residuals in the order of the estimates.
    pub durbin_watson: f64,
    /// Breusch-Pagan test (Lagrange multiplier) with the estimate as the regressor.
    pub breusch_pagan: Option<TestResult>,
    /// Overall F, or `None` if the model is worse than the mean of the truth.
    pub f: Option<TestResult>,
    /// Shapiro-Wilk test of the residuals.
    pub shapiro_wilk: Option<TestResult>,
    /// Truth minus estimate, in the order of the estimates.
    pub residuals: Vec<f64>,
    /// The estimates in ascending order.
    pub estimates: Vec<f64>,
}

impl Diagnostics {
    /// Computes the statistics of a model's predictions. Pictures have no natural order, so the residuals are ordered
    /// by estimate. Correlated neighbours then mean that the model has the wrong curvature.
    pub fn new(fitted: &Fitted, truth: &[f64]) -> Self {
        let estimates = &fitted.predictions;
        let mut order: Vec<usize> = (0..truth.len()).collect();
        order.sort_by(|a, b| estimates[*a].total_cmp(&estimates[*b]));
        let residuals: Vec<f64> = order.iter().map(|row| truth[*row] - estimates[*row]).collect();
        let sorted: Vec<f64> = order.iter().map(|row| estimates[*row]).collect();
        let r_squared = r_squared(estimates, truth);
        let f = f_statistic(r_squared, truth.len(), fitted.degrees_of_freedom).filter(|f| f.statistic > 0.0);
        Self {
            r_squared,
            xi: xi(estimates, truth),
            mse: mse(estimates, truth),
            pearson: pearson(estimates, truth),
            durbin_watson: durbin_watson(&residuals),
            breusch_pagan: breusch_pagan(&residuals, &DMatrix::from_column_slice(sorted.len(), 1, &sorted))
                .map(|test| test.lagrange),
            f,
            shapiro_wilk: shapiro_wilk(&subsample(&residuals, SHAPIRO_WILK_MAX)),
            residuals,
            estimates: sorted,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fitted(predictions: Vec<f64>) -> Fitted {
        Fitted {
            kind: "test".to_owned(),
            blendshape: 0,
            predictions,
            degrees_of_freedom: 1,
            bytes: 8,
            nanoseconds: 1.0,
        }
    }

    #[test]
    fn a_model_of_wrong_curvature_has_a_low_durbin_watson_in_any_order_of_the_pictures() {
        let truth: Vec<f64> = (0..200).map(|i| f64::from(i * 77 % 200) / 200.0).collect();
        let bent: Vec<f64> = truth.iter().map(|value| value * value).collect();
        assert!(Diagnostics::new(&fitted(bent), &truth).durbin_watson < 0.1);
    }

    #[test]
    fn a_model_worse_than_the_mean_has_no_f() {
        let truth: Vec<f64> = (0..20).map(f64::from).collect();
        let turned = truth.iter().rev().copied().collect();
        let diagnostics = Diagnostics::new(&fitted(turned), &truth);
        assert!(diagnostics.r_squared < 0.0 && diagnostics.f.is_none());
    }
}
