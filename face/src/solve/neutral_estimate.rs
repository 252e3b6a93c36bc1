//! Estimates the wearer's neutral face while it watches.
//!
//! A face that faces the camera, holds still, and that the model reads as nearly at rest ([`rest`]), is averaged, weighted
//! by how sure that is. A wearer who only speaks or smiles gives no evidence, so that no expression becomes neutral. The
//! outputs by which a frame is judged count as measured from the mean of many people, whatever the reference is by
//! now: otherwise a half-smile that is held would look more like rest the more of it was learned.
//!
//! The reference moves from the mean to the estimate at a bounded speed, and so does the output. When another person
//! sits down ([`identity`]), it moves back, and learning begins anew.
//!
//! Limits: of a wearer whose face at rest reads like an expression (root sum square beyond 0.45), or whose eyes read as 0.3
//! shut, nothing is learned. Only a calibration can tell that from a smile or tiredness. Outputs at rest are not
//! subtracted: in films of 20 people that raised the error, because an output below 0 at rest says nothing.

mod identity;
mod rest;
#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::float_cmp)]
mod tests;

use self::{
    identity::{Identity, Verdict},
    rest::RestWatch,
};
use super::{
    COEFFS, RawCoeffs, Reference,
    affine::Normalised,
    features::measure,
    filter::{approach, difference, square},
    neutral::Neutral,
};
use crate::model::MEASURES;

/// Longest time that one frame counts for, seconds.
const LONGEST_STEP_S: f32 = 0.1;
/// A longer pause between frames is a gap: somebody else may have sat down.
const GAP_S: f32 = 0.5;
/// Speeds that heads hardly reach, per second: eye distances, change of size as a factor, and sine of the turn.
const MOST_SPEED: f32 = 12.0;
const MOST_ZOOM: f32 = 4.0;
const MOST_TURN: f32 = 6.0;
/// Shorter times between frames count as this one, seconds, because frames in quick succession show some jitter, too.
const SHORTEST_JUMP_S: f32 = 0.033;
/// Evidence at which the reference is half the wearer's, seconds at full weight. Landmarks are so steady that a few
/// frames are a good mean, even of faces that are only nearly at rest. `facewire-fit wearers` shows what is
/// learned from wearers who are never at rest.
const HALF_EVIDENCE_S: f32 = 0.005;
/// Evidence that is remembered, seconds at full weight. Later frames replace it little by little.
const MEMORY_S: f32 = 30.0;
/// Bounds on the speed of the share, per second.
const RISE_PER_S: f32 = 0.05;
const FALL_PER_S: f32 = 0.25;
/// Time in which the reference in use follows the estimate by 63 %, seconds.
const FOLLOW_S: f32 = 5.0;

/// What the estimate does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NeutralMode {
    /// Learns and is used.
    Auto,
    /// Is used as it is.
    Frozen,
    /// Is not used: what was learned fades out.
    #[default]
    Off,
}

/// The estimate of the wearer's neutral face. All memory is taken when it is made.
#[derive(Debug, Clone)]
pub(super) struct NeutralEstimate {
    /// Mean of the measures at rest.
    mean: Box<[f32; MEASURES]>,
    /// Mean of the outputs at rest, measured from the mean of many people.
    outputs: [f32; COEFFS],
    /// Weight of both means.
    evidence_s: f32,
    /// The face that the reference contains by `share`.
    used: Neutral,
    share: f32,
    /// Whether `used` shows somebody who has left.
    is_fading: bool,
    forgotten: u64,
    watch: RestWatch,
    identity: Identity,
    /// Where the last face was.
    position: Option<Position>,
}

/// Where a face is in the picture.
#[derive(Debug, Clone, Copy)]
struct Position {
    origin_px: [f32; 2],
    scale_px: f32,
    turns: [f32; 2],
}

impl Default for NeutralEstimate {
    fn default() -> Self {
        let measures = Box::new([0.0; MEASURES]);
        Self {
            mean: measures.clone(),
            outputs: [0.0; COEFFS],
            evidence_s: 0.0,
            used: Neutral { measures },
            share: 0.0,
            is_fading: false,
            forgotten: 0,
            watch: RestWatch::default(),
            identity: Identity::default(),
            position: None,
        }
    }
}

impl NeutralEstimate {
    /// What displacements are measured from.
    pub(super) fn reference(&self) -> Reference<'_> {
        Reference::between(&self.used, self.share)
    }

    /// Share of the wearer's own face in the reference, from 0 to 1.
    pub(super) fn share(&self) -> f32 {
        self.share
    }

    /// How often another person was noticed.
    pub(super) fn forgotten(&self) -> u64 {
        self.forgotten
    }

    /// Takes in a frame `step_s` seconds after the last one, and what the regression made of it with [`Self::reference`].
    /// Does not allocate.
    pub(super) fn update(&mut self, mode: NeutralMode, face: &Normalised, raw: &RawCoeffs, step_s: f32) {
        let dt_s = step_s.min(LONGEST_STEP_S);
        if mode == NeutralMode::Auto {
            if self.has_jumped(face, dt_s) || step_s > GAP_S {
                self.watch = RestWatch::default();
                self.identity.gap();
            }
            match self.identity.update(face, dt_s) {
                Verdict::Same if !self.is_fading => self.learn(face, raw, dt_s),
                Verdict::Same | Verdict::Doubtful => {}
                Verdict::Another => self.forget(),
            }
        }
        if mode != NeutralMode::Frozen {
            self.follow(mode, dt_s);
        }
    }

    /// Whether the face is where hardly a head moves to in this time: perhaps the picture shows somebody else.
    fn has_jumped(&mut self, face: &Normalised, dt_s: f32) -> bool {
        let position = Position { origin_px: face.origin_px, scale_px: face.scale_px, turns: face.turns() };
        self.position.replace(position).is_some_and(|last| position.is_far_from(last, dt_s))
    }

    fn learn(&mut self, face: &Normalised, raw: &RawCoeffs, dt_s: f32) {
        let mut outputs = raw.0;
        outputs.iter_mut().zip(&self.outputs).for_each(|(output, rest)| *output += self.share * rest);
        let weight_s = self.watch.weight(face, &outputs, dt_s) * dt_s;
        if weight_s <= 0.0 {
            return;
        }
        self.evidence_s = (self.evidence_s + weight_s).min(MEMORY_S);
        let passed = (weight_s / self.evidence_s).min(1.0);
        approach(&mut self.mean, &measure(&face.points), passed);
        approach(&mut self.outputs, &outputs, passed);
    }

    fn forget(&mut self) {
        self.is_fading = self.share > 0.0;
        self.evidence_s = 0.0;
        self.forgotten += 1;
        self.watch = RestWatch::default();
    }

    /// The share that the estimate deserves: the more evidence, and the nearer to rest the model reads its mean.
    fn wanted_share(&self) -> f32 {
        self.evidence_s / (self.evidence_s + HALF_EVIDENCE_S) * rest::quality(&self.outputs)
    }

    /// Moves the reference towards the estimate.
    fn follow(&mut self, mode: NeutralMode, dt_s: f32) {
        let is_wanted = mode == NeutralMode::Auto && !self.is_fading;
        let wanted = if is_wanted { self.wanted_share() } else { 0.0 };
        let has_begun = self.share > 0.0;
        self.share = wanted.clamp(self.share - FALL_PER_S * dt_s, self.share + RISE_PER_S * dt_s).max(0.0);
        self.is_fading &= self.share > 0.0;
        if is_wanted && self.share > 0.0 {
            let passed = if has_begun { (dt_s / FOLLOW_S).min(1.0) } else { 1.0 };
            approach(&mut self.used.measures, &self.mean, passed);
        }
    }
}

impl Position {
    fn is_far_from(self, last: Self, dt_s: f32) -> bool {
        let distance = |a: [f32; 2], b: [f32; 2]| square(difference(a, b)).sqrt();
        // Frames that come at once have jitter, too.
        let time_s = dt_s.max(SHORTEST_JUMP_S);
        distance(self.origin_px, last.origin_px) > MOST_SPEED * time_s * last.scale_px
            || distance(self.turns, last.turns) > MOST_TURN * time_s
            || (self.scale_px / last.scale_px - 1.0).abs() > MOST_ZOOM * time_s
    }
}
