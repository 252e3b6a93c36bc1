//! `facewire-fit judge`: how good a model is by facewire's own solver, and how sure that is.

pub mod figures;
pub mod set;
pub mod tables;

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use clap::Args;
use facewire_face::model::FEATURES;
use facewire_face::stages::{Coefficients, FaceMean, Features, Normalised, correct, normalise};
use facewire_face::{BLENDSHAPES, COEFFS, Camera, HeadPose, Model, Neutral, Profile, SolveError};
use nalgebra::DMatrix;
use rayon::prelude::*;

use self::figures::Judgement;
use self::set::Set;
use crate::dataset::{Appearances, Person, Sample, held_out};
use crate::output;
use crate::statistics::{mean, mse, pearson, standard_deviation};

/// Number of passes over the pictures when timing. The fastest pass counts, because other load disturbs it least.
const TIMED_PASSES: usize = 7;
const MOVES: f64 = 1e-3;

pub struct Faces<'a> {
    samples: &'a [Sample],
    features: Vec<Features>,
    neutral_known: bool,
    appearances: Option<&'a Appearances>,
}

impl<'a> Faces<'a> {
    /// Computes the features of every sample. They are relative to the person's neutral face if `neutral_known`.
    pub fn new(samples: &'a [Sample], neutral_known: bool) -> Result<Self> {
        let faces = samples.par_iter().map(|sample| normalise(&sample.landmarks)).collect::<Result<Vec<_>, _>>()?;
        let neutrals = if neutral_known { neutrals(samples, &faces)? } else { BTreeMap::new() };
        let one = |(sample, face): (&Sample, &Normalised)| Features::new(face, neutrals.get(&sample.person()));
        let features = samples.par_iter().zip(&faces).map(one).collect();
        Ok(Self { samples, features, neutral_known, appearances: None })
    }

    /// Adds how the faces of the dataset look. No sample may be a mirrored copy.
    pub fn with_appearances(self, appearances: Option<&'a Appearances>) -> Self {
        Self { appearances, ..self }
    }

    fn raw(&self, model: &Model, row: usize) -> Result<Coefficients, SolveError> {
        let appearance = self.appearances.map(|appearances| appearances.of(self.samples[row].picture));
        let raw = self.of_landmarks(model, row)?;
        let residual = model.residual(appearance.as_ref(), f32::from(u8::from(self.neutral_known)))?;
        Ok(residual.map_or(raw, |residual| raw.plus(&residual)))
    }

    /// Returns what a model makes of the landmarks of picture `row`, without the look of the face.
    pub fn of_landmarks(&self, model: &Model, row: usize) -> Result<Coefficients, SolveError> {
        model.process(&self.features[row])
    }

    pub fn len(&self) -> usize {
        self.samples.len()
    }

    pub fn rows(&self, all: bool) -> Result<Vec<usize>> {
        if all { Ok((0..self.len()).collect()) } else { held_out(self.samples) }
    }

    /// Returns those of the blendshapes that move in each of `parts`. The names of the others are printed.
    pub fn moving(&self, wanted: &[usize], parts: &[&[usize]]) -> Result<Vec<usize>> {
        let moves = |shape: &usize| parts.iter().all(|rows| standard_deviation(&self.truth(*shape, rows)) > MOVES);
        let (moving, still): (Vec<usize>, Vec<usize>) = wanted.iter().partition(|shape| moves(shape));
        ensure!(!moving.is_empty(), "none of these blendshapes moves in the pictures");
        if !still.is_empty() {
            let names: Vec<&str> = still.iter().map(|shape| BLENDSHAPES[*shape]).collect();
            eprintln!("left out because they do not move in the pictures: {}", names.join(", "));
        }
        Ok(moving)
    }

    pub fn truth(&self, blendshape: usize, rows: &[usize]) -> Vec<f64> {
        rows.iter().map(|row| self.samples[*row].truth[blendshape]).collect()
    }

    /// Returns the true coefficients of pictures `rows`, one column per picture.
    pub fn truths(&self, rows: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(COEFFS, rows.len(), |blendshape, row| self.samples[rows[row]].truth[blendshape])
    }

    pub fn values(&self, row: usize) -> &[f32; FEATURES] {
        self.features[row].values()
    }
}

fn neutrals(samples: &[Sample], faces: &[Normalised]) -> Result<BTreeMap<Person, Neutral>> {
    let mut means: BTreeMap<Person, FaceMean> = BTreeMap::new();
    for (sample, face) in samples.iter().zip(faces) {
        let mean = means.entry(sample.person()).or_default();
        if sample.neutral {
            mean.add(face);
        }
    }
    let finish =
        |(person, mean): (Person, FaceMean)| Ok((person, mean.neutral().context("a subject has no neutral picture")?));
    means.into_iter().map(finish).collect()
}

/// Returns correlation and mean squared error of the corrected coefficients in pictures `rows`, for each blendshape.
pub fn scores(model: &Model, faces: &Faces, rows: &[usize]) -> Result<Vec<[f64; 2]>> {
    let score = |(blendshape, estimate): (usize, Vec<f64>)| {
        let truth = faces.truth(blendshape, rows);
        [pearson(&estimate, &truth), mse(&estimate, &truth)]
    };
    Ok(estimates(model, faces, rows)?.into_iter().enumerate().map(score).collect())
}

pub fn estimates(model: &Model, faces: &Faces, rows: &[usize]) -> Result<Vec<Vec<f64>>> {
    let mut curves = vec![Vec::new(); COEFFS];
    for row in rows {
        let raw = faces.raw(model, *row)?;
        let corrected = correct(&raw, &model.correction, &Profile::default());
        curves.iter_mut().zip(corrected.0).for_each(|(curve, value)| curve.push(f64::from(value)));
    }
    Ok(curves)
}

/// Times the regression. Returns nanoseconds per face: the mean over pictures `rows` in the fastest of several passes.
pub fn regression_ns(model: &Model, faces: &Faces, rows: &[usize]) -> Result<f64> {
    let pass = || -> Result<f64> {
        let start = Instant::now();
        for row in rows {
            black_box(model.process(black_box(&faces.features[*row]))?);
        }
        Ok(start.elapsed().as_secs_f64() * 1e9 / rows.len() as f64)
    };
    (0..TIMED_PASSES).try_fold(f64::INFINITY, |best, _| Ok(best.min(pass()?)))
}

/// Returns the mean absolute error of yaw, pitch and roll in degrees over all pictures: the pose is not fitted.
pub fn pose_error_deg(samples: &[Sample]) -> Result<[f64; 3]> {
    let camera = Camera { width_px: 400.0, height_px: 600.0, horizontal_fov_deg: 16.1 };
    let angles = |pose: HeadPose| pose.yaw_pitch_roll_deg().map(f64::from);
    let errors = |sample: &Sample| -> Result<[f64; 3]> {
        let seen = angles(HeadPose::new(&normalise(&sample.landmarks)?, &camera));
        Ok(core::array::from_fn(|axis| (seen[axis] - sample.pose_deg[axis]).abs()))
    };
    let errors = samples.par_iter().map(errors).collect::<Result<Vec<_>>>()?;
    Ok(core::array::from_fn(|axis| mean(errors.iter().map(|error| error[axis]))))
}

const AFTER_HELP: &str = "\
Figures, of all pictures of all people together:
  r      Pearson's correlation of estimate and truth
  MSE    mean squared error
  bias   mean error, estimate minus truth
  gain   standard deviation of the estimates divided by that of the truth
  slope  slope of the straight line through the estimates over the truth: gain times r
A SET that is a folder holds clips: NAME.avi with its truth in NAME.csv, each of another person, as `film` makes them. They
are tracked by every stage of `facewire track`, with and without --neutral. Clips also have the jitter: the root mean square
of the steps from frame to frame, over the frames at which the truth has stayed within 0.01 for 6 frames.
The MSE is the sum of three parts. Bias: what subtracting each person's mean error would remove. Gain: what scaling each
person's estimates by the best factor would remove after that. Rest: the remainder.
A blendshape is at rest in the pictures in which its true coefficient is at most 0.02, and moves in the others.
`+-` and `a .. b` are 95 % confidence intervals by the bootstrap over people: whole people are drawn, with replacement.
Two models are compared on the same draws. A difference whose interval excludes 0 is marked `*`.

Examples:
  facewire-fit judge faces/judge/faces.npz --all-subjects
  facewire-fit judge faces/judge/faces.npz --all-subjects --model new.toml --against models/blendshapes.toml
  facewire-fit judge faces.npz clips/ --model new.toml --against old.toml --page new-against-old.html
  facewire-fit judge faces.npz clips/ --json figures.json --csv people.csv";

#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct JudgeArgs {
    /// Landmarks with true coefficients (npz archives with names.json beside them), or folders of clips
    #[arg(required = true, value_name = "SET")]
    sets: Vec<PathBuf>,
    /// A model to judge instead of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Another model to compare it with, on the same faces
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// HTML page that compares both models
    #[arg(long, value_name = "FILE", requires = "against")]
    page: Option<PathBuf>,
    /// Judge on all subjects of datasets: only for data that the model was not fitted on
    #[arg(long)]
    all_subjects: bool,
    /// Number of frames at the start of each clip in which the face is at rest
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    neutral_frames: u32,
    /// Draws of people for the confidence intervals
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(40..=100_000))]
    resamples: u64,
    /// JSON file for all figures with their intervals
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// CSV file for the figures of every person and blendshape
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

pub struct Judged {
    pub set: String,
    /// Facts about the set itself, such as the number of frames without a face.
    pub notes: String,
    pub neutral: [Rivals; 2],
}

pub struct Rivals {
    pub model: Judgement,
    pub against: Option<Judgement>,
}

pub const NEUTRAL: [&str; 2] = ["neutral face known", "neutral face not known"];

pub fn run(args: &JudgeArgs) -> Result<()> {
    [&args.json, &args.csv, &args.page].into_iter().flatten().try_for_each(|path| output::check(path))?;
    let model = load_model(args.model.as_deref())?;
    let against = args.against.as_deref().map(Model::load).transpose()?;
    let models: Vec<&Model> = [&model].into_iter().chain(&against).collect();
    let mut judged = Vec::new();
    for path in &args.sets {
        let set = Set::load(path, args.all_subjects, args.neutral_frames)?;
        let one = judge(&set, &models, args.resamples)?;
        print!("{}", tables::text(&one)?);
        judged.push(one);
    }
    println!("model in memory: {} bytes", model.size_bytes());
    if let Some(path) = &args.page {
        let name = |path: &PathBuf| path.display().to_string();
        let names = [&args.model, &args.against].map(|path| path.as_ref().map_or_else(|| "built in".to_owned(), name));
        let (sections, body) = tables::page(&judged, &names)?;
        let contents = [("overview", "Overview"), ("guide", "How to read it")];
        output::write_page(path, "Two models on the same people", &contents, &sections, &body)?;
    }
    if let Some(path) = &args.json {
        output::write(path, serde_json::to_string_pretty(&tables::json(&judged))?)?;
    }
    args.csv.as_deref().map_or(Ok(()), |path| output::write(path, tables::csv(&judged)))
}

pub fn judge_fitted(name: String, samples: Vec<Sample>, appearances: Option<Appearances>, model: &Model) -> Result<()> {
    let judged = judge(&Set::of(name, samples, appearances, false)?, &[model], 1000)?;
    print!("{}", tables::text(&judged)?);
    Ok(())
}

pub fn load_model(path: Option<&Path>) -> Result<Model> {
    Ok(path.map_or_else(|| Ok(Model::embedded()), Model::load)?)
}

fn judge(set: &Set, models: &[&Model], resamples: u64) -> Result<Judged> {
    let rivals = |neutral_known| -> Result<Rivals> {
        let people = set.people(models, neutral_known)?;
        let mut judgements = people.into_iter().map(|people| Judgement::new(people, resamples));
        let model = judgements.next().context("there is a model")?;
        Ok(Rivals { model, against: judgements.next() })
    };
    Ok(Judged { set: set.name.clone(), notes: set.notes()?, neutral: [rivals(true)?, rivals(false)?] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{self, tests::test_faces};
    use crate::reference;

    fn assert_correlates(samples: &[Sample], bounds: [(bool, f64, f64); 2]) {
        let model = Model::embedded();
        for (neutral_known, least_r, most_mse) in bounds {
            let faces = Faces::new(samples, neutral_known).expect("faces");
            let scores = scores(&model, &faces, &faces.rows(true).expect("all")).expect("scores");
            let shown = || scores[..scores.len() - 1].iter();
            let [r, mse] = [0, 1].map(|figure: usize| mean(shown().map(|score| score[figure])));
            assert!(r >= least_r && mse <= most_mse, "neutral known: {neutral_known}, r {r}, MSE {mse}");
        }
    }

    #[test]
    fn the_shipped_model_correlates_on_faces_that_the_fit_never_saw() {
        assert_correlates(&test_faces(), [(true, 0.70, 0.013), (false, 0.67, 0.0145)]);
    }

    #[test]
    fn the_shipped_model_correlates_on_faces_of_another_renderer_and_tracker() {
        let Some(path) = reference::shared("dataset/train.npz") else { return };
        let samples = dataset::load(&path).expect("a dataset");
        assert_correlates(&samples, [(true, 0.67, 0.012), (false, 0.62, 0.0145)]);
    }
}
