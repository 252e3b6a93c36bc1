//! Cameras that only have the kernel's interface for pictures in several planes of memory, as most of those at a camera
//! connector or an HDMI input have. They are read in the formats that need one plane for a whole picture.
//!
//! Contract: [`Planes`] behaves like the mapped buffers of the crate v4l, which knows the other interface alone. It has the
//! same traits, calls the driver in the same order, and fails with the same errors.
//!
//! Limits: the interval that the driver sets is not known, because reading it would need `unsafe`.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, AsRawFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rustix::fs::OFlags;
use v4l::buffer::Metadata;
use v4l::format::{Colorspace, FieldOrder, Quantization};
use v4l::io::traits::{CaptureStream, Stream};
use v4l::timestamp::Timestamp;
use v4l::{Format, FourCC, Fraction};
use v4l2r::bindings::{
    v4l2_captureparm, v4l2_format, v4l2_format__bindgen_ty_1, v4l2_fract, v4l2_pix_format_mplane, v4l2_streamparm,
    v4l2_streamparm__bindgen_ty_1,
};
use v4l2r::ioctl::{
    self, GFmtError, IntoErrno, PlaneMapping, QueryBuffer, SFmtError, UncheckedV4l2Buffer, V4l2MplaneFormat,
};
use v4l2r::memory::MemoryType;
use v4l2r::nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use v4l2r::{PixelFormat, QueueType};

const QUEUE: QueueType = QueueType::VideoCaptureMplane;

pub(super) struct Device {
    file: Arc<File>,
}

impl Device {
    pub(super) fn open(node: &Path) -> io::Result<Self> {
        let non_blocking = OFlags::NONBLOCK.bits().cast_signed();
        let file = File::options().read(true).write(true).custom_flags(non_blocking).open(node)?;
        Ok(Self { file: Arc::new(file) })
    }

    pub(super) fn file(&self) -> Arc<File> {
        Arc::clone(&self.file)
    }

    /// Asks the driver for a format, and returns the one that it has set, unless its pictures need several planes.
    pub(super) fn set_format(&self, wanted: &Format) -> io::Result<Option<Format>> {
        let pix_mp = v4l2_pix_format_mplane {
            width: wanted.width,
            height: wanted.height,
            pixelformat: wanted.fourcc.into(),
            field: wanted.field_order as u32,
            num_planes: 1,
            ..v4l2_pix_format_mplane::default()
        };
        let wanted = v4l2_format { type_: QUEUE as u32, fmt: v4l2_format__bindgen_ty_1 { pix_mp } };
        let set: V4l2MplaneFormat = ioctl::s_fmt(&mut self.file.as_raw_fd(), wanted).map_err(|error| match error {
            SFmtError::FromV4L2FormatConversionError => undefined(),
            error => failed(error),
        })?;
        let needs_planes = set.planes().len() > 1;
        if needs_planes { Ok(None) } else { converted(&set).map(Some) }
    }

    pub(super) fn set_interval(&self, interval: Fraction) -> io::Result<()> {
        let timeperframe = v4l2_fract { numerator: interval.numerator, denominator: interval.denominator };
        let capture = v4l2_captureparm { timeperframe, ..v4l2_captureparm::default() };
        let wanted = v4l2_streamparm { type_: QUEUE as u32, parm: v4l2_streamparm__bindgen_ty_1 { capture } };
        ioctl::s_parm::<_, v4l2_streamparm>(&self.file, wanted).map(|_| ()).map_err(failed)
    }
}

/// The codes of the pixel formats that a driver lists.
pub(super) fn formats(device: &impl AsRawFd) -> Vec<FourCC> {
    let format = |index| ioctl::enum_fmt::<PixelFormat>(device, QUEUE, index).ok();
    (0..).map_while(format).map(|format| FourCC::new(&format.to_fourcc())).collect()
}

/// Returns the format that is set, with the first plane of its pictures.
pub(super) fn format(device: &impl AsRawFd) -> io::Result<Format> {
    let set = ioctl::g_fmt(device, QUEUE).map_err(|error| match error {
        GFmtError::FromV4L2FormatConversionError => undefined(),
        error => failed(error),
    })?;
    converted(&set)
}

fn converted(set: &V4l2MplaneFormat) -> io::Result<Format> {
    let plane = set.planes().first().ok_or_else(undefined)?;
    let [stride, size] = [plane.bytesperline, plane.sizeimage];
    let (width, height) = set.size();
    let field_order = FieldOrder::try_from(set.field() as u32).map_err(|()| undefined())?;
    let colorspace = Colorspace::try_from(set.colorspace() as u32).map_err(|()| undefined())?;
    let quantization = Quantization::try_from(set.quantization() as u32).map_err(|()| undefined())?;
    let fourcc = FourCC::new(&set.pixelformat().to_fourcc());
    Ok(Format { field_order, stride, size, colorspace, quantization, ..Format::new(width, height, fourcc) })
}

/// The mapped buffers of a camera, each of which has one plane.
pub(super) struct Planes {
    file: Arc<File>,
    mapped: Vec<PlaneMapping>,
    /// The buffer that is lent to the reader, and the bytes in front of its picture.
    lent: usize,
    offset: usize,
    meta: Metadata,
    timeout_ms: i32,
    is_active: bool,
}

impl Planes {
    pub(super) fn with_buffers(device: &Device, count: u32, timeout: Duration) -> io::Result<Self> {
        let file = device.file();
        let granted: usize = ioctl::reqbufs(&file, QUEUE, MemoryType::Mmap, count).map_err(failed)?;
        let timeout_ms = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        let meta = Metadata::default();
        let mut buffers =
            Self { file, mapped: Vec::with_capacity(granted), lent: 0, offset: 0, meta, timeout_ms, is_active: false };
        for index in 0..granted {
            let asked: QueryBuffer = ioctl::querybuf(&buffers.file, QUEUE, index).map_err(failed)?;
            let plane = asked.planes.first().ok_or_else(undefined)?;
            buffers.mapped.push(ioctl::mmap(&buffers.file, plane.mem_offset, plane.length).map_err(failed)?);
        }
        Ok(buffers)
    }
}

impl Stream for Planes {
    type Item = [u8];

    fn start(&mut self) -> io::Result<()> {
        ioctl::streamon(&self.file, QUEUE).map_err(failed)?;
        self.is_active = true;
        Ok(())
    }

    fn stop(&mut self) -> io::Result<()> {
        ioctl::streamoff(&self.file, QUEUE).map_err(failed)?;
        self.is_active = false;
        Ok(())
    }
}

impl<'a> CaptureStream<'a> for Planes {
    fn queue(&mut self, index: usize) -> io::Result<()> {
        let mut buffer = UncheckedV4l2Buffer::new_for_querybuf(QUEUE, u32::try_from(index).ok());
        buffer.0.memory = MemoryType::Mmap as u32;
        buffer.0.length = 1;
        ioctl::qbuf::<_, ()>(&self.file, buffer).map_err(failed)
    }

    fn dequeue(&mut self) -> io::Result<usize> {
        if poll_readable(&self.file, self.timeout_ms)? == 0 {
            return Err(io::ErrorKind::TimedOut.into());
        }
        let UncheckedV4l2Buffer(buffer, planes) = ioctl::dqbuf(&self.file, QUEUE).map_err(failed)?;
        let [plane, ..] = planes.unwrap_or_default();
        self.offset = plane.data_offset as usize;
        self.meta = Metadata {
            bytesused: plane.bytesused.saturating_sub(plane.data_offset),
            flags: buffer.flags.into(),
            field: buffer.field,
            timestamp: Timestamp::new(buffer.timestamp.tv_sec, buffer.timestamp.tv_usec),
            sequence: buffer.sequence,
        };
        Ok(buffer.index as usize)
    }

    fn next(&'a mut self) -> io::Result<(&'a [u8], &'a Metadata)> {
        if self.is_active {
            self.queue(self.lent)?;
        } else {
            (0..self.mapped.len()).try_for_each(|index| self.queue(index))?;
            self.start()?;
        }
        self.lent = self.dequeue()?;
        let picture = self.mapped.get(self.lent).and_then(|plane| plane.get(self.offset..));
        Ok((picture.unwrap_or_default(), &self.meta))
    }
}

impl Drop for Planes {
    fn drop(&mut self) {
        // Even if the driver refuses, the descriptor is closed, which frees the camera.
        let _ = self.stop();
        self.mapped.clear();
        let _ = ioctl::reqbufs::<()>(&self.file, QUEUE, MemoryType::Mmap, 0);
    }
}

/// Waits until a buffer can be dequeued, for so long at most. Returns 0 if none can.
pub(super) fn poll_readable(file: &impl AsFd, timeout_ms: i32) -> io::Result<i32> {
    let timeout = PollTimeout::try_from(timeout_ms).unwrap_or(PollTimeout::MAX);
    Ok(poll(&mut [PollFd::new(file.as_fd(), PollFlags::POLLIN)], timeout)?)
}

fn failed(error: impl IntoErrno) -> io::Error {
    io::Error::from_raw_os_error(error.into_errno())
}

/// The error of a driver that returns a value that the kernel does not define.
fn undefined() -> io::Error {
    io::ErrorKind::InvalidData.into()
}
