//! The sets that a model is judged on.

use std::{collections::BTreeMap, path::Path};

use anyhow::Result;
use facewire::solve::{COEFFS, Model};
use rayon::prelude::*;

use super::{
    Faces,
    clips::{self, Clip},
    estimates,
    people::{self, Person},
    pose_error_deg,
};
use crate::dataset::{self, Appearances, Sample};

/// A set of people with truth.
pub struct Set {
    /// The name of the file or folder.
    pub name: String,
    content: Content,
}

enum Content {
    /// Single pictures of each person, and the look of the faces if that is known.
    Pictures(Vec<Sample>, Option<Appearances>),
    /// A clip of each person.
    Clips(Vec<Clip>),
}

/// Results of the regression with the truth: for each picture of a person a pair of all blendshapes.
pub type RawFaces = Vec<([f32; COEFFS], [f64; COEFFS])>;

/// Which part of a set counts, and where its neutral faces are.
#[derive(Debug, Clone, Copy)]
pub struct SetOptions {
    /// Judge on all subjects of a dataset, not only the held-out ones.
    pub all_subjects: bool,
    /// Number of frames at the start of each clip in which the face is at rest.
    pub neutral_frames: u32,
}

impl Set {
    /// Loads a dataset, or a folder of clips.
    pub fn load(path: &Path, options: SetOptions) -> Result<Self> {
        let name = path.display().to_string();
        if path.is_dir() {
            return Ok(Self { name, content: Content::Clips(clips::load(path, options.neutral_frames)?) });
        }
        let samples = dataset::load(path)?;
        let appearances = dataset::load_appearances(&[path], samples.len())?;
        Self::of(name, samples, appearances, options.all_subjects)
    }

    /// Returns a set of the samples of a dataset, with the look of the faces if that is known.
    pub fn of(
        name: String,
        mut samples: Vec<Sample>,
        appearances: Option<Appearances>,
        all_subjects: bool,
    ) -> Result<Self> {
        if !all_subjects {
            dataset::held_out(&samples)?;
            samples.retain(Sample::held_out);
        }
        Ok(Self { name, content: Content::Pictures(samples, appearances) })
    }

    /// Runs each model on every face, relative to the person's neutral face if `neutral_known`. Returns the people by
    /// model.
    pub fn people(&self, models: &[&Model], neutral_known: bool) -> Result<Vec<Vec<Person>>> {
        match &self.content {
            Content::Pictures(samples, appearances) => {
                let faces = Faces::new(samples, neutral_known)?.with_appearances(appearances.as_ref());
                models.iter().map(|model| people_of(model, samples, &faces)).collect()
            }
            Content::Clips(clips) => {
                let solve = |model: &&Model| clips.par_iter().map(|clip| clip.person(model, neutral_known)).collect();
                Ok(models.iter().map(solve).collect())
            }
        }
    }

    /// Returns the results of the regression with the truth, person by person, relative to the neutral face if
    /// `neutral_known`.
    pub fn raw(&self, model: &Model, neutral_known: bool) -> Result<Vec<RawFaces>> {
        match &self.content {
            Content::Pictures(samples, appearances) => {
                let faces = Faces::new(samples, neutral_known)?.with_appearances(appearances.as_ref());
                let mut people: BTreeMap<usize, RawFaces> = BTreeMap::new();
                for (row, sample) in samples.iter().enumerate() {
                    people.entry(sample.subject).or_default().push((faces.raw(model, row)?.0, sample.truth));
                }
                Ok(people.into_values().collect())
            }
            Content::Clips(clips) => Ok(clips.par_iter().map(|clip| clip.raw(model, neutral_known)).collect()),
        }
    }

    /// Returns facts about the set itself in one line: the error of the head pose, or the number of frames without a
    /// face.
    pub fn notes(&self) -> Result<String> {
        match &self.content {
            Content::Pictures(samples, _) => {
                let [yaw, pitch, roll] = pose_error_deg(samples)?;
                Ok(format!("head pose, mean error: yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} degrees"))
            }
            Content::Clips(clips) => {
                let [all, faceless] = clips.iter().map(Clip::frames).fold([0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]);
                Ok(format!("no face was found in {faceless} of {all} frames"))
            }
        }
    }
}

fn people_of(model: &Model, samples: &[Sample], faces: &Faces) -> Result<Vec<Person>> {
    let estimates = estimates(model, faces, &faces.rows(true)?)?;
    let mut people: BTreeMap<usize, people::SolvedFaces> = BTreeMap::new();
    for (row, sample) in samples.iter().enumerate() {
        let person = people.entry(sample.subject).or_default();
        person.estimates.push(core::array::from_fn(|blendshape| estimates[blendshape][row]));
        person.truths.push(sample.truth);
        person.is_neutral.push(sample.neutral);
    }
    Ok(people.iter().map(|(subject, faces)| Person::new(subject.to_string(), faces, false)).collect())
}
