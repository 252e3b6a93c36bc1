//! `facewire record`: keeps the landmarks and the outputs of every frame in a file.
//!
//! The service holds the camera while it runs. The command then records the frames of the service, which goes on
//! sending. Without a service the command opens the camera itself, and sends nothing.

use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, TrySendError};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use clap::Args;
use signal_hook::consts::{SIGINT, SIGTERM};

use crate::progress::{ProgressLine, clock};
use facewire::cli::{Failure, SettingsArgs, say};
use facewire::pipeline::{Pipeline, load_profile};
use facewire::recording::{Recorded, Writer};
use facewire::service::OpenCamera;
use facewire_packet::control::{Connection, Reply, Request};

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

const PROGRESS_PERIOD: Duration = Duration::from_secs(10);
/// Time between two checks whether the recording is over.
const CHECK_PERIOD: Duration = Duration::from_millis(100);
/// Frames that wait for the disk at most. Each takes some 6 kB.
const WAITING_FRAMES: usize = 1000;
const BYTES_PER_MB: u64 = 1_000_000;

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
    match Connection::open().map_err(Failure::failed)? {
        Some(connection) => by_service(connection, args, &stop),
        None => without_service(args, &stop),
    }
}

/// Frames that were lost: in the service, and here because the disk took too long.
#[derive(Debug, Default)]
struct Lost {
    service: AtomicU64,
    disk: AtomicU64,
}

fn by_service(mut connection: Connection, args: &RecordArgs, stop: &AtomicBool) -> Result<(), Failure> {
    connection.ask(&Request::Record {}).map_err(Failure::failed)?;
    let (told, heard) = mpsc::sync_channel(WAITING_FRAMES);
    let lost = Arc::<Lost>::default();
    let counted = Arc::clone(&lost);
    thread::spawn(move || listen(|| connection.reply(), &told, &counted));
    let other = || Failure::failed("the service is of another version: restart it".to_owned());
    let outcome = record(args, stop, "the service records", || {
        let text = match heard.recv_timeout(CHECK_PERIOD) {
            Ok(Ok(Reply::Frame(text))) => text,
            Ok(Ok(Reply::Refused(sentence)) | Err(sentence)) => return Err(Failure::failed(sentence)),
            Err(RecvTimeoutError::Timeout) => return Ok(None),
            Ok(Ok(_)) | Err(RecvTimeoutError::Disconnected) => return Err(other()),
        };
        let frame = BASE64_STANDARD.decode(text).ok().and_then(|bytes| Recorded::from_bytes(&bytes));
        frame.map(Some).ok_or_else(other)
    });
    let [service, disk] = [&lost.service, &lost.disk].map(|lost| lost.load(Relaxed));
    if service + disk > 0 {
        let remedy = "end other programs, or record to a faster disk";
        say(format_args!(
            "{service} frames were lost in the service, and {disk} because the disk was too slow: {remedy}"
        ));
    }
    outcome
}

/// Takes what the service sends: a disk may take seconds for a write, and the service does not wait. Frames for which there
/// is no more room are counted.
fn listen(mut reply: impl FnMut() -> Result<Reply, String>, told: &SyncSender<Result<Reply, String>>, lost: &Lost) {
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

fn without_service(args: &RecordArgs, stop: &AtomicBool) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    let mut pipeline = Pipeline::load(&settings, true)?;
    let (profile, warning) = load_profile(&settings.wearer, &settings.solver)?;
    pipeline.solver.profile = profile;
    if let Some(warning) = warning {
        say(warning);
    }
    say("no service answers: opening the camera");
    let mut camera = OpenCamera::open(&settings.camera)?;
    let begin = format!("recording from {}", camera.source.describe());
    let outcome = record(args, stop, &begin, || Ok(camera.next()?.map(|frame| pipeline.process(&frame).record())));
    camera.source.close().unwrap_or_else(say);
    outcome
}

/// Creates the file, says that it begins, and keeps each frame that `next` gives until a signal or a limit ends the
/// recording. The frames that came before an error are kept.
fn record(
    args: &RecordArgs,
    stop: &AtomicBool,
    begin: &str,
    mut next: impl FnMut() -> Result<Option<Recorded>, Failure>,
) -> Result<(), Failure> {
    let unwritable = |error| Failure::unwritable(&args.file, &error);
    let mut writer = Writer::create(&args.file, args.max_mb * BYTES_PER_MB).map_err(unwritable)?;
    say(format_args!("{begin}; Ctrl-C ends it"));
    let mut first = None::<Instant>;
    let mut told = Instant::now();
    let mut faces = 0_u64;
    let mut progress = ProgressLine::new();
    let mut keep_all = || {
        let is_long = |first: Instant| args.seconds.is_some_and(|longest_s| first.elapsed().as_secs() >= longest_s);
        while !stop.load(Relaxed) && !first.is_some_and(is_long) {
            let Some(frame) = next()? else { continue };
            first.get_or_insert_with(Instant::now);
            if !writer.push(&frame).map_err(unwritable)? {
                say(format_args!("the file is full: --max-mb allows {} MB", args.max_mb));
                break;
            }
            let has_face = frame.landmarks.is_some();
            faces += u64::from(has_face);
            let face = if has_face { "a face is seen" } else { "no face is seen" };
            let time = clock(first.map_or(0, |first| first.elapsed().as_secs()));
            if progress.is_shown() {
                progress.draw(None, format_args!("{time}, {face}, {} frames, {faces} with a face", writer.frames()));
            } else if told.elapsed() >= PROGRESS_PERIOD {
                told = Instant::now();
                say(format_args!("{time}, {face}, {} frames, {faces} with a face", writer.frames()));
            }
        }
        Ok(())
    };
    let outcome = keep_all();
    drop(progress);
    let bytes = writer.finish().map_err(unwritable)?;
    let frames = writer.frames();
    let path = &args.file;
    if frames == 0 {
        // An empty file would be in the way of the next attempt.
        let _ = fs::remove_file(path);
    }
    let seconds = first.map_or(0.0, |first| first.elapsed().as_secs_f64());
    say(format_args!("{frames} frames in {seconds:.1} s: {}, {} kB", path.display(), bytes / 1000));
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_a_stalled_disk_has_no_room_for_are_dropped_and_counted() {
        let (told, heard) = mpsc::sync_channel(3);
        let lost = &Lost::default();
        let frame = |number: u32| Reply::Frame(number.to_string());
        let mut replies = [Reply::Lost(5)].into_iter().chain((0..10).map(frame));
        thread::scope(|scope| {
            let mut reply = || Ok(replies.next().unwrap_or(Reply::Refused("the service stops".to_owned())));
            scope.spawn(move || listen(&mut reply, &told, lost));
            while lost.disk.load(Relaxed) < 7 {
                thread::yield_now();
            }
            assert_eq!([0, 1, 2].map(|_| heard.recv().unwrap().unwrap()), [0, 1, 2].map(frame));
            assert!(matches!(heard.recv(), Ok(Ok(Reply::Refused(_)))));
        });
        assert_eq!((lost.service.load(Relaxed), lost.disk.load(Relaxed)), (5, 7));
    }
}
