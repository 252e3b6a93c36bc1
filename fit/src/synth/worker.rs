//! One subject after another: pictures taken and searched for landmarks.

use std::path::Path;

use anyhow::{Context, Result};
use facewire::{face::LANDMARKS, solve::COEFFS};

use super::{
    booth::{Booth, Times, thread_time_s},
    finder::Finder,
    kit::Kit,
    sample::{Choice, Subject, Take},
};

/// Numbers in a row: landmarks, weights, pose, meta, and how often the picture was drawn until its face was found.
pub const ROW: usize = LANDMARKS * 3 + COEFFS + 3 + META + 1;
/// Numbers that describe a picture: skin, brow, eye, distance, whether neutral.
pub const META: usize = 5;
/// A picture whose face is not found is drawn again up to this often, then left out.
const TRIES: u8 = 8;

/// What a subject's pictures are drawn from.
pub struct Studio<'a> {
    /// Rig and textures.
    pub kit: &'a Kit,
    /// What may be drawn.
    pub choice: &'a Choice<'a>,
    /// Columns and rows of the pictures.
    pub size: [usize; 2],
    /// Of all subjects.
    pub seed: u64,
}

/// Booth and networks of one thread.
pub struct Worker<'a> {
    studio: &'a Studio<'a>,
    booth: Booth,
    finder: Finder,
    tracking_s: f64,
}

impl<'a> Worker<'a> {
    /// Takes all memory and loads the networks.
    pub fn new(studio: &'a Studio<'a>) -> Result<Self> {
        let size = studio.size;
        Ok(Self { studio, booth: Booth::new(size)?, finder: Finder::load(size)?, tracking_s: 0.0 })
    }

    /// CPU time spent so far.
    pub fn times(&self) -> Times {
        Times { tracking: self.tracking_s, ..self.booth.times }
    }

    /// Rows of a subject's pictures, the neutral one first; none at all if that one is not found. The first so many
    /// are written to the folder of `saved`.
    pub fn subject(&mut self, number: u64, pictures: usize, saved: Option<(&Path, usize)>) -> Result<Vec<f32>> {
        let Studio { kit, choice, size, seed } = *self.studio;
        let mut subject = Subject::random(kit, &choice.wardrobe, size, [seed, number]);
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
            let take = subject.take(self.studio.choice, neutral);
            let jpeg = self.booth.shoot(self.studio.kit, subject, &take)?;
            let start = thread_time_s();
            let eyes = self.booth.eye_corners(self.studio.kit);
            let found = self.finder.find(&jpeg, eyes)?.cloned();
            self.tracking_s += thread_time_s() - start;
            if let Some(landmarks) = found {
                return Ok(Some((jpeg, row(landmarks.0.as_flattened(), subject, &take, tries))));
            }
        }
        Ok(None)
    }
}

fn row(landmarks: &[f32], subject: &Subject, take: &Take, tries: u8) -> Vec<f32> {
    let looks = &subject.person.looks;
    let numbers = [looks.skin, looks.brow, looks.eye].map(|number| number as f32);
    let meta = [subject.distance, f32::from(take.neutral), f32::from(tries)];
    let labels = take.shot.weights.iter().chain(&take.shot.placement.angles_deg);
    landmarks.iter().chain(labels).chain(&numbers).chain(&meta).copied().collect()
}
