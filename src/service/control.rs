//! The control thread: programs on this machine calibrate wearers, choose the one in use, record, and read the metrics
//! while the service runs.
//!
//! It has two doors: a Unix socket in the runtime directory, for the service's user and root alone, and the address of
//! the metrics. One calibration and one recording run at a time, and a client that closes its connection ends its own. No
//! client can hold up the thread: connections do not block, and their number, the length of a request and the time until
//! it has come are limited.

pub(super) mod client;

use std::error::Error;
use std::fs::{DirBuilder, Permissions, set_permissions};
use std::io::{self, ErrorKind, PipeReader, PipeWriter, pipe};
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, mpsc};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use facewire_packet::Reason;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use self::client::{Client, Reply, Request, Speaks};
use super::counters::Counters;
use super::hot::HotChange;
use super::metrics;
use super::observer::Observed;
use super::reload::Mailbox;
use crate::calibration::{Guide, Observation, Progress, Store, WearerName, model_hash};
use crate::capture::monotonic_us;
use crate::config::{Listen, Settings, WearerSettings};
use crate::listener::Listener;
use crate::pipeline::{is_same_profile, load_model, load_profile};
use crate::recording::Recorded;
use facewire_face::Profile;

/// Number of clients at a time at each door. The others wait in the queue of the socket.
const MAX_CLIENTS: usize = 4;
/// Time between two looks at what clients ask and the hot loop shows, and without clients at new settings.
const LOOK_BUSY: Timespec = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };
const LOOK_IDLE: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };
/// Time in which a client must ask, and in which it must take the answer.
const ASK_PATIENCE: Duration = Duration::from_secs(2);
const HTTP_PATIENCE: Duration = Duration::from_millis(500);
/// Time in which a client that calibrates or records must take what it was sent.
const STREAM_PATIENCE: Duration = Duration::from_secs(10);
/// Delay before the next attempt after listening or accepting a client has failed.
const RETRY_DELAY: Duration = Duration::from_secs(1);
/// Time without a frame after which a client that records is told of lost frames or a missing camera, microseconds.
const QUIET_US: u64 = 1_000_000;
/// The guide is told that no picture comes after this time, microseconds, or after this many frame periods if longer.
const SILENT_US: u64 = 500_000;
const SILENT_FRAMES: u64 = 3;
/// Least time between two messages of progress that differ only in the bars, microseconds.
const PROGRESS_US: u64 = 60_000;
const STACK_BYTES: usize = 512 << 10;
/// The wearer who is calibrated if the client names none and none is in use.
pub const DEFAULT_WEARER: &str = "default";

struct Door {
    listen: Listen,
    speaks: Speaks,
    listener: Option<Listener>,
    /// Until when the door is left alone, since listening or accepting a client failed last.
    rests_until: Option<Instant>,
}

impl Door {
    fn new(listen: Listen, speaks: Speaks) -> Self {
        Self { listen, speaks, listener: None, rests_until: None }
    }

    fn rests(&self) -> bool {
        self.rests_until.is_some_and(|until| Instant::now() < until)
    }

    fn bind(&self) -> io::Result<Listener> {
        let (Listen::Unix(path), Speaks::Requests) = (&self.listen, self.speaks) else {
            return Listener::bind(&self.listen);
        };
        if let Some(folder) = path.parent() {
            DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
        }
        let listener = Listener::bind(&self.listen)?;
        set_permissions(path, Permissions::from_mode(0o600))?;
        Ok(listener)
    }

    /// Opens the socket if it is not open yet. A failure is told once, and tried again every second.
    fn open(&mut self) {
        if self.listen == Listen::Off || self.listener.is_some() || self.rests() {
            return;
        }
        let (what, remedy) = match self.speaks {
            Speaks::Requests => ("control socket", "end the service that uses it, or make its folder writable"),
            Speaks::Http => ("metrics", "free the address or change metrics.listen"),
        };
        match self.bind() {
            Ok(listener) => {
                tracing::info!("{what} at {}", self.listen);
                self.listener = Some(listener);
            }
            Err(error) => {
                if self.rests_until.is_none() {
                    tracing::warn!("no {what} at {} ({error}): {remedy}; trying again every second", self.listen);
                }
                self.rests_until = Some(Instant::now() + RETRY_DELAY);
            }
        }
    }
}

pub(super) struct Server {
    doors: [Door; 2],
    settings: Settings,
    changes: mpsc::Receiver<Settings>,
    observed: Observed<Observation>,
    recorded: Observed<Recorded>,
    hot: Arc<Mailbox<HotChange>>,
    counters: Arc<Counters>,
    stop_signal: PipeReader,
    clients: Vec<Client>,
    calibrating: Option<Calibrating>,
    recording: Option<Recording>,
}

impl Server {
    /// Without a path there is no control socket. Also returns the end of the pipe that is closed to stop the thread.
    pub(super) fn new(
        path: Option<PathBuf>,
        settings: Settings,
        changes: mpsc::Receiver<Settings>,
        (observed, recorded): (Observed<Observation>, Observed<Recorded>),
        hot: Arc<Mailbox<HotChange>>,
        counters: Arc<Counters>,
    ) -> io::Result<(Self, PipeWriter)> {
        if path.is_none() {
            tracing::debug!("no control socket: neither RUNTIME_DIRECTORY nor XDG_RUNTIME_DIR is set");
        }
        let (stop_signal, stop) = pipe()?;
        let control = Door::new(path.map_or(Listen::Off, Listen::Unix), Speaks::Requests);
        let doors = [control, Door::new(settings.metrics.listen.clone(), Speaks::Http)];
        let (clients, calibrating, recording) = (Vec::new(), None, None);
        let server = Self {
            doors,
            settings,
            changes,
            observed,
            recorded,
            hot,
            counters,
            stop_signal,
            clients,
            calibrating,
            recording,
        };
        Ok((server, stop))
    }

    pub(super) fn start(self) -> io::Result<JoinHandle<()>> {
        Builder::new().name("fw-control".to_owned()).stack_size(STACK_BYTES).spawn(|| self.run())
    }

    /// Serves clients until the pipe is closed.
    fn run(mut self) {
        while self.wait() {
            self.adopt();
            self.serve();
            self.calibrate();
            self.record();
        }
        self.observed.ask(false);
        self.recorded.ask(false);
    }

    fn wait(&mut self) -> bool {
        self.doors.iter_mut().for_each(Door::open);
        let inside = |speaks| self.clients.iter().filter(|client| client.speaks == speaks).count();
        let admits = |door: &&mut Door| inside(door.speaks) < MAX_CLIENTS && !door.rests();
        let doors: Vec<_> = self.doors.iter_mut().filter(admits).collect();
        let mut polled = vec![PollFd::new(&self.stop_signal, PollFlags::IN)];
        polled.extend(doors.iter().filter_map(|door| Some(PollFd::new(door.listener.as_ref()?, PollFlags::IN))));
        let is_idle = self.clients.is_empty() && self.calibrating.is_none() && self.recording.is_none();
        if let Err(error) = poll(&mut polled, Some(if is_idle { &LOOK_IDLE } else { &LOOK_BUSY })) {
            return error == Errno::INTR;
        }
        let goes_on = polled.first().is_some_and(|stop| stop.revents().is_empty());
        for door in doors {
            match door.listener.as_ref().map(Listener::accept) {
                Some(Ok(stream)) => self.clients.push(Client::new(stream.into(), door.speaks)),
                Some(Err(error)) if error.kind() != ErrorKind::WouldBlock => {
                    // Without memory or file descriptors the client stays in the queue. The delay keeps the loop from
                    // spinning.
                    door.rests_until = Some(Instant::now() + RETRY_DELAY);
                }
                Some(Err(_)) | None => {}
            }
        }
        goes_on
    }

    fn adopt(&mut self) {
        while let Ok(settings) = self.changes.try_recv() {
            if !is_same_profile(&settings.wearer, &self.settings.wearer) {
                self.counters.set_wearer(WearerName::new(&settings.wearer.name));
            }
            let [_, door] = &mut self.doors;
            if door.listen != settings.metrics.listen {
                *door = Door::new(settings.metrics.listen.clone(), Speaks::Http);
            }
            self.settings = settings;
            if let Some(calibrating) = &self.calibrating
                && let Ok(model) = load_model(&self.settings.solver)
                && model_hash(&model) != calibrating.guide.calibration.model
            {
                // A profile of takes that two models have read would fit neither.
                let why = "no profile was made, and the former one stays. The blendshape model has changed: try again";
                self.end(Reply::Refused(why.to_owned()));
            }
        }
    }

    fn serve(&mut self) {
        for mut client in std::mem::take(&mut self.clients) {
            let patience = if client.speaks == Speaks::Http { HTTP_PATIENCE } else { ASK_PATIENCE };
            if client.has_waited(patience) {
                continue;
            }
            if client.is_behind() {
                self.send(client, Client::flush);
                continue;
            }
            let Ok(has_ended) = client.receive() else { continue };
            match client.speaks {
                Speaks::Http => match metrics::answer(&client.input, has_ended, &self.counters) {
                    Some(page) => self.send(client, |client| client.send_bytes(page.as_bytes())),
                    None => self.clients.push(client),
                },
                Speaks::Requests => match client.request() {
                    Some(Ok(request)) => self.answer(client, request),
                    Some(Err(refusal)) => self.send(client, |client| client.send(&Reply::Refused(refusal))),
                    None if has_ended => {}
                    None => self.clients.push(client),
                },
            }
        }
    }

    fn send(&mut self, mut client: Client, send: impl FnOnce(&mut Client) -> io::Result<()>) {
        if send(&mut client).is_ok() && client.is_behind() {
            self.clients.push(client);
        }
    }

    fn answer(&mut self, client: Client, request: Request) {
        let outcome = match request {
            Request::Calibrate { wearer } => match self.prepare(wearer.as_deref()) {
                Ok((name, guide)) => {
                    tracing::info!("calibration of wearer {name} begins");
                    self.observed.ask(true);
                    self.calibrating = Some(Calibrating::new(client, name, guide, monotonic_us()));
                    return;
                }
                Err(refusal) => Err(refusal),
            },
            Request::Record {} if self.recording.is_none() => {
                tracing::info!("recording begins");
                self.recorded.ask(true);
                self.recording = Some(Recording::new(client, monotonic_us()));
                return;
            }
            Request::Record {} => Err("another recording is in progress: try again when it has ended".into()),
            Request::Use { wearer: Some(name) } => self.set_wearer(&name),
            Request::Use { wearer: None } => {
                self.hand_over(Profile::default(), None);
                Ok(Reply::Done("nobody's profile is in use, until the next start of the service".to_owned()))
            }
            Request::Delete { wearer } => self.delete(&wearer),
            Request::List {} => self.list(),
        };
        let reply = outcome.unwrap_or_else(|refusal| Reply::Refused(refusal.to_string()));
        self.send(client, |client| client.send(&reply));
    }

    fn store(&self) -> Store {
        Store::new(&self.settings.wearer.folder)
    }

    fn delete(&mut self, name: &str) -> Outcome<Reply> {
        let name = named(name)?;
        self.store().delete(&name)?;
        if self.counters.wearer().as_ref() == Some(&name) {
            self.hand_over(Profile::default(), None);
        }
        Ok(Reply::Done(format!("the profile of {name} is deleted")))
    }

    fn list(&self) -> Outcome<Reply> {
        let (store, in_use) = (self.store(), self.counters.wearer().map(|name| name.to_string()));
        Ok(Reply::Wearers { wearers: store.list()?, in_use, folder: store.folder().display().to_string() })
    }

    fn set_wearer(&mut self, name: &str) -> Outcome<Reply> {
        let name = named(name)?;
        let settings = &self.settings;
        let wearer = WearerSettings { name: name.to_string(), ..settings.wearer.clone() };
        let (profile, warning) = load_profile(&wearer, &settings.solver)?;
        let warning = warning.map_or_else(String::new, |warning| format!(". {warning}"));
        self.hand_over(profile, Some(name.clone()));
        Ok(Reply::Done(format!(
            "the profile of {name} is in use; to use it after every start, set wearer.name = \"{name}\" in the settings{warning}"
        )))
    }

    fn hand_over(&mut self, profile: Profile, name: Option<WearerName>) {
        tracing::info!("wearer {}", name.as_ref().map_or("nobody", WearerName::as_str));
        self.hot.send(HotChange { profile: Some(profile), ..HotChange::default() });
        self.counters.set_wearer(name);
    }

    /// Loads what a calibration of this wearer, or else of the one in use, needs.
    fn prepare(&self, wearer: Option<&str>) -> Outcome<(WearerName, Guide)> {
        let in_use = self.counters.wearer();
        let name = named(wearer.unwrap_or_else(|| in_use.as_ref().map_or(DEFAULT_WEARER, WearerName::as_str)))?;
        if self.calibrating.is_some() {
            return Err("another calibration is in progress: try again when it has ended".into());
        }
        Ok((name, Guide::new(load_model(&self.settings.solver)?)))
    }

    fn calibrate(&mut self) {
        let Some(calibrating) = &mut self.calibrating else { return };
        let silent_us = SILENT_US.max(SILENT_FRAMES * self.counters.frame_period_us.load(Relaxed));
        let told = loop {
            let next = self.observed.take();
            let told = calibrating.step(next.as_ref(), silent_us, monotonic_us());
            if next.is_none() || told.is_err() || calibrating.guide.outcome().is_some() {
                break told;
            }
        };
        let Some(outcome) = calibrating.guide.outcome() else {
            if told.is_err() || calibrating.client.has_gone(STREAM_PATIENCE) {
                tracing::info!("calibration of wearer {} cancelled", calibrating.name);
                self.observed.ask(false);
                self.calibrating = None;
            }
            return;
        };
        let name = calibrating.name.clone();
        let kept = outcome.map_err(|refusal| refusal.end()).and_then(|calibration| {
            let profile = calibration.profile.clone();
            Ok((profile, self.store().keep(&name, calibration).map_err(|error| error.to_string())?))
        });
        let reply = kept.map_or_else(Reply::Refused, |(profile, kept)| {
            self.hand_over(profile, Some(name));
            Reply::Calibrated(kept)
        });
        self.end(reply);
    }

    fn end(&mut self, reply: Reply) {
        self.observed.ask(false);
        let Some(Calibrating { client, name, .. }) = self.calibrating.take() else { return };
        if let Reply::Refused(reason) = &reply {
            tracing::warn!("calibration of wearer {name}: {reason}");
        }
        self.send(client, |client| client.send(&reply));
    }

    fn record(&mut self) {
        let Some(recording) = &mut self.recording else { return };
        let is_camera_open = self.counters.camera_open.load(Relaxed);
        let sent = recording.step(&mut self.recorded, is_camera_open, monotonic_us());
        if sent.is_err() || recording.client.has_gone(STREAM_PATIENCE) {
            tracing::info!("recording ended, {} frames lost", recording.lost);
            self.recorded.ask(false);
            self.recording = None;
        }
    }
}

type Outcome<T> = Result<T, Box<dyn Error>>;

fn named(text: &str) -> Result<WearerName, String> {
    WearerName::new(text).ok_or_else(|| format!("no name of a wearer: give {}", WearerName::EXPECTED))
}

struct Calibrating {
    client: Client,
    name: WearerName,
    guide: Guide,
    /// When the last observation came, or the guide was told that none comes.
    observed_us: u64,
    /// What the client was told last, and when.
    told: Option<(Progress, u64)>,
}

impl Calibrating {
    fn new(client: Client, name: WearerName, guide: Guide, now_us: u64) -> Self {
        Self { client, name, guide, observed_us: now_us, told: None }
    }

    /// Takes in an observation if there is one, or that there was none for the time `silent_us`, and tells the client.
    fn step(&mut self, observation: Option<&Observation>, silent_us: u64, now_us: u64) -> io::Result<()> {
        match observation {
            Some(observation) => self.guide.update(observation),
            None if now_us.saturating_sub(self.observed_us) > silent_us => {
                self.guide.update(&Observation::nothing(now_us));
            }
            None => return Ok(()),
        }
        self.observed_us = now_us;
        let progress = self.guide.progress();
        let is_known = self.told.as_ref().is_some_and(|(told, told_us)| {
            now_us.saturating_sub(*told_us) < PROGRESS_US && told.says_the_same(&progress)
        });
        self.client.flush()?;
        if !is_known && !self.client.is_behind() {
            self.client.send(&Reply::Progress(progress.clone()))?;
            self.told = Some((progress, now_us));
        }
        Ok(())
    }
}

struct Recording {
    client: Client,
    sent_us: u64,
    /// The time of the last entry, when it was made, and whether it was a frame.
    last: Option<(u64, u64, bool)>,
    /// Frames that the client did not take in time, and all that were lost, as the client was told.
    refused: u64,
    lost: u64,
}

impl Recording {
    fn new(client: Client, now_us: u64) -> Self {
        Self { client, sent_us: now_us, last: None, refused: 0, lost: 0 }
    }

    /// Sends what the new frames show, how many were lost, and once a second that no camera is open.
    fn step(&mut self, frames: &mut Observed<Recorded>, is_camera_open: bool, now_us: u64) -> io::Result<()> {
        self.client.flush()?;
        while let Some(mut frame) = frames.take() {
            // The entry for a missing camera may be later than the capture of the frame that follows.
            if let Some((last_us, _, false)) = self.last {
                frame.time_us = frame.time_us.max(last_us + 1);
            }
            self.last = Some((frame.time_us, now_us, true));
            self.entry(&frame, now_us)?;
        }
        let is_quiet = now_us.saturating_sub(self.sent_us) >= QUIET_US;
        if is_quiet && !is_camera_open {
            // In the clock of the frames, so that a replay shows it when it happened.
            let time_us = self.last.map_or(now_us, |(time_us, at_us, _)| time_us + now_us.saturating_sub(at_us));
            self.last = Some((time_us, now_us, false));
            self.entry(&Recorded::nothing(time_us, Reason::NoCamera), now_us)?;
        }
        let lost = frames.lost() + self.refused;
        if (lost != self.lost || (is_quiet && is_camera_open)) && !self.client.is_behind() {
            (self.lost, self.sent_us) = (lost, now_us);
            self.client.send(&Reply::Lost(lost))?;
        }
        Ok(())
    }

    fn entry(&mut self, frame: &Recorded, now_us: u64) -> io::Result<()> {
        if self.client.is_behind() {
            self.refused += 1;
            return Ok(());
        }
        self.sent_us = now_us;
        self.client.send(&Reply::Frame(BASE64_STANDARD.encode(frame.to_bytes())))
    }
}

#[cfg(test)]
mod tests;
