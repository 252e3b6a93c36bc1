//! The control thread: programs on this machine calibrate wearers, choose the one in use, record, watch, reload the settings,
//! and read the state and the metrics while the service runs.
//!
//! It has two sockets: a Unix socket in the runtime directory, for the service's user and root alone or for a group as well,
//! and the address of the metrics. Each client has a [`Task`], which has a file of its own. One calibration and one recording
//! run at a time, one client drives, and a client that closes its connection ends its own. Nothing can hold up the thread:
//! connections do not block, their number, the length of a request and the time until it has come are limited, and the
//! loader's thread waits for disks.

mod calibrate;
mod client;
mod drive;
mod endpoint;
mod picture;
mod record;
pub(super) mod release;
mod status;
mod wait;
mod watch;
mod wearers;

use std::collections::VecDeque;
use std::io::{self, ErrorKind, PipeReader, PipeWriter, pipe};
use std::path::PathBuf;
use std::sync::atomic::Ordering::Relaxed;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, mpsc};
use std::thread::{self, Builder, JoinHandle, Thread};
use std::time::Duration;

use facewire_packet::control::{Reply, Request};
use facewire_packet::{Packet, Pose};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use triple_buffer::Input;

use self::calibrate::Calibrating;
use self::client::{Client, MAX_LINE, Speaks};
use self::endpoint::Endpoint;
use self::picture::{NO_PICTURES, USUAL_SIZE, picture_of, warn_of_picture};
use self::record::Recording;
use self::wait::{Answer, Outcome, wait_for};
use self::watch::Shown;
use self::wearers::named;
use super::Loader;
use super::counters::Counters;
use super::hot::HotChange;
use super::kept::Kept;
use super::metrics::{self, MAX_REQUEST_BYTES};
use super::observer::Observed;
use super::picture::Asker;
use super::reload::Mailbox;
use crate::calibration::{Observation, WearerName};
use crate::clock::monotonic_us;
use crate::config::{Listen, Settings};
use crate::pipeline::is_same_profile;
use crate::recording::Recorded;

/// Number of clients at a time at each socket. If there are more, the one that has longest asked nothing makes room. If each of
/// them waits for an answer, the others wait in the queue of the socket.
const MAX_CLIENTS: usize = 64;
/// How many of them may watch or wait, so that one who releases servos finds a free place.
const MAX_WAITING: usize = 8;
/// Time between two looks at what clients ask and the hot loop shows, and without clients at new settings.
const LOOK_BUSY: Timespec = Timespec { tv_sec: 0, tv_nsec: 10_000_000 };
const LOOK_IDLE: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };
/// Time in which a client that calibrates, records or watches must take what it was sent.
const STREAM_PATIENCE: Duration = Duration::from_secs(10);
const FAILURE_PAUSE: Duration = Duration::from_millis(50);
const STACK_BYTES: usize = 512 << 10;
/// The wearer who is calibrated if the client names none and none is in use.
pub const DEFAULT_WEARER: &str = "default";

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
    /// Keeps what an operator orders, whatever holds up the loader.
    pub(super) keeper: Loader,
    pub(super) counters: Arc<Counters>,
    /// How long a client waits for the outcome of a release.
    pub(super) release_patience: Duration,
}

/// What a client is there for.
enum Task {
    /// To ask: its request is heard.
    Ask,
    /// To take the answer, after which the connection is closed.
    Leave,
    Watch,
    /// To send one line after another. The servo boards that it does not move follow the face, or stay still.
    Drive {
        others_follow: bool,
    },
    Record(Recording),
    Calibrate(Calibrating),
    /// To wait for an answer.
    Wait(Box<dyn FnMut() -> Option<Answer> + Send>),
}

pub(super) struct Server {
    endpoints: [Endpoint; 2],
    settings: Settings,
    config: Option<String>,
    kept: Kept,
    peers: Peers,
    stop_signal: PipeReader,
    clients: VecDeque<(Client, Task)>,
    shown: Shown,
    /// Whether it was logged that the system refused to wait for clients.
    has_failed: bool,
}

impl Server {
    /// Without a path there is no control socket. Also returns the end of the pipe that is closed to stop the thread.
    pub(super) fn new(
        path: Option<PathBuf>,
        settings: Settings,
        config: Option<String>,
        kept: Kept,
        peers: Peers,
    ) -> io::Result<(Self, PipeWriter)> {
        if path.is_none() {
            tracing::warn!(
                "no control socket, so neither the console nor `facewire calibrate` can reach this service: set \
                 XDG_RUNTIME_DIR to a folder that only this user can enter, for both of them, and start it again"
            );
        }
        warn_of_picture(&settings.console);
        let (stop_signal, stop) = pipe()?;
        let control = Endpoint::new(path.map_or(Listen::Off, Listen::Unix), Speaks::Requests);
        let endpoints = [control, Endpoint::new(settings.metrics.listen.clone(), Speaks::Http)];
        let clients = VecDeque::new();
        let shown = Shown::default();
        Ok((Self { endpoints, settings, config, kept, peers, stop_signal, clients, shown, has_failed: false }, stop))
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
            if let Task::Calibrate(calibrating) = task
                && let Some(reply) = calibrating.finish()
            {
                let _ = client.send(&reply);
            }
        }
        self.ask_for_frames();
    }

    fn wait(&mut self) -> bool {
        self.endpoints.iter_mut().for_each(Endpoint::open);
        let of = |speaks| self.clients.iter().filter(move |(client, _)| client.speaks == speaks);
        let has_room =
            |speaks| of(speaks).count() < MAX_CLIENTS || of(speaks).any(|(_, task)| matches!(task, Task::Ask));
        let admits = |endpoint: &&mut Endpoint| has_room(endpoint.speaks) && !endpoint.rests();
        let endpoints: Vec<_> = self.endpoints.iter_mut().filter(admits).collect();
        let mut polled = vec![PollFd::new(&self.stop_signal, PollFlags::IN)];
        let listeners = endpoints.iter().filter_map(|endpoint| endpoint.listener.as_ref());
        polled.extend(listeners.map(|listener| PollFd::new(&listener.socket, PollFlags::IN)));
        let failure = poll(&mut polled, Some(if self.clients.is_empty() { &LOOK_IDLE } else { &LOOK_BUSY })).err();
        let goes_on = polled.first().is_some_and(|stop| stop.revents().is_empty());
        let arrived: Vec<_> = endpoints.into_iter().filter_map(Endpoint::accept).collect();
        for client in arrived {
            self.make_room(client.speaks);
            self.clients.push_back((client, Task::Ask));
        }
        if let Some(error) = failure.filter(|error| *error != Errno::INTR) {
            self.outlive(error);
        }
        goes_on
    }

    /// Closes the connection of whoever has longest asked nothing, if there is no place left.
    fn make_room(&mut self, speaks: Speaks) {
        let is_here = |client: &Client| client.speaks == speaks;
        if self.clients.iter().filter(|(client, _)| is_here(client)).count() >= MAX_CLIENTS {
            let idle = self.clients.iter().position(|(client, task)| is_here(client) && matches!(task, Task::Ask));
            idle.map(|idle| self.clients.remove(idle));
        }
    }

    /// Lets a moment pass in which the system may find the memory that it lacked. Clients are served all the same.
    fn outlive(&mut self, error: Errno) {
        if !std::mem::replace(&mut self.has_failed, true) {
            tracing::warn!("the control socket and the metrics answer late: {error}; free some memory");
        }
        thread::sleep(FAILURE_PAUSE);
    }

    fn adopt(&mut self) {
        while let Ok((settings, model)) = self.peers.changes.try_recv() {
            if !is_same_profile(&settings.wearer, &self.settings.wearer) {
                self.peers.counters.set_wearer(WearerName::new(&settings.wearer.name));
            }
            let [_, metrics] = &mut self.endpoints;
            if metrics.listen != settings.metrics.listen {
                *metrics = Endpoint::new(settings.metrics.listen.clone(), Speaks::Http);
            }
            if settings.console != self.settings.console {
                warn_of_picture(&settings.console);
            }
            self.settings = settings;
            for (_, task) in &mut self.clients {
                if let Task::Calibrate(calibrating) = task {
                    calibrating.adopt(model, &self.peers.loader, &self.settings);
                }
            }
        }
    }

    /// Does what is to be done for each client now.
    fn serve(&mut self) {
        let packet = self.shown.next(&mut self.peers.watched);
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

    /// Asks the hot loop and the sender for what present clients need.
    fn ask_for_frames(&mut self) {
        let is_guided = |task: &Task| matches!(task, Task::Calibrate(calibrating) if calibrating.is_guided());
        self.peers.observed.ask(self.is_any(is_guided));
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
            Task::Drive { others_follow } => drive::step(client, *others_follow, &mut self.peers)?.map(|why| {
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
            Task::Calibrate(calibrating) => {
                let reply = calibrating.step(client, &mut self.peers, &self.settings.wearer)?;
                reply.map(|reply| (reply, Vec::new()))
            }
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
            Task::Drive { .. } => drive::end(&self.peers),
            Task::Record(recording) => recording.end(),
            Task::Calibrate(calibrating) => calibrating.end(),
            _ => {}
        }
    }

    /// Ends the drive that there may be, because whoever releases servos has the last word.
    fn end_drive(&mut self) {
        for (client, task) in self.clients.iter_mut().filter(|(_, task)| matches!(task, Task::Drive { .. })) {
            *task = Task::Leave;
            drive::end(&self.peers);
            // One that has gone ends at its next step.
            let _ = client.send(&Reply::Refused("all servos are released: drive again to move one by hand".to_owned()));
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
            Request::Status {} => {
                let status = status::status(&self.peers.counters, &self.settings, self.config.as_deref());
                return Ok((Some(Reply::Status(Box::new(status))), Task::Leave));
            }
            Request::Release { on } => {
                if on {
                    self.end_drive();
                }
                release::release(on, &self.peers, self.kept.clone())
            }
            Request::Drive { .. } if self.is_any(|task| matches!(task, Task::Drive { .. })) => {
                return Err("somebody else drives: try again when they have ended".into());
            }
            Request::Drive { others_follow } => {
                drive::begin(others_follow, &mut self.peers);
                return Ok((Some(Reply::Driving(true)), Task::Drive { others_follow }));
            }
            Request::Record {} if self.is_any(|task| matches!(task, Task::Record(_))) => {
                return Err("another recording is in progress: try again when it has ended".into());
            }
            Request::Record {} => Task::Record(Recording::begin()),
            Request::Calibrate { .. } if self.is_any(|task| matches!(task, Task::Calibrate(..))) => {
                return Err("another calibration is in progress: try again when it has ended".into());
            }
            Request::Calibrate { wearer } => {
                Task::Calibrate(Calibrating::begin(wearer.as_deref(), &self.peers, &self.settings)?)
            }
            _ if is_full => return Err("too many clients watch or wait: close one, or try again later".into()),
            Request::Use { wearer: Some(name) } => wearers::use_wearer(named(&name)?, &self.peers, &self.settings),
            Request::Use { wearer: None } => wearers::use_nobody(&self.peers),
            Request::Delete { wearer } => wearers::delete(named(&wearer)?, &self.peers, &self.settings.wearer),
            Request::List {} => wearers::list(&self.peers, &self.settings.wearer),
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
}

#[cfg(test)]
mod tests;
