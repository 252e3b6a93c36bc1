//! The service's log: events as they come, and a status line from time to time.

use std::fmt::Write as _;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use super::adaptation::Cause;
use super::counters::Counters;
use super::hot::Event;
use super::load::Load;
use super::realtime::Grant;
use super::step::Step;
use crate::impairment::{Impairment, ImpairmentSet};
use crate::retry::LoggedReasons;

const STATUS_PERIOD: Duration = Duration::from_secs(10);

/// An impairment that begins again within this time is not logged again.
const IMPAIRMENT_PERIOD: Duration = Duration::from_mins(10);

/// What the log has said so far, as far as the next lines depend on it.
pub(super) struct Log {
    /// Description of the open camera, or why there are no pictures.
    camera: Result<String, String>,
    /// Why there are no pictures, as it was logged last.
    blind_because: LoggedReasons,
    /// Why the network takes no packets, as it was logged last.
    refusal: LoggedReasons,
    impaired_by: ImpairmentSet,
    impaired_at: [Option<Instant>; Impairment::ALL.len()],
    /// Real-time requests and the system's answers.
    grants: Vec<Grant>,
    status_due: Instant,
    /// Time of the last status line, and the count of frames in it.
    last_status: (Instant, u64),
}

impl Default for Log {
    fn default() -> Self {
        let now = Instant::now();
        Self {
            camera: Err("no camera has been opened yet".to_owned()),
            blind_because: LoggedReasons::default(),
            refusal: LoggedReasons::default(),
            impaired_by: ImpairmentSet::default(),
            impaired_at: Default::default(),
            grants: Vec::new(),
            status_due: now + STATUS_PERIOD,
            last_status: (now, 0),
        }
    }
}

impl Log {
    /// Logs an event. Repeated attempts that fail for the same reason are logged once.
    pub(super) fn event(&mut self, event: Event) {
        match event {
            Event::Started(grants) => grants.into_iter().for_each(|grant| self.grant(grant)),
            Event::Opened(camera) => {
                tracing::info!("camera opened: {camera}");
                self.camera = Ok(camera);
                self.blind_because.clear();
            }
            Event::Lost(error) => {
                let reason = error.to_string();
                tracing::warn!("camera lost: {reason}");
                self.blind_because.is_new(&reason);
                self.camera = Err(reason);
            }
            Event::Closed(error) => self.blind("no camera", error.to_string()),
            Event::NotLoaded(error) => self.blind("no model", error.to_string()),
            Event::EngineFailed(error) => tracing::warn!("{error}; loading the networks again"),
            Event::EngineReloaded => tracing::info!("networks loaded again"),
        }
    }

    fn blind(&mut self, what: &str, reason: String) {
        if self.blind_because.is_new(&reason) {
            tracing::warn!("{what}: {reason}; trying again");
        }
        self.camera = Err(reason);
    }

    pub(super) fn camera_line(&self) -> String {
        match &self.camera {
            Ok(camera) => format!("camera opened: {camera}"),
            Err(reason) => format!("blind, because {reason}"),
        }
    }

    /// Logs the system's answer to a real-time request, unless the answer is the same as before.
    pub(super) fn grant(&mut self, grant: Grant) {
        if self.grants.contains(&grant) {
            return;
        }
        match grant.remedy() {
            None => tracing::info!("{grant}"),
            Some(remedy) => tracing::warn!("{grant}: {remedy}"),
        }
        self.grants.retain(|known| !known.is_same_request(&grant));
        self.grants.push(grant);
    }

    /// Logs which link's packets the network does not take, and why, once for each reason.
    pub(super) fn refusal(&mut self, refusal: Option<String>) {
        match refusal {
            None => self.refusal.clear(),
            Some(reason) if self.refusal.is_new(&reason) => tracing::warn!("{reason}"),
            Some(_) => {}
        }
    }

    /// Logs each impairment that has begun since the last call. The status line says when it has passed.
    pub(super) fn impairments(&mut self, present: ImpairmentSet) {
        let before = std::mem::replace(&mut self.impaired_by, present);
        for (impairment, logged_at) in Impairment::ALL.into_iter().zip(&mut self.impaired_at) {
            let has_begun = present.contains(impairment) && !before.contains(impairment);
            if has_begun && logged_at.is_none_or(|logged_at| logged_at.elapsed() >= IMPAIRMENT_PERIOD) {
                *logged_at = Some(Instant::now());
                tracing::warn!("tracking is impaired: {}", impairment.sentence());
            }
        }
    }

    /// Logs that the pipeline has changed to a lower step, why, and what the operator can do about it.
    pub(super) fn step_down(step: Step, cause: Cause, load: &Load) {
        let what = step.sentence();
        let reason = match cause {
            Cause::Hot => Impairment::Hot.sentence().to_owned(),
            Cause::Undervoltage => Impairment::Undervoltage.sentence().to_owned(),
            Cause::Slow => {
                let [busy_ms, period_ms] = [load.busy, load.camera_period].map(|time| time.as_secs_f64() * 1000.0);
                if load.is_too_slow_on(step) {
                    tracing::warn!(
                        "too slow: a frame takes {busy_ms:.0} ms, and no step makes up for that: poses come too late, and the \
                         face stays neutral; end other programs, or use a faster board"
                    );
                }
                format!(
                    "a frame takes {busy_ms:.1} ms, and the camera has one every {period_ms:.1} ms: end other programs, or set \
                     a lower camera.fps or a smaller camera.width and camera.height"
                )
            }
        };
        tracing::warn!("step {step}: {what}, because {reason}");
    }

    pub(super) fn step_up(step: Step) {
        tracing::info!("step {step}: {} again", step.sentence());
    }

    /// Logs that the camera is opened again with pictures of another size, and why.
    pub(super) fn picture_size(is_small: bool, load: Option<Load>) {
        match load {
            Some(load) if is_small => tracing::warn!(
                "small picture: the camera is opened with half the width and height, because decoding takes {:.1} ms of the \
                 {:.1} ms of a frame: set a smaller camera.width and camera.height to begin with such a picture",
                load.decoding.as_secs_f64() * 1000.0,
                load.busy.as_secs_f64() * 1000.0
            ),
            _ => tracing::info!("full picture: the camera is opened with the width and height of the settings again"),
        }
    }

    pub(super) fn is_status_due(&self) -> bool {
        Instant::now() >= self.status_due
    }

    pub(super) fn status(&mut self, counters: &Counters) -> String {
        let line = self.status_line(counters);
        if self.camera.is_ok() {
            tracing::info!("{line}");
        } else {
            tracing::warn!("{line}");
        }
        line
    }

    fn status_line(&mut self, counters: &Counters) -> String {
        let (now, status, count) = (Instant::now(), counters.status_line(), counters.frames.load(Relaxed));
        let (last, last_count) = std::mem::replace(&mut self.last_status, (now, count));
        self.status_due = now + STATUS_PERIOD;
        let fps = (count - last_count) as f64 / now.duration_since(last).as_secs_f64().max(f64::EPSILON);
        let mut line = match &self.camera {
            Ok(_) => format!("fps={fps:.1} {status}"),
            Err(_) => format!("{}: {status}", self.camera_line()),
        };
        for (index, grant) in self.grants.iter().enumerate() {
            let separator = if index == 0 { "; real time: " } else { ", " };
            // Writing to a string does not fail.
            let _ = write!(line, "{separator}{grant}");
        }
        line
    }
}
