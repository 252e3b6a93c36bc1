//! What one frame shows of the wearer, and whether it meets the conditions of a take.

use super::hold::LIDS;
use super::learn::Takes;
use super::take::{Refusal, Take, mean_of};
use facewire_face::stages::{FaceMean, Features, Normalised, Residual, normalise};
use facewire_face::{COEFFS, Camera, Face, HeadPose, Model, Neutral};

/// How far the head may be turned from the camera in the neutral take (yaw, pitch, roll), and from there in the others.
const FACING_DEG: [f32; 3] = [15.0, 20.0, 15.0];
const TURNED_DEG: f32 = 12.0;
/// General coefficients from which on a face does not rest. Faces at rest measured from the mean of many people stay below.
const SHUT: f32 = 0.65;
const SMILES: f32 = 0.5;
const OPEN: f32 = 0.4;

/// What one frame shows of the wearer. Has a fixed size, so that it can be handed from thread to thread without allocation.
#[derive(Debug, Clone, PartialEq)]
pub struct Observation {
    pub time_us: u64,
    /// Whether the light is too poor for a calibration.
    pub is_dark: bool,
    pub sight: Sight,
}

#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "observations live in a ring, none on the heap")]
pub enum Sight {
    /// There is no frame: the camera is silent or gone.
    NoPicture,
    /// The frame shows no face, or none that can be read.
    NoFace,
    Face(Seen),
}

#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// The face in its own basis.
    pub face: Normalised,
    /// What the look of the face adds to the coefficients: first while the neutral face is unknown, then once it is
    /// known.
    pub residuals: [Residual; 2],
    pub head_deg: [f32; 3],
}

impl Observation {
    pub fn nothing(time_us: u64) -> Self {
        Self { time_us, is_dark: false, sight: Sight::NoPicture }
    }

    /// Observes the face of a frame that was captured at `time_us`, `None` if the frame shows none. Does not allocate.
    pub fn new(model: &Model, face: Option<Face<'_>>, camera: &Camera, time_us: u64, is_dark: bool) -> Self {
        let seen = face.and_then(|face| Seen::new(model, face, camera));
        Self { time_us, is_dark, sight: seen.map_or(Sight::NoFace, Sight::Face) }
    }

    /// Whether the frame shows a face that can be read.
    pub fn shows_face(&self) -> bool {
        matches!(self.sight, Sight::Face(_))
    }
}

impl Seen {
    fn new(model: &Model, Face { landmarks, appearance }: Face<'_>, camera: &Camera) -> Option<Self> {
        let face = normalise(landmarks).ok()?;
        let head = HeadPose::new(&face, camera);
        let residual = |known| model.residual(appearance, known);
        let nothing = Residual([0.0; COEFFS]);
        let residuals = [residual(0.0).ok()?.unwrap_or(nothing), residual(1.0).ok()?.unwrap_or(nothing)];
        Some(Self { face, residuals, head_deg: head.yaw_pitch_roll_deg() })
    }

    /// Output of the regression for this face. Without a neutral face it is measured from the mean of many people. `None`
    /// if the model makes nothing of it.
    pub fn raw(&self, model: &Model, neutral: Option<&Neutral>) -> Option<[f32; COEFFS]> {
        let [unknown, known] = &self.residuals;
        let raw = model.process(&Features::new(&self.face, neutral)).ok()?;
        Some(raw.plus(if neutral.is_some() { known } else { unknown }).0)
    }
}

#[derive(Debug, Clone)]
pub(super) struct SeenMean {
    faces: FaceMean,
    residuals: [Residual; 2],
    head_deg: [f32; 3],
}

impl Default for SeenMean {
    fn default() -> Self {
        Self { faces: FaceMean::default(), residuals: [Residual([0.0; COEFFS]); 2], head_deg: [0.0; 3] }
    }
}

impl SeenMean {
    pub(super) fn add(&mut self, seen: &Seen) {
        self.faces.add(&seen.face);
        for (sums, residual) in self.residuals.iter_mut().zip(&seen.residuals) {
            sums.0.iter_mut().zip(&residual.0).for_each(|(sum, value)| *sum += value);
        }
        self.head_deg.iter_mut().zip(seen.head_deg).for_each(|(sum, value)| *sum += value);
    }

    pub(super) fn frames(&self) -> u32 {
        self.faces.frames()
    }

    pub(super) fn finish(&self) -> Option<Seen> {
        let count = self.frames() as f32;
        let residuals = self.residuals.map(|sums| Residual(sums.0.map(|sum| sum / count)));
        Some(Seen { face: self.faces.finish()?, residuals, head_deg: self.head_deg.map(|sum| sum / count) })
    }
}

/// A face under fair conditions: its coefficients, and how strongly it shows the pose.
pub(super) struct View<'a> {
    pub(super) seen: &'a Seen,
    pub(super) coefficients: [f32; COEFFS],
    /// In this frame, and smoothed.
    pub(super) strength_now: f32,
    pub(super) strength: f32,
}

impl<'a> View<'a> {
    pub(super) fn new(model: &Model, takes: &Takes, take: Take, observation: &'a Observation) -> Result<Self, Refusal> {
        let seen = match &observation.sight {
            Sight::NoPicture => return Err(Refusal::NoPicture),
            _ if observation.is_dark => return Err(Refusal::TooDark),
            Sight::NoFace => return Err(Refusal::NoFace),
            Sight::Face(seen) => seen,
        };
        let neutral = takes.neutral().filter(|_| take != Take::Neutral);
        let (from, limits) = neutral.map_or(([0.0; 3], FACING_DEG), |known| (known.seen.head_deg, [TURNED_DEG; 3]));
        let mut angles = seen.head_deg.iter().zip(from).zip(limits);
        // An angle that is not a number is refused, too.
        if !angles.all(|((angle, from), limit)| (angle - from).abs() <= limit) {
            return Err(Refusal::HeadTurned);
        }
        let coefficients = seen.raw(model, neutral.map(|known| &known.neutral)).ok_or(Refusal::NoFace)?;
        let strength = neutral.map_or(0.0, |known| take.strength(&coefficients) - take.strength(&known.raw));
        Ok(Self { seen, coefficients, strength_now: strength, strength })
    }

    /// Why the face is not what the take asks for.
    pub(super) fn unfit(&self, take: Take) -> Option<Refusal> {
        match take {
            Take::Neutral => not_at_rest(&self.coefficients),
            _ => (self.strength < take.threshold()).then_some(Refusal::NotSeen),
        }
    }
}

/// Why a face, measured from the mean of many people, is not at rest.
fn not_at_rest(general: &[f32; COEFFS]) -> Option<Refusal> {
    let shows = |names: &[&str], limit: f32| mean_of(names, general) > limit;
    match general {
        _ if shows(&LIDS, SHUT) => Some(Refusal::EyesShut),
        _ if shows(Take::Smile.raises(), SMILES) => Some(Refusal::Smiling),
        _ if shows(Take::JawOpen.raises(), OPEN) => Some(Refusal::MouthOpen),
        _ => None,
    }
}
