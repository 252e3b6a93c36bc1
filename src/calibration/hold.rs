//! The part of a take that is measured: the wearer holds still, and the frames are averaged.

use super::observation::{Seen, SeenMean};
use super::take::{Refusal, mean_of};
use facewire_face::{BLENDSHAPES, COEFFS};

/// Least number of frames of a hold, however slow the camera is.
const LEAST_FRAMES: u32 = 3;
/// How far the head may turn during a hold, degrees.
const STILL_DEG: f32 = 4.0;
/// How far a coefficient of the resting face may move during the neutral take. Speech moves the mouth further.
const REST_MOVES: f32 = 0.25;
/// Change of the lids from which on a frame of the neutral take shows a blink.
const BLINK: f32 = 0.25;
/// By how much a pose may grow during a hold, and from what share of its peak on it counts as released.
const GROWS: f32 = 1.2;
const RELEASED: f32 = 0.7;

pub(super) const LIDS: [&str; 2] = ["eyeBlinkLeft", "eyeBlinkRight"];

/// What a frame does to a hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fit {
    Belongs,
    /// The frame shows a blink and is left out.
    Blink,
    /// The hold begins anew with this frame, because the wearer was still moving into the pose.
    Anew,
    Broken(Refusal),
}

#[derive(Debug, Clone)]
pub(super) struct Hold {
    mean: SeenMean,
    coefficients: [f32; COEFFS],
    /// Head and strength at the beginning, and the greatest strength since.
    head_deg: [f32; 3],
    begun: f32,
    peak: f32,
    held_s: f32,
    blink_s: f32,
}

impl Hold {
    /// Begins with a frame that shows these coefficients.
    pub(super) fn begin(seen: &Seen, coefficients: &[f32; COEFFS], strength: f32) -> Self {
        let mut mean = SeenMean::default();
        mean.add(seen);
        let (coefficients, head_deg) = (*coefficients, seen.head_deg);
        Self { mean, coefficients, head_deg, begun: strength, peak: strength, held_s: 0.0, blink_s: 0.0 }
    }

    pub(super) fn judge_rest(&self, seen: &Seen, coefficients: &[f32; COEFFS]) -> Fit {
        let count = self.mean.frames() as f32;
        let before = self.coefficients.map(|sum| sum / count);
        let lids = mean_of(&LIDS, coefficients) - mean_of(&LIDS, &before);
        if lids > BLINK {
            return Fit::Blink;
        }
        if lids < -BLINK {
            return Fit::Anew;
        }
        let rests = |name: &str| !name.starts_with("eye");
        let resting = BLENDSHAPES.iter().zip(coefficients.iter().zip(&before)).filter(|(name, _)| rests(name));
        let changes = resting.map(|(_, (value, before))| (value - before).abs());
        match self.is_head_still(seen) {
            false => Fit::Broken(Refusal::HeadMoves),
            true if changes.fold(0.0, f32::max) > REST_MOVES => Fit::Broken(Refusal::FaceMoves),
            true => Fit::Belongs,
        }
    }

    /// Judges the next frame of a pose, which is seen with this strength.
    pub(super) fn judge_pose(&self, seen: &Seen, strength: f32) -> Fit {
        match strength {
            _ if !self.is_head_still(seen) => Fit::Broken(Refusal::HeadMoves),
            _ if strength > GROWS * self.begun => Fit::Anew,
            _ if strength < RELEASED * self.peak => Fit::Broken(Refusal::TooShort),
            _ => Fit::Belongs,
        }
    }

    fn is_head_still(&self, seen: &Seen) -> bool {
        self.head_deg.iter().zip(seen.head_deg).all(|(before, now)| (now - before).abs() <= STILL_DEG)
    }

    /// Adds a frame that came `step_s` after the last one.
    pub(super) fn add(&mut self, seen: &Seen, coefficients: &[f32; COEFFS], strength: f32, step_s: f32) {
        self.mean.add(seen);
        self.coefficients.iter_mut().zip(coefficients).for_each(|(sum, value)| *sum += value);
        self.peak = self.peak.max(strength);
        self.held_s += step_s;
        self.blink_s = 0.0;
    }

    /// Leaves out a frame that shows a blink. Returns for how long the blink has lasted.
    pub(super) fn blink(&mut self, step_s: f32) -> f32 {
        self.blink_s += step_s;
        self.blink_s
    }

    /// How much of a hold of `wanted_s` is done, 0 to 1.
    pub(super) fn done(&self, wanted_s: f32) -> f32 {
        let frames = self.mean.frames() as f32 / LEAST_FRAMES as f32;
        (self.held_s / wanted_s).min(frames).clamp(0.0, 1.0)
    }

    pub(super) fn finish(&self) -> Option<Seen> {
        self.mean.finish()
    }
}
