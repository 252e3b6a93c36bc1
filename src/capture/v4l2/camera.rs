//! A camera as a source: sets the mode, checks every buffer and keeps the pixels of the newest one.

use std::mem::take;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use super::super::{CaptureError, Content, Delivery, Description, Frame, FrameFault, FrameRate, Skipped, Source};
use super::layout::{Layout, Store};
use super::mode::{Choice, Wish, choose, has_smaller};
use super::probe::{cameras, guarded, probe};
use super::select::{failed, start_one};
use super::stream::Stream;

/// A camera that has shown this many pictures is a good one: if it fails after that, it is tried first again.
const PROVEN_AFTER: u32 = 30;

/// An open camera.
pub struct CameraSource {
    stream: Stream,
    pixels: Store,
    layout: Layout,
    node: PathBuf,
    origin: String,
    rate: Option<FrameRate>,
    decoding: Duration,
    has_smaller_mode: bool,
    /// Number of pictures so far, up to [`PROVEN_AFTER`].
    shown: u32,
    /// Whether the last call of [`Source::next`] has returned an error.
    has_failed: bool,
}

impl CameraSource {
    /// Opens the camera that `wanted` names: `auto`, a path (`/dev/video0` or a link to it), or a part of the camera's name
    /// or of its links. Sets the mode that is nearest to `wish`. The first frame must come within 5 seconds, and each later
    /// frame within `timeout`. If several cameras fit, the next one is tried if one does not start.
    pub fn open(wanted: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let start = |node: &Path, note: &str| guarded(node, || Self::start(node, note, wish, timeout));
        if wanted.starts_with('/') {
            return start(Path::new(wanted), "");
        }
        start_one(cameras(), wanted, wish, start)
    }

    fn start(path: &Path, note: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let (camera, device) = probe(path)?;
        let choice = choose(&camera.modes, wish).ok_or_else(|| camera.lacks(wish))?;
        let has_smaller_mode = has_smaller(&camera.modes, wish, &choice);
        let layout = set_format(&device, &camera.node, choice)?;
        let rate = choice.rate.and_then(|rate| set_rate(&device, rate)).or(choice.rate);
        let pixels = Store::new(&layout)?;
        let period_us = rate.unwrap_or(FrameRate::FPS_30).period_us();
        let stream = Stream::start(&device, &camera.node, timeout, period_us)?;
        let origin = format!("{} ({}{note})", camera.card, camera.node.display());
        let (node, decoding) = (camera.node, Duration::ZERO);
        let (shown, has_failed) = (0, false);
        Ok(Self { stream, pixels, layout, node, origin, rate, decoding, has_smaller_mode, shown, has_failed })
    }

    /// Returns the number of the newest frame, whose pixels are kept, and its time of capture.
    fn keep_newest(&mut self) -> Result<(u64, u64), CaptureError> {
        let (pixels, layout, decoding) = (&mut self.pixels, &self.layout, &mut self.decoding);
        let kept = self.stream.newest(|bytes| {
            let begun = Instant::now();
            let kept = pixels.keep(bytes, layout);
            *decoding += begun.elapsed();
            kept
        })?;
        let number = self.stream.taken() - 1;
        kept.map(|captured_us| (number, captured_us)).map_err(|fault| CaptureError::Frame { number, fault })
    }
}

impl Drop for CameraSource {
    fn drop(&mut self) {
        if self.shown == PROVEN_AFTER {
            failed().forget(&self.node);
        } else if self.has_failed {
            failed().add(&self.node);
        }
    }
}

impl Source for CameraSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let kept = self.keep_newest();
        self.has_failed = kept.is_err();
        let (number, captured_us) = kept?;
        self.shown = PROVEN_AFTER.min(self.shown + 1);
        let missing = CaptureError::Frame { number, fault: FrameFault::Incomplete };
        let picture = self.pixels.picture(&self.layout).ok_or(missing)?;
        Ok(Some(Frame { content: Content::Picture(picture), captured_us, number }))
    }

    fn leave_out_until(&mut self, captured_us: u64) {
        self.stream.leave_out_until(captured_us);
    }

    fn take_skipped(&mut self) -> Skipped {
        self.stream.take_skipped()
    }

    fn take_delivery(&mut self) -> Option<Delivery> {
        self.stream.take_delivery()
    }

    fn take_decoding(&mut self) -> Duration {
        take(&mut self.decoding)
    }

    fn has_smaller_mode(&self) -> bool {
        self.has_smaller_mode
    }

    fn close(mut self: Box<Self>) -> Result<(), CaptureError> {
        self.stream.stop()
    }

    fn describe(&self) -> Description<'_> {
        let Layout { format, width, height, .. } = self.layout;
        Description { origin: &self.origin, format: format.name(), width, height, rate: self.rate }
    }
}

/// Sets format and size, and returns what the driver has set.
fn set_format(device: &Device, path: &Path, choice: Choice) -> Result<Layout, CaptureError> {
    let wanted = Format::new(choice.width, choice.height, FourCC::new(&choice.format.fourcc()));
    let set = device.set_format(&wanted).map_err(|error| CaptureError::device(path, "setting its format", error))?;
    let Format { fourcc, width, height, .. } = set;
    Layout::of(&set).ok_or_else(|| {
        let (path, remedy) = (path.display(), "set another camera.format or size");
        CaptureError::Unusable(format!(
            "{path} answered with {fourcc} {width}x{height}, which cannot be read; {remedy}"
        ))
    })
}

/// Asks the driver for a rate. Returns the rate that it has set, if it says so.
fn set_rate(device: &Device, rate: FrameRate) -> Option<FrameRate> {
    let set = device.set_params(&Parameters::new(Fraction::new(rate.seconds, rate.frames))).ok()?.interval;
    FrameRate::new(set.denominator, set.numerator)
}
