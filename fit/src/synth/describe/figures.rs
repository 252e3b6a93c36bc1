//! Statistics of expressions.

use facewire::solve::{BLENDSHAPES, COEFFS, MIRRORED};

use crate::{
    design::MODELLED,
    statistics::{mean, pearson},
    synth::expression::Coefficients,
};

/// Coefficients above these limits count as visible and as strong.
pub const VISIBLE: f64 = 0.1;
pub const STRONG: f64 = 0.3;
/// A coefficient below this limit counts as 0.
const ZERO: f64 = 0.01;
/// The quantiles that are shown of each blendshape.
pub const QUANTILES: [f64; 4] = [0.5, 0.75, 0.9, 0.99];

/// Statistics of many expressions.
pub struct Figures {
    /// Number of expressions.
    pub count: usize,
    /// Share of the expressions by their number of visible coefficients, from 0 on.
    pub densities: Vec<f64>,
    /// Mean number of strong coefficients.
    pub strong: f64,
    /// Share of the expressions without a visible coefficient.
    pub rest: f64,
    /// Statistics of each blendshape except the tongue.
    pub shapes: Vec<Marginal>,
    /// Correlation of each blendshape with each other.
    pub correlations: Vec<Vec<f64>>,
}

/// Statistics of one blendshape.
pub struct Marginal {
    /// Index of the blendshape.
    pub index: usize,
    /// Share of the expressions in which it is 0.
    pub zero: f64,
    /// Its [`QUANTILES`].
    pub quantiles: [f64; QUANTILES.len()],
    /// If it has two sides: their mean absolute difference and their correlation. Only the left side has them.
    pub sides: Option<[f64; 2]>,
}

impl Figures {
    /// Computes the statistics of at least one expression.
    pub fn of(faces: &[Coefficients]) -> Self {
        let columns: Vec<Vec<f64>> =
            (0..COEFFS).map(|index| faces.iter().map(|face| f64::from(face[index])).collect()).collect();
        let mut densities = vec![0.0; COEFFS + 1];
        for face in faces {
            densities[above(face, VISIBLE)] += 1.0 / faces.len() as f64;
        }
        let row = |a: usize| (0..MODELLED).map(|b| pearson(&columns[a], &columns[b])).collect();
        Self {
            count: faces.len(),
            rest: densities[0],
            densities,
            strong: mean(faces.iter().map(|face| above(face, STRONG) as f64)),
            shapes: (0..MODELLED).map(|index| Marginal::of(index, &columns)).collect(),
            correlations: (0..MODELLED).map(row).collect(),
        }
    }

    /// Returns the mean number of visible coefficients.
    pub fn visible(&self) -> f64 {
        self.densities.iter().enumerate().map(|(count, share)| count as f64 * share).sum()
    }

    /// Returns the smallest number of visible coefficients that this share of the expressions does not exceed.
    pub fn density_quantile(&self, share: f64) -> usize {
        let mut sum = 0.0;
        let reached = |own: &f64| {
            sum += own;
            sum >= share
        };
        self.densities.iter().position(reached).unwrap_or(COEFFS)
    }
}

impl Marginal {
    fn of(index: usize, columns: &[Vec<f64>]) -> Self {
        let own = &columns[index];
        let mut sorted = own.clone();
        sorted.sort_by(f64::total_cmp);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
        let quantile = |share: f64| sorted[(share * (sorted.len() - 1) as f64).round() as usize];
        let other = &columns[MIRRORED[index]];
        let gap = || mean(own.iter().zip(other).map(|(left, right)| (left - right).abs()));
        Self {
            index,
            zero: mean(own.iter().map(|value| f64::from(u8::from(*value < ZERO)))),
            quantiles: QUANTILES.map(quantile),
            sides: BLENDSHAPES[index].ends_with("Left").then(|| [gap(), pearson(own, other)]),
        }
    }
}

fn above(face: &Coefficients, limit: f64) -> usize {
    face.iter().filter(|value| f64::from(**value) > limit).count()
}

/// Two blendshapes whose correlation differs between recorded and sampled expressions.
pub struct Difference {
    /// The two blendshapes.
    pub pair: [usize; 2],
    /// Their correlation in recorded and in sampled expressions.
    pub correlations: [f64; 2],
}

/// Returns the pairs whose correlations differ most, the largest difference first.
pub fn largest_differences(recorded: &Figures, sampled: &Figures, count: usize) -> Vec<Difference> {
    let pairs = (0..MODELLED).flat_map(|a| (0..a).map(move |b| [b, a]));
    let difference = |pair: [usize; 2]| {
        let [a, b] = pair;
        Difference { pair, correlations: [recorded, sampled].map(|figures| figures.correlations[a][b]) }
    };
    let mut all: Vec<Difference> = pairs.map(difference).collect();
    let size = |own: &Difference| (own.correlations[0] - own.correlations[1]).abs();
    all.sort_by(|one, other| size(other).total_cmp(&size(one)));
    all.truncate(count);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::anatomy::index_of;

    /// Returns 11 faces: jawOpen rises from 0 to 1, mouthFunnel follows it, mouthSmileLeft falls, and mouthSmileRight is
    /// half as strong.
    fn faces() -> Vec<Coefficients> {
        let face = |step: u8| {
            let mut face = [0.0; COEFFS];
            let open = f32::from(step) / 10.0;
            face[index_of("jawOpen")] = open;
            face[index_of("mouthFunnel")] = 0.2 * open;
            face[index_of("mouthSmileLeft")] = 1.0 - open;
            face[index_of("mouthSmileRight")] = (1.0 - open) / 2.0;
            face
        };
        (0..11).map(face).collect()
    }

    #[test]
    fn densities_count_visible_coefficients() {
        let figures = Figures::of(&[faces(), vec![[0.0; COEFFS]; 11]].concat());
        assert_eq!(figures.count, 22);
        assert!((figures.rest - 0.5).abs() < 1e-9 && figures.density_quantile(0.5) == 0);
        assert!((figures.densities.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        let visible: usize = faces().iter().map(|face| above(face, VISIBLE)).sum();
        assert!((figures.visible() - visible as f64 / 22.0).abs() < 1e-9 && figures.density_quantile(1.0) == 4);
    }

    #[test]
    fn marginals_have_quantiles_and_the_difference_of_both_sides() {
        let figures = Figures::of(&faces());
        let shape = |name: &str| &figures.shapes[index_of(name)];
        let near = |one: f64, other: f64| (one - other).abs() < 1e-6;
        assert!(near(shape("jawOpen").quantiles[0], 0.5) && near(shape("jawOpen").quantiles[2], 0.9));
        assert!(near(shape("jawOpen").zero, 1.0 / 11.0) && near(shape("browInnerUp").zero, 1.0));
        let [gap, r] = shape("mouthSmileLeft").sides.expect("two sides");
        assert!(near(gap, 0.25) && near(r, 1.0), "{gap} {r}");
        assert!(shape("jawOpen").sides.is_none() && shape("mouthSmileRight").sides.is_none());
    }

    #[test]
    fn the_largest_difference_of_correlations_comes_first() {
        let mut broken = faces();
        let funnel = index_of("mouthFunnel");
        for face in &mut broken {
            face[funnel] = 0.2 - face[funnel];
        }
        let [recorded, sampled] = [faces(), broken].map(|faces| Figures::of(&faces));
        let differences = largest_differences(&recorded, &sampled, 3);
        assert_eq!(differences.len(), 3);
        assert!(differences.iter().all(|own| own.pair.contains(&funnel)), "only mouthFunnel was changed");
        assert!((differences[0].correlations[0] + differences[0].correlations[1]).abs() < 1e-6);
    }
}
