//! Renders one subject after another and finds the landmarks in their pictures.

use std::ops::AddAssign;
use std::path::Path;

use anyhow::{Context, Result};
use facewire::capture::JpegDecoder;
use facewire_face::stages::{Detector, Mesh};
use facewire_face::{Appearance, COEFFS, Face, FaceBox, LANDMARKS, Landmarks};
use glam::Vec2;
use half::f16;
use half::slice::HalfFloatSliceExt;
use rustix::time::{ClockId, clock_gettime};

use super::assets::Assets;
use super::camera::Camera;
use super::render::Renderer;
use super::sample::{Distribution, PictureSpec, Subject};
use crate::dataset::Appearances;

/// Numbers per row: landmarks, weights, pose, meta, and the number of attempts until the face was found.
pub const ROW: usize = LANDMARKS * 3 + COEFFS + 3 + META + 1;
/// Values of the feature map per row.
pub const APPEARANCE: usize = Appearances::VALUES;
/// Numbers that describe a picture: skin, brow, eye, distance, and whether it is neutral.
pub const META: usize = 5;
/// Largest number of attempts to draw a picture in which the face is found.
const TRIES: u8 = 8;

#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rows {
    pub numbers: Vec<f32>,
    pub appearance: Vec<f16>,
}

pub struct Setup<'a> {
    pub assets: &'a Assets,
    pub distribution: &'a Distribution,
    pub size: [usize; 2],
    pub seed: u64,
}

pub struct Worker<'a> {
    setup: &'a Setup<'a>,
    imager: Imager,
    finder: Finder,
    tracking_s: f64,
}

impl<'a> Worker<'a> {
    pub fn new(setup: &'a Setup<'a>) -> Result<Self> {
        let size = setup.size;
        Ok(Self { setup, imager: Imager::new(size, 1.0)?, finder: Finder::load(size)?, tracking_s: 0.0 })
    }

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

// Finds the landmarks in a JPEG image by facewire's own detector and mesh.
//
// The first region comes from the detector. As in tracking, further regions are derived from the landmarks found.

/// Number of times the region is derived from the landmarks.
const REFINEMENTS: usize = 1;
/// Landmarks at the outer eye corners: the person's right, then left.
const EYE_CORNERS: [usize; 2] = [33, 263];
/// Largest error of an eye corner, relative to the distance of both, before the landmarks count as another object's.
const ASTRAY: f32 = 0.3;

pub struct Finder {
    decoder: JpegDecoder,
    detector: Detector,
    mesh: Mesh,
}

impl Finder {
    pub fn load([width, height]: [usize; 2]) -> Result<Self> {
        let engine = facewire_face::engine(facewire_face::EngineChoice::Auto, "", 1)?;
        Ok(Self {
            decoder: JpegDecoder::new(width, height)?,
            detector: Detector::load(engine.as_ref())?,
            mesh: Mesh::load(engine.as_ref())?,
        })
    }

    /// Finds the face whose outer eye corners are at `eyes`. Returns `None` if it is not found.
    pub fn find(&mut self, jpeg: &[u8], eyes: [Vec2; 2]) -> Result<Option<Face<'_>>> {
        self.decoder.decode(jpeg)?;
        let picture = self.decoder.picture().context("the image was not decoded")?;
        let mut region = self.detector.find(&picture)?;
        for _ in 0..REFINEMENTS {
            let Some(around) = region else { return Ok(None) };
            region = self.mesh.find(&picture, &around)?.and_then(FaceBox::following);
        }
        let Some(around) = region else { return Ok(None) };
        let is_this = |landmarks: &Landmarks| FaceBox::following(landmarks).is_some() && agrees(landmarks, eyes);
        let is_found = self.mesh.find(&picture, &around)?.is_some_and(is_this);
        Ok(is_found.then(|| self.mesh.face()))
    }
}

fn agrees(landmarks: &Landmarks, eyes: [Vec2; 2]) -> bool {
    let distance = (eyes[0] - eyes[1]).length();
    let off = |(index, eye): (usize, Vec2)| {
        let [x, y, _] = landmarks.0[index];
        (Vec2::new(x, y) - eye).length()
    };
    EYE_CORNERS.into_iter().zip(eyes).all(|pair| off(pair) < ASTRAY * distance)
}

#[derive(Debug, Clone, Copy, Default)]
pub struct Times {
    pub render: f64,
    pub camera: f64,
    pub tracking: f64,
}

impl AddAssign for Times {
    fn add_assign(&mut self, other: Self) {
        self.render += other.render;
        self.camera += other.camera;
        self.tracking += other.tracking;
    }
}

pub struct Imager {
    width: usize,
    renderer: Renderer,
    camera: Camera,
    pixels: Vec<[f32; 3]>,
    pub times: Times,
}

impl Imager {
    /// Allocates all buffers. Pictures have at least `least_density` samples per side of a pixel.
    pub fn new(size: [usize; 2], least_density: f32) -> Result<Self> {
        let pixels = vec![[0.0; 3]; size[0] * size[1]];
        let (renderer, camera) = (Renderer::new(size, least_density), Camera::new(size)?);
        Ok(Self { width: size[0], renderer, camera, pixels, times: Times::default() })
    }

    pub fn take_picture(&mut self, assets: &Assets, subject: &mut Subject, spec: &PictureSpec) -> Result<Vec<u8>> {
        let start = thread_time_s();
        subject.backdrop().fill(self.width, &mut self.pixels);
        self.renderer.draw(assets, &subject.person, &spec.scene, &mut self.pixels);
        let drawn = thread_time_s();
        let jpeg = self.camera.capture(&mut self.pixels, &spec.effects, subject.rng())?;
        self.times += Times { render: drawn - start, camera: thread_time_s() - drawn, tracking: 0.0 };
        Ok(jpeg)
    }

    /// Returns the pixel positions of the outer eye corners in the last picture: the person's right, then left.
    pub fn eye_corners(&self, assets: &Assets) -> [Vec2; 2] {
        self.renderer.eye_corners(assets)
    }
}

pub fn thread_time_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn landmarks_of_another_object_are_refused() {
        let mut landmarks = Landmarks::zero();
        landmarks.0[33] = [100.0, 50.0, 0.0];
        landmarks.0[263] = [160.0, 50.0, 0.0];
        let eyes = [Vec2::new(102.0, 52.0), Vec2::new(158.0, 49.0)];
        assert!(agrees(&landmarks, eyes));
        assert!(!agrees(&landmarks, eyes.map(|eye| eye + 30.0)));
        assert!(!agrees(&landmarks, [eyes[1], eyes[0]]));
    }
}
