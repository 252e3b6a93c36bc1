//! What a packet says about itself.

/// How much the sender trusts the pose it sends.
///
/// ```text
///          silence          silence          output neutral
///   Live ----------> Hold ----------> Decay ----------------> Neutral
///    ^  <------------                   |                        |
///    |   a good pose                    |                        |
///    +----------------------------------+------------------------+
///                  several good poses in a row (recovery)
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum State {
    /// Follows the camera.
    Live,
    /// No good pose for a moment: the last output stands still.
    Hold,
    /// No good pose for longer: the output moves to neutral at a bounded speed.
    Decay,
    /// The neutral face: all coefficients 0, head facing the camera.
    #[default]
    Neutral,
}

impl State {
    /// The state whose bits these are; only the lower two count.
    pub(crate) const fn from_bits(bits: u8) -> Self {
        match bits & 0b11 {
            0 => Self::Live,
            1 => Self::Hold,
            2 => Self::Decay,
            _ => Self::Neutral,
        }
    }

    /// Lower-case name, as in tables and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Live => "live",
            Self::Hold => "hold",
            Self::Decay => "decay",
            Self::Neutral => "neutral",
        }
    }
}

/// Why the sender is not live.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reason {
    /// Nothing is wrong.
    #[default]
    None,
    /// The camera runs, but shows no face.
    NoFace,
    /// The camera gives no frames.
    NoCamera,
    /// Poses come too late, or not at all without a known fault.
    Late,
    /// A result was not a number or out of range.
    BadResult,
    /// The sender is going away.
    Stopping,
}

impl Reason {
    /// The reason with this number, or `None` for a number version 1 does not know.
    pub(crate) const fn from_number(number: u8) -> Option<Self> {
        Some(match number {
            0 => Self::None,
            1 => Self::NoFace,
            2 => Self::NoCamera,
            3 => Self::Late,
            4 => Self::BadResult,
            5 => Self::Stopping,
            _ => return None,
        })
    }

    /// Lower-case name, as in tables and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::NoFace => "no face",
            Self::NoCamera => "no camera",
            Self::Late => "late",
            Self::BadResult => "bad result",
            Self::Stopping => "stopping",
        }
    }
}
