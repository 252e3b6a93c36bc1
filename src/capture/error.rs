//! What can go wrong between a camera or file and a frame. Each variant is one sentence for the operator.

use std::io;

use thiserror::Error;

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
    #[error(
        "cannot open {path}: {source}; give the path of a .y4m or Motion-JPEG .avi file, `-` or `demo`"
    )]
    Open {
        /// As given.
        path: String,
        /// The system's reason.
        source: io::Error,
    },
    /// Neither AVI nor y4m.
    #[error(
        "{path} is neither an AVI nor a y4m file; convert it with `ffmpeg -i {path} -c:v mjpeg -q:v 3 out.avi`"
    )]
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
    /// Larger or smaller than this program takes.
    #[error(
        "the picture is {width}x{height}, but each side must be 1 to 4096 pixels; scale it first"
    )]
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
    #[error(
        "the stream is damaged at byte {offset}, before frame {frame}; copy or record it again"
    )]
    Damaged {
        /// The frame that should begin, from 0.
        frame: u64,
        /// Where it should.
        offset: u64,
    },
    /// Reading failed.
    #[error("reading failed: {0}; check the disk or the pipe")]
    Read(#[from] io::Error),
    /// libjpeg-turbo could not start.
    #[error("the JPEG decoder could not start; free some memory")]
    Decoder,
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
