//! `facewire record`: keeps the landmarks and the outputs of every frame in a file.
//!
//! The service holds the camera while it runs. The command then records the frames of the service, which goes on
//! sending. Without a service the command opens the camera itself, and sends nothing.

use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use clap::Args;
use signal_hook::consts::{SIGINT, SIGTERM};

use facewire::cli::Connection;
use facewire::cli::SettingsArgs;
use facewire::cli::{Failure, say};
use facewire::pipeline::Pipeline;
use facewire::preflight::{load_profile, model_warning};
use facewire::recording::{Recorded, Writer};
use facewire::service::{OpenCamera, Reply, Request};

const EXAMPLES: &str = "\
Examples:
  facewire record talk.fwrec                until Ctrl-C
  sudo facewire record talk.fwrec           while the service runs as another user
  facewire record talk.fwrec --seconds 60
  facewire record day.fwrec --max-mb 4000
  facewire replay talk.fwrec                send it again, as if the face were in front of the camera
  facewire track talk.fwrec --out talk.csv  solve its landmarks again, with one CSV row per frame

A recording has the landmarks and the outputs of each frame, and no picture: about 1.8 kB a frame, or 190 MB an hour. What \
was recorded up to a crash or a power failure can be read, except for the last second. While the \
service runs, it holds the camera: the command then records the frames of the service, with the settings of the \
service, and the service goes on sending.";

/// Time after which the progress is reported again.
const PROGRESS: Duration = Duration::from_secs(10);
/// Time between two checks whether the recording is over.
const LOOK: Duration = Duration::from_millis(100);
/// Frames that wait for the disk at most. Each takes some 6 kB.
const WAITING_FRAMES: usize = 1000;
const BYTES_PER_MB: u64 = 1_000_000;

/// Arguments of `facewire record`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct RecordArgs {
    /// The file, which must not exist.
    file: PathBuf,
    /// Stop after this many seconds.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    seconds: Option<u64>,
    /// Stop before the file becomes larger than this many megabytes.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    max_mb: u64,
    #[command(flatten)]
    settings: SettingsArgs,
}

pub fn run(args: &RecordArgs) -> Result<(), Failure> {
    let stop = Arc::<AtomicBool>::default();
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop))
            .and_then(|_| signal_hook::flag::register(signal, Arc::clone(&stop)))
            .map_err(|error| Failure::failed(format!("the system refused a signal handler: {error}")))?;
    }
    // Checked first, so that no camera is opened in vain.
    if args.file.exists() {
        return Err(Failure::unwritable(&args.file, &ErrorKind::AlreadyExists.into()));
    }
    match Connection::open()? {
        Some(connection) => by_service(connection, args, stop),
        None => without_service(args, stop),
    }
}

/// Frames that were lost: in the service, and here because the disk took too long.
#[derive(Debug, Default)]
struct Lost {
    service: AtomicU64,
    disk: AtomicU64,
}

/// Writes the frames that a running service sends.
fn by_service(mut connection: Connection, args: &RecordArgs, stop: Arc<AtomicBool>) -> Result<(), Failure> {
    connection.ask(&Request::Record {})?;
    let mut recorder = Recorder::begin(args, stop)?;
    say("the service records; Ctrl-C ends it");
    let ((told, heard), lost) = (mpsc::sync_channel(WAITING_FRAMES), Arc::<Lost>::default());
    let counted = Arc::clone(&lost);
    thread::spawn(move || listen(|| connection.reply(), &told, &counted));
    let outcome = keep_all(&heard, &mut recorder);
    // The frames that came before an error are kept.
    recorder.finish()?;
    let [service, disk] = [&lost.service, &lost.disk].map(|lost| lost.load(Relaxed));
    if service + disk > 0 {
        let remedy = "end other programs, or record to a faster disk";
        say(format_args!("{service} frames were lost in the service and {disk} before the disk: {remedy}"));
    }
    outcome
}

/// Takes what the service sends: a disk may take seconds for a write, and the service does not wait. Frames for which there
/// is no more room are counted.
fn listen(mut reply: impl FnMut() -> Result<Reply, Failure>, told: &SyncSender<Result<Reply, Failure>>, lost: &Lost) {
    loop {
        match reply() {
            Ok(Reply::Lost(count)) => lost.service.store(count, Relaxed),
            frame @ Ok(Reply::Frame(_)) => match told.try_send(frame) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) => drop(lost.disk.fetch_add(1, Relaxed)),
                Err(TrySendError::Disconnected(_)) => return,
            },
            last => return drop(told.send(last)),
        }
    }
}

fn keep_all(heard: &mpsc::Receiver<Result<Reply, Failure>>, recorder: &mut Recorder) -> Result<(), Failure> {
    let other = || Failure::failed("the service is of another version: restart it".to_owned());
    while !recorder.is_over() {
        let text = match heard.recv_timeout(LOOK) {
            Ok(Ok(Reply::Frame(text))) => text,
            Ok(Ok(Reply::Refused(sentence))) => return Err(Failure::failed(sentence)),
            Ok(Err(error)) => return Err(error),
            Err(mpsc::RecvTimeoutError::Timeout) => continue,
            Ok(Ok(_)) | Err(mpsc::RecvTimeoutError::Disconnected) => return Err(other()),
        };
        let bytes = BASE64_STANDARD.decode(text).map_err(|_| other())?;
        if !recorder.keep(&Recorded::from_bytes(&bytes).ok_or_else(other)?)? {
            break;
        }
    }
    Ok(())
}

fn without_service(args: &RecordArgs, stop: Arc<AtomicBool>) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    let mut pipeline = Pipeline::load(&settings)?;
    pipeline.solver.profile = load_profile(&settings.wearer)?;
    model_warning(&settings).iter().for_each(say);
    say("no service answers: opening the camera");
    let mut camera = OpenCamera::open(&settings.camera)?;
    let mut recorder = Recorder::begin(args, stop)?;
    say(format_args!("recording from {}; Ctrl-C ends it", camera.source.describe()));
    let outcome = record(&mut camera, &mut pipeline, &mut recorder);
    recorder.finish()?;
    if let Err(error) = camera.close() {
        say(error);
    }
    outcome
}

fn record(camera: &mut OpenCamera, pipeline: &mut Pipeline, recorder: &mut Recorder) -> Result<(), Failure> {
    while !recorder.is_over() {
        let Some(frame) = camera.next()? else { continue };
        if !recorder.keep(&pipeline.process(&frame).record())? {
            break;
        }
    }
    Ok(())
}

/// The file, and the progress of the recording.
struct Recorder {
    writer: Writer,
    path: PathBuf,
    stop: Arc<AtomicBool>,
    /// When the first frame came.
    begun: Option<Instant>,
    told: Instant,
    longest: Option<Duration>,
    max_mb: u64,
    faces: u64,
}

impl Recorder {
    fn begin(args: &RecordArgs, stop: Arc<AtomicBool>) -> Result<Self, Failure> {
        let path = args.file.clone();
        let writer = Writer::create(&path, args.max_mb * BYTES_PER_MB);
        let writer = writer.map_err(|error| Failure::unwritable(&path, &error))?;
        let (told, longest) = (Instant::now(), args.seconds.map(Duration::from_secs));
        Ok(Self { writer, path, stop, begun: None, told, longest, max_mb: args.max_mb, faces: 0 })
    }

    fn is_over(&self) -> bool {
        let lasted = self.begun.map(|begun| begun.elapsed());
        self.stop.load(Relaxed) || self.longest.zip(lasted).is_some_and(|(longest, lasted)| lasted >= longest)
    }

    /// Keeps a frame. Returns `false` if the file is as large as it may become.
    fn keep(&mut self, frame: &Recorded) -> Result<bool, Failure> {
        self.begun.get_or_insert_with(Instant::now);
        if !self.writer.push(frame).map_err(|error| Failure::unwritable(&self.path, &error))? {
            say(format_args!("the file is full: --max-mb allows {} MB", self.max_mb));
            return Ok(false);
        }
        self.faces += u64::from(frame.landmarks.is_some());
        if self.told.elapsed() >= PROGRESS {
            self.told = Instant::now();
            say(format_args!("{} frames, {} with a face", self.writer.frames(), self.faces));
        }
        Ok(true)
    }

    /// Writes what is left. An empty file is removed, because it would be in the way of the next attempt.
    fn finish(mut self) -> Result<(), Failure> {
        let bytes = self.writer.finish().map_err(|error| Failure::unwritable(&self.path, &error))?;
        let (frames, path) = (self.writer.frames(), self.path.display());
        if frames == 0 {
            let _ = fs::remove_file(&self.path);
        }
        let seconds = self.begun.map_or(0.0, |begun| begun.elapsed().as_secs_f64());
        say(format_args!("{frames} frames in {seconds:.1} s: {path}, {} kB", bytes / 1000));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_a_stalled_disk_has_no_room_for_are_dropped_and_counted() {
        let (told, heard) = mpsc::sync_channel(3);
        let (lost, mut replies) = (Lost::default(), (0..10).map(|number| Reply::Frame(number.to_string())));
        thread::scope(|scope| {
            let listener = scope.spawn(|| {
                let last = || Reply::Refused("the service stops".to_owned());
                listen(|| Ok(replies.next().unwrap_or_else(last)), &told, &lost);
            });
            while lost.disk.load(Relaxed) < 7 {
                thread::yield_now();
            }
            let kept: Vec<_> = (0..3).map(|_| heard.recv().unwrap().unwrap()).collect();
            assert_eq!(kept, [0, 1, 2].map(|number| Reply::Frame(number.to_string())));
            assert!(matches!(heard.recv(), Ok(Ok(Reply::Refused(_)))));
            listener.join().unwrap();
        });
        listen(
            {
                let mut replies = [Reply::Lost(5), Reply::Done(String::new())].into_iter();
                move || Ok(replies.next().unwrap())
            },
            &mpsc::sync_channel(1).0,
            &lost,
        );
        assert_eq!((lost.service.load(Relaxed), lost.disk.load(Relaxed)), (5, 7));
    }
}
