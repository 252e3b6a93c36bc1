//! Renders one subject after another and finds the landmarks in their pictures.

use std::path::Path;

use anyhow::{Context, Result};
use facewire::capture::JpegDecoder;
use facewire_face::stages::{Block, Detector, Mesh, Mouth};
use facewire_face::{COEFFS, Face, FaceBox, LANDMARKS, Landmarks};
use glam::Vec2;
use half::f16;
use nalgebra::{Vector3, vector};
use rustix::time::{ClockId, clock_gettime};

use super::assets::Assets;
use super::camera::Camera;
use super::render::Renderer;
use super::sample::{Distribution, PictureSpec, Subject};
use super::visible::REGIONS;
use crate::dataset::Appearances;

/// Numbers per row: landmarks, weights, pose, meta, visibility, and the number of attempts until the face was found.
pub const ROW: usize = LANDMARKS * 3 + COEFFS + 3 + META + REGIONS + 1;
pub const APPEARANCE: usize = Appearances::ROW;
/// Numbers that describe a picture: skin, brow, eye, distance, and whether it is neutral.
pub const META: usize = 5;
/// Largest number of attempts to draw a picture in which the face is found.
const TRIES: u8 = 8;

#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rows {
    pub numbers: Vec<f32>,
    pub appearance: Vec<f16>,
}

pub struct Worker<'a> {
    assets: &'a Assets,
    distribution: &'a Distribution,
    size: [usize; 2],
    seed: u64,
    imager: Imager,
    finder: Finder,
}

impl<'a> Worker<'a> {
    pub fn new(assets: &'a Assets, distribution: &'a Distribution, size: [usize; 2], seed: u64) -> Result<Self> {
        let (imager, finder) = (Imager::new(size, 1.0)?, Finder::load(size)?);
        Ok(Self { assets, distribution, size, seed, imager, finder })
    }

    pub fn times(&self) -> Times {
        self.imager.times
    }

    /// Renders a subject and returns the rows of its pictures, the neutral picture first. If no face is found in the
    /// neutral picture, there are no rows. `saved` is a folder and how many of the first pictures to save there.
    pub fn subject(&mut self, number: u64, pictures: usize, saved: Option<(&Path, usize)>) -> Result<Rows> {
        let variety = &self.distribution.variety;
        let mut subject = Subject::random(self.assets, variety, self.size, [self.seed, number]);
        let mut rows = Rows::default();
        for picture in 0..pictures {
            subject.begin(picture as u64);
            let jpeg = self.picture(&mut subject, picture == 0, &mut rows)?;
            if jpeg.is_none() && picture == 0 {
                break;
            }
            let folder = saved.filter(|(_, count)| picture < *count).map(|(folder, _)| folder);
            if let (Some(jpeg), Some(folder)) = (jpeg, folder) {
                let path = folder.join(format!("{number:05}-{picture:02}.jpg"));
                std::fs::write(&path, jpeg).with_context(|| format!("cannot write {}", path.display()))?;
            }
        }
        Ok(rows)
    }

    fn picture(&mut self, subject: &mut Subject, neutral: bool, rows: &mut Rows) -> Result<Option<Vec<u8>>> {
        for tries in 1..=TRIES {
            let spec = subject.random_spec(self.assets, self.distribution, neutral);
            let jpeg = self.imager.take_picture(self.assets, subject, &spec)?;
            let start = thread_time_s();
            let seen = Seen::of(&self.imager.renderer, self.assets);
            let found = self.finder.find(&jpeg, &seen)?;
            self.imager.times[2] += thread_time_s() - start;
            if let Some(face) = found {
                rows.numbers.extend(row(face.landmarks.0.as_flattened(), subject, &spec, (&seen, tries)));
                let skin = face.appearance.iter().flat_map(|appearance| appearance.skin.as_flattened());
                rows.appearance.extend(skin.map(|value| f16::from_f32(*value)));
                let eyes = self.finder.mesh.eyes.pictures.as_flattened();
                let mouth = self.finder.mouth.picture.iter();
                rows.appearance.extend(eyes.iter().chain(mouth).map(|pixel| f16::from_f32(*pixel)));
                return Ok(Some(jpeg));
            }
        }
        Ok(None)
    }
}

fn row(landmarks: &[f32], subject: &Subject, spec: &PictureSpec, (seen, tries): (&Seen, u8)) -> Vec<f32> {
    let looks = &subject.person.looks;
    let numbers = [looks.skin, looks.brow, looks.eye].map(|number| number as f32);
    let meta = [subject.distance, f32::from(spec.neutral)];
    let labels = spec.scene.weights.iter().chain(&spec.scene.placement.angles_deg);
    let meta = numbers.iter().chain(&meta).chain(&seen.visible);
    landmarks.iter().chain(labels).chain(meta).chain([&f32::from(tries)]).copied().collect()
}

// Finds the landmarks in a JPEG image by facewire's own detector and mesh.
//
// The first region comes from the detector. As in tracking, the second is derived from the landmarks found.

/// Landmarks at the outer corners of the eyes and at those of the mouth: the person's right, then left.
const EYE_CORNERS: [usize; 2] = [33, 263];
const MOUTH_CORNERS: [usize; 2] = [61, 291];
/// Largest error of a corner, relative to the distance between those of the eyes, before the landmarks count as another
/// object's.
const ASTRAY: f32 = 0.3;
/// The visibility from which on a region tells whether the landmarks are the face's.
const IN_VIEW: f32 = 0.5;

/// What a picture shows: corners of eyes and mouth in pixels, and which share of each region is in view.
pub struct Seen {
    pub eyes: [Vec2; 2],
    pub mouth: [Vec2; 2],
    pub visible: [f32; REGIONS],
}

impl Seen {
    fn of(renderer: &Renderer, assets: &Assets) -> Self {
        Self {
            eyes: renderer.eye_corners(assets),
            mouth: renderer.mouth_corners(assets),
            visible: renderer.visible(assets),
        }
    }

    /// Whether these are the landmarks of the face, by the corners of its eyes and of its mouth that are in view.
    pub fn agrees(&self, landmarks: &Landmarks) -> bool {
        let [left, right, _, mouth, _] = self.visible;
        let most_off = ASTRAY * (self.eyes[0] - self.eyes[1]).length();
        let is_near = |(index, corner): (usize, Vec2)| {
            let [x, y, _] = landmarks.0[index];
            (Vec2::new(x, y) - corner).length() < most_off
        };
        let corners = EYE_CORNERS.into_iter().zip(self.eyes).chain(MOUTH_CORNERS.into_iter().zip(self.mouth));
        let in_view = corners.zip([right, left, mouth, mouth]).filter(|(_, visible)| *visible >= IN_VIEW);
        let mut in_view = in_view.map(|(corner, _)| corner).peekable();
        in_view.peek().is_some() && in_view.all(is_near)
    }
}

struct Finder {
    decoder: JpegDecoder,
    detector: Detector,
    mesh: Mesh,
    /// The mesh looks at the mouth only while the eyes are covered.
    mouth: Mouth,
    block: Block,
}

impl Finder {
    fn load([width, height]: [usize; 2]) -> Result<Self> {
        let engine = facewire_face::engine(facewire_face::EngineChoice::Auto, "", 1)?;
        Ok(Self {
            decoder: JpegDecoder::new(width, height)?,
            detector: Detector::load(engine.as_ref())?,
            mesh: Mesh::load(engine.as_ref())?,
            mouth: Mouth::load()?,
            block: Block::default(),
        })
    }

    /// Finds the face that is seen. Returns `None` if it is not found.
    fn find(&mut self, jpeg: &[u8], seen: &Seen) -> Result<Option<Face<'_>>> {
        self.decoder.decode(jpeg)?;
        let picture = self.decoder.picture().context("the image was not decoded")?;
        let mut region = self.detector.find(&picture)?;
        if let Some(around) = region {
            region = self.mesh.find(&picture, &around)?.and_then(FaceBox::following);
        }
        let Some(around) = region else { return Ok(None) };
        let is_this = |landmarks: &Landmarks| FaceBox::following(landmarks).is_some() && seen.agrees(landmarks);
        let found = self.mesh.find(&picture, &around)?.filter(|landmarks| is_this(landmarks));
        let Some(landmarks) = found else { return Ok(None) };
        self.mouth.look(&picture, &around, landmarks, &mut self.block);
        Ok(Some(self.mesh.face()))
    }
}

/// Seconds of computing for rendering, for the camera and JPEG, and for finding landmarks.
pub type Times = Vector3<f64>;

pub struct Imager {
    width: usize,
    renderer: Renderer,
    camera: Camera,
    pixels: Vec<[f32; 3]>,
    pub times: Times,
}

impl Imager {
    pub fn new(size: [usize; 2], least_density: f32) -> Result<Self> {
        let pixels = vec![[0.0; 3]; size[0] * size[1]];
        let (renderer, camera) = (Renderer::new(size, least_density), Camera::new(size)?);
        Ok(Self { width: size[0], renderer, camera, pixels, times: Times::zeros() })
    }

    pub fn take_picture(&mut self, assets: &Assets, subject: &mut Subject, spec: &PictureSpec) -> Result<Vec<u8>> {
        let start = thread_time_s();
        subject.backdrop.fill(self.width, &mut self.pixels);
        self.renderer.draw(assets, &subject.person, &spec.scene, &mut self.pixels);
        let drawn = thread_time_s();
        let jpeg = self.camera.capture(&mut self.pixels, &spec.effects, &mut subject.rng)?;
        self.times += vector![drawn - start, thread_time_s() - drawn, 0.0];
        Ok(jpeg)
    }
}

fn thread_time_s() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}
