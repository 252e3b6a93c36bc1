//! What the supervisor says: events as they come, and one status line from time to time.

use std::fmt::Write as _;
use std::mem::{Discriminant, discriminant};
use std::time::{Duration, Instant};

use super::counters::{Counters, Status};
use super::realtime::Grant;
use super::report::Event;
use crate::capture::CaptureError;

/// How often the status line is written.
const STATUS_PERIOD: Duration = Duration::from_secs(10);

/// What was said last.
pub(super) struct Log {
    /// The camera, or why there is none.
    camera: Result<String, String>,
    /// The reason that was told last: one of the same kind is not told again.
    told: Option<Discriminant<CaptureError>>,
    /// What of real time was asked for, and what became of it.
    grants: Vec<Grant>,
    due: Instant,
    before: (Instant, u64),
    /// What of the network was told last.
    refusal: Option<String>,
}

impl Default for Log {
    fn default() -> Self {
        let now = Instant::now();
        let camera = Err("none was opened yet".to_owned());
        Self { camera, told: None, grants: Vec::new(), due: now + STATUS_PERIOD, before: (now, 0), refusal: None }
    }
}

impl Log {
    pub(super) fn event(&mut self, event: Event) {
        match event {
            Event::Started(grants) => grants.into_iter().for_each(|grant| self.grant(grant)),
            Event::Opened(source) => {
                tracing::info!("camera opened: {source}");
                self.camera = Ok(source);
                self.told = None;
            }
            Event::Lost(error) => {
                tracing::warn!("camera lost: {error}");
                self.blind(&error);
            }
            Event::Closed(error) => {
                if self.told != Some(discriminant(&error)) {
                    tracing::warn!("no camera: {error}; trying again");
                }
                self.blind(&error);
            }
        }
    }

    fn blind(&mut self, error: &CaptureError) {
        self.told = Some(discriminant(error));
        self.camera = Err(error.to_string());
    }

    /// The camera in one line.
    pub(super) fn sight(&self) -> String {
        match &self.camera {
            Ok(source) => format!("camera opened: {source}"),
            Err(reason) => format!("blind, because {reason}"),
        }
    }

    /// Says what was granted, once for each answer.
    pub(super) fn grant(&mut self, grant: Grant) {
        if self.grants.contains(&grant) {
            return;
        }
        match grant.remedy() {
            None => tracing::info!("{grant}"),
            Some(remedy) => tracing::warn!("{grant}: {remedy}"),
        }
        self.grants.retain(|known| !known.is_about_the_same(&grant));
        self.grants.push(grant);
    }

    /// Says which link's packets the network does not take, once.
    pub(super) fn refusal(&mut self, refusal: Option<String>) {
        if let Some(told) = &refusal
            && self.refusal != refusal
        {
            tracing::warn!("{told}");
        }
        self.refusal = refusal;
    }

    /// Whether the status line is due.
    pub(super) fn is_due(&self) -> bool {
        Instant::now() >= self.due
    }

    /// Writes the status line and returns it.
    pub(super) fn status(&mut self, counters: &Counters) -> String {
        let status = counters.status();
        let line = self.line(&status);
        if self.camera.is_ok() {
            tracing::info!("{line}");
        } else {
            tracing::warn!("{line}");
        }
        line
    }

    fn line(&mut self, status: &Status) -> String {
        let now = Instant::now();
        let (before, frames) = std::mem::replace(&mut self.before, (now, status.frames));
        self.due = now + STATUS_PERIOD;
        let fps = (status.frames - frames) as f64 / now.duration_since(before).as_secs_f64().max(f64::EPSILON);
        let mut line = match &self.camera {
            Ok(_) => format!("fps={fps:.1} {status}"),
            Err(_) => format!("{}: {status}", self.sight()),
        };
        for (index, grant) in self.grants.iter().enumerate() {
            let separator = if index == 0 { "; real time: " } else { ", " };
            // Writing to a string does not fail.
            let _ = write!(line, "{separator}{grant}");
        }
        line
    }
}
