//! Finds the landmarks in a JPEG image by facewire's own detector and mesh.
//!
//! The first region comes from the detector. As in tracking, further regions are derived from the landmarks found.

use anyhow::{Context, Result};
use facewire::{
    capture::JpegDecoder,
    config::NetworkSettings,
    face::{Detector, Face, FaceBox, Landmarks, Mesh},
};
use glam::Vec2;

/// Number of times the region is derived from the landmarks.
const REFINEMENTS: usize = 1;
/// Landmarks at the outer eye corners: the person's right, then left.
const EYE_CORNERS: [usize; 2] = [33, 263];
/// Largest error of an eye corner, relative to the distance of both, before the landmarks count as another object's.
const ASTRAY: f32 = 0.3;

/// JPEG decoder and networks, each on one thread.
pub struct Finder {
    decoder: JpegDecoder,
    detector: Detector,
    mesh: Mesh,
}

impl Finder {
    /// Loads the networks for pictures of `size`.
    pub fn load([width, height]: [usize; 2]) -> Result<Self> {
        let engine = facewire::infer::engine(&NetworkSettings::default())?;
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
