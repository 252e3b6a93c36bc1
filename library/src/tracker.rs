//! Follows faces from one picture to the next and solves each with a history of its own.

use std::iter;
use std::time::Duration;

use facewire_face::stages::{Coefficients, Detector, Mesh, Wearer, bounds};
use facewire_face::{
    BLENDSHAPES, COEFFS, Camera, Engine, FaceBox, Gaze, HeadPose, InferError, Landmarks, Model, NeutralMode, Picture,
    Profile, Solver,
};
use facewire_packet::{NeutralFace, Visibility};

use crate::options::Lens;
use crate::{Error, Options, neutral_of};

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

    /// The smallest upright rectangle around the landmarks, in pixels of the picture: left, top, right and bottom. It reaches
    /// from the forehead to the chin, and beyond the edge of the picture if the face does.
    pub fn box_px(&self) -> [f32; 4] {
        let [[left, top], [right, bottom]] = bounds(self.landmarks.0.iter().map(|[x, y, _]| [*x, *y]));
        [left, top, right, bottom]
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
///
/// With [`Options::max_faces`] above 1, a face that is new in the picture begins with a history of its own, unless it looks
/// like one that has left: then its neutral face and its profile come back. One more person than [`Options::max_faces`] is
/// remembered. When memory for another one is needed, who was seen for less than half a second is forgotten first, and then
/// who has been away longest. If another person takes the place of a face from one picture to the next, the face keeps its
/// identifier and profile.
///
/// With one face, all history is that of the wearer, and a stranger who stays is noticed within some seconds, as by the service.
pub struct FaceTracker {
    detector: Detector,
    seats: Vec<Seat>,
    /// One for each seat, and with several seats one more. The first one has the profile.
    people: Vec<Person>,
    profile: Profile,
    /// The time of the last picture.
    last_us: u64,
    lens: Lens,
    is_for_stills: bool,
    pictures_since_search: u32,
    found: u64,
}

/// A face that is followed, or the memory for one.
struct Seat {
    mesh: Mesh,
    /// Where the face is expected in the next picture; `None` while no face is followed.
    region: Option<FaceBox>,
    is_seen: bool,
    /// Whether nobody knows yet whose face it is.
    is_new: bool,
    face: Face,
    /// Whose face it is: a place in [`FaceTracker::people`], which no other seat has.
    person: usize,
}

/// What is known of a person, who may have left the picture.
struct Person {
    solver: Solver,
    wearer: Wearer,
    seen_us: u64,
    /// Whether this is memory that nobody has had yet.
    is_free: bool,
}

impl FaceTracker {
    /// A tracker of one face with the default [`Options`].
    pub fn new() -> Result<Self, Error> {
        Options::default().open()
    }

    pub(crate) fn load(options: &Options, engine: &dyn Engine, model: Model) -> Result<Self, Error> {
        let seat = |person| -> Result<Seat, InferError> {
            let mesh = Mesh::load(engine)?;
            Ok(Seat { mesh, region: None, is_seen: false, is_new: false, face: Face::default(), person })
        };
        let person = |model| {
            let mut solver = Solver::new(model, Profile::default(), options.shaping.clone());
            solver.neutral_mode = options.neutral;
            solver.eye_distance_mm = options.eye_distance_mm;
            Person { solver, wearer: Wearer::default(), seen_us: 0, is_free: true }
        };
        let people = if options.max_faces > 1 { options.max_faces + 1 } else { 1 };
        let mut tracker = Self {
            detector: Detector::load(engine)?,
            seats: (0..options.max_faces).map(seat).collect::<Result<_, _>>()?,
            people: iter::repeat_n(model, people).map(person).collect(),
            last_us: 0,
            profile: options.profile.clone(),
            lens: options.lens,
            is_for_stills: options.stills,
            pictures_since_search: 0,
            found: 0,
        };
        tracker.reset();
        Ok(tracker)
    }

    /// Returns the face in a picture that was taken at `time` since any moment that stays the same. If several faces are
    /// followed, this is the one that has been followed longest. Does not allocate, except with [`Options::for_stills`].
    ///
    /// A time before the last one begins anew: the filters forget the past.
    pub fn process(&mut self, picture: &Picture, time: Duration) -> Result<Option<&Face>, Error> {
        Ok(self.process_all(picture, time)?.min_by_key(|face| face.id))
    }

    /// Returns all faces in a picture, like [`FaceTracker::process`].
    pub fn process_all(&mut self, picture: &Picture, time: Duration) -> Result<impl Iterator<Item = &Face>, Error> {
        if self.is_for_stills {
            self.reset();
        }
        self.seats.iter_mut().for_each(|seat| seat.is_seen = false);
        let camera = self.lens.camera(picture);
        let time_us = u64::try_from(time.as_micros()).unwrap_or(u64::MAX);
        self.pass_time(time_us);
        self.search(picture)?;
        for seat in &mut self.seats {
            seat.find(picture)?;
        }
        self.leave_doubles();
        if self.seats.len() > 1 {
            self.recognise(time_us);
        }
        for seat in &mut self.seats {
            if let Some(person) = self.people.get_mut(seat.person) {
                seat.solve(person, &camera, time_us);
            }
        }
        Ok(self.faces())
    }

    /// The faces in the last picture.
    pub fn faces(&self) -> impl Iterator<Item = &Face> {
        self.seats.iter().filter(|seat| seat.is_seen).map(|seat| &seat.face)
    }

    /// Moves on to the time of a picture. If the clock went back, those who are away stay away for as long as they have been.
    fn pass_time(&mut self, time_us: u64) {
        let back_us = self.last_us.saturating_sub(time_us);
        self.people.iter_mut().for_each(|person| person.seen_us = person.seen_us.saturating_sub(back_us));
        self.last_us = time_us;
    }

    /// Forgets all faces, what was learned of them and their profiles, but that of the first face. The options remain.
    pub fn reset(&mut self) {
        self.pictures_since_search = 0;
        for seat in &mut self.seats {
            (seat.region, seat.is_seen) = (None, false);
        }
        self.people.iter_mut().for_each(Person::forget);
        if let Some(first) = self.people.first_mut() {
            first.solver.profile = self.profile.clone();
        }
    }

    /// Replaces the profile of the first face, as [`Options::profile`] gives it. Its coefficients do not jump. The profile
    /// remains after [`FaceTracker::reset`]; `Profile::default()` takes it away.
    pub fn set_profile(&mut self, profile: &Profile) {
        self.profile = profile.clone();
        if let Some(first) = self.people.first_mut() {
            first.solver.set_profile(profile.clone());
        }
    }

    /// Replaces the profile of the person whose face has this [`id`](Face::id), until that person is forgotten. The
    /// coefficients do not jump. Returns whether there is such a face in the last picture. With [`Options::for_stills`] nobody
    /// is remembered, and there is none.
    #[must_use = "the face may have left the picture"]
    pub fn set_profile_of(&mut self, id: u64, profile: &Profile) -> bool {
        let person = self.place_of(id).and_then(|place| self.people.get_mut(place));
        person.map(|person| person.solver.set_profile(profile.clone())).is_some()
    }

    /// Makes the mean of these faces the neutral face of the wearer, who looks at the camera, at rest ([`neutral_of`]). This
    /// replaces the profile. With [`Options::max_faces`] above 1, the faces are those of one identifier, which is in the last
    /// picture, and nobody else's neutral face changes.
    pub fn set_neutral<'a>(&mut self, faces: impl IntoIterator<Item = &'a Face>) -> Result<(), Error> {
        let faces: Vec<_> = faces.into_iter().collect();
        let profile = Profile::from(neutral_of(faces.iter().copied())?);
        if self.seats.len() == 1 {
            self.set_profile(&profile);
            return Ok(());
        }
        let id = faces.first().map_or(0, |face| face.id);
        if faces.iter().any(|face| face.id != id) {
            return Err(Error::Face("these faces have different ids; give those of one id".to_owned()));
        }
        self.set_profile_of(id, &profile).then_some(()).ok_or_else(|| missing(id))
    }

    /// What is known of the first face: the profile that it was given, or the neutral face that was estimated, once the wearer is
    /// known well enough, which takes some seconds at rest. `None` until then. With the profile, a later tracker need not
    /// estimate.
    pub fn profile(&self) -> Option<Profile> {
        self.people.first()?.solver.known_profile()
    }

    /// The same for the face with this [`id`](Face::id) in the last picture.
    pub fn profile_of(&self, id: u64) -> Option<Profile> {
        self.people.get(self.place_of(id)?)?.solver.known_profile()
    }

    /// The person whose face in the last picture has this identifier. With [`Options::for_stills`] nobody is remembered.
    fn place_of(&self, id: u64) -> Option<usize> {
        let is_meant = |seat: &&Seat| seat.is_seen && seat.face.id == id && !self.is_for_stills;
        self.seats.iter().find(is_meant).map(|seat| seat.person)
    }

    /// Sets whether the neutral faces are estimated.
    pub fn set_neutral_mode(&mut self, mode: NeutralMode) {
        self.people.iter_mut().for_each(|person| person.solver.neutral_mode = mode);
    }

    /// Finds faces for seats that are free: in each picture while there is no face, else now and then.
    fn search(&mut self, picture: &Picture) -> Result<(), InferError> {
        self.pictures_since_search = self.pictures_since_search.saturating_add(1);
        let followed = self.seats.iter().filter(|seat| seat.region.is_some()).count();
        if followed == self.seats.len() || (followed > 0 && self.pictures_since_search < SEARCH_EVERY) {
            return Ok(());
        }
        self.pictures_since_search = 0;
        for region in self.detector.find_all(picture)? {
            let is_followed = |seat: &Seat| seat.region.is_some_and(|known| known.is_same(&region));
            if self.seats.iter().any(is_followed) {
                continue;
            }
            if let Some(seat) = self.seats.iter_mut().find(|seat| seat.region.is_none()) {
                self.found += 1;
                seat.face.id = self.found;
                (seat.region, seat.is_new) = (Some(region), true);
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
                    younger.region = None;
                }
            }
        }
    }

    /// Finds out whose the new faces are.
    fn recognise(&mut self, time_us: u64) {
        for index in 0..self.seats.len() {
            let Some(seat) = self.seats.get(index).filter(|seat| seat.is_new) else { continue };
            let Some(region) = seat.region else { continue };
            let before = seat.person;
            let known = self.person_like(&seat.mesh.face(), &region, time_us);
            let chosen = known.or_else(|| self.stranger()).unwrap_or(before);
            if let Some(person) = self.people.get_mut(chosen).filter(|_| known.is_none()) {
                person.begin(time_us);
            }
            for seat in self.seats.iter_mut().filter(|seat| seat.person == chosen) {
                seat.person = before;
            }
            if let Some(seat) = self.seats.get_mut(index) {
                (seat.person, seat.is_new) = (chosen, false);
            }
        }
    }

    /// Those whose faces are not in the picture, as far as is known.
    fn away(&self) -> impl Iterator<Item = (usize, &Person)> {
        let is_here = |seat: &Seat| seat.region.is_some() && !seat.is_new;
        let is_away = move |person: usize| !self.seats.iter().any(|seat| seat.person == person && is_here(seat));
        self.people.iter().enumerate().filter(move |(place, _)| is_away(*place))
    }

    /// Who has come back with this face, if somebody has.
    fn person_like(&self, face: &facewire_face::Face, region: &FaceBox, time_us: u64) -> Option<usize> {
        let strangeness = |person: &Person| person.wearer.strangeness(face, region, person.away_s(time_us));
        let all = self.away().filter_map(|(place, person)| Some((place, strangeness(person)?)));
        let most_alike = all.min_by(|(_, one), (_, other)| one.total_cmp(other));
        most_alike.filter(|(_, strangeness)| *strangeness <= 1.0).map(|(place, _)| place)
    }

    /// Chooses a place for a new person: a free one, else that of a person who was hardly seen and has no calibrated neutral
    /// face, else that of any other person who is away. In each group, the one who left earliest is chosen, and the first
    /// place, which may have the profile, comes last.
    fn stranger(&self) -> Option<usize> {
        let rank = |(place, person): &(usize, &Person)| {
            let is_known = person.wearer.is_known() || person.solver.profile.neutral.is_some();
            (!person.is_free).then_some((is_known, *place == 0, person.seen_us))
        };
        self.away().min_by_key(rank).map(|(place, _)| place)
    }
}

fn missing(id: u64) -> Error {
    Error::Face(format!(
        "face {id} is not in the last picture; give faces that have the id of one that is. Of several faces in unrelated pictures, \
         no neutral face is kept"
    ))
}

impl Person {
    /// Forgets a person and their profile.
    fn forget(&mut self) {
        self.solver.forget();
        self.solver.profile = Profile::default();
        self.wearer.forget();
        self.is_free = true;
    }

    /// Begins with a face of which nothing is known. A profile that nobody has had yet is that of this face.
    fn begin(&mut self, time_us: u64) {
        if !self.is_free {
            self.forget();
        }
        self.is_free = false;
        self.seen_us = time_us;
    }

    /// How long the person has not been seen.
    fn away_s(&self, time_us: u64) -> f32 {
        #[expect(clippy::cast_precision_loss, reason = "a time in seconds")]
        let away_us = time_us.saturating_sub(self.seen_us) as f32;
        away_us / 1e6
    }

    /// Remembers how the face looks and where it is.
    fn remember(&mut self, face: &facewire_face::Face, region: &FaceBox, time_us: u64) {
        self.wearer.learn_from(face, region, self.away_s(time_us));
        self.seen_us = time_us;
    }
}

impl Seat {
    /// Finds the face, if there is one in the region.
    fn find(&mut self, picture: &Picture) -> Result<(), InferError> {
        // If a network fails, the landmarks are half written: there is no face then.
        let Some(region) = self.region.take() else { return Ok(()) };
        self.region = self.mesh.find(picture, &region)?.and_then(FaceBox::following);
        Ok(())
    }

    /// Solves the face that was found. Landmarks that cannot be solved are no face.
    fn solve(&mut self, person: &mut Person, camera: &Camera, time_us: u64) {
        let Some(region) = self.region.take() else { return };
        let seen = self.mesh.face();
        let Ok(solution) = person.solver.solve(seen, camera, time_us) else { return };
        person.remember(&seen, &region, time_us);
        (self.region, self.is_seen) = (Some(region), true);
        self.face.landmarks.0 = seen.landmarks.0;
        self.face.coefficients = solution.smoothed.0;
        self.face.head = solution.head;
        self.face.gaze = Gaze::of(&Coefficients(solution.smoothed.0));
        self.face.neutral = solution.neutral_face;
        self.face.visibility = solution.visibility;
        self.face.score = seen.appearance.map_or(0.0, |seen| seen.score);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

    use facewire_face::testing::{Scripted, face, show};

    use super::*;
    use crate::Format;

    #[test]
    fn detector_runs_once_for_a_picture_with_several_new_faces_and_not_while_all_are_followed() {
        let runs = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&runs);
        let engine = Scripted::new(move |mut run| {
            show(&mut run, &face([0.0; 3], 60.0, [110.0, 70.0]));
            if let ("detector", [boxes, scores]) = (run.network, &mut *run.outputs) {
                counted.fetch_add(1, Relaxed);
                // Small faces at three anchors of the middle row.
                scores.fill(-10.0);
                for anchor in [2, 8, 14].map(|column| (8 * 16 + column) * 2) {
                    scores[anchor] = 10.0;
                    boxes[16 * anchor..][2..8].copy_from_slice(&[16.0, 16.0, -4.0, -2.0, 4.0, -2.0]);
                }
            }
            Ok(())
        });
        let options = Options::default().max_faces(3);
        let mut tracker = FaceTracker::load(&options, &engine, Model::embedded()).unwrap();
        let samples = vec![128; 640 * 640];
        let picture = Format::Grey.picture(&samples, [640; 2]).unwrap();
        for _ in 0..30 {
            tracker.search(&picture).unwrap();
            assert_eq!(tracker.seats.iter().filter(|seat| seat.region.is_some()).count(), 3);
        }
        assert_eq!(runs.load(Relaxed), 1);
    }
}
