//! Errors of sources. Each is one sentence for the operator: what is wrong, then what to do.

use std::fmt::Display;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::Duration;

use rustix::io::Errno;
use thiserror::Error;

/// Why a source cannot be opened, or delivers no frame. There is a variant for each way to react.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// One frame cannot be read. The source continues with the next one.
    #[error("frame {number} was left out: {fault}")]
    Frame { number: u64, fault: FrameFault },
    /// The camera sends pictures that cannot be read. Opening it again cures some cameras.
    #[error("{count} frames in a row were bad (the last: {fault}); {}", fault.remedy())]
    AllDamaged { count: u32, fault: FrameFault },
    /// The camera was unplugged, or its driver was removed.
    #[error("the camera is gone; plug it in again")]
    Gone,
    /// There is no such camera, or the path leads to something else. A search passes over it.
    #[error("{0}")]
    Absent(String),
    /// The camera has no format that needs one plane of memory for a picture. A search names it if there is no other camera.
    #[error(
        "{path} ({card}) gives its pictures in several planes, which facewire does not read; use a USB camera, or pass its \
         pictures on to a v4l2loopback device as YUYV"
    )]
    MultiPlanar { path: String, card: String },
    /// The camera or the file is there, but cannot be used now. A search tells of it.
    #[error("{0}")]
    Unusable(String),
    /// The file holds something else than it should, or ends early.
    #[error("{0}")]
    BadFile(String),
    /// A file, or standard input, cannot be read.
    #[error("reading failed: {0}; check the disk or the pipe")]
    Read(#[from] io::Error),
    /// The camera cannot be stopped, so it stays open until the process ends.
    #[error(
        "{path} cannot be stopped: {source}; start this program again, and if that does not help, unplug the camera"
    )]
    NotStopped { path: String, source: io::Error },
}

/// Time after which a node has the group that the system's rules give it.
const SETTLING: Duration = Duration::from_secs(5);

/// What is done with a device that may be no camera.
pub(super) const IDENTIFYING: &str = "asking what it is";

impl CaptureError {
    /// Converts the system's error about the device at `path`.
    pub(super) fn device(path: &Path, during: &'static str, source: io::Error) -> Self {
        let is_new = has_just_appeared(path);
        let path = path.display();
        Self::Unusable(match source.kind() {
            ErrorKind::NotFound => {
                return Self::Absent(format!("no camera is called {path}; `facewire devices` lists those there are"));
            }
            // The system creates a node first, and gives it its group a moment later.
            ErrorKind::PermissionDenied if is_new => {
                format!("{path} has just appeared, and has no permissions yet; wait some seconds")
            }
            ErrorKind::PermissionDenied => format!("no permission to open {path}; add the user to the group `video`"),
            ErrorKind::ResourceBusy => {
                format!("{path} is in use by another program; stop that program (`fuser -v {path}` names it)")
            }
            // The kernel's USB drivers refuse to reserve time on the bus with ENOSPC.
            ErrorKind::StorageFull => format!(
                "{path} cannot start, because its USB bus has no bandwidth left; give it a port of its own instead of a \
                 hub shared with other cameras or sound, set camera.format = \"mjpeg\", or choose a smaller picture"
            ),
            ErrorKind::InvalidData => return Self::undefined(&path, during),
            _ if during == IDENTIFYING && source.raw_os_error() == Some(Errno::NOTTY.raw_os_error()) => {
                return Self::not_a_camera(&path);
            }
            _ => return Self::driver_failed(during, &source),
        })
    }

    /// Converts the system's error about an open camera.
    pub(super) fn driver_failed(during: &str, source: &io::Error) -> Self {
        if [Errno::NODEV, Errno::NXIO].map(|gone| Some(gone.raw_os_error())).contains(&source.raw_os_error()) {
            return Self::Gone;
        }
        // Drivers of a camera connector refuse to start with these while nothing is connected to their nodes.
        let lacks_pipeline = [Errno::PIPE, Errno::NOLINK].map(|errno| Some(errno.raw_os_error()));
        let remedy = if lacks_pipeline.contains(&source.raw_os_error()) {
            "its pipeline is not set up: set it up by `media-ctl`, or use another camera"
        } else {
            "if this happens again, unplug it and plug it in again"
        };
        Self::Unusable(format!("the camera failed while {during}: {source}; {remedy}"))
    }

    /// The error of a driver that returns a value that nobody expects.
    pub(super) fn undefined(path: &impl Display, reason: &str) -> Self {
        let fault = format!("returned a value that the kernel does not define ({reason})");
        Self::Unusable(format!("the driver of {path} {fault}; use another camera"))
    }

    pub(super) fn not_a_camera(path: &impl Display) -> Self {
        Self::Absent(format!("{path} is not a camera that captures pictures; `facewire devices` lists those that do"))
    }

    pub(super) fn stalled(waited: Duration) -> Self {
        let waited_ms = waited.as_millis();
        Self::Unusable(format!("the camera sent nothing for {waited_ms} ms; check its cable and USB bandwidth"))
    }

    pub fn unopened(path: &str, source: &io::Error) -> Self {
        let remedy = "give the path of a .y4m, Motion-JPEG .avi or .npy file, or `demo`";
        Self::Unusable(format!("cannot open {path}: {source}; {remedy}"))
    }

    pub fn picture_size(width: usize, height: usize) -> Self {
        let remedy = "each side must be 1 to 4096 pixels; scale it first";
        Self::BadFile(format!("the picture is {width}x{height}, but {remedy}"))
    }

    /// The error of reading a film whose first `offset` bytes were read: it is cut short in this frame, or the disk failed.
    pub fn cut_short(error: io::Error, frame: u64, offset: u64) -> Self {
        if error.kind() != ErrorKind::UnexpectedEof {
            return Self::Read(error);
        }
        let remedy = "the frames before it were used, copy or record it again for the rest";
        Self::BadFile(format!("the file is cut short at byte {offset}, in frame {frame}; {remedy}"))
    }
}

/// Whether the system has created a node a few seconds ago.
fn has_just_appeared(path: &Path) -> bool {
    let created = fs::metadata(path).and_then(|node| node.modified());
    created.is_ok_and(|created| created.elapsed().is_ok_and(|age| age < SETTLING))
}

/// What is wrong with one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FrameFault {
    #[error("it is not a JPEG image")]
    NotJpeg,
    #[error("it is incomplete")]
    Incomplete,
    #[error("it is empty")]
    Empty,
    #[error("the driver marked it as damaged")]
    Marked,
    #[error("it is larger than a picture of the announced size can be")]
    TooLarge,
    #[error("it is {width}x{height}, not the announced size")]
    WrongSize { width: usize, height: usize },
    /// The image is sound, but of another kind than cameras make.
    #[error("it is {0}, which is not supported")]
    Unsupported(&'static str),
    /// The JPEG data is corrupt, or has more scans than that of a camera.
    #[error("its JPEG data is corrupt")]
    Corrupt,
    /// The noise of a sensor makes two pictures differ.
    #[error("it shows the same picture as for a second before, byte for byte")]
    Repeated,
}

impl FrameFault {
    /// What to do about a camera with only such frames.
    const fn remedy(self) -> &'static str {
        match self {
            Self::NotJpeg | Self::Incomplete | Self::Marked | Self::Corrupt => {
                "check the camera's cable and USB bandwidth"
            }
            Self::Empty => {
                "its driver delivers empty buffers: set another camera.format or size, or check the program that feeds it"
            }
            Self::Repeated => {
                "open its shutter, switch on a light and what is connected to it, or unplug the camera and plug it in again"
            }
            Self::TooLarge | Self::WrongSize { .. } | Self::Unsupported(_) => "set another camera.format or size",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_camera_that_refuses_a_call_is_a_camera_nevertheless() {
        let sentence = |during| CaptureError::device(Path::new("/dev/video7"), during, Errno::NOTTY.into()).to_string();
        assert!(sentence(IDENTIFYING).starts_with("/dev/video7 is not a camera"));
        let refused = sentence("starting it");
        assert!(refused.starts_with("the camera failed while starting it: "), "{refused}");
    }

    #[test]
    fn a_camera_connector_without_a_pipeline_is_no_camera_to_unplug() {
        let sentence = CaptureError::device(Path::new("/dev/video7"), "starting it", Errno::PIPE.into()).to_string();
        assert!(sentence.contains("its pipeline is not set up") && !sentence.contains("unplug"), "{sentence}");
    }

    #[test]
    fn a_bus_without_bandwidth_is_told_with_its_remedy() {
        let sentence = CaptureError::device(Path::new("/dev/video7"), "starting it", Errno::NOSPC.into()).to_string();
        assert!(sentence.contains("/dev/video7") && sentence.contains("camera.format = \"mjpeg\""), "{sentence}");
    }
}
