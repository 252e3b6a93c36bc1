//! Opens the file that an argument names: a film, landmarks or a recording.

mod y4m;

use std::fs::File;
use std::io::{self, BufRead as _, BufReader, Cursor, ErrorKind, Read};
use std::path::Path;

use facewire::capture::{AviSource, CaptureError, Clip, Content, DEMO, Description, Frame, FrameRate, Source};
use facewire::recording::{Reader, Recorded, RecordingError};
use facewire_face::{Face, Landmarks, MESH};
use facewire_packet::Reason;
use npyz::{DType, DTypeError, NpyFile, Order, TypeChar};

use self::y4m::Y4mSource;
use crate::progress::ShareRead;

const BUFFER_BYTES: usize = 64 * 1024;
/// Size of the picture in which the landmarks of a `.npy` file were found, unless an argument tells another.
pub(crate) const USUAL_SIZE_PX: [u16; 2] = [640, 480];
/// Largest number of bytes before the numbers; usual files have 128.
const MAX_START_BYTES: u64 = 1024;
/// Landmarks in pixels are not all as near to the corner as this.
const MAX_NORMALISED: f32 = 2.0;
/// The header of a plain array is a dictionary, in which the shape is a tuple. Nested brackets would keep the parser busy
/// without bound.
const MAX_BRACKETS: usize = 2;
/// Lengths that have so few digits together have a product that fits 64 bits.
const MAX_DIGITS: usize = 19;

/// A file that was opened, and how much of it was read.
pub(crate) struct Input {
    pub source: Box<dyn Source>,
    pub read: ShareRead,
}

/// Opens `-` (y4m on standard input), `demo` (the built-in clip, once through), a `.npy` file of landmarks, or a film or a
/// recording by its content. A file that states no rate has the given one.
pub(crate) fn open(input: &str, rate: FrameRate, points_size_px: [u16; 2]) -> Result<Input, CaptureError> {
    let unmeasured = |source| Ok(Input { source, read: ShareRead::default() });
    if input == DEMO {
        return unmeasured(Box::new(Clip::once()?));
    }
    if input == "-" {
        let stream = BufReader::with_capacity(BUFFER_BYTES, io::stdin());
        return unmeasured(Box::new(Y4mSource::open(stream, "standard input", rate)?));
    }
    let cannot = |error| CaptureError::unopened(input, &error);
    let file = File::open(input).map_err(cannot)?;
    let read = ShareRead::of(file.metadata().map_err(cannot)?.len());
    // A counter within the buffered reader would let it clear its buffer before each read.
    let mut reader = read.count(BufReader::with_capacity(BUFFER_BYTES, file));
    if Path::new(input).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy")) {
        return Ok(Input { source: Box::new(FaceSource::points(reader, input, rate, points_size_px)?), read });
    }
    let source: Box<dyn Source> = match reader.fill_buf().map_err(cannot)? {
        [b'R', b'I', b'F', b'F', ..] => Box::new(AviSource::open(reader, input, rate)?),
        [b'F', b'W', b'R', b'E', b'C', ..] => Box::new(FaceSource::recording(reader, input)?),
        [b'Y', b'U', b'V', b'4', ..] => Box::new(Y4mSource::open(reader, input, rate)?),
        _ => {
            let remedy = format!("convert it with `ffmpeg -i {input} -c:v mjpeg -q:v 3 out.avi`");
            return Err(CaptureError::BadFile(format!("{input} is neither an AVI nor a y4m file; {remedy}")));
        }
    };
    Ok(Input { source, read })
}

/// The landmarks in a file: a recording, or a `.npy` file.
struct FaceSource {
    frames: Box<dyn Iterator<Item = Result<Recorded, CaptureError>>>,
    current: Option<Recorded>,
    number: u64,
    origin: String,
    format: &'static str,
    size_px: [u16; 2],
    rate: Option<FrameRate>,
}

impl FaceSource {
    fn recording(file: impl Read + 'static, path: &str) -> Result<Self, CaptureError> {
        let origin = path.to_owned();
        let unreadable = move |error: RecordingError| CaptureError::BadFile(format!("{origin}: {error}"));
        let mut reader = Reader::new(file).map_err(&unreadable)?;
        let first = reader.next_frame().map_err(&unreadable)?;
        let size_px = first.as_ref().map_or([0; 2], |frame| frame.size_px);
        let others = std::iter::from_fn(move || reader.next_frame().map_err(&unreadable).transpose());
        let frames = Box::new(first.map(Ok).into_iter().chain(others));
        Ok(Self { frames, current: None, number: 0, origin: path.to_owned(), format: "recording", size_px, rate: None })
    }

    /// Opens a `.npy` file of frames x 478 x 3 numbers, in pixels of pictures of this size. A frame with a number that is
    /// not finite shows no face.
    fn points(
        mut file: impl Read + 'static,
        path: &str,
        rate: FrameRate,
        size_px: [u16; 2],
    ) -> Result<Self, CaptureError> {
        let needs = "it must hold frames x 478 x 3 floating-point numbers of 32 or 64 bits in C order";
        let refuse = |reason: &str| CaptureError::BadFile(format!("{path} {reason}; {needs}"));
        let mut start = Vec::new();
        file.by_ref().take(MAX_START_BYTES).read_to_end(&mut start)?;
        let npy = is_plain(&start).then(|| NpyFile::new(Cursor::new(start).chain(file)).ok()).flatten();
        let npy = npy.ok_or_else(|| refuse("is not a .npy file of plain numbers"))?;
        let [count, 478, 3] = *npy.shape() else { return Err(refuse(&format!("has shape {:?}", npy.shape()))) };
        if npy.order() != Order::C {
            return Err(refuse("is in Fortran order"));
        }
        let DType::Plain(kind) = npy.dtype() else { return Err(refuse("holds records")) };
        let unreadable = |error: DTypeError| refuse(&error.to_string());
        let mut values: Box<dyn Iterator<Item = io::Result<f32>>> = match (kind.type_char(), kind.size_field()) {
            (TypeChar::Float, 4) => Box::new(npy.data::<f32>().map_err(unreadable)?),
            (TypeChar::Float, 8) => {
                Box::new(npy.data::<f64>().map_err(unreadable)?.map(|value| value.map(|value| value as f32)))
            }
            _ => return Err(refuse(&format!("holds numbers of the kind `{kind}`"))),
        };
        let frames = Box::new((0..count).map(move |number| {
            let landmarks = landmarks(&mut values, number)?;
            let landmarks = landmarks.is_finite().then_some(landmarks);
            if landmarks.as_ref().is_some_and(are_normalised) {
                return Err(CaptureError::BadFile(format!(
                    "the landmarks of frame {number} seem to be normalised, from 0 to 1; multiply x and z by the width of the \
                     picture in pixels and y by its height, and write the file again"
                )));
            }
            Ok(Recorded { time_us: rate.stamp_us(number), pose: Err(Reason::NoFace), size_px, landmarks })
        }));
        let origin = path.to_owned();
        let rate = Some(rate);
        Ok(Self { frames, current: None, number: 0, origin, format: "landmarks", size_px, rate })
    }
}

/// Reads the landmarks of a frame. Some trackers write irises of depth 0, which the model was not fitted to. They are put at
/// the depth of the eye.
fn landmarks(values: &mut dyn Iterator<Item = io::Result<f32>>, number: u64) -> Result<Landmarks, CaptureError> {
    let mut landmarks = Landmarks::zero();
    for slot in landmarks.0.as_flattened_mut() {
        let value = values.next().unwrap_or_else(|| Err(ErrorKind::UnexpectedEof.into()));
        *slot = value.map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => CaptureError::BadFile(format!(
                "the .npy file is cut short in frame {number}; the frames before it were used, write it again for the rest"
            )),
            _ => error.into(),
        })?;
    }
    if landmarks.0.iter().skip(MESH).all(|[_, _, depth]| *depth == 0.0) {
        landmarks.level_irises();
    }
    Ok(landmarks)
}

/// Whether these may be landmarks from 0 to 1, as MediaPipe gives them. Zeros alone stand for no face in some files.
fn are_normalised(landmarks: &Landmarks) -> bool {
    let points = || landmarks.0.iter().flat_map(|[x, y, _]| [x, y]);
    points().all(|value| value.abs() <= MAX_NORMALISED) && points().any(|value| *value != 0.0)
}

impl Source for FaceSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let next = self.frames.next().transpose();
        if next.is_err() {
            // After an error the file has ended.
            self.frames = Box::new(std::iter::empty());
        }
        self.current = next?;
        let Some(frame) = &self.current else { return Ok(None) };
        let number = self.number;
        self.number += 1;
        let face = frame.landmarks.as_ref().map(Face::from);
        let size_px = frame.size_px.map(f32::from);
        Ok(Some(Frame { content: Content::Face { face, size_px }, captured_us: frame.time_us, number }))
    }

    fn shows_pictures(&self) -> bool {
        false
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.size_px.map(usize::from);
        Description { origin: &self.origin, format: self.format, width, height, rate: self.rate }
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
mod tests {
    use facewire_face::{LANDMARKS, Pixels};
    use tempfile::NamedTempFile;

    use super::*;
    use crate::track::write_npy;

    fn opened(input: &str) -> Result<Box<dyn Source>, CaptureError> {
        Ok(open(input, FrameRate::FPS_30, USUAL_SIZE_PX)?.source)
    }

    /// The depths of the irises that a frame shows after it went through a file. All other points have depth 6.
    fn iris_depths(written: [f32; LANDMARKS - MESH]) -> Vec<f32> {
        let file = NamedTempFile::with_suffix(".npy").unwrap();
        let depths = [6.0; MESH].into_iter().chain(written);
        write_npy(file.path(), &depths.flat_map(|depth| [100.0, 100.0, depth]).collect::<Vec<_>>()).unwrap();
        let mut source = opened(file.path().to_str().unwrap()).unwrap();
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

    #[test]
    fn normalised_landmarks_are_named_and_frames_without_a_face_are_none() {
        let told = |first: f32, other: f32| {
            let file = NamedTempFile::with_suffix(".npy").unwrap();
            let points = [[first, other, 0.5]; LANDMARKS];
            write_npy(file.path(), points.as_flattened()).unwrap();
            opened(file.path().to_str().unwrap()).unwrap().next().err().map(|error| error.to_string())
        };
        for [x, y] in [[0.2, 0.9], [-0.1, 1.2], [-1.0, 0.0]] {
            let error = told(x, y).unwrap();
            assert!(
                error.starts_with("the landmarks of frame 0 seem to be normalised, from 0 to 1; multiply"),
                "{error}"
            );
        }
        for [x, y] in [[0.0, 0.0], [0.5, 300.0], [0.5, f32::NAN], [f32::INFINITY, 0.5]] {
            assert_eq!(told(x, y), None);
        }
    }

    fn y4m(header: &str, frame_bytes: usize, frames: usize) -> Vec<u8> {
        let frame = [&b"FRAME\n"[..], &vec![7; frame_bytes]].concat();
        [format!("YUV4MPEG2 {header}\n").as_bytes(), &frame.repeat(frames)].concat()
    }

    fn open_y4m(bytes: &[u8]) -> Result<Y4mSource<&[u8]>, CaptureError> {
        Y4mSource::open(bytes, "stream", FrameRate::FPS_30)
    }

    #[test]
    fn every_8_bit_layout_of_a_y4m_stream_is_read_at_odd_sizes_with_its_range_and_rate() {
        let table = [
            ("C420jpeg", 15 + 2 * 6, Some([1, 1]), false),
            ("C420mpeg2 Ip XYSCSS=420MPEG2", 15 + 2 * 6, Some([1, 1]), false),
            ("C420paldv", 15 + 2 * 6, Some([1, 1]), false),
            ("A1:1", 15 + 2 * 6, Some([1, 1]), false),
            ("C422 XCOLORRANGE=FULL", 15 + 2 * 9, Some([1, 0]), true),
            ("C444", 15 * 3, Some([0, 0]), false),
            ("C411", 15 + 2 * 6, Some([2, 0]), false),
            ("It XYSCSS=422", 15 + 2 * 9, Some([1, 0]), false),
            ("Cmono", 15, None, false),
        ];
        for (fields, bytes, shift, full_range) in table {
            let stream = y4m(&format!("W5 H3 F25:1 {fields}"), bytes, 2);
            let mut source = open_y4m(&stream).unwrap();
            let frame = source.next().unwrap().unwrap();
            let picture = frame.picture().unwrap();
            assert_eq!(picture.full_range(), full_range, "{fields}");
            match picture.pixels() {
                Pixels::Planar { planes, chroma_shift, .. } => {
                    assert_eq!((Some(chroma_shift), planes.concat()), (shift, vec![7; bytes]), "{fields}");
                }
                Pixels::Grey { data, .. } => assert_eq!((None, data.len()), (shift, bytes)),
                _ => panic!("{fields}"),
            }
            assert_eq!(source.next().unwrap().unwrap().captured_us, 40_000);
            assert!(source.next().unwrap().is_none());
        }
        assert_eq!(open_y4m(&y4m("W4 H2 F0:0", 12, 1)).unwrap().frame_period_us(), Some(33_333), "no rate");
    }

    #[test]
    fn a_second_y4m_stream_is_read_on_if_it_is_like_the_first_and_otherwise_named_where_it_begins() {
        let first = y4m("W4 H2 F25:1 Cmono", 8, 2);
        let joined = [first.clone(), y4m("W4 H2 F25:1 Ip Cmono", 8, 1)].concat();
        let mut source = open_y4m(&joined).unwrap();
        assert!(source.skip().unwrap() && source.skip().unwrap());
        let third = source.next().unwrap().unwrap();
        assert_eq!((third.number, third.captured_us), (2, 80_000));
        assert!(!source.skip().unwrap());
        for other in ["W2 H4 F25:1 Cmono", "W4 H2 F30:1 Cmono", "W4 H2 F25:1"] {
            let joined = [first.clone(), y4m(other, 0, 0)].concat();
            let mut source = open_y4m(&joined).unwrap();
            assert!(source.skip().unwrap() && source.skip().unwrap());
            let error = source.next().unwrap_err().to_string();
            assert!(error.contains(&format!("begins at byte {}, before frame 2;", first.len())), "{error}");
        }
        let cut = &joined[..first.len() + 5];
        let mut source = open_y4m(cut).unwrap();
        assert!(source.skip().unwrap() && source.skip().unwrap());
        assert!(source.skip().unwrap_err().to_string().contains("is cut short"));
    }

    #[test]
    fn a_y4m_stream_that_cannot_be_read_is_refused_with_the_reason() {
        let reason = |header: &str| open_y4m(&y4m(header, 0, 0)).unwrap_err().to_string();
        for layout in ["420p10", "422p12", "444p16", "420p9", "mono16", "mono12"] {
            assert!(reason(&format!("W4 H2 F25:1 C{layout}")).contains("more than 8 bits"), "{layout}");
        }
        assert!(reason("W4 H2 F25:1 C444alpha").contains("the colour layout 444alpha, which is not supported"));
        for size in ["W0 H2", "W4097 H2", "W4", "W99999999999999999999 H4", "W-4 H4", "W4294967295 H4294967295"] {
            assert!(reason(size).contains("each side must be"), "{size}");
        }
        assert!(reason(&"W".repeat(5000)).contains("ends within its header"));
        assert!(open_y4m(b"RIFF").unwrap_err().to_string().contains("does not begin with YUV4MPEG2"));
        let mut damaged = y4m("W4 H2 F25:1 Cmono", 8, 2);
        let second = damaged.len() - 14;
        damaged[second] = b'X';
        let mut source = open_y4m(&damaged).unwrap();
        assert!(source.skip().unwrap());
        let error = source.next().unwrap_err().to_string();
        assert!(error.contains(&format!("damaged at byte {second}, before frame 1;")), "{error}");
    }
}
