//! Messages of the hot loop: reports for the sender, events for the supervisor.

use facewire_packet::Reason;

use super::failsafe::News;
use super::realtime::Grant;
use crate::capture::CaptureError;
use crate::infer::InferError;
use crate::link::Pose;
use crate::preflight::SetupError;
use crate::solve::Solution;

/// The newest result of the hot loop. The sender reads the newest report only.
#[derive(Debug, Clone, Copy)]
#[expect(clippy::large_enum_variant, reason = "three reports live in a triple buffer, none on the heap")]
pub(super) enum Report {
    /// There is no result yet.
    Nothing,
    /// A pose, and when its frame was captured.
    Solved { pose: Pose, captured_us: u64 },
    /// Why there is no pose.
    Fault(Reason),
}

impl Report {
    /// A report of this solution.
    pub(super) fn solved(solution: &Solution, captured_us: u64) -> Self {
        Self::Solved { pose: solution.into(), captured_us }
    }

    /// The pose, or why there is none.
    pub(super) fn pose(&self) -> Result<&Pose, Reason> {
        match self {
            Self::Nothing => Err(Reason::None),
            Self::Solved { pose, .. } => Ok(pose),
            Self::Fault(reason) => Err(*reason),
        }
    }

    /// The report as the failsafe takes it.
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
            neutral_face: solution.neutral_face,
        }
    }
}

/// An event for the log. Threads send events only between frames.
#[derive(Debug)]
pub(super) enum Event {
    /// A thread started and got these answers to its real-time requests.
    Started(Vec<Grant>),
    /// A camera delivers pictures; the text describes it.
    Opened(String),
    /// The open camera failed.
    Lost(CaptureError),
    /// No camera could be opened.
    Closed(CaptureError),
    /// The pipeline could not be loaded, because something that it needs is not there yet.
    NotLoaded(SetupError),
    /// The engine has failed several times in a row, and its networks are about to be loaded again.
    EngineFailed(InferError),
    /// The networks have been loaded again.
    EngineReloaded,
}

impl Event {
    /// The reason that receivers get for the missing poses.
    pub(super) fn reason(&self) -> Reason {
        match self {
            Self::NotLoaded(_) | Self::EngineFailed(_) | Self::EngineReloaded => Reason::BadResult,
            Self::Started(_) | Self::Opened(_) | Self::Lost(_) | Self::Closed(_) => Reason::NoCamera,
        }
    }
}
