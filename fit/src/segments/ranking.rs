//! Rankings of the features, and how far they agree.

use crate::statistics::spearman;

/// How many rankings there are.
pub const RANKINGS: usize = 3;
/// What they go by: correlation, partial F, and R2 of support vectors.
pub const NAMES: [&str; RANKINGS] = ["r", "F", "SVR"];
/// The pairs that are compared.
pub const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// All features in an order of their own.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranking {
    /// By feature; more is better.
    pub scores: Vec<f64>,
    /// By feature, from 1; of equal features the first is better.
    pub ranks: Vec<usize>,
    /// Features, the best first.
    pub order: Vec<usize>,
}

impl Ranking {
    /// By scores.
    pub fn new(scores: Vec<f64>) -> Self {
        let mut order: Vec<usize> = (0..scores.len()).collect();
        order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        let mut ranks = vec![0; scores.len()];
        order.iter().enumerate().for_each(|(place, feature)| ranks[*feature] = place + 1);
        Self { scores, ranks, order }
    }

    /// Part of the best `count` features that are among the best `count` of another ranking.
    pub fn overlap(&self, other: &Self, count: usize) -> f64 {
        let best = self.order.iter().take(count);
        best.filter(|feature| other.ranks[**feature] <= count).count() as f64 / count as f64
    }

    /// Spearman's correlation of the ranks.
    pub fn agreement(&self, other: &Self) -> f64 {
        spearman(&self.scores, &other.scores)
    }
}

/// The features of one blendshape.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Place in [`facewire::solve::BLENDSHAPES`].
    pub blendshape: usize,
    /// Pearson's correlation of each feature, with its sign.
    pub r: Vec<f64>,
    /// F of each feature alone; its order is that of `r` squared.
    pub f_alone: Vec<f64>,
    /// By [`NAMES`].
    pub rankings: [Ranking; RANKINGS],
    /// How many features are kept.
    pub count: usize,
}

impl Segment {
    /// The features that are kept: the best by correlation, the best first.
    pub fn kept(&self) -> &[usize] {
        &self.rankings[0].order[..self.count]
    }

    /// The best feature by correlation, and by partial F.
    pub fn best(&self) -> [usize; 2] {
        [0, 1].map(|index| self.rankings[index].order[0])
    }

    /// Whether a feature is kept.
    pub fn keeps(&self, feature: usize) -> bool {
        self.rankings[0].ranks[feature] <= self.count
    }

    /// Overlap of the kept features, for each of [`PAIRS`].
    pub fn overlaps(&self) -> [f64; PAIRS.len()] {
        PAIRS.map(|(a, b)| self.rankings[a].overlap(&self.rankings[b], self.count))
    }

    /// Correlation of all ranks, for each of [`PAIRS`].
    pub fn agreements(&self) -> [f64; PAIRS.len()] {
        PAIRS.map(|(a, b)| self.rankings[a].agreement(&self.rankings[b]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn best_feature_has_rank_1_and_equal_ones_keep_their_order() {
        let ranking = Ranking::new(vec![0.1, 0.9, 0.5, 0.9]);
        assert_eq!(ranking.ranks, [4, 1, 3, 2]);
        assert_eq!(ranking.order, [1, 3, 2, 0]);
    }

    #[test]
    fn overlap_is_the_part_of_the_best_that_two_rankings_share() {
        let (one, other) = (Ranking::new(vec![4.0, 3.0, 2.0, 1.0]), Ranking::new(vec![4.0, 1.0, 2.0, 3.0]));
        assert!((one.overlap(&other, 2) - 0.5).abs() < 1e-12);
        assert!((one.overlap(&one, 2) - 1.0).abs() < 1e-12);
        assert!((one.agreement(&other) - 0.2).abs() < 1e-12);
    }
}
