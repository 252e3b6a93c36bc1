//! What can go wrong between a camera or file and a frame. Each variant is one sentence for the operator.

use std::io;
use std::path::Path;

use rustix::io::Errno;
use thiserror::Error;

use crate::config::Script;

/// Why a source gave no frame.
#[derive(Debug, Error)]
pub enum CaptureError {
    /// One frame is bad; the source goes on.
    #[error("frame {number} was left out: {fault}")]
    Frame {
        /// Its position in the source.
        number: u64,
        /// What is wrong with it.
        fault: FrameFault,
    },
    /// The file could not be opened.
    #[error("cannot open {path}: {source}; give the path of a .y4m, Motion-JPEG .avi or .npy file, `-` or `demo`")]
    Open {
        /// As given.
        path: String,
        /// The system's reason.
        source: io::Error,
    },
    /// Neither AVI nor y4m.
    #[error("{path} is neither an AVI nor a y4m file; convert it with `ffmpeg -i {path} -c:v mjpeg -q:v 3 out.avi`")]
    UnknownContainer {
        /// As given.
        path: String,
    },
    /// An AVI file whose picture cannot be read.
    #[error("the AVI file {0}; convert it with `ffmpeg -i FILE -c:v mjpeg -q:v 3 out.avi`")]
    Avi(&'static str),
    /// A y4m stream whose header cannot be used.
    #[error("the y4m stream {0}; make one with `ffmpeg -i FILE -pix_fmt yuv420p out.y4m`")]
    Y4m(&'static str),
    /// A `.npy` file without landmarks.
    #[error("{path} {reason}; it must hold frames x 478 x 3 floating-point numbers in C order")]
    Points {
        /// As given.
        path: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A `.npy` file that ends too soon.
    #[error("the .npy file is cut short in frame {frame}; the frames before it were used, write it again for the rest")]
    PointsCutShort {
        /// The frame that is incomplete, from 0.
        frame: u64,
    },
    /// Larger or smaller than this program takes.
    #[error("the picture is {width}x{height}, but each side must be 1 to 4096 pixels; scale it first")]
    PictureSize {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A file that ends too soon.
    #[error(
        "the file is cut short at byte {offset}, in frame {frame}; the frames before it were used, copy or record it again for the rest"
    )]
    CutShort {
        /// The frame that is incomplete, from 0.
        frame: u64,
        /// Where the file ends.
        offset: u64,
    },
    /// Bytes where a frame should begin are something else.
    #[error("the stream is damaged at byte {offset}, before frame {frame}; copy or record it again")]
    Damaged {
        /// The frame that should begin, from 0.
        frame: u64,
        /// Where it should.
        offset: u64,
    },
    /// Reading failed.
    #[error("reading failed: {0}; check the disk or the pipe")]
    Read(#[from] io::Error),
    /// No camera at all.
    #[error("there is no camera; plug one in, or set camera.device = \"demo\" to play the built-in clip")]
    NoCamera,
    /// No camera of that name or path.
    #[error("no camera is called {wanted}; {hint}")]
    NotFound {
        /// As set.
        wanted: String,
        /// Those that are there, or how to list them.
        hint: String,
    },
    /// A rehearsal that cannot be read.
    #[error("{wanted} is no rehearsal; give {expected}", expected = Script::EXPECTED)]
    Script {
        /// As set.
        wanted: String,
    },
    /// A file or device of another kind.
    #[error("{path} is not a camera that captures pictures; `facewire devices` lists those that do")]
    NotACamera {
        /// As set.
        path: String,
    },
    /// The user may not open it.
    #[error("no permission to open {path}; add the user to the group `video`")]
    PermissionDenied {
        /// As set.
        path: String,
    },
    /// Another program has it.
    #[error("{path} is in use by another program; stop that one (`fuser -v {path}` names it)")]
    Busy {
        /// As set.
        path: String,
    },
    /// The camera has no such format.
    #[error("{path} does not offer {wanted}; set camera.format to one it has ({offered}), or take another camera")]
    ModeLacking {
        /// Its node.
        path: String,
        /// Names of formats.
        wanted: &'static str,
        /// Names of the formats it has.
        offered: String,
    },
    /// The driver set something else than it offered.
    #[error("{path} answered with {got}, which cannot be read; set another camera.format or size")]
    ModeRefused {
        /// Its node.
        path: String,
        /// Format and size.
        got: String,
    },
    /// Unplugged, or its driver was removed.
    #[error("the camera is gone; plug it in again")]
    Gone,
    /// The camera cannot be stopped, so it stays open until the process ends.
    #[error(
        "{path} cannot be stopped: {source}; start this program again, and if that does not help, unplug the camera"
    )]
    NotStopped {
        /// Its node.
        path: String,
        /// The system's reason.
        source: io::Error,
    },
    /// No frame came in time.
    #[error("the camera sent nothing for {waited_ms} ms; check its cable and USB bandwidth")]
    Stalled {
        /// How long was waited.
        waited_ms: u64,
    },
    /// Frame after frame was bad.
    #[error("{count} frames in a row were bad (the last: {fault}); check the camera's cable and USB bandwidth")]
    AllDamaged {
        /// How many.
        count: u32,
        /// Of the last.
        fault: FrameFault,
    },
    /// The driver failed in another way.
    #[error("the camera failed while {during}: {source}; if that goes on, unplug it and plug it in again")]
    Device {
        /// What was being done.
        during: &'static str,
        /// The system's reason.
        source: io::Error,
    },
    /// The driver answered with what is not understood.
    #[error("the driver of {path} answered with what the kernel does not define ({reason}); take another camera")]
    Driver {
        /// Its node.
        path: String,
        /// What is wrong with it.
        reason: String,
    },
    /// libjpeg-turbo could not start.
    #[error("the JPEG decoder could not start; free some memory")]
    Decoder,
}

impl CaptureError {
    /// What the system's error means for the device at `path`.
    pub(super) fn device(path: &Path, during: &'static str, source: io::Error) -> Self {
        let path = path.display().to_string();
        match source.kind() {
            io::ErrorKind::NotFound => {
                Self::NotFound { wanted: path, hint: "`facewire devices` lists those there are".to_owned() }
            }
            io::ErrorKind::PermissionDenied => Self::PermissionDenied { path },
            io::ErrorKind::ResourceBusy => Self::Busy { path },
            _ if Self::is_not_v4l2(&source) => Self::NotACamera { path },
            _ if Self::is_gone(&source) => Self::Gone,
            _ => Self::Device { during, source },
        }
    }

    /// What the system's error means while frames flow.
    pub(super) fn stream(source: io::Error) -> Self {
        if Self::is_gone(&source) { Self::Gone } else { Self::Device { during: "sending frames", source } }
    }

    /// Whether the device was removed.
    pub(super) fn is_gone(error: &io::Error) -> bool {
        [Errno::NODEV, Errno::NXIO].map(Errno::raw_os_error).map(Some).contains(&error.raw_os_error())
    }

    fn is_not_v4l2(error: &io::Error) -> bool {
        error.raw_os_error() == Some(Errno::NOTTY.raw_os_error())
    }
}

/// What is wrong with one frame. Small and `Copy`, so that counting faults costs nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FrameFault {
    /// No JPEG start marker.
    #[error("it is not a JPEG image")]
    NotJpeg,
    /// No JPEG end marker, or fewer bytes than the format needs.
    #[error("it is incomplete")]
    Incomplete,
    /// The driver marked the buffer as damaged.
    #[error("the driver marked it as damaged")]
    Marked,
    /// Bytes that no picture of the announced size can have.
    #[error("it is larger than a picture of the announced size can be")]
    TooLarge,
    /// A JPEG of another size than announced.
    #[error("it is {width}x{height}, not the announced size")]
    WrongSize {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Not YCbCr or grey, or with unusual chroma subsampling.
    #[error("its colour layout is not supported")]
    Layout,
    /// The JPEG data is corrupt, or has more scans than a camera makes.
    #[error("its JPEG data is corrupt")]
    Corrupt,
}
