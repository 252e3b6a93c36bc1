//! Follows faces from one picture to the next and solves each with a history of its own.

use std::iter;
use std::time::Duration;

use facewire_face::stages::{Coefficients, Detector, Mesh};
use facewire_face::{
    BLENDSHAPES, COEFFS, Camera, Engine, FaceBox, Gaze, HeadPose, InferError, Landmarks, Model, NeutralMode, Picture,
    Profile, Solver,
};
use facewire_packet::{NeutralFace, Visibility};

use crate::{Error, Options};

/// While some faces are followed, every tenth picture is searched for more.
const SEARCH_EVERY: u32 = 10;

/// A face in a picture.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Face {
    /// Stays the same while a face is followed. A face that was lost and found again is a new one.
    pub id: u64,
    /// 478 points in MediaPipe's order, in pixels of the picture: x to the right, y down, z away from the camera.
    pub landmarks: Landmarks,
    /// In the order of [`BLENDSHAPES`], from 0 to 1.
    pub coefficients: [f32; COEFFS],
    /// Rotation and position of the head.
    pub head: HeadPose,
    /// Where both eyes look, in the axes of the head.
    pub gaze: Gaze,
    /// The neutral face from which the coefficients are measured.
    pub neutral: NeutralFace,
    /// How much of each part of the face is in view. The coefficients of what is covered are a guess.
    pub visibility: Visibility,
    /// How surely the network sees a face: the log-odds that it computes, from 0 on. It is about 25 for a face in view. Below 15
    /// the face is doubtful, for instance because its upper half is covered, and its coefficients may be wrong.
    pub score: f32,
}

impl Face {
    /// The coefficient of this name, such as `jawOpen`.
    pub fn coefficient(&self, name: &str) -> Option<f32> {
        let index = BLENDSHAPES.iter().position(|known| *known == name)?;
        self.coefficients.get(index).copied()
    }
}

/// A face with the identifier 0, whose values are all 0, which does not turn and of which nothing is covered: a program fills it
/// to restore a face that it kept, or in a test.
impl Default for Face {
    fn default() -> Self {
        Self {
            id: 0,
            landmarks: Landmarks::zero(),
            coefficients: [0.0; COEFFS],
            head: HeadPose::from_rotation([0.0, 0.0, 0.0, 1.0], [0.0; 3]),
            gaze: Gaze::default(),
            neutral: NeutralFace::Mean,
            visibility: Visibility::WHOLE,
            score: 0.0,
        }
    }
}

/// Follows faces from picture to picture.
pub struct FaceTracker {
    detector: Detector,
    seats: Vec<Seat>,
    /// Memory for the regions of the faces that are followed.
    regions: Vec<FaceBox>,
    horizontal_fov_deg: f32,
    is_for_stills: bool,
    pictures_since_search: u32,
    found: u64,
}

/// A face that is followed, or the memory for one.
struct Seat {
    mesh: Mesh,
    solver: Solver,
    /// Where the face is expected in the next picture; `None` while no face is followed.
    region: Option<FaceBox>,
    /// Where a face was seen last.
    last: Option<FaceBox>,
    is_seen: bool,
    face: Face,
}

impl FaceTracker {
    /// A tracker of one face with the default [`Options`].
    pub fn new() -> Result<Self, Error> {
        Options::default().open()
    }

    pub(crate) fn load(options: &Options, engine: &dyn Engine, model: Model) -> Result<Self, Error> {
        let seat = |model| -> Result<Seat, InferError> {
            let mut solver = Solver::new(model, options.profile.clone(), options.shaping.clone());
            solver.neutral_mode = options.neutral;
            Ok(Seat {
                mesh: Mesh::load(engine)?,
                solver,
                region: None,
                last: None,
                is_seen: false,
                face: Face::default(),
            })
        };
        Ok(Self {
            detector: Detector::load(engine)?,
            seats: iter::repeat_n(model, options.max_faces).map(seat).collect::<Result<_, _>>()?,
            regions: Vec::with_capacity(options.max_faces),
            horizontal_fov_deg: options.horizontal_fov_deg,
            is_for_stills: options.stills,
            pictures_since_search: 0,
            found: 0,
        })
    }

    /// Returns the face in a picture that was taken at `time` since any moment that stays the same. If several faces are
    /// followed, this is the one that has been followed longest. Does not allocate, except with [`Options::for_stills`].
    ///
    /// A time before the last one begins anew: the filters forget the past. A picture is an error if its fields were changed to
    /// what does not fit its samples.
    pub fn process(&mut self, picture: &Picture, time: Duration) -> Result<Option<&Face>, Error> {
        Ok(self.process_all(picture, time)?.min_by_key(|face| face.id))
    }

    /// Returns all faces in a picture, like [`FaceTracker::process`].
    pub fn process_all(&mut self, picture: &Picture, time: Duration) -> Result<impl Iterator<Item = &Face>, Error> {
        check(picture)?;
        if self.is_for_stills {
            self.reset();
        }
        self.seats.iter_mut().for_each(|seat| seat.is_seen = false);
        #[expect(clippy::cast_precision_loss, reason = "a side is at most 4096 px long")]
        let camera = Camera::new([picture.width, picture.height].map(|side| side as f32), self.horizontal_fov_deg);
        let time_us = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        self.search(picture)?;
        for seat in &mut self.seats {
            seat.follow(picture, &camera, time_us)?;
        }
        self.leave_doubles();
        Ok(self.faces())
    }

    /// The faces in the last picture.
    pub fn faces(&self) -> impl Iterator<Item = &Face> {
        self.seats.iter().filter(|seat| seat.is_seen).map(|seat| &seat.face)
    }

    /// Forgets all faces and what was learned of them. The options remain.
    pub fn reset(&mut self) {
        self.pictures_since_search = 0;
        for seat in &mut self.seats {
            let Solver { model, profile, shaping, neutral_mode, .. } = &seat.solver;
            let mode = *neutral_mode;
            seat.solver = Solver::new(model.clone(), profile.clone(), shaping.clone());
            seat.solver.neutral_mode = mode;
            (seat.region, seat.last, seat.is_seen) = (None, None, false);
        }
    }

    /// Replaces the profile of all faces. The coefficients do not jump.
    pub fn set_profile(&mut self, profile: &Profile) {
        self.seats.iter_mut().for_each(|seat| seat.solver.set_profile(profile.clone()));
    }

    /// Sets whether the neutral face is estimated.
    pub fn set_neutral_mode(&mut self, mode: NeutralMode) {
        self.seats.iter_mut().for_each(|seat| seat.solver.neutral_mode = mode);
    }

    /// Finds faces for seats that are free: in each picture while there is no face, else now and then.
    fn search(&mut self, picture: &Picture) -> Result<(), InferError> {
        self.regions.clear();
        self.regions.extend(self.seats.iter().filter_map(|seat| seat.region));
        self.pictures_since_search = self.pictures_since_search.saturating_add(1);
        if !self.regions.is_empty() && self.pictures_since_search < SEARCH_EVERY {
            return Ok(());
        }
        self.pictures_since_search = 0;
        while self.regions.len() < self.seats.len()
            && let Some(region) = self.detector.find(picture, &self.regions)?
        {
            self.regions.push(region);
            let free = self.seats.iter_mut().filter(|seat| seat.region.is_none());
            if let Some(seat) = free.min_by(|one, other| one.distance(&region).total_cmp(&other.distance(&region))) {
                self.found += 1;
                seat.face.id = self.found;
                seat.region = Some(region);
            }
        }
        Ok(())
    }

    /// Leaves a face that is followed twice to the seat that has had it longer.
    fn leave_doubles(&mut self) {
        for index in 1..self.seats.len() {
            let (before, rest) = self.seats.split_at_mut(index);
            let Some(seat) = rest.first_mut() else { continue };
            for other in before {
                if seat.region.zip(other.region).is_some_and(|(one, other)| one.is_same(&other)) {
                    let younger = if seat.face.id > other.face.id { &mut *seat } else { other };
                    (younger.region, younger.is_seen) = (None, false);
                }
            }
        }
    }
}

/// Checks again what [`Picture::new`] has checked, because fields can be changed.
fn check(picture: &Picture) -> Result<(), Error> {
    let Picture { width, height, pixels, full_range, .. } = *picture;
    match Picture::new(width, height, pixels, full_range) {
        Some(_) => Ok(()),
        None => Err(Error::Picture(format!(
            "the picture of {width} x {height} pixels is not complete: its fields were changed to what does not fit its \
             samples; make it by Picture::new"
        ))),
    }
}

impl Seat {
    /// The square of how far a region is from where this seat last saw a face. A seat that saw none is farther than all others.
    fn distance(&self, region: &FaceBox) -> f32 {
        let away =
            |last: FaceBox| (last.centre[0] - region.centre[0]).powi(2) + (last.centre[1] - region.centre[1]).powi(2);
        self.last.map_or(f32::INFINITY, away)
    }

    /// Finds and solves the face, if there is one in the region. Landmarks that cannot be solved are no face.
    fn follow(&mut self, picture: &Picture, camera: &Camera, time_us: u64) -> Result<(), InferError> {
        // If a network fails, the landmarks are half written: there is no face then.
        let Some(region) = self.region.take() else { return Ok(()) };
        let Some(next) = self.mesh.find(picture, &region)?.and_then(FaceBox::following) else { return Ok(()) };
        let Ok(solution) = self.solver.solve(self.mesh.face(), camera, time_us) else { return Ok(()) };
        (self.region, self.last, self.is_seen) = (Some(next), Some(next), true);
        self.face.landmarks.0 = self.mesh.face().landmarks.0;
        self.face.coefficients = solution.smoothed.0;
        self.face.head = solution.head;
        self.face.gaze = Gaze::of(&Coefficients(solution.smoothed.0));
        self.face.neutral = solution.neutral_face;
        self.face.visibility = solution.visibility;
        self.face.score = self.mesh.face().appearance.map_or(0.0, |seen| seen.score);
        Ok(())
    }
}
