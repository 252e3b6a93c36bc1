//! Checks the promises of every reader of films.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io::{self, ErrorKind, Read};

use facewire::capture::{CaptureError, Source};
use facewire_face::{Picture, Pixels};

/// Larger pictures are skipped rather than decoded, for the fuzzer's speed.
const MOST_PIXELS: usize = 1 << 16;

/// A reader that returns bytes in pieces, as a pipe does, and that every seventh read interrupts.
pub struct Pieces<'a> {
    data: &'a [u8],
    /// The most bytes that one read returns.
    most: usize,
    reads: usize,
}

impl<'a> Pieces<'a> {
    pub fn new(data: &'a [u8], most: usize) -> Self {
        Self { data, most, reads: 0 }
    }
}

impl Read for Pieces<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.reads += 1;
        if self.reads.is_multiple_of(7) {
            return Err(ErrorKind::Interrupted.into());
        }
        let bytes = self.most.min(buffer.len());
        self.data.read(&mut buffer[..bytes])
    }
}

/// Opens a film.
pub type Open = for<'a> fn(Pieces<'a>) -> Result<Box<dyn Source + 'a>, CaptureError>;

/// The frames of a film: number, time and a hash of the samples.
type Told = Vec<(u64, u64, u64)>;

/// Checks that a film ends after at most one frame for each `bytes_per_frame` bytes. It gives the same frames if it is read
/// in pieces, if other frames are skipped, and, up to the cut, if it is cut short.
pub fn film(data: &[u8], bytes_per_frame: usize, open: Open) {
    let most = data.len() / bytes_per_frame;
    let told = frames(Pieces::new(data, usize::MAX), open, most, &[false]);
    let salt = usize::from(data.last().copied().unwrap_or_default());
    assert_eq!(frames(Pieces::new(data, 1 + salt % 61), open, most, &[false]), told);
    let cut = frames(Pieces::new(&data[..data.len() * salt / 256], usize::MAX), open, most, &[false]);
    assert!(told.starts_with(&cut), "{told:?} does not start with {cut:?}");
    let some = frames(Pieces::new(data, usize::MAX), open, most, &[true, salt % 2 == 0, false]);
    assert!(some.iter().all(|frame| told.contains(frame)), "{told:?} does not contain all of {some:?}");
}

/// Reads to the end and skips frames by a pattern.
fn frames(data: Pieces<'_>, open: Open, most: usize, skips: &[bool]) -> Told {
    let mut told = Told::new();
    let mut source = match open(data) {
        Ok(source) => source,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return told;
        }
    };
    let of = source.describe();
    assert!(!of.to_string().is_empty());
    let is_large = of.width * of.height > MOST_PIXELS;
    for skip in skips.iter().cycle().take(most + 1) {
        match step(source.as_mut(), is_large || *skip) {
            Ok(Some(Some(frame))) => told.push(frame),
            Ok(Some(None)) | Err(CaptureError::Frame { .. }) => {}
            ended => {
                assert!(ended.is_ok_and(|frame| frame.is_none()) || matches!(source.next(), Ok(None)));
                assert!(matches!(source.next(), Ok(None)), "a film that has ended begins again");
                assert!(told.is_sorted_by(|a, b| a.0 < b.0 && a.1 <= b.1), "{told:?}");
                return told;
            }
        }
    }
    panic!("more than {most} frames");
}

/// Reads or skips one frame. Returns `None` at the end, and `Some(None)` for a skipped frame.
fn step(source: &mut dyn Source, skip: bool) -> Result<Option<Option<(u64, u64, u64)>>, CaptureError> {
    if skip {
        return Ok(source.skip()?.then_some(None));
    }
    let frame = source.next()?;
    Ok(frame.map(|frame| Some((frame.number, frame.captured_us, hash(frame.picture().unwrap())))))
}

/// Returns a hash of a picture's samples, without the padding between its rows.
pub fn hash(picture: &Picture<'_>) -> u64 {
    let mut hasher = DefaultHasher::new();
    let mut rows = |data: &[u8], stride: usize, [width, rows]: [usize; 2]| {
        (0..rows).for_each(|row| data[row * stride..][..width].hash(&mut hasher));
    };
    let [width, height] = [picture.width(), picture.height()];
    let pixels = picture.pixels();
    match pixels {
        Pixels::Grey { data, stride } => rows(data, stride, [width, height]),
        Pixels::Packed { data, stride, step, .. } => rows(data, stride, [step * width, height]),
        Pixels::Yuyv { data, stride } => rows(data, stride, [4 * width.div_ceil(2), height]),
        Pixels::Nv12 { luma, chroma, stride } => {
            rows(luma, stride, [width, height]);
            rows(chroma, stride, [2 * width.div_ceil(2), height.div_ceil(2)]);
        }
        Pixels::Planar { planes: [luma, cb, cr], strides: [stride, chroma_stride], chroma_shift: [x, y] } => {
            rows(luma, stride, [width, height]);
            let size = [width.div_ceil(1 << x), height.div_ceil(1 << y)];
            for plane in [cb, cr] {
                rows(plane, chroma_stride, size);
            }
        }
    }
    hasher.finish()
}
