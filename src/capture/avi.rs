//! Motion-JPEG in AVI files (RIFF, and `OpenDML` files of several RIFF parts), read as a stream.
//!
//! The reader does not trust the sizes of RIFF parts and lists, so it can read a file whose writer was stopped before it
//! filled them in, or wrote wrong ones. It takes the first video stream, and skips sound, indexes and padding. Where no chunk
//! begins in its place, it looks for the next frame, byte by byte. An empty frame chunk stands for a frame that the
//! recorder dropped; it counts in the numbers and times of the following frames. Crates for AVI seek, which a pipe and a
//! file without an index do not allow.
//!
//! Limits: one frame is in memory, and the size of a frame is bounded by that of the picture.

use std::io::{self, ErrorKind, Read, Seek};
use std::mem::take;
use std::ops::Range;

use super::jpeg::{END_OF_IMAGE, JpegDecoder, START_OF_IMAGE, image_size};
use super::{CaptureError, Content, Description, Frame, FrameFault, FrameRate, Source, Tally};

/// Number of bytes of a header chunk that are read.
const FIELD_BYTES: usize = 64;
/// The name of a chunk and its number of bytes.
const CHUNK_BYTES: usize = 8;
/// A list's name, number of bytes and kind.
const LIST_BYTES: usize = 12;
/// The beginning of a frame: the chunk's name and size, and the start marker of its image.
const FRAME_BYTES: usize = CHUNK_BYTES + START_OF_IMAGE.len();
/// Number of bytes in which the first image is looked for.
const AHEAD_BYTES: usize = 1024 * 1024;
/// Number of bytes in which the end of a frame is looked for at first.
const FIRST_REACH_BYTES: usize = 4096;
/// Largest number of bytes that are read at once, unless more are wanted.
const READ_BYTES: usize = 64 * 1024;
/// Bytes by which a chunk may begin later than it should, because its writer fills up words of 4 bytes. It may begin one byte
/// sooner, because its writer does not fill up any.
const MAX_PADDING_BYTES: u64 = 3;
/// No chunk of a header has more bytes.
const MAX_HEADER_BYTES: u32 = 1_000_000;
/// Larger sizes of RIFF parts are those of a file that was not finished. Parts of 2 GB have no proper size in many files.
const MAX_RIFF_BYTES: u32 = 0x7fff_0000;
/// Largest chunk of padding whose size is believed, and largest chunk of sound where no chunk should begin.
const MAX_STRAY_CHUNK_BYTES: u32 = 1 << 24;

#[derive(Debug)]
pub struct AviSource<R> {
    riff: Riff<R>,
    origin: String,
    rate: FrameRate,
    decoder: JpegDecoder,
    /// Length of the current image, which comes next in `riff`; `None` if it is too large.
    jpeg_bytes: Option<usize>,
    /// Number of frames that were read, damaged and dropped ones among them.
    read: u64,
    ended: bool,
    /// How a film that is repeated for ever begins again. Numbers and times continue to grow.
    rewind: Option<fn(&mut R) -> io::Result<()>>,
}

impl<R: Read> AviSource<R> {
    /// Reads the header. `origin` names the source to the operator. A film that states no rate has the given one.
    pub fn open(reader: R, origin: &str, rate: FrameRate) -> Result<Self, CaptureError> {
        let mut riff = Riff::new(reader);
        let Header { size, codec, rate: stated } = riff.read_header()?;
        // Where the header states another size than the images have, theirs is true.
        let image = riff.first_image(size)?;
        if image.is_none() && ![*b"MJPG", *b"JPEG"].contains(&codec) {
            return Err(refuse(&format!("is not Motion-JPEG, but `{}`", codec.escape_ascii())));
        }
        let decoder = match image.unwrap_or((size, false)) {
            ([width, height], false) => JpegDecoder::new(width, height)?,
            ([width, height], true) => JpegDecoder::of_fields(width, height)?,
        };
        riff.buffer.resize(AHEAD_BYTES.max(decoder.max_jpeg_bytes() + FRAME_BYTES), 0);
        let origin = origin.to_owned();
        let rate = stated.unwrap_or(rate);
        Ok(Self { riff, origin, rate, decoder, jpeg_bytes: None, read: 0, ended: false, rewind: None })
    }

    /// Makes the film begin again at its end, for ever.
    pub(super) fn repeated(self) -> Self
    where
        R: Seek,
    {
        Self { rewind: Some(R::rewind), ..self }
    }

    /// Goes to the next frame that was not dropped. Returns `false` at the end.
    fn read_frame(&mut self) -> io::Result<bool> {
        self.riff.advance(self.jpeg_bytes.take().unwrap_or_default());
        while let Some(stated) = self.riff.next_frame()? {
            let bytes = self.riff.frame_bytes(stated)?;
            self.read += 1;
            if bytes > 0 {
                self.jpeg_bytes = usize::try_from(bytes).ok().filter(|bytes| *bytes <= self.decoder.max_jpeg_bytes());
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl<R: Read> Source for AviSource<R> {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        if !self.skip()? {
            return Ok(None);
        }
        let number = self.read.saturating_sub(1);
        let bad = |fault| CaptureError::Frame { number, fault };
        let bytes = self.jpeg_bytes.ok_or(bad(FrameFault::TooLarge))?;
        self.decoder.decode(self.riff.peek(bytes)?.get(..bytes).unwrap_or_default()).map_err(bad)?;
        let picture = self.decoder.picture().ok_or(bad(FrameFault::Corrupt))?;
        Ok(Some(Frame { content: Content::Picture(picture), captured_us: self.rate.stamp_us(number), number }))
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        if self.ended {
            return Ok(false);
        }
        let mut found = self.read_frame();
        if let (Ok(false), Some(rewind)) = (&found, self.rewind) {
            rewind(&mut self.riff.reader)?;
            self.riff.begin_again();
            self.riff.read_header()?;
            found = self.read_frame();
        }
        self.ended = !matches!(found, Ok(true));
        found.map_err(|error| CaptureError::cut_short(error, self.read, self.riff.end_of_read()))
    }

    fn take_tally(&mut self) -> Tally {
        Tally { stray_bytes: take(&mut self.riff.stray_bytes), ..Tally::default() }
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.decoder.picture_size();
        Description { origin: &self.origin, format: "MJPEG", width, height, rate: Some(self.rate) }
    }
}

/// What the header says of the first video stream.
struct Header {
    size: [usize; 2],
    /// In upper case.
    codec: [u8; 4],
    rate: Option<FrameRate>,
}

/// Reads the chunks of a RIFF stream one after the other, without seeking.
///
/// A `RIFF` or a `LIST` holds chunks in turn. The reader continues with its content, whatever its size. It only remembers
/// where the frames end, to tell a complete file from one that is cut off between two chunks.
#[derive(Debug)]
struct Riff<R> {
    reader: R,
    buffer: Vec<u8>,
    /// The part of the buffer that was read from the file, but not passed.
    ahead: Range<usize>,
    /// Offset of that part in the file.
    offset: u64,
    /// Offset at which the next chunk should begin.
    expected: u64,
    /// Offset at which the frames of the current `RIFF` end, if it states a size.
    end: Option<u64>,
    /// The digits with which the names of the chunks of the first video stream begin.
    stream: [u8; 2],
    /// Number of bytes that stood where a chunk should begin.
    stray_bytes: u64,
}

impl<R: Read> Riff<R> {
    fn new(reader: R) -> Self {
        let buffer = vec![0; AHEAD_BYTES];
        Self { reader, buffer, ahead: 0..0, offset: 0, expected: 0, end: None, stream: [0; 2], stray_bytes: 0 }
    }

    fn begin_again(&mut self) {
        self.ahead = 0..0;
        self.offset = 0;
        self.end = None;
    }

    /// Reads the header, up to the first frame. The offsets are those of `AVIMAINHEADER`, `AVISTREAMHEADER` and
    /// `BITMAPINFOHEADER`.
    fn read_header(&mut self) -> Result<Header, CaptureError> {
        let is_avi = matches!(self.peek(LIST_BYTES)?, [b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', ..]);
        if !is_avi {
            return Err(refuse("is not an AVI file"));
        }
        let mut streams = 0_u8;
        let mut main_rate = None;
        let mut video = None;
        let mut picture = None;
        loop {
            self.expected = self.offset;
            let next = self.peek(CHUNK_BYTES + FIELD_BYTES)?;
            if next.is_empty() {
                return Err(refuse("has no pictures"));
            }
            let early = || refuse("ends within its header");
            let (id, bytes) = chunk(next).ok_or_else(early)?;
            let mut fields = [0; FIELD_BYTES];
            let content = next.get(CHUNK_BYTES..).unwrap_or_default();
            let length = FIELD_BYTES.min(bytes as usize).min(content.len());
            fields.iter_mut().zip(content).take(length).for_each(|(field, byte)| *field = *byte);
            if id == *b"RIFF" || id == *b"LIST" {
                let kind = content.first_chunk().copied().ok_or_else(early)?;
                self.enter(bytes, kind);
                if kind == *b"movi" {
                    break;
                }
                continue;
            }
            // The list of the frames was missed.
            let is_behind = bytes > MAX_HEADER_BYTES || matches!(id, [b'0'..=b'9', b'0'..=b'9', b'd', _]);
            if is_behind && picture.is_some() {
                break;
            }
            let is_whole = self.pass(CHUNK_BYTES as u64 + u64::from(bytes))?;
            let padding = self.peek(1)?.first().is_some_and(|byte| bytes % 2 == 1 && !byte.is_ascii_alphanumeric());
            self.advance(padding.into());
            if !is_whole {
                return Err(early());
            }
            let word = |at: usize| fields.get(at..).and_then(<[u8]>::first_chunk).copied().unwrap_or_default();
            let number = |at| u32::from_le_bytes(word(at));
            if id == *b"avih" {
                main_rate = FrameRate::new(1_000_000, number(0));
            } else if id == *b"strh" {
                if word(0) == *b"vids" && video.is_none() {
                    video = Some((streams, FrameRate::new(number(24), number(20))));
                }
                streams = streams.saturating_add(1);
            } else if id == *b"strf" && video.is_some() && picture.is_none() {
                // A negative height says that the top row comes first.
                let sides = [number(4), number(8).cast_signed().unsigned_abs()];
                picture = Some((sides.map(|side| side as usize), word(16).map(|c| c.to_ascii_uppercase())));
            }
        }
        let Some(((stream @ ..=99, rate), (size, codec))) = video.zip(picture) else {
            return Err(refuse("has no video stream"));
        };
        self.stream = [b'0' + stream / 10, b'0' + stream % 10];
        Ok(Header { size, codec, rate: rate.or(main_rate) })
    }

    /// Returns the size of the first image, if it comes soon, and whether it has only every second row of a picture of the
    /// stated size. The other rows are then in a second image, in the same frame or in the next one.
    fn first_image(&mut self, stated: [usize; 2]) -> io::Result<Option<([usize; 2], bool)>> {
        let stream = self.stream;
        let ahead = self.peek(AHEAD_BYTES)?;
        let is_frame = |at: &usize| ahead.get(*at..).is_some_and(|bytes| begins_frame(bytes, stream));
        let mut frames = (0..ahead.len()).filter(is_frame).peekable();
        while let Some(at) = frames.next() {
            // Each byte is looked at for one frame alone, however many there are.
            let end = frames.peek().copied().unwrap_or(ahead.len());
            let Some((_, bytes)) = ahead.get(at..).and_then(chunk) else { continue };
            let content = ahead.get(at + CHUNK_BYTES..end).unwrap_or_default();
            let Some(size) = image_size(content) else { continue };
            let frame = content.get(..bytes as usize).unwrap_or(content);
            let is_low = size[0] == stated[0] && 4 * size[1] < 3 * stated[1];
            return Ok(Some((size, is_low && (2 * size[1] == stated[1] || has_second_image(frame)))));
        }
        Ok(None)
    }

    /// Passes the beginning of the next frame, and all that is before it. Returns the number of bytes that the frame states.
    /// Returns `None` at the proper end of the stream.
    fn next_frame(&mut self) -> io::Result<Option<u32>> {
        loop {
            let stream = self.stream;
            let is_within = self.offset + 1 < self.expected;
            let is_in_place = !is_within && self.offset <= self.expected + MAX_PADDING_BYTES;
            let next = self.peek(LIST_BYTES)?;
            let Some((id, bytes)) = chunk(next) else { return self.at_end() };
            let content = next.get(CHUNK_BYTES..).unwrap_or_default();
            let is_image = id.starts_with(&stream) && content.starts_with(START_OF_IMAGE);
            if begins_frame(next, stream) || is_in_place && (is_image || is_frame_name(id, stream)) {
                self.count_stray_bytes();
                self.advance(CHUNK_BYTES);
                return Ok(Some(bytes));
            }
            match id {
                // Within another chunk only a frame is believed, because that chunk may be cut short.
                _ if is_within => {}
                [b'R', b'I', b'F', b'F'] | [b'L', b'I', b'S', b'T'] => {
                    let kind = content.first_chunk().copied().unwrap_or_default();
                    self.enter(bytes, kind);
                    continue;
                }
                [b'i', b'd', b'x', b'1'] if is_in_place => {
                    self.count_stray_bytes();
                    // A file that is cut off within its index has all of its frames.
                    self.pass(CHUNK_BYTES as u64 + u64::from(bytes))?;
                    self.expected = self.offset;
                    self.end = Some(self.offset);
                    continue;
                }
                // Padding may hold old frames.
                [b'J', b'U', b'N', b'K'] if bytes <= MAX_STRAY_CHUNK_BYTES => {
                    self.enter_chunk(bytes);
                    self.pass(bytes.into())?;
                    continue;
                }
                [b'0'..=b'9', b'0'..=b'9', b'w', b'b'] if bytes <= MAX_STRAY_CHUNK_BYTES => {
                    self.enter_chunk(bytes);
                    continue;
                }
                [b'0'..=b'9', b'0'..=b'9', b'a'..=b'z', b'a'..=b'z']
                | [b'i', b'x', b'0'..=b'9', b'0'..=b'9']
                | [b'J', b'U', b'N', b'K']
                    if is_in_place =>
                {
                    self.enter_chunk(bytes);
                    continue;
                }
                _ => {}
            }
            // The beginnings of all names that are looked for.
            let may_begin = |byte: &u8| matches!(byte, b'0'..=b'9' | b'R' | b'L' | b'J' | b'i');
            let passed = next.iter().skip(1).position(may_begin).map_or(next.len(), |at| at + 1);
            self.advance(passed);
        }
    }

    /// Returns the number of bytes of a frame that states `stated` bytes: fewer if the next frame begins before its end.
    /// Reads the frame if it fits the buffer.
    fn frame_bytes(&mut self, stated: u32) -> io::Result<u64> {
        let room = self.buffer.len() - FRAME_BYTES;
        let next = self.peek(START_OF_IMAGE.len())?;
        // An image of 0 bytes was written by a recorder that was stopped, and goes on up to the next frame.
        let is_unfinished = stated == 0 && next.starts_with(START_OF_IMAGE);
        let stated = if is_unfinished { u64::MAX >> 1 } else { stated.into() };
        let wanted = usize::try_from(stated).unwrap_or(usize::MAX).min(room);
        let following = self.following_frame(wanted)?;
        if following.is_none() && self.ahead.len() < wanted {
            return Err(ErrorKind::UnexpectedEof.into());
        }
        let [bytes, padded] = following.map_or([stated, stated.next_multiple_of(2)], |at| [at as u64; 2]);
        self.expected = self.offset + padded;
        Ok(bytes)
    }

    /// Reads `wanted` bytes, or fewer if the next frame begins within them. Returns where it begins then. Reads no farther than
    /// about twice the way to that frame, so that a file of very many small frames with large sizes is not read slowly.
    fn following_frame(&mut self, wanted: usize) -> io::Result<Option<usize>> {
        let stream = self.stream;
        let mut searched = 0;
        let mut reach = FIRST_REACH_BYTES.min(wanted);
        loop {
            let next = self.peek(reach + FRAME_BYTES)?;
            let within = next.get(searched..next.len().min(reach + FRAME_BYTES - 1)).unwrap_or_default();
            let found = within.windows(FRAME_BYTES).position(|bytes| begins_frame(bytes, stream));
            if found.is_some() || reach == wanted || next.len() < reach {
                return Ok(found.map(|at| searched + at));
            }
            searched = reach;
            reach = wanted.min(2 * reach);
        }
    }

    /// Whether the stream ended properly, now that fewer bytes are left than a chunk has.
    fn at_end(&mut self) -> io::Result<Option<u32>> {
        let end_of_file = self.end_of_read();
        let next = self.expected.max(self.offset);
        // Some writers count the 8 bytes before the content, too.
        let has_all_lists = self.end.is_none_or(|end| end_of_file + CHUNK_BYTES as u64 >= end);
        let is_chunk_whole = end_of_file + 1 >= self.expected;
        // What is left is the beginning of a chunk, unless it is behind the frames or other bytes that belong to none.
        let is_behind = self.end.is_some_and(|end| next >= end) || self.offset > self.expected + 1;
        let is_proper = has_all_lists && is_chunk_whole && (is_behind || end_of_file <= next + 1);
        if is_proper { Ok(None) } else { Err(ErrorKind::UnexpectedEof.into()) }
    }

    /// Passes the beginning of a part or a list.
    fn enter(&mut self, bytes: u32, kind: [u8; 4]) {
        self.count_stray_bytes();
        let is_known = bytes != 0 && bytes < MAX_RIFF_BYTES;
        let end = is_known.then_some(self.offset + CHUNK_BYTES as u64 + u64::from(bytes));
        match &kind {
            [b'A', b'V', b'I', _] => self.end = end,
            // Nothing is lost with what follows the frames.
            b"movi" => self.end = end.into_iter().chain(self.end).min(),
            _ => {}
        }
        self.advance(LIST_BYTES);
        self.expected = self.offset;
    }

    /// Passes the beginning of a chunk that is no frame.
    fn enter_chunk(&mut self, bytes: u32) {
        self.count_stray_bytes();
        self.advance(CHUNK_BYTES);
        self.expected = self.offset + u64::from(bytes).next_multiple_of(2);
    }

    /// Counts the bytes between the place where a chunk should begin and this one.
    fn count_stray_bytes(&mut self) {
        self.stray_bytes += self.offset.saturating_sub(self.expected);
    }

    fn end_of_read(&self) -> u64 {
        self.offset + self.ahead.len() as u64
    }

    /// Reads until `bytes` bytes are ahead, and returns all that are: fewer at the end of the file.
    fn peek(&mut self, bytes: usize) -> io::Result<&[u8]> {
        if self.ahead.start + bytes > self.buffer.len() {
            self.buffer.copy_within(self.ahead.clone(), 0);
            self.ahead = 0..self.ahead.len();
        }
        while self.ahead.len() < bytes {
            let room = READ_BYTES.max(bytes - self.ahead.len()).min(self.buffer.len() - self.ahead.end);
            let room = self.buffer.get_mut(self.ahead.end..).and_then(|rest| rest.get_mut(..room)).unwrap_or_default();
            match self.reader.read(room) {
                Ok(0) => break,
                Ok(read) => self.ahead.end += read,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(self.buffer.get(self.ahead.clone()).unwrap_or_default())
    }

    /// Passes bytes that are ahead.
    fn advance(&mut self, bytes: usize) {
        let bytes = bytes.min(self.ahead.len());
        self.ahead.start += bytes;
        self.offset += bytes as u64;
    }

    /// Passes any number of bytes. Returns whether there were so many.
    fn pass(&mut self, bytes: u64) -> io::Result<bool> {
        let mut left = bytes;
        while left > 0 {
            let ahead = self.peek(1)?.len();
            if ahead == 0 {
                return Ok(false);
            }
            let passed = ahead.min(usize::try_from(left).unwrap_or(usize::MAX));
            self.advance(passed);
            left -= passed as u64;
        }
        Ok(true)
    }
}

fn refuse(reason: &str) -> CaptureError {
    let remedy = "convert it with `ffmpeg -i FILE -c:v mjpeg -q:v 3 out.avi`";
    CaptureError::BadFile(format!("the AVI file {reason}; {remedy}"))
}

/// The name of a chunk that begins here, and its number of bytes.
fn chunk(bytes: &[u8]) -> Option<([u8; 4], u32)> {
    let (id, rest) = bytes.split_first_chunk()?;
    Some((*id, u32::from_le_bytes(*rest.first_chunk()?)))
}

/// A frame's name is the number of its stream and `dc` or `db`.
fn is_frame_name(id: [u8; 4], stream: [u8; 2]) -> bool {
    let [tens, ones, d, kind] = id;
    [tens, ones] == stream && d == b'd' && matches!(kind, b'c' | b'b')
}

/// Whether another image follows the first one. An image within the header of the first one does not count.
fn has_second_image(frame: &[u8]) -> bool {
    let end = frame.windows(END_OF_IMAGE.len()).position(|bytes| bytes == END_OF_IMAGE);
    let rest = end.and_then(|at| frame.get(at..)).unwrap_or_default();
    rest.windows(START_OF_IMAGE.len()).any(|bytes| bytes == START_OF_IMAGE)
}

/// Whether a frame begins here that has an image, or was dropped. So many bytes are not found by chance.
fn begins_frame(bytes: &[u8], stream: [u8; 2]) -> bool {
    let Some((id, size)) = chunk(bytes) else { return false };
    is_frame_name(id, stream)
        && (size == 0 || bytes.get(CHUNK_BYTES..).is_some_and(|content| content.starts_with(START_OF_IMAGE)))
}

#[cfg(test)]
mod tests {
    use facewire_face::Pixels;
    use turbojpeg::Subsamp;

    use super::super::jpeg::tests::jpeg;
    use super::*;

    fn chunk(id: &[u8; 4], content: &[u8]) -> Vec<u8> {
        let padding = &[0][..content.len() % 2];
        [&id[..], &u32::try_from(content.len()).unwrap().to_le_bytes(), content, padding].concat()
    }

    fn list(id: &[u8; 4], kind: &[u8; 4], chunks: &[Vec<u8>]) -> Vec<u8> {
        chunk(id, &[&kind[..], &chunks.concat()].concat())
    }

    /// Returns the header of a film of 30 frames per second, in which stream 0 is sound and stream 1 is video.
    fn avi_header(width: u32, codec: &[u8; 4]) -> Vec<u8> {
        let zeros = [0; 56];
        let [one, rate, height] = [1_u32, 30, 8].map(u32::to_le_bytes);
        let video = [&b"vids"[..], codec, &zeros[..12], &one, &rate, &zeros[..28]].concat();
        let format = [&zeros[..4], &width.to_le_bytes(), &height, &zeros[..4], codec, &zeros[..20]].concat();
        let sound = [chunk(b"strh", &[&b"auds"[..], &zeros[..52]].concat()), chunk(b"strf", &zeros[..18])];
        let streams = [sound, [chunk(b"strh", &video), chunk(b"strf", &format)]];
        let lists = streams.map(|chunks| list(b"LIST", b"strl", &chunks)).concat();
        list(b"LIST", b"hdrl", &[chunk(b"avih", &zeros), lists])
    }

    /// Returns a complete film of 16 x 8 pixels with an index, and with sound between the frames.
    fn avi(frames: &[Vec<u8>]) -> Vec<u8> {
        let chunks = frames.iter().flat_map(|frame| [chunk(b"01dc", frame), chunk(b"00wb", &[1, 2, 3])]);
        let movi = list(b"LIST", b"movi", &chunks.collect::<Vec<_>>());
        list(b"RIFF", b"AVI ", &[avi_header(16, b"MJPG"), movi, chunk(b"idx1", &[0; 32])])
    }

    fn frame() -> Vec<u8> {
        let mut frame = jpeg(16, 8, Subsamp::Sub2x2);
        frame.resize(frame.len() | 1, 0);
        frame
    }

    fn open(bytes: &[u8]) -> Result<AviSource<&[u8]>, CaptureError> {
        AviSource::open(bytes, "film", FrameRate::FPS_30)
    }

    /// Returns the numbers of the intact frames, and the errors.
    fn play(bytes: &[u8]) -> (Vec<u64>, Vec<CaptureError>) {
        let mut numbers = Vec::new();
        let mut errors = Vec::new();
        let mut source = open(bytes).unwrap();
        loop {
            match source.next() {
                Ok(Some(frame)) => {
                    assert_eq!(frame.captured_us, FrameRate::FPS_30.stamp_us(frame.number));
                    numbers.push(frame.number);
                }
                Ok(None) => return (numbers, errors),
                Err(error) => errors.push(error),
            }
        }
    }

    fn position(film: &[u8], id: &[u8; 4]) -> usize {
        film.windows(4).rposition(|found| found == id).unwrap()
    }

    #[test]
    fn every_truncation_gives_the_frames_before_it_and_one_error_with_its_offset() {
        let film = avi(&[frame(), frame(), frame()]);
        assert_eq!(open(&film).unwrap().describe().to_string(), "film: MJPEG 16x8 at 30 fps");
        let starts: Vec<_> = film.windows(4).enumerate().filter(|(_, id)| id == b"01dc").map(|(at, _)| at).collect();
        let movi = starts[0];
        let index = position(&film, b"idx1");
        for length in 0..movi {
            assert!(open(&film[..length]).is_err_and(|error| error.to_string().contains("the AVI file")), "{length}");
        }
        for length in movi..index - 1 {
            let complete = starts.iter().filter(|&start| start + 8 + frame().len() <= length).count();
            let (numbers, errors) = play(&film[..length]);
            let place = format!("cut short at byte {length}, in frame {complete};");
            assert!(numbers.len() == complete && errors.len() == 1, "{length}: {errors:?}");
            assert!(errors[0].to_string().contains(&place), "{errors:?}");
        }
        for length in index - 1..=film.len() {
            let (_, errors) = play(&film[..length]);
            assert!(errors.is_empty(), "nothing is lost with padding and index: {length} of {index}: {errors:?}");
        }
    }

    #[test]
    fn a_frame_that_is_bad_or_too_large_is_an_error_and_one_that_was_dropped_is_none() {
        let broken = frame()[..100].to_vec();
        let huge = vec![0; 200_000];
        let dropped = Vec::new();
        let (numbers, errors) = play(&avi(&[frame(), broken, huge.clone(), dropped, frame()]));
        assert_eq!(numbers, [0, 4]);
        let [first, second] = &errors[..] else { unreachable!("{errors:?}") };
        assert!(matches!(first, CaptureError::Frame { number: 1, fault: FrameFault::Incomplete }));
        assert!(matches!(second, CaptureError::Frame { number: 2, fault: FrameFault::TooLarge }));
        let film = avi(&[huge]);
        let (_, errors) = play(&film[..film.len() - 1000]);
        assert!(errors[0].to_string().contains("cut short") && errors.len() == 1, "{errors:?}");
    }

    #[test]
    fn all_frames_are_read_whatever_sizes_riff_and_movi_state_and_so_are_all_parts_of_an_opendml_video() {
        let film = avi(&[frame(), frame(), frame()]);
        let movi = position(&film, b"movi");
        let index = position(&film, b"idx1");
        for size in [0, 4, 1000, 0x7fff_ffff, u32::MAX] {
            let mut film = film.clone();
            film[4..8].copy_from_slice(&size.to_le_bytes());
            film[movi - 4..movi].copy_from_slice(&size.to_le_bytes());
            for film in [&film[..], &film[..index]] {
                let (numbers, errors) = play(film);
                assert_eq!((numbers.as_slice(), errors.len()), (&[0, 1, 2][..], 0), "{size}: {errors:?}");
            }
        }
        let groups = list(b"LIST", b"rec ", &[chunk(b"01dc", &frame()), chunk(b"01dc", &frame())]);
        let second = list(b"RIFF", b"AVIX", &[list(b"LIST", b"movi", &[groups])]);
        let (numbers, errors) = play(&[avi(&[frame()]), second, chunk(b"01dc", &frame()), vec![0; 99]].concat());
        assert_eq!((numbers.as_slice(), errors.len()), (&[0, 1, 2, 3][..], 0), "{errors:?}");
    }

    /// Returns the film with `bytes` in place of those that `part` returns for its second frame.
    fn altered(film: &[u8], part: impl Fn(usize) -> Range<usize>, bytes: &[u8]) -> Vec<u8> {
        let second = film.windows(4).enumerate().filter(|(_, id)| id == b"01dc").nth(1).unwrap().0;
        let Range { start, end } = part(second);
        [&film[..start], bytes, &film[end..]].concat()
    }

    #[test]
    fn whatever_stands_between_frames_is_passed_over_and_counted_and_all_whole_frames_are_read() {
        let film = avi(&[frame(), frame(), frame()]);
        let length = frame().len() as u32;
        let unknown = chunk(b"abcd", &[7; 20]);
        let before = |bytes: &[u8]| altered(&film, |at| at..at, bytes);
        let size = |bytes: u32| altered(&film, |at| at + 4..at + 8, &bytes.to_le_bytes());
        let all = &[0, 1, 2][..];
        for (what, film, numbers, stray_bytes) in [
            ("stray bytes", before(b"stray bytes of odd length"), all, 25),
            ("zeros up to a boundary", before(&[0; 300]), all, 300),
            ("text that looks like a huge chunk", before(b"textTEXT"), all, 8),
            ("an unknown chunk", before(&unknown), all, 28),
            ("padding with an old frame", before(&chunk(b"JUNK", &chunk(b"01dc", &frame()))), all, 0),
            ("padding of 2 GB", before(b"JUNK\xff\xff\xff\x7f"), all, 0),
            (
                "padding to words of 4 bytes before a dropped frame",
                before(&[&[0; 3], &chunk(b"01dc", &[])[..]].concat()),
                &[0, 2, 3],
                3,
            ),
            ("zeros before a dropped frame", before(&[&[0; 300], &chunk(b"01dc", &[])[..]].concat()), &[0, 2, 3], 300),
            ("a sound chunk that is cut short", before(&[&b"00wb"[..], &[200, 0, 0, 0, 1, 2]].concat()), all, 0),
            ("stray bytes before sound", before(&[&[9; 5], &chunk(b"00wb", &[0; 40])[..]].concat()), all, 5),
            ("sound that ends with a digit", before(&chunk(b"00wb", b"1239")), all, 0),
            ("no padding", altered(&film, |at| at - 1..at, &[]), all, 0),
            ("a frame cut short", altered(&film, |at| at + 60..at + 8 + frame().len() + 1, &[]), &[0, 2], 0),
            ("a frame of no end", size(u32::MAX), all, 0),
            ("a frame of 2 GB", size(0x7fff_0000), all, 0),
            ("a size that counts the header", size(length + 8), all, 4),
            ("a size that was not filled in", size(0), all, 0),
            ("a name of another kind", altered(&film, |at| at + 2..at + 4, b"iv"), all, 0),
        ] {
            let (played, errors) = play(&film);
            assert_eq!(played, numbers, "{what}: {errors:?}");
            assert_eq!(errors.len(), 3 - numbers.len(), "{what}: {errors:?}");
            let mut source = open(&film).unwrap();
            while source.skip().unwrap() {}
            assert_eq!(source.take_tally().stray_bytes, stray_bytes, "{what}");
        }
    }

    #[test]
    fn the_images_decide_size_and_kind_and_the_main_header_gives_the_rate_that_the_stream_lacks() {
        let film = |header: Vec<u8>| {
            let movi = list(b"LIST", b"movi", &[chunk(b"01dc", &[]), chunk(b"01dc", &frame())]);
            list(b"RIFF", b"AVI ", &[header, movi])
        };
        let mut without_list = film(avi_header(16, b"MJPG"));
        let movi = position(&without_list, b"movi");
        without_list[movi - 8..movi + 4].fill(b' ');
        without_list[movi - 4..movi].fill(0xff);
        assert_eq!(play(&without_list).0, [1], "the list of the frames is damaged");
        for (width, codec) in [(8, b"MJPG"), (9000, b"mjpg"), (0, b"AVRn"), (16, b"dmb1"), (16, &[0; 4])] {
            let film = film(avi_header(width, codec));
            assert_eq!(open(&film).unwrap().describe().to_string(), "film: MJPEG 16x8 at 30 fps");
            assert_eq!(play(&film).0, [1]);
        }
        let mut film = film(avi_header(16, b"MJPG"));
        let main = position(&film, b"avih") + 8;
        let stream = film.windows(4).position(|id| id == b"vids").unwrap();
        film[main..main + 4].copy_from_slice(&100_000_u32.to_le_bytes());
        assert_eq!(open(&film).unwrap().describe().to_string(), "film: MJPEG 16x8 at 30 fps");
        film[stream + 20..stream + 28].fill(0);
        assert_eq!(open(&film).unwrap().describe().to_string(), "film: MJPEG 16x8 at 10 fps");
        film[main..main + 4].fill(0);
        let other = AviSource::open(&film[..], "film", FrameRate::new(25, 1).unwrap()).unwrap();
        assert_eq!(other.describe().to_string(), "film: MJPEG 16x8 at 25 fps");
    }

    #[test]
    fn a_frame_of_two_fields_shows_the_rows_of_the_first_one_twice_and_a_single_image_is_as_high_as_it_is() {
        for subsamp in [Subsamp::Sub2x2, Subsamp::Gray] {
            let field = jpeg(16, 3, subsamp);
            let film = |frame: &[u8]| {
                let movi = list(b"LIST", b"movi", &[chunk(b"01dc", frame)]);
                list(b"RIFF", b"AVI ", &[avi_header(16, b"MJPG"), movi])
            };
            let rows = |film: &[u8]| {
                let mut source = open(film).unwrap();
                let frame = source.next().unwrap().unwrap();
                let (Pixels::Planar { planes: [data, ..], strides: [stride, _], .. } | Pixels::Grey { data, stride }) =
                    frame.picture().unwrap().pixels()
                else {
                    unreachable!()
                };
                let height = frame.picture().unwrap().height();
                data.chunks(stride).take(height).map(<[u8]>::to_vec).collect::<Vec<_>>()
            };
            let single = rows(&film(&field));
            let both = rows(&film(&[&field[..], &field].concat()));
            assert_eq!((single.len(), both.len()), (3, 6));
            assert!(both.chunks(2).zip(&single).all(|(pair, row)| pair[0] == *row && pair[1] == *row), "{subsamp:?}");
            assert_eq!(rows(&film(&jpeg(16, 4, subsamp))).len(), 8, "half as high as the header says");
        }
    }

    /// Counts the reads that give something.
    struct Counted<'a> {
        bytes: &'a [u8],
        reads: usize,
    }

    impl Read for Counted<'_> {
        fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
            let count = self.bytes.read(room)?;
            self.reads += usize::from(count > 0);
            Ok(count)
        }
    }

    #[test]
    fn a_file_of_very_many_tiny_frames_that_state_large_sizes_is_read_in_large_parts() {
        let whole = avi(&[frame()]);
        let mut film = whole[..position(&whole, b"01dc")].to_vec();
        for _ in 0..150_000 {
            film.extend([&b"01dc"[..], &0x7fff_ffff_u32.to_le_bytes(), START_OF_IMAGE, &[0; 8]].concat());
        }
        let reader = Counted { bytes: &film, reads: 0 };
        let mut source = AviSource::open(reader, "film", FrameRate::FPS_30).unwrap();
        let frames = std::iter::from_fn(|| source.skip().is_ok_and(|is_frame| is_frame).then_some(())).count();
        assert_eq!(frames, 149_999, "the last one goes on behind the end");
        let fewest = film.len() / READ_BYTES;
        assert!(source.riff.reader.reads < 2 * fewest, "{} reads", source.riff.reader.reads);
    }

    #[test]
    fn other_files_are_refused_with_their_reason() {
        let movi = list(b"LIST", b"movi", &[]);
        let film = |header| list(b"RIFF", b"AVI ", &[header, movi.clone()]);
        let table = [
            (list(b"RIFF", b"WAVE", &[chunk(b"data", &[0; 9])]), "is not an AVI file"),
            (film(avi_header(16, b"H264")), "is not Motion-JPEG, but `H264`"),
            (film(chunk(b"JUNK", &[])), "has no video stream"),
            (film(avi_header(5000, b"MJPG")), "5000x8"),
            (list(b"RIFF", b"AVI ", &[avi_header(16, b"MJPG")]), "has no pictures"),
        ];
        for (bytes, reason) in table {
            let error = open(&bytes).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn a_damaged_byte_causes_neither_a_panic_nor_an_endless_film() {
        let film = avi(&[frame(), frame()]);
        for at in 0..film.len() {
            let mut damaged = film.clone();
            damaged[at] ^= 0xff;
            let Ok(mut source) = open(&damaged) else { continue };
            let items = std::iter::from_fn(|| source.next().map(|frame| frame.map(|_| ())).transpose());
            assert!(items.take(10).count() < 10);
        }
    }
}
