//! YUV4MPEG2 streams (`.y4m`, or standard input): uncompressed planes, 8 bits a sample.
//!
//! Contract: a stream that ends inside a frame is told from one that ends after a frame. The `y4m` crate reports both
//! as the end, which is why the few lines of this format are read here.
//!
//! Limits: 4:2:0, 4:2:2, 4:4:4, 4:1:1 and mono; interlacing is not undone; one frame in memory.

use std::io::Read;

use super::read::fill;
use super::{CaptureError, Description, Frame, FrameRate, MAX_SIDE_PX, Picture, Pixels, Source};

/// Longest header line; real ones have under 100 bytes.
const MAX_LINE_BYTES: usize = 1024;

/// A y4m stream.
#[derive(Debug)]
pub struct Y4mSource<R> {
    reader: R,
    header: Header,
    origin: String,
    samples: Box<[u8]>,
    /// Bytes read.
    offset: u64,
    /// Frames read.
    number: u64,
    ended: bool,
}

/// What the first line says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Header {
    width: usize,
    height: usize,
    rate: Option<FrameRate>,
    /// `None` is luma alone.
    chroma_shift: Option<[u8; 2]>,
    full_range: bool,
}

impl<R: Read> Y4mSource<R> {
    /// Reads the header; `origin` is the name shown to the operator. `reader` should be buffered.
    ///
    /// # Errors
    /// [`CaptureError::Y4m`] for other content, [`CaptureError::PictureSize`], [`CaptureError::Read`].
    pub fn open(mut reader: R, origin: &str) -> Result<Self, CaptureError> {
        let mut line = [0; MAX_LINE_BYTES];
        let (line, ended) = read_line(&mut reader, &mut line)?;
        let fields = line
            .strip_prefix(b"YUV4MPEG2 ")
            .ok_or(CaptureError::Y4m("is not a y4m stream"))?;
        if !ended {
            return Err(CaptureError::Y4m("ends within its header"));
        }
        let offset = line.len() as u64 + 1;
        let header = Header::parse(fields)?;
        let samples = vec![0; header.frame_bytes()].into_boxed_slice();
        Ok(Self {
            reader,
            header,
            origin: origin.to_owned(),
            samples,
            offset,
            number: 0,
            ended: false,
        })
    }

    /// Reads `FRAME`, its parameters and its samples; `false` at the end.
    fn read_frame(&mut self) -> Result<bool, CaptureError> {
        let mut line = [0; MAX_LINE_BYTES];
        let (line, ended) = read_line(&mut self.reader, &mut line)?;
        if line.is_empty() && !ended {
            return Ok(false);
        }
        let (frame, offset) = (self.number, self.offset);
        self.offset += line.len() as u64 + u64::from(ended);
        let cut =
            !ended && line.len() < MAX_LINE_BYTES && b"FRAME".iter().zip(line).all(|(a, b)| a == b);
        if cut {
            return Err(CaptureError::CutShort {
                frame,
                offset: self.offset,
            });
        }
        if !ended || !line.starts_with(b"FRAME") {
            return Err(CaptureError::Damaged { frame, offset });
        }
        self.read_samples()
    }

    fn read_samples(&mut self) -> Result<bool, CaptureError> {
        let filled = fill(&mut self.reader, &mut self.samples)?;
        self.offset += filled as u64;
        if filled < self.samples.len() {
            return Err(CaptureError::CutShort {
                frame: self.number,
                offset: self.offset,
            });
        }
        self.number += 1;
        Ok(true)
    }

    /// Brings the next frame into `self.samples`; after the end or an error there is none.
    fn advance(&mut self) -> Result<bool, CaptureError> {
        if self.ended {
            return Ok(false);
        }
        let read = self.read_frame();
        self.ended = !matches!(read, Ok(true));
        read
    }
}

impl<R: Read> Source for Y4mSource<R> {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        if !self.advance()? {
            return Ok(None);
        }
        let Header {
            width,
            height,
            rate,
            full_range,
            ..
        } = self.header;
        let number = self.number - 1;
        let captured_us = rate.unwrap_or(FrameRate::FPS_30).stamp_us(number);
        let pixels = self.header.pixels(&self.samples);
        let picture = pixels.and_then(|pixels| Picture::new(width, height, pixels, full_range));
        let picture = picture.ok_or(CaptureError::PictureSize { width, height })?;
        Ok(Some(Frame {
            picture,
            captured_us,
            number,
            skipped: 0,
            damaged: 0,
        }))
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        self.advance()
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.header.rate.map(FrameRate::period_us)
    }

    fn describe(&self) -> Description<'_> {
        let Header {
            width,
            height,
            rate,
            chroma_shift,
            ..
        } = self.header;
        let format = if chroma_shift.is_some() {
            "YUV"
        } else {
            "GREY"
        };
        Description {
            origin: &self.origin,
            format,
            width,
            height,
            rate,
        }
    }
}

impl Header {
    /// Parses the fields behind the magic word. Aspect, interlacing and comments do not matter here.
    fn parse(fields: &[u8]) -> Result<Self, CaptureError> {
        let mut header = Self {
            width: 0,
            height: 0,
            rate: None,
            chroma_shift: Some([1, 1]),
            full_range: false,
        };
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
        let fits = |side| (1..=MAX_SIDE_PX).contains(&side);
        if fits(width) && fits(height) {
            Ok(header)
        } else {
            Err(CaptureError::PictureSize { width, height })
        }
    }

    /// Columns and rows of each chroma plane.
    fn chroma_size(&self) -> [usize; 2] {
        let shrink = |side: usize, shift: u8| side.div_ceil(1 << shift);
        self.chroma_shift.map_or([0, 0], |[x, y]| {
            [shrink(self.width, x), shrink(self.height, y)]
        })
    }

    fn frame_bytes(&self) -> usize {
        let [columns, rows] = self.chroma_size();
        self.width * self.height + 2 * columns * rows
    }

    fn pixels<'a>(&self, samples: &'a [u8]) -> Option<Pixels<'a>> {
        let stride = self.width;
        let Some(chroma_shift) = self.chroma_shift else {
            return Some(Pixels::Grey {
                data: samples,
                stride,
            });
        };
        let [columns, rows] = self.chroma_size();
        let (luma, chroma) = samples.split_at_checked(stride * self.height)?;
        let (cb, cr) = chroma.split_at_checked(columns * rows)?;
        Some(Pixels::Planar {
            planes: [luma, cb, cr],
            strides: [stride, columns],
            chroma_shift,
        })
    }
}

/// How much smaller chroma is. The siting names differ by a fraction of a pixel, which does not matter here.
fn chroma_shift(name: &[u8]) -> Result<Option<[u8; 2]>, CaptureError> {
    match name {
        b"420" | b"420jpeg" | b"420mpeg2" | b"420paldv" => Ok(Some([1, 1])),
        b"422" => Ok(Some([1, 0])),
        b"444" => Ok(Some([0, 0])),
        b"411" => Ok(Some([2, 0])),
        b"mono" => Ok(None),
        [.., b'p', b'1', _] | [.., b'p', b'9'] | [b'm', b'o', b'n', b'o', ..] => {
            Err(CaptureError::Y4m("has more than 8 bits a sample"))
        }
        _ => Err(CaptureError::Y4m(
            "has a colour layout that is not supported",
        )),
    }
}

fn number(digits: &[u8]) -> Option<u32> {
    std::str::from_utf8(digits).ok()?.parse().ok()
}

/// `30000:1001`; `0:0` means that it is not known.
fn rate(value: &[u8]) -> Option<FrameRate> {
    let colon = value.iter().position(|&byte| byte == b':')?;
    let (frames, seconds) = value.split_at_checked(colon)?;
    FrameRate::new(number(frames)?, number(seconds.get(1..)?)?)
}

/// Reads up to a line feed, which is left out; the flag says whether it came before the end and the limit.
fn read_line<'a>(
    reader: &mut impl Read,
    line: &'a mut [u8],
) -> Result<(&'a [u8], bool), CaptureError> {
    let mut length = 0;
    let mut byte = [0];
    while length < line.len() && fill(reader, &mut byte)? == 1 && byte != [b'\n'] {
        line.iter_mut()
            .skip(length)
            .take(1)
            .for_each(|end| [*end] = byte);
        length += 1;
    }
    Ok((line.get(..length).unwrap_or_default(), byte == [b'\n']))
}

#[cfg(test)]
mod tests;
