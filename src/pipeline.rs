//! The hot path: from a frame to its coefficients.
//!
//! Contract: [`Pipeline::process`] does not allocate, lock, log or panic; all memory is taken when the pipeline is made. A
//! frame whose result is not trustworthy is rejected as a whole.

use std::time::{Duration, Instant};

use facewire_packet::Reason;

use crate::calibration::Observation;
use crate::capture::{Content, Frame, Source};
use crate::config::Settings;
use crate::face::{Face, Tracker};
use crate::infer::InferError;
use crate::link::Pose;
use crate::preflight::{SetupError, load_solver, load_tracker};
use crate::recording::Recorded;
use crate::solve::{Camera, Solution, SolveError, Solver};

/// Why a frame has no solution.
#[derive(Debug, thiserror::Error)]
pub enum Rejected {
    /// The frame shows no face.
    #[error("no face in the picture")]
    NoFace,
    /// A network failed to run.
    #[error(transparent)]
    Infer(#[from] InferError),
    /// The landmarks cannot be solved.
    #[error(transparent)]
    Unsolved(#[from] SolveError),
}

impl Rejected {
    /// The reason that receivers get for the missing pose.
    #[must_use]
    pub fn reason(&self) -> Reason {
        if matches!(self, Self::NoFace) { Reason::NoFace } else { Reason::BadResult }
    }
}

/// Duration of each stage of a frame; `None` for a stage that did not run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StageTimes {
    /// Finding the region of the face. Only this stage runs the detector, and not while a face is followed.
    pub detect: Option<Duration>,
    /// Finding the landmarks.
    pub mesh: Option<Duration>,
    /// From landmarks to coefficients.
    pub solve: Option<Duration>,
}

/// Runs a stage and measures its duration, which is used for statistics only.
fn timed<T>(time: &mut Option<Duration>, stage: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = stage();
    *time = Some(begun.elapsed());
    result
}

/// Turns frames into coefficients.
pub struct Pipeline {
    /// Finds the landmarks in pictures. `None` for a source of landmarks.
    pub tracker: Option<Tracker>,
    /// Turns landmarks into coefficients.
    pub solver: Solver,
    /// Angle of view of the camera, for the position of the head.
    pub horizontal_fov_deg: f32,
    times: StageTimes,
}

impl Pipeline {
    /// Loads the networks and the model that the settings name.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn load(settings: &Settings) -> Result<Self, SetupError> {
        // The model comes first, so that the networks take the memory that reading it leaves free.
        let solver = load_solver(settings)?;
        Ok(Self::new(load_tracker(&settings.networks)?, solver, settings.camera.horizontal_fov_deg))
    }

    /// Loads the model, and the networks only if `source` shows pictures.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn load_for(source: &dyn Source, settings: &Settings) -> Result<Self, SetupError> {
        if source.shows_pictures() {
            return Self::load(settings);
        }
        Ok(Self::for_landmarks(load_solver(settings)?, settings.camera.horizontal_fov_deg))
    }

    /// A pipeline for frames of landmarks, which were found before.
    #[must_use]
    pub fn for_landmarks(solver: Solver, horizontal_fov_deg: f32) -> Self {
        Self { tracker: None, solver, horizontal_fov_deg, times: StageTimes::default() }
    }

    /// A pipeline of these parts, for a camera with this angle of view.
    #[must_use]
    pub fn new(tracker: Tracker, solver: Solver, horizontal_fov_deg: f32) -> Self {
        Self { tracker: Some(tracker), solver, horizontal_fov_deg, times: StageTimes::default() }
    }

    /// Returns the face that the frame brings, or else the one that the tracker finds in its picture. `None` if there is no
    /// face, or a picture but no tracker.
    ///
    /// # Errors
    /// [`InferError::Run`].
    pub fn find<'a>(&'a mut self, frame: &Frame<'a>) -> Result<Option<Face<'a>>, InferError> {
        find(self.tracker.as_mut(), &mut self.times, frame)
    }

    /// Solves one frame. Landmarks that cannot be solved are no face: the tracker forgets them, so that it finds another
    /// face in the next picture.
    ///
    /// # Errors
    /// [`Rejected`]. The next frame is not affected.
    pub fn process(&mut self, frame: &Frame) -> Result<Solution, Rejected> {
        let face = find(self.tracker.as_mut(), &mut self.times, frame)?.ok_or(Rejected::NoFace)?;
        let camera = Camera::new(frame.size_px(), self.horizontal_fov_deg);
        let (solver, times) = (&mut self.solver, &mut self.times);
        let outcome = timed(&mut times.solve, || solver.solve(face, &camera, frame.captured_us));
        if outcome.is_err() && frame.picture().is_some() {
            self.forget_face();
        }
        Ok(outcome?)
    }

    /// Observes, for a calibration, the face that the last call of [`Pipeline::process`] or [`Pipeline::find`] found in this
    /// frame. Does not allocate.
    #[must_use]
    pub fn observe(&self, frame: &Frame<'_>, is_dark: bool) -> Observation {
        let face = self.face_in(frame);
        let camera = Camera::new(frame.size_px(), self.horizontal_fov_deg);
        Observation::new(&self.solver.model, face, &camera, frame.captured_us, is_dark)
    }

    /// What a recording keeps of this frame: the landmarks that the last call of [`Pipeline::process`] or
    /// [`Pipeline::find`] found in it, and what it made of them. Does not allocate.
    #[must_use]
    pub fn record(&self, frame: &Frame<'_>, solved: Result<&Pose, Reason>) -> Recorded {
        let landmarks = self.face_in(frame).map(|face| face.landmarks);
        match solved {
            Ok(pose) => Recorded::new(frame.captured_us, pose, frame.size_px(), landmarks),
            Err(reason) => Recorded::nothing(frame.captured_us, reason),
        }
    }

    /// The face that was found in this frame.
    fn face_in<'a>(&'a self, frame: &Frame<'a>) -> Option<Face<'a>> {
        match &frame.content {
            Content::Picture(_) => self.tracker.as_ref().and_then(Tracker::face),
            Content::Face { face, .. } => *face,
        }
    }

    /// Makes the tracker search the next picture as a whole.
    pub fn forget_face(&mut self) {
        if let Some(tracker) = &mut self.tracker {
            tracker.forget();
        }
    }

    /// Durations of the stages of the last frame.
    #[must_use]
    pub fn times(&self) -> &StageTimes {
        &self.times
    }
}

fn find<'a>(
    tracker: Option<&'a mut Tracker>,
    times: &mut StageTimes,
    frame: &Frame<'a>,
) -> Result<Option<Face<'a>>, InferError> {
    *times = StageTimes::default();
    let picture = match &frame.content {
        Content::Picture(picture) => picture,
        Content::Face { face, .. } => return Ok(*face),
    };
    let Some(tracker) = tracker else { return Ok(None) };
    let Some(region) = timed(&mut times.detect, || tracker.detect(picture))? else { return Ok(None) };
    timed(&mut times.mesh, || tracker.landmarks(picture, &region).map(drop))?;
    Ok(tracker.face())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

    use super::*;
    use crate::capture::{Picture, Pixels};
    use crate::face::test_face::show;
    use crate::infer::scripted::Scripted;
    use crate::solve::{Neutral, NeutralMean, normalise, test_face::face};

    const SIDE: usize = 192;

    /// A pipeline whose detector finds something that is no face in its first `wrong` runs, and a face later; and how
    /// often it ran.
    fn pipeline(wrong: usize) -> (Pipeline, Arc<AtomicUsize>) {
        let runs = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&runs);
        let engine = Scripted::new(move |mut run| {
            if run.network == "detector" {
                counted.fetch_add(1, Relaxed);
            }
            let mut shown = face([0.0; 3], 60.0, [96.0, 80.0]);
            if counted.load(Relaxed) <= wrong {
                shown.0.reverse();
            }
            show(&mut run, &shown);
            Ok(())
        });
        let solver = load_solver(&Settings::default()).unwrap();
        (Pipeline::new(Tracker::load(&engine).unwrap(), solver, 60.0), runs)
    }

    #[test]
    fn landmarks_that_form_no_face_are_forgotten_so_that_another_face_is_found() {
        let data = vec![128; SIDE * SIDE];
        let picture = Picture::new(SIDE, SIDE, Pixels::Grey { data: &data, stride: SIDE }, true).unwrap();
        let frame = |number| Frame { content: Content::Picture(picture), captured_us: 33_333 * number, number };
        let (mut pipeline, detector_runs) = pipeline(1);
        pipeline.solver.profile.neutral = Some(neutral(&frame(0)));
        assert!(matches!(pipeline.process(&frame(0)), Err(Rejected::Unsolved(_))));
        for number in 1..3 {
            pipeline.process(&frame(number)).unwrap();
        }
        assert_eq!(detector_runs.load(Relaxed), 2);
    }

    /// The scripted face as the neutral one. It has few points, so only displacements from itself are sensible.
    fn neutral(frame: &Frame) -> Neutral {
        let mut mean = NeutralMean::default();
        mean.add(&normalise(pipeline(0).0.find(frame).unwrap().unwrap().landmarks).unwrap());
        mean.finish().unwrap()
    }
}
