//! YUV4MPEG2 streams (`.y4m`, or standard input): uncompressed planes, 8 bits a sample.
//!
//! Contract: a stream that is cut off within a frame is an error, unlike the proper end of a stream. The `y4m` crate
//! reports both as the end, which is why this module reads the format itself.
//!
//! Limits: 4:2:0, 4:2:2, 4:4:4, 4:1:1 and mono; pictures are not deinterlaced; one frame is in memory.

use std::io::{self, Read};

use super::read::Counted;
use super::{CaptureError, Content, Description, Frame, FrameRate, Source};
use facewire_face::{MAX_SIDE_PX, Picture, Pixels};

/// Longest header line that is read. Usual ones have less than 100 bytes.
const MAX_LINE_BYTES: usize = 1024;

/// A y4m stream.
#[derive(Debug)]
pub struct Y4mSource<R> {
    input: Counted<R>,
    header: Header,
    origin: String,
    samples: Box<[u8]>,
    /// Number of frames that were read.
    read: u64,
    ended: bool,
}

impl<R: Read> Y4mSource<R> {
    /// Reads the header. `origin` names the source to the operator. `reader` should be buffered.
    pub fn open(reader: R, origin: &str) -> Result<Self, CaptureError> {
        let mut input = Counted { reader, offset: 0 };
        let mut line = [0; MAX_LINE_BYTES];
        let (line, is_whole) = read_line(&mut input, &mut line)?;
        let fields = line.strip_prefix(b"YUV4MPEG2 ").ok_or_else(|| refused("does not begin with YUV4MPEG2"))?;
        if !is_whole {
            return Err(refused("ends within its header"));
        }
        let header = Header::parse(fields)?;
        let samples = vec![0; header.frame_bytes()].into_boxed_slice();
        Ok(Self { input, header, origin: origin.to_owned(), samples, read: 0, ended: false })
    }

    /// Sets the rate of a stream that states none.
    pub fn with_rate(mut self, rate: FrameRate) -> Self {
        self.header.rate = self.header.rate.or(Some(rate));
        self
    }

    /// Reads `FRAME`, its parameters and its samples. Returns `false` at the end.
    fn read_frame(&mut self) -> Result<bool, CaptureError> {
        let (frame, start, mut line) = (self.read, self.input.offset, [0; MAX_LINE_BYTES]);
        let (line, is_whole) = read_line(&mut self.input, &mut line)?;
        if line.is_empty() && !is_whole {
            return Ok(false);
        }
        let is_cut = !is_whole && line.len() < MAX_LINE_BYTES && b"FRAME".iter().zip(line).all(|(a, b)| a == b);
        if !(is_cut || is_whole && line.starts_with(b"FRAME")) {
            let place = format!("at byte {start}, before frame {frame}");
            return Err(CaptureError::BadFile(format!("the stream is damaged {place}; copy or record it again")));
        }
        // A line that is cut off is followed by no samples.
        let read = self.input.read_exact(&mut self.samples);
        read.map_err(|error| CaptureError::cut_short(error, frame, self.input.offset))?;
        self.read += 1;
        Ok(true)
    }
}

impl<R: Read> Source for Y4mSource<R> {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        if !self.skip()? {
            return Ok(None);
        }
        let Header { width, height, rate, full_range, .. } = self.header;
        let number = self.read - 1;
        let captured_us = rate.unwrap_or(FrameRate::FPS_30).stamp_us(number);
        let pixels = self.header.pixels(&self.samples);
        let picture = pixels.and_then(|pixels| Picture::new(width, height, pixels, full_range));
        let picture = picture.ok_or_else(|| CaptureError::picture_size(width, height))?;
        Ok(Some(Frame { content: Content::Picture(picture), captured_us, number }))
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        let read = if self.ended { Ok(false) } else { self.read_frame() };
        self.ended = !matches!(read, Ok(true));
        read
    }

    fn describe(&self) -> Description<'_> {
        let Header { width, height, rate, chroma_shift, .. } = self.header;
        let format = if chroma_shift.is_some() { "YUV" } else { "GREY" };
        Description { origin: &self.origin, format, width, height, rate }
    }
}

/// The format of the frames.
#[derive(Debug, Clone, Copy)]
struct Header {
    width: usize,
    height: usize,
    rate: Option<FrameRate>,
    /// Powers of two by which chroma is narrower and lower than luma; `None` without chroma.
    chroma_shift: Option<[u8; 2]>,
    full_range: bool,
}

impl Header {
    /// Parses the fields behind the magic word. Ignores aspect ratio, interlacing and comments.
    fn parse(fields: &[u8]) -> Result<Self, CaptureError> {
        let mut header = Self { width: 0, height: 0, rate: None, chroma_shift: Some([1, 1]), full_range: false };
        for field in fields.split(|&byte| byte == b' ') {
            match field {
                [b'W', value @ ..] => header.width = number(value).unwrap_or(0) as usize,
                [b'H', value @ ..] => header.height = number(value).unwrap_or(0) as usize,
                [b'F', value @ ..] => header.rate = rate(value),
                [b'C', value @ ..] => header.chroma_shift = chroma_shift(value)?,
                b"XCOLORRANGE=FULL" => header.full_range = true,
                _ => {}
            }
        }
        let Self { width, height, .. } = header;
        let fits = [width, height].iter().all(|side| (1..=MAX_SIDE_PX).contains(side));
        if fits { Ok(header) } else { Err(CaptureError::picture_size(width, height)) }
    }

    /// Columns and rows of each chroma plane.
    fn chroma_size(&self) -> [usize; 2] {
        self.chroma_shift.map_or([0, 0], |[x, y]| [self.width.div_ceil(1 << x), self.height.div_ceil(1 << y)])
    }

    fn frame_bytes(&self) -> usize {
        let [columns, rows] = self.chroma_size();
        self.width * self.height + 2 * columns * rows
    }

    fn pixels<'a>(&self, samples: &'a [u8]) -> Option<Pixels<'a>> {
        let stride = self.width;
        let Some(chroma_shift) = self.chroma_shift else {
            return Some(Pixels::Grey { data: samples, stride });
        };
        let [columns, rows] = self.chroma_size();
        let (luma, chroma) = samples.split_at_checked(stride * self.height)?;
        let (cb, cr) = chroma.split_at_checked(columns * rows)?;
        Some(Pixels::Planar { planes: [luma, cb, cr], strides: [stride, columns], chroma_shift })
    }
}

fn refused(reason: &str) -> CaptureError {
    let remedy = "make one with `ffmpeg -i FILE -pix_fmt yuv420p out.y4m`";
    CaptureError::BadFile(format!("the y4m stream {reason}; {remedy}"))
}

/// Parses the colour layout. Ignores the siting of chroma samples, which differs by a fraction of a pixel.
fn chroma_shift(name: &[u8]) -> Result<Option<[u8; 2]>, CaptureError> {
    match name {
        b"420" | b"420jpeg" | b"420mpeg2" | b"420paldv" => Ok(Some([1, 1])),
        b"422" => Ok(Some([1, 0])),
        b"444" => Ok(Some([0, 0])),
        b"411" => Ok(Some([2, 0])),
        b"mono" => Ok(None),
        [.., b'p', b'1', _] | [.., b'p', b'9'] | [b'm', b'o', b'n', b'o', ..] => {
            Err(refused("has more than 8 bits a sample"))
        }
        _ => Err(refused("has a colour layout that is not supported")),
    }
}

fn number(digits: &[u8]) -> Option<u32> {
    std::str::from_utf8(digits).ok()?.parse().ok()
}

/// Parses a rate such as `30000:1001`. `0:0` stands for an unknown rate.
fn rate(value: &[u8]) -> Option<FrameRate> {
    let (frames, seconds) = std::str::from_utf8(value).ok()?.split_once(':')?;
    FrameRate::new(frames.parse().ok()?, seconds.parse().ok()?)
}

/// Reads a line without its line feed. The flag is `false` if the stream or `line` ended before the line feed.
fn read_line<'a>(input: &mut impl Read, line: &'a mut [u8]) -> io::Result<(&'a [u8], bool)> {
    let (mut length, mut byte) = (0, [0]);
    for slot in &mut *line {
        match input.read_exact(&mut byte) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => break,
            read => read?,
        }
        if byte == [b'\n'] {
            return Ok((line.get(..length).unwrap_or_default(), true));
        }
        [*slot] = byte;
        length += 1;
    }
    Ok((line.get(..length).unwrap_or_default(), false))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(header: &str, frame_bytes: usize, frames: usize) -> Vec<u8> {
        let frame = [&b"FRAME\n"[..], &vec![7; frame_bytes]].concat();
        [format!("YUV4MPEG2 {header}\n").as_bytes(), &frame.repeat(frames)].concat()
    }

    fn open(bytes: &[u8]) -> Result<Y4mSource<&[u8]>, CaptureError> {
        Y4mSource::open(bytes, "stream")
    }

    #[test]
    fn every_8_bit_layout_is_read_at_odd_sizes() {
        let cases = [
            ("C420jpeg", 15 + 2 * 6, Some([1, 1])),
            ("C420mpeg2 Ip XYSCSS=420MPEG2", 15 + 2 * 6, Some([1, 1])),
            ("C420paldv", 15 + 2 * 6, Some([1, 1])),
            ("A1:1", 15 + 2 * 6, Some([1, 1])),
            ("C422", 15 + 2 * 9, Some([1, 0])),
            ("C444", 15 * 3, Some([0, 0])),
            ("C411", 15 + 2 * 6, Some([2, 0])),
            ("Cmono", 15, None),
        ];
        for (fields, bytes, shift) in cases {
            let stream = stream(&format!("W5 H3 F30:1 {fields}"), bytes, 2);
            let mut source = open(&stream).unwrap();
            let frame = source.next().unwrap().unwrap();
            assert!(!frame.picture().unwrap().full_range);
            match frame.picture().unwrap().pixels {
                Pixels::Planar { planes, chroma_shift, .. } => {
                    assert_eq!((Some(chroma_shift), planes.concat()), (shift, vec![7; bytes]), "{fields}");
                }
                Pixels::Grey { data, .. } => assert_eq!((None, data.len()), (shift, bytes)),
                _ => panic!("{fields}"),
            }
            assert_eq!(source.next().unwrap().unwrap().captured_us, 33_333);
            assert!(source.next().unwrap().is_none());
        }
    }

    #[test]
    fn the_range_and_the_rate_are_taken_from_the_header() {
        let ntsc = stream("W4 H2 F30000:1001 C444 XCOLORRANGE=FULL", 24, 1);
        let mut source = open(&ntsc).unwrap();
        assert_eq!(source.describe().to_string(), "stream: YUV 4x2 at 29.97 fps");
        assert!(source.next().unwrap().unwrap().picture().unwrap().full_range);
        assert_eq!(open(&stream("W4 H2 F0:0", 12, 1)).unwrap().frame_period_us(), None);
    }

    #[test]
    fn every_truncation_gives_the_frames_before_it_and_names_the_frame() {
        let whole = stream("W4 H2 F25:1 Cmono", 8, 3);
        let header = whole.iter().position(|&byte| byte == b'\n').unwrap() + 1;
        for length in 0..header {
            assert!(
                open(&whole[..length]).is_err_and(|error| error.to_string().contains("the y4m stream")),
                "{length}"
            );
        }
        for length in header..=whole.len() {
            let (complete, rest) = ((length - header) / 14, (length - header) % 14);
            let mut source = open(&whole[..length]).unwrap();
            for _ in 0..complete {
                assert!(source.skip().unwrap());
            }
            match source.next() {
                Ok(None) => assert_eq!(rest, 0, "{length}"),
                Ok(Some(_)) => panic!("{length}"),
                Err(error) => {
                    assert!(
                        error.to_string().contains(&format!("cut short at byte {length}, in frame {complete};")),
                        "{error}"
                    );
                }
            }
            assert!(source.next().unwrap().is_none(), "one error, then the end");
        }
    }

    #[test]
    fn streams_that_cannot_be_read_are_refused_with_the_reason() {
        let reason = |bytes: &[u8]| open(bytes).unwrap_err().to_string();
        for layout in ["420p10", "422p12", "444p16", "420p9", "mono16", "mono12"] {
            assert!(reason(&stream(&format!("W4 H2 F25:1 C{layout}"), 0, 0)).contains("more than 8 bits"), "{layout}");
        }
        assert!(reason(&stream("W4 H2 F25:1 C444alpha", 0, 0)).contains("not supported"));
        for size in ["W0 H2", "W4097 H2", "W4", "W99999999999999999999 H4", "W-4 H4", "W4294967295 H4294967295"] {
            assert!(reason(&stream(size, 0, 0)).contains("each side must be"), "{size}");
        }
        assert!(reason(b"RIFF").contains("does not begin with YUV4MPEG2"));
        assert!(reason(&[&b"YUV4MPEG2 "[..], &[b'W'; 5000]].concat()).contains("ends within its header"));
    }

    #[test]
    fn bytes_that_are_no_frame_are_an_error_with_their_offset() {
        let mut whole = stream("W4 H2 F25:1 Cmono", 8, 2);
        let second = whole.len() - 14;
        whole[second] = b'X';
        let mut source = open(&whole).unwrap();
        assert!(source.skip().unwrap());
        let error = source.next().unwrap_err().to_string();
        assert!(error.contains(&format!("damaged at byte {second}, before frame 1;")), "{error}");
    }
}
