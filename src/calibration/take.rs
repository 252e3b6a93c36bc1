//! The takes of a calibration: what the wearer is asked to do, why a take is refused, and what the takes tell about the
//! wearer.

use std::collections::BTreeMap;

use facewire_face::stages::{Coefficients, Normalised};
use facewire_face::{BLENDSHAPES, COEFFS, EyeValues, MAX_REST, Model, MouthValues, Neutral, Profile, Wears};
use facewire_packet::control::{Refusal, Take};

pub(super) const LIDS: [&str; 2] = ["eyeBlinkLeft", "eyeBlinkRight"];

/// What the guide and the profile expect of a take.
pub(super) struct Expected {
    /// The coefficients that the pose raises to the end of their range.
    pub(super) raises: &'static [&'static str],
    /// By how much the strength must exceed that of the neutral take for the pose to count as seen. The faintest poses of
    /// people who were asked for them exceed it by more, and faces at rest by less.
    pub(super) threshold: f32,
    /// How far the lids may close during the take. A frame in which they are closed further shows a blink. Some poses lower
    /// the lids, too.
    pub(super) lids: f32,
    /// The typical reading of the pose, and the power `p` with which the gain `(typical / reading)^p` is computed.
    ///
    /// `fit/poses.py` finds both from rendered people who show 75 to 100 % of the expression. Most people's strong and weak
    /// poses differ by chance, so that the power is small or 0, except for lids, which are to close.
    typical: (f32, f32),
}

pub(super) fn expected(take: Take) -> Expected {
    let (raises, threshold, lids, typical): (&[_], _, _, _) = match take {
        Take::Neutral => (&[], 0.0, f32::INFINITY, (1.0, 0.0)),
        Take::EyesShut => (&LIDS, 0.45, f32::INFINITY, (0.82, 1.0)),
        Take::JawOpen => (&["jawOpen"], 0.3, 0.5, (1.0, 0.0)),
        Take::BrowsUp => (&["browInnerUp", "browOuterUpLeft", "browOuterUpRight"], 0.25, 0.5, (1.0, 0.0)),
        Take::BrowsDown => (&["browDownLeft", "browDownRight"], 0.25, 0.8, (0.26, 0.25)),
        Take::Smile => (&["mouthSmileLeft", "mouthSmileRight"], 0.25, 0.8, (1.0, 0.0)),
        Take::Pucker => (&["mouthPucker"], 0.25, 0.5, (1.0, 0.0)),
        Take::LookLeft => (&["eyeLookOutLeft", "eyeLookInRight"], 0.3, 0.5, (0.89, 0.25)),
        Take::LookRight => (&["eyeLookInLeft", "eyeLookOutRight"], 0.3, 0.5, (0.89, 0.25)),
        Take::LookUp => (&["eyeLookUpLeft", "eyeLookUpRight"], 0.2, 0.5, (0.80, 0.25)),
        Take::LookDown => (&["eyeLookDownLeft", "eyeLookDownRight"], 0.2, 0.8, (0.65, 0.25)),
    };
    Expected { raises, threshold, lids, typical }
}

/// The takes of a wearer who has this on the face: a pose that is covered cannot be seen. Under a headset, the mouth is read from
/// its picture, and only its rest is learned.
pub(super) fn takes_of(wears: Wears) -> impl Iterator<Item = Take> {
    let is_of_mouth = |take| matches!(take, Take::JawOpen | Take::Smile | Take::Pucker);
    Take::ALL.into_iter().filter(move |take| match wears {
        Wears::Nothing => true,
        Wears::Headset => *take == Take::Neutral,
        Wears::Mask => !is_of_mouth(*take),
    })
}

/// How strongly a pose is seen: the mean of its coefficients, or, for shut eyes, the lid that is less shut.
pub(super) fn strength(take: Take, coefficients: &[f32; COEFFS]) -> f32 {
    match take {
        Take::EyesShut => LIDS.iter().map(|name| mean_of(&[name], coefficients)).fold(f32::MAX, f32::min),
        _ => mean_of(expected(take).raises, coefficients),
    }
}

pub(super) fn mean_of(names: &[&str], coefficients: &[f32; COEFFS]) -> f32 {
    let chosen = BLENDSHAPES.iter().zip(coefficients).filter(|(name, _)| names.contains(name));
    chosen.map(|(_, value)| value).sum::<f32>() / names.len().max(1) as f32
}

const GAIN: [f32; 2] = [0.6, 1.6];
/// Least reading of a pose, above the rest, from which a gain can be found.
const LEAST_MEASURED: f32 = 0.1;

/// What the neutral take tells the poses.
pub(super) struct Known {
    pub(super) neutral: Neutral,
    pub(super) head_deg: [f32; 3],
    /// Output of the regression for the neutral face, measured from that face itself.
    pub(super) raw: [f32; COEFFS],
}

/// A face as one frame shows it, or as the mean of the frames of a hold.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    pub face: Normalised,
    /// What the look of the face adds to the coefficients, while the neutral face is unknown and once it is known.
    pub residuals: [Coefficients; 2],
    /// What the network of the eyes gives, if the face was seen in a picture.
    pub eyes: Option<EyeValues>,
    /// What the network of the mouth gives, likewise.
    pub mouth: Option<MouthValues>,
    pub head_deg: [f32; 3],
}

/// The accepted takes. Poses are kept as they were seen, so that they stay valid when the neutral take is repeated.
#[derive(Default)]
pub(super) struct Takes {
    pub(super) wears: Wears,
    pub(super) neutral: Option<Known>,
    poses: BTreeMap<Take, Seen>,
}

impl Takes {
    /// No takes yet, of a wearer who has this on the face.
    pub(super) fn of(wears: Wears) -> Self {
        Self { wears, ..Self::default() }
    }

    /// Keeps a take. `None` if the model can make nothing of it.
    pub(super) fn insert(&mut self, model: &Model, take: Take, seen: Seen) -> Option<()> {
        if take == Take::Neutral {
            let neutral = Neutral::from_points(&seen.face.points).ok()?;
            let raw = seen.raw(model, Some(&neutral), self.wears)?;
            self.neutral = Some(Known { neutral, head_deg: seen.head_deg, raw });
        } else {
            self.poses.insert(take, seen);
        }
        Some(())
    }

    fn raw(&self, model: &Model, pose: Take) -> Option<[f32; COEFFS]> {
        self.poses.get(&pose)?.raw(model, Some(&self.neutral.as_ref()?.neutral), self.wears)
    }

    pub(super) fn taken(&self) -> Vec<Take> {
        self.neutral.iter().map(|_| Take::Neutral).chain(self.poses.keys().copied()).collect()
    }
}

/// Learns the wearer's profile.
///
/// The neutral face is that of the neutral take, and the rest is what the model still reads of that face, measured from
/// itself. The gain of a coefficient compares its reading in the pose that raises it with the reading that the shipped
/// model gives for most people. Shut lids then read 1. In other poses, how far people go differs from time to time, and a
/// model that reads little of a full expression often reads most of a small one. The gain therefore makes up only a part
/// of the difference, and is 1 for poses where a gain would make expressions between rest and pose worse.
pub(super) fn learn(model: &Model, takes: &Takes) -> Option<Profile> {
    let known = takes.neutral.as_ref()?;
    let mut profile = Profile::from(known.neutral.clone());
    profile.wears = takes.wears;
    for (rest, (raw, terms)) in profile.rest.iter_mut().zip(known.raw.iter().zip(&model.correction.0)) {
        // A reading below 0 is sent as 0 in any case. Subtracting it would lift the noise of the resting face.
        *rest = terms.rest_of(*raw).clamp(0.0, MAX_REST);
    }
    for pose in takes.poses.keys().copied() {
        let Some(raw) = takes.raw(model, pose) else { continue };
        let (typical, power) = expected(pose).typical;
        let wearer = profile.gain.iter_mut().zip(&profile.rest).zip(&raw);
        for (name, ((gain, rest), raw)) in BLENDSHAPES.iter().zip(wearer) {
            if expected(pose).raises.contains(name) && raw - rest > LEAST_MEASURED {
                *gain = (typical / (raw - rest)).powf(power).clamp(GAIN[0], GAIN[1]);
            }
        }
    }
    Some(profile)
}

/// The neutral take is in doubt if the median reading of a part of the face, in the poses that leave that part at rest,
/// lies farther below that of the neutral take than this.
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
        let strength = |raw: &[f32; COEFFS]| mean_of(expected(part).raises, raw);
        let raw = poses.iter().filter_map(|pose| takes.raw(model, *pose));
        let mut moved: Vec<f32> = raw.map(|raw| strength(&raw) - strength(&known.raw)).collect();
        moved.sort_by(f32::total_cmp);
        let median = moved.get(moved.len() / 2).filter(|_| moved.len() >= LEAST_POSES)?;
        (*median < BELOW).then_some(refusal)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_raise_blendshapes_that_exist_and_each_only_once() {
        let mut raised = Vec::new();
        for take in Take::ALL {
            let is_new = |name| BLENDSHAPES.contains(name) && !raised.contains(name);
            assert!(expected(take).raises.iter().all(is_new), "{take:?}");
            raised.extend(expected(take).raises);
        }
    }
}
