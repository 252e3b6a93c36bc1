//! Cameras of the kernel's `Video4Linux2` interface.
//!
//! `probe` lists the cameras, `select` decides which of them to try for a setting, `mode` chooses among the modes that a
//! camera offers, `stream` waits for the newest buffer, `clock` judges its time, and `layout` checks and keeps its pixels.
//! `device` is a camera by either of the kernel's interfaces, and `planes` has the one for several planes.
//!
//! Contract: every error except a damaged frame ends the source, which must then be closed and opened again. Unplugged
//! cameras and faulty drivers cause errors, never panics.
//!
//! Limits: the formats of [`PixelFormat::ALL`], each picture of which is in one piece of memory.

mod clock;
mod device;
mod layout;
mod mode;
mod planes;
mod probe;
mod select;
mod stream;

use std::mem::take;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use v4l::format::FieldOrder;
use v4l::{Format, FourCC, Fraction};

pub use self::layout::{Layout, PixelFormat, Store};
pub use self::mode::Wish;
pub use self::probe::{Camera, Found, cameras};

use self::clock::DriverClock;
use self::device::{Buffers, Device, Waker};
use self::mode::{Choice, choose, has_smaller};
use self::probe::{guarded, has_hardware, probe};
pub(super) use self::select::{AUTO, start_one};
use self::stream::{BUFFERS, captured_us, failed_stream, filled, is_ready, wait};
use super::delivery::Arrival;
use super::live::Live;
use super::{CaptureError, Content, Delivery, Description, Frame, FrameFault, FrameRate, Motion, Source, Tally};
use crate::clock::monotonic_us;

/// Age, in frame periods, from which a frame that waited in a buffer is skipped. The next frame comes in less time.
const STALE_PERIODS: u64 = 2;

pub struct CameraSource {
    /// `None` after the camera was stopped.
    mapped: Option<Buffers>,
    waker: Waker,
    store: Store,
    node: PathBuf,
    origin: String,
    rate: Option<FrameRate>,
    /// Time after which a camera without a frame has stalled.
    timeout: Duration,
    has_smaller_mode: bool,
    /// Number of frames that were taken from the driver, without the first one.
    taken: u64,
    clock: DriverClock,
    /// Whether a program makes the pictures, which may then stand still.
    is_virtual: bool,
    live: Live,
}

impl CameraSource {
    /// Opens the camera that `wanted` names: `auto`, a path (`/dev/video0` or a link to it), or a part of the camera's name
    /// or of its links. Sets the mode that is nearest to `wish`. The first frame must come within 5 seconds, and each later
    /// frame within `timeout`. If several cameras fit, the next one is tried if one does not start.
    pub fn open(wanted: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let start = |node: &Path, note: &str| Self::open_node(node, note, wish, timeout);
        if wanted.starts_with('/') {
            start(Path::new(wanted), "")
        } else {
            start_one(None, cameras, wanted, wish, start)
        }
    }

    /// Opens the camera with this node. The log shows `note` after the name of the camera.
    pub(super) fn open_node(node: &Path, note: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        guarded(node, || Self::start(node, note, wish, timeout))
    }

    fn start(path: &Path, note: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let (camera, device) = probe(path)?;
        let choice = choose(&camera.modes, wish).ok_or_else(|| camera.lacks(wish))?;
        let has_smaller_mode = has_smaller(&camera.modes, wish, &choice);
        let opened = Device::new(device, &camera.node, camera.is_multi_planar);
        let device = opened.map_err(|error| CaptureError::device(&camera.node, "opening it", error))?;
        let store = Store::new(set_format(&device, &camera, choice)?)?;
        let Camera { node, card, .. } = camera;
        let rate = choice.rate.and_then(|rate| set_rate(&device, rate)).or(choice.rate);
        let period_us = rate.unwrap_or(FrameRate::FPS_30).period_us();
        let mapped = stream::start(&device, &node)?;
        Ok(Self {
            mapped: Some(mapped),
            waker: device.waker(),
            store,
            origin: format!("{card} ({}{note})", node.display()),
            is_virtual: !has_hardware(&node),
            live: Live::new(&node, period_us),
            node,
            rate,
            timeout,
            has_smaller_mode,
            taken: 0,
            clock: DriverClock::new(period_us, monotonic_us()),
        })
    }

    /// Waits for a frame that is not to be left out, skips all but the newest, and keeps the pixels of that one. Returns its
    /// number and its time of capture.
    ///
    /// After a long pause of the reader all buffers are filled, and even the newest frame is old, because the driver had
    /// no buffer for later frames. Such a frame is skipped as well, and the next one awaited.
    fn keep_newest(&mut self) -> Result<(u64, u64), CaptureError> {
        let waker = &self.waker;
        let timeout = self.timeout;
        wait(waker, timeout)?;
        let mapped = self.mapped.as_mut().ok_or(CaptureError::Gone)?;
        let stale_us = STALE_PERIODS * self.rate.unwrap_or(FrameRate::FPS_30).period_us();
        let mut skipped = 0;
        let mut patience = timeout;
        loop {
            let (bytes, meta) = mapped.next().map_err(|error| failed_stream(&error))?;
            let number = self.taken;
            let now_us = monotonic_us();
            self.taken += 1;
            let stated_us = captured_us(meta, now_us);
            let believed_us = stated_us.and_then(|stated_us| self.clock.judge(stated_us, now_us));
            if let Some(captured_us) = believed_us {
                self.live.delivery.arrived(Arrival { sequence: meta.sequence, captured_us, taken_us: now_us });
            } else if stated_us.is_some() {
                self.live.delivery.interrupt();
                self.live.tally.mistimed += 1;
                self.live.tally.has_false_clock |= self.clock.is_given_up();
            }
            let captured_us = believed_us.unwrap_or(now_us);
            // Every frame counts: of a picture that moves, those that are shown may be the same.
            let frame = filled(bytes, meta);
            let is_frozen = frame.is_ok_and(|frame| self.live.repeats.is_frozen(frame, now_us));
            if self.live.leaves_out(captured_us) {
                wait(waker, timeout)?;
                continue;
            }
            let is_stale = skipped > 0 && now_us - captured_us > stale_us;
            let has_newer = is_ready(waker, Duration::ZERO)? || is_stale && is_ready(waker, take(&mut patience))?;
            if !has_newer || skipped > BUFFERS {
                self.live.tally.motion = match is_frozen {
                    false => Motion::Moving,
                    true if self.is_virtual => Motion::Frozen,
                    true => Motion::Hung,
                };
                if let Some(count) = self.live.repeats.asks_to_reopen().filter(|_| !self.is_virtual) {
                    return Err(CaptureError::AllDamaged { count, fault: FrameFault::Repeated });
                }
                let begun = Instant::now();
                let kept = frame.and_then(|frame| self.store.keep(frame));
                self.live.tally.decoding += begun.elapsed();
                return kept.map(|()| (number, captured_us)).map_err(|fault| {
                    self.live.delivery.damaged += 1;
                    self.fit_store(fault);
                    CaptureError::Frame { number, fault }
                });
            }
            skipped += 1;
            self.live.tally.for_newer += 1;
        }
    }

    /// Makes room for images of another size than the driver has announced, such as those of 1088 rows in place of 1080. Once a
    /// picture was shown, another size counts as damage, and a far larger one always does.
    fn fit_store(&mut self, fault: FrameFault) {
        if let FrameFault::WrongSize { width, height } = fault
            && self.live.has_shown_nothing()
            && width <= 2 * self.store.layout.width
            && height <= 2 * self.store.layout.height
            && let Ok(store) = Store::new(Layout { width, height, ..self.store.layout })
        {
            self.store = store;
        }
    }

    /// Stops the camera and gives its buffers back. There are no frames afterwards.
    fn stop(&mut self) -> Result<(), CaptureError> {
        self.mapped.take().map_or(Ok(()), |mapped| stream::release(mapped, &self.node))
    }
}

impl Drop for CameraSource {
    fn drop(&mut self) {
        // The result matters to those who call `close`.
        let _ = self.stop();
    }
}

impl Source for CameraSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let kept = self.keep_newest();
        let (number, captured_us) = self.live.answered(kept)?;
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

    fn has_smaller_mode(&self) -> bool {
        self.has_smaller_mode
    }

    fn close(mut self: Box<Self>) -> Result<(), CaptureError> {
        self.stop()
    }

    fn describe(&self) -> Description<'_> {
        let Layout { format, width, height, .. } = self.store.layout;
        Description { origin: &self.origin, format: format.name, width, height, rate: self.rate }
    }
}

/// Asks the driver for a format with whole pictures: in its usual order of fields, or else with rows of two moments in turn.
fn set_format(device: &Device, camera: &Camera, choice: Choice) -> Result<Layout, CaptureError> {
    let path = camera.node.as_path();
    let ask = |field_order| {
        let [width, height] = choice.size;
        let wanted = Format { field_order, ..Format::new(width, height, FourCC::new(&choice.format.fourcc)) };
        let set = device.set_format(&wanted);
        set.map_err(|error| CaptureError::device(path, "setting its format", error))?
            .ok_or_else(|| camera.needs_planes())
    };
    let mut set = ask(FieldOrder::Any)?;
    if lacks_rows(&set)
        && let Ok(whole) = ask(FieldOrder::Interlaced)
    {
        set = whole;
    }
    let unusable = |fault: String, remedy| CaptureError::Unusable(format!("{} {fault}; {remedy}", path.display()));
    let Format { fourcc, width, height, field_order, .. } = set;
    if lacks_rows(&set) {
        let fault = format!("sends pictures of which every second row is elsewhere (fields: {field_order})");
        return Err(unusable(
            fault,
            "switch what is connected to it to a progressive mode, or set another camera.width and height",
        ));
    }
    let fault = || format!("answered with {fourcc} {width}x{height}, which cannot be read");
    Layout::of(&set).ok_or_else(|| unusable(fault(), "set another camera.format or size"))
}

/// Whether pictures come in halves, each of which has every second row. The upper or the lower half alone is a picture of fewer
/// rows, unless these are too few for its width.
fn lacks_rows(set: &Format) -> bool {
    match set.field_order {
        FieldOrder::Top | FieldOrder::Bottom => set.width > 2 * set.height,
        FieldOrder::SequentialTB | FieldOrder::SequentialBT | FieldOrder::Alternate => true,
        _ => false,
    }
}

/// Asks the driver for a rate. Returns the rate that it has set, if that is known.
fn set_rate(device: &Device, rate: FrameRate) -> Option<FrameRate> {
    let set = device.set_interval(Fraction::new(rate.seconds, rate.frames))?;
    FrameRate::new(set.denominator, set.numerator)
}
