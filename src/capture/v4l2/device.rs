//! An open camera, by the interface that its driver has: the kernel's older one, for which there is the crate v4l, or the one
//! for pictures in several planes of memory (`planes`).

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use v4l::buffer::Type;
use v4l::device::Handle;
use v4l::io::mmap::Stream as MappedStream;
use v4l::io::traits::CaptureStream;
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Format, FourCC, Fraction};

use super::planes::{self, Planes, poll_readable};

/// Flag of `poll` for a buffer that can be dequeued.
const READABLE: i16 = 1;

/// The buffers that a driver fills.
pub(super) type Buffers = Box<dyn for<'a> CaptureStream<'a, Item = [u8]> + Send>;

pub(super) enum Device {
    Single(v4l::Device),
    Multi(planes::Device),
}

/// What shows that a buffer is filled.
pub(super) enum Waker {
    Single(Arc<Handle>),
    Multi(Arc<File>),
}

impl Device {
    /// The camera that was opened to examine it. One with several planes is opened a second time, because its buffers must be
    /// mapped by a descriptor that the crate v4l does not lend.
    pub(super) fn new(examined: v4l::Device, node: &Path, is_multi_planar: bool) -> io::Result<Self> {
        if !is_multi_planar {
            return Ok(Self::Single(examined));
        }
        // Some drivers may be opened only once.
        drop(examined);
        planes::Device::open(node).map(Self::Multi)
    }

    /// Asks for a format, and returns the one that the driver has set, unless its pictures need several planes.
    pub(super) fn set_format(&self, wanted: &Format) -> io::Result<Option<Format>> {
        match self {
            Self::Single(device) => device.set_format(wanted).map(Some),
            Self::Multi(device) => device.set_format(wanted),
        }
    }

    /// Asks for an interval, and returns the one that the driver has set, if that is known.
    pub(super) fn set_interval(&self, interval: Fraction) -> Option<Fraction> {
        match self {
            Self::Single(device) => Some(device.set_params(&Parameters::new(interval)).ok()?.interval),
            Self::Multi(device) => device.set_interval(interval).map(|()| interval).ok(),
        }
    }

    /// Maps buffers. A frame must come within `timeout`.
    pub(super) fn map(&self, buffers: u32, timeout: Duration) -> io::Result<Buffers> {
        Ok(match self {
            Self::Single(device) => {
                let mut mapped = MappedStream::with_buffers(device, Type::VideoCapture, buffers)?;
                mapped.set_timeout(timeout);
                Box::new(mapped)
            }
            Self::Multi(device) => Box::new(Planes::with_buffers(device, buffers, timeout)?),
        })
    }

    pub(super) fn waker(&self) -> Waker {
        match self {
            Self::Single(device) => Waker::Single(device.handle()),
            Self::Multi(device) => Waker::Multi(device.file()),
        }
    }
}

/// The codes of the pixel formats that a driver lists.
pub(super) fn formats(device: &v4l::Device, is_multi_planar: bool) -> Vec<FourCC> {
    if is_multi_planar {
        return planes::formats(&device.handle().fd());
    }
    device.enum_formats().unwrap_or_default().into_iter().map(|format| format.fourcc).collect()
}

/// Returns the format that is set.
pub(super) fn format(device: &v4l::Device, is_multi_planar: bool) -> io::Result<Format> {
    if is_multi_planar { planes::format(&device.handle().fd()) } else { device.format() }
}

impl Waker {
    /// Waits until a buffer can be dequeued, for so long at most. Returns 0 if none can.
    pub(super) fn poll(&self, timeout_ms: i32) -> io::Result<i32> {
        match self {
            Self::Single(handle) => handle.poll(READABLE, timeout_ms),
            Self::Multi(file) => poll_readable(file, timeout_ms),
        }
    }
}
