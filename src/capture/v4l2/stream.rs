//! The buffers of a camera: starts the stream, waits for frames, and gives all buffers back at the end.
//!
//! The v4l crate's stream lends a buffer from one `next` to the following one, and cannot be used after an error. Every
//! error therefore ends the source.
//!
//! Its `Drop` stops the stream, and panics if that fails with any error but `ENODEV`. [`release`] therefore stops the
//! stream first and drops it only afterwards. A camera that cannot be stopped stays open, because its descriptor cannot
//! be closed without that `Drop`: only the end of the process frees it ([`CaptureError::NotStopped`]). `Drop` stops the
//! stream a second time. If that fails and freeing the buffers fails too, the crate panics while it is already panicking, so
//! that the process aborts. That also frees the camera.

use std::io;
use std::mem;
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::io::Errno;
use v4l::buffer::{Flags, Metadata};
use v4l::io::traits::Stream;

use super::super::{CaptureError, FrameFault};
use super::device::{Buffers, Device, Waker};
use super::probe::guarded;

/// Number of buffers. Two are enough for streaming; two more bridge a late wake-up without a dropped frame.
pub(super) const BUFFERS: u32 = 4;
/// Time limit for the first frame. Exposure, USB bandwidth and sleeping hubs can delay it.
const START_TIMEOUT: Duration = Duration::from_secs(5);
/// Largest number of attempts to stop, which signals can interrupt.
const STOP_ATTEMPTS: usize = 10;

/// Maps the buffers, starts the camera and discards the first frame, because some drivers deliver an old one.
pub(super) fn start(device: &Device, path: &Path) -> Result<Buffers, CaptureError> {
    let fail = |error| CaptureError::device(path, "starting it", error);
    let mut mapped = device.map(BUFFERS, START_TIMEOUT).map_err(fail)?;
    if let Err(error) = mapped.next().map(|_| ()) {
        release(mapped, path)?;
        // The error of the v4l crate for a camera that sends nothing has no number. That of a driver has one.
        let is_silent = error.kind() == io::ErrorKind::TimedOut && error.raw_os_error().is_none();
        return Err(if is_silent { CaptureError::stalled(START_TIMEOUT) } else { fail(error) });
    }
    Ok(mapped)
}

/// Stops a stream and drops it. A stream that cannot be stopped is leaked. A camera that was unplugged
/// counts as stopped.
pub(super) fn release<S: Stream + ?Sized>(mut mapped: Box<S>, path: &Path) -> Result<(), CaptureError> {
    let is_interrupted = |error: &io::Error| error.kind() == io::ErrorKind::Interrupted;
    let mut outcome = mapped.stop();
    for _ in 1..STOP_ATTEMPTS {
        if outcome.as_ref().is_err_and(is_interrupted) {
            outcome = mapped.stop();
        }
    }
    if let Err(source) = outcome
        && source.raw_os_error() != Some(Errno::NODEV.raw_os_error())
    {
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

pub(super) fn wait(waker: &Waker, timeout: Duration) -> Result<(), CaptureError> {
    let deadline = Instant::now() + timeout;
    while !is_ready(waker, deadline.saturating_duration_since(Instant::now()))? {
        if Instant::now() >= deadline {
            return Err(CaptureError::stalled(timeout));
        }
    }
    Ok(())
}

/// Returns whether a buffer is ready, or becomes ready within `timeout`. A signal ends the wait early.
pub(super) fn is_ready(waker: &Waker, timeout: Duration) -> Result<bool, CaptureError> {
    // Rounded up, so that the last fraction of a millisecond is not spent in a busy loop.
    let timeout_ms = i32::try_from(timeout.as_micros().div_ceil(1000)).unwrap_or(i32::MAX);
    match waker.poll(timeout_ms) {
        Ok(ready) => Ok(ready > 0),
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
        Err(error) => Err(failed_stream(&error)),
    }
}

pub(super) fn failed_stream(error: &io::Error) -> CaptureError {
    CaptureError::driver_failed("sending frames", error)
}

/// Returns the part of a buffer that the driver has filled.
pub(super) fn filled<'a>(bytes: &'a [u8], meta: &Metadata) -> Result<&'a [u8], FrameFault> {
    if meta.flags.contains(Flags::ERROR) {
        return Err(FrameFault::Marked);
    }
    if meta.bytesused == 0 {
        return Err(FrameFault::Empty);
    }
    usize::try_from(meta.bytesused).ok().and_then(|used| bytes.get(..used)).ok_or(FrameFault::Incomplete)
}

/// Returns the driver's timestamp if it uses the monotonic clock. One in the future is clamped to `now_us`.
pub(super) fn captured_us(meta: &Metadata, now_us: u64) -> Option<u64> {
    let [seconds, micros] = [meta.timestamp.sec, meta.timestamp.usec].map(|part| u64::try_from(part).unwrap_or(0));
    let is_monotonic = meta.flags & Flags::TIMESTAMP_MASK == Flags::TIMESTAMP_MONOTONIC;
    is_monotonic.then(|| seconds.saturating_mul(1_000_000).saturating_add(micros).min(now_us))
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use v4l::timestamp::Timestamp;

    use super::*;

    #[test]
    fn only_the_filled_part_of_a_buffer_is_used_with_a_time_of_the_monotonic_clock_that_is_not_in_the_future() {
        let meta =
            |flags, bytesused| Metadata { bytesused, flags, timestamp: Timestamp::new(2, 500), ..Metadata::default() };
        let shown = |flags, bytesused| filled(&[7; 100], &meta(flags, bytesused)).map(<[u8]>::len);
        assert_eq!(shown(Flags::empty(), 60), Ok(60));
        assert_eq!(shown(Flags::empty(), 101), Err(FrameFault::Incomplete));
        assert_eq!(shown(Flags::empty(), 0), Err(FrameFault::Empty));
        assert_eq!(shown(Flags::ERROR, 60), Err(FrameFault::Marked));
        let times_us = |flags| [3_000_000, 1_000_000].map(|now_us| captured_us(&meta(flags, 0), now_us));
        assert_eq!(times_us(Flags::TIMESTAMP_MONOTONIC), [Some(2_000_500), Some(1_000_000)]);
        assert_eq!([Flags::TIMESTAMP_COPY, Flags::TIMESTAMP_UNKNOWN].map(times_us), [[None; 2]; 2]);
    }

    /// A stream whose attempts to stop end as listed, and which panics in `Drop` as that of the v4l crate does.
    struct Stoppable<'a> {
        errors: std::slice::Iter<'a, Option<Errno>>,
        dropped: &'a Cell<bool>,
    }

    impl Stream for Stoppable<'_> {
        type Item = [u8];

        fn start(&mut self) -> io::Result<()> {
            Ok(())
        }

        fn stop(&mut self) -> io::Result<()> {
            self.errors.next().copied().flatten().map_or(Ok(()), |error| Err(error.into()))
        }
    }

    impl Drop for Stoppable<'_> {
        fn drop(&mut self) {
            self.dropped.set(true);
            if let Err(error) = self.stop() {
                panic!("{error}");
            }
        }
    }

    #[test]
    fn a_stream_is_dropped_after_it_has_stopped_and_otherwise_is_an_error_with_its_remedy() {
        const INTERRUPTED: Option<Errno> = Some(Errno::INTR);
        for (errors, stops, what) in [
            (vec![], true, "stops at once"),
            (vec![INTERRUPTED; 2], true, "a signal interrupts it"),
            (vec![Some(Errno::NODEV)], true, "unplugged"),
            (vec![None, Some(Errno::IO)], true, "the second attempt is that of its drop"),
            (vec![Some(Errno::IO)], false, "its drop would panic"),
            (vec![INTERRUPTED; 10], false, "signals without end"),
        ] {
            let dropped = Cell::new(false);
            let stream = Stoppable { errors: errors.iter(), dropped: &dropped };
            let sentence = release(Box::new(stream), Path::new("/dev/video7")).map_err(|error| error.to_string());
            assert_eq!((sentence.is_ok(), dropped.get()), (stops, stops), "{what}");
            let remedy =
                |text: String| text.contains("/dev/video7 cannot be stopped") && text.contains("start this program");
            assert!(sentence.err().is_none_or(remedy), "{what}");
        }
    }
}
