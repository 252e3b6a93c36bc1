//! YUV4MPEG2 streams (`.y4m`, or standard input): uncompressed planes, 8 bits a sample.
//!
//! A stream that is cut off within a frame is an error, unlike the proper end of a stream. The `y4m` crate reports both as
//! the end, which is why this module reads the format itself.
//!
//! Limits: 4:2:0, 4:2:2, 4:4:4, 4:1:1 and mono; pictures are not deinterlaced; one frame is in memory.

use std::io::{self, BufRead, ErrorKind, Read as _};

use facewire::capture::{CaptureError, Content, Description, Frame, FrameRate, Source};
use facewire_face::{MAX_SIDE_PX, Picture, Pixels};

/// Longest header line that is read. Usual ones have less than 100 bytes.
const MAX_LINE_BYTES: u64 = 1024;
/// How the header of a stream begins.
const MAGIC: &[u8] = b"YUV4MPEG2 ";

#[derive(Debug)]
pub struct Y4mSource<R> {
    input: R,
    offset: u64,
    line: Vec<u8>,
    samples: Vec<u8>,
    read: u64,
    ended: bool,
    origin: String,
    header: Header,
    /// The rate of a stream that states none.
    usual_rate: FrameRate,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Header {
    size: [usize; 2],
    rate: FrameRate,
    layout: Layout,
    full_range: bool,
}

/// Powers of two by which chroma is narrower and lower than luma; `None` without chroma.
type Layout = Option<[u8; 2]>;

impl<R: BufRead> Y4mSource<R> {
    /// Reads the header. `origin` names the source to the operator. A stream that states no rate has the given one.
    pub fn open(mut input: R, origin: &str, rate: FrameRate) -> Result<Self, CaptureError> {
        let mut line = Vec::new();
        let is_whole = read_line(&mut input, &mut line)?;
        let fields = line.strip_prefix(MAGIC).ok_or_else(|| refused("does not begin with YUV4MPEG2"))?;
        if !is_whole {
            return Err(refused("ends within its header"));
        }
        let header = Header::parse(fields, rate)?;
        let offset = line.len() as u64 + 1;
        let samples = Vec::new();
        let origin = origin.to_owned();
        Ok(Self { input, offset, line, samples, read: 0, ended: false, origin, header, usual_rate: rate })
    }

    /// Reads the line before the samples of a frame. A header like that of the stream may be before it, as in two files that
    /// were joined. Returns whether the line is whole.
    fn read_frame_line(&mut self) -> Result<bool, CaptureError> {
        loop {
            let start = self.offset;
            let is_whole = read_line(&mut self.input, &mut self.line)?;
            self.offset += self.line.len() as u64 + u64::from(is_whole);
            let fields = self.line.strip_prefix(MAGIC).filter(|_| is_whole);
            let Some(fields) = fields else { return Ok(is_whole) };
            if Header::parse(fields, self.usual_rate).ok() != Some(self.header) {
                return Err(CaptureError::BadFile(format!(
                    "a stream of another size, rate or colour layout begins at byte {start}, before frame {}; the frames \
                     before it were used, cut the file there for the rest",
                    self.read
                )));
            }
        }
    }

    /// Reads `FRAME`, its parameters and its samples. Returns `false` at the end.
    fn read_frame(&mut self) -> Result<bool, CaptureError> {
        let is_whole = self.read_frame_line()?;
        if self.line.is_empty() && !is_whole {
            return Ok(false);
        }
        let length = self.line.len() as u64;
        let begins = |word: &[u8]| word.iter().zip(&self.line).all(|(wanted, byte)| wanted == byte);
        let is_cut = !is_whole && length < MAX_LINE_BYTES && (begins(b"FRAME") || begins(MAGIC));
        if !(is_cut || is_whole && self.line.starts_with(b"FRAME")) {
            let start = self.offset - length - u64::from(is_whole);
            let place = format!("at byte {start}, before frame {}", self.read);
            return Err(CaptureError::BadFile(format!("the stream is damaged {place}; copy or record it again")));
        }
        let [width, height] = self.header.size;
        let [columns, rows] = self.chroma_size();
        let wanted = width * height + 2 * columns * rows;
        self.samples.clear();
        self.samples.reserve_exact(wanted);
        // A line that is cut off is followed by no samples.
        let read = self.input.by_ref().take(wanted as u64).read_to_end(&mut self.samples)?;
        self.offset += read as u64;
        if read < wanted {
            return Err(CaptureError::cut_short(ErrorKind::UnexpectedEof.into(), self.read, self.offset));
        }
        self.read += 1;
        Ok(true)
    }

    /// Columns and rows of each chroma plane.
    fn chroma_size(&self) -> [usize; 2] {
        let [width, height] = self.header.size;
        self.header.layout.map_or([0, 0], |[x, y]| [width.div_ceil(1 << x), height.div_ceil(1 << y)])
    }

    fn picture(&self) -> Option<Picture<'_>> {
        let [width, height] = self.header.size;
        let [columns, rows] = self.chroma_size();
        let data = &self.samples;
        let pixels = match self.header.layout {
            None => Pixels::Grey { data, stride: width },
            Some(chroma_shift) => {
                let (luma, chroma) = data.split_at_checked(width * height)?;
                let (cb, cr) = chroma.split_at_checked(columns * rows)?;
                Pixels::Planar { planes: [luma, cb, cr], strides: [width, columns], chroma_shift }
            }
        };
        Picture::new(width, height, pixels, self.header.full_range)
    }
}

impl<R: BufRead> Source for Y4mSource<R> {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        if !self.skip()? {
            return Ok(None);
        }
        let [width, height] = self.header.size;
        let number = self.read - 1;
        let picture = self.picture().ok_or_else(|| CaptureError::picture_size(width, height))?;
        Ok(Some(Frame { content: Content::Picture(picture), captured_us: self.header.rate.stamp_us(number), number }))
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        let read = if self.ended { Ok(false) } else { self.read_frame() };
        self.ended = !matches!(read, Ok(true));
        read
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.header.size;
        let format = if self.header.layout.is_some() { "YUV" } else { "GREY" };
        Description { origin: &self.origin, format, width, height, rate: Some(self.header.rate) }
    }
}

impl Header {
    fn parse(fields: &[u8], usual_rate: FrameRate) -> Result<Self, CaptureError> {
        let [mut width, mut height] = [0; 2];
        let mut rate = usual_rate;
        let mut layout = None;
        let mut full_range = false;
        // Aspect ratio, interlacing and comments are ignored.
        for field in fields.split(|&byte| byte == b' ') {
            let number = |digits| str::from_utf8(digits).ok().and_then(|digits| digits.parse().ok()).unwrap_or(0);
            match field {
                [b'W', value @ ..] => width = number(value),
                [b'H', value @ ..] => height = number(value),
                [b'F', value @ ..] => rate = parse_rate(value).unwrap_or(rate),
                [b'C', value @ ..] => layout = Some(parse_layout(value)?),
                b"XCOLORRANGE=FULL" => full_range = true,
                // Where older programs put the layout.
                [b'X', b'Y', b'S', b'C', b'S', b'S', b'=', value @ ..] if layout.is_none() => {
                    layout = Some(parse_layout(&value.to_ascii_lowercase())?);
                }
                _ => {}
            }
        }
        let size = [width, height];
        if !size.iter().all(|side| (1..=MAX_SIDE_PX).contains(side)) {
            return Err(CaptureError::picture_size(width, height));
        }
        Ok(Self { size, rate, layout: layout.unwrap_or(Some([1, 1])), full_range })
    }
}

fn refused(reason: &str) -> CaptureError {
    let remedy = "make one with `ffmpeg -i FILE -pix_fmt yuv420p out.y4m`";
    CaptureError::BadFile(format!("the y4m stream {reason}; {remedy}"))
}

/// Parses the colour layout. Ignores the siting of chroma samples, which differs by a fraction of a pixel.
fn parse_layout(name: &[u8]) -> Result<Layout, CaptureError> {
    match name {
        b"420" | b"420jpeg" | b"420mpeg2" | b"420paldv" => Ok(Some([1, 1])),
        b"422" => Ok(Some([1, 0])),
        b"444" => Ok(Some([0, 0])),
        b"411" => Ok(Some([2, 0])),
        b"mono" => Ok(None),
        [.., b'p', b'1', _] | [.., b'p', b'9'] | [b'm', b'o', b'n', b'o', ..] => {
            Err(refused("has more than 8 bits a sample"))
        }
        _ => Err(refused(&format!("has the colour layout {}, which is not supported", name.escape_ascii()))),
    }
}

/// Parses a rate such as `30000:1001`. `0:0` stands for an unknown rate.
fn parse_rate(value: &[u8]) -> Option<FrameRate> {
    let (frames, seconds) = str::from_utf8(value).ok()?.split_once(':')?;
    FrameRate::new(frames.parse().ok()?, seconds.parse().ok()?)
}

/// Reads a line without its line feed. Returns `false` if the stream or the longest line ended before the line feed.
fn read_line(input: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    line.clear();
    input.take(MAX_LINE_BYTES).read_until(b'\n', line)?;
    Ok(line.pop_if(|last| *last == b'\n').is_some())
}
