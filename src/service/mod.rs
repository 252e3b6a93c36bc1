//! The service: camera to links, unattended, until it is told to stop.
//!
//! Three threads. The hot loop runs frames ([`hot`]); the sender owns the failsafe and the links ([`sender`]), so that
//! a stuck inference cannot freeze a face; the supervisor, which is the thread that calls [`run`], hears signals and
//! writes the log ([`supervisor`]). From the hot loop to the sender goes a triple buffer, newest wins; from both to the
//! supervisor go counters, and, where no frame waits, events.

mod camera;
mod counters;
pub mod failsafe;
mod hot;
mod report;
mod sender;
mod supervisor;

use std::io;
use std::sync::{Arc, mpsc};
use std::thread::Builder;

pub use camera::open as open_camera;
pub use counters::{Counters, Status};

use crate::config::Settings;
use crate::link::{Link, LinkError};
use crate::pipeline::{Pipeline, SetupError};

/// Why the service could not start.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// A network or the model.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A link.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The system refused a thread or a signal handler.
    #[error("the system refused a thread or a signal handler: {0}")]
    System(#[from] io::Error),
}

/// Runs until SIGTERM or SIGINT. A second signal ends the process at once.
///
/// # Errors
/// [`ServiceError`], before any camera is opened. Afterwards nothing ends the service but a signal.
pub fn run(settings: &Settings) -> Result<Status, ServiceError> {
    let counters = Arc::new(Counters::default());
    supervisor::catch_signals(&counters)?;
    let links = Link::open_all(&settings.links)?;
    let pipeline = Pipeline::load(settings)?;
    let (reports, news) = triple_buffer::triple_buffer(&report::Report::NOTHING);
    let (events, heard) = mpsc::channel();

    let sender = sender::Sender::new(settings, links, news, Arc::clone(&counters));
    let sender = Builder::new().name("fw-sender".to_owned()).spawn(move || sender.run())?;
    let wake = sender.thread().clone();
    let hot = hot::HotLoop::new(settings, pipeline, hot::Outlets { reports, wake, events }, Arc::clone(&counters));
    let hot = Builder::new().name("fw-hot".to_owned()).spawn(move || hot.run())?;

    supervisor::supervise(&counters, &heard);
    // Frames end before packets do, so that the last word of the sender is its own.
    hot.thread().unpark();
    if hot.join().is_err() {
        tracing::error!("the hot loop ended by a panic");
    }
    counters.stop_sending();
    sender.thread().unpark();
    if sender.join().is_err() {
        tracing::error!("the sender ended by a panic");
    }
    Ok(counters.status())
}
