//! A camera as a source: sets the mode, checks every buffer and keeps the pixels of the newest one.

use std::mem::take;
use std::path::Path;
use std::time::{Duration, Instant};

use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use super::super::{CaptureError, Content, Delivery, Description, Frame, FrameFault, FrameRate, Skipped, Source};
use super::guard::guarded;
use super::layout::{Layout, Store};
use super::mode::{Choice, Wish, choose, has_smaller};
use super::select::{self, Selected};
use super::stream::{Limits, Stream};

/// An open camera.
pub struct CameraSource {
    stream: Stream,
    pixels: Store,
    layout: Layout,
    origin: String,
    rate: Option<FrameRate>,
    decoding: Duration,
    has_smaller_mode: bool,
}

impl CameraSource {
    /// Opens the camera that `wanted` names: `auto` (the first camera with a usable mode), a path (`/dev/video0` or a link
    /// to it), or a part of the camera's name or of its links. Sets the mode that is nearest to `wish`. The first frame
    /// must come within 5 seconds, and each later frame within `timeout`.
    ///
    /// # Errors
    /// [`CaptureError::NoCamera`], [`CaptureError::NotFound`], [`CaptureError::NotACamera`],
    /// [`CaptureError::PermissionDenied`], [`CaptureError::Busy`], [`CaptureError::ModeLacking`],
    /// [`CaptureError::ModeRefused`], [`CaptureError::Stalled`], [`CaptureError::Gone`], [`CaptureError::Driver`],
    /// [`CaptureError::Device`].
    pub fn open(wanted: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let selected = select::open(wanted, wish)?;
        guarded(&selected.camera.node, || Self::start(&selected, wish, timeout))
    }

    fn start(selected: &Selected, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let Selected { camera, device, origin } = selected;
        let choice = choose(&camera.modes, wish).ok_or_else(|| camera.lacks(wish))?;
        let has_smaller_mode = has_smaller(&camera.modes, wish, &choice);
        let layout = set_format(device, &camera.node, choice)?;
        let rate = choice.rate.and_then(|rate| set_rate(device, rate)).or(choice.rate);
        let pixels = Store::new(&layout)?;
        let period_us = rate.unwrap_or(FrameRate::FPS_30).period_us();
        let limits = Limits { timeout, period_us };
        let stream = Stream::start(device, &camera.node, limits)?;
        Ok(Self { stream, pixels, layout, origin: origin.clone(), rate, decoding: Duration::ZERO, has_smaller_mode })
    }
}

impl Source for CameraSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let (pixels, layout, decoding) = (&mut self.pixels, &self.layout, &mut self.decoding);
        let kept = self.stream.newest(|shot| {
            let begun = Instant::now();
            let kept = pixels.keep(shot.bytes, layout);
            *decoding += begun.elapsed();
            kept.map(|()| shot.captured_us)
        })?;
        let number = self.stream.taken() - 1;
        let damaged = |fault| CaptureError::Frame { number, fault };
        let captured_us = kept.map_err(damaged)?;
        let picture = self.pixels.picture(&self.layout).ok_or(damaged(FrameFault::Incomplete))?;
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

    fn frame_period_us(&self) -> Option<u64> {
        self.rate.map(FrameRate::period_us)
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
    Layout::of(&set).ok_or_else(|| CaptureError::ModeRefused {
        path: path.display().to_string(),
        got: format!("{} {}x{}", set.fourcc, set.width, set.height),
    })
}

/// Asks the driver for a rate. Returns the rate that it has set, if it says so.
fn set_rate(device: &Device, rate: FrameRate) -> Option<FrameRate> {
    let [frames, seconds] = rate.fraction();
    let set = device.set_params(&Parameters::new(Fraction::new(seconds, frames))).ok()?.interval;
    FrameRate::new(set.denominator, set.numerator)
}
