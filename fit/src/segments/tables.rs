//! The rankings as a summary for the terminal and the page, and as CSV with all ranks.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::Result;
use facewire_face::model::{FeatureId, MEASURES};
use facewire_face::{BLENDSHAPES, LANDMARKS};
use maud::{Markup, html};
use rayon::prelude::*;

use super::{NAMES, PAIRS, Pictures, Ranking, Segment};
use crate::drawing::{Axis, BLUE_INK, GREY_INK, LandmarkMotion, face, scatter};
use crate::faces::Faces;
use crate::output::{Table, figures, guide, number};
use crate::statistics::{mean, subsample};

const LISTED: usize = 10;

fn feature_name(feature: usize) -> String {
    FeatureId::from_index(feature).map_or_else(String::new, |id| id.to_string())
}

/// Returns the landmarks that features are coordinates of, in the order of the features.
pub fn landmarks(features: &[usize]) -> Vec<usize> {
    let mut known = BTreeSet::new();
    let coordinates = features.iter().filter(|feature| **feature < 3 * LANDMARKS);
    coordinates.map(|feature| feature / 3).filter(|landmark| known.insert(*landmark)).collect()
}

/// Returns a line for every segment with shares of common best features and correlations of ranks, and the means.
pub fn summary(segments: &[Segment]) -> Table {
    let pairs = |what: &str| PAIRS.map(|(a, b)| format!("{what} {}, {}", NAMES[a], NAMES[b]));
    let own = ["blendshape", "kept", "landmarks", "best", "r", "best by F"].map(str::to_owned);
    let heads = own.into_iter().chain(pairs("both")).chain(pairs("rho"));
    let cells = |agreements: [f64; 2 * PAIRS.len()]| {
        let (overlaps, correlations) = agreements.split_at(PAIRS.len());
        let overlaps = overlaps.iter().map(|share| format!("{:.0} %", 100.0 * share));
        overlaps.chain(correlations.iter().map(|rho| format!("{rho:.2}"))).collect::<Vec<_>>()
    };
    let row = |segment: &Segment| {
        let [best, best_by_f] = [0, 1].map(|index| segment.rankings[index].order[0]);
        let own = [
            BLENDSHAPES[segment.blendshape].to_owned(),
            segment.count.to_string(),
            landmarks(segment.kept()).len().to_string(),
            feature_name(best),
            format!("{:.3}", segment.r[best]),
            feature_name(best_by_f),
        ];
        own.into_iter().chain(cells(segment.agreements())).collect()
    };
    let all: Vec<_> = segments.iter().map(Segment::agreements).collect();
    let means = cells(core::array::from_fn(|index| mean(all.iter().map(|own| own[index]))));
    let mean = ["mean", "", "", "", "", ""].map(str::to_owned).into_iter().chain(means).collect::<Vec<_>>();
    Table::new(heads, segments.iter().map(row).chain([mean]))
}

pub fn write_csv(path: &Path, segments: &[Segment]) -> Result<()> {
    let mut csv = csv::Writer::from_path(path)?;
    let heads = "blendshape,feature,kept,r,f_alone,partial_f,svr_r2,rank_r,rank_f,rank_svr";
    csv.write_record(heads.split(','))?;
    for segment in segments {
        let [r, f, svr] = &segment.rankings;
        for feature in 0..segment.r.len() {
            csv.write_record([
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
            ])?;
        }
    }
    Ok(csv.flush()?)
}

pub fn page(pictures: &Pictures, unknown: &Faces, segments: &[Segment], dataset: &Path) -> Result<Markup> {
    let motion = LandmarkMotion::new(pictures.known, unknown, &pictures.seen)?;
    let drawn = segments.par_iter().map(|segment| section(segment, pictures, &motion)).collect::<Result<Vec<_>>>()?;
    Ok(html! {
        p {
            (pictures.seen.len()) " rendered pictures of subjects that the fit may see, and "
            (pictures.held_out.len()) " of held-out subjects, from "
            (dataset.file_name().unwrap_or_default().to_string_lossy()) "."
        }
        h2 id="all" { "All blendshapes" }
        (summary(segments).linked().html())
        (guide(&GUIDE))
        @for section in &drawn { (section) }
    })
}

fn section(segment: &Segment, pictures: &Pictures, motion: &LandmarkMotion) -> Result<Markup> {
    let (name, chosen) = (BLENDSHAPES[segment.blendshape], landmarks(segment.kept()));
    let correlations = motion.correlations(&pictures.known.truth(segment.blendshape, &pictures.seen));
    let highest = correlations.iter().copied().fold(0.0, f64::max);
    let heat = face(&motion.positions, &correlations, &chosen)?;
    let caption = format!(
        "Correlation of each landmark's three coordinates with the truth: black 0, yellow {highest:.2}. Rings: landmarks of kept features"
    );
    let by_f = &segment.rankings[1];
    let heat_f = face(&motion.positions, &strength(by_f), &landmarks(&by_f.order[..segment.count]))?;
    let [r_and_f, r_and_svr, f_and_svr] = PAIRS.map(|pair| ranks(segment, pair));
    let drawn = [
        (heat, caption.as_str()),
        (
            heat_f,
            "The same by partial F (the root of the largest F of the coordinates), which shows what moves with this blendshape itself. Rings: landmarks of the best features",
        ),
        (order(segment)?, "Features by rank. The blue features, up to the line, are kept"),
        (
            r_and_f?,
            "Rank by correlation and by partial F. Features in the lower left corner are among the best of both",
        ),
        (r_and_svr?, "Rank by correlation and by support vectors"),
        (f_and_svr?, "Rank by partial F and by support vectors. Blue features are kept by correlation"),
    ];
    let discarded = number(Some(100.0 * (1.0 - segment.count as f64 / MEASURES as f64)), 1);
    let list = chosen.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    let names = segment.kept().iter().map(|feature| feature_name(*feature));
    let distances = names.filter(|name| name.starts_with('d')).collect::<Vec<_>>().join(", ");
    Ok(html! {
        section id=(name) {
            h2 { (name) }
            p {
                (segment.count) " of " (MEASURES) " features are kept and " (discarded) " % are discarded. "
                @if !chosen.is_empty() { "Landmarks, best first: " (list) ". " }
                @if !distances.is_empty() { "Distances: " (distances) "." }
            }
            (best_features(segment).html())
            (figures(&drawn, name))
            p.up { a href="#all" { "Up" } }
        }
    })
}

fn strength(ranking: &Ranking) -> Vec<f64> {
    let largest = |scores: &[f64]| scores.iter().copied().fold(0.0, f64::max).sqrt();
    ranking.scores[..3 * LANDMARKS].chunks_exact(3).map(largest).collect()
}

fn best_features(segment: &Segment) -> Table {
    let [r, f, svr] = &segment.rankings;
    let row = |feature: &usize| {
        let scores = [(segment.r[*feature], 3), (f.scores[*feature], 0), (svr.scores[*feature], 3)];
        let scores = scores.map(|(score, decimals)| number(Some(score), decimals));
        let ranks = [r, f, svr].map(|ranking| ranking.ranks[*feature].to_string());
        [feature_name(*feature)].into_iter().chain(scores).chain(ranks).collect::<Vec<_>>()
    };
    let heads = ["feature", "r", "partial F", "SVR R2", "rank by r", "by F", "by SVR"];
    Table::new(heads, segment.kept().iter().take(LISTED).map(row))
}

const GUIDE: [(&str, &str); 6] = [
    (
        "feature",
        "A coordinate of a landmark (x to the person's left, y up, z out of the face) or a distance of two landmarks (d), \
         as displacement from the subject's neutral face.",
    ),
    (
        "r",
        "Pearson's correlation with the true coefficient over the pictures. The features with the largest absolute r are \
         kept.",
    ),
    (
        "F",
        "Partial F of the feature and the coefficient, controlling for the subject, the head's pose and all other \
         coefficients. It is large if the feature moves with this blendshape itself. The F of a single feature has the \
         order of r squared; the CSV file contains it.",
    ),
    (
        "SVR",
        "R2, on held-out subjects, of a support vector regression with a Gaussian kernel on this feature alone. It also \
         finds nonlinear relations.",
    ),
    (
        "both",
        "Share of the best features that two rankings have in common. By chance it would be the percentage of features \
         that are kept.",
    ),
    ("rho", "Spearman's correlation of all ranks."),
];

/// Number of points for features that are not among the best of any ranking: enough to show their distribution.
const OTHERS: usize = 250;
const RANKS: [&str; NAMES.len()] = ["rank by correlation", "rank by partial F", "rank by SVR"];

pub fn order(segment: &Segment) -> Result<String> {
    let ranking = &segment.rankings[0];
    let point = |feature: &usize| ((ranking.ranks[*feature] as f64).log10(), ranking.scores[*feature]);
    let (kept, others) = ranking.order.split_at(segment.count);
    let [kept, others] = [kept, &subsample(others, OTHERS)].map(|some| some.iter().map(point).collect::<Vec<_>>());
    // The next tenth above the highest.
    let most = ((ranking.scores[ranking.order[0]] * 10.0).ceil() / 10.0).clamp(0.1, 1.0);
    let axes = [Axis::ranks(RANKS[0], ranking.ranks.len()), Axis::linear("absolute correlation", [0.0, most])];
    let cut = cut(segment);
    scatter(&[(&others, GREY_INK), (&kept, BLUE_INK)], &axes, &[[(cut, 0.0), (cut, most)]])
}

/// Plots two of the ranks against each other: the best of both are in the lower left corner, the kept ones blue.
pub fn ranks(segment: &Segment, (x, y): (usize, usize)) -> Result<String> {
    let [a, b] = [x, y].map(|index| &segment.rankings[index]);
    let power = |rank: usize| (rank as f64).log10();
    let point = |feature: &usize| (power(a.ranks[*feature]), power(b.ranks[*feature]));
    let best = |feature: &usize| a.ranks[*feature] <= segment.count || b.ranks[*feature] <= segment.count;
    let (best, others): (Vec<usize>, Vec<usize>) =
        a.order.iter().filter(|feature| !segment.keeps(**feature)).partition(|feature| best(feature));
    let kept: Vec<_> = segment.kept().iter().map(point).collect();
    let others: Vec<_> = best.iter().chain(&subsample(&others, OTHERS)).map(point).collect();
    let last = a.ranks.len();
    let (cut, end) = (cut(segment), power(last));
    let axes = [Axis::ranks(RANKS[x], last), Axis::ranks(RANKS[y], last)];
    scatter(&[(&others, GREY_INK), (&kept, BLUE_INK)], &axes, &[[(cut, 0.0), (cut, end)], [(0.0, cut), (end, cut)]])
}

fn cut(segment: &Segment) -> f64 {
    (segment.count as f64 + 0.5).log10()
}
