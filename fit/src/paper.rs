//! Results of the paper "Statistical Blendshape Calculation and Analysis for Graphics Applications", for comparison,
//! and the same statistics of our own models. `facewire-fit paper` shows all of them on one page (`page.rs`).
//!
//! The paper measured other faces against another truth, so its results give a scale, but do not tell which is better.

pub mod ambiguous;
pub mod corrective;
pub mod hardware;
pub mod material;
pub mod page;
pub mod processes;
pub mod sine;
pub mod smoothers;
pub mod transforms;

use facewire_face::model::FormulaScoreTable;
use nalgebra::DMatrix;

use crate::network::rounded;
use crate::output::{Table, number};
use crate::statistics::{
    SHAPIRO_WILK_MAX, TestResult, breusch_pagan, durbin_watson, f_statistic, mse, pearson, r_squared, shapiro_wilk,
    subsample, xi,
};

/// Title of the paper's table with the rows [`AGAINST_ARKIT`].
pub const AGAINST_ARKIT_TITLE: &str = "\"Comparison Between ARKit and our methods\"";
/// Title of the paper's table with the rows [`SMILE_LEFT`] and [`CHEEK_PUFF`].
pub const MODELS_TITLE: &str = "\"Demonstrative statistical behavior of blendshape models\"";

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgainstArkit {
    pub blendshape: &'static str,
    /// Precision, recall and F1 of events, compared with annotations.
    pub events: [f64; 3],
    /// Pearson's, Spearman's and Chatterjee's correlation, `1 - sqrt(MSD)`, MSD, and the standard deviation of the
    /// differences from the curves of ARKit 6. The paper does not say how it computes the last.
    pub agreement: [f64; 6],
}

const fn row(blendshape: &'static str, events: [f64; 3], agreement: [f64; 6]) -> AgainstArkit {
    AgainstArkit { blendshape, events, agreement }
}

pub const AGAINST_ARKIT: [AgainstArkit; 15] = [
    row("eyeBlinkLeft", [1.00, 1.00, 1.00], [0.576, 0.572, 0.305, 0.752, 0.061, 0.216]),
    row("eyeLookDownLeft", [0.61, 1.00, 0.76], [0.657, 0.678, 0.393, 0.876, 0.015, 0.074]),
    row("eyeLookInLeft", [0.50, 1.00, 0.66], [0.489, 0.504, 0.402, 0.773, 0.051, 0.224]),
    row("eyeBlinkRight", [1.00, 1.00, 1.00], [0.674, 0.675, 0.410, 0.794, 0.042, 0.282]),
    row("eyeLookDownRight", [0.61, 1.00, 0.76], [0.658, 0.679, 0.385, 0.876, 0.015, 0.074]),
    row("eyeLookInRight", [0.80, 0.80, 0.80], [0.567, 0.606, 0.400, 0.914, 0.007, 0.133]),
    row("jawOpen", [1.00, 1.00, 1.00], [0.921, 0.886, 0.682, 0.965, 0.001, 0.039]),
    row("mouthRight", [0.80, 1.00, 0.88], [0.636, 0.537, 0.349, 0.961, 0.001, 0.025]),
    row("mouthLeft", [1.00, 0.62, 0.76], [0.610, 0.616, 0.425, 0.945, 0.002, 0.042]),
    row("mouthSmileLeft", [1.00, 0.62, 0.76], [0.932, 0.953, 0.740, 0.867, 0.017, 0.073]),
    row("mouthSmileRight", [0.80, 1.00, 0.88], [0.907, 0.943, 0.702, 0.861, 0.019, 0.067]),
    row("mouthUpperUpLeft", [1.00, 0.62, 0.76], [0.474, 0.467, 0.407, 0.925, 0.005, 0.078]),
    row("mouthUpperUpRight", [0.80, 1.00, 0.88], [0.496, 0.504, 0.387, 0.927, 0.005, 0.080]),
    row("browDownLeft", [0.63, 1.00, 0.77], [0.699, 0.544, 0.404, 0.698, 0.091, 0.337]),
    row("browDownRight", [0.75, 0.85, 0.80], [0.717, 0.518, 0.373, 0.756, 0.059, 0.235]),
];

/// The averages that the paper prints. Its average MSD differs from that of its rows, which is 0.026.
pub const AGAINST_ARKIT_AVERAGE: AgainstArkit =
    row("average", [0.82, 0.90, 0.83], [0.667, 0.645, 0.451, 0.859, 0.019, 0.132]);

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelRow {
    pub kind: &'static str,
    /// R2, xi, MSE, Durbin-Watson and Shapiro-Wilk.
    pub figures: [f64; 5],
    pub bytes: u64,
}

const fn model(kind: &'static str, figures: [f64; 5], bytes: u64) -> ModelRow {
    ModelRow { kind, figures, bytes }
}

/// `SmileLeft`, a blendshape that a linear model suits.
const SMILE_LEFT: [ModelRow; 7] = [
    model("ML-OLS", [0.9919, 0.8849, 0.0010, 1.7679, 0.9976], 1553),
    model("Poly", [0.9882, 0.8648, 0.0014, 1.6839, 0.9931], 20_856),
    model("PCA", [0.9918, 0.8501, 0.0018, 1.7380, 0.9964], 4192),
    model("PLS", [0.9899, 0.8659, 0.0015, 1.6906, 0.9975], 5358),
    model("GP/RBF", [0.9886, 0.8645, 0.0014, 1.6274, 0.9931], 2_911_867),
    model("SVR/RBF", [0.9871, 0.8680, 0.0015, 1.6768, 0.9976], 1602),
    model("GBH/RBF", [0.9905, 0.9112, 0.0011, 1.8433, 0.9855], 2_707_469),
];

/// `CheekPuff`, a blendshape that does not suit a linear model.
const CHEEK_PUFF: [ModelRow; 11] = [
    model("ML-OLS", [0.9365, 0.7812, 0.0120, 0.5719, 0.9858], 1548),
    model("Poly", [0.8458, 0.6577, 0.0134, 1.1404, 0.9663], 30_488),
    model("PCA", [0.7560, 0.6235, 0.0203, 0.6800, 0.9811], 5486),
    model("PLS", [0.7649, 0.6237, 0.0196, 0.6800, 0.9795], 14_062),
    model("ML-Exp", [0.9509, 0.7784, 0.0119, 1.3601, 0.9392], 1548),
    model("GP/RBF", [0.8405, 0.6587, 0.0133, 0.9960, 0.9710], 2_897_439),
    model("SVR/Poly", [0.0873, 0.6430, 0.0763, 0.0005, 0.9539], 55_957),
    model("SVR/RBF", [0.8038, 0.6605, 0.0164, 0.5063, 0.96674], 32_721),
    model("GBHist/SE", [0.8715, 0.7597, 0.0107, 1.1232, 0.9766], 26_837_469),
    model("ADA", [0.8517, 0.9310, 0.0123, 0.8351, 0.9901], 8028),
    model("Grad. Boost.", [0.9043, 0.7943, 0.0080, 1.171, 0.9788], 5529),
];

/// Returns the paper's table for the two blendshapes that it reports, and nothing for others.
pub fn model_rows(blendshape: &str) -> &'static [ModelRow] {
    match blendshape {
        "mouthSmileLeft" => &SMILE_LEFT,
        "cheekPuff" => &CHEEK_PUFF,
        _ => &[],
    }
}

pub const COLUMNS: [(&str, usize); 11] = [
    ("R2", 3),
    ("xi", 3),
    ("MSE", 4),
    ("DW", 2),
    ("BP", 1),
    ("p(BP)", 3),
    ("F", 1),
    ("SW", 3),
    ("r", 3),
    ("bytes", 0),
    ("ns", 0),
];
/// The column of p values, which are too small to be averaged or written with a fixed number of decimals.
pub const P: usize = 5;

pub type Values = [Option<f64>; COLUMNS.len()];

pub struct Fitted {
    pub kind: String,
    pub predictions: Vec<f64>,
    pub values: Values,
    /// Truth minus estimate, in the order of the estimates.
    pub residuals: Vec<f64>,
}

impl Fitted {
    /// Computes the statistics of a model with a number of `weights`, without the constant. Pictures have no natural order,
    /// so the residuals are ordered by estimate. Correlated neighbours then mean that the model has the wrong curvature.
    /// There is no F of a model that is worse than the mean of the truth.
    pub fn new(
        kind: String,
        predictions: Vec<f64>,
        truth: &[f64],
        weights: usize,
        [bytes, nanoseconds]: [f64; 2],
    ) -> Self {
        let mut order: Vec<usize> = (0..truth.len()).collect();
        order.sort_by(|a, b| predictions[*a].total_cmp(&predictions[*b]));
        let residuals: Vec<f64> = order.iter().map(|row| truth[*row] - predictions[*row]).collect();
        let sorted: Vec<f64> = order.iter().map(|row| predictions[*row]).collect();
        let r_squared = r_squared(&predictions, truth);
        let f = f_statistic(r_squared, truth.len(), weights).filter(|f| f.statistic > 0.0);
        let spread = breusch_pagan(&residuals, &DMatrix::from_column_slice(sorted.len(), 1, &sorted));
        let statistic = |tested: Option<TestResult>| tested.map(|tested| tested.statistic);
        let values = [
            Some(r_squared),
            Some(xi(&predictions, truth)),
            Some(mse(&predictions, truth)),
            Some(durbin_watson(&residuals)),
            statistic(spread),
            spread.map(|tested| tested.p),
            statistic(f),
            statistic(shapiro_wilk(&subsample(&residuals, SHAPIRO_WILK_MAX))),
            Some(pearson(&predictions, truth)),
            Some(bytes),
            Some(nanoseconds),
        ];
        Self { kind, predictions, values, residuals }
    }
}

/// Returns the statistics of estimates that a model file states of a formula.
pub fn score(predictions: &[f64], truth: &[f64]) -> FormulaScoreTable {
    let [r2, xi, mse, dw, bp, .., r, _, _] =
        Fitted::new(String::new(), predictions.to_vec(), truth, 0, [0.0; 2]).values;
    let figure = |value: Option<f64>, decimals| value.map(|value| rounded(value, decimals));
    FormulaScoreTable {
        r: figure(r, 3).unwrap_or_default(),
        mse: figure(mse, 4).unwrap_or_default(),
        r2: figure(r2, 3),
        xi: figure(xi, 3),
        dw: figure(dw, 2),
        bp: figure(bp, 1),
    }
}

pub fn table<N: Into<String>>(first: &str, rows: impl IntoIterator<Item = (N, Values)>) -> Table {
    let cell = |(column, value): (usize, Option<f64>)| match value {
        Some(0.0) if column == P => "0".to_owned(),
        Some(p) if column == P && p < 0.001 => format!("{p:.0e}"),
        value => number(value, COLUMNS[column].1),
    };
    let row = |(name, values): (N, Values)| {
        [name.into()].into_iter().chain(values.into_iter().enumerate().map(cell)).collect::<Vec<_>>()
    };
    Table::new([first].into_iter().chain(COLUMNS.map(|(title, _)| title)), rows.into_iter().map(row))
}

/// Returns the statistics of models of one blendshape, followed by those of the paper, which has fewer columns.
pub fn with_papers(models: &[&Fitted], paper: &[ModelRow]) -> Table {
    let own = models.iter().map(|model| (model.kind.clone(), model.values));
    let papers = paper.iter().map(|row| {
        let [r_squared, xi, mse, durbin_watson, shapiro_wilk] = row.figures.map(Some);
        let bytes = Some(row.bytes as f64);
        let values = [r_squared, xi, mse, durbin_watson, None, None, None, shapiro_wilk, None, bytes, None];
        (format!("  {}", row.kind), values)
    });
    table("kind", own.chain(papers))
}
