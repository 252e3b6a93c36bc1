//! Errors of sources. Each is one sentence for the operator: what is wrong, then what to do.

use std::io;
use std::path::Path;

use rustix::io::Errno;
use thiserror::Error;

use crate::config::Script;
use crate::recording::RecordingError;

/// Why a source cannot be opened, or delivers no frame.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// One frame cannot be read. The source continues with the next one.
    #[error("frame {number} was left out: {fault}")]
    Frame {
        /// Position in the source.
        number: u64,
        /// What is wrong with the frame.
        fault: FrameFault,
    },
    /// The file could not be opened.
    #[error("cannot open {path}: {source}; give the path of a .y4m, Motion-JPEG .avi or .npy file, `-` or `demo`")]
    Open {
        /// The path as given.
        path: String,
        /// The error of the system.
        source: io::Error,
    },
    /// The file is neither AVI nor y4m.
    #[error("{path} is neither an AVI nor a y4m file; convert it with `ffmpeg -i {path} -c:v mjpeg -q:v 3 out.avi`")]
    UnknownContainer {
        /// The path as given.
        path: String,
    },
    /// The AVI file has no video that can be read.
    #[error("the AVI file {0}; convert it with `ffmpeg -i FILE -c:v mjpeg -q:v 3 out.avi`")]
    Avi(&'static str),
    /// The y4m stream has an unsupported header.
    #[error("the y4m stream {0}; make one with `ffmpeg -i FILE -pix_fmt yuv420p out.y4m`")]
    Y4m(&'static str),
    /// The `.npy` file does not hold landmarks.
    #[error("{path} {reason}; it must hold frames x 478 x 3 floating-point numbers in C order")]
    Points {
        /// The path as given.
        path: String,
        /// What is wrong with the file.
        reason: String,
    },
    /// The `.npy` file ends within a frame.
    #[error("the .npy file is cut short in frame {frame}; the frames before it were used, write it again for the rest")]
    PointsCutShort {
        /// Number of the incomplete frame, from 0.
        frame: u64,
    },
    /// A recording cannot be read, or not to its end.
    #[error("{path}: {error}")]
    Recording {
        /// The path as given.
        path: String,
        /// What is wrong with it.
        error: RecordingError,
    },
    /// The picture is larger or smaller than supported.
    #[error("the picture is {width}x{height}, but each side must be 1 to 4096 pixels; scale it first")]
    PictureSize {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The file ends within a frame.
    #[error(
        "the file is cut short at byte {offset}, in frame {frame}; the frames before it were used, copy or record it again for the rest"
    )]
    CutShort {
        /// Number of the incomplete frame, from 0.
        frame: u64,
        /// Length of the file in bytes.
        offset: u64,
    },
    /// There is something else where a frame should begin.
    #[error("the stream is damaged at byte {offset}, before frame {frame}; copy or record it again")]
    Damaged {
        /// Number of the frame that should begin, from 0.
        frame: u64,
        /// Byte at which it should begin.
        offset: u64,
    },
    /// A file, or standard input, cannot be read.
    #[error("reading failed: {0}; check the disk or the pipe")]
    Read(#[from] io::Error),
    /// This machine has no camera.
    #[error("there is no camera; plug one in, or set camera.device = \"demo\" to play the built-in clip")]
    NoCamera,
    /// No camera has this name or path.
    #[error("no camera is called {wanted}; {hint}")]
    NotFound {
        /// The setting.
        wanted: String,
        /// The cameras of this machine, or how to list them.
        hint: String,
    },
    /// The script of a rehearsal cannot be read.
    #[error("{wanted} is no rehearsal; give {expected}", expected = Script::EXPECTED)]
    Script {
        /// The setting.
        wanted: String,
    },
    /// The path leads to a file or to a device of another kind.
    #[error("{path} is not a camera that captures pictures; `facewire devices` lists those that do")]
    NotACamera {
        /// The setting.
        path: String,
    },
    /// The user has no permission to open the camera.
    #[error("no permission to open {path}; add the user to the group `video`")]
    PermissionDenied {
        /// The setting.
        path: String,
    },
    /// Another program uses the camera.
    #[error("{path} is in use by another program; stop that program (`fuser -v {path}` names it)")]
    Busy {
        /// The setting.
        path: String,
    },
    /// The USB bus cannot carry the pictures of this camera beside what it carries already.
    #[error(
        "{path} cannot start, because its USB bus has no bandwidth left; give it a port of its own instead of a hub shared \
         with other cameras or sound, set camera.format = \"mjpeg\", or choose a smaller picture"
    )]
    Bandwidth {
        /// Path of the device node.
        path: String,
    },
    /// The camera does not offer the wanted format.
    #[error(
        "{path} does not offer {wanted}; set camera.format to a format it offers ({offered}), or use another camera"
    )]
    ModeLacking {
        /// Path of the device node.
        path: String,
        /// Names of the wanted formats.
        wanted: &'static str,
        /// Names of the offered formats.
        offered: String,
    },
    /// The driver set a format or size that is not supported.
    #[error("{path} answered with {got}, which cannot be read; set another camera.format or size")]
    ModeRefused {
        /// Path of the device node.
        path: String,
        /// The format and size that the driver set.
        got: String,
    },
    /// The camera was unplugged, or its driver was removed.
    #[error("the camera is gone; plug it in again")]
    Gone,
    /// The camera cannot be stopped, so it stays open until the process ends.
    #[error(
        "{path} cannot be stopped: {source}; start this program again, and if that does not help, unplug the camera"
    )]
    NotStopped {
        /// Path of the device node.
        path: String,
        /// The error of the system.
        source: io::Error,
    },
    /// The camera delivered no frame in time.
    #[error("the camera sent nothing for {waited_ms} ms; check its cable and USB bandwidth")]
    Stalled {
        /// Time that the program waited.
        waited_ms: u64,
    },
    /// Too many frames in a row could not be read.
    #[error("{count} frames in a row were bad (the last: {fault}); check the camera's cable and USB bandwidth")]
    AllDamaged {
        /// Number of these frames.
        count: u32,
        /// What is wrong with the last of them.
        fault: FrameFault,
    },
    /// The driver reported another error.
    #[error("the camera failed while {during}: {source}; if this happens again, unplug it and plug it in again")]
    Device {
        /// What the program was doing.
        during: &'static str,
        /// The error of the system.
        source: io::Error,
    },
    /// The driver returned a value that the kernel's interface does not define.
    #[error("the driver of {path} returned a value that the kernel does not define ({reason}); use another camera")]
    Driver {
        /// Path of the device node.
        path: String,
        /// What is wrong with the value.
        reason: String,
    },
    /// libjpeg-turbo cannot start.
    #[error("the JPEG decoder could not start; free some memory")]
    Decoder,
}

impl CaptureError {
    /// Converts the system's error about the device at `path`.
    pub(super) fn device(path: &Path, during: &'static str, source: io::Error) -> Self {
        let path = path.display().to_string();
        match source.kind() {
            io::ErrorKind::NotFound => {
                Self::NotFound { wanted: path, hint: "`facewire devices` lists those there are".to_owned() }
            }
            io::ErrorKind::PermissionDenied => Self::PermissionDenied { path },
            io::ErrorKind::ResourceBusy => Self::Busy { path },
            // The kernel's USB drivers refuse to reserve time on the bus with ENOSPC.
            io::ErrorKind::StorageFull => Self::Bandwidth { path },
            _ if Self::is_not_v4l2(&source) => Self::NotACamera { path },
            _ if Self::is_gone(&source) => Self::Gone,
            _ => Self::Device { during, source },
        }
    }

    /// Converts the system's error about a camera that delivers frames.
    pub(super) fn stream(source: io::Error) -> Self {
        if Self::is_gone(&source) { Self::Gone } else { Self::Device { during: "sending frames", source } }
    }

    /// Returns whether the error says that the device was removed.
    pub(super) fn is_gone(error: &io::Error) -> bool {
        [Errno::NODEV, Errno::NXIO].map(Errno::raw_os_error).map(Some).contains(&error.raw_os_error())
    }

    fn is_not_v4l2(error: &io::Error) -> bool {
        error.raw_os_error() == Some(Errno::NOTTY.raw_os_error())
    }
}

/// What is wrong with one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FrameFault {
    /// The data has no JPEG start marker.
    #[error("it is not a JPEG image")]
    NotJpeg,
    /// The data ends before the picture is complete.
    #[error("it is incomplete")]
    Incomplete,
    /// The driver marked the buffer as damaged.
    #[error("the driver marked it as damaged")]
    Marked,
    /// The data is longer than a picture of the announced size can be.
    #[error("it is larger than a picture of the announced size can be")]
    TooLarge,
    /// The JPEG image has another size than announced.
    #[error("it is {width}x{height}, not the announced size")]
    WrongSize {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The image is neither YCbCr nor grey, or has an unusual chroma subsampling.
    #[error("its colour layout is not supported")]
    Layout,
    /// The JPEG data is corrupt, or has more scans than that of a camera.
    #[error("its JPEG data is corrupt")]
    Corrupt,
}
