//! Finds a face in a picture, follows it from frame to frame and returns its landmarks. The region of interest comes
//! from the landmarks of the previous frame. The detector runs only if there is no region.

mod block;
mod crop;
mod detector;
mod eyes;
pub(crate) mod feature_map;
mod grey;
mod landmarks;
mod mesh;
mod parts;
pub(crate) mod refinement;
pub(crate) mod visible;

use std::f32::consts::FRAC_PI_4;

use crate::infer::{Engine, InferError};
use crate::picture::Picture;

pub use block::Block;
pub use crop::{Border, CropShape, Rows, crop};
pub use detector::Detector;
pub use eyes::{EYE_SIDE, EyeValues, Eyes};
pub use feature_map::bounds;
pub use landmarks::{Appearance, Face, FaceBox, LANDMARKS, Landmarks, MESH};
pub use mesh::Mesh;
pub use parts::{PART_SIDE, PartValues, Parts};
pub use visible::{InView, Visible};

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

    /// Returns the region to search: around the landmarks of the previous picture, or where the detector finds a face.
    pub fn detect(&mut self, picture: &Picture) -> Result<Option<FaceBox>, InferError> {
        if self.region.is_none() {
            self.region = self.detector.find(picture, &[])?;
            self.mesh.turn = None;
        }
        Ok(self.region)
    }

    /// Returns the landmarks of the face in `region`, in pixels of the picture. If there is none, forgets the region.
    pub fn landmarks(&mut self, picture: &Picture, region: &FaceBox) -> Result<Option<&Landmarks>, InferError> {
        // If a network fails, the landmarks are half written: there is no face then.
        self.region = None;
        let found = self.mesh.find(picture, region)?;
        self.region = found.and_then(FaceBox::following);
        Ok(found)
    }

    /// Searches the picture for a face that stands upright, and returns its [`score`](Appearance::score), or 0 if there is
    /// none. The face that is followed stays as it is.
    pub fn upright_score(&mut self, picture: &Picture) -> Result<f32, InferError> {
        let Some(detected) = self.detector.find(picture, &[])? else { return Ok(0.0) };
        // The mesh sees the detector's region tilted and off the middle, so that it doubts the face at first.
        let Some((_, region)) = self.mesh.look(picture, &detected)? else { return Ok(0.0) };
        let seen = self.mesh.look(picture, &region)?;
        let upright = seen.filter(|(_, region)| region.angle_rad.abs() < FRAC_PI_4);
        Ok(upright.map_or(0.0, |(score, _)| score))
    }

    /// The face in the last picture, if there was one.
    pub fn face(&self) -> Option<Face<'_>> {
        self.region.and(Some(self.mesh.face()))
    }

    /// Sets whether the heads of the mesh take turns ([`Mesh`]).
    pub fn set_turns(&mut self, by_turns: bool) {
        self.mesh.by_turns = by_turns;
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
    use crate::testing::{Run, Scripted, face, show};

    const WIDTH: usize = 192;
    const NETWORKS: [&str; 5] = ["detector", "mesh", "lips", "left_eye", "right_eye"];

    /// A picture of the size of the mesh's input: a region that covers it does not change coordinates.
    fn picture() -> Picture<'static> {
        static GREY: [u8; WIDTH * WIDTH] = [128; WIDTH * WIDTH];
        Picture::new(WIDTH, WIDTH, Pixels::Grey { data: &GREY, stride: WIDTH }, true).expect("a whole picture")
    }

    /// A tracker whose networks show a face, unless `alter` changes it or refuses a network's run of this number, and how
    /// often each of [`NETWORKS`] has run.
    fn tracker(
        alter: impl Fn(&mut Run, usize) -> Result<(), &'static str> + Send + Sync + 'static,
    ) -> (Tracker, Arc<[AtomicUsize; 5]>) {
        let runs: Arc<[AtomicUsize; 5]> = Arc::default();
        let counted = Arc::clone(&runs);
        let engine = Scripted::new(move |mut run| {
            let network = NETWORKS.iter().position(|name| *name == run.network).expect("a known network");
            show(&mut run, &face([0.0; 3], 60.0, [110.0, 70.0]));
            alter(&mut run, counted[network].fetch_add(1, Relaxed))
        });
        (Tracker::load(&engine).expect("scripted networks"), runs)
    }

    /// A region that covers the picture.
    const WHOLE: FaceBox = FaceBox { centre: [96.0; 2], size: 192.0, angle_rad: 0.0 };

    /// Finds the face in the next picture.
    fn follow(tracker: &mut Tracker) -> Result<Option<Landmarks>, String> {
        tracker.detect(&picture()).expect("a run").expect("a face");
        let outcome = tracker.landmarks(&picture(), &WHOLE).map(Option::<&Landmarks>::cloned);
        assert_eq!(tracker.face().is_some(), matches!(outcome, Ok(Some(_))));
        outcome.map_err(|error| error.to_string())
    }

    #[test]
    fn after_a_network_failed_there_is_no_face_until_the_next_picture() {
        let fails =
            |run: &mut Run, number| if run.network == "lips" && number == 2 { Err("no memory") } else { Ok(()) };
        let (mut tracker, _) = tracker(fails);
        assert!(follow(&mut tracker).is_ok() && follow(&mut tracker).is_ok());
        let failure = follow(&mut tracker).expect_err("no memory");
        assert!(failure.starts_with("network lips failed to run (no memory); "), "{failure}");
        assert!(follow(&mut tracker).is_ok());
    }

    #[test]
    fn the_detector_runs_until_it_finds_a_face_and_not_while_that_face_is_followed() {
        let (mut tracker, runs) = tracker(|run, number| {
            if run.network == "detector" && number == 0 {
                run.outputs[1].fill(-9.0);
            }
            Ok(())
        });
        assert_eq!(tracker.detect(&picture()).expect("a run"), None);
        for _ in 0..3 {
            assert!(follow(&mut tracker).is_ok_and(|found| found.is_some()));
        }
        assert_eq!(runs[0].load(Relaxed), 2);
        tracker.forget();
        assert!(tracker.detect(&picture()).expect("a run").is_some());
        assert_eq!(runs[0].load(Relaxed), 3);
    }

    #[test]
    fn heads_by_turns_run_one_at_a_time_and_all_at_once_on_another_face() {
        let (mut tracker, runs) = tracker(|_, _| Ok(()));
        tracker.set_turns(true);
        let first = follow(&mut tracker).expect("a run").expect("a face");
        for (picture, wanted) in [[2, 2, 1, 1], [3, 2, 2, 1], [4, 2, 2, 2], [5, 3, 2, 2]].into_iter().enumerate() {
            let next = follow(&mut tracker).expect("a run").expect("a face");
            for (next, first) in next.0.iter().flatten().zip(first.0.iter().flatten()) {
                assert!((next - first).abs() < 1e-2, "a face that rests: {next} instead of {first}");
            }
            assert_eq!([1, 2, 3, 4].map(|network| runs[network].load(Relaxed)), wanted, "{picture}");
        }
        tracker.forget();
        follow(&mut tracker).expect("a run").expect("a face");
        assert_eq!([1, 2, 3, 4].map(|network| runs[network].load(Relaxed)), [6, 4, 3, 3]);
    }

    #[test]
    fn a_flag_below_one_half_or_a_number_that_is_not_finite_in_any_output_is_not_a_face() {
        let cases = [
            ("mesh", 1, 0.01, true),
            ("mesh", 1, -0.01, false),
            ("mesh", 1, f32::NAN, false),
            ("mesh", 0, f32::NAN, false),
            ("lips", 0, f32::INFINITY, false),
            ("left_eye", 1, f32::NAN, false),
        ];
        for (network, output, value, is_face) in cases {
            let (mut tracker, _) = tracker(move |run, _| {
                if run.network == network {
                    *run.outputs[output].last_mut().expect("values") = value;
                }
                Ok(())
            });
            let found = follow(&mut tracker).expect("a run").is_some();
            assert_eq!(found, is_face, "{value} in output {output} of {network}");
        }
    }
}
