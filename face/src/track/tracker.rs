//! Follows one face from frame to frame.
//!
//! The region of interest comes from the landmarks of the previous frame. The detector runs only if there is no region.

use crate::infer::{Engine, InferError};
use crate::picture::Picture;

use super::detector::Detector;
use super::landmarks::{Face, Landmarks};
use super::mesh::Mesh;
use super::region::FaceBox;

/// The networks, and the region of the face that they follow.
pub struct Tracker {
    detector: Detector,
    mesh: Mesh,
    region: Option<FaceBox>,
}

impl Tracker {
    /// Loads all networks.
    pub fn load(engine: &dyn Engine) -> Result<Self, InferError> {
        Ok(Self { detector: Detector::load(engine)?, mesh: Mesh::load(engine)?, region: None })
    }

    /// Returns the region of this picture to search for landmarks: around the landmarks of the previous picture, or where
    /// the detector finds a face. Returns `None` if it finds no face.
    pub fn detect(&mut self, picture: &Picture) -> Result<Option<FaceBox>, InferError> {
        if self.region.is_none() {
            self.region = self.detector.find(picture)?;
            self.mesh.begin();
        }
        Ok(self.region)
    }

    /// Returns the landmarks of the face in `region`, in pixels of the picture. If there is no face, returns `None` and
    /// forgets the region, so that the detector searches the next picture.
    pub fn landmarks(&mut self, picture: &Picture, region: &FaceBox) -> Result<Option<&Landmarks>, InferError> {
        // If a network fails, the landmarks are half written: there is no face then.
        self.region = None;
        let found = self.mesh.find(picture, region)?;
        self.region = found.and_then(FaceBox::following);
        Ok(found)
    }

    /// The face in the last picture, if there was one.
    pub fn face(&self) -> Option<Face<'_>> {
        self.region.and(Some(self.mesh.face()))
    }

    /// Sets whether the heads of the mesh take turns ([`Mesh`]).
    pub fn set_turns(&mut self, by_turns: bool) {
        self.mesh.set_turns(by_turns);
    }

    /// Forgets the region, so that the detector searches the next picture.
    pub fn forget(&mut self) {
        self.region = None;
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

    use super::*;
    use crate::picture::Pixels;
    use crate::testing::{Scripted, face, show};

    const WIDTH: usize = 192;

    /// A picture of the size of the mesh's input: a region that covers it does not change coordinates.
    fn picture() -> Picture<'static> {
        static GREY: [u8; WIDTH * WIDTH] = [128; WIDTH * WIDTH];
        let pixels = Pixels::Grey { data: &GREY, stride: WIDTH };
        Picture::new(WIDTH, WIDTH, pixels, true).expect("a whole picture")
    }

    /// A tracker whose detector finds a face from its second run on, and the number of runs of the detector.
    fn tracker() -> (Tracker, Arc<AtomicUsize>) {
        let runs = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&runs);
        let engine = Scripted::new(move |mut run| {
            let is_first = run.network == "detector" && counted.fetch_add(1, Relaxed) == 0;
            if !is_first {
                show(&mut run, &face([0.0; 3], 60.0, [96.0, 80.0]));
            }
            Ok(())
        });
        (Tracker::load(&engine).expect("scripted networks"), runs)
    }

    #[test]
    fn the_landmarks_are_those_of_the_networks_in_the_picture() {
        let (mut tracker, _) = tracker();
        let region = FaceBox { centre: [96.0; 2], size: 192.0, angle_rad: 0.0 };
        let found = tracker.landmarks(&picture(), &region).expect("a run").expect("a face").clone();
        let shown = face([0.0; 3], 60.0, [96.0, 80.0]);
        for (index, (found, shown)) in found.0.iter().zip(&shown.0).enumerate().take(super::super::MESH) {
            for (found, shown) in found.iter().zip(shown) {
                assert!((found - shown).abs() < 1e-3, "landmark {index}: {found} in place of {shown}");
            }
        }
    }

    #[test]
    fn after_a_network_failed_there_is_no_face_until_the_next_picture() {
        let pictures = AtomicUsize::new(0);
        let engine = Scripted::new(move |mut run| {
            show(&mut run, &face([0.0; 3], 60.0, [96.0, 80.0]));
            let picture = pictures.fetch_add(usize::from(run.network == "mesh"), Relaxed);
            if run.network == "lips" && picture == 2 { Err("no memory") } else { Ok(()) }
        });
        let mut tracker = Tracker::load(&engine).expect("scripted networks");
        let mut follow = || -> Result<bool, InferError> {
            let region = tracker.detect(&picture())?.expect("a face");
            let outcome = tracker.landmarks(&picture(), &region).map(drop);
            assert_eq!(tracker.face().is_some(), outcome.is_ok());
            outcome.map(|()| true)
        };
        assert!(follow().is_ok());
        let failure = follow().expect_err("no memory").to_string();
        assert!(failure.starts_with("network lips failed to run (no memory); "), "{failure}");
        assert!(follow().is_ok());
    }

    #[test]
    fn the_detector_runs_until_it_finds_a_face_and_not_while_that_face_is_followed() {
        let (mut tracker, detector_runs) = tracker();
        assert_eq!(tracker.detect(&picture()).expect("a run"), None);
        for _ in 0..3 {
            let region = tracker.detect(&picture()).expect("a run").expect("a face");
            assert!(tracker.landmarks(&picture(), &region).expect("a run").is_some());
        }
        assert_eq!(detector_runs.load(Relaxed), 2);
        tracker.forget();
        assert!(tracker.detect(&picture()).expect("a run").is_some());
        assert_eq!(detector_runs.load(Relaxed), 3);
    }
}
