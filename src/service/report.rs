//! What the hot loop tells the sender about a frame.

use facewire_packet::Reason;

use super::failsafe::{News, Pose};
use crate::pipeline::Solution;

/// The newest result of the hot loop.
#[derive(Debug, Clone, Copy)]
#[expect(clippy::large_enum_variant, reason = "three of them live in a triple buffer, on no heap")]
pub(super) enum Report {
    /// Not one yet.
    Nothing,
    /// A pose, and when its frame was captured.
    Solved { pose: Pose, captured_us: u64 },
    /// Why there is none.
    Fault(Reason),
}

impl Report {
    pub(super) const NOTHING: Self = Self::Nothing;

    pub(super) fn solved(solution: &Solution, captured_us: u64) -> Self {
        Self::Solved { pose: solution.into(), captured_us }
    }

    pub(super) fn news(&self) -> News<'_> {
        match self {
            Self::Nothing => News::Nothing,
            Self::Solved { pose, captured_us } => News::Pose(pose, *captured_us),
            Self::Fault(reason) => News::Fault(*reason),
        }
    }
}

impl From<&Solution> for Pose {
    fn from(solution: &Solution) -> Self {
        Self {
            rotation: solution.head.rotation_xyzw,
            position_mm: solution.head.position_mm,
            coefficients: solution.smoothed.0,
        }
    }
}
