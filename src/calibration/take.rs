//! The takes of a calibration: what the wearer is asked to do, and by which coefficients it is seen.

use serde::{Deserialize, Serialize};

use crate::solve::{BLENDSHAPES, COEFFS};

/// One thing that the wearer is asked to do, in the order in which the guide asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Take {
    /// A face at rest that looks into the camera.
    Neutral,
    /// Both eyes shut.
    EyesShut,
    /// The mouth wide open.
    JawOpen,
    /// Both brows raised.
    BrowsUp,
    /// Both brows drawn down.
    BrowsDown,
    /// A wide smile.
    Smile,
    /// The lips pushed forward.
    Pucker,
    /// The eyes turned to the wearer's left.
    LookLeft,
    /// The eyes turned to the wearer's right.
    LookRight,
    /// The eyes turned up.
    LookUp,
    /// The eyes turned down.
    LookDown,
}

impl Take {
    /// Every take, in order.
    pub const ALL: [Self; 11] = [
        Self::Neutral,
        Self::EyesShut,
        Self::JawOpen,
        Self::BrowsUp,
        Self::BrowsDown,
        Self::Smile,
        Self::Pucker,
        Self::LookLeft,
        Self::LookRight,
        Self::LookUp,
        Self::LookDown,
    ];

    /// Place in [`Take::ALL`].
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }

    /// The name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Neutral => "neutral",
            Self::EyesShut => "eyes-shut",
            Self::JawOpen => "jaw-open",
            Self::BrowsUp => "brows-up",
            Self::BrowsDown => "brows-down",
            Self::Smile => "smile",
            Self::Pucker => "pucker",
            Self::LookLeft => "look-left",
            Self::LookRight => "look-right",
            Self::LookUp => "look-up",
            Self::LookDown => "look-down",
        }
    }

    /// What the wearer is asked to do.
    #[must_use]
    pub fn instruction(self) -> &'static str {
        match self {
            Self::Neutral => "Look into the camera with your face at rest and your mouth closed",
            Self::EyesShut => "Shut both eyes, count to three, and open them again",
            Self::JawOpen => "Open your mouth wide",
            Self::BrowsUp => "Raise your eyebrows",
            Self::BrowsDown => "Draw your eyebrows down, as if in anger",
            Self::Smile => "Smile as widely as you can",
            Self::Pucker => "Pucker your lips, as if for a kiss",
            Self::LookLeft => "Look to your left with your eyes alone",
            Self::LookRight => "Look to your right with your eyes alone",
            Self::LookUp => "Look up with your eyes alone",
            Self::LookDown => "Look down with your eyes alone",
        }
    }

    /// The coefficients that the pose raises to the end of their range. The neutral face raises none.
    #[must_use]
    pub fn raises(self) -> &'static [&'static str] {
        match self {
            Self::Neutral => &[],
            Self::EyesShut => &["eyeBlinkLeft", "eyeBlinkRight"],
            Self::JawOpen => &["jawOpen"],
            Self::BrowsUp => &["browInnerUp", "browOuterUpLeft", "browOuterUpRight"],
            Self::BrowsDown => &["browDownLeft", "browDownRight"],
            Self::Smile => &["mouthSmileLeft", "mouthSmileRight"],
            Self::Pucker => &["mouthPucker"],
            Self::LookLeft => &["eyeLookOutLeft", "eyeLookInRight"],
            Self::LookRight => &["eyeLookInLeft", "eyeLookOutRight"],
            Self::LookUp => &["eyeLookUpLeft", "eyeLookUpRight"],
            Self::LookDown => &["eyeLookDownLeft", "eyeLookDownRight"],
        }
    }

    /// How strongly the pose is seen in these coefficients: their mean, or, for shut eyes, the value of
    /// the lid that is less shut.
    pub(super) fn strength(self, coefficients: &[f32; COEFFS]) -> f32 {
        match self {
            Self::EyesShut => self.raises().iter().map(|name| mean_of(&[name], coefficients)).fold(f32::MAX, f32::min),
            _ => mean_of(self.raises(), coefficients),
        }
    }

    /// Strength, less that of the neutral take, from which on it counts as seen. The faintest poses of people who
    /// were asked for them lie above, and what a face at rest shows lies below.
    pub(super) fn threshold(self) -> f32 {
        match self {
            Self::Neutral => 0.0,
            Self::EyesShut => 0.45,
            Self::JawOpen | Self::LookLeft | Self::LookRight => 0.3,
            Self::BrowsUp | Self::BrowsDown | Self::Smile | Self::Pucker => 0.25,
            Self::LookUp | Self::LookDown => 0.2,
        }
    }

    /// How far the lids may close during the take. A frame in which they are closed further shows a blink.
    pub(super) fn lids(self) -> f32 {
        match self {
            Self::EyesShut => f32::INFINITY,
            // The lids follow these.
            Self::LookDown | Self::BrowsDown | Self::Smile => 0.8,
            _ => 0.5,
        }
    }
}

/// Mean of the coefficients with these names.
pub(super) fn mean_of(names: &[&str], coefficients: &[f32; COEFFS]) -> f32 {
    let chosen = BLENDSHAPES.iter().zip(coefficients).filter(|(name, _)| names.contains(name));
    chosen.map(|(_, value)| value).sum::<f32>() / names.len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn takes_name_blendshapes_that_exist_and_each_only_once() {
        let mut raised: Vec<_> = Take::ALL.iter().flat_map(|take| take.raises()).collect();
        assert!(raised.iter().all(|name| BLENDSHAPES.contains(name)));
        let count = raised.len();
        raised.sort();
        raised.dedup();
        assert_eq!(raised.len(), count);
    }

    #[test]
    fn takes_stand_in_their_order_and_are_written_as_their_names() {
        for (index, take) in Take::ALL.into_iter().enumerate() {
            assert_eq!(take.index(), index);
            assert_eq!(serde_json::to_string(&take).unwrap_or_default(), format!("{:?}", take.name()));
        }
    }
}
