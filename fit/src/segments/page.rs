//! The page of feature rankings.

use std::path::Path;

use anyhow::Result;
use facewire::{
    face::LANDMARKS,
    solve::{BLENDSHAPES, MEASURES},
};
use maud::{Markup, html};
use rayon::prelude::*;

use super::{
    drawings,
    pictures::Pictures,
    ranking::{PAIRS, Ranking, Segment},
    table::{feature_name, landmarks, mean_figures, pair_cells, pair_figures, pair_heads},
};
use crate::{
    drawing::face::face,
    heat::LandmarkMotion,
    html::{RowHeader, figure, page, table},
    judge::Faces,
};

/// Number of features that a section lists with their scores.
const LISTED: usize = 10;

/// Returns the whole page.
pub fn html(pictures: &Pictures, unknown: &Faces, segments: &[Segment], dataset: &Path) -> Result<String> {
    let motion = LandmarkMotion::new(pictures.known, unknown, &pictures.seen)?;
    let drawn = segments.par_iter().map(|segment| section(segment, pictures, &motion)).collect::<Result<Vec<_>>>()?;
    let body = html! {
        header {
            h1 { "Segmentation" }
            p {
                (pictures.seen.len()) " rendered pictures of subjects that the fit may see, and "
                (pictures.held_out.len()) " of held-out subjects, from "
                (dataset.file_name().unwrap_or_default().to_string_lossy()) "."
            }
        }
        nav aria-label="Contents" {
            a href="#all" { "All blendshapes" }
            a href="#guide" { "How to read it" }
            @for segment in segments { @let name = BLENDSHAPES[segment.blendshape]; a.small href={ "#" (name) } { (name) } }
        }
        main {
            h2 id="all" { "All blendshapes" }
            (summary(segments))
            (guide())
            @for section in &drawn { (section) }
        }
    };
    Ok(page("segmentation", &body))
}

fn summary(segments: &[Segment]) -> Markup {
    let pairs = pair_heads();
    let heads: Vec<&str> =
        ["kept", "landmarks", "best", "r", "best by F"].into_iter().chain(pairs.iter().map(String::as_str)).collect();
    let row = |segment: &Segment| {
        let [best, best_by_f] = segment.best();
        let (count, landmark_count) = (segment.count.to_string(), landmarks(segment.kept()).len().to_string());
        let own =
            [count, landmark_count, feature_name(best), format!("{:.3}", segment.r[best]), feature_name(best_by_f)];
        let head = RowHeader { name: BLENDSHAPES[segment.blendshape], link: true };
        (head, own.into_iter().chain(pair_cells(pair_figures(segment))).collect())
    };
    let none = [""; 5].map(str::to_owned).into_iter();
    let mean = (RowHeader { name: "mean", link: false }, none.chain(pair_cells(mean_figures(segments))).collect());
    table("blendshape", &heads, &segments.iter().map(row).chain([mean]).collect::<Vec<_>>())
}

fn section(segment: &Segment, pictures: &Pictures, motion: &LandmarkMotion) -> Result<Markup> {
    let (name, chosen) = (BLENDSHAPES[segment.blendshape], landmarks(segment.kept()));
    let correlations = motion.correlations(&pictures.truth(segment.blendshape, &pictures.seen));
    let highest = correlations.iter().copied().fold(0.0, f64::max);
    let heat = face(&motion.positions, &correlations, &chosen)?;
    let caption = format!(
        "Correlation of each landmark's three coordinates with the truth: black 0, yellow {highest:.2}. Rings: landmarks of kept features"
    );
    let [_, by_f, _] = &segment.rankings;
    let heat_f = face(&motion.positions, &strength(by_f), &landmarks(&by_f.order[..segment.count]))?;
    let order = drawings::order(segment)?;
    let [r_and_f, r_and_svr, f_and_svr] = PAIRS.map(|pair| drawings::ranks(segment, pair));
    Ok(html! {
        section id=(name) {
            h2 { (name) }
            p {
                (segment.count) " of " (MEASURES) " features are kept and " (discarded(segment)) " are discarded. "
                @if !chosen.is_empty() { "Landmarks, best first: " (list(&chosen)) ". " }
                @let distances = distances(segment);
                @if !distances.is_empty() { "Distances: " (distances) "." }
            }
            (best_features(segment))
            div.figures {
                (figure(&heat, &caption, name))
                (figure(&heat_f, "The same by partial F (the root of the largest F of the coordinates), which shows what moves with this blendshape itself. Rings: landmarks of the best features", name))
                (figure(&order, "Features by rank. The blue features, up to the line, are kept", name))
                (figure(&r_and_f?, "Rank by correlation and by partial F. Features in the lower left corner are among the best of both", name))
                (figure(&r_and_svr?, "Rank by correlation and by support vectors", name))
                (figure(&f_and_svr?, "Rank by partial F and by support vectors. Blue features are kept by correlation", name))
            }
            p.up { a href="#all" { "Up" } }
        }
    })
}

/// Returns the root of the largest score of each landmark's coordinates.
fn strength(ranking: &Ranking) -> Vec<f64> {
    let largest = |scores: &[f64]| scores.iter().copied().fold(0.0, f64::max).sqrt();
    ranking.scores[..3 * LANDMARKS].chunks_exact(3).map(largest).collect()
}

fn discarded(segment: &Segment) -> String {
    format!("{:.1} %", 100.0 * (1.0 - segment.count as f64 / MEASURES as f64))
}

fn list(landmarks: &[usize]) -> String {
    landmarks.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

fn distances(segment: &Segment) -> String {
    let names = segment.kept().iter().map(|feature| feature_name(*feature));
    names.filter(|name| name.starts_with('d')).collect::<Vec<_>>().join(", ")
}

fn best_features(segment: &Segment) -> Markup {
    let [r, f, svr] = &segment.rankings;
    let names: Vec<String> = segment.kept().iter().take(LISTED).map(|feature| feature_name(*feature)).collect();
    let row = |(feature, name): (&usize, _)| {
        let scores = [
            format!("{:.3}", segment.r[*feature]),
            format!("{:.0}", f.scores[*feature]),
            format!("{:.3}", svr.scores[*feature]),
        ];
        let ranks = [r, f, svr].map(|ranking| ranking.ranks[*feature].to_string());
        (RowHeader { name, link: false }, scores.into_iter().chain(ranks).collect())
    };
    let rows: Vec<_> = segment.kept().iter().zip(names.iter().map(String::as_str)).map(row).collect();
    table("feature", &["r", "partial F", "SVR R2", "rank by r", "by F", "by SVR"], &rows)
}

fn guide() -> Markup {
    html! {
        h2 id="guide" { "How to read it" }
        dl {
            dt { "feature" } dd { "A coordinate of a landmark (x to the person's left, y up, z out of the face) or a distance of two landmarks (d), as displacement from the subject's neutral face." }
            dt { "r" } dd { "Pearson's correlation with the true coefficient over the pictures. The features with the largest absolute r are kept." }
            dt { "F" } dd { "Partial F of the feature and the coefficient, controlling for the subject, the head's pose and all other coefficients. It is large if the feature moves with this blendshape itself. The F of a single feature has the order of r squared; the CSV file contains it." }
            dt { "SVR" } dd { "R2, on held-out subjects, of a support vector regression with a Gaussian kernel on this feature alone. It also finds nonlinear relations." }
            dt { "both" } dd { "Share of the best features that two rankings have in common. By chance it would be the percentage of features that are kept." }
            dt { "rho" } dd { "Spearman's correlation of all ranks." }
        }
    }
}
