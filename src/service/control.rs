//! The control thread: programs on this machine calibrate wearers, choose the one in use, record, watch, reload the settings,
//! and read the state and the metrics while the service runs.
//!
//! It has two doors: a Unix socket in the runtime directory, for the service's user and root alone or for a group as well,
//! and the address of the metrics. One calibration and one recording run at a time, and a client that closes its connection ends its own. No
//! client can hold up the thread: connections do not block, and their number, the length of a request and the time until
//! it has come are limited.

pub(super) mod client;

use std::collections::BTreeMap;
use std::error::Error;
use std::fs::{DirBuilder, Permissions, metadata, set_permissions};
use std::io::{self, ErrorKind, PipeReader, PipeWriter, pipe};
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, mpsc};
use std::thread::{Builder, JoinHandle, Thread};
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use facewire_packet::{BLENDSHAPES, Packet, Pose, Reason};
use nalgebra::{UnitQuaternion, Vector3};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use triple_buffer::Input;

use self::client::{Client, Drive, LinkStatus, PictureHead, Reply, Request, Role, Speaks, Status};
use super::counters::Counters;
use super::hot::HotChange;
use super::metrics;
use super::observer::Observed;
use super::picture::{self, Asker, Snapshot};
use super::reload::Mailbox;
use crate::calibration::{Guide, Observation, Progress, Store, WearerName, model_hash};
use crate::capture::monotonic_us;
use crate::config::{ConsoleSettings, Listen, Settings, WearerSettings};
use crate::listener::Listener;
use crate::pipeline::{is_same_profile, load_model, load_profile};
use crate::recording::Recorded;
use facewire_face::{Landmarks, Profile};

/// Number of clients at a time at each door. The others wait in the queue of the socket.
const MAX_CLIENTS: usize = 16;
/// How many of them may watch or wait, so that one who releases servos finds a free place.
const MAX_STAYING: usize = 8;
/// Time between two looks at what clients ask and the hot loop shows, and without clients at new settings.
const LOOK_BUSY: Timespec = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };
const LOOK_IDLE: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };
/// Time in which a client must ask, and in which it must take the answer.
const ASK_PATIENCE: Duration = Duration::from_secs(2);
const HTTP_PATIENCE: Duration = Duration::from_millis(500);
/// Time in which a client that calibrates, records or watches must take what it was sent.
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
/// Longest time that one who drives may be silent.
const DRIVE_PATIENCE: Duration = Duration::from_millis(400);
/// Least time between two packets to a watcher.
const WATCH_PERIOD: Duration = Duration::from_micros(16_666);
/// The mode of a runtime directory whose group may use the socket.
const SHARED_FOLDER: u32 = 0o710;
/// The size of a picture for which memory is taken at first.
const USUAL_SIZE: [usize; 2] = [640, 480];
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
        // Whoever made the folder says by its mode whether the group may use the socket.
        let folder = path.parent().and_then(|folder| metadata(folder).ok());
        let is_shared = folder.is_some_and(|folder| folder.permissions().mode() & 0o777 == SHARED_FOLDER);
        let listener = Listener::bind(&self.listen)?;
        set_permissions(path, Permissions::from_mode(if is_shared { 0o660 } else { 0o600 }))?;
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

/// What leads to and from the other threads.
pub(super) struct Peers {
    pub(super) changes: mpsc::Receiver<Settings>,
    pub(super) observed: Observed<Observation>,
    pub(super) recorded: Observed<Recorded>,
    pub(super) watched: Observed<Packet>,
    pub(super) hot: Arc<Mailbox<HotChange>>,
    /// Wakes the sender, which obeys the [`Operator`](facewire_servo::Operator) and shows the puppet.
    pub(super) sender: Thread,
    pub(super) puppet: Input<Option<Pose>>,
    pub(super) pictures: picture::Asker,
    /// Takes those who ask for a reload.
    pub(super) reload: mpsc::Sender<mpsc::Sender<Reply>>,
    pub(super) counters: Arc<Counters>,
}

pub(super) struct Server {
    doors: [Door; 2],
    settings: Settings,
    config: Option<String>,
    peers: Peers,
    stop_signal: PipeReader,
    clients: Vec<Client>,
    calibrating: Option<Calibrating>,
    recording: Option<Recording>,
    /// When watchers were shown a packet last; `None` without watchers.
    watched_at: Option<Instant>,
    driver: Option<Client>,
    /// How many clients watch or wait.
    staying: usize,
}

impl Server {
    /// Without a path there is no control socket. Also returns the end of the pipe that is closed to stop the thread.
    pub(super) fn new(
        path: Option<PathBuf>,
        settings: Settings,
        config: Option<String>,
        peers: Peers,
    ) -> io::Result<(Self, PipeWriter)> {
        if path.is_none() {
            tracing::debug!("no control socket: neither RUNTIME_DIRECTORY nor XDG_RUNTIME_DIR is set");
        }
        tell_console(&settings.console);
        let (stop_signal, stop) = pipe()?;
        let control = Door::new(path.map_or(Listen::Off, Listen::Unix), Speaks::Requests);
        let doors = [control, Door::new(settings.metrics.listen.clone(), Speaks::Http)];
        let (clients, calibrating, recording, watched_at, driver) = (Vec::new(), None, None, None, None);
        let server = Self {
            doors,
            settings,
            config,
            peers,
            stop_signal,
            clients,
            calibrating,
            recording,
            watched_at,
            driver,
            staying: 0,
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
            self.drive();
        }
        self.peers.observed.ask(false);
        self.peers.recorded.ask(false);
        self.peers.watched.ask(false);
    }

    fn wait(&mut self) -> bool {
        self.doors.iter_mut().for_each(Door::open);
        let inside = |speaks| self.clients.iter().filter(|client| client.speaks == speaks).count();
        let admits = |door: &&mut Door| inside(door.speaks) < MAX_CLIENTS && !door.rests();
        let doors: Vec<_> = self.doors.iter_mut().filter(admits).collect();
        let mut polled = vec![PollFd::new(&self.stop_signal, PollFlags::IN)];
        polled.extend(doors.iter().filter_map(|door| Some(PollFd::new(door.listener.as_ref()?, PollFlags::IN))));
        let is_idle =
            self.clients.is_empty() && self.calibrating.is_none() && self.recording.is_none() && self.driver.is_none();
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
        while let Ok(settings) = self.peers.changes.try_recv() {
            if !is_same_profile(&settings.wearer, &self.settings.wearer) {
                self.peers.counters.set_wearer(WearerName::new(&settings.wearer.name));
            }
            let [_, door] = &mut self.doors;
            if door.listen != settings.metrics.listen {
                *door = Door::new(settings.metrics.listen.clone(), Speaks::Http);
            }
            if settings.console != self.settings.console {
                tell_console(&settings.console);
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
        let packet = self.watched_packet();
        for mut client in std::mem::take(&mut self.clients) {
            if matches!(client.role, Role::Asks) {
                self.hear(client);
                continue;
            }
            if client.has_gone(STREAM_PATIENCE) || client.flush().is_err() {
                continue;
            }
            if let Role::Awaits(answer) = &mut client.role {
                match answer() {
                    Some((reply, bytes)) => {
                        self.send(client, |client| client.send(&reply).and_then(|()| client.send_bytes(&bytes)));
                    }
                    None => self.clients.push(client),
                }
                continue;
            }
            let packet = packet.as_ref().filter(|_| !client.is_behind());
            if packet.is_none_or(|packet| client.send(packet).is_ok()) {
                self.clients.push(client);
            }
        }
        self.staying = self.clients.iter().filter(|client| !matches!(client.role, Role::Asks)).count();
        if self.watched_at.is_some() && !self.clients.iter().any(|client| matches!(client.role, Role::Watches)) {
            self.peers.watched.ask(false);
            self.watched_at = None;
        }
    }

    /// Returns what watchers are to be shown now, if it is time for a packet and there is a new one.
    fn watched_packet(&mut self) -> Option<Reply> {
        let watched_at = self.watched_at.as_mut().filter(|at| at.elapsed() >= WATCH_PERIOD)?;
        let packet = self.peers.watched.newest()?;
        *watched_at = Instant::now();
        Some(Reply::Packet(BASE64_STANDARD.encode(packet.encode())))
    }

    fn hear(&mut self, mut client: Client) {
        let patience = if client.speaks == Speaks::Http { HTTP_PATIENCE } else { ASK_PATIENCE };
        if client.has_waited(patience) {
            return;
        }
        if client.is_behind() {
            return self.send(client, Client::flush);
        }
        let Ok(has_ended) = client.receive() else { return };
        match client.speaks {
            Speaks::Http => match metrics::answer(&client.input, has_ended, &self.peers.counters) {
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

    /// Sends the answer, after which the connection is closed.
    fn send(&mut self, mut client: Client, send: impl FnOnce(&mut Client) -> io::Result<()>) {
        client.role = Role::Asks;
        if send(&mut client).is_ok() && client.is_behind() {
            self.clients.push(client);
        }
    }

    fn answer(&mut self, mut client: Client, request: Request) {
        let outcome = match request {
            Request::Calibrate { wearer } => match self.prepare(wearer.as_deref()) {
                Ok((name, guide)) => {
                    tracing::info!("calibration of wearer {name} begins");
                    self.peers.observed.ask(true);
                    self.calibrating = Some(Calibrating::new(client, name, guide, monotonic_us()));
                    return;
                }
                Err(refusal) => Err(refusal),
            },
            Request::Record {} if self.recording.is_none() => {
                tracing::info!("recording begins");
                self.peers.recorded.ask(true);
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
            Request::Watch {} | Request::Picture {} | Request::Reload {} if self.staying >= MAX_STAYING => {
                Err("too many clients watch or wait: close one, or try again later".into())
            }
            Request::Watch {} => {
                if self.watched_at.is_none() {
                    self.peers.watched.ask(true);
                    self.watched_at = Some(Instant::now());
                }
                return self.stay(client, Role::Watches);
            }
            Request::Status {} => Ok(Reply::Status(Box::new(self.status()))),
            Request::Release { on } => {
                let role = self.release(on);
                return self.stay(client, role);
            }
            Request::Drive {} if self.driver.is_some() => {
                Err("somebody else drives: try again when they have ended".into())
            }
            Request::Drive {} => {
                tracing::info!("driving begins");
                // Nobody is moved by what was wanted last time.
                self.set_driven(None, None);
                client.role = Role::Drives;
                if client.send(&Reply::Driving(true)).is_ok() {
                    self.driver = Some(client);
                }
                return;
            }
            Request::Picture {} if !self.settings.console.picture => {
                Err("the camera's picture stays in the service unless the settings have picture = true in [console]"
                    .into())
            }
            Request::Picture {} => match picture_of(self.peers.pictures.clone(), USUAL_SIZE) {
                Some(role) => return self.stay(client, role),
                None => Err("too many pictures are asked for: try again when the camera shows some".into()),
            },
            Request::Reload {} => {
                let (asker, answer) = mpsc::channel();
                // If the supervisor has ended, the service stops and closes the connection.
                let _ = self.peers.reload.send(asker);
                let answer = move || Some((answer.try_recv().ok()?, Vec::new()));
                return self.stay(client, Role::Awaits(Box::new(answer)));
            }
        };
        let reply = outcome.unwrap_or_else(|refusal| Reply::Refused(refusal.to_string()));
        self.send(client, |client| client.send(&reply));
    }

    fn stay(&mut self, mut client: Client, role: Role) {
        client.role = role;
        self.staying += 1;
        self.clients.push(client);
    }

    fn store(&self) -> Store {
        Store::new(&self.settings.wearer.folder)
    }

    fn release(&self, on: bool) -> Role {
        let operator = Arc::clone(&self.peers.counters.traffic.operator);
        operator.is_released.store(on, Relaxed);
        self.peers.sender.unpark();
        let done = if on { "servos get no pulses" } else { "servos follow the face again" };
        tracing::info!("{done}, as an operator wants it");
        Role::Awaits(Box::new(move || {
            let is_told = operator.told_released.load(Relaxed) == operator.is_released.load(Relaxed);
            is_told.then(|| (Reply::Done(done.to_owned()), Vec::new()))
        }))
    }

    /// Does what the driver's lines say, until one is bad or none comes any more.
    fn drive(&mut self) {
        let Some(mut driver) = self.driver.take() else { return };
        let (has_ended, mut obeyed) = (driver.receive(), Ok(()));
        while let (Ok(()), Some(line)) = (&obeyed, driver.request()) {
            obeyed = line.and_then(|drive| self.turn(drive));
        }
        let why = match (obeyed, has_ended) {
            (Err(why), _) => Some(why),
            (Ok(()), Ok(false)) if driver.has_waited(DRIVE_PATIENCE) => Some("no line has come for 400 ms".to_owned()),
            (Ok(()), Ok(false)) if driver.flush().is_ok() => {
                self.driver = Some(driver);
                return;
            }
            _ => None,
        };
        self.drive_until(0);
        tracing::info!("driving has ended{}", why.as_ref().map_or_else(String::new, |why| format!(": {why}")));
        if let Some(why) = why {
            self.send(driver, |driver| driver.send(&Reply::Refused(why)));
        }
    }

    /// Gives the links what one who drives wants, for as long as one who drives may be silent.
    fn turn(&mut self, drive: Drive) -> Result<(), String> {
        match drive {
            Drive::Alive {} => {}
            Drive::Jog { link, channel, position } => {
                if !self.peers.counters.panels().get(link).is_some_and(|panel| panel.dials.has(channel)) {
                    return Err(format!("link {link} has no servo at channel {channel}"));
                }
                self.set_driven(Some((link, channel, position)), None);
            }
            Drive::Puppet { coefficients, head_deg } => {
                let pose = puppet_pose(&coefficients, head_deg)?;
                self.set_driven(None, Some(pose));
            }
        }
        self.drive_until(monotonic_us() + DRIVE_PATIENCE.as_micros() as u64);
        Ok(())
    }

    fn set_driven(&mut self, jog: Option<(usize, u8, f32)>, pose: Option<Pose>) {
        self.peers.puppet.write(pose);
        for (index, panel) in self.peers.counters.panels().iter().enumerate() {
            let of_panel = jog.filter(|(link, ..)| *link == index);
            panel.dials.turn(of_panel.map(|(_, channel, position)| (channel, position)));
        }
    }

    fn drive_until(&self, time_us: u64) {
        self.peers.counters.traffic.operator.driven_until_us.store(time_us, Relaxed);
        self.peers.sender.unpark();
    }

    fn status(&self) -> Status {
        let counters = &self.peers.counters;
        let operator = &counters.traffic.operator;
        Status {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            metrics: metrics::page(counters),
            wearer: counters.wearer().map(|name| name.to_string()),
            config: self.config.clone(),
            released: operator.is_released.load(Relaxed),
            driven: operator.is_driven.load(Relaxed),
            picture: self.settings.console.picture,
            links: counters.panels().iter().map(|panel| LinkStatus::of(panel)).collect(),
        }
    }

    fn delete(&mut self, name: &str) -> Outcome<Reply> {
        let name = named(name)?;
        self.store().delete(&name)?;
        if self.peers.counters.wearer().as_ref() == Some(&name) {
            self.hand_over(Profile::default(), None);
        }
        Ok(Reply::Done(format!("the profile of {name} is deleted")))
    }

    fn list(&self) -> Outcome<Reply> {
        let (store, in_use) = (self.store(), self.peers.counters.wearer().map(|name| name.to_string()));
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
        self.peers.hot.send(HotChange { profile: Some(profile), ..HotChange::default() });
        self.peers.counters.set_wearer(name);
    }

    /// Loads what a calibration of this wearer, or else of the one in use, needs.
    fn prepare(&self, wearer: Option<&str>) -> Outcome<(WearerName, Guide)> {
        let in_use = self.peers.counters.wearer();
        let name = named(wearer.unwrap_or_else(|| in_use.as_ref().map_or(DEFAULT_WEARER, WearerName::as_str)))?;
        if self.calibrating.is_some() {
            return Err("another calibration is in progress: try again when it has ended".into());
        }
        Ok((name, Guide::new(load_model(&self.settings.solver)?)))
    }

    fn calibrate(&mut self) {
        let Some(calibrating) = &mut self.calibrating else { return };
        let silent_us = SILENT_US.max(SILENT_FRAMES * self.peers.counters.frame_period_us.load(Relaxed));
        let told = loop {
            let next = self.peers.observed.take();
            let told = calibrating.step(next.as_ref(), silent_us, monotonic_us());
            if next.is_none() || told.is_err() || calibrating.guide.outcome().is_some() {
                break told;
            }
        };
        let Some(outcome) = calibrating.guide.outcome() else {
            if told.is_err() || calibrating.client.has_gone(STREAM_PATIENCE) {
                tracing::info!("calibration of wearer {} cancelled", calibrating.name);
                self.peers.observed.ask(false);
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
        self.peers.observed.ask(false);
        let Some(Calibrating { client, name, .. }) = self.calibrating.take() else { return };
        if let Reply::Refused(reason) = &reply {
            tracing::warn!("calibration of wearer {name}: {reason}");
        }
        self.send(client, |client| client.send(&reply));
    }

    fn record(&mut self) {
        let Some(recording) = &mut self.recording else { return };
        let is_camera_open = self.peers.counters.camera_open.load(Relaxed);
        let sent = recording.step(&mut self.peers.recorded, is_camera_open, monotonic_us());
        if sent.is_err() || recording.client.has_gone(STREAM_PATIENCE) {
            tracing::info!("recording ended, {} frames lost", recording.lost);
            self.peers.recorded.ask(false);
            self.recording = None;
        }
    }
}

/// Waits for a picture, first of at most this size, and then of the size that it has.
fn picture_of(pictures: Asker, size: [usize; 2]) -> Option<Role> {
    let mut copied = pictures.ask(size)?;
    Some(Role::Awaits(Box::new(move || {
        let copy = copied.try_recv().ok()?;
        if copy.bytes.is_empty() {
            copied = pictures.ask(copy.size)?;
            return None;
        }
        let points = |landmarks: Landmarks| landmarks.0.iter().map(|[x, y, _]| [*x, *y]).collect();
        let ([width, height], landmarks) = (copy.size, copy.landmarks.map(points));
        let (format, bytes) = (copy.format.to_owned(), copy.bytes.len());
        let Snapshot { full_range, time_us, .. } = copy;
        let head = PictureHead { format, width, height, full_range, bytes, time_us, landmarks };
        Some((Reply::Picture(head), copy.bytes))
    })))
}

/// Tells whether programs at the control socket may see what the camera sees.
fn tell_console(settings: &ConsoleSettings) {
    if settings.picture {
        tracing::warn!("programs at the control socket may ask for the camera's picture: console.picture is true");
    }
}

/// A face that looks at the camera but for these angles, which are bounded as the coefficients are.
fn puppet_pose(coefficients: &BTreeMap<String, f32>, head_deg: [f32; 3]) -> Result<Pose, String> {
    let mut pose = Pose::NEUTRAL;
    for (name, value) in coefficients {
        let place = BLENDSHAPES.iter().zip(&mut pose.coefficients).find(|(known, _)| *known == name);
        let (_, coefficient) = place.ok_or_else(|| format!("{name:?} is no coefficient"))?;
        *coefficient = value.clamp(0.0, 1.0);
    }
    let [yaw, pitch, roll] = head_deg.map(|angle_deg| angle_deg.clamp(-90.0, 90.0).to_radians());
    let [x, y, z] = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
    let turned = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    pose.rotation = (turned(z, roll) * turned(x, -pitch) * turned(y, yaw)).coords.into();
    Ok(pose)
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
