//! `facewire-fit select`: the paper's segmentation (eq. 4), the selection of features by correlation, for inspection.
//!
//! For every blendshape, the features (coordinates and distances, as displacements from the subject's neutral face) are
//! ranked by their correlation with the coefficient, and the best few percent are kept. Two other rankings check this
//! one: by partial F and by support vectors. The F of a single feature orders features like r squared, so it would be
//! no check. The partial F, which controls for the subject, the head's pose and all other blendshapes, distinguishes
//! features that move with this blendshape from those that move with others that usually accompany it. The model that
//! facewire runs shares its features among all blendshapes and selects them in another way (`select.rs`).

mod ranking;
mod tables;

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use facewire_face::BLENDSHAPES;
use facewire_face::model::MEASURES;

use self::ranking::{Pictures, Ranking, Segment};
use crate::design::MODELLED;
use crate::judge::Faces;
use crate::statistics::f_regression;
use crate::{dataset, output};

/// Arguments of `select`.
#[derive(Debug, Args)]
pub struct SelectArgs {
    /// Landmarks with true coefficients (npz archive with names.json beside it)
    dataset: PathBuf,
    /// A blendshape to rank features for; may be repeated [default: all]
    #[arg(long, value_name = "NAME", value_parser = blendshape)]
    blendshape: Vec<usize>,
    /// The page to write
    #[arg(long, value_name = "FILE", default_value = "segments.html")]
    out: PathBuf,
    /// CSV file for all scores and ranks
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Percentage of the features to keep
    #[arg(long, default_value_t = 2.0, value_parser = percentile)]
    percentile: f64,
    /// Largest number of pictures to fit support vectors to, and to judge them by
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(20..=5000))]
    svr_rows: u32,
}

fn blendshape(name: &str) -> Result<usize, String> {
    let known = BLENDSHAPES.iter().take(MODELLED).position(|known| *known == name);
    known.ok_or_else(|| "not a blendshape that landmarks show: names are like eyeBlinkLeft".to_owned())
}

fn percentile(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (0.1..=50.0).contains(number));
    number.ok_or_else(|| "not a number from 0.1 to 50".to_owned())
}

pub fn run(args: &SelectArgs) -> Result<()> {
    args.csv.iter().chain([&args.out]).try_for_each(|path| output::check(path))?;
    let samples = dataset::load(&args.dataset)?;
    let (known, unknown) = (Faces::new(&samples, true)?, Faces::new(&samples, false)?);
    let pictures = Pictures::new(&samples, &known)?;
    let wanted = if args.blendshape.is_empty() { (0..MODELLED).collect() } else { args.blendshape.clone() };
    let kept = kept_count(args.percentile);
    let segments = segments(&pictures, &wanted, kept, args.svr_rows as usize)?;
    print!("{}", tables::summary(&segments).text());
    if let Some(path) = &args.csv {
        tables::write_csv(path, &segments).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let names: Vec<String> = segments.iter().map(|own| BLENDSHAPES[own.blendshape].to_owned()).collect();
    let body = tables::page(&pictures, &unknown, &segments, &args.dataset)?;
    let contents = [("all", "All blendshapes"), ("guide", "How to read it")];
    output::write_page(&args.out, "Segmentation", &contents, &names, &body)
}

fn kept_count(percentile: f64) -> usize {
    (MEASURES as f64 * percentile / 100.0).ceil() as usize
}

fn segments(pictures: &Pictures, wanted: &[usize], kept: usize, most_rows: usize) -> Result<Vec<Segment>> {
    let moving = pictures.known.moving(wanted, &[&pictures.seen, &pictures.held_out])?;
    let (r, partial_f) = (pictures.correlations(&moving), pictures.partial_f(&moving)?);
    let mut segments = Vec::new();
    for (index, (blendshape, (r, partial_f))) in moving.iter().zip(r.into_iter().zip(partial_f)).enumerate() {
        eprint!("\rsupport vectors: blendshape {} of {} ", index + 1, moving.len());
        let f_alone = r.iter().map(|r| f_regression(*r, pictures.seen.len())).collect();
        let r2 = ranking::scores(pictures, *blendshape, most_rows)?;
        let rankings = [r.iter().map(|r| r.abs()).collect(), partial_f, r2].map(Ranking::new);
        segments.push(Segment { blendshape: *blendshape, r, f_alone, rankings, count: kept });
    }
    eprintln!();
    Ok(segments)
}

#[cfg(test)]
mod tests {
    use crate::dataset::Sample;
    use crate::dataset::tests::test_faces;
    use crate::reference;

    use super::*;

    /// Landmarks around the left eye and on its lids, without the iris.
    const LEFT_LIDS: [usize; 32] = [
        249, 263, 362, 373, 374, 380, 381, 382, 384, 385, 386, 387, 388, 390, 398, 466, 253, 254, 256, 257, 258, 259,
        260, 286, 339, 341, 359, 414, 463, 467, 252, 255,
    ];

    /// The landmark between nose and upper lip, and the inner edge of the upper lip.
    const NOSE_BASE: usize = 2;
    const UPPER_LIP: usize = 13;

    /// Ranks the features of one blendshape on few pictures, with few support vectors.
    fn segment(samples: &[Sample], name: &str) -> Segment {
        let known = Faces::new(samples, true).unwrap();
        let pictures = Pictures::new(samples, &known).unwrap();
        segments(&pictures, &[blendshape(name).unwrap()], kept_count(2.0), 20).unwrap().pop().unwrap()
    }

    #[test]
    fn the_best_features_of_eye_blink_left_are_at_the_left_eyelids() {
        let Some(path) = reference::shared("dataset/train.npz") else { return };
        let segment = segment(&dataset::load(&path).unwrap(), "eyeBlinkLeft");
        let [r, f, _] = &segment.rankings;
        for ranking in [r, f] {
            let landmarks = tables::landmarks(&ranking.order[..8]);
            assert!(landmarks.iter().all(|landmark| LEFT_LIDS.contains(landmark)), "{landmarks:?}");
        }
        assert!(segment.r[r.order[0]].abs() > 0.7);
    }

    #[test]
    fn all_features_kept_for_jaw_open_are_at_mouth_and_chin() {
        let samples = test_faces();
        let segment = segment(&samples, "jawOpen");
        let neutral = samples.iter().find(|sample| sample.neutral).unwrap();
        let down = |landmark: usize| neutral.landmarks.0[landmark][1];
        let landmarks = tables::landmarks(segment.kept());
        assert!(landmarks.iter().all(|landmark| down(*landmark) > down(NOSE_BASE)), "{landmarks:?}");
        assert!(landmarks.iter().filter(|landmark| down(**landmark) > down(UPPER_LIP)).count() > landmarks.len() / 2);
    }
}
