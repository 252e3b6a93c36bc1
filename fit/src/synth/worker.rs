//! Renders one subject after another and finds the landmarks in their pictures.

use std::path::Path;

use anyhow::{Context, Result};
use facewire::{face::LANDMARKS, solve::COEFFS};

use super::{
    assets::Assets,
    finder::Finder,
    imager::{Imager, Times, thread_time_s},
    sample::{Distribution, PictureSpec, Subject},
};

/// Numbers per row: landmarks, weights, pose, meta, and the number of attempts until the face was found.
pub const ROW: usize = LANDMARKS * 3 + COEFFS + 3 + META + 1;
/// Numbers that describe a picture: skin, brow, eye, distance, and whether it is neutral.
pub const META: usize = 5;
/// Largest number of attempts to draw a picture in which the face is found.
const TRIES: u8 = 8;

/// The settings of all workers.
pub struct Setup<'a> {
    /// Rig and textures.
    pub assets: &'a Assets,
    /// Distribution of the pictures.
    pub distribution: &'a Distribution<'a>,
    /// Width and height of the pictures.
    pub size: [usize; 2],
    /// Seed of all subjects.
    pub seed: u64,
}

/// Renderer and networks of one thread.
pub struct Worker<'a> {
    setup: &'a Setup<'a>,
    imager: Imager,
    finder: Finder,
    tracking_s: f64,
}

impl<'a> Worker<'a> {
    /// Allocates all buffers and loads the networks.
    pub fn new(setup: &'a Setup<'a>) -> Result<Self> {
        let size = setup.size;
        Ok(Self { setup, imager: Imager::new(size)?, finder: Finder::load(size)?, tracking_s: 0.0 })
    }

    /// Returns the CPU times so far.
    pub fn times(&self) -> Times {
        Times { tracking: self.tracking_s, ..self.imager.times }
    }

    /// Renders a subject and returns the rows of its pictures, the neutral picture first. If no face is found in the
    /// neutral picture, there are no rows. `saved` is a folder and how many of the first pictures to save there.
    pub fn subject(&mut self, number: u64, pictures: usize, saved: Option<(&Path, usize)>) -> Result<Vec<f32>> {
        let Setup { assets, distribution, size, seed } = *self.setup;
        let mut subject = Subject::random(assets, &distribution.textures, size, [seed, number]);
        let mut rows = Vec::with_capacity(pictures * ROW);
        for picture in 0..pictures {
            let Some((jpeg, row)) = self.picture(&mut subject, picture == 0)? else {
                if picture == 0 {
                    break;
                }
                continue;
            };
            rows.extend(row);
            if let Some((folder, _)) = saved.filter(|(_, count)| picture < *count) {
                let path = folder.join(format!("{number:05}-{picture:02}.jpg"));
                std::fs::write(&path, jpeg).with_context(|| format!("cannot write {}", path.display()))?;
            }
        }
        Ok(rows)
    }

    fn picture(&mut self, subject: &mut Subject, neutral: bool) -> Result<Option<(Vec<u8>, Vec<f32>)>> {
        for tries in 1..=TRIES {
            let spec = subject.random_spec(self.setup.distribution, neutral);
            let jpeg = self.imager.take_picture(self.setup.assets, subject, &spec)?;
            let start = thread_time_s();
            let eyes = self.imager.eye_corners(self.setup.assets);
            let found = self.finder.find(&jpeg, eyes)?.cloned();
            self.tracking_s += thread_time_s() - start;
            if let Some(landmarks) = found {
                return Ok(Some((jpeg, row(landmarks.0.as_flattened(), subject, &spec, tries))));
            }
        }
        Ok(None)
    }
}

fn row(landmarks: &[f32], subject: &Subject, spec: &PictureSpec, tries: u8) -> Vec<f32> {
    let looks = &subject.person.looks;
    let numbers = [looks.skin, looks.brow, looks.eye].map(|number| number as f32);
    let meta = [subject.distance, f32::from(spec.neutral), f32::from(tries)];
    let labels = spec.scene.weights.iter().chain(&spec.scene.placement.angles_deg);
    landmarks.iter().chain(labels).chain(&numbers).chain(&meta).copied().collect()
}
