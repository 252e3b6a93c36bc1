//! The control thread: programs on this machine calibrate wearers, choose the one in use, record, watch, reload the settings,
//! and read the state and the metrics while the service runs.
//!
//! It has two doors: a Unix socket in the runtime directory, for the service's user and root alone or for a group as well,
//! and the address of the metrics. Each client has a [`Task`]. One calibration and one recording run at a time, one client
//! drives, and a client that closes its connection ends its own. Nothing can hold up the thread: connections do not block,
//! their number, the length of a request and the time until it has come are limited, and the loader's thread waits for
//! disks.

mod client;

use std::collections::{BTreeMap, VecDeque};
use std::error::Error;
use std::fs::{self, DirBuilder, Permissions, metadata, set_permissions};
use std::io::{self, ErrorKind, PipeReader, PipeWriter, pipe};
use std::os::unix::fs::{DirBuilderExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, PoisonError, mpsc};
use std::thread::{Builder, JoinHandle, Thread};
use std::time::{Duration, Instant};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use facewire_packet::control::{Drive, PictureHead, Progress, Refusal, Reply, Request, Status};
use facewire_packet::{BLENDSHAPES, Packet, Pose, Reason};
use nalgebra::{UnitQuaternion, Vector3};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use triple_buffer::Input;

use self::client::{Client, MAX_DRIVE_LINE, MAX_LINE, Speaks};
use super::counters::Counters;
use super::hot::HotChange;
use super::metrics::{self, MAX_REQUEST_BYTES};
use super::observer::Observed;
use super::picture::{Asker, Snapshot};
use super::reload::Mailbox;
use super::{DISK_PATIENCE, Loader};
use crate::calibration::{Calibration, Guide, Observation, Store, WearerName};
use crate::capture::monotonic_us;
use crate::config::{ConsoleSettings, Listen, Settings, SolverSettings, WearerSettings};
use crate::listener::Listener;
use crate::pipeline::{is_same_profile, load_model, load_profile};
use crate::recording::Recorded;
use facewire_face::{Landmarks, Profile};

/// Number of clients at a time at each door. The others wait in the queue of the socket.
const MAX_CLIENTS: usize = 16;
/// How many of them may watch or wait, so that one who releases servos finds a free place.
const MAX_WAITING: usize = 8;
/// Time between two looks at what clients ask and the hot loop shows, and without clients at new settings.
const LOOK_BUSY: Timespec = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };
const LOOK_IDLE: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };
/// Time in which a client that calibrates, records or watches must take what it was sent.
const STREAM_PATIENCE: Duration = Duration::from_secs(10);
/// Delay before the next attempt after listening or accepting a client has failed.
const RETRY_DELAY: Duration = Duration::from_secs(1);
/// Time without a frame after which a client that records is told of lost frames or a missing camera, microseconds.
const QUIET_US: u64 = 1_000_000;
/// Least time between two messages of progress that differ only in the bars, microseconds.
const PROGRESS_US: u64 = 60_000;
/// Longest silence of a client that drives.
const DRIVE_PATIENCE: Duration = Duration::from_millis(400);
/// Least time between two packets to a watcher.
const WATCH_PERIOD: Duration = Duration::from_micros(16_666);
/// The mode of a runtime directory whose group may use the socket.
const SHARED_FOLDER: u32 = 0o710;
/// The size of a picture for which memory is taken at first.
const USUAL_SIZE: [usize; 2] = [640, 480];
const STACK_BYTES: usize = 512 << 10;
const MODEL_CHANGED: &str =
    "no profile was made, and the former one stays. The blendshape model has changed: try again";
const NO_PICTURES: &str =
    "the camera's picture stays in the service unless the settings have picture = true in [console]";
const TOO_MANY_PICTURES: &str = "too many requests for pictures are waiting: try again once the camera delivers frames";
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
    /// New settings, and the hash of the model if it was read again.
    pub(super) changes: Receiver<(Settings, Option<u32>)>,
    pub(super) observed: Observed<Observation>,
    pub(super) recorded: Observed<Recorded>,
    pub(super) watched: Observed<Packet>,
    pub(super) hot: Arc<Mailbox<HotChange>>,
    /// Wakes the sender, which obeys the [`Operator`](facewire_servo::Operator) and shows the puppet.
    pub(super) sender: Thread,
    pub(super) puppet: Input<Option<Pose>>,
    pub(super) pictures: Asker,
    /// Takes those who ask for a reload.
    pub(super) reload: mpsc::Sender<mpsc::Sender<Reply>>,
    pub(super) loader: Loader,
    pub(super) counters: Arc<Counters>,
}

/// A reply, and bytes that follow it.
type Answer = (Reply, Vec<u8>);

/// What a client is there for.
enum Task {
    /// To ask: its request is heard.
    Ask,
    /// To take the answer, after which the connection is closed.
    Leave,
    Watch,
    /// To send one line after another.
    Drive,
    Record(Recording),
    Calibrate(WearerName, Stage),
    /// To wait for an answer.
    Wait(Box<dyn FnMut() -> Option<Answer> + Send>),
}

/// This file beside the profiles holds the boot identifier if an operator has released all servos since that boot.
const RELEASED: &str = "released";
const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";

/// Whether an operator has released all servos since the machine was started.
pub(super) fn was_released(wearer: &WearerSettings) -> bool {
    let released_in = fs::read(Store::new(&wearer.folder).folder().join(RELEASED));
    released_in.is_ok_and(|boot| fs::read(BOOT_ID).is_ok_and(|now| now == boot))
}

fn note_released(folder: &Path, on: bool) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    fs::write(folder.join(RELEASED), if on { fs::read(BOOT_ID)? } else { Vec::new() })
}

pub(super) struct Server {
    doors: [Door; 2],
    settings: Settings,
    config: Option<String>,
    peers: Peers,
    stop_signal: PipeReader,
    clients: VecDeque<(Client, Task)>,
    /// When watchers were shown a packet last.
    shown_at: Option<Instant>,
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
        warn_of_picture(&settings.console);
        let (stop_signal, stop) = pipe()?;
        let control = Door::new(path.map_or(Listen::Off, Listen::Unix), Speaks::Requests);
        let doors = [control, Door::new(settings.metrics.listen.clone(), Speaks::Http)];
        Ok((Self { doors, settings, config, peers, stop_signal, clients: VecDeque::new(), shown_at: None }, stop))
    }

    pub(super) fn start(self) -> io::Result<JoinHandle<()>> {
        Builder::new().name("fw-control".to_owned()).stack_size(STACK_BYTES).spawn(|| self.run())
    }

    /// Serves clients until the pipe is closed.
    fn run(mut self) {
        while self.wait() {
            self.adopt();
            self.serve();
        }
        for (mut client, task) in self.clients.drain(..) {
            if let Task::Calibrate(_, Stage::Keep(kept)) = task
                && let Ok(Ok(reply)) = kept.recv_timeout(DISK_PATIENCE)
            {
                let _ = client.send(&reply);
            }
        }
        self.ask_for_frames();
    }

    fn wait(&mut self) -> bool {
        self.doors.iter_mut().for_each(Door::open);
        let inside = |speaks| self.clients.iter().filter(|(client, _)| client.speaks == speaks).count();
        let admits = |door: &&mut Door| inside(door.speaks) < MAX_CLIENTS && !door.rests();
        let doors: Vec<_> = self.doors.iter_mut().filter(admits).collect();
        let mut polled = vec![PollFd::new(&self.stop_signal, PollFlags::IN)];
        let listeners = doors.iter().filter_map(|door| door.listener.as_ref());
        polled.extend(listeners.map(|listener| PollFd::new(&listener.socket, PollFlags::IN)));
        if let Err(error) = poll(&mut polled, Some(if self.clients.is_empty() { &LOOK_IDLE } else { &LOOK_BUSY })) {
            return error == Errno::INTR;
        }
        let goes_on = polled.first().is_some_and(|stop| stop.revents().is_empty());
        for door in doors {
            match door.listener.as_ref().map(Listener::accept) {
                Some(Ok(stream)) => self.clients.push_back((Client::new(stream.into(), door.speaks), Task::Ask)),
                Some(Err(error)) if error.kind() != ErrorKind::WouldBlock => {
                    // Without memory or file descriptors the client stays in the queue, and the loop would spin.
                    door.rests_until = Some(Instant::now() + RETRY_DELAY);
                }
                Some(Err(_)) | None => {}
            }
        }
        goes_on
    }

    fn adopt(&mut self) {
        while let Ok((settings, model)) = self.peers.changes.try_recv() {
            if !is_same_profile(&settings.wearer, &self.settings.wearer) {
                self.peers.counters.set_wearer(WearerName::new(&settings.wearer.name));
            }
            let [_, door] = &mut self.doors;
            if door.listen != settings.metrics.listen {
                *door = Door::new(settings.metrics.listen.clone(), Speaks::Http);
            }
            if settings.console != self.settings.console {
                warn_of_picture(&settings.console);
            }
            self.settings = settings;
            for (_, task) in &mut self.clients {
                let Task::Calibrate(_, stage) = task else { continue };
                match stage {
                    Stage::Load(_) => *stage = Stage::load(&self.peers.loader, &self.settings.solver),
                    // A profile of takes that two models have read would fit neither.
                    Stage::Guide(guiding) if model.is_some_and(|model| model != guiding.guide.calibration.model) => {
                        *stage = Stage::End(Reply::Refused(MODEL_CHANGED.to_owned()));
                    }
                    _ => {}
                }
            }
        }
    }

    /// Does what is to be done for each client now.
    fn serve(&mut self) {
        let packet = self.packet_to_show();
        for _ in 0..self.clients.len() {
            // Out of the queue while it is served, so that it does not count as another client that does the same.
            let Some((mut client, mut task)) = self.clients.pop_front() else { break };
            let stepped = self.step(&mut client, &mut task, packet.as_ref());
            if stepped.is_err() || (matches!(task, Task::Leave) && !client.is_behind()) {
                self.end(&task);
            } else {
                self.clients.push_back((client, task));
            }
        }
        self.ask_for_frames();
    }

    /// Returns what watchers are to be shown now, if it is time for a packet and there is a new one.
    fn packet_to_show(&mut self) -> Option<Reply> {
        if self.shown_at.is_some_and(|at| at.elapsed() < WATCH_PERIOD) {
            return None;
        }
        let packet = self.peers.watched.newest()?;
        self.shown_at = Some(Instant::now());
        Some(Reply::Packet(BASE64_STANDARD.encode(packet.encode())))
    }

    /// Asks the hot loop and the sender for what present clients need.
    fn ask_for_frames(&mut self) {
        self.peers.observed.ask(self.is_any(|task| matches!(task, Task::Calibrate(_, Stage::Guide(_)))));
        self.peers.recorded.ask(self.is_any(|task| matches!(task, Task::Record(_))));
        self.peers.watched.ask(self.is_any(|task| matches!(task, Task::Watch)));
    }

    fn is_any(&self, does: fn(&Task) -> bool) -> bool {
        self.clients.iter().any(|(_, task)| does(task))
    }

    /// Fails if the connection is to be closed.
    fn step(&mut self, client: &mut Client, task: &mut Task, packet: Option<&Reply>) -> io::Result<()> {
        client.flush()?;
        let answer = match task {
            Task::Ask | Task::Leave if client.has_waited(client.patience()) => return Err(ErrorKind::TimedOut.into()),
            Task::Ask => return self.hear(client).map(|heard| *task = heard),
            Task::Leave => return Ok(()),
            Task::Drive => self.drive(client)?.map(|why| {
                tracing::info!("the driver is refused: {why}");
                (Reply::Refused(why), Vec::new())
            }),
            _ if client.has_gone(STREAM_PATIENCE) => return Err(ErrorKind::ConnectionReset.into()),
            Task::Watch if client.is_behind() => return Ok(()),
            Task::Watch => return packet.map_or(Ok(()), |packet| client.send(packet)),
            Task::Record(recording) => {
                let is_camera_open = self.peers.counters.camera_open.load(Relaxed);
                return recording.step(client, &mut self.peers.recorded, is_camera_open, monotonic_us());
            }
            Task::Calibrate(name, stage) => self.calibrate(client, name, stage)?.map(|reply| (reply, Vec::new())),
            Task::Wait(answer) => answer(),
        };
        if let Some((reply, bytes)) = answer {
            self.end(&std::mem::replace(task, Task::Leave));
            client.send(&reply)?;
            client.send_bytes(&bytes)?;
        }
        Ok(())
    }

    fn end(&self, task: &Task) {
        match task {
            Task::Drive => {
                self.drive_until(0);
                tracing::info!("driving has ended");
            }
            Task::Record(recording) => tracing::info!("recording ended, {} frames lost", recording.lost),
            Task::Calibrate(name, Stage::Load(_) | Stage::Guide(_)) => {
                tracing::info!("calibration of wearer {name} cancelled");
            }
            _ => {}
        }
    }

    fn hear(&mut self, client: &mut Client) -> io::Result<Task> {
        match client.speaks {
            Speaks::Http => {
                let has_ended = client.receive(MAX_REQUEST_BYTES)?;
                match metrics::answer(&client.input, has_ended, &self.peers.counters) {
                    Some(page) => client.send_bytes(page.as_bytes()).map(|()| Task::Leave),
                    None => Ok(Task::Ask),
                }
            }
            Speaks::Requests => {
                let has_ended = client.receive(MAX_LINE)?;
                let answered = match client.request(MAX_LINE) {
                    Some(request) => request.and_then(|request| self.answer(request).map_err(|why| why.to_string())),
                    None if has_ended => return Err(ErrorKind::UnexpectedEof.into()),
                    None => return Ok(Task::Ask),
                };
                let (reply, task) = answered.unwrap_or_else(|refusal| (Some(Reply::Refused(refusal)), Task::Leave));
                reply.map_or(Ok(()), |reply| client.send(&reply))?;
                Ok(task)
            }
        }
    }

    /// Returns what the client is told at once, and what it is there for from now on.
    fn answer(&mut self, request: Request) -> Outcome<(Option<Reply>, Task)> {
        let is_waiting = |(_, task): &&(Client, Task)| matches!(task, Task::Watch | Task::Wait(_));
        let is_full = self.clients.iter().filter(is_waiting).count() >= MAX_WAITING;
        let task = match request {
            Request::Status {} => return Ok((Some(Reply::Status(Box::new(self.status()))), Task::Leave)),
            Request::Release { on } => self.release(on),
            Request::Drive {} if self.is_any(|task| matches!(task, Task::Drive)) => {
                return Err("somebody else drives: try again when they have ended".into());
            }
            Request::Drive {} => {
                tracing::info!("driving begins");
                // The last driver's jog or puppet must not move anything.
                self.set_driven(None, None);
                return Ok((Some(Reply::Driving(true)), Task::Drive));
            }
            Request::Record {} if self.is_any(|task| matches!(task, Task::Record(_))) => {
                return Err("another recording is in progress: try again when it has ended".into());
            }
            Request::Record {} => {
                tracing::info!("recording begins");
                Task::Record(Recording { sent_us: monotonic_us(), ..Recording::default() })
            }
            Request::Calibrate { .. } if self.is_any(|task| matches!(task, Task::Calibrate(..))) => {
                return Err("another calibration is in progress: try again when it has ended".into());
            }
            Request::Calibrate { wearer } => self.begin_calibration(wearer.as_deref())?,
            _ if is_full => return Err("too many clients watch or wait: close one, or try again later".into()),
            Request::Use { wearer: Some(name) } => self.set_wearer(named(&name)?),
            Request::Use { wearer: None } => {
                let in_use = self.in_use();
                self.begin(move || {
                    in_use.set(Profile::default(), None);
                    Ok(Reply::Done("nobody's profile is in use, until the next start of the service".to_owned()))
                })
            }
            Request::Delete { wearer } => self.delete(named(&wearer)?),
            Request::List {} => self.list(),
            Request::Watch {} => Task::Watch,
            Request::Picture {} if !self.settings.console.picture => return Err(NO_PICTURES.into()),
            Request::Picture {} => picture_of(self.peers.pictures.clone(), Some(USUAL_SIZE))?,
            Request::Landmarks {} => picture_of(self.peers.pictures.clone(), None)?,
            Request::Reload {} => {
                let (asker, answer) = mpsc::channel();
                let _ = self.peers.reload.send(asker);
                wait_for(answer)
            }
        };
        Ok((None, task))
    }

    /// Begins work that needs the disk, on the loader's thread. The client waits for its outcome.
    fn begin(&self, work: impl FnOnce() -> Outcome<Reply> + Send + 'static) -> Task {
        wait_for(self.peers.loader.begin(|| work().unwrap_or_else(|refusal| Reply::Refused(refusal.to_string()))))
    }

    fn store(&self) -> Store {
        Store::new(&self.settings.wearer.folder)
    }

    fn in_use(&self) -> InUse {
        InUse { hot: Arc::clone(&self.peers.hot), counters: Arc::clone(&self.peers.counters) }
    }

    fn release(&self, on: bool) -> Task {
        let operator = Arc::clone(&self.peers.counters.traffic.operator);
        operator.is_released.store(on, Relaxed);
        self.peers.sender.unpark();
        let store = self.store();
        self.peers.loader.begin(move || {
            if let Err(error) = note_released(store.folder(), on) {
                tracing::warn!("a restarted service will not know whether servos are released: {error}");
            }
        });
        let done = if on { "servos get no pulses" } else { "servos follow the face again" };
        tracing::info!("{done}, as an operator wants it");
        Task::Wait(Box::new(move || {
            let is_told = operator.told_released.load(Relaxed) == operator.is_released.load(Relaxed);
            is_told.then(|| (Reply::Done(done.to_owned()), Vec::new()))
        }))
    }

    /// Does what the driver's lines say. Returns why it may not drive any more if one is bad or none comes.
    fn drive(&mut self, driver: &mut Client) -> io::Result<Option<String>> {
        let has_ended = driver.receive(MAX_DRIVE_LINE)?;
        while let Some(line) = driver.request(MAX_DRIVE_LINE) {
            if let Err(why) = line.and_then(|drive| self.obey(drive)) {
                return Ok(Some(why));
            }
        }
        if has_ended {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        Ok(driver.has_waited(DRIVE_PATIENCE).then(|| "no line has come for 400 ms".to_owned()))
    }

    /// Gives the links what the driver wants, until [`DRIVE_PATIENCE`] has passed without another line.
    fn obey(&mut self, drive: Drive) -> Result<(), String> {
        match drive {
            Drive::Alive {} => {}
            Drive::Jog { link, channel, position } => {
                if !self.peers.counters.panels().get(link).is_some_and(|panel| panel.dials.has(channel)) {
                    return Err(format!("link {link} has no servo at channel {channel}"));
                }
                self.set_driven(Some((link, channel, position)), None);
            }
            Drive::Puppet { coefficients, head_deg } => {
                self.set_driven(None, Some(puppet_pose(&coefficients, head_deg)?));
            }
        }
        self.drive_until(monotonic_us() + DRIVE_PATIENCE.as_micros() as u64);
        Ok(())
    }

    fn set_driven(&mut self, jog: Option<(usize, u16, f32)>, pose: Option<Pose>) {
        self.peers.puppet.write(pose);
        for (index, panel) in self.peers.counters.panels().iter().enumerate() {
            let of_panel = jog.filter(|(link, ..)| *link == index);
            panel.dials.jog(of_panel.map(|(_, channel, position)| (channel, position)));
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
            settings_refused: counters.settings_refused.lock().unwrap_or_else(PoisonError::into_inner).clone(),
            released: operator.is_released.load(Relaxed),
            driven: operator.is_driven.load(Relaxed),
            picture: self.settings.console.picture,
            links: counters.panels().iter().map(|panel| panel.status()).collect(),
        }
    }

    fn delete(&self, name: WearerName) -> Task {
        let (in_use, store) = (self.in_use(), self.store());
        self.begin(move || {
            store.delete(&name)?;
            if in_use.counters.wearer().as_ref() == Some(&name) {
                in_use.set(Profile::default(), None);
            }
            Ok(Reply::Done(format!("the profile of {name} is deleted")))
        })
    }

    fn list(&self) -> Task {
        let (in_use, store) = (self.peers.counters.wearer().map(|name| name.to_string()), self.store());
        self.begin(move || {
            Ok(Reply::Wearers { wearers: store.list()?, in_use, folder: store.folder().display().to_string() })
        })
    }

    fn set_wearer(&self, name: WearerName) -> Task {
        let (in_use, solver) = (self.in_use(), self.settings.solver.clone());
        let wearer = WearerSettings { name: name.to_string(), ..self.settings.wearer.clone() };
        self.begin(move || {
            let (profile, warning) = load_profile(&wearer, &solver)?;
            let warning = warning.map_or_else(String::new, |warning| format!(". {warning}"));
            in_use.set(profile, Some(name.clone()));
            Ok(Reply::Done(format!(
                "the profile of {name} is in use; to use it after every start, set wearer.name = \"{name}\" in the settings{warning}"
            )))
        })
    }

    /// Begins a calibration of this wearer, or else of the one in use.
    fn begin_calibration(&self, wearer: Option<&str>) -> Outcome<Task> {
        let in_use = self.peers.counters.wearer();
        let name = named(wearer.unwrap_or_else(|| in_use.as_ref().map_or(DEFAULT_WEARER, WearerName::as_str)))?;
        tracing::info!("calibration of wearer {name} begins");
        Ok(Task::Calibrate(name, Stage::load(&self.peers.loader, &self.settings.solver)))
    }

    /// Goes on with a calibration. Returns what the client is told at its end.
    fn calibrate(&mut self, client: &mut Client, name: &WearerName, stage: &mut Stage) -> io::Result<Option<Reply>> {
        let next = match stage {
            Stage::Load(guide) => poll_outcome(guide).map(|guide| {
                let guiding =
                    |guide| Stage::Guide(Box::new(Guiding { guide, observed_us: monotonic_us(), told: None }));
                guide.flatten().map(guiding)
            }),
            Stage::Guide(guiding) => self.guide(client, guiding)?.map(|outcome| {
                let keep = |calibration| Stage::Keep(self.keep(name.clone(), calibration));
                outcome.map(keep).map_err(Refusal::end)
            }),
            Stage::Keep(kept) => poll_outcome(kept).map(|kept| kept.flatten().map(Stage::End)),
            Stage::End(_) => None,
        };
        if let Some(next) = next {
            *stage = next.unwrap_or_else(|why| Stage::End(Reply::Refused(why)));
        }
        let Stage::End(reply) = stage else { return Ok(None) };
        if let Reply::Refused(why) = reply {
            tracing::warn!("calibration of wearer {name}: {why}");
        }
        Ok(Some(reply.clone()))
    }

    /// Shows the guide what the hot loop has seen. Returns the guide's outcome.
    fn guide(&mut self, client: &mut Client, guided: &mut Guiding) -> io::Result<Option<Result<Calibration, Refusal>>> {
        loop {
            let next = self.peers.observed.take();
            guided.step(client, next.as_ref(), monotonic_us())?;
            let outcome = guided.guide.outcome();
            if next.is_none() || outcome.is_some() {
                return Ok(outcome);
            }
        }
    }

    fn keep(&self, name: WearerName, calibration: Calibration) -> Receiver<Result<Reply, String>> {
        let (in_use, store) = (self.in_use(), self.store());
        self.peers.loader.begin(move || {
            let profile = calibration.profile.clone();
            let kept = store.keep(&name, calibration).map_err(|error| error.to_string())?;
            in_use.set(profile, Some(name));
            Ok(Reply::Calibrated(kept))
        })
    }
}

/// What it takes to put a profile in use, on any thread.
struct InUse {
    hot: Arc<Mailbox<HotChange>>,
    counters: Arc<Counters>,
}

impl InUse {
    fn set(&self, profile: Profile, name: Option<WearerName>) {
        tracing::info!("wearer {}", name.as_ref().map_or("nobody", WearerName::as_str));
        self.hot.send(HotChange { profile: Some(profile), ..HotChange::default() });
        self.counters.set_wearer(name);
    }
}

/// Returns the outcome of another thread's work, once there is one.
fn poll_outcome<T>(outcome: &Receiver<T>) -> Option<Result<T, String>> {
    match outcome.try_recv() {
        Err(TryRecvError::Empty) => None,
        outcome => Some(outcome.map_err(|_| "it came to no end: see the log of the service".to_owned())),
    }
}

fn wait_for(reply: Receiver<Reply>) -> Task {
    Task::Wait(Box::new(move || Some((poll_outcome(&reply)?.unwrap_or_else(Reply::Refused), Vec::new()))))
}

/// Waits for a picture, and asks again with its true size if it exceeds `size`. Without a size, waits for the landmarks
/// alone.
fn picture_of(pictures: Asker, size: Option<[usize; 2]>) -> Result<Task, &'static str> {
    let ask = move |size| pictures.ask(size).ok_or(TOO_MANY_PICTURES);
    let mut copied = ask(size.unwrap_or_default())?;
    Ok(Task::Wait(Box::new(move || {
        let copy = copied.try_recv().ok()?;
        if copy.bytes.is_empty() && size.is_some() {
            match ask(copy.size) {
                Ok(larger) => copied = larger,
                Err(why) => return Some((Reply::Refused(why.to_owned()), Vec::new())),
            }
            return None;
        }
        let points = |landmarks: Landmarks| landmarks.0.iter().map(|[x, y, _]| [*x, *y]).collect();
        let Snapshot { format, size: [width, height], full_range, time_us, landmarks, bytes, .. } = copy;
        let (landmarks, count) = (landmarks.map(points), bytes.len());
        let head = PictureHead { format, width, height, full_range, bytes: count, time_us, landmarks };
        Some((Reply::Picture(head), bytes))
    })))
}

/// Warns if programs at the control socket may see what the camera sees.
fn warn_of_picture(settings: &ConsoleSettings) {
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

/// How far a calibration is.
enum Stage {
    /// The loader reads the model.
    Load(Receiver<Result<Guide, String>>),
    Guide(Box<Guiding>),
    /// The loader writes the profile.
    Keep(Receiver<Result<Reply, String>>),
    /// The client is told this.
    End(Reply),
}

impl Stage {
    fn load(loader: &Loader, solver: &SolverSettings) -> Self {
        let solver = solver.clone();
        Self::Load(loader.begin(move || load_model(&solver).map(Guide::new).map_err(|error| error.to_string())))
    }
}

struct Guiding {
    guide: Guide,
    /// When the last observation came, or the guide was told that none comes.
    observed_us: u64,
    /// What the client was told last, and when.
    told: Option<(Progress, u64)>,
}

impl Guiding {
    /// Passes an observation on, or reports that none came for too long, and sends the progress to the client.
    fn step(&mut self, client: &mut Client, observation: Option<&Observation>, now_us: u64) -> io::Result<()> {
        let silent_s = now_us.saturating_sub(self.observed_us) as f32 / 1e6;
        match observation {
            Some(observation) => self.guide.update(observation),
            None if silent_s > self.guide.gap_s() => self.guide.update(&Observation::nothing(now_us)),
            None => return Ok(()),
        }
        self.observed_us = now_us;
        let progress = self.guide.progress();
        let is_known = self.told.as_ref().is_some_and(|(told, told_us)| {
            now_us.saturating_sub(*told_us) < PROGRESS_US && told.says_the_same(&progress)
        });
        if !is_known && !client.is_behind() {
            client.send(&Reply::Progress(progress.clone()))?;
            self.told = Some((progress, now_us));
        }
        Ok(())
    }
}

#[derive(Default)]
struct Recording {
    sent_us: u64,
    /// The last entry: its time on the clock of the frames, the time when it was made, and whether it was a frame.
    last: Option<(u64, u64, bool)>,
    /// Frames that the client did not take in time, and all that were lost, as the client was told.
    refused: u64,
    lost: u64,
}

impl Recording {
    /// Sends what the new frames show, how many were lost, and once a second that no camera is open.
    fn step(
        &mut self,
        client: &mut Client,
        frames: &mut Observed<Recorded>,
        is_camera_open: bool,
        now_us: u64,
    ) -> io::Result<()> {
        while let Some(mut frame) = frames.take() {
            // The entry for a missing camera may be later than the capture of the frame that follows.
            if let Some((last_us, _, false)) = self.last {
                frame.time_us = frame.time_us.max(last_us + 1);
            }
            self.last = Some((frame.time_us, now_us, true));
            self.entry(client, &frame, now_us)?;
        }
        let is_quiet = now_us.saturating_sub(self.sent_us) >= QUIET_US;
        if is_quiet && !is_camera_open {
            // In the clock of the frames, so that a replay shows it when it happened.
            let time_us = self.last.map_or(now_us, |(time_us, at_us, _)| time_us + now_us.saturating_sub(at_us));
            self.last = Some((time_us, now_us, false));
            self.entry(client, &Recorded::nothing(time_us, Reason::NoCamera), now_us)?;
        }
        let lost = frames.lost() + self.refused;
        if (lost != self.lost || (is_quiet && is_camera_open)) && !client.is_behind() {
            (self.lost, self.sent_us) = (lost, now_us);
            client.send(&Reply::Lost(lost))?;
        }
        Ok(())
    }

    fn entry(&mut self, client: &mut Client, frame: &Recorded, now_us: u64) -> io::Result<()> {
        if client.is_behind() {
            self.refused += 1;
            return Ok(());
        }
        self.sent_us = now_us;
        client.send(&Reply::Frame(BASE64_STANDARD.encode(frame.to_bytes())))
    }
}

#[cfg(test)]
mod tests;
