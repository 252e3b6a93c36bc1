//! The service: from the camera to the links, unattended, until it is told to stop.
//!
//! The [`hot`] loop runs frames, and hands its newest result to the sender in a triple buffer. The [`sender`] owns the
//! failsafe and the links, so that a stuck inference cannot freeze a face. The [`supervisor`], on the thread that calls
//! [`run`], handles signals, reloads, the watchdog and the log. The [`control`] thread serves other programs.

mod adaptation;
mod camera;
mod control;
mod counters;
pub mod failsafe;
mod hot;
mod kept;
mod metrics;
mod observer;
mod picture;
mod realtime;
mod reload;
mod sender;
mod supervisor;
mod timing;

use std::io::{self, PipeWriter};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, mpsc};
use std::thread::{Builder, JoinHandle, sleep};
use std::time::{Duration, Instant};

use facewire_packet::{Reason, control::socket};
use tracing::level_filters::LevelFilter;
use triple_buffer::triple_buffer;

pub use adaptation::Step;
pub use camera::OpenCamera;
pub use control::DEFAULT_WEARER;
pub use kept::Kept;
pub use realtime::bind_to_hot_cpu;
pub use sender::replay;
pub use timing::Histogram;

use self::adaptation::Adaptation;
use self::control::release::RELEASE_PATIENCE;
use self::control::{Peers, Server};
use self::counters::{Counters, OPEN_PATIENCE_US};
use self::hot::{Event, HotLoop, Outlets};
use self::realtime::Scheduling;
use self::reload::{LoadSettings, Mailbox, Reloader};
use self::sender::{Links, Sender};
use self::supervisor::{Log, Supervisor};
use crate::calibration::WearerName;
use crate::capture::CaptureError;
use crate::clock::{monotonic_us, seconds_since_1970};
use crate::config::Settings;
use crate::link::LinkError;
use crate::pipeline::{Pipeline, SetupError, load_profile};
use facewire_face::Profile;

/// How long a stopping service waits for the hot loop, which may be opening a camera in the kernel.
const HOT_PATIENCE: Duration = Duration::from_secs(2);
/// How long a stopping service waits for a profile that is being written.
const DISK_PATIENCE: Duration = Duration::from_secs(1);
/// Time between two looks at a thread that is to end.
const LOOK_PERIOD: Duration = Duration::from_millis(5);

#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The hot loop tries again after most of these. [`run`] returns those from which only a new process recovers.
    #[error(transparent)]
    Camera(#[from] CaptureError),
    #[error(
        "the system refused a thread or a signal handler: {0}; raise the limit of threads (systemd: TasksMax), or free some memory"
    )]
    System(#[from] io::Error),
    /// A thread panicked. Unless it was the sender, the receivers got the neutral face.
    #[error("the {0} ended by a panic, which is a fault of facewire: please report it; start the service again")]
    Panicked(&'static str),
}

/// Runs until SIGTERM or SIGINT. A second of these signals ends the process at once. SIGHUP reads the settings again, and
/// SIGUSR1 writes the status line. `config` is the file of the settings. Returns the last status line.
pub fn run(
    settings: Settings,
    config: Option<String>,
    load_settings: LoadSettings,
    set_level: Box<dyn Fn(LevelFilter)>,
) -> Result<String, ServiceError> {
    let counters = Arc::new(Counters::default());
    counters.catch_signals()?;
    let kept = Kept::new(config.as_deref());
    stay_released(&settings, &kept, &counters);
    let links = Links::change(&settings, Vec::new(), &counters.traffic)?;
    counters.set_panels(links.panels());
    let [loader, keeper] = [Loader::start("fw-load")?, Loader::start("fw-keep")?];
    let wanted = settings.clone();
    let pipeline = match loader.load(move || Pipeline::load(&wanted, true))? {
        Ok(pipeline) => Some(pipeline),
        // The hot loop tries again.
        Err(error) if error.is_temporary() => None,
        Err(error) => return Err(error.into()),
    };
    let (newest, news) = triple_buffer(&Err(Reason::NoCamera));
    let (loads, load) = triple_buffer(&None);
    let (puppet, played) = triple_buffer(&None);
    let (observer, observed) = observer::channel();
    let (recorder, recorded) = observer::channel();
    let (shown, watched) = observer::channel();
    let (pictures, copier) = picture::channel();
    let (events, heard) = mpsc::channel();
    let (reload, asked) = mpsc::channel();
    let (to_sender, new_links) = mpsc::channel();
    let (to_hot, hot_changes) = mpsc::channel();
    let (control, changes) = mpsc::channel();
    let shared = || Arc::clone(&counters);
    counters.heartbeats.beat_hot(monotonic_us(), OPEN_PATIENCE_US);
    counters.heartbeats.beat_sender(monotonic_us());

    let sender = Sender { links, changes: new_links, news, puppet: played, shown, counters: shared() };
    let sender_thread = spawn("fw-sender", Scheduling::sender(&settings.realtime), &events, || sender.run())?;
    let sender = Mailbox { changes: to_sender, thread: sender_thread.thread().clone() };

    let outlets =
        Outlets { newest, wake: sender.thread.clone(), loads, events: events.clone(), observer, recorder, copier };
    let profile = profile_of(&settings, &counters);
    let hot = HotLoop::new(settings.clone(), pipeline, profile, outlets, hot_changes, shared(), loader.clone());
    let hot_thread = spawn("fw-hot", Scheduling::hot(&settings.realtime), &events, || hot.run())?;
    let hot = Arc::new(Mailbox { changes: to_hot, thread: hot_thread.thread().clone() });

    let peers = Peers {
        changes,
        observed,
        recorded,
        watched,
        hot: Arc::clone(&hot),
        sender: sender.thread.clone(),
        puppet,
        reload,
        pictures,
        loader: loader.clone(),
        keeper: keeper.clone(),
        counters: shared(),
        release_patience: RELEASE_PATIENCE,
    };
    let server = Server::new(socket(), settings.clone(), config.clone(), kept.clone(), peers);
    let control_thread = server.and_then(|(server, stop)| Ok((stop, server.start()?)));
    // The face is sent without it, too.
    if let Err(error) = &control_thread {
        tracing::warn!("no control socket and no metrics: {error}; raise the limit of threads and files");
    }
    let reloader = Reloader {
        live: settings,
        config,
        load_settings,
        set_level,
        hot,
        sender,
        control,
        counters: shared(),
        loader,
        keeper,
        kept,
        change: None,
        asked,
        askers: Vec::new(),
    };
    reloader.keep_settings();
    let mut supervisor = Supervisor {
        counters: shared(),
        events: heard,
        load,
        reloader,
        adaptation: Adaptation::default(),
        log: Log::default(),
    };
    let has_control = || control_thread.as_ref().map_or(true, |(_, thread)| !thread.is_finished());
    supervisor.run(|| !sender_thread.is_finished() && !hot_thread.is_finished() && has_control());
    // The receivers get the last packets first: the control thread may be writing to a slow disk.
    let ended = stop(&counters, sender_thread, hot_thread);
    let control_ended = control_thread.map_or(Ok(()), |(stop, thread)| end_control(stop, thread));
    supervisor.events.try_iter().for_each(|event| supervisor.log.event(event, Instant::now()));
    control_ended.and(ended)
}

/// Ends the control thread, unless it has ended by itself.
fn end_control(stop: PipeWriter, thread: JoinHandle<()>) -> Result<(), ServiceError> {
    drop(stop);
    if ends_before(Instant::now() + DISK_PATIENCE, || thread.is_finished()) {
        return thread.join().map_err(|_| ServiceError::Panicked("control thread"));
    }
    Ok(())
}

/// Leaves the servos without pulses if an operator has released them since the machine was started.
fn stay_released(settings: &Settings, kept: &Kept, counters: &Counters) {
    if !settings.links.iter().any(|link| link.kind.moves_servos()) {
        return;
    }
    let Some(since) = kept.released_since() else { return };
    counters.traffic.operator.is_released.store(true, Relaxed);
    counters.released_unix_s.store(seconds_since_1970(since), Relaxed);
    let minutes = since.elapsed().unwrap_or_default().as_secs() / 60;
    tracing::warn!(
        "an operator released all servos {minutes} min ago: they get no pulses until an operator lets them move again, on the \
         page of the console or by {{\"do\":\"release\",\"on\":false}} at the control socket"
    );
}

/// The profile of the wearer that the settings name, who is then in use. The service runs without it if it does not load.
fn profile_of(settings: &Settings, counters: &Counters) -> Profile {
    let name = &settings.wearer.name;
    match load_profile(&settings.wearer, &settings.solver) {
        Ok((profile, warning)) => {
            warning.inspect(|warning| tracing::warn!("{warning}"));
            counters.set_wearer(WearerName::new(name));
            profile
        }
        Err(error) => {
            tracing::warn!(
                "wearer {name}: {error}; the service runs without a profile until `facewire calibrate --use {name}`"
            );
            Profile::default()
        }
    }
}

/// Stack of a thread. With locked memory the whole stack is in RAM, and the usual 2 MiB would be a tenth of all memory.
/// ONNX Runtime needs the most.
const STACK_BYTES: usize = 1 << 20;

/// Starts a thread, which first makes its real-time requests.
fn spawn<T: Send + 'static>(
    name: &str,
    scheduling: Scheduling,
    events: &mpsc::Sender<Event>,
    run: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    let events = events.clone();
    Builder::new().name(name.to_owned()).stack_size(STACK_BYTES).spawn(move || {
        // The supervisor does not end before this thread.
        let _ = events.send(Event::Started(scheduling.apply()));
        drop(events);
        run()
    })
}

/// The thread that loads networks, models and profiles, which may take seconds. It is one for all of them because the C
/// library gives each thread a heap of its own, and keeps what was once in use there. It has neither the priority nor the
/// CPU of the hot loop, which the helper threads of the networks would inherit.
#[derive(Debug, Clone)]
pub(super) struct Loader(mpsc::Sender<Box<dyn FnOnce() + Send>>);

impl Loader {
    pub(super) fn start(name: &str) -> io::Result<Self> {
        let (jobs, to_do) = mpsc::channel::<Box<dyn FnOnce() + Send>>();
        let run = || to_do.into_iter().for_each(|job| drop(catch_unwind(AssertUnwindSafe(job))));
        Builder::new().name(name.to_owned()).stack_size(STACK_BYTES).spawn(run)?;
        Ok(Self(jobs))
    }

    pub(super) fn load<T: Send + 'static>(&self, job: impl FnOnce() -> T + Send + 'static) -> Result<T, ServiceError> {
        self.begin(job).recv().map_err(|_| ServiceError::Panicked("loader"))
    }

    /// Begins a job. If it panics, the receiver is disconnected.
    pub(super) fn begin<T: Send + 'static>(&self, job: impl FnOnce() -> T + Send + 'static) -> mpsc::Receiver<T> {
        let (done, result) = mpsc::channel();
        // Nobody waits for the result any more if the service ends meanwhile.
        let _ = self.0.send(Box::new(move || drop(done.send(job()))));
        result
    }
}

/// Waits for the end of something, but no longer than until this time. Returns whether it has ended.
fn ends_before(time: Instant, mut has_ended: impl FnMut() -> bool) -> bool {
    while !has_ended() {
        if Instant::now() >= time {
            return false;
        }
        sleep(LOOK_PERIOD);
    }
    true
}

/// Ends the threads: the sender first, so that the receivers get the last packets whatever holds up the hot loop.
fn stop(
    counters: &Counters,
    sender: JoinHandle<()>,
    hot: JoinHandle<Result<(), ServiceError>>,
) -> Result<String, ServiceError> {
    let end = Instant::now() + HOT_PATIENCE;
    counters.stop();
    sender.thread().unpark();
    hot.thread().unpark();
    sender.join().map_err(|_| ServiceError::Panicked("sender"))?;
    if ends_before(end, || hot.is_finished()) {
        hot.join().map_err(|_| ServiceError::Panicked("hot loop"))??;
    } else {
        tracing::warn!("the camera's driver does not return and is left behind");
    }
    Ok(counters.status_line())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::testing::eventually;

    #[test]
    fn a_thread_that_panics_is_named_in_the_services_last_words() {
        let gone = || Err(ServiceError::Camera(CaptureError::Gone));
        let good: fn() = || {};
        let bad: fn() = || panic!("tried");
        for (sender, hot, want) in [
            (good, (|| panic!("tried")) as fn() -> Result<(), ServiceError>, "the hot loop ended by a panic"),
            (bad, || Ok(()), "the sender ended by a panic"),
            (good, gone, &CaptureError::Gone.to_string()),
        ] {
            let sender = std::thread::spawn(sender);
            let hot = std::thread::spawn(hot);
            eventually("the end of the hot loop", || hot.is_finished());
            let error = stop(&Counters::default(), sender, hot).unwrap_err().to_string();
            assert!(error.starts_with(want), "{error}");
        }
    }
}
