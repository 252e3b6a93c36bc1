//! Motion-JPEG in AVI files (RIFF, and `OpenDML` files of several RIFF parts), read as a stream.
//!
//! The reader does not use the sizes of lists, so it can read a file whose writer was stopped before it filled them in. It
//! takes the first video stream, and skips sound, indexes and padding. An empty frame chunk stands for a frame that the
//! recorder dropped; it counts in the numbers and times of the following frames.
//!
//! Limits: one chunk header and one frame are in memory, and the size of a frame is bounded by that of the picture.

use std::io::Read;

use super::jpeg::JpegDecoder;
use super::riff::{Item, Riff, START_BYTES, Stop};
use super::{CaptureError, Content, Description, Frame, FrameFault, FrameRate, Source};

/// A Motion-JPEG AVI file.
#[derive(Debug)]
pub struct AviSource<R> {
    riff: Riff<R>,
    video: Video,
    origin: String,
    decoder: JpegDecoder,
    /// Memory for the largest image.
    jpeg: Box<[u8]>,
    /// Length of the current image.
    jpeg_bytes: usize,
    /// Number of frames that were begun, damaged ones among them.
    begun: u64,
    ended: bool,
}

/// The first video stream by the file's header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Video {
    stream: u8,
    size: [usize; 2],
    rate: Option<FrameRate>,
}

impl<R: Read> AviSource<R> {
    /// Reads the header. `origin` names the source to the operator.
    ///
    /// # Errors
    /// [`CaptureError::Avi`] for other content, [`CaptureError::PictureSize`], [`CaptureError::Read`].
    pub fn open(reader: R, origin: &str) -> Result<Self, CaptureError> {
        let mut riff = Riff::new(reader);
        let video = read_header(&mut riff)?;
        let [width, height] = video.size;
        let decoder = JpegDecoder::new(width, height)?;
        let jpeg = vec![0; decoder.max_jpeg_bytes()].into_boxed_slice();
        let origin = origin.to_owned();
        Ok(Self { riff, video, origin, decoder, jpeg, jpeg_bytes: 0, begun: 0, ended: false })
    }

    /// Sets the rate of a file that states none.
    #[must_use]
    pub fn with_rate(mut self, rate: FrameRate) -> Self {
        self.video.rate = self.video.rate.or(Some(rate));
        self
    }

    /// Continues with the same film from its beginning. Numbers and times continue to grow.
    pub(super) fn rewind(&mut self, reader: R) -> Result<(), CaptureError> {
        self.riff = Riff::new(reader);
        self.video = read_header(&mut self.riff)?;
        self.ended = false;
        Ok(())
    }

    /// Reads the next JPEG image into `self.jpeg`. Returns `false` at the end.
    pub(super) fn advance(&mut self) -> Result<bool, CaptureError> {
        if self.ended {
            return Ok(false);
        }
        let found = self.find_frame();
        self.ended = !matches!(found, Ok(true) | Err(CaptureError::Frame { .. }));
        found
    }

    /// Decodes the image that [`AviSource::advance`] has read.
    pub(super) fn decoded(&mut self) -> Result<Frame<'_>, CaptureError> {
        let number = self.begun.saturating_sub(1);
        let bad = |fault| CaptureError::Frame { number, fault };
        let jpeg = self.jpeg.get(..self.jpeg_bytes).unwrap_or_default();
        self.decoder.decode(jpeg).map_err(bad)?;
        let picture = self.decoder.picture().ok_or(bad(FrameFault::Layout))?;
        let captured_us = self.video.rate.unwrap_or(FrameRate::FPS_30).stamp_us(number);
        Ok(Frame { content: Content::Picture(picture), captured_us, number })
    }

    fn find_frame(&mut self) -> Result<bool, CaptureError> {
        loop {
            let number = self.begun;
            let stop = |stop: Stop| stop.in_frame(number);
            let Some(item) = self.riff.next_item().map_err(stop)? else {
                return Ok(false);
            };
            let Item::Chunk { id, bytes } = item else {
                continue;
            };
            if self.video.is_frame(id) {
                self.begun += 1;
                if bytes > 0 {
                    return self.read_jpeg(number, bytes).map(|()| true);
                }
            } else if !self.riff.skip(bytes.into()).map_err(stop)? {
                // A file that is cut off within its index has all of its frames.
                return if id == *b"idx1" { Ok(false) } else { Err(stop(self.riff.cut())) };
            }
        }
    }

    fn read_jpeg(&mut self, number: u64, bytes: u32) -> Result<(), CaptureError> {
        let stop = |stop: Stop| stop.in_frame(number);
        self.jpeg_bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
        if let Some(jpeg) = self.jpeg.get_mut(..self.jpeg_bytes) {
            return self.riff.read(jpeg).map_err(stop);
        }
        let whole = self.riff.skip(bytes.into()).map_err(stop)?;
        let too_large = CaptureError::Frame { number, fault: FrameFault::TooLarge };
        Err(if whole { too_large } else { stop(self.riff.cut()) })
    }
}

impl<R: Read> Source for AviSource<R> {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        if self.advance()? { self.decoded().map(Some) } else { Ok(None) }
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        self.advance()
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.video.rate.map(FrameRate::period_us)
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.video.size;
        Description { origin: &self.origin, format: "MJPEG", width, height, rate: self.video.rate }
    }
}

impl Video {
    /// Returns whether a chunk is a frame of this stream. Its name is then the two-digit number and `dc` or `db`.
    fn is_frame(self, [tens, ones, d, kind]: [u8; 4]) -> bool {
        let number = [b'0' + self.stream / 10, b'0' + self.stream % 10];
        [tens, ones] == number && d == b'd' && matches!(kind, b'c' | b'b')
    }
}

/// Reads the header, up to the first frame.
fn read_header<R: Read>(riff: &mut Riff<R>) -> Result<Video, CaptureError> {
    let early = |stop| match stop {
        Stop::Cut { .. } => CaptureError::Avi("ends within its header"),
        Stop::Read(error) => CaptureError::Read(error),
    };
    if !matches!(riff.next_item().map_err(early)?, Some(Item::List { kind: [b'A', b'V', b'I', b' '] })) {
        return Err(CaptureError::Avi("is not an AVI file"));
    }
    let mut header = Header::default();
    loop {
        match riff.next_item().map_err(early)? {
            None => return Err(CaptureError::Avi("has no pictures")),
            Some(Item::List { kind }) if kind == *b"movi" => return header.video(),
            Some(Item::List { .. }) => {}
            Some(Item::Chunk { id, bytes }) => {
                let fields = riff.read_start(bytes).map_err(early)?;
                header.read(id, &fields);
            }
        }
    }
}

/// The part of the header that was read so far.
#[derive(Debug, Default)]
struct Header {
    streams: u8,
    /// Number and rate of the first video stream.
    video: Option<(u8, Option<FrameRate>)>,
    /// Size and codec of its pictures.
    picture: Option<([usize; 2], [u8; 4])>,
}

impl Header {
    /// Reads a chunk. The offsets are those of `AVISTREAMHEADER` and `BITMAPINFOHEADER`.
    fn read(&mut self, id: [u8; 4], fields: &[u8; START_BYTES]) {
        let word = |at: usize| fields.get(at..at + 4).and_then(|b| b.try_into().ok()).unwrap_or([0; 4]);
        let number = |at| u32::from_le_bytes(word(at));
        match &id {
            b"strh" => {
                let (scale, rate) = (number(20), number(24));
                if word(0) == *b"vids" && self.video.is_none() {
                    self.video = Some((self.streams, FrameRate::new(rate, scale)));
                }
                self.streams = self.streams.saturating_add(1);
            }
            b"strf" if self.video.is_some() && self.picture.is_none() => {
                // A negative height says that the top row comes first.
                let height = i32::from_le_bytes(word(8)).unsigned_abs();
                self.picture = Some(([number(4), height].map(|side| side as usize), word(16)));
            }
            _ => {}
        }
    }

    fn video(&self) -> Result<Video, CaptureError> {
        let no_video = CaptureError::Avi("has no video stream");
        let (Some((stream, rate)), Some((size, codec))) = (self.video, self.picture) else {
            return Err(no_video);
        };
        if stream > 99 {
            return Err(no_video);
        }
        match &codec.map(|c| c.to_ascii_uppercase()) {
            b"MJPG" | b"JPEG" => Ok(Video { stream, size, rate }),
            _ => Err(CaptureError::Avi("is not Motion-JPEG")),
        }
    }
}

#[cfg(test)]
mod tests;
