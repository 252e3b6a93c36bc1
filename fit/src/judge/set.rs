//! The sets that a model is judged on.

use std::{collections::BTreeMap, path::Path};

use anyhow::Result;
use facewire::solve::Model;

use super::{
    Faces, estimates,
    people::{self, Person},
    pose_error_deg,
};
use crate::dataset::{self, Sample};

/// A set of people with truth: single pictures of each person.
pub struct Set {
    /// The name of the file.
    pub name: String,
    samples: Vec<Sample>,
}

impl Set {
    /// Loads a dataset. Only the held-out subjects count, or all of them if `all_subjects`.
    pub fn load(path: &Path, all_subjects: bool) -> Result<Self> {
        Self::of(path.display().to_string(), dataset::load(path)?, all_subjects)
    }

    /// Returns a set of the samples of a dataset.
    pub fn of(name: String, mut samples: Vec<Sample>, all_subjects: bool) -> Result<Self> {
        if !all_subjects {
            dataset::held_out(&samples)?;
            samples.retain(Sample::held_out);
        }
        Ok(Self { name, samples })
    }

    /// Runs each model on every face, relative to the person's neutral face if `neutral_known`. Returns the people by
    /// model.
    pub fn people(&self, models: &[&Model], neutral_known: bool) -> Result<Vec<Vec<Person>>> {
        let faces = Faces::new(&self.samples, neutral_known)?;
        models.iter().map(|model| people_of(model, &self.samples, &faces)).collect()
    }

    /// Returns what else there is to know of the set, in one line.
    pub fn notes(&self) -> Result<String> {
        let [yaw, pitch, roll] = pose_error_deg(&self.samples)?;
        Ok(format!("head pose, mean error: yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} degrees"))
    }
}

fn people_of(model: &Model, samples: &[Sample], faces: &Faces) -> Result<Vec<Person>> {
    let estimates = estimates(model, faces, &faces.rows(true)?)?;
    let mut people: BTreeMap<usize, people::Faces> = BTreeMap::new();
    for (row, sample) in samples.iter().enumerate() {
        let person = people.entry(sample.subject).or_default();
        person.estimates.push(core::array::from_fn(|blendshape| estimates[blendshape][row]));
        person.truths.push(sample.truth);
        person.is_neutral.push(sample.neutral);
    }
    Ok(people.iter().map(|(subject, faces)| Person::new(subject.to_string(), faces, false)).collect())
}
