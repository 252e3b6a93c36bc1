//! How far a calibration is, for the display.

use serde::{Deserialize, Serialize};

use super::refusal::Refusal;
use super::take::Take;

/// How far a calibration is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Progress {
    /// The take in progress.
    pub take: Take,
    /// Takes that are done or left out.
    pub done: usize,
    /// Takes in all.
    pub of: usize,
    /// What the guide does.
    pub phase: Phase,
    /// How much of the take is measured, 0 to 1.
    pub measured: f32,
    /// How strongly the pose is seen, 1 being enough; 0 in the neutral take.
    pub seen: f32,
    /// What the guide waits for.
    pub waits_for: Option<Refusal>,
    /// Number of refused takes.
    pub refused: u32,
    /// Why the last refused take was refused.
    pub last_refusal: Option<Refusal>,
}

impl Progress {
    /// Whether nothing but measures differs.
    #[must_use]
    pub fn says_the_same(&self, other: &Self) -> bool {
        let key = |of: &Self| (of.take, of.phase, of.waits_for, of.refused, of.last_refusal);
        key(self) == key(other)
    }
}

/// What the guide does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Phase {
    /// The wearer reads what to do.
    GetReady,
    /// The conditions of the take do not hold, or its pose is not seen yet.
    Wait,
    /// The wearer holds still and is measured.
    Measure,
    /// The calibration has ended.
    Ended,
}
