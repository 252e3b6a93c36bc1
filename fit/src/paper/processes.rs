//! Gaussian processes with their confidence bands, and the models of figures 6 and 7 on a single feature.

use anyhow::{Context, Result};
use facewire_face::BLENDSHAPES;
use maud::{Markup, html};
use nalgebra::{DMatrix, DVector};

use crate::drawing::{Axis, BLUE_INK, Curve, GREEN_INK, GREY_INK, Mark, ORANGE_INK, PURPLE_INK, curves};
use crate::kinds::memory::{GaussianProcess, Kernel};
use crate::kinds::{self, Predictor};
use crate::output::{Table, figures, number};
use crate::segments::Pictures;
use crate::statistics::{mean, mse, pearson, standard_deviation, subsample};

/// Standard deviations on either side of the mean in which 95 % of a normal distribution lie.
const BAND: f64 = 1.96;
/// Pictures that a process is fitted to.
const FITTED: usize = 300;
/// Features of a process whose band is judged.
const FEATURES: usize = 8;

/// Pictures and standardised features that correlate with a blendshape, best first.
struct Cloud {
    /// What the first feature is called in a chart.
    name: &'static str,
    features: [DMatrix<f64>; 2],
    truths: [Vec<f64>; 2],
}

impl Cloud {
    /// Takes the best features for a blendshape, of some pictures that a fit sees and of the held-out ones.
    fn of(pictures: &Pictures, shape: usize, count: usize) -> Self {
        let strength: Vec<f64> = pictures.correlations(&[shape]).remove(0);
        let mut order: Vec<usize> = (0..strength.len()).collect();
        order.sort_by(|a, b| strength[*b].abs().total_cmp(&strength[*a].abs()));
        let parts = [subsample(&pictures.seen, FITTED), pictures.held_out.clone()];
        let columns: Vec<[Vec<f64>; 2]> =
            order[..count].iter().map(|feature| standardised(pictures, *feature, &parts)).collect();
        let matrix = |part: usize| DMatrix::from_fn(parts[part].len(), count, |row, at| columns[at][part][row]);
        let truths = parts.each_ref().map(|rows| pictures.known.truth(shape, rows));
        Self { name: "best feature, standardised", features: [matrix(0), matrix(1)], truths }
    }
}

/// Returns a feature of some pictures with mean 0 and deviation 1 over the first of them, and the same of others.
fn standardised(pictures: &Pictures, feature: usize, parts: &[Vec<usize>; 2]) -> [Vec<f64>; 2] {
    let [mut own, mut other] = parts.each_ref().map(|rows| pictures.feature(feature, rows));
    let (centre, deviation) = (mean(own.iter().copied()), standard_deviation(&own).max(1e-12));
    own.iter_mut().chain(&mut other).for_each(|value| *value = (*value - centre) / deviation);
    [own, other]
}

/// Returns the share of values that lie in the 95 % band of a process, the mean width of the band, and r and MSE.
pub fn coverage(process: &GaussianProcess, faces: &DMatrix<f64>, truth: &[f64]) -> [f64; 4] {
    let all: Vec<[f64; 2]> =
        faces.row_iter().map(|face| process.distribution(&face.iter().copied().collect::<Vec<_>>())).collect();
    let inside = all.iter().zip(truth).filter(|([mean, deviation], truth)| (*truth - mean).abs() <= BAND * deviation);
    let means: Vec<f64> = all.iter().map(|own| own[0]).collect();
    let width = mean(all.iter().map(|own| 2.0 * BAND * own[1]));
    [inside.count() as f64 / truth.len() as f64, width, pearson(&means, truth), mse(&means, truth)]
}

const GRID: usize = 80;

fn ends(values: &[f64]) -> [f64; 2] {
    [values.iter().copied().fold(f64::MAX, f64::min), values.iter().copied().fold(f64::MIN, f64::max)]
}

fn grid([least, most]: [f64; 2]) -> impl DoubleEndedIterator<Item = f64> + Clone {
    (0..=GRID).map(move |at| least + (most - least) * at as f64 / GRID as f64)
}

fn dots(cloud: &Cloud) -> Curve {
    let points = cloud.features[0].column(0).iter().copied().zip(cloud.truths[0].iter().copied()).collect();
    Curve::new(Mark::Dots, GREY_INK, points)
}

fn axes(cloud: &Cloud) -> [Axis; 2] {
    [Axis::linear(cloud.name, ends(cloud.features[0].as_slice())), Axis::linear("truth", [-0.2, 1.2])]
}

fn line(model: &dyn Predictor, cloud: &Cloud, ink: plotters::style::RGBColor) -> Curve {
    let points = grid(ends(cloud.features[0].as_slice())).map(|x| (x, model.predict(&[x]).clamp(-0.2, 1.2))).collect();
    Curve::new(Mark::Line, ink, points)
}

/// Draws a process on one feature with its 95 % band.
fn band(cloud: &Cloud) -> Result<String> {
    let process = GaussianProcess::fit(Kernel::Rbf, &cloud.features[0], &cloud.truths[0])?;
    let at = |x: f64, side: f64| {
        let [mean, deviation] = process.distribution(&[x]);
        (x, (mean + side * BAND * deviation).clamp(-0.2, 1.2))
    };
    let xs = grid(ends(cloud.features[0].as_slice()));
    let edge: Vec<(f64, f64)> = xs.clone().map(|x| at(x, 1.0)).chain(xs.rev().map(|x| at(x, -1.0))).collect();
    curves(&[Curve::new(Mark::Area, BLUE_INK, edge), dots(cloud), line(&process, cloud, BLUE_INK)], &axes(cloud))
}

/// Draws kinds of model on one feature.
fn kinds_chart(cloud: &Cloud, names: &[&str]) -> Result<String> {
    let mut shown = vec![dots(cloud)];
    for (name, ink) in names.iter().zip([BLUE_INK, ORANGE_INK, PURPLE_INK, GREEN_INK]) {
        let kind = kinds::ALL.iter().find(|kind| kind.name == *name).context("an unknown kind")?;
        let model = (kind.fit)(&cloud.features[0], &cloud.truths[0])?;
        shown.push(line(model.as_ref(), cloud, ink));
    }
    curves(&shown, &axes(cloud))
}

/// Draws the truth over the scores of all features along a direction, with the straight line through them.
fn score_chart(cloud: &Cloud, direction: &DVector<f64>) -> Result<String> {
    let scores = &cloud.features[0] * direction;
    let scores = DMatrix::from_column_slice(scores.len(), 1, (scores.clone() / scores.variance().sqrt()).as_slice());
    let scored = Cloud { name: "score", features: [scores, cloud.features[1].clone()], truths: cloud.truths.clone() };
    kinds_chart(&scored, &["ols"])
}

/// The direction of the greatest variance of the features, and that of the greatest covariance with the truth.
fn directions(cloud: &Cloud) -> [DVector<f64>; 2] {
    let features = &cloud.features[0];
    let decomposed = (features.transpose() * features).symmetric_eigen();
    let greatest = decomposed.eigenvectors.column(decomposed.eigenvalues.imax()).into_owned();
    [greatest, features.transpose() * DVector::from_column_slice(&cloud.truths[0])]
}

/// Returns the table of bands, and the mean share of held-out pictures in the 95 % band.
pub fn bands(pictures: &Pictures, shapes: &[usize]) -> Result<(Table, f64)> {
    let mut rows = Vec::new();
    let mut shares = Vec::new();
    for shape in shapes {
        let cloud = Cloud::of(pictures, *shape, FEATURES);
        let process = GaussianProcess::fit(Kernel::Rbf, &cloud.features[0], &cloud.truths[0])?;
        let [share, width, r, error] = coverage(&process, &cloud.features[1], &cloud.truths[1]);
        shares.push(share);
        let cells = [(100.0 * share, 1), (width, 2), (r, 3), (error, 4)];
        let cells = cells.map(|(value, decimals)| number(Some(value), decimals));
        rows.push([BLENDSHAPES[*shape].to_owned()].into_iter().chain(cells).collect::<Vec<_>>());
    }
    let heads = ["blendshape", "held-out pictures in the 95 % band, %", "mean width", "r", "MSE"];
    Ok((Table::new(heads, rows), mean(shares.into_iter())))
}

/// Draws figure 6 from pictures of one person.
pub fn simple_charts(pictures: &Pictures, shape: usize) -> Result<Markup> {
    let [one, all] = [1, FEATURES].map(|count| Cloud::of(pictures, shape, count));
    let [component, partial] = directions(&all);
    let drawn = [
        (kinds_chart(&one, &["ols"])?, "(a) A straight line on the best feature"),
        (score_chart(&all, &component)?, "(b) On the first principal component of 8 features"),
        (score_chart(&all, &partial)?, "(c) On the first component of partial least squares of 8 features"),
        (band(&one)?, "(g) A Gaussian process on the best feature, with its 95 % band"),
    ];
    Ok(html! { h3 { "Figure 6: " (BLENDSHAPES[shape]) " of one avatar" } (figures(&drawn, "Figure 6")) })
}

/// Draws figure 7 from pictures of one person. `errors` is its last chart.
pub fn other_charts(pictures: &Pictures, shape: usize, errors: String) -> Result<Markup> {
    let cloud = Cloud::of(pictures, shape, 1);
    let ensembles = ["hist-gb", "gb", "ada", "knn"];
    let drawn = [
        (kinds_chart(&cloud, &["gp-rbf", "gp-matern"])?, "(a) Gaussian processes: RBF (blue), Matérn 5/2 (orange)"),
        (kinds_chart(&cloud, &["svr-rbf", "svr-poly"])?, "(b) Support vectors: RBF (blue), polynomial (orange)"),
        (
            kinds_chart(&cloud, &ensembles)?,
            "(c) Ensembles: histogram boosting (blue), boosting (orange), AdaBoost (purple), neighbours (green)",
        ),
        (
            errors,
            "(d) Squared errors of models of all features, in order: linear (blue), exponential (orange), RBF process (purple), boosting (green)",
        ),
    ];
    Ok(
        html! { h3 { "Figure 7: " (BLENDSHAPES[shape]) " of one avatar, on the best feature" } (figures(&drawn, "Figure 7")) },
    )
}
