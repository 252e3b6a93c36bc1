//! The state of the sender, the reason for it, and what it knows of the wearer.

/// How much the sender trusts the pose it sends.
///
/// ```text
///         no good pose      no good pose     output has become neutral
///   Live -------------> Hold ----------> Decay ----------------> Neutral
///    ^  <---------------                   |                        |
///    |    a good pose                      |                        |
///    +-------------------------------------+------------------------+
///                 several good poses in a row (recovery)
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum State {
    /// The output follows the camera.
    Live,
    /// No good pose arrived for a short time. The output keeps its last value.
    Hold,
    /// No good pose arrived for longer. The output moves to neutral at a bounded speed.
    Decay,
    /// The output is the neutral face: all coefficients are 0 and the head faces the camera.
    #[default]
    Neutral,
}

impl State {
    /// Reads the state from the two lowest bits.
    pub(crate) const fn from_bits(bits: u8) -> Self {
        match bits & 0b11 {
            0 => Self::Live,
            1 => Self::Hold,
            2 => Self::Decay,
            _ => Self::Neutral,
        }
    }

    /// Whether the output shows the face of the camera, or did so a moment ago.
    #[cfg(feature = "formats")]
    pub(crate) const fn shows_face(self) -> bool {
        matches!(self, Self::Live | Self::Hold)
    }

    /// Returns the lower-case name, as used in tables and logs.
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

/// Why the state is not live.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reason {
    /// No fault is known.
    #[default]
    None,
    /// The camera delivers pictures without a face.
    NoFace,
    /// The camera delivers no frames.
    NoCamera,
    /// Poses arrive too late, or do not arrive although no fault is known.
    Late,
    /// The solver's result was not a number or out of range.
    BadResult,
    /// The sender is shutting down.
    Stopping,
}

impl Reason {
    /// Returns the reason with this number, or `None` if version 1 does not define it.
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

    /// Returns the lower-case name, as used in tables and logs.
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

/// The neutral face from which the sender measures expressions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NeutralFace {
    /// The mean of many people. Coefficients may have a resting offset that differs from wearer to wearer.
    #[default]
    Mean,
    /// The wearer's, as far as the sender has estimated it while watching.
    Estimated,
    /// The wearer's, from a calibration.
    Calibrated,
}

impl NeutralFace {
    /// Reads the neutral face from the two lowest bits. Version 1 does not use the value 3, which is read as the mean.
    pub(crate) const fn from_bits(bits: u8) -> Self {
        match bits & 0b11 {
            1 => Self::Estimated,
            2 => Self::Calibrated,
            _ => Self::Mean,
        }
    }

    /// Returns the lower-case name, as used in tables and logs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Estimated => "estimated",
            Self::Calibrated => "calibrated",
        }
    }
}
