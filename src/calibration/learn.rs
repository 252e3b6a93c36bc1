//! What the takes tell about the wearer.
//!
//! The neutral face is that of the neutral take, and the rest is what the model still reads of that face, measured from
//! itself. The gain of a coefficient compares what the pose that raises it reads with what it reads of most people, by the
//! shipped model. Shut lids then read 1. In other poses, how far people go differs from time to time, and a model that reads
//! little of a full expression often reads most of a small one. The gain therefore makes up only a part of the difference,
//! and is 1 for poses where a gain would make expressions between rest and pose worse.

use std::collections::BTreeMap;

use facewire_face::{BLENDSHAPES, COEFFS, MAX_REST, Model, Neutral, Profile};

use super::observation::Seen;
use super::take::{Refusal, Take, mean_of};

const GAIN: [f32; 2] = [0.6, 1.6];
/// Least reading of a pose, above the rest, from which a gain can be found.
const LEAST_MEASURED: f32 = 0.1;

/// Returns the typical reading of a pose, and the power `p` with which the gain `(typical / reading)^p` is computed.
///
/// A typical reading is the mean over 20 rendered people who show 75 to 100 % of the expression. The powers have the
/// least mean squared error over 20 s of recorded expressions; each half of the people gives them within 0.25.
fn typical(pose: Take) -> (f32, f32) {
    match pose {
        Take::EyesShut => (0.79, 1.0),
        Take::BrowsDown => (0.36, 0.5),
        Take::LookLeft | Take::LookRight => (0.71, 0.5),
        Take::LookUp => (0.37, 0.75),
        Take::LookDown => (0.52, 0.25),
        Take::Neutral | Take::JawOpen | Take::BrowsUp | Take::Smile | Take::Pucker => (1.0, 0.0),
    }
}

#[derive(Debug)]
pub(super) struct Known {
    pub(super) neutral: Neutral,
    pub(super) head_deg: [f32; 3],
    /// Output of the regression for it, relative to itself.
    pub(super) raw: [f32; COEFFS],
}

/// The accepted takes. Poses are kept as they were seen, so that they stay valid when the neutral take is repeated.
#[derive(Debug, Default)]
pub(super) struct Takes {
    pub(super) neutral: Option<Known>,
    poses: BTreeMap<Take, Seen>,
}

impl Takes {
    /// Keeps a take. `None` if the model can make nothing of it.
    pub(super) fn insert(&mut self, model: &Model, take: Take, seen: Seen) -> Option<()> {
        if take == Take::Neutral {
            let neutral = Neutral::from_points(&seen.face.points).ok()?;
            let raw = seen.raw(model, Some(&neutral))?;
            self.neutral = Some(Known { neutral, head_deg: seen.head_deg, raw });
        } else {
            self.poses.insert(take, seen);
        }
        Some(())
    }

    fn raw(&self, model: &Model, pose: Take) -> Option<[f32; COEFFS]> {
        self.poses.get(&pose)?.raw(model, Some(&self.neutral.as_ref()?.neutral))
    }

    pub(super) fn taken(&self) -> Vec<Take> {
        self.neutral.iter().map(|_| Take::Neutral).chain(self.poses.keys().copied()).collect()
    }
}

pub(super) fn learn(model: &Model, takes: &Takes) -> Option<Profile> {
    let known = takes.neutral.as_ref()?;
    let mut profile = Profile { neutral: Some(known.neutral.clone()), ..Profile::default() };
    for (rest, (raw, terms)) in profile.rest.iter_mut().zip(known.raw.iter().zip(&model.correction.0)) {
        // A reading below 0 is sent as 0. Taking it off, too, would lift the noise of the resting face.
        *rest = terms.rest_of(*raw).clamp(0.0, MAX_REST);
    }
    for pose in takes.poses.keys().copied() {
        let Some(raw) = takes.raw(model, pose) else { continue };
        let (typical, power) = typical(pose);
        let wearer = profile.gain.iter_mut().zip(&profile.rest).zip(&raw);
        for (name, ((gain, rest), raw)) in BLENDSHAPES.iter().zip(wearer) {
            if pose.raises().contains(name) && raw - rest > LEAST_MEASURED {
                *gain = (typical / (raw - rest)).powf(power).clamp(GAIN[0], GAIN[1]);
            }
        }
    }
    Some(profile)
}

/// The neutral take is in doubt if the median reading of a part of the face, in the poses that leave that part at rest,
/// lies this far or farther from the neutral take.
const BELOW: f32 = -0.2;
const LEAST_POSES: usize = 3;

/// Parts of the face: the pose that moves one, the poses that leave it at rest, and what the wearer did in a neutral take
/// in which it was not at rest.
const PARTS: [(Take, &[Take], Refusal); 4] = {
    use Take::*;
    [
        (Smile, &[EyesShut, BrowsUp, LookLeft, LookRight, LookUp, LookDown], Refusal::Smiling),
        (JawOpen, &[EyesShut, BrowsUp, BrowsDown, LookLeft, LookRight, LookUp], Refusal::MouthOpen),
        (EyesShut, &[JawOpen, BrowsUp, Pucker, LookLeft, LookRight], Refusal::EyesShut),
        (BrowsUp, &[EyesShut, Smile, Pucker, LookLeft, LookRight, LookDown], Refusal::BrowsMoved),
    ]
};

/// Why the poses contradict the neutral take, if they do: a pose moves one part of the face while the others rest, so that
/// most poses show what the other parts look like at rest.
pub(super) fn doubt(model: &Model, takes: &Takes) -> Option<Refusal> {
    let known = takes.neutral.as_ref()?;
    PARTS.into_iter().find_map(|(part, poses, refusal)| {
        let strength = |raw: &[f32; COEFFS]| mean_of(part.raises(), raw);
        let raw = poses.iter().filter_map(|pose| takes.raw(model, *pose));
        let mut moved: Vec<f32> = raw.map(|raw| strength(&raw) - strength(&known.raw)).collect();
        moved.sort_by(f32::total_cmp);
        let median = moved.get(moved.len() / 2).filter(|_| moved.len() >= LEAST_POSES)?;
        (*median < BELOW).then_some(refusal)
    })
}
