//! Following one face from frame to frame.
//!
//! The region of interest comes from the previous frame's landmarks; the detector runs only when there are none.

use crate::capture::Picture;
use crate::infer::{Engine, InferError};

use super::detector::Detector;
use super::landmarks::Landmarks;
use super::mesh::Mesh;
use super::region::FaceBox;

/// Detector, mesh and the face they follow.
pub struct Tracker {
    detector: Detector,
    mesh: Mesh,
    region: Option<FaceBox>,
    landmarks: Landmarks,
}

impl Tracker {
    /// Loads all networks.
    ///
    /// # Errors
    /// Those of [`Engine::load`].
    pub fn load(engine: &dyn Engine) -> Result<Self, InferError> {
        Ok(Self {
            detector: Detector::load(engine)?,
            mesh: Mesh::load(engine)?,
            region: None,
            landmarks: Landmarks::zero(),
        })
    }

    /// Where to look for the face in this picture: around the last landmarks, or where the detector sees a face.
    ///
    /// # Errors
    /// [`InferError::Run`].
    pub fn detect(&mut self, picture: &Picture) -> Result<Option<FaceBox>, InferError> {
        if self.region.is_none() {
            self.region = self.detector.find(picture)?.and_then(|detection| detection.region());
        }
        Ok(self.region)
    }

    /// The landmarks of the face in `region`, in pixels; `None` if there is no face, which ends the following.
    ///
    /// # Errors
    /// [`InferError::Run`].
    pub fn landmarks(&mut self, picture: &Picture, region: &FaceBox) -> Result<Option<&Landmarks>, InferError> {
        let found = self.mesh.find(picture, region, &mut self.landmarks)?;
        self.region = if found { FaceBox::following(&self.landmarks) } else { None };
        Ok(found.then_some(&self.landmarks))
    }

    /// Forgets the face, so that the next picture is searched as a whole.
    pub fn forget(&mut self) {
        self.region = None;
    }
}
