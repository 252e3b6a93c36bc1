//! Why a take is not accepted.

use core::fmt;

use serde::{Deserialize, Serialize};

/// Why the guide waits, or refuses a take. Displays as one sentence for the wearer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// No frame came for a while.
    NoPicture,
    /// The picture shows no face.
    NoFace,
    /// The face is too dark or too noisy.
    TooDark,
    /// The head does not face the camera, or is not as in the neutral take.
    HeadTurned,
    /// The head moved.
    HeadMoves,
    /// The face moved during the neutral take.
    FaceMoves,
    /// The eyes were shut in the neutral take, or for longer than a blink in another pose.
    EyesShut,
    /// The wearer smiled in the neutral take.
    Smiling,
    /// The mouth was open in the neutral take.
    MouthOpen,
    /// The brows were raised in the neutral take.
    BrowsMoved,
    /// The pose was not seen.
    NotSeen,
    /// The pose ended before it was measured.
    TooShort,
}

impl Refusal {
    /// One sentence for the wearer.
    #[must_use]
    pub fn sentence(self) -> &'static str {
        match self {
            Self::NoPicture => "No picture comes from the camera: check its cable",
            Self::NoFace => "No face is in the picture: sit in front of the camera",
            Self::TooDark => "The face is too dark: turn on a light in front of you",
            Self::HeadTurned => "The head is turned: face the camera",
            Self::HeadMoves => "The head moves: keep it still",
            Self::FaceMoves => "The face moves: hold it still",
            Self::EyesShut => "The eyes are shut or half shut: open them as you usually do",
            Self::Smiling => "The mouth smiles: let your face rest",
            Self::MouthOpen => "The mouth is open: close it",
            Self::BrowsMoved => "The eyebrows are raised or drawn down: let your face rest",
            Self::NotSeen => "No such movement is seen: make it stronger",
            Self::TooShort => "The movement ended too early: hold it a little longer",
        }
    }
}

impl Refusal {
    /// What to tell when a calibration ends without a profile for this reason.
    #[must_use]
    pub fn end(self) -> String {
        format!("no profile was made, and the former one stays. {self}, and try again")
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.sentence())
    }
}
