//! The takes of a calibration: what the wearer is asked to do, and why a take is refused.

use facewire_face::{BLENDSHAPES, COEFFS};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub(super) const LIDS: [&str; 2] = ["eyeBlinkLeft", "eyeBlinkRight"];

/// One thing that the wearer is asked to do, in the order in which the guide asks. Left and right are the wearer's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Take {
    Neutral,
    EyesShut,
    JawOpen,
    BrowsUp,
    BrowsDown,
    Smile,
    Pucker,
    LookLeft,
    LookRight,
    LookUp,
    LookDown,
}

impl Take {
    pub const ALL: [Self; 11] = {
        use Take::*;
        [Neutral, EyesShut, JawOpen, BrowsUp, BrowsDown, Smile, Pucker, LookLeft, LookRight, LookUp, LookDown]
    };

    pub fn name(self) -> &'static str {
        self.properties().0
    }

    pub fn instruction(self) -> &'static str {
        self.properties().1
    }

    /// The coefficients that the pose raises to the end of their range.
    pub fn raises(self) -> &'static [&'static str] {
        self.properties().2
    }

    /// Strength, less that of the neutral take, from which on it counts as seen. The faintest poses of people who
    /// were asked for them lie above, and what a face at rest shows lies below.
    pub(super) fn threshold(self) -> f32 {
        self.properties().3
    }

    /// The name in files, the instruction, the coefficients that it raises, and the threshold of their strength.
    fn properties(self) -> (&'static str, &'static str, &'static [&'static str], f32) {
        use Take::*;
        match self {
            Neutral => ("neutral", "Look into the camera with your face at rest and your mouth closed", &[], 0.0),
            EyesShut => ("eyes-shut", "Shut both eyes, count to three, and open them again", &LIDS, 0.45),
            JawOpen => ("jaw-open", "Open your mouth wide", &["jawOpen"], 0.3),
            BrowsUp => {
                ("brows-up", "Raise your eyebrows", &["browInnerUp", "browOuterUpLeft", "browOuterUpRight"], 0.25)
            }
            BrowsDown => {
                ("brows-down", "Draw your eyebrows down, as if in anger", &["browDownLeft", "browDownRight"], 0.25)
            }
            Smile => ("smile", "Smile as widely as you can", &["mouthSmileLeft", "mouthSmileRight"], 0.25),
            Pucker => ("pucker", "Pucker your lips, as if for a kiss", &["mouthPucker"], 0.25),
            LookLeft => {
                ("look-left", "Look to your left with your eyes alone", &["eyeLookOutLeft", "eyeLookInRight"], 0.3)
            }
            LookRight => {
                ("look-right", "Look to your right with your eyes alone", &["eyeLookInLeft", "eyeLookOutRight"], 0.3)
            }
            LookUp => ("look-up", "Look up with your eyes alone", &["eyeLookUpLeft", "eyeLookUpRight"], 0.2),
            LookDown => ("look-down", "Look down with your eyes alone", &["eyeLookDownLeft", "eyeLookDownRight"], 0.2),
        }
    }

    /// How strongly the pose is seen: the mean of its coefficients, or, for shut eyes, the lid that is less shut.
    pub(super) fn strength(self, coefficients: &[f32; COEFFS]) -> f32 {
        match self {
            Self::EyesShut => LIDS.iter().map(|name| mean_of(&[name], coefficients)).fold(f32::MAX, f32::min),
            _ => mean_of(self.raises(), coefficients),
        }
    }

    /// How far the lids may close during the take. A frame in which they are closed further shows a blink.
    pub(super) fn lids(self) -> f32 {
        match self {
            Self::Neutral | Self::EyesShut => f32::INFINITY,
            // The lids follow these.
            Self::LookDown | Self::BrowsDown | Self::Smile => 0.8,
            _ => 0.5,
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
    /// Also if the head is not as in the neutral take.
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
