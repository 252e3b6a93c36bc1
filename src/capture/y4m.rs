//! YUV4MPEG2 streams (`.y4m`, or standard input): uncompressed planes, 8 bits a sample.
//!
//! Contract: a stream that is cut off within a frame is an error, unlike the proper end of a stream. The `y4m` crate
//! reports both as the end, which is why this module reads the format itself.
//!
//! Limits: 4:2:0, 4:2:2, 4:4:4, 4:1:1 and mono; pictures are not deinterlaced; one frame is in memory.

mod header;

use std::io::Read;

use self::header::Header;
use super::read::fill;
use super::{CaptureError, Content, Description, Frame, FrameRate, Picture, Source};

/// Longest header line that is read. Usual ones have less than 100 bytes.
const MAX_LINE_BYTES: usize = 1024;

/// A y4m stream.
#[derive(Debug)]
pub struct Y4mSource<R> {
    reader: R,
    header: Header,
    origin: String,
    samples: Box<[u8]>,
    /// Number of bytes that were read.
    offset: u64,
    /// Number of frames that were read.
    number: u64,
    ended: bool,
}

impl<R: Read> Y4mSource<R> {
    /// Reads the header. `origin` names the source to the operator. `reader` should be buffered.
    ///
    /// # Errors
    /// [`CaptureError::Y4m`] for other content, [`CaptureError::PictureSize`], [`CaptureError::Read`].
    pub fn open(mut reader: R, origin: &str) -> Result<Self, CaptureError> {
        let mut line = [0; MAX_LINE_BYTES];
        let (line, ended) = read_line(&mut reader, &mut line)?;
        let fields = line.strip_prefix(b"YUV4MPEG2 ").ok_or(CaptureError::Y4m("does not begin with YUV4MPEG2"))?;
        if !ended {
            return Err(CaptureError::Y4m("ends within its header"));
        }
        let offset = line.len() as u64 + 1;
        let header = Header::parse(fields)?;
        let samples = vec![0; header.frame_bytes()].into_boxed_slice();
        Ok(Self { reader, header, origin: origin.to_owned(), samples, offset, number: 0, ended: false })
    }

    /// Sets the rate of a stream that states none.
    #[must_use]
    pub fn with_rate(mut self, rate: FrameRate) -> Self {
        self.header.rate = self.header.rate.or(Some(rate));
        self
    }

    /// Reads `FRAME`, its parameters and its samples. Returns `false` at the end.
    fn read_frame(&mut self) -> Result<bool, CaptureError> {
        let mut line = [0; MAX_LINE_BYTES];
        let (line, ended) = read_line(&mut self.reader, &mut line)?;
        if line.is_empty() && !ended {
            return Ok(false);
        }
        let (frame, offset) = (self.number, self.offset);
        self.offset += line.len() as u64 + u64::from(ended);
        let cut = !ended && line.len() < MAX_LINE_BYTES && b"FRAME".iter().zip(line).all(|(a, b)| a == b);
        if cut {
            return Err(CaptureError::CutShort { frame, offset: self.offset });
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
            return Err(CaptureError::CutShort { frame: self.number, offset: self.offset });
        }
        self.number += 1;
        Ok(true)
    }

    /// Reads the next frame into `self.samples`. Returns `false` at the end, and after an error.
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
        let Header { width, height, rate, full_range, .. } = self.header;
        let number = self.number - 1;
        let captured_us = rate.unwrap_or(FrameRate::FPS_30).stamp_us(number);
        let pixels = self.header.pixels(&self.samples);
        let picture = pixels.and_then(|pixels| Picture::new(width, height, pixels, full_range));
        let picture = picture.ok_or(CaptureError::PictureSize { width, height })?;
        Ok(Some(Frame { content: Content::Picture(picture), captured_us, number }))
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        self.advance()
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.header.rate.map(FrameRate::period_us)
    }

    fn describe(&self) -> Description<'_> {
        let Header { width, height, rate, chroma_shift, .. } = self.header;
        let format = if chroma_shift.is_some() { "YUV" } else { "GREY" };
        Description { origin: &self.origin, format, width, height, rate }
    }
}

/// Reads a line without its line feed. The flag is `false` if the stream or `line` ended before the line feed.
fn read_line<'a>(reader: &mut impl Read, line: &'a mut [u8]) -> Result<(&'a [u8], bool), CaptureError> {
    let mut length = 0;
    let mut byte = [0];
    while length < line.len() && fill(reader, &mut byte)? == 1 && byte != [b'\n'] {
        line.iter_mut().skip(length).take(1).for_each(|end| [*end] = byte);
        length += 1;
    }
    Ok((line.get(..length).unwrap_or_default(), byte == [b'\n']))
}

#[cfg(test)]
mod tests;
