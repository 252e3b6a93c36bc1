//! The buffers of a camera: waits for frames, takes the newest, and gives all buffers back at the end.
//!
//! The v4l crate's stream lends a buffer from one `next` to the following one, and cannot be used after an error. Every
//! error therefore ends the source.
//!
//! Its `Drop` stops the stream, and panics if that fails with any error but `ENODEV`. [`Stream::stop`] therefore stops the
//! stream first and drops it only afterwards. A camera that cannot be stopped stays open, because its descriptor cannot
//! be closed without that `Drop`: only the end of the process frees it ([`CaptureError::NotStopped`]). `Drop` stops the
//! stream a second time. If that fails and freeing the buffers fails too, the crate panics while it is already panicking, so
//! that the process aborts. That also frees the camera.

use std::io;
use std::mem;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use rustix::io::Errno;
use v4l::Device;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::device::Handle;
use v4l::io::mmap::Stream as MappedStream;
use v4l::io::traits::CaptureStream;

use super::super::delivery::{Arrival, Delivery, DeliveryCounter};
use super::super::{CaptureError, FrameFault, Skipped, monotonic_us};
use super::guard::guarded;

/// Number of buffers. Two are enough for streaming; two more bridge a late wake-up without a dropped frame.
const BUFFERS: u32 = 4;
/// Flag of `poll` for a buffer that can be dequeued.
const READABLE: i16 = 1;
/// Time limit for the first frame. Exposure, USB bandwidth and sleeping hubs can delay it.
const START_TIMEOUT: Duration = Duration::from_secs(5);
/// Age, in frame periods, from which a frame that waited in a buffer is skipped. The next frame comes in less time.
const STALE_PERIODS: u64 = 2;
/// Largest number of frames that are left out at once, so that a camera whose clock stands still is read nevertheless.
const MAX_LEFT_OUT: u32 = 16;
/// Largest number of attempts to stop, which signals can interrupt.
const STOP_ATTEMPTS: usize = 10;

/// The running stream of a camera.
pub struct Stream {
    /// `None` after [`Stream::stop`].
    mapped: Option<MappedStream<'static>>,
    handle: Arc<Handle>,
    path: PathBuf,
    limits: Limits,
    /// Number of frames that were taken from the driver.
    taken: u64,
    /// Frames that were captured earlier are left out.
    wanted_us: u64,
    /// Numbers of frames that were skipped since the last call of [`Stream::take_skipped`].
    skipped: Skipped,
    delivery: DeliveryCounter,
}

/// Time limits of a stream.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Time after which a camera without a frame has stalled.
    pub timeout: Duration,
    /// Time from one frame to the next, microseconds.
    pub period_us: u64,
}

/// A filled buffer.
#[derive(Clone, Copy)]
pub struct Shot<'a> {
    /// The bytes that the driver has written.
    pub bytes: &'a [u8],
    /// Time of capture on the monotonic clock, in microseconds.
    pub captured_us: u64,
}

impl Stream {
    /// Maps the buffers, starts the camera and discards the first frame, because some drivers deliver an old one.
    ///
    /// # Errors
    /// [`CaptureError::Stalled`] if no frame comes within 5 seconds, [`CaptureError::NotStopped`] if the camera then cannot
    /// be stopped either, [`CaptureError::Busy`], [`CaptureError::Gone`], and the others of [`CaptureError::device`].
    pub fn start(device: &Device, path: &Path, limits: Limits) -> Result<Self, CaptureError> {
        let fail = |error| CaptureError::device(path, "starting it", error);
        let mut mapped = MappedStream::with_buffers(device, Type::VideoCapture, BUFFERS).map_err(fail)?;
        mapped.set_timeout(START_TIMEOUT);
        let (delivery, skipped) = (DeliveryCounter::new(limits.period_us), Skipped::default());
        let (handle, path) = (device.handle(), path.to_owned());
        let mut stream = Self { mapped: Some(mapped), handle, path, limits, taken: 0, wanted_us: 0, skipped, delivery };
        let error = match stream.mapped.as_mut().ok_or(CaptureError::Gone)?.next() {
            Ok(_) => return Ok(stream),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => stalled(START_TIMEOUT),
            Err(error) => fail(error),
        };
        stream.stop()?;
        Err(error)
    }

    /// Lets [`Stream::newest`] leave out frames that were captured before this time.
    pub fn leave_out_until(&mut self, captured_us: u64) {
        self.wanted_us = captured_us;
    }

    /// Waits for a frame that is not to be left out, skips all but the newest, and passes that one to `look`.
    ///
    /// After a long pause of the reader all buffers are filled, and even the newest frame is old, because the driver had
    /// no buffer for later frames. Such a frame is skipped as well, and the next one awaited.
    ///
    /// # Errors
    /// [`CaptureError::Stalled`], [`CaptureError::Gone`], [`CaptureError::Device`]. The inner result is that of `look`, or
    /// the fault of a buffer that the driver has marked as damaged.
    pub fn newest<T>(
        &mut self,
        look: impl FnOnce(Shot<'_>) -> Result<T, FrameFault>,
    ) -> Result<Result<T, FrameFault>, CaptureError> {
        let (handle, limits) = (&self.handle, self.limits);
        wait(handle, limits.timeout)?;
        let mapped = self.mapped.as_mut().ok_or(CaptureError::Gone)?;
        let (mut skipped, mut left_out, mut patience) = (0, 0, limits.timeout);
        loop {
            let (bytes, meta) = mapped.next().map_err(CaptureError::stream)?;
            self.taken += 1;
            let now_us = monotonic_us();
            let captured_us = captured_us(meta, now_us);
            if is_monotonic(meta) {
                self.delivery.arrived(Arrival { sequence: meta.sequence, captured_us, taken_us: now_us });
            }
            if captured_us < self.wanted_us && left_out < MAX_LEFT_OUT {
                left_out += 1;
                self.skipped.left_out += 1;
                wait(handle, limits.timeout)?;
                continue;
            }
            let is_stale = skipped > 0 && now_us - captured_us > STALE_PERIODS * limits.period_us;
            let has_newer =
                is_ready(handle, Duration::ZERO)? || is_stale && is_ready(handle, mem::take(&mut patience))?;
            if !has_newer || skipped > BUFFERS {
                let outcome = shot(bytes, meta).and_then(look);
                if outcome.is_err() {
                    self.delivery.damaged();
                }
                return Ok(outcome);
            }
            skipped += 1;
            self.skipped.for_newer += 1;
        }
    }

    /// Number of frames that were taken from the driver, without the first one.
    pub fn taken(&self) -> u64 {
        self.taken
    }

    /// Returns the numbers of frames that were skipped since the last call.
    pub fn take_skipped(&mut self) -> Skipped {
        mem::take(&mut self.skipped)
    }

    /// Returns what the camera has delivered whenever a window is complete.
    pub fn take_delivery(&mut self) -> Option<Delivery> {
        self.delivery.take()
    }

    /// Stops the camera and gives its buffers back. There are no frames afterwards.
    ///
    /// # Errors
    /// [`CaptureError::NotStopped`] if the camera stays open for the rest of the process.
    pub fn stop(&mut self) -> Result<(), CaptureError> {
        self.mapped.take().map_or(Ok(()), |mapped| release(mapped, &self.path))
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        // The result matters to those who call `stop` themselves.
        let _ = self.stop();
    }
}

/// Stops a stream of the v4l crate and drops it. A stream that cannot be stopped is leaked.
fn release<S: v4l::io::traits::Stream>(mut mapped: S, path: &Path) -> Result<(), CaptureError> {
    if let Err(source) = stop(&mut mapped) {
        mem::forget(mapped);
        return Err(CaptureError::NotStopped { path: path.display().to_string(), source });
    }
    // Even if the driver does not take the buffers back, the descriptor is closed, which frees the camera.
    let _ = guarded(path, || {
        drop(mapped);
        Ok(())
    });
    Ok(())
}

/// Stops a stream. A camera that was unplugged counts as stopped.
fn stop(mapped: &mut impl v4l::io::traits::Stream) -> io::Result<()> {
    let mut outcome = mapped.stop();
    for _ in 1..STOP_ATTEMPTS {
        match &outcome {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => outcome = mapped.stop(),
            _ => break,
        }
    }
    match outcome {
        Err(error) if error.raw_os_error() == Some(Errno::NODEV.raw_os_error()) => Ok(()),
        outcome => outcome,
    }
}

/// Waits until a buffer is ready.
fn wait(handle: &Handle, timeout: Duration) -> Result<(), CaptureError> {
    let deadline_us = monotonic_us() + u64::try_from(timeout.as_micros()).unwrap_or(u64::MAX / 2);
    loop {
        let left = Duration::from_micros(deadline_us.saturating_sub(monotonic_us()));
        if is_ready(handle, left)? {
            return Ok(());
        }
        if left.is_zero() {
            return Err(stalled(timeout));
        }
    }
}

/// Returns whether a buffer is ready, or becomes ready within `timeout`. A signal ends the wait early.
fn is_ready(handle: &Handle, timeout: Duration) -> Result<bool, CaptureError> {
    // Rounded up, so that the last fraction of a millisecond is not spent in a busy loop.
    let timeout_ms = i32::try_from(timeout.as_micros().div_ceil(1000)).unwrap_or(i32::MAX);
    match handle.poll(READABLE, timeout_ms) {
        Ok(ready) => Ok(ready > 0),
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
        Err(error) => Err(CaptureError::stream(error)),
    }
}

/// Returns the part of a buffer that the driver has filled.
fn shot<'a>(bytes: &'a [u8], meta: &Metadata) -> Result<Shot<'a>, FrameFault> {
    if meta.flags.contains(Flags::ERROR) {
        return Err(FrameFault::Marked);
    }
    let used = usize::try_from(meta.bytesused).ok().and_then(|used| bytes.get(..used));
    let bytes = used.ok_or(FrameFault::Incomplete)?;
    Ok(Shot { bytes, captured_us: captured_us(meta, monotonic_us()) })
}

/// Returns the driver's timestamp if it uses the monotonic clock, and `now_us` otherwise. A timestamp in the future is
/// clamped to `now_us`.
fn captured_us(meta: &Metadata, now_us: u64) -> u64 {
    if !is_monotonic(meta) {
        return now_us;
    }
    let [seconds, micros] = [meta.timestamp.sec, meta.timestamp.usec].map(|part| u64::try_from(part).unwrap_or(0));
    seconds.saturating_mul(1_000_000).saturating_add(micros).min(now_us)
}

fn is_monotonic(meta: &Metadata) -> bool {
    meta.flags & Flags::TIMESTAMP_MASK == Flags::TIMESTAMP_MONOTONIC
}

fn stalled(timeout: Duration) -> CaptureError {
    CaptureError::Stalled { waited_ms: u64::try_from(timeout.as_millis()).unwrap_or(u64::MAX) }
}

#[cfg(test)]
mod tests;
