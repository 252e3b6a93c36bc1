//! Renders one subject after another and finds the landmarks in their pictures.

use std::path::Path;

use anyhow::{Context, Result};
use facewire::{
    face::{Appearance, LANDMARKS},
    solve::COEFFS,
};
use half::{f16, slice::HalfFloatSliceExt};

use super::{
    assets::Assets,
    finder::Finder,
    imager::{Imager, Times, thread_time_s},
    sample::{Distribution, PictureSpec, Subject},
};
use crate::dataset::Appearances;

/// Numbers per row: landmarks, weights, pose, meta, and the number of attempts until the face was found.
pub const ROW: usize = LANDMARKS * 3 + COEFFS + 3 + META + 1;
/// Values of the feature map per row.
pub const APPEARANCE: usize = Appearances::VALUES;
/// Numbers that describe a picture: skin, brow, eye, distance, and whether it is neutral.
pub const META: usize = 5;
/// Largest number of attempts to draw a picture in which the face is found.
const TRIES: u8 = 8;

/// What is known of some pictures.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rows {
    /// [`ROW`] numbers for each picture.
    pub numbers: Vec<f32>,
    /// [`APPEARANCE`] values for each picture.
    pub appearance: Vec<f16>,
}

/// The settings of all workers.
pub struct Setup<'a> {
    /// Rig and textures.
    pub assets: &'a Assets,
    /// Distribution of the pictures.
    pub distribution: &'a Distribution,
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
        Ok(Self { setup, imager: Imager::new(size, 1.0)?, finder: Finder::load(size)?, tracking_s: 0.0 })
    }

    /// Returns the CPU times so far.
    pub fn times(&self) -> Times {
        Times { tracking: self.tracking_s, ..self.imager.times }
    }

    /// Renders a subject and returns the rows of its pictures, the neutral picture first. If no face is found in the
    /// neutral picture, there are no rows. `saved` is a folder and how many of the first pictures to save there.
    pub fn subject(&mut self, number: u64, pictures: usize, saved: Option<(&Path, usize)>) -> Result<Rows> {
        let Setup { assets, distribution, size, seed } = *self.setup;
        let mut subject = Subject::random(assets, &distribution.variety, size, [seed, number]);
        let mut rows = Rows::default();
        for picture in 0..pictures {
            subject.begin(picture as u64);
            let Some(jpeg) = self.picture(&mut subject, picture == 0, &mut rows)? else {
                if picture == 0 {
                    break;
                }
                continue;
            };
            if let Some((folder, _)) = saved.filter(|(_, count)| picture < *count) {
                let path = folder.join(format!("{number:05}-{picture:02}.jpg"));
                std::fs::write(&path, jpeg).with_context(|| format!("cannot write {}", path.display()))?;
            }
        }
        Ok(rows)
    }

    /// Takes a picture in which the face is found, and adds its row.
    fn picture(&mut self, subject: &mut Subject, neutral: bool, rows: &mut Rows) -> Result<Option<Vec<u8>>> {
        for tries in 1..=TRIES {
            let spec = subject.random_spec(self.setup.distribution, neutral);
            let jpeg = self.imager.take_picture(self.setup.assets, subject, &spec)?;
            let start = thread_time_s();
            let eyes = self.imager.eye_corners(self.setup.assets);
            let found = self.finder.find(&jpeg, eyes)?;
            self.tracking_s += thread_time_s() - start;
            if let Some(face) = found {
                rows.numbers.extend(row(face.landmarks.0.as_flattened(), subject, &spec, tries));
                face.appearance.into_iter().for_each(|appearance| rows.add_appearance(appearance));
                return Ok(Some(jpeg));
            }
        }
        Ok(None)
    }
}

impl Rows {
    /// Rounds the values of a picture to half precision and adds them.
    fn add_appearance(&mut self, appearance: &Appearance) {
        let first = self.appearance.len();
        self.appearance.resize(first + APPEARANCE, f16::ZERO);
        self.appearance[first..].convert_from_f32_slice(appearance.0.as_flattened());
    }
}

fn row(landmarks: &[f32], subject: &Subject, spec: &PictureSpec, tries: u8) -> Vec<f32> {
    let looks = &subject.person.looks;
    let numbers = [looks.skin, looks.brow, looks.eye].map(|number| number as f32);
    let meta = [subject.distance, f32::from(spec.neutral), f32::from(tries)];
    let labels = spec.scene.weights.iter().chain(&spec.scene.placement.angles_deg);
    landmarks.iter().chain(labels).chain(&numbers).chain(&meta).copied().collect()
}
