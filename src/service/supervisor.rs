//! The supervisor: signals, reloads, watchdog and log, on the thread that starts the others.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use sd_notify::NotifyState;
use triple_buffer::Output;

use super::adaptation::{Adaptation, Cause, Conditions, Load, Step};
use super::counters::Counters;
use super::hot::Event;
use super::realtime::{self, Grant};
use super::reload::Reloader;
use crate::clock::monotonic_us;
use crate::link::Panel;
use crate::retry::{LoggedReasons, has_lasted};
use facewire_board::{self as board, Hardware, Impairment, ImpairmentSet, Machine};
use facewire_face::Rotation;

const TICK: Duration = Duration::from_millis(50);
const STATUS_PERIOD: Duration = Duration::from_secs(10);
const LISTEN_PERIOD: Duration = Duration::from_millis(500);
/// What impairs tracking, and that the board is too slow, is not logged again within this time.
const IMPAIRMENT_PERIOD: Duration = Duration::from_mins(10);

pub(super) struct Supervisor {
    pub(super) counters: Arc<Counters>,
    pub(super) events: Receiver<Event>,
    pub(super) load: Output<Option<Load>>,
    pub(super) reloader: Reloader,
    pub(super) adaptation: Adaptation,
    pub(super) log: Log,
}

impl Supervisor {
    /// Runs until the service is to stop, or until `all_run` says that a thread has ended by itself.
    pub(super) fn run(&mut self, all_run: impl Fn() -> bool) {
        tracing::info!("board {}", Machine::detect(&board::root()).tell(self.reloader.live.board));
        let mut hardware = Hardware::new(board::root(), self.reloader.live.hardware.clone());
        let watchdog = sd_notify::watchdog_enabled();
        let mut pinged_at = Instant::now();
        self.log.camera = "blind, because no camera has been opened yet".to_owned();
        self.log.last_status = Some((Instant::now(), 0));
        self.lock_memory();
        notify(NotifyState::Ready);
        while !self.counters.stopping() && all_run() {
            self.receive();
            self.reload();
            let now_us = monotonic_us();
            // The manager is pinged twice in each period of its watchdog.
            if watchdog.is_some_and(|period| pinged_at.elapsed() >= period / 2)
                && self.counters.heartbeats.are_alive(now_us)
            {
                pinged_at = Instant::now();
                notify(NotifyState::Watchdog);
            }
            // A rehearsal may set other impairments.
            if let Some(found) = hardware.poll(&self.reloader.live.hardware, now_us) {
                self.counters.impairments.set_all(Hardware::FINDS, found);
            }
            self.adapt(now_us);
            self.log.impairments(self.counters.impairments.present());
            self.listen();
            self.tell_status();
        }
        tracing::info!("stopping");
        notify(NotifyState::Stopping);
    }

    /// Waits up to one [`TICK`] for an event.
    fn receive(&mut self) {
        let Ok(event) = self.events.recv_timeout(TICK) else { return };
        let takes_memory = matches!(event, Event::Opened(_) | Event::EngineReloaded);
        let before = self.log.camera.clone();
        self.log.event(event, Instant::now());
        if self.log.camera != before {
            notify(NotifyState::Status(&self.log.camera));
        }
        if takes_memory {
            self.lock_memory();
        }
    }

    fn reload(&mut self) {
        if self.reloader.change.is_none() {
            self.reloader.askers.extend(self.reloader.asked.try_iter());
            if self.counters.wants_reload.swap(false, Relaxed) || !self.reloader.askers.is_empty() {
                self.reloader.start();
            }
        }
        if self.reloader.step() {
            self.lock_memory();
        }
    }

    fn adapt(&mut self, now_us: u64) {
        let counters = &self.counters;
        let adaptation = &mut self.adaptation;
        let load = self.load.read().filter(|_| counters.camera_open.load(Relaxed));
        let before = (adaptation.step, adaptation.picture.is_small);
        let conditions = Conditions {
            is_allowed: self.reloader.live.adaptation.enabled,
            load,
            impaired_by: counters.impairments.present(),
            has_smaller_mode: counters.has_smaller_mode.load(Relaxed),
        };
        adaptation.update(now_us, &conditions);
        let Adaptation { step, cause, .. } = *adaptation;
        if step != before.0 {
            counters.set_step(step, cause);
            Log::step(step, cause.filter(|_| step > before.0).zip(load));
        }
        if adaptation.picture.is_small != before.1 {
            counters.small_picture.store(adaptation.picture.is_small, Relaxed);
            Log::picture_size(load.filter(|_| adaptation.picture.is_small));
        }
        if let Some(load) = load.filter(|_| adaptation.is_too_slow && is_due(&mut self.log.too_slow_at)) {
            tracing::warn!(
                "too slow: a frame takes {:.0} ms, and no step makes up for that: poses come too late, and the face stays \
                 neutral; end other programs, or use a faster board",
                ms(load.busy)
            );
        }
    }

    /// Hears what has come back from receivers.
    fn listen(&mut self) {
        let now = Instant::now();
        if self.log.listened_at.is_none_or(|at| now.saturating_duration_since(at) >= LISTEN_PERIOD) {
            self.log.listened_at = Some(now);
            self.counters.panels().iter().for_each(|panel| panel.listen(now));
        }
    }

    fn tell_status(&mut self) {
        let is_asked = self.counters.wants_status.swap(false, Relaxed);
        if !is_asked && self.log.last_status.is_some_and(|(last, _)| last.elapsed() < STATUS_PERIOD) {
            return;
        }
        self.lock_memory();
        notify(NotifyState::Status(&self.log.status(&self.counters)));
        let refused = |panel: &Arc<Panel>| Some(format!("link {}: {}", panel.receiver, panel.refusal()?));
        match self.counters.panels().iter().find_map(refused) {
            Some(line) if self.log.refusals.is_new(&line) => tracing::warn!("{line}"),
            Some(_) => {}
            None => self.log.refusals = LoggedReasons::default(),
        }
    }

    fn lock_memory(&mut self) {
        if self.reloader.live.realtime.lock_memory {
            self.log.grant(realtime::lock_memory());
        }
    }
}

#[derive(Default)]
pub(super) struct Log {
    /// Which camera is open, or why there are no pictures.
    camera: String,
    is_open: bool,
    opened_at: Option<Instant>,
    /// The rotation that was proposed last.
    turned: Option<Rotation>,
    blind_reasons: LoggedReasons,
    /// Whether the camera opens and fails at once, again and again.
    flaps: bool,
    refusals: LoggedReasons,
    impaired_by: ImpairmentSet,
    impaired_at: [Option<Instant>; Impairment::ALL.len()],
    too_slow_at: Option<Instant>,
    listened_at: Option<Instant>,
    grants: Vec<Grant>,
    /// Time of the last status line, or of the start, and the count of frames in it.
    last_status: Option<(Instant, u64)>,
}

impl Log {
    /// Logs an event. Repeated attempts that fail for the same reason are logged once, as is a camera that opens and fails again
    /// and again.
    pub(super) fn event(&mut self, event: Event, now: Instant) {
        match event {
            Event::Started(grants) => grants.into_iter().for_each(|grant| self.grant(grant)),
            Event::Opened(camera) => {
                self.camera = format!("camera opened: {camera}");
                self.is_open = true;
                self.opened_at = Some(now);
                if !self.flaps || self.blind_reasons.is_new(&self.camera) {
                    tracing::info!("{}", self.camera);
                }
            }
            Event::FalseClock => tracing::warn!(
                "the camera driver's timestamps cannot be true: from now on each frame is dated by its arrival, so that its age is \
                 slightly underestimated; a newer driver or another camera may help"
            ),
            Event::Turned(rotation) => {
                if self.turned.replace(rotation) != Some(rotation) {
                    tracing::warn!(
                        "the camera seems to be mounted on its side or upside down: set camera.rotation = {}, which shows the face \
                         upright",
                        rotation.degrees()
                    );
                }
            }
            Event::Blind(what, reason) => {
                let opened_for = self.opened_at.take().map(|opened_at| now.saturating_duration_since(opened_at));
                if opened_for.is_some_and(has_lasted) {
                    self.blind_reasons = LoggedReasons::default();
                }
                let is_new = self.blind_reasons.is_new(&reason);
                if is_new {
                    tracing::warn!("{what}: {reason}; trying again");
                }
                if opened_for.is_some() {
                    self.flaps = !is_new;
                }
                self.camera = format!("blind, because {reason}");
                self.is_open = false;
            }
            Event::EngineFailed(error) => tracing::warn!("{error}; loading the networks again"),
            Event::EngineReloaded => tracing::info!("networks loaded again"),
        }
    }

    /// Logs the system's answer to a real-time request, unless the answer is the same as before.
    fn grant(&mut self, grant: Grant) {
        if self.grants.contains(&grant) {
            return;
        }
        match &grant.refusal {
            None => tracing::info!("{grant}"),
            Some((_, remedy)) => tracing::warn!("{grant}: {remedy}"),
        }
        self.grants.retain(|known| known.request != grant.request);
        self.grants.push(grant);
    }

    /// Logs each impairment that has begun since the last call. The status line says when it has passed.
    fn impairments(&mut self, present: ImpairmentSet) {
        let before = std::mem::replace(&mut self.impaired_by, present);
        for (impairment, logged_at) in Impairment::ALL.into_iter().zip(&mut self.impaired_at) {
            if present.contains(impairment) && !before.contains(impairment) && is_due(logged_at) {
                tracing::warn!("tracking is impaired: {}", impairment.sentence());
            }
        }
    }

    /// Logs the new step of the pipeline, and for a lower one the reason and what the operator can do about it.
    fn step(step: Step, lowered_by: Option<(Cause, Load)>) {
        let name = step.name();
        let what = step.sentence();
        let reason = match lowered_by {
            None => return tracing::info!("step {name}: {what} again"),
            Some((Cause::Hot, _)) => Impairment::Hot.sentence().to_owned(),
            Some((Cause::Undervoltage, _)) => Impairment::Undervoltage.sentence().to_owned(),
            Some((Cause::Slow, load)) => format!(
                "a frame takes {:.1} ms, and the camera has one every {:.1} ms: end other programs, or set a lower \
                 camera.fps or a smaller camera.width and camera.height",
                ms(load.busy),
                ms(load.camera_period)
            ),
        };
        tracing::warn!("step {name}: {what}, because {reason}");
    }

    /// Logs that the camera is opened again with another picture size: the small one because of this load, if given.
    fn picture_size(too_slow: Option<Load>) {
        match too_slow {
            Some(load) => tracing::warn!(
                "small picture: the camera is opened with half the width and height, because decoding takes {:.1} ms of the \
                 {:.1} ms of a frame: set a smaller camera.width and camera.height to begin with such a picture",
                ms(load.decoding),
                ms(load.busy)
            ),
            None => tracing::info!("full picture: the camera is opened with the size of the settings again"),
        }
    }

    fn status(&mut self, counters: &Counters) -> String {
        let now = Instant::now();
        let status = counters.status_line();
        let count = counters.frames.load(Relaxed);
        let (last, last_count) = self.last_status.replace((now, count)).unwrap_or((now, count));
        let fps = (count - last_count) as f64 / now.duration_since(last).as_secs_f64().max(f64::EPSILON);
        let grants = self.grants.iter().map(Grant::to_string).collect::<Vec<_>>().join(", ");
        let grants = if grants.is_empty() { grants } else { format!("; real time: {grants}") };
        if self.is_open {
            let line = format!("fps={fps:.1} {status}{grants}");
            tracing::info!("{line}");
            return line;
        }
        let line = format!("{}: {status}{grants}", self.camera);
        tracing::warn!("{line}");
        line
    }
}

/// Whether something was not logged within the last [`IMPAIRMENT_PERIOD`]. It counts as logged now.
fn is_due(logged_at: &mut Option<Instant>) -> bool {
    let is_due = logged_at.is_none_or(|logged_at| logged_at.elapsed() >= IMPAIRMENT_PERIOD);
    if is_due {
        *logged_at = Some(Instant::now());
    }
    is_due
}

fn notify(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::debug!("the service manager could not be notified: {error}");
    }
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::testing::logged;

    #[test]
    fn a_camera_that_opens_and_fails_again_and_again_is_logged_once_and_one_that_lasted_a_second_each_time() {
        let mut log = Log::default();
        let mut now = Instant::now();
        let mut lines = |works_for_ms: u64| {
            let work = || {
                log.event(Event::Opened("Webcam".to_owned()), now);
                now += Duration::from_millis(works_for_ms);
                log.event(Event::Blind("camera lost", "it is gone".to_owned()), now);
                log.event(Event::Blind("no camera", "there is none".to_owned()), now);
            };
            let text = logged(work);
            ["camera opened: Webcam", "camera lost: it is gone", "no camera: there is none"]
                .map(|line| text.matches(line).count())
        };
        assert_eq!(lines(10), [1, 1, 1]);
        assert_eq!(lines(10), [1, 0, 0]);
        let flaps: usize = (0..100).flat_map(|_| lines(999)).sum();
        assert!(flaps <= 1, "{flaps}");
        assert_eq!([lines(1000), lines(1000)], [[0, 1, 1], [1, 1, 1]]);
    }
}
