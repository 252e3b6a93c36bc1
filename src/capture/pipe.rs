//! A camera that another program reads: JPEG images or raw pictures, one after the other, through a named pipe.
//!
//! Raspberry Pi's camera modules need libcamera, whose program `rpicam-vid` writes such a stream, and so do ffmpeg and GStreamer
//! for all that the kernel's interface does not give. JPEG images state where they begin and end, and how large they are, so
//! that a reader finds its place in a stream that is already running. Raw pictures need no encoding and decoding, which takes
//! more than half as long as finding the landmarks. Their size and format are in the pipe's name, and a writer that pauses has
//! finished one.
//!
//! Contract: as of a camera. Of the pictures that have come, the newest whole one is kept. A stream that ends or pauses is an
//! error, after which the pipe must be opened again. Nothing allocates once the pipe is open.
//!
//! Limits: a frame counts as captured when its last byte is here. Pictures that wait in the writer because the pipe is full would
//! look newer than they are, so that the pipe gets the greatest size that a user without privileges may give it. Raw pictures
//! soon fill it: a reader that was away passes over all that have waited.

use std::fs;
use std::fs::File;
use std::io::{ErrorKind, Read as _};
use std::mem::{replace, take};
use std::os::unix::fs::{FileTypeExt as _, OpenOptionsExt as _};
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use rustix::pipe::fcntl_setpipe_size;

use super::delivery::{Arrival, Delivery};
use super::jpeg::{END_OF_IMAGE, START_OF_IMAGE, image_length, image_size};
use super::live::Live;
use super::v4l2::{Layout, PixelFormat, Store, Wish};
use super::{CaptureError, Content, Description, Frame, FrameFault, Motion, Source, Tally};
use crate::clock::monotonic_us;

/// The folder of the pipe to which `facewire-camera.service` writes the pictures of a Raspberry Pi's camera module.
const MODULE_FOLDER: &str = "/run/facewire-camera";
/// Time limit for the first image: the program may still start.
const START_TIMEOUT: Duration = Duration::from_secs(5);
/// What comes within this time after the first image was captured before the pipe had a reader.
const STALE: Duration = Duration::from_millis(300);
/// Bytes that the pipe holds.
const PIPE_BYTES: usize = 1 << 20;
/// Room for the first JPEG image, whose size is not known.
const FIRST_BYTES: usize = 4 << 20;
/// A writer of raw pictures that writes nothing for this share of a frame period has finished one.
const PAUSE_SHARE: u32 = 4;
/// A writer that has written this often as much as before, which is no picture, writes pictures of another size.
const MAX_ALIKE: u32 = 5;
/// Largest number of raw pictures that are passed over at once because they have waited.
const MAX_WAITED: usize = 16;

/// The pipe of a Raspberry Pi's camera module, if its service has made one.
pub fn module_pipe() -> Option<String> {
    let entries = fs::read_dir(MODULE_FOLDER).ok()?;
    let paths = entries.filter_map(|entry| entry.ok()?.path().into_os_string().into_string().ok());
    paths.filter(|path| is_pipe(path)).min()
}

pub fn is_pipe(path: &str) -> bool {
    path.starts_with('/') && fs::metadata(path).is_ok_and(|file| file.file_type().is_fifo())
}

/// The layout of the raw pictures that come through a pipe whose name ends with it, such as `video-640x480.yu12`.
fn raw_layout(path: &str) -> Result<Option<Layout>, CaptureError> {
    let Some((rest, ending)) = path.rsplit_once('.') else { return Ok(None) };
    let is_named = |format: &PixelFormat| format.name.eq_ignore_ascii_case(ending);
    let Some(format) = PixelFormat::ALL.into_iter().find(is_named).filter(|format| !format.is_jpeg()) else {
        return Ok(None);
    };
    let layout = || {
        let (_, size) = rest.rsplit_once('-')?;
        let (width, height) = size.split_once('x')?;
        Layout::without_padding(format, [width.parse().ok()?, height.parse().ok()?])
    };
    layout().map(Some).ok_or_else(|| {
        let remedy = "such as video-640x480.yu12; a pipe for JPEG images has another ending";
        CaptureError::Unusable(format!("the name of {path} does not end with the pictures' size and format, {remedy}"))
    })
}

pub struct PipeSource {
    path: String,
    pipe: File,
    /// What has come and was not kept yet, up to `filled`.
    buffer: Box<[u8]>,
    filled: usize,
    /// Up to here, the buffer has no end of an image that was not taken.
    searched: usize,
    store: Store,
    /// Number of whole pictures that have come.
    taken: u64,
    timeout: Duration,
    /// A writer of raw pictures that writes nothing for this long has finished one.
    pause: Duration,
    live: Live,
}

impl PipeSource {
    /// Opens the pipe, and waits for the first picture. All JPEG images must have the size of the first one.
    pub fn open(path: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let raw = raw_layout(path)?;
        let open = File::options().read(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed()).open(path);
        let fail = |error| CaptureError::device(Path::new(path), "opening it", error);
        let pipe = open.map_err(fail)?;
        // Two readers would get a part of the bytes each.
        let lock = flock(&pipe, FlockOperation::NonBlockingLockExclusive);
        lock.map_err(|error| fail(if error == Errno::WOULDBLOCK { Errno::BUSY } else { error }.into()))?;
        // A pipe that cannot grow works, too.
        let _ = fcntl_setpipe_size(&pipe, PIPE_BYTES);
        let store = match raw {
            Some(layout) => Store::new(layout)?,
            None => jpeg_store([wish.width, wish.height].map(|side| side as usize))?,
        };
        let bytes = if raw.is_some() { 2 * store.max_frame_bytes() } else { FIRST_BYTES };
        let mut source = Self {
            path: path.to_owned(),
            pipe,
            buffer: vec![0; bytes].into(),
            filled: 0,
            searched: 0,
            store,
            taken: 0,
            timeout: START_TIMEOUT,
            pause: Duration::from_micros(wish.rate.period_us()) / PAUSE_SHARE,
            live: Live::new(Path::new(path), wish.rate.period_us()),
        };
        match raw {
            Some(layout) => source.find_beginning(&layout)?,
            None => source.take_size()?,
        }
        source.timeout = timeout;
        Ok(source)
    }

    /// Waits for the first JPEG image, and makes room for images of its size.
    fn take_size(&mut self) -> Result<(), CaptureError> {
        let [from, to] = self.await_image()?;
        let image = self.buffer.get(from..to).unwrap_or_default();
        let size = image_size(image).unwrap_or([self.store.layout.width, self.store.layout.height]);
        self.discard_stale(to)?;
        self.store = jpeg_store(size)?;
        // Room for the newest image, and for the one before, until it has come.
        let mut buffer = vec![0; 2 * self.store.max_frame_bytes()].into_boxed_slice();
        self.filled = self.filled.min(buffer.len());
        buffer.iter_mut().zip(&self.buffer).take(self.filled).for_each(|(to, from)| *to = *from);
        self.buffer = buffer;
        Ok(())
    }

    /// Waits until one raw picture has come between two pauses, so that the next byte begins a picture.
    fn find_beginning(&mut self, layout: &Layout) -> Result<(), CaptureError> {
        let deadline = Instant::now() + START_TIMEOUT;
        let picture_bytes = layout.frame_bytes();
        // What comes first may be the rest of a picture.
        let mut last_bytes = self.discard_until_pause(deadline)?;
        let mut alike = 0;
        loop {
            let bytes = self.discard_until_pause(deadline)?;
            if bytes == picture_bytes {
                return Ok(());
            }
            alike = if bytes == last_bytes { alike + 1 } else { 0 };
            last_bytes = bytes;
            if bytes > 0 && alike == MAX_ALIKE {
                return Err(self.of_another_size(bytes, layout));
            }
            if Instant::now() >= deadline {
                return Err(self.gave_nothing());
            }
        }
    }

    /// Discards what comes until the writer pauses. Returns how much it was.
    fn discard_until_pause(&mut self, deadline: Instant) -> Result<usize, CaptureError> {
        let mut discarded = 0;
        loop {
            let pause = Instant::now() + self.pause;
            self.wait(if discarded == 0 { deadline } else { deadline.min(pause) })?;
            self.read()?;
            match take(&mut self.filled) {
                0 => return Ok(discarded),
                bytes => discarded += bytes,
            }
        }
    }

    /// Discards what is before this place, and the images that come within [`STALE`].
    fn discard_stale(&mut self, before: usize) -> Result<(), CaptureError> {
        self.discard(before);
        let deadline = Instant::now() + STALE;
        while !self.wait(deadline)?.is_zero() {
            self.read()?;
            if let Some([_, to]) = self.newest() {
                self.discard(to);
            }
            if self.filled == self.buffer.len() {
                self.discard(self.filled);
            }
        }
        Ok(())
    }

    /// Waits until something comes, or until the deadline. Returns the time that is left then.
    fn wait(&self, deadline: Instant) -> Result<Duration, CaptureError> {
        let left = deadline.saturating_duration_since(Instant::now());
        let timeout = Timespec::try_from(left).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
        let mut pipe = [PollFd::new(&self.pipe, PollFlags::IN)];
        match poll(&mut pipe, Some(&timeout)) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => return Err(CaptureError::driver_failed("sending frames", &error.into())),
        }
        // A writer that came and went is reported at once, again and again.
        let [pipe] = pipe;
        if pipe.revents() == PollFlags::HUP {
            return Err(self.silent("has no writer any more"));
        }
        Ok(left)
    }

    /// Waits until a whole image is in the buffer, and reads what else has come. Returns where the newest whole image is.
    fn await_image(&mut self) -> Result<[usize; 2], CaptureError> {
        let deadline = Instant::now() + self.timeout;
        loop {
            self.read()?;
            if let Some(place) = self.newest() {
                return Ok(place);
            }
            if self.filled == self.buffer.len() {
                self.discard(self.filled);
                return Err(self.fault(FrameFault::TooLarge));
            }
            if self.wait(deadline)?.is_zero() {
                return Err(self.gave_nothing());
            }
        }
    }

    /// Reads what has come, as far as there is room.
    fn read(&mut self) -> Result<(), CaptureError> {
        while let Some(room) = self.buffer.get_mut(self.filled..).filter(|room| !room.is_empty()) {
            match self.pipe.read(room) {
                // There is no writer, or not yet.
                Ok(0) => return Ok(()),
                Ok(count) => self.filled += count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(CaptureError::driver_failed("sending frames", &error)),
            }
        }
        Ok(())
    }

    /// Finds the newest whole picture, and counts those before it as skipped.
    fn newest(&mut self) -> Option<[usize; 2]> {
        if self.store.layout.format.is_jpeg() { self.newest_jpeg() } else { self.newest_raw() }
    }

    fn newest_raw(&mut self) -> Option<[usize; 2]> {
        let bytes = self.store.layout.frame_bytes();
        let whole = self.filled / bytes;
        let now_us = monotonic_us();
        (0..whole).for_each(|_| self.count(now_us));
        self.live.tally.for_newer += whole.saturating_sub(1) as u32;
        (whole > 0).then(|| [(whole - 1) * bytes, whole * bytes])
    }

    /// Passes over the raw pictures that have waited while the reader was away, in the pipe and in the writer.
    fn pass_over_waiting(&mut self) -> Result<(), CaptureError> {
        if self.store.layout.format.is_jpeg() {
            return Ok(());
        }
        for _ in 0..MAX_WAITED {
            self.read()?;
            if self.filled < self.buffer.len() {
                break;
            }
            self.count(monotonic_us());
            self.live.tally.for_newer += 1;
            self.discard(self.store.layout.frame_bytes());
            self.wait(Instant::now() + self.pause)?;
        }
        Ok(())
    }

    /// Counts a picture that has come.
    fn count(&mut self, now_us: u64) {
        let sequence = self.taken as u32;
        self.live.delivery.arrived(Arrival { sequence, captured_us: now_us, taken_us: now_us });
        self.taken += 1;
    }

    fn newest_jpeg(&mut self) -> Option<[usize; 2]> {
        // An unfinished image is not looked through again each time that a part of it comes.
        let from = replace(&mut self.searched, self.filled).saturating_sub(1);
        self.buffer.get(from..self.filled)?.windows(2).find(|two| *two == END_OF_IMAGE)?;
        let mut newest = None;
        let now_us = monotonic_us();
        let mut from = 0;
        while let Some(bytes) = self.buffer.get(from..self.filled)
            && let Some(start) = bytes.windows(2).position(|two| two == START_OF_IMAGE)
            && let Some(length) = bytes.get(start..).and_then(image_length)
        {
            self.count(now_us);
            self.live.tally.for_newer += u32::from(newest.is_some());
            newest = Some([from + start, from + start + length]);
            from += start + length;
        }
        newest
    }

    /// Waits for a picture that is not to be left out, and keeps it. Returns the time at which it came.
    fn keep_newest(&mut self) -> Result<u64, CaptureError> {
        self.pass_over_waiting()?;
        let mut place = self.await_image()?;
        let mut captured_us = monotonic_us();
        while self.live.leaves_out(captured_us) {
            self.discard(place[1]);
            place = self.await_image()?;
            captured_us = monotonic_us();
        }
        let [from, to] = place;
        let image = self.buffer.get(from..to).unwrap_or_default();
        let is_frozen = self.live.repeats.is_frozen(image, captured_us);
        self.live.tally.motion = if is_frozen { Motion::Frozen } else { Motion::Moving };
        let begun = Instant::now();
        let kept = self.store.keep(image);
        self.live.tally.decoding += begun.elapsed();
        self.discard(to);
        kept.map(|()| captured_us).map_err(|fault| self.fault(fault))
    }

    /// Makes room by removing what is before this place.
    fn discard(&mut self, before: usize) {
        self.buffer.copy_within(before.min(self.filled)..self.filled, 0);
        self.filled = self.filled.saturating_sub(before);
        self.searched = 0;
    }

    fn fault(&mut self, fault: FrameFault) -> CaptureError {
        self.live.delivery.damaged += 1;
        CaptureError::Frame { number: self.taken, fault }
    }

    fn gave_nothing(&self) -> CaptureError {
        self.silent(&format!("gave no picture for {} ms", self.timeout.as_millis()))
    }

    fn silent(&self, what: &str) -> CaptureError {
        let path = &self.path;
        CaptureError::Unusable(format!("{path} {what}; start the program that writes pictures to it"))
    }

    fn of_another_size(&self, bytes: usize, layout: &Layout) -> CaptureError {
        let Layout { format, width, height, .. } = layout;
        CaptureError::Unusable(format!(
            "{} gets {bytes} bytes at a time, which are no pictures of {width}x{height} in {}, of {} bytes; name it after what \
             is written to it",
            self.path,
            format.name,
            layout.frame_bytes(),
        ))
    }
}

/// Keeps JPEG images of this size.
fn jpeg_store([width, height]: [usize; 2]) -> Result<Store, CaptureError> {
    let layout = Layout::without_padding(PixelFormat::JPEG, [width, height]);
    Store::new(layout.ok_or_else(|| CaptureError::picture_size(width, height))?)
}

impl Source for PipeSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let kept = self.keep_newest();
        let captured_us = self.live.answered(kept)?;
        let number = self.taken - 1;
        let missing = CaptureError::Frame { number, fault: FrameFault::Incomplete };
        let picture = self.store.picture().ok_or(missing)?;
        Ok(Some(Frame { content: Content::Picture(picture), captured_us, number }))
    }

    fn leave_out_until(&mut self, captured_us: u64) {
        self.live.wanted_us = captured_us;
    }

    fn take_tally(&mut self) -> Tally {
        self.live.take_tally()
    }

    fn take_delivery(&mut self) -> Option<Delivery> {
        self.live.delivery.take()
    }

    fn describe(&self) -> Description<'_> {
        let Layout { format, width, height, .. } = self.store.layout;
        Description { origin: &self.path, format: format.name, width, height, rate: None }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::OpenOptions;
    use std::io::Write as _;
    use std::path::PathBuf;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    use std::sync::atomic::Ordering::Relaxed;
    use std::thread::JoinHandle;

    use facewire_face::Pixels;
    use rustix::fs::{CWD, FileType, Mode, mknodat};
    use tempfile::TempDir;
    use turbojpeg::Subsamp;

    use super::super::FrameRate;
    use super::super::jpeg::tests::jpeg;
    use super::*;

    const WISH: Wish = Wish { width: 64, height: 48, rate: FrameRate::FPS_30, format: None };
    const PATIENCE: Duration = Duration::from_secs(60);

    fn pipe() -> (TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("video");
        mknodat(CWD, &path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        (folder, path)
    }

    /// Opens a source whose first image, of 40 x 32 pixels, has come behind the rest of another one, and its writer.
    fn opened(timeout: Duration) -> (PipeSource, File, TempDir) {
        let (folder, path) = pipe();
        // A writer that can also read does not wait for a reader.
        let mut early = OpenOptions::new().read(true).write(true).open(&path).unwrap();
        let image = jpeg(40, 32, Subsamp::Sub2x2);
        early.write_all(&[&image[100..], &image].concat()).unwrap();
        let path = path.to_str().unwrap();
        assert!(is_pipe(path) && !is_pipe(folder.path().to_str().unwrap()));
        let source = PipeSource::open(path, &WISH, timeout).unwrap();
        // Now there is a reader, and no other one than the source is to be left.
        let writer = OpenOptions::new().write(true).open(path).unwrap();
        (source, writer, folder)
    }

    #[test]
    fn of_the_images_that_have_come_the_newest_whole_one_is_shown_without_an_allocation() {
        let (mut source, mut writer, _folder) = opened(PATIENCE);
        assert_eq!(source.describe().to_string().rsplit_once(": ").unwrap().1, "JPEG 40x32");
        let image = jpeg(40, 32, Subsamp::Sub2x2);
        // A pipe of the usual size would not hold this.
        writer.write_all(&vec![0; 100_000]).unwrap();
        let mut numbers = Vec::with_capacity(3);
        for _ in 0..3 {
            writer.write_all(&image.repeat(3)).unwrap();
            writer.write_all(&image[..image.len() / 2]).unwrap();
            let allocated = allocation_counter::measure(|| {
                let frame = source.next().unwrap().unwrap();
                numbers.push((frame.number, frame.picture().unwrap().width));
            });
            assert_eq!(allocated.count_total, 0);
            writer.write_all(&image[image.len() / 2..]).unwrap();
        }
        assert_eq!((numbers, source.take_tally().for_newer), (vec![(3, 40), (7, 40), (11, 40)], 8));
    }

    #[test]
    fn a_damaged_image_is_an_error_of_its_own_and_the_next_one_is_intact() {
        let (mut source, mut writer, _folder) = opened(PATIENCE);
        let image = jpeg(40, 32, Subsamp::Sub2x2);
        let other = jpeg(64, 48, Subsamp::Sub2x2);
        // An image that breaks off shows once the next one has come, and gives way to it.
        writer.write_all(&[&image[..image.len() - 60], &image].concat()).unwrap();
        assert!(source.next().unwrap().is_some());
        for damaged in [&other[..], &[0xff, 0xd8, 0xff, 0xd9]] {
            writer.write_all(&[damaged, &[0xff, 0xd8]].concat()).unwrap();
            assert!(matches!(source.next(), Err(CaptureError::Frame { .. })), "{} bytes", damaged.len());
            writer.write_all(&image[2..]).unwrap();
            assert!(source.next().unwrap().is_some(), "{} bytes", damaged.len());
        }
        let endless = vec![7; source.buffer.len() + 1];
        let long = std::thread::spawn(move || {
            writer.write_all(&[&image[..image.len() / 2], &endless, &image].concat()).unwrap();
            writer
        });
        assert!(matches!(source.next(), Err(CaptureError::Frame { fault: FrameFault::TooLarge, .. })));
        assert!(source.next().unwrap().is_some());
        drop(long.join().unwrap());
    }

    /// A program that writes pictures of so many bytes to a pipe, with pauses between them, until it is dropped. The bytes of each
    /// are all the same, and one more than those of the picture before. It begins in the middle of a picture.
    struct Writer {
        thread: Option<JoinHandle<File>>,
        has_ended: Arc<AtomicBool>,
    }

    impl Writer {
        fn start(path: &Path, picture_bytes: usize) -> Self {
            // A writer that can also read does not wait for a reader.
            let mut pipe = OpenOptions::new().read(true).write(true).open(path).unwrap();
            let has_ended = Arc::new(AtomicBool::new(false));
            let thread = std::thread::spawn({
                let has_ended = Arc::clone(&has_ended);
                move || {
                    pipe.write_all(&vec![0; picture_bytes / 3]).unwrap();
                    for number in (1..=u8::MAX).cycle() {
                        std::thread::sleep(Duration::from_millis(40));
                        if has_ended.load(Relaxed) {
                            break;
                        }
                        pipe.write_all(&vec![number; picture_bytes]).unwrap();
                    }
                    pipe
                }
            });
            Self { thread: Some(thread), has_ended }
        }

        /// Ends between two pictures. Returns its end of the pipe.
        fn end(mut self) -> File {
            self.has_ended.store(true, Relaxed);
            self.thread.take().unwrap().join().unwrap()
        }
    }

    fn raw_pipe(name: &str) -> (TempDir, String) {
        let (folder, path) = pipe();
        let named = folder.path().join(name);
        std::fs::rename(path, &named).unwrap();
        (folder, named.to_str().unwrap().to_owned())
    }

    /// The luma of all pixels of the next picture, which must be the same.
    fn next_luma(source: &mut PipeSource) -> u8 {
        let frame = source.next().unwrap().unwrap();
        let Pixels::Planar { planes: [luma, ..], .. } = frame.picture().unwrap().pixels else { unreachable!() };
        assert!(luma.iter().all(|value| *value == luma[0]), "a picture that is put together from two");
        luma[0]
    }

    #[test]
    fn raw_pictures_begin_after_a_pause_of_their_writer_and_those_that_have_waited_are_passed_over() {
        let (_folder, path) = raw_pipe("video-64x48.yu12");
        let picture_bytes = 64 * 48 * 3 / 2;
        let writer = Writer::start(Path::new(&path), picture_bytes);
        let mut source = PipeSource::open(&path, &WISH, PATIENCE).unwrap();
        assert_eq!(source.describe().to_string().rsplit_once(": ").unwrap().1, "YU12 64x48");
        let first = next_luma(&mut source);
        assert!(next_luma(&mut source) > first);
        let mut pipe = writer.end();
        // More pictures than there is room for, and the beginning of another one.
        for number in 201..=205 {
            pipe.write_all(&vec![number; picture_bytes]).unwrap();
        }
        pipe.write_all(&[206; 100]).unwrap();
        source.take_tally();
        let mut luma = 0;
        let allocated = allocation_counter::measure(|| luma = next_luma(&mut source));
        assert_eq!((luma, allocated.count_total), (205, 0));
        assert!(source.take_tally().for_newer >= 4);
        pipe.write_all(&vec![206; picture_bytes - 100]).unwrap();
        assert_eq!(next_luma(&mut source), 206);
    }

    #[test]
    fn a_pipe_whose_name_is_not_that_of_its_raw_pictures_is_reported_with_what_it_gets() {
        for (name, picture_bytes, expected) in [
            (
                "video-64x48.yu12",
                64 * 48 * 2,
                "gets 6144 bytes at a time, which are no pictures of 64x48 in YU12, of 4608 bytes",
            ),
            // Three small pictures have as many bytes as one of these.
            ("video-64x48.nv12", 3 * 4608, "gets 13824 bytes at a time, which are no pictures of 64x48 in NV12"),
            (
                "video.yu12",
                10,
                "video.yu12 does not end with the pictures' size and format, such as video-640x480.yu12",
            ),
            ("video-64x0.grey", 10, "does not end with the pictures' size and format"),
            ("video-64x48x2.grey", 10, "does not end with the pictures' size and format"),
        ] {
            let (_folder, path) = raw_pipe(name);
            let writer = Writer::start(Path::new(&path), picture_bytes);
            let refused = PipeSource::open(&path, &WISH, PATIENCE).err().unwrap().to_string();
            assert!(refused.contains(expected), "{refused}");
            writer.end();
        }
        for name in ["video", "video.mjpeg", "video-64x48.jpeg", "video.1"] {
            assert_eq!(raw_layout(name).unwrap(), None, "{name}");
        }
    }

    #[test]
    fn a_pipe_that_is_being_read_is_in_use_by_another_program() {
        let (_source, _writer, folder) = opened(PATIENCE);
        let path = folder.path().join("video");
        let again = PipeSource::open(path.to_str().unwrap(), &WISH, PATIENCE).err().unwrap().to_string();
        assert!(again.contains("/video is in use by another program"), "{again}");
    }

    #[test]
    fn a_writer_that_comes_and_goes_without_a_picture_has_ended() {
        let (_folder, path) = pipe();
        let open = std::thread::spawn({
            let path = path.clone();
            move || PipeSource::open(path.to_str().unwrap(), &WISH, PATIENCE).err().unwrap().to_string()
        });
        drop(OpenOptions::new().write(true).open(&path).unwrap());
        let ended = open.join().unwrap();
        assert!(ended.contains("/video has no writer any more"), "{ended}");
    }

    #[test]
    fn a_writer_that_ends_or_pauses_is_an_error_that_names_the_pipe() {
        let (mut source, writer, _folder) = opened(Duration::from_millis(1));
        let paused = source.next().unwrap_err().to_string();
        assert!(paused.contains("/video gave no picture for 1 ms; start the program that writes"), "{paused}");
        drop(writer);
        let ended = source.next().unwrap_err().to_string();
        assert!(ended.contains("/video has no writer any more; start the program that writes"), "{ended}");
    }
}
