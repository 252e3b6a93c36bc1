//! The hot path: from a frame to its coefficients.
//!
//! [`Pipeline::process`] does not allocate, lock, log or panic. A frame whose result is not trustworthy is rejected as a
//! whole. The parts of a pipeline are loaded here, too: [`crate::config`] judges settings by their text alone, and whether
//! the files that they name can be used turns out now.

use std::time::{Duration, Instant};

use facewire_face::{Camera, Face, InferError, Model, ModelError, Profile, Shaping, Solution, Solver, Tracker, Wears};
use facewire_packet::{Pose, Reason};

use crate::calibration::{Observation, ProfileFile, Store, StoreError, WearerName, model_hash};
use crate::capture::{Content, Frame};
use crate::config::{NetworkSettings, Settings, SolverSettings, WearerSettings};
use crate::recording::Recorded;

pub enum Rejected {
    NoFace,
    /// The face is turned away from the camera, so that its pose is not to be trusted. It is followed all the same.
    TurnedAway,
    Infer(InferError),
    Unsolved,
}

/// Duration of each stage of a frame; `None` for a stage that did not run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StageTimes {
    /// Finding the region of the face. Only this stage runs the detector, and not while a face is followed.
    pub detect: Option<Duration>,
    pub mesh: Option<Duration>,
    pub solve: Option<Duration>,
}

fn timed<T>(time: &mut Option<Duration>, stage: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = stage();
    *time = Some(begun.elapsed());
    result
}

pub struct Processed<'a> {
    pub solved: Result<Solution, Rejected>,
    /// The face, unless there is none or the landmarks cannot be used: after a failed inference they may be half written.
    pub face: Option<Face<'a>>,
    pub times: StageTimes,
    frame: Frame<'a>,
    camera: Camera,
    pub solver: &'a Solver,
}

impl Processed<'_> {
    pub fn pose(&self) -> Result<Pose, Reason> {
        self.solved.as_ref().map(Pose::from).map_err(|rejected| match rejected {
            Rejected::NoFace | Rejected::TurnedAway => Reason::NoFace,
            Rejected::Infer(_) | Rejected::Unsolved => Reason::BadResult,
        })
    }

    /// What a calibration learns from the frame. Does not allocate.
    pub fn observe(&self, is_dark: bool) -> Observation {
        Observation::new(self.solver.model(), self.face, &self.camera, self.frame.captured_us, is_dark)
    }

    /// What a recording keeps of the frame. Does not allocate.
    pub fn record(&self) -> Recorded {
        let time_us = self.frame.captured_us;
        let landmarks = self.face.map(|face| face.landmarks);
        match self.pose() {
            Ok(pose) => Recorded::new(time_us, &pose, self.frame.size_px(), landmarks),
            Err(reason) => Recorded::nothing(time_us, reason),
        }
    }
}

pub struct Pipeline {
    /// Finds the landmarks in pictures. `None` for a source of landmarks.
    pub tracker: Option<Tracker>,
    pub solver: Solver,
    pub horizontal_fov_deg: f32,
}

impl Pipeline {
    /// Loads a pipeline for frames that are pictures, or else landmarks, which need no networks.
    pub fn load(settings: &Settings, are_pictures: bool) -> Result<Self, SetupError> {
        // The model comes first, so that the networks take the memory that reading it leaves free.
        let solver = load_solver(settings)?;
        let tracker = are_pictures.then(|| load_tracker(&settings.networks)).transpose()?;
        let mut pipeline = Self { tracker, solver, horizontal_fov_deg: settings.camera.horizontal_fov_deg };
        pipeline.set_wearer(&settings.wearer);
        Ok(pipeline)
    }

    /// Finds the face of one frame by [`find`].
    pub fn find<'a>(&'a mut self, frame: &Frame<'a>) -> Result<Option<Face<'a>>, InferError> {
        find(self.tracker.as_mut(), &mut StageTimes::default(), frame)
    }

    /// Finds and solves the face of one frame. Landmarks that cannot be solved are no face: the tracker forgets them, so
    /// that it finds another face in the next picture.
    pub fn process<'a>(&'a mut self, frame: &Frame<'a>) -> Processed<'a> {
        let mut times = StageTimes::default();
        let camera = frame.camera(self.horizontal_fov_deg);
        let solver = &mut self.solver;
        let solved = match find(self.tracker.as_mut(), &mut times, frame) {
            Ok(Some(face)) => {
                let solved = timed(&mut times.solve, || solver.solve(face, &camera, frame.captured_us));
                match solved {
                    Ok(solution) if solution.is_turned_away => Err(Rejected::TurnedAway),
                    solved => solved.map_err(|_| Rejected::Unsolved),
                }
            }
            Ok(None) => Err(Rejected::NoFace),
            Err(error) => Err(Rejected::Infer(error)),
        };
        if matches!(solved, Err(Rejected::Unsolved)) && frame.picture().is_some() {
            self.lose_face();
        }
        let face = match &frame.content {
            _ if !matches!(solved, Ok(_) | Err(Rejected::TurnedAway)) => None,
            Content::Picture(_) => self.tracker.as_ref().and_then(Tracker::face),
            Content::Face { face, .. } => *face,
        };
        Processed { solved, face, times, frame: *frame, camera, solver: &self.solver }
    }

    /// Sets whether the networks for lips and eyes take turns, one on each frame.
    pub fn set_turns(&mut self, by_turns: bool) {
        if let Some(tracker) = &mut self.tracker {
            tracker.set_turns(by_turns);
        }
    }

    /// Gives up the face because its landmarks are of no use, and looks for the wearer in the next picture.
    pub fn lose_face(&mut self) {
        if let Some(tracker) = &mut self.tracker {
            tracker.lose();
        }
    }

    /// Sets which face is followed, and what the wearer has on it.
    pub fn set_wearer(&mut self, wearer: &WearerSettings) {
        self.solver.set_wears(wearer.wears);
        if let Some(tracker) = &mut self.tracker {
            tracker.set_follow(wearer.follow);
            tracker.set_wears(wearer.wears);
        }
    }

    /// Forgets whose face was followed.
    pub fn forget_face(&mut self) {
        if let Some(tracker) = &mut self.tracker {
            tracker.forget();
        }
    }
}

/// Returns the face that the frame contains, or else the one that the tracker finds in its picture. Returns `None` if there
/// is no face, or if a picture comes without a tracker.
pub fn find<'a>(
    tracker: Option<&'a mut Tracker>,
    times: &mut StageTimes,
    frame: &Frame<'a>,
) -> Result<Option<Face<'a>>, InferError> {
    let picture = match &frame.content {
        Content::Picture(picture) => picture,
        Content::Face { face, .. } => return Ok(*face),
    };
    let Some(tracker) = tracker else { return Ok(None) };
    let Some(region) = timed(&mut times.detect, || tracker.detect(picture, frame.captured_us))? else {
        return Ok(None);
    };
    timed(&mut times.mesh, || tracker.landmarks(picture, &region).map(drop))?;
    Ok(tracker.face())
}

#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    #[error(transparent)]
    Networks(#[from] InferError),
    /// The blendshape model does not load. An error that does not name the file itself gets its path in front.
    #[error("{}{error}", if self.is_temporary() { String::new() } else { format!("{path}: ") })]
    Model { path: String, error: ModelError },
}

impl SetupError {
    /// Whether the same attempt can succeed later without anybody changing the settings or a file: a disk may be mounted.
    pub fn is_temporary(&self) -> bool {
        matches!(self, Self::Model { error: ModelError::Unreadable { .. }, .. })
    }
}

pub fn load_tracker(settings: &NetworkSettings) -> Result<Tracker, InferError> {
    Tracker::load(facewire_face::engine(settings.engine, &settings.folder, settings.threads)?.as_ref())
}

pub fn load_model(settings: &SolverSettings) -> Result<Model, SetupError> {
    let path = &settings.model;
    if path.is_empty() {
        return Ok(Model::of(settings.method));
    }
    let loaded = Model::load(path.as_ref()).map(Model::with_gaze);
    loaded.map_err(|error| SetupError::Model { path: path.clone(), error })
}

pub fn is_same_profile(one: &WearerSettings, other: &WearerSettings) -> bool {
    (&one.name, &one.folder) == (&other.name, &other.folder)
}

/// Returns the wearer's profile, and its [`profile_warning`].
pub fn load_profile(wearer: &WearerSettings, solver: &SolverSettings) -> Result<(Profile, Option<String>), StoreError> {
    let Some(name) = WearerName::new(&wearer.name) else { return Ok((Profile::default(), None)) };
    let file = Store::new(&wearer.folder).load(&name)?;
    let warning = profile_warning(&name, &file, wearer.wears, solver);
    Ok((file.profile, warning))
}

/// Why a wearer's profile has no effect, or may not fit.
pub fn profile_warning(name: &WearerName, file: &ProfileFile, wears: Wears, solver: &SolverSettings) -> Option<String> {
    if file.profile.fits(wears) {
        return model_warning(name, file.model, solver);
    }
    let [made, now] = [file.profile.wears, wears].map(Wears::name);
    Some(format!(
        "the profile of {name} was made with wearer.wears = \"{made}\", and has no effect while it is \"{now}\": correct the setting, \
         or calibrate under another name"
    ))
}

/// Says that a wearer's profile was made with another model, if it was: what it says of the wearer's rest and range may
/// then not fit.
pub fn model_warning(name: &WearerName, made_with: Option<u32>, solver: &SolverSettings) -> Option<String> {
    (made_with? != model_hash(&load_model(solver).ok()?)).then(|| {
        format!(
            "the profile of {name} was made with another blendshape model, and may not fit this one: run `facewire \
             calibrate --wearer {name}`"
        )
    })
}

pub fn shaping(settings: &Settings) -> Shaping {
    facewire_face::settings::shaping(&settings.smoothing, settings.plausibility, &settings.adjust)
}

pub fn load_solver(settings: &Settings) -> Result<Solver, SetupError> {
    let mut solver = Solver::new(load_model(&settings.solver)?, Profile::default(), shaping(settings));
    solver.neutral_mode = settings.wearer.neutral;
    solver.set_wears(settings.wearer.wears);
    solver.eye_distance_mm = settings.wearer.eye_distance_mm;
    Ok(solver)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

    use facewire_packet::control::Refusal;

    use facewire_face::stages::{FaceMean, normalise};
    use facewire_face::testing::{Scripted, face, show};
    use facewire_face::{Landmarks, Picture, Pixels};

    use super::*;

    const SIDE: usize = 192;
    const FAILING: usize = 1000;

    fn scripted() -> Landmarks {
        face([0.0; 3], 60.0, [96.0, 80.0])
    }

    /// A pipeline whose detector finds something that is no face in its first `wrong` runs, and a face later; and how
    /// often it ran. The networks fail while the number of runs is set to [`FAILING`]. The neutral face is the scripted
    /// one: it has few points, so only displacements from itself are sensible.
    fn pipeline(wrong: usize) -> (Pipeline, Arc<AtomicUsize>) {
        let runs = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&runs);
        let engine = Scripted::new(move |mut run| {
            if counted.load(Relaxed) == FAILING && run.network == "lips" {
                return Err("the device has hung up");
            }
            if run.network == "detector" {
                counted.fetch_add(1, Relaxed);
            }
            let mut shown = scripted();
            if counted.load(Relaxed) <= wrong {
                shown.0.reverse();
            }
            show(&mut run, &shown);
            Ok(())
        });
        let mut solver = load_solver(&Settings::default()).unwrap();
        let mut mean = FaceMean::default();
        mean.add(&normalise(&scripted()).unwrap());
        solver.profile.neutral = Some(mean.neutral().unwrap());
        let tracker = Some(Tracker::load(&engine).unwrap());
        (Pipeline { tracker, solver, horizontal_fov_deg: 60.0 }, runs)
    }

    fn frame(number: u64) -> Frame<'static> {
        let pixels = Pixels::Grey { data: &[128; SIDE * SIDE], stride: SIDE };
        let content = Content::Picture(Picture::new(SIDE, SIDE, pixels, true).unwrap());
        Frame { content, captured_us: 33_333 * number, number }
    }

    #[test]
    fn landmarks_that_form_no_face_are_forgotten_so_that_another_face_is_found() {
        let (mut pipeline, detector_runs) = pipeline(1);
        assert!(matches!(pipeline.process(&frame(0)).solved, Err(Rejected::Unsolved)));
        assert!((1..3).all(|number| pipeline.process(&frame(number)).solved.is_ok()));
        assert_eq!(detector_runs.load(Relaxed), 2);
    }

    #[test]
    fn a_face_that_is_turned_away_is_rejected_and_followed_until_it_is_back() {
        let yaw_deg = Arc::new(AtomicUsize::new(0));
        let turned = Arc::clone(&yaw_deg);
        let detector_runs = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&detector_runs);
        let engine = Scripted::new(move |mut run| {
            counted.fetch_add(usize::from(run.network == "detector"), Relaxed);
            show(&mut run, &face([turned.load(Relaxed) as f32, 0.0, 0.0], 60.0, [96.0, 80.0]));
            Ok(())
        });
        let (mut pipeline, _) = pipeline(0);
        pipeline.tracker = Some(Tracker::load(&engine).unwrap());
        let mut seen = |number: u64, degrees| {
            yaw_deg.store(degrees, Relaxed);
            let frame = frame(number);
            let processed = pipeline.process(&frame);
            assert!(processed.face.is_some(), "{degrees} degrees");
            (matches!(processed.solved, Err(Rejected::TurnedAway)), processed.pose().err())
        };
        // The pose is nine tenths of what the drawn face is turned by.
        let away = (true, Some(Reason::NoFace));
        let degrees = [0, 30, 45, 60, 66, 58, 54, 30];
        let got: Vec<_> = (0..).zip(degrees).map(|(number, degrees)| seen(number, degrees)).collect();
        let back = (false, None);
        assert_eq!(got, [back, back, back, back, away, away, back, back]);
        assert_eq!(detector_runs.load(Relaxed), 1);
    }

    #[test]
    fn a_profile_that_does_not_hold_for_what_the_wearer_has_on_is_named_with_the_remedy() {
        let file = crate::calibration::test_profile(7);
        let anna = WearerName::new("anna").unwrap();
        let warning = |wears| profile_warning(&anna, &file, wears, &SolverSettings::default()).unwrap();
        assert!(warning(Wears::Headset).contains("has no effect while it is \"headset\": correct the setting"));
        assert!(warning(Wears::Mask).contains("another blendshape model"));
    }

    /// The backbone has written new landmarks then, and a head that fails has not refined them.
    #[test]
    fn after_a_failed_inference_a_calibration_sees_no_face() {
        let (mut pipeline, runs) = pipeline(0);
        assert!(pipeline.process(&frame(0)).observe(false).sight.is_ok());
        runs.store(FAILING, Relaxed);
        let frame = frame(0);
        let failed = pipeline.process(&frame);
        assert!(matches!(failed.solved, Err(Rejected::Infer(_))));
        assert!(failed.observe(false).sight == Err(Refusal::NoFace) && failed.record().landmarks.is_none());
    }
}
