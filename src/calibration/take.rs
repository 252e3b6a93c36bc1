//! The takes of a calibration: what the wearer is asked to do, why a take is refused, and what the takes tell about the
//! wearer.

use std::collections::BTreeMap;

use facewire_face::stages::{Coefficients, Normalised};
use facewire_face::{BLENDSHAPES, COEFFS, MAX_REST, Model, Neutral, Profile};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub(super) const LIDS: [&str; 2] = ["eyeBlinkLeft", "eyeBlinkRight"];

/// Declares the takes in the order in which the guide asks for them, with what `Take` says of each.
macro_rules! takes {
    ($( $take:ident $name:literal: $instruction:literal, $raises:expr,
        threshold $threshold:literal, lids $lids:expr, typical $typical:expr; )*) => {
        /// One thing that the wearer is asked to do. Left and right are the wearer's.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum Take {
            $( $take, )*
        }

        impl Take {
            pub const ALL: [Self; 11] = [ $( Self::$take, )* ];

            /// The name in files.
            pub fn name(self) -> &'static str {
                match self { $( Self::$take => $name, )* }
            }

            pub fn instruction(self) -> &'static str {
                match self { $( Self::$take => $instruction, )* }
            }

            /// The coefficients that the pose raises to the end of their range.
            pub fn raises(self) -> &'static [&'static str] {
                match self { $( Self::$take => &$raises, )* }
            }

            /// By how much the strength must exceed that of the neutral take for the pose to count as seen. The faintest
            /// poses of people who were asked for them exceed it by more, and faces at rest by less.
            pub(super) fn threshold(self) -> f32 {
                match self { $( Self::$take => $threshold, )* }
            }

            /// How far the lids may close during the take. A frame in which they are closed further shows a blink. Some
            /// poses lower the lids, too.
            pub(super) fn lids(self) -> f32 {
                match self { $( Self::$take => $lids, )* }
            }

            /// Returns the typical reading of a pose, and the power `p` with which the gain `(typical / reading)^p` is
            /// computed.
            ///
            /// `fit/poses.py` finds both from rendered people who show 75 to 100 % of the expression. Most people's strong
            /// and weak poses differ by chance, so that the power is small or 0, except for lids, which are to close.
            fn typical(self) -> (f32, f32) {
                match self { $( Self::$take => $typical, )* }
            }
        }
    };
}

takes! {
    Neutral "neutral": "Look into the camera with your face at rest and your mouth closed", [],
        threshold 0.0, lids f32::INFINITY, typical (1.0, 0.0);
    EyesShut "eyes-shut": "Shut both eyes, count to three, and open them again", LIDS,
        threshold 0.45, lids f32::INFINITY, typical (0.82, 1.0);
    JawOpen "jaw-open": "Open your mouth wide", ["jawOpen"],
        threshold 0.3, lids 0.5, typical (1.0, 0.0);
    BrowsUp "brows-up": "Raise your eyebrows", ["browInnerUp", "browOuterUpLeft", "browOuterUpRight"],
        threshold 0.25, lids 0.5, typical (1.0, 0.0);
    BrowsDown "brows-down": "Draw your eyebrows down, as if in anger", ["browDownLeft", "browDownRight"],
        threshold 0.25, lids 0.8, typical (0.28, 0.25);
    Smile "smile": "Smile as widely as you can", ["mouthSmileLeft", "mouthSmileRight"],
        threshold 0.25, lids 0.8, typical (1.0, 0.0);
    Pucker "pucker": "Pucker your lips, as if for a kiss", ["mouthPucker"],
        threshold 0.25, lids 0.5, typical (1.0, 0.0);
    LookLeft "look-left": "Look to your left with your eyes alone", ["eyeLookOutLeft", "eyeLookInRight"],
        threshold 0.3, lids 0.5, typical (0.83, 0.25);
    LookRight "look-right": "Look to your right with your eyes alone", ["eyeLookInLeft", "eyeLookOutRight"],
        threshold 0.3, lids 0.5, typical (0.83, 0.25);
    LookUp "look-up": "Look up with your eyes alone", ["eyeLookUpLeft", "eyeLookUpRight"],
        threshold 0.2, lids 0.5, typical (0.57, 0.25);
    LookDown "look-down": "Look down with your eyes alone", ["eyeLookDownLeft", "eyeLookDownRight"],
        threshold 0.2, lids 0.8, typical (0.56, 0.25);
}

impl Take {
    /// How strongly the pose is seen: the mean of its coefficients, or, for shut eyes, the lid that is less shut.
    pub(super) fn strength(self, coefficients: &[f32; COEFFS]) -> f32 {
        match self {
            Self::EyesShut => LIDS.iter().map(|name| mean_of(&[name], coefficients)).fold(f32::MAX, f32::min),
            _ => mean_of(self.raises(), coefficients),
        }
    }
}

pub(super) fn mean_of(names: &[&str], coefficients: &[f32; COEFFS]) -> f32 {
    let chosen = BLENDSHAPES.iter().zip(coefficients).filter(|(name, _)| names.contains(name));
    chosen.map(|(_, value)| value).sum::<f32>() / names.len().max(1) as f32
}

/// Why the guide waits, or refuses a take. Displays as one sentence for the wearer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Error)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    #[error("No picture comes from the camera: check its cable")]
    NoPicture,
    #[error("No face is in the picture: sit in front of the camera")]
    NoFace,
    #[error("The face is too dark: turn on a light in front of you")]
    TooDark,
    /// In a pose: the head is not turned as it was in the neutral take.
    #[error("The head is turned: face the camera")]
    HeadTurned,
    #[error("The head moves: keep it still")]
    HeadMoves,
    #[error("The face moves: hold it still")]
    FaceMoves,
    /// In the neutral take, or for longer than a blink in another pose.
    #[error("The eyes are shut or half shut: open them as you usually do")]
    EyesShut,
    #[error("The mouth smiles: let your face rest")]
    Smiling,
    #[error("The mouth is open: close it")]
    MouthOpen,
    #[error("The eyebrows are raised or drawn down: let your face rest")]
    BrowsMoved,
    #[error("No such movement is seen: make it stronger")]
    NotSeen,
    #[error("The movement ended too early: hold it a little longer")]
    TooShort,
}

impl Refusal {
    pub fn end(self) -> String {
        format!("no profile was made, and the former one stays. {self}, and try again")
    }
}

const GAIN: [f32; 2] = [0.6, 1.6];
/// Least reading of a pose, above the rest, from which a gain can be found.
const LEAST_MEASURED: f32 = 0.1;

#[derive(Debug)]
pub(super) struct Known {
    pub(super) neutral: Neutral,
    pub(super) head_deg: [f32; 3],
    /// Output of the regression for the neutral face, measured from that face itself.
    pub(super) raw: [f32; COEFFS],
}

#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    pub face: Normalised,
    /// What the look of the face adds to the coefficients, while the neutral face is unknown and once it is known.
    pub residuals: [Coefficients; 2],
    pub head_deg: [f32; 3],
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

/// Learns the wearer's profile.
///
/// The neutral face is that of the neutral take, and the rest is what the model still reads of that face, measured from
/// itself. The gain of a coefficient compares its reading in the pose that raises it with the reading that the shipped
/// model gives for most people. Shut lids then read 1. In other poses, how far people go differs from time to time, and a
/// model that reads little of a full expression often reads most of a small one. The gain therefore makes up only a part
/// of the difference, and is 1 for poses where a gain would make expressions between rest and pose worse.
pub(super) fn learn(model: &Model, takes: &Takes) -> Option<Profile> {
    let known = takes.neutral.as_ref()?;
    let mut profile = Profile { neutral: Some(known.neutral.clone()), ..Profile::default() };
    for (rest, (raw, terms)) in profile.rest.iter_mut().zip(known.raw.iter().zip(&model.correction.0)) {
        // A reading below 0 is sent as 0 in any case. Subtracting it would lift the noise of the resting face.
        *rest = terms.rest_of(*raw).clamp(0.0, MAX_REST);
    }
    for pose in takes.poses.keys().copied() {
        let Some(raw) = takes.raw(model, pose) else { continue };
        let (typical, power) = pose.typical();
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
        let strength = |raw: &[f32; COEFFS]| mean_of(part.raises(), raw);
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
    fn takes_stand_in_their_order_and_raise_blendshapes_that_exist_and_each_only_once() {
        assert!(Take::ALL.is_sorted());
        let mut raised = Vec::new();
        for take in Take::ALL {
            assert_eq!(serde_json::to_string(&take).unwrap(), format!("{:?}", take.name()));
            assert!(take.raises().iter().all(|name| BLENDSHAPES.contains(name) && !raised.contains(name)), "{take:?}");
            raised.extend(take.raises());
        }
    }
}
