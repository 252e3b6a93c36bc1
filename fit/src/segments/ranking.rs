//! Rankings of the features, and their agreement.

use crate::statistics::spearman;

/// The number of rankings.
pub const RANKINGS: usize = 3;
/// The names of the rankings: by correlation, by partial F, and by R2 of support vectors.
pub const NAMES: [&str; RANKINGS] = ["r", "F", "SVR"];
/// The pairs of rankings to compare.
pub const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// All features, ranked by a score.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranking {
    /// Score of each feature; larger is better.
    pub scores: Vec<f64>,
    /// Rank of each feature, from 1. Of features with equal scores, the first has the better rank.
    pub ranks: Vec<usize>,
    /// The features, best first.
    pub order: Vec<usize>,
}

impl Ranking {
    /// Ranks features by their scores.
    pub fn new(scores: Vec<f64>) -> Self {
        let mut order: Vec<usize> = (0..scores.len()).collect();
        order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        let mut ranks = vec![0; scores.len()];
        order.iter().enumerate().for_each(|(index, feature)| ranks[*feature] = index + 1);
        Self { scores, ranks, order }
    }

    /// Returns the share of the best `count` features that are also among the best `count` of another ranking.
    pub fn overlap(&self, other: &Self, count: usize) -> f64 {
        let best = self.order.iter().take(count);
        best.filter(|feature| other.ranks[**feature] <= count).count() as f64 / count as f64
    }

    /// Returns Spearman's correlation of the ranks.
    pub fn agreement(&self, other: &Self) -> f64 {
        spearman(&self.scores, &other.scores)
    }
}

/// The ranked features of one blendshape.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Index in [`facewire::solve::BLENDSHAPES`].
    pub blendshape: usize,
    /// Pearson's correlation of each feature, with its sign.
    pub r: Vec<f64>,
    /// F of each feature alone, which has the order of `r` squared.
    pub f_alone: Vec<f64>,
    /// The rankings by [`NAMES`].
    pub rankings: [Ranking; RANKINGS],
    /// The number of features that are kept.
    pub count: usize,
}

impl Segment {
    /// Returns the features that are kept: those with the highest correlation, best first.
    pub fn kept(&self) -> &[usize] {
        &self.rankings[0].order[..self.count]
    }

    /// Returns the best feature by correlation and by partial F.
    pub fn best(&self) -> [usize; 2] {
        [0, 1].map(|index| self.rankings[index].order[0])
    }

    /// Returns whether a feature is kept.
    pub fn keeps(&self, feature: usize) -> bool {
        self.rankings[0].ranks[feature] <= self.count
    }

    /// Returns the overlap of the best features for each of [`PAIRS`].
    pub fn overlaps(&self) -> [f64; PAIRS.len()] {
        PAIRS.map(|(a, b)| self.rankings[a].overlap(&self.rankings[b], self.count))
    }

    /// Returns the correlation of all ranks for each of [`PAIRS`].
    pub fn agreements(&self) -> [f64; PAIRS.len()] {
        PAIRS.map(|(a, b)| self.rankings[a].agreement(&self.rankings[b]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_feature_has_rank_1_and_equal_features_keep_their_order() {
        let ranking = Ranking::new(vec![0.1, 0.9, 0.5, 0.9]);
        assert_eq!(ranking.ranks, [4, 1, 3, 2]);
        assert_eq!(ranking.order, [1, 3, 2, 0]);
    }

    #[test]
    fn overlap_is_the_share_of_the_best_features_in_common() {
        let (one, other) = (Ranking::new(vec![4.0, 3.0, 2.0, 1.0]), Ranking::new(vec![4.0, 1.0, 2.0, 3.0]));
        assert!((one.overlap(&other, 2) - 0.5).abs() < 1e-12);
        assert!((one.overlap(&one, 2) - 1.0).abs() < 1e-12);
        assert!((one.agreement(&other) - 0.2).abs() < 1e-12);
    }
}
