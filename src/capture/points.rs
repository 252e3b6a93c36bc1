//! Landmarks from a `.npy` file: frames x 478 x 3 numbers, in pixels.
//!
//! Some trackers write irises of depth 0, which the model was not fitted to. They are put at the depth of the eye.
//!
//! The header is checked before it is parsed, because nested brackets would keep the parser busy without bound, and a
//! product of lengths may exceed 64 bits.

use std::fs::File;
use std::io::{self, BufReader, Cursor, Read};

use npyz::{DType, NpyFile, NpyReader, TypeChar};

use super::{CaptureError, Content, Description, FileOptions, Frame, Source};
use crate::face::{Face, Landmarks, MESH};

/// Largest number of bytes before the numbers; usual files have 128.
const MAX_START_BYTES: u64 = 1024;
/// The header of a plain array is a dictionary, in which the shape is a tuple.
const MAX_BRACKETS: usize = 2;
/// Lengths of so few digits have a product of 64 bits.
const MAX_DIGITS: usize = 19;

/// The file behind the start that was checked.
type Input = io::Chain<Cursor<Vec<u8>>, BufReader<File>>;

/// A file of landmarks. A frame with a number that is not finite shows no face.
pub struct PointsSource {
    values: Values,
    origin: String,
    options: FileOptions,
    /// Frames that the header announces and that were not read yet.
    left: u64,
    number: u64,
    landmarks: Box<Landmarks>,
}

/// The numbers that were not read yet.
enum Values {
    Single(NpyReader<f32, Input>),
    Double(NpyReader<f64, Input>),
}

impl PointsSource {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// [`CaptureError::Open`], [`CaptureError::Read`], [`CaptureError::Points`] for other content.
    pub fn open(path: &str, options: &FileOptions) -> Result<Self, CaptureError> {
        let file = File::open(path).map_err(|source| CaptureError::Open { path: path.to_owned(), source })?;
        let refuse = |reason: &str| CaptureError::Points { path: path.to_owned(), reason: reason.to_owned() };
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
        let values = match (kind.type_char(), kind.size_field()) {
            (TypeChar::Float, 4) => Values::Single(npy.data().map_err(unreadable)?),
            (TypeChar::Float, 8) => Values::Double(npy.data().map_err(unreadable)?),
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
            *slot = match self.values.next() {
                Ok(value) => value,
                Err(error) => {
                    // The file has ended.
                    self.left = 0;
                    let is_cut = error.kind() == io::ErrorKind::UnexpectedEof;
                    return Err(if is_cut { CaptureError::PointsCutShort { frame: number } } else { error.into() });
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

    fn frame_period_us(&self) -> Option<u64> {
        Some(self.options.rate.period_us())
    }

    fn shows_pictures(&self) -> bool {
        false
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.options.points_size_px.map(usize::from);
        Description { origin: &self.origin, format: "landmarks", width, height, rate: Some(self.options.rate) }
    }
}

impl Values {
    #[expect(clippy::cast_possible_truncation, reason = "landmarks are kept as f32")]
    fn next(&mut self) -> io::Result<f32> {
        let value = match self {
            Self::Single(values) => values.next(),
            Self::Double(values) => values.next().map(|value| value.map(|value| value as f32)),
        };
        value.unwrap_or_else(|| Err(io::ErrorKind::UnexpectedEof.into()))
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

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::float_cmp)]
mod tests {
    use npyz::WriterBuilder as _;
    use tempfile::NamedTempFile;

    use super::*;
    use crate::face::LANDMARKS;

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
    fn irises_without_depth_are_put_at_the_depth_of_their_eye() {
        assert_eq!(iris_depths([0.0; 10]), [6.0; 10]);
    }

    #[test]
    fn irises_with_depth_stay_where_they_are() {
        let mut depths = [0.0; 10];
        depths[9] = -1.5;
        assert_eq!(iris_depths(depths), depths);
    }
}
