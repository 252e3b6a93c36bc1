//! The control socket: programs on this machine calibrate wearers, choose the one in use and record while the
//! service runs.
//!
//! The thread `fw-control` listens at a Unix socket in the runtime directory, which only the service's user and root may
//! open. It runs the guide on what the hot loop observes, keeps the profile, and hands it to the hot loop through the
//! mailbox of reloads. One calibration and one recording run at a time, and a client that closes its connection ends its
//! own. No client can hold up the thread: connections do not block, and their number, the length of a line and the time
//! until the request are limited.

mod client;
pub(crate) mod protocol;
mod session;
pub(crate) mod socket;

use std::io::{self, PipeReader, PipeWriter, pipe};
use std::os::fd::AsFd as _;
use std::path::PathBuf;
use std::sync::mpsc;
use std::thread::{Builder, JoinHandle, sleep};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use facewire_packet::Reason;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use self::client::Client;
use self::protocol::{Reply, Request};
use self::session::Session;
use super::hot::HotNews;
use super::listener::Listener;
use super::observer::Observed;
use super::reload::Mailbox;
use crate::calibration::{Observation, Store, WearerName};
use crate::capture::monotonic_us;
use crate::config::Settings;
use crate::preflight::{is_same_profile, load_model, load_profile};
use crate::recording::Recorded;
use crate::solve::Profile;

/// Number of clients at a time. The others wait in the queue of the socket.
const MAX_CLIENTS: usize = 4;
/// Time between two looks at the newest observation, and at clients that have not asked yet.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };
const WAIT: Timespec = Timespec { tv_sec: 0, tv_nsec: 500_000_000 };
/// Time without a frame after which a client that records is told so, microseconds.
const SILENT_US: u64 = 1_000_000;
/// How long a stopping service waits for a profile that is being written.
const DISK_PATIENCE: Duration = Duration::from_secs(1);
/// Delay before the next attempt after listening or accepting a client has failed.
const RETRY_DELAY: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };
/// Stack of the thread: reading a profile and a model takes most of it.
const STACK_BYTES: usize = 512 << 10;
/// The wearer who is calibrated if the client names none and none is in use.
pub(crate) const DEFAULT_WEARER: &str = "default";

/// A handle to the control thread. Dropping it ends the thread, and cancels the calibration.
#[derive(Debug)]
pub(super) struct Control {
    stop: Option<PipeWriter>,
    thread: Option<JoinHandle<()>>,
}

/// What the control thread works with.
pub(super) struct Parts {
    pub(super) settings: Settings,
    /// New settings, after a reload.
    pub(super) changes: mpsc::Receiver<Settings>,
    /// The wearer whose profile is in use.
    pub(super) in_use: Option<WearerName>,
    pub(super) observed: Observed<Observation>,
    pub(super) recorded: Observed<Recorded>,
    pub(super) hot: Mailbox<HotNews>,
}

impl Control {
    /// Starts the thread. Without a runtime directory there is no socket, and no thread.
    ///
    /// # Errors
    /// The system could not create a pipe or a thread.
    pub(super) fn start(parts: Parts) -> io::Result<Self> {
        let Some(path) = socket::path() else {
            tracing::debug!("no control socket: neither RUNTIME_DIRECTORY nor XDG_RUNTIME_DIR is set");
            return Ok(Self { stop: None, thread: None });
        };
        Self::listen_at(path, parts)
    }

    fn listen_at(path: PathBuf, parts: Parts) -> io::Result<Self> {
        let (stop_signal, stop) = pipe()?;
        let server = Server { path, parts, stop_signal, clients: Vec::new(), session: None, recording: None };
        let builder = Builder::new().name("fw-control".to_owned()).stack_size(STACK_BYTES);
        Ok(Self { stop: Some(stop), thread: Some(builder.spawn(move || server.run())?) })
    }
}

impl Drop for Control {
    /// Waits for no client, and for a disk that does not answer no longer than [`DISK_PATIENCE`].
    fn drop(&mut self) {
        self.stop = None;
        let Some(thread) = self.thread.take() else { return };
        let end = Instant::now() + DISK_PATIENCE;
        while !thread.is_finished() && Instant::now() < end {
            sleep(Duration::from_millis(5));
        }
        if thread.is_finished() {
            // A panic of the thread is ignored: the service does not depend on it.
            let _ = thread.join();
        }
    }
}

struct Server {
    path: PathBuf,
    parts: Parts,
    /// [`Control`] closes the other end of this pipe to stop the thread.
    stop_signal: PipeReader,
    clients: Vec<Client>,
    session: Option<Session>,
    /// The client that records, and when it was told something last.
    recording: Option<(Client, u64)>,
}

impl Server {
    fn run(mut self) {
        let Some(listener) = self.bind() else { return };
        tracing::info!("control socket {}", self.path.display());
        while let Ok(is_waiting) = self.wait(&listener) {
            if is_waiting {
                match listener.accept_unix() {
                    Ok(stream) => self.clients.push(Client::new(stream)),
                    // Without memory or file descriptors the client stays in the queue.
                    Err(_) if self.stops_within(&RETRY_DELAY) => break,
                    Err(_) => {}
                }
            }
            self.adopt();
            self.serve();
            self.calibrate();
            self.record();
        }
        self.parts.observed.ask(false);
        self.parts.recorded.ask(false);
    }

    /// Waits, and returns early with `true` if the thread is to stop.
    fn stops_within(&self, time: &Timespec) -> bool {
        poll(&mut [PollFd::new(&self.stop_signal, PollFlags::IN)], Some(time)) != Ok(0)
    }

    /// Retries until the socket is open. `None` if the thread is to stop.
    fn bind(&self) -> Option<Listener> {
        let mut has_warned = false;
        loop {
            match socket::bind(&self.path) {
                Ok(listener) => return Some(listener),
                Err(error) if !has_warned => {
                    let path = self.path.display();
                    tracing::warn!(
                        "no control socket at {path} ({error}): end the service that uses it, or make its folder writable; trying again every second"
                    );
                    has_warned = true;
                }
                Err(_) => {}
            }
            if self.stops_within(&RETRY_DELAY) {
                return None;
            }
        }
    }

    /// Waits until there is something to do. Returns whether a connection waits.
    ///
    /// # Errors
    /// The thread is to stop.
    fn wait(&self, listener: &Listener) -> io::Result<bool> {
        let listener = listener.as_fd();
        let mut polled = vec![PollFd::new(&self.stop_signal, PollFlags::IN)];
        polled.extend(self.clients.iter().map(|client| PollFd::new(client, PollFlags::IN)));
        if self.clients.len() < MAX_CLIENTS {
            polled.push(PollFd::new(&listener, PollFlags::IN));
        }
        let is_busy = self.session.is_some() || self.recording.is_some();
        let timeout = match (is_busy, self.clients.is_empty()) {
            (true, _) => Some(&LOOK),
            (false, false) => Some(&WAIT),
            (false, true) => None,
        };
        if let Err(error) = poll(&mut polled, timeout) {
            return if error == rustix::io::Errno::INTR { Ok(false) } else { Err(error.into()) };
        }
        let is_ready = |polled: Option<&PollFd>| polled.is_some_and(|polled| !polled.revents().is_empty());
        if is_ready(polled.first()) {
            return Err(io::ErrorKind::Interrupted.into());
        }
        Ok(polled.len() > 1 + self.clients.len() && is_ready(polled.last()))
    }

    /// Takes in the settings of a reload.
    fn adopt(&mut self) {
        while let Ok(settings) = self.parts.changes.try_recv() {
            if !is_same_profile(&settings.wearer, &self.parts.settings.wearer) {
                self.parts.in_use = WearerName::new(&settings.wearer.name);
            }
            self.parts.settings = settings;
        }
    }

    /// Answers the clients that have asked, and leaves those that have gone.
    fn serve(&mut self) {
        for mut client in std::mem::take(&mut self.clients) {
            match client.request() {
                Ok(None) => self.clients.push(client),
                Ok(Some(Ok(request))) => self.answer(client, request),
                Ok(Some(Err(refusal))) => client.answer(&Reply::Refused(refusal)),
                Err(_) => {}
            }
        }
    }

    fn answer(&mut self, mut client: Client, request: Request) {
        let outcome = match request {
            Request::Calibrate { wearer } => return self.begin(client, wearer.as_deref()),
            Request::Use { wearer: Some(name) } => named(&name).and_then(|name| self.wear(&name)),
            Request::Use { wearer: None } => {
                self.hand_over(Profile::default(), None);
                Ok(Reply::Done("nobody's profile is in use, until the next start of the service".to_owned()))
            }
            Request::Delete { wearer } => named(&wearer).and_then(|name| self.delete(&name)),
            Request::List {} => self.list(),
            Request::Record {} if self.recording.is_none() => {
                tracing::info!("recording begins");
                self.parts.recorded.ask(true);
                self.recording = Some((client, monotonic_us()));
                return;
            }
            Request::Record {} => Err("another recording is in progress: try again when it has ended".to_owned()),
        };
        client.answer(&outcome.unwrap_or_else(Reply::Refused));
    }

    fn store(&self) -> Store {
        Store::new(&self.parts.settings.wearer.folder)
    }

    /// Deletes the profile of this wearer. It is then in use no longer.
    fn delete(&mut self, name: &WearerName) -> Result<Reply, String> {
        self.store().delete(name).map_err(|error| error.to_string())?;
        if self.parts.in_use.as_ref() == Some(name) {
            self.hand_over(Profile::default(), None);
        }
        Ok(Reply::Done(format!("the profile of {name} is deleted")))
    }

    fn list(&self) -> Result<Reply, String> {
        let store = self.store();
        let wearers = store.list().map_err(|error| error.to_string())?;
        let in_use = self.parts.in_use.as_ref().map(ToString::to_string);
        Ok(Reply::Wearers { wearers, in_use, folder: store.folder().display().to_string() })
    }

    /// Uses the profile of this wearer.
    fn wear(&mut self, name: &WearerName) -> Result<Reply, String> {
        let mut wearer = self.parts.settings.wearer.clone();
        name.as_str().clone_into(&mut wearer.name);
        let profile = load_profile(&wearer).map_err(|error| error.to_string())?;
        self.hand_over(profile, Some(name.clone()));
        Ok(Reply::Done(format!(
            "the profile of {name} is in use; to use it after every start, set wearer.name = \"{name}\" in the settings"
        )))
    }

    /// Hands a profile to the hot loop.
    fn hand_over(&mut self, profile: Profile, name: Option<WearerName>) {
        tracing::info!("wearer {}", name.as_ref().map_or("nobody", WearerName::as_str));
        self.parts.hot.send(HotNews::Wearer(Box::new(profile)));
        self.parts.in_use = name;
    }

    /// Begins a calibration for a client.
    fn begin(&mut self, mut client: Client, wearer: Option<&str>) {
        let of_settings = || self.parts.in_use.as_ref().map_or(DEFAULT_WEARER, WearerName::as_str);
        let begun = named(wearer.unwrap_or_else(of_settings)).and_then(|name| {
            if self.session.is_some() {
                return Err("another calibration is in progress: try again when it has ended".to_owned());
            }
            let model = load_model(&self.parts.settings.solver).map_err(|error| error.to_string())?;
            Ok((name, model))
        });
        match begun {
            Ok((name, model)) => {
                tracing::info!("calibration of wearer {name} begins");
                self.parts.observed.ask(true);
                self.session = Some(Session::new(client, name, model, monotonic_us()));
            }
            Err(refusal) => client.answer(&Reply::Refused(refusal)),
        }
    }

    /// Goes on with the calibration in progress.
    fn calibrate(&mut self) {
        let Some(session) = &mut self.session else { return };
        if session.client_has_gone() {
            tracing::info!("calibration of wearer {} cancelled", session.name);
            self.end();
            return;
        }
        session.step(self.parts.observed.take(), monotonic_us());
        if session.outcome().is_some() {
            self.finish();
        }
    }

    /// Tells the client that records what the newest frame shows, or once a second that there is none. A client that does
    /// not read is disconnected.
    fn record(&mut self) {
        let Some((client, told_us)) = &mut self.recording else { return };
        let now_us = monotonic_us();
        let frame = match self.parts.recorded.take() {
            Some(frame) => Some(frame.to_bytes()),
            None if now_us.saturating_sub(*told_us) < SILENT_US => None,
            None => Some(Recorded::nothing(now_us, Reason::NoCamera).to_bytes()),
        };
        let has_failed = frame.is_some_and(|frame| {
            *told_us = now_us;
            client.send(&Reply::Frame(BASE64_STANDARD.encode(frame))).is_err()
        });
        if has_failed || client.has_gone() {
            tracing::info!("recording ended");
            self.parts.recorded.ask(false);
            self.recording = None;
        }
    }

    /// Ends the calibration, and returns it.
    fn end(&mut self) -> Option<Session> {
        self.parts.observed.ask(false);
        self.session.take()
    }

    /// Keeps what the calibration has found, uses it, and tells the client.
    fn finish(&mut self) {
        let Some(mut session) = self.end() else { return };
        let name = session.name.clone();
        let reply = match session.outcome() {
            Some(Ok(calibration)) => {
                let profile = calibration.profile.clone();
                match self.store().keep(&name, calibration) {
                    Ok(report) => {
                        self.hand_over(profile, Some(name.clone()));
                        Reply::Calibrated(report)
                    }
                    Err(error) => Reply::Refused(error.to_string()),
                }
            }
            Some(Err(refusal)) => Reply::Refused(refusal.end()),
            None => return,
        };
        if let Reply::Refused(reason) = &reply {
            tracing::warn!("calibration of wearer {name}: {reason}");
        }
        session.client.answer(&reply);
    }
}

fn named(text: &str) -> Result<WearerName, String> {
    WearerName::new(text).ok_or_else(|| format!("no name of a wearer: give {}", WearerName::EXPECTED))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic)]
mod tests;
