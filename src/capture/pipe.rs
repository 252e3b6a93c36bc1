//! A camera that another program reads: JPEG images, one after the other, through a named pipe.
//!
//! Raspberry Pi's camera modules need libcamera, whose program `rpicam-vid` writes such a stream, and so do ffmpeg and GStreamer
//! for all that the kernel's interface does not give. JPEG images state where they begin and end, and how large they are, so
//! that a reader finds its place in a stream that is already running. Raw pictures state neither, and two of them fill a pipe, so
//! that a busy reader would get old ones.
//!
//! Contract: as of a camera. Of the images that have come, the newest whole one is decoded. A stream that ends or pauses is an
//! error, after which the pipe must be opened again. Nothing allocates once the pipe is open.
//!
//! Limits: a frame counts as captured when its last byte is here. Images that wait in the writer because the pipe is full would
//! look newer than they are, so that the pipe gets the greatest size that a user without privileges may give it.

use std::fs;
use std::fs::File;
use std::io::{ErrorKind, Read as _};
use std::mem::replace;
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
use super::v4l2::Wish;
use super::{CaptureError, Content, Description, Frame, FrameFault, JpegDecoder, Motion, Source, Tally};
use crate::clock::monotonic_us;

/// Where `facewire-camera.service` writes the pictures of a Raspberry Pi's camera module.
const MODULE: &str = "/run/facewire-camera/video";
/// Time limit for the first image: the program may still start.
const START_TIMEOUT: Duration = Duration::from_secs(5);
/// What comes within this time after the first image was captured before the pipe had a reader.
const STALE: Duration = Duration::from_millis(300);
/// Bytes that the pipe holds.
const PIPE_BYTES: usize = 1 << 20;
/// Room for the first image, whose size is not known.
const FIRST_BYTES: usize = 4 << 20;

/// The pipe of a Raspberry Pi's camera module, if its service has made one.
pub fn module_pipe() -> Option<&'static str> {
    is_pipe(MODULE).then_some(MODULE)
}

pub fn is_pipe(path: &str) -> bool {
    path.starts_with('/') && fs::metadata(path).is_ok_and(|file| file.file_type().is_fifo())
}

pub struct PipeSource {
    path: String,
    origin: String,
    pipe: File,
    /// What has come and was not decoded yet, up to `filled`.
    buffer: Box<[u8]>,
    filled: usize,
    /// Up to here, the buffer has no end of an image that was not taken.
    searched: usize,
    decoder: JpegDecoder,
    size: [usize; 2],
    /// Number of whole images that have come.
    taken: u64,
    timeout: Duration,
    live: Live,
}

impl PipeSource {
    /// Opens the pipe, and waits for the first image, whose size the others must have. The log shows `note` after
    /// the path.
    pub fn open(path: &str, note: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let open = File::options().read(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed()).open(path);
        let fail = |error| CaptureError::device(Path::new(path), "opening it", error);
        let pipe = open.map_err(fail)?;
        // Two readers would get a part of the bytes each.
        let lock = flock(&pipe, FlockOperation::NonBlockingLockExclusive);
        lock.map_err(|error| fail(if error == Errno::WOULDBLOCK { Errno::BUSY } else { error }.into()))?;
        // A pipe that cannot grow works, too.
        let _ = fcntl_setpipe_size(&pipe, PIPE_BYTES);
        let size = [wish.width, wish.height].map(|side| side as usize);
        let mut source = Self {
            path: path.to_owned(),
            origin: format!("{path}{note}"),
            pipe,
            buffer: vec![0; FIRST_BYTES].into(),
            filled: 0,
            searched: 0,
            decoder: JpegDecoder::new(size[0], size[1])?,
            size,
            taken: 0,
            timeout: START_TIMEOUT,
            live: Live::new(Path::new(path), wish.rate.period_us()),
        };
        let [from, to] = source.await_image()?;
        let image = source.buffer.get(from..to).unwrap_or_default();
        source.size = image_size(image).unwrap_or(source.size);
        source.discard_stale(to)?;
        source.decoder = JpegDecoder::new(source.size[0], source.size[1])?;
        // Room for the newest image, and for the one before, until it has come.
        let mut buffer = vec![0; 2 * source.decoder.max_jpeg_bytes()].into_boxed_slice();
        source.filled = source.filled.min(buffer.len());
        buffer.iter_mut().zip(&source.buffer).take(source.filled).for_each(|(to, from)| *to = *from);
        source.buffer = buffer;
        source.timeout = timeout;
        Ok(source)
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
                return Err(self.silent(&format!("gave no picture for {} ms", self.timeout.as_millis())));
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

    /// Finds the newest whole image, and counts those before it as skipped.
    fn newest(&mut self) -> Option<[usize; 2]> {
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
            let sequence = self.taken as u32;
            self.live.delivery.arrived(Arrival { sequence, captured_us: now_us, taken_us: now_us });
            self.taken += 1;
            self.live.tally.for_newer += u32::from(newest.is_some());
            newest = Some([from + start, from + start + length]);
            from += start + length;
        }
        newest
    }

    /// Waits for an image that is not to be left out, and decodes it. Returns the time at which it came.
    fn keep_newest(&mut self) -> Result<u64, CaptureError> {
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
        let kept = self.decoder.decode(image);
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

    fn silent(&self, what: &str) -> CaptureError {
        let path = &self.path;
        CaptureError::Unusable(format!("{path} {what}; start the program that writes JPEG images to it"))
    }
}

impl Source for PipeSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let kept = self.keep_newest();
        let captured_us = self.live.answered(kept)?;
        let number = self.taken - 1;
        let missing = CaptureError::Frame { number, fault: FrameFault::Incomplete };
        let picture = self.decoder.picture().ok_or(missing)?;
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
        let [width, height] = self.size;
        Description { origin: &self.origin, format: "JPEG", width, height, rate: None }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::OpenOptions;
    use std::io::Write as _;
    use std::path::PathBuf;

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
        let source = PipeSource::open(path, "", &WISH, timeout).unwrap();
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
                numbers.push((frame.number, frame.picture().unwrap().width()));
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

    #[test]
    fn a_pipe_that_is_being_read_is_in_use_by_another_program() {
        let (_source, _writer, folder) = opened(PATIENCE);
        let path = folder.path().join("video");
        let again = PipeSource::open(path.to_str().unwrap(), "", &WISH, PATIENCE).err().unwrap().to_string();
        assert!(again.contains("/video is in use by another program"), "{again}");
    }

    #[test]
    fn a_writer_that_comes_and_goes_without_a_picture_has_ended() {
        let (_folder, path) = pipe();
        let open = std::thread::spawn({
            let path = path.clone();
            move || PipeSource::open(path.to_str().unwrap(), "", &WISH, PATIENCE).err().unwrap().to_string()
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
