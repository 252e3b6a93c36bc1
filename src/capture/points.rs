//! Landmarks from a recording of facewire, or from a `.npy` file: frames x 478 x 3 numbers, in pixels.
//!
//! Some trackers write irises of depth 0, which the model was not fitted to. They are put at the depth of the eye.
//!
//! The header is checked before it is parsed, because nested brackets would keep the parser busy without bound, and a
//! product of lengths may exceed 64 bits.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read};
use std::path::Path;

use npyz::{DType, NpyFile, TypeChar};

use super::open::FileOptions;
use super::{CaptureError, Content, Description, Frame, Source};
use crate::recording::{Reader, Recorded, RecordingError};
use facewire_face::{Face, Landmarks, MESH};

/// Largest number of bytes before the numbers; usual files have 128.
const MAX_START_BYTES: u64 = 1024;
/// The header of a plain array is a dictionary, in which the shape is a tuple.
const MAX_BRACKETS: usize = 2;
/// Lengths of so few digits have a product of 64 bits.
const MAX_DIGITS: usize = 19;

/// A file of landmarks. A frame with a number that is not finite shows no face.
pub(super) struct PointsSource {
    /// The numbers that were not read yet.
    values: Box<dyn Iterator<Item = io::Result<f32>> + Send>,
    origin: String,
    options: FileOptions,
    /// Frames that the header announces and that were not read yet.
    left: u64,
    number: u64,
    landmarks: Box<Landmarks>,
}

impl PointsSource {
    /// Opens the file at `path`.
    pub(super) fn open(path: &str, options: &FileOptions) -> Result<Self, CaptureError> {
        let file = File::open(path).map_err(|error| CaptureError::unopened(path, &error))?;
        let needs = "it must hold frames x 478 x 3 floating-point numbers in C order";
        let refuse = |reason: &str| CaptureError::BadFile(format!("{path} {reason}; {needs}"));
        let mut reader = BufReader::new(file);
        let mut start = Vec::new();
        reader.by_ref().take(MAX_START_BYTES).read_to_end(&mut start)?;
        let other = "is not a .npy file of plain numbers";
        if !is_plain(&start) {
            return Err(refuse(other));
        }
        let npy = NpyFile::new(Cursor::new(start).chain(reader)).map_err(|_| refuse(other))?;
        let [left, 478, 3] = *npy.shape() else { return Err(refuse(&format!("has shape {:?}", npy.shape()))) };
        if npy.order() != npyz::Order::C {
            return Err(refuse("is in Fortran order"));
        }
        let DType::Plain(kind) = npy.dtype() else { return Err(refuse("holds records")) };
        let unreadable = |error: npyz::DTypeError| refuse(&error.to_string());
        let values: Box<dyn Iterator<Item = _> + Send> = match (kind.type_char(), kind.size_field()) {
            (TypeChar::Float, 4) => Box::new(npy.data::<f32>().map_err(unreadable)?),
            (TypeChar::Float, 8) => {
                Box::new(npy.data::<f64>().map_err(unreadable)?.map(|value| value.map(|value| value as f32)))
            }
            _ => return Err(refuse("holds numbers of another kind")),
        };
        let landmarks = Box::new(Landmarks::zero());
        Ok(Self { values, origin: path.to_owned(), options: *options, left, number: 0, landmarks })
    }
}

impl Source for PointsSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let Some(left) = self.left.checked_sub(1) else { return Ok(None) };
        let number = self.number;
        for slot in self.landmarks.0.as_flattened_mut() {
            *slot = match self.values.next().unwrap_or_else(|| Err(io::ErrorKind::UnexpectedEof.into())) {
                Ok(value) => value,
                Err(error) => {
                    // The file has ended.
                    self.left = 0;
                    return Err(match error.kind() {
                        io::ErrorKind::UnexpectedEof => CaptureError::BadFile(format!(
                            "the .npy file is cut short in frame {number}; the frames before it were used, write it again \
                             for the rest"
                        )),
                        _ => error.into(),
                    });
                }
            };
        }
        (self.left, self.number) = (left, number + 1);
        if self.landmarks.0.iter().skip(MESH).all(|[_, _, depth]| *depth == 0.0) {
            self.landmarks.level_irises();
        }
        let face = self.landmarks.is_finite().then(|| Face::from(&*self.landmarks));
        let size_px = self.options.points_size_px.map(f32::from);
        let content = Content::Face { face, size_px };
        Ok(Some(Frame { content, captured_us: self.options.rate.stamp_us(number), number }))
    }

    fn shows_pictures(&self) -> bool {
        false
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.options.points_size_px.map(usize::from);
        Description { origin: &self.origin, format: "landmarks", width, height, rate: Some(self.options.rate) }
    }
}

/// Returns whether a file that begins with `start` has the header of an array of numbers.
fn is_plain(start: &[u8]) -> bool {
    let header = match start.strip_prefix(b"\x93NUMPY") {
        Some([1, _, a, b, rest @ ..] | [2 | 3, _, a, b, 0, 0, rest @ ..]) => {
            rest.get(..usize::from(u16::from_le_bytes([*a, *b])))
        }
        _ => None,
    };
    let count = |header: &[u8], of: &[u8]| header.iter().filter(|byte| of.contains(byte)).count();
    header.is_some_and(|header| count(header, b"([{") <= MAX_BRACKETS && count(header, b"0123456789") <= MAX_DIGITS)
}

/// A recording as a source of landmarks.
pub(super) struct RecordingSource {
    reader: Reader<BufReader<File>>,
    /// The first frame, which was read for the size of its picture.
    first: Option<Recorded>,
    current: Option<Recorded>,
    origin: String,
    size_px: [u16; 2],
    number: u64,
}

impl RecordingSource {
    /// Opens the file at `path`.
    pub(super) fn open(path: &str) -> Result<Self, CaptureError> {
        let refuse = |error: RecordingError| CaptureError::BadFile(format!("{path}: {error}"));
        let mut reader = Reader::open(Path::new(path)).map_err(refuse)?;
        let first = reader.next_frame().map_err(refuse)?;
        let size_px = first.as_ref().map_or([0; 2], |frame| frame.size_px);
        Ok(Self { reader, first, current: None, origin: path.to_owned(), size_px, number: 0 })
    }
}

impl Source for RecordingSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let refuse = |error: RecordingError| CaptureError::BadFile(format!("{}: {error}", self.origin));
        self.current = match self.first.take() {
            Some(first) => Some(first),
            None => self.reader.next_frame().map_err(refuse)?,
        };
        let Some(frame) = &self.current else { return Ok(None) };
        let number = self.number;
        self.number += 1;
        let content =
            Content::Face { face: frame.landmarks.as_ref().map(Face::from), size_px: frame.size_px.map(f32::from) };
        Ok(Some(Frame { content, captured_us: frame.time_us, number }))
    }

    fn shows_pictures(&self) -> bool {
        false
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.size_px.map(usize::from);
        Description { origin: &self.origin, format: "recording", width, height, rate: None }
    }
}

#[cfg(test)]
mod tests {
    use npyz::WriterBuilder as _;
    use tempfile::NamedTempFile;

    use super::*;
    use facewire_face::LANDMARKS;

    /// The depths of the irises that a frame shows after it went through a file. All other points have depth 6.
    fn iris_depths(written: [f32; LANDMARKS - MESH]) -> Vec<f32> {
        let file = NamedTempFile::with_suffix(".npy").unwrap();
        let options = npyz::WriteOptions::new().default_dtype().shape(&[1, LANDMARKS as u64, 3]);
        let mut writer = options.writer(&file).begin_nd().unwrap();
        let depths = [6.0; MESH].into_iter().chain(written);
        writer.extend(depths.flat_map(|depth| [100.0_f32, 100.0, depth])).unwrap();
        writer.finish().unwrap();
        let mut source = PointsSource::open(file.path().to_str().unwrap(), &FileOptions::default()).unwrap();
        let frame = source.next().unwrap().unwrap();
        let Content::Face { face, size_px: [640.0, 480.0] } = frame.content else { unreachable!() };
        face.unwrap().landmarks.0.iter().skip(MESH).map(|point| point[2]).collect()
    }

    #[test]
    fn irises_without_depth_are_put_at_the_depth_of_their_eye_and_others_stay() {
        assert_eq!(iris_depths([0.0; 10]), [6.0; 10]);
        let mut depths = [0.0; 10];
        depths[9] = -1.5;
        assert_eq!(iris_depths(depths), depths);
    }
}
