//! A face under the conditions of a take.

use super::hold::LIDS;
use super::learn::Takes;
use super::observation::{Observation, Seen, Sight};
use super::refusal::Refusal;
use super::take::{Take, mean_of};
use crate::solve::{COEFFS, Model};

/// How far the head may be turned from the camera in the neutral take (yaw, pitch, roll), and from there in the others.
const FACING_DEG: [f32; 3] = [15.0, 20.0, 15.0];
const TURNED_DEG: f32 = 12.0;
/// General coefficients from which on a face does not rest. Faces at rest measured from the mean of many people stay below.
const SHUT: f32 = 0.65;
const SMILES: f32 = 0.5;
const OPEN: f32 = 0.4;

/// A face under fair conditions: its coefficients, and how strongly it shows the pose.
pub(super) struct View<'a> {
    pub(super) seen: &'a Seen,
    pub(super) coefficients: [f32; COEFFS],
    /// In this frame, and smoothed.
    pub(super) strength_now: f32,
    pub(super) strength: f32,
}

impl<'a> View<'a> {
    /// Checks the conditions of the take.
    ///
    /// # Errors
    /// Why they do not hold.
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
