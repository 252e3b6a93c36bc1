//! The supervisor: signals and log, on the thread that started the others.

use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use super::counters::{Counters, Status};
use crate::capture::CaptureError;

/// How often signals are looked for.
const TICK: Duration = Duration::from_millis(50);
/// How often the status line is written.
const STATUS_PERIOD: Duration = Duration::from_secs(10);
/// Exit status after a second signal.
const IMPATIENT: i32 = 130;

/// What the hot loop tells while it has no frame to work on.
#[derive(Debug)]
pub(super) enum Event {
    /// A camera was opened; what it delivers.
    Opened(String),
    /// The camera failed.
    Lost(CaptureError),
    /// No camera could be opened.
    Closed(CaptureError),
}

/// Lets SIGTERM and SIGINT stop the service, the second of them at once.
pub(super) fn catch_signals(counters: &Counters) -> io::Result<()> {
    for signal in [SIGTERM, SIGINT] {
        flag::register_conditional_shutdown(signal, IMPATIENT, counters.stop_flag())?;
        flag::register(signal, counters.stop_flag())?;
    }
    Ok(())
}

/// Logs events and the status until the service is to stop.
pub(super) fn supervise(counters: &Counters, events: &Receiver<Event>) {
    let mut log = Log::default();
    while !counters.stopping() {
        match events.recv_timeout(TICK) {
            Ok(event) => log.event(event),
            Err(RecvTimeoutError::Timeout) => {}
            // The hot loop ended without being told to: so must the service, to be started anew.
            Err(RecvTimeoutError::Disconnected) => break,
        }
        log.status(counters);
    }
    tracing::info!("stopping");
}

/// What was logged last.
struct Log {
    /// Why there is no camera, as last told: the same reason is told once.
    blind: Option<String>,
    due: Instant,
    before: Option<Status>,
}

impl Default for Log {
    fn default() -> Self {
        Self { blind: None, due: Instant::now() + STATUS_PERIOD, before: None }
    }
}

impl Log {
    fn event(&mut self, event: Event) {
        match event {
            Event::Opened(source) => {
                self.blind = None;
                tracing::info!("camera opened: {source}");
            }
            Event::Lost(error) => tracing::warn!("camera lost: {error}"),
            Event::Closed(error) => {
                let reason = error.to_string();
                if self.blind.as_ref() != Some(&reason) {
                    tracing::warn!("no camera: {reason}; trying again");
                }
                self.blind = Some(reason);
            }
        }
    }

    fn status(&mut self, counters: &Counters) {
        if Instant::now() < self.due {
            return;
        }
        self.due += STATUS_PERIOD;
        let status = counters.status();
        let before = self.before.replace(status).map_or(0, |before| before.frames);
        let fps = (status.frames - before) as f64 / STATUS_PERIOD.as_secs_f64();
        if let Some(reason) = &self.blind {
            tracing::warn!("blind, because {reason}: {status}");
        } else {
            tracing::info!("fps={fps:.1} {status}");
        }
    }
}
