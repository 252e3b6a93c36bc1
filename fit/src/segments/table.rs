//! The rankings as a summary for the terminal, and as CSV with all ranks.

use std::{collections::BTreeSet, path::Path};

use anyhow::Result;
use facewire::{
    face::LANDMARKS,
    solve::{BLENDSHAPES, FeatureId},
};

use super::ranking::{NAMES, PAIRS, Segment};
use crate::statistics::mean;

/// Returns the name of a feature, as in the model file.
pub fn feature_name(feature: usize) -> String {
    FeatureId::from_index(feature).map_or_else(String::new, |id| id.to_string())
}

/// Returns the landmarks that features are coordinates of, in the order of the features.
pub fn landmarks(features: &[usize]) -> Vec<usize> {
    let mut known = BTreeSet::new();
    let coordinates = features.iter().filter(|feature| **feature < 3 * LANDMARKS);
    coordinates.map(|feature| feature / 3).filter(|landmark| known.insert(*landmark)).collect()
}

/// Returns the titles of the columns for the agreement of rankings.
pub fn pair_heads() -> [String; 2 * PAIRS.len()] {
    let pair = |index: usize| {
        let ((a, b), what) = (PAIRS[index % PAIRS.len()], if index < PAIRS.len() { "both" } else { "rho" });
        format!("{what} {}, {}", NAMES[a], NAMES[b])
    };
    core::array::from_fn(pair)
}

/// Returns the agreement of the rankings: overlaps, then correlations of the ranks.
pub fn pair_figures(segment: &Segment) -> [f64; 2 * PAIRS.len()] {
    let (overlaps, agreements) = (segment.overlaps(), segment.agreements());
    core::array::from_fn(|index| if index < PAIRS.len() { overlaps[index] } else { agreements[index - PAIRS.len()] })
}

/// Returns the agreement of the rankings, averaged over the segments.
pub fn mean_figures(segments: &[Segment]) -> [f64; 2 * PAIRS.len()] {
    let figures: Vec<_> = segments.iter().map(pair_figures).collect();
    core::array::from_fn(|index| mean(figures.iter().map(|own| own[index])))
}

/// Formats the agreement of the rankings: overlaps as percentages, correlations as numbers.
pub fn pair_cells(figures: [f64; 2 * PAIRS.len()]) -> [String; 2 * PAIRS.len()] {
    let cell = |index: usize| match figures[index] {
        overlap if index < PAIRS.len() => format!("{:.0} %", 100.0 * overlap),
        correlation => format!("{correlation:.2}"),
    };
    core::array::from_fn(cell)
}

/// Returns a line for every segment with the overlaps, and their mean.
pub fn text(segments: &[Segment]) -> String {
    let columns = |cells: &[String]| -> Vec<String> {
        cells.iter().take(PAIRS.len()).map(|cell| format!(" {cell:>11} |")).collect()
    };
    let cells = |figures| columns(&pair_cells(figures)).concat();
    let line = |segment: &Segment| {
        let (name, [best, best_by_f]) = (BLENDSHAPES[segment.blendshape], segment.best());
        let own = format!("{:>4} | {:>9}", segment.count, landmarks(segment.kept()).len());
        let cells = cells(pair_figures(segment));
        let (best, r, best_by_f) = (feature_name(best), segment.r[best], feature_name(best_by_f));
        format!("| {name:<19} | {own} | {best:<8} | {r:>6.3} | {best_by_f:<8} |{cells}\n")
    };
    let heads = columns(&pair_heads()).concat();
    let mean = format!(
        "| {:<19} |      |           |          |        |          |{}\n",
        "mean",
        cells(mean_figures(segments))
    );
    let head = format!("| {:<19} | kept | landmarks | best     | r      | by F     |{heads}\n", "blendshape");
    let rule = format!("|---|---|---|---|---|---|{}\n", "---|".repeat(PAIRS.len()));
    head + &rule + &segments.iter().map(line).collect::<String>() + &mean
}

/// Writes a row for every blendshape and feature.
pub fn write_csv(path: &Path, segments: &[Segment]) -> Result<()> {
    let mut csv = csv::Writer::from_path(path)?;
    let heads = "blendshape,feature,kept,r,f_alone,partial_f,svr_r2,rank_r,rank_f,rank_svr";
    csv.write_record(heads.split(','))?;
    for segment in segments {
        for feature in 0..segment.r.len() {
            csv.write_record(record(segment, feature))?;
        }
    }
    Ok(csv.flush()?)
}

fn record(segment: &Segment, feature: usize) -> [String; 10] {
    let [r, f, svr] = &segment.rankings;
    [
        BLENDSHAPES[segment.blendshape].to_owned(),
        feature_name(feature),
        u8::from(segment.keeps(feature)).to_string(),
        format!("{:.6}", segment.r[feature]),
        format!("{:.3}", segment.f_alone[feature]),
        format!("{:.3}", f.scores[feature]),
        format!("{:.6}", svr.scores[feature]),
        r.ranks[feature].to_string(),
        f.ranks[feature].to_string(),
        svr.ranks[feature].to_string(),
    ]
}
