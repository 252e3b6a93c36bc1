//! What the other threads tell the supervisor.

use super::realtime::Grant;
use crate::capture::CaptureError;

/// Told while no frame waits.
#[derive(Debug)]
pub(super) enum Event {
    /// A thread started; what of real time it was granted.
    Started(Vec<Grant>),
    /// A camera was opened and shows something; what it delivers.
    Opened(String),
    /// The camera failed.
    Lost(CaptureError),
    /// No camera could be opened.
    Closed(CaptureError),
}
