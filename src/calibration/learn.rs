//! What the takes tell about the wearer.
//!
//! - The neutral face is that of the neutral take, and the rest is what the model reads there in spite of it.
//! - The gain of a coefficient follows from the pose that raises it to the end of its range. Shut lids must read 1. How
//!   far people go in the other poses differs from person to person and from time to time, so that their gain is moved
//!   only part of the way from 1.

use super::observation::Seen;
use super::take::Take;
use crate::solve::{BLENDSHAPES, COEFFS, MAX_REST, Model, Neutral, NeutralMean, Profile};

/// What a full pose reads after calibration, if its gain is moved all the way.
const TARGET: f32 = 0.9;
/// How far the gain is moved from 1.
const TRUST: f32 = 0.7;
/// Bounds of gains.
const GAIN: [f32; 2] = [0.6, 1.6];

/// The neutral take.
#[derive(Debug, Clone)]
pub(super) struct Known {
    pub(super) neutral: Neutral,
    pub(super) seen: Seen,
    /// Output of the regression for it, relative to itself.
    pub(super) raw: [f32; COEFFS],
}

/// The accepted takes. Poses are kept as they were seen, so that they stay valid when the neutral take is repeated.
#[derive(Debug, Clone, Default)]
pub(super) struct Takes {
    neutral: Option<Known>,
    poses: [Option<Box<Seen>>; Take::ALL.len()],
}

impl Takes {
    /// Keeps a take. Returns whether the model can make anything of it.
    pub(super) fn insert(&mut self, model: &Model, take: Take, seen: Seen) -> bool {
        if take != Take::Neutral {
            self.poses.iter_mut().skip(take.index()).take(1).for_each(|slot| *slot = Some(Box::new(seen.clone())));
            return true;
        }
        let mut mean = NeutralMean::default();
        mean.add(&seen.face);
        let Ok(neutral) = mean.finish() else { return false };
        let Some(raw) = seen.raw(model, Some(&neutral)) else { return false };
        self.neutral = Some(Known { neutral, seen, raw });
        true
    }

    pub(super) fn neutral(&self) -> Option<&Known> {
        self.neutral.as_ref()
    }

    /// Output of the regression in a pose, relative to the neutral take.
    pub(super) fn raw(&self, model: &Model, pose: Take) -> Option<[f32; COEFFS]> {
        self.poses.get(pose.index())?.as_ref()?.raw(model, Some(&self.neutral()?.neutral))
    }

    /// The accepted takes, in order.
    pub(super) fn taken(&self) -> impl Iterator<Item = Take> {
        let neutral = self.neutral.iter().map(|_| Take::Neutral);
        let poses = Take::ALL.into_iter().zip(&self.poses).filter(|(_, seen)| seen.is_some()).map(|(take, _)| take);
        neutral.chain(poses)
    }
}

/// Learns the wearer's profile. `None` without a neutral take.
pub(super) fn learn(model: &Model, takes: &Takes) -> Option<Profile> {
    let known = takes.neutral()?;
    let mut profile = Profile { neutral: Some(known.neutral.clone()), ..Profile::default() };
    let terms = &model.correction.0;
    for (rest, (raw, terms)) in profile.rest.iter_mut().zip(known.raw.iter().zip(terms)) {
        *rest = terms.rest_of(*raw).clamp(-MAX_REST, MAX_REST);
    }
    for pose in Take::ALL {
        let Some(raw) = takes.raw(model, pose) else { continue };
        let numbers = profile.gain.iter_mut().zip(profile.rest).zip(raw.into_iter().zip(terms));
        for (name, ((gain, rest), (raw, terms))) in BLENDSHAPES.iter().zip(numbers) {
            if pose.raises().contains(name) {
                let (target, trust) = if pose == Take::EyesShut { (1.0, 1.0) } else { (TARGET, TRUST) };
                let full = terms.gain_for(raw, rest, target).unwrap_or(1.0);
                *gain = (1.0 + trust * (full - 1.0)).clamp(GAIN[0], GAIN[1]);
            }
        }
    }
    Some(profile)
}
