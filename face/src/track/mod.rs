//! Finds a face in a picture, follows it from frame to frame and returns its landmarks. The region of interest comes from the
//! landmarks of the previous frame. The detector runs if there is no region, and now and then while it is not sure that the
//! face is the wearer's.

mod block;
mod crop;
mod detector;
mod eyes;
pub(crate) mod feature_map;
mod grey;
mod landmarks;
mod mesh;
mod mouth;
pub(crate) mod refinement;
pub(crate) mod visible;
mod wearer;

use std::f32::consts::FRAC_PI_4;

use crate::infer::{Engine, InferError};
use crate::picture::Picture;
use crate::solve::Wears;

pub use block::Block;
pub use crop::{Border, CropShape, Rows, crop};
pub use detector::Detector;
pub use eyes::{EYE_SIDE, EyeValues, Eyes};
pub use feature_map::bounds;
pub use landmarks::{Appearance, Face, FaceBox, LANDMARKS, Landmarks, Looks, MESH};
pub use mesh::Mesh;
pub use mouth::{MOUTH_SIDE, MOUTH_VALUES, Mouth, MouthValues};
pub use visible::{InView, Visible};
use wearer::Verdict;
pub use wearer::{Follow, Wearer};

/// While it is watched whether the wearer appears, one picture in this many is searched. While the wearer is looked for among
/// others, it is one in the second number.
const WATCH_EVERY: u32 = 10;
const SEARCH_EVERY: u32 = 3;
/// Longest time from one picture to the next that counts, seconds.
const LONGEST_STEP_S: f32 = 1.0;

/// The networks, the region of the face that they follow, and whose face it is.
pub struct Tracker {
    detector: Detector,
    mesh: Mesh,
    region: Option<FaceBox>,
    wearer: Wearer,
    /// Whether the face in the region is the wearer's, rather than one that may be.
    is_wearer: bool,
    time_us: Option<u64>,
    step_s: f32,
    since_search: u32,
}

impl Tracker {
    /// Loads all networks.
    pub fn load(engine: &dyn Engine) -> Result<Self, InferError> {
        Ok(Self {
            detector: Detector::load(engine)?,
            mesh: Mesh::load(engine)?,
            region: None,
            wearer: Wearer::default(),
            is_wearer: false,
            time_us: None,
            step_s: 0.0,
            since_search: 0,
        })
    }

    /// Returns the region to search of a picture that was taken at `time_us`: around the landmarks of the previous picture, or
    /// where the detector finds the face to follow.
    pub fn detect(&mut self, picture: &Picture, time_us: u64) -> Result<Option<FaceBox>, InferError> {
        let step_us = self.time_us.replace(time_us).and_then(|last_us| time_us.checked_sub(last_us));
        self.step_s = step_us.map_or(0.0, |step_us| step_us as f32 / 1e6).min(LONGEST_STEP_S);
        self.since_search = self.since_search.saturating_add(1);
        if !self.is_wearer {
            self.wearer.miss(self.step_s);
        }
        let size_px = picture.size_px();
        let every = match self.region {
            Some(_) if !self.wearer.is_watched() => return Ok(self.region),
            Some(_) => WATCH_EVERY,
            None if self.wearer.is_wary => SEARCH_EVERY,
            None => 1,
        };
        if self.since_search < every {
            return Ok(self.region);
        }
        self.since_search = 0;
        let faces = self.detector.find_all(picture)?;
        let chosen = match &self.region {
            Some(region) => self.wearer.better(region, &faces, size_px),
            None => self.wearer.choose(&faces, size_px),
        };
        if chosen.is_some() {
            self.region = chosen;
            self.mesh.turn = None;
        }
        Ok(self.region)
    }

    /// Returns the landmarks of the face in `region`, in pixels of the picture, if it is the wearer's. Forgets the region if
    /// there is no face, or another one.
    pub fn landmarks(&mut self, picture: &Picture, region: &FaceBox) -> Result<Option<&Landmarks>, InferError> {
        // If a network fails, the landmarks are half written: there is no face then.
        self.region = None;
        self.is_wearer = false;
        let Some(next) = self.mesh.find(picture, region)?.and_then(FaceBox::following) else { return Ok(None) };
        let verdict = self.wearer.judge(&self.mesh.face(), &next, self.step_s);
        self.is_wearer = verdict == Verdict::Wearer;
        self.region = Some(next).filter(|_| verdict != Verdict::Other);
        Ok(self.face().map(|face| face.landmarks))
    }

    /// Searches the picture for a face that stands upright, and returns its [`score`](Appearance::score), or 0 if there is
    /// none. The face that is followed stays as it is.
    pub fn upright_score(&mut self, picture: &Picture) -> Result<f32, InferError> {
        let Some(detected) = self.detector.find(picture)? else { return Ok(0.0) };
        // The mesh sees the detector's region tilted and off the middle, so that it doubts the face at first.
        let Some((_, region)) = self.mesh.look(picture, &detected)? else { return Ok(0.0) };
        let seen = self.mesh.look(picture, &region)?;
        let upright = seen.filter(|(_, region)| region.angle_rad.abs() < FRAC_PI_4);
        Ok(upright.map_or(0.0, |(score, _)| score))
    }

    /// The face in the last picture, if there was one.
    pub fn face(&self) -> Option<Face<'_>> {
        self.region.filter(|_| self.is_wearer).and(Some(self.mesh.face()))
    }

    /// Sets whether the heads of the mesh take turns ([`Mesh`]).
    pub fn set_turns(&mut self, by_turns: bool) {
        self.mesh.by_turns = by_turns;
    }

    /// Sets which face is followed when there are several.
    pub fn set_follow(&mut self, follow: Follow) {
        self.wearer.follow = follow;
    }

    /// Sets what the wearer has on the face.
    pub fn set_wears(&mut self, wears: Wears) {
        self.mesh.wears = wears;
    }

    /// Gives up the region, because its landmarks are of no use. The detector searches the next picture for the wearer.
    pub fn lose(&mut self) {
        self.region = None;
        self.is_wearer = false;
    }

    /// Forgets whose face was followed, so that the detector searches the next picture for any.
    pub fn forget(&mut self) {
        self.lose();
        self.wearer.forget();
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
        tracker.detect(&picture(), 0).expect("a run").expect("a face");
        let outcome = tracker.landmarks(&picture(), &WHOLE).map(Option::<&Landmarks>::cloned);
        assert_eq!(tracker.face().is_some(), matches!(outcome, Ok(Some(_))));
        outcome.map_err(|error| error.to_string())
    }

    #[test]
    fn time_passes_for_a_wearer_whose_landmarks_were_of_no_use() {
        let (mut tracker, _) = tracker(|_, _| Ok(()));
        for frame in 0..30 {
            tracker.detect(&picture(), 33_333 * frame).expect("a run");
            assert!(tracker.landmarks(&picture(), &WHOLE).is_ok_and(|found| found.is_some()));
        }
        tracker.lose();
        tracker.detect(&picture(), 33_333 * 29 + 500_000).expect("a run");
        assert!((tracker.wearer.away_s - 0.5).abs() < 1e-3, "{}", tracker.wearer.away_s);
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
        assert_eq!(tracker.detect(&picture(), 0).expect("a run"), None);
        for _ in 0..3 {
            assert!(follow(&mut tracker).is_ok_and(|found| found.is_some()));
        }
        assert_eq!(runs[0].load(Relaxed), 2);
        tracker.forget();
        assert!(tracker.detect(&picture(), 0).expect("a run").is_some());
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
