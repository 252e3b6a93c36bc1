//! Motion-JPEG in AVI files (RIFF, and `OpenDML` files of several RIFF parts), read as a stream.
//!
//! The reader does not use the sizes of lists, so it can read a file whose writer was stopped before it filled them in. It
//! takes the first video stream, and skips sound, indexes and padding. An empty frame chunk stands for a frame that the
//! recorder dropped; it counts in the numbers and times of the following frames. Crates for AVI seek, which a pipe and a
//! file without an index do not allow.
//!
//! Limits: one chunk header and one frame are in memory, and the size of a frame is bounded by that of the picture.

use std::io::{self, ErrorKind, Read, Seek};
use std::mem::take;

use super::jpeg::JpegDecoder;
use super::{CaptureError, Content, Description, Frame, FrameFault, FrameRate, Source};

/// Number of bytes of a header chunk that are read.
const FIELD_BYTES: usize = 64;

#[derive(Debug)]
pub struct AviSource<R> {
    riff: Riff<R>,
    origin: String,
    /// Number of the first video stream.
    stream: u8,
    rate: FrameRate,
    decoder: JpegDecoder,
    jpeg: Box<[u8]>,
    /// Length of the current image, which may be too large for `jpeg`.
    jpeg_bytes: usize,
    /// Number of frames that were read, damaged and dropped ones among them.
    read: u64,
    ended: bool,
    /// How a film that is repeated for ever begins again. Numbers and times continue to grow.
    rewind: Option<fn(&mut R) -> io::Result<()>>,
}

impl<R: Read> AviSource<R> {
    /// Reads the header. `origin` names the source to the operator. A film that states no rate has the given one.
    pub fn open(reader: R, origin: &str, rate: FrameRate) -> Result<Self, CaptureError> {
        let mut riff = Riff { reader, offset: 0, end: None, has_padding: false };
        let (stream, [width, height], stated) = riff.read_header()?;
        let decoder = JpegDecoder::new(width, height)?;
        let jpeg = vec![0; decoder.max_jpeg_bytes()].into_boxed_slice();
        Ok(Self {
            riff,
            origin: origin.to_owned(),
            stream,
            rate: stated.unwrap_or(rate),
            decoder,
            jpeg,
            jpeg_bytes: 0,
            read: 0,
            ended: false,
            rewind: None,
        })
    }

    /// Makes the film begin again at its end, for ever.
    pub(super) fn repeated(self) -> Self
    where
        R: Seek,
    {
        Self { rewind: Some(R::rewind), ..self }
    }

    /// Reads the next frame that was not dropped into `self.jpeg`. Returns `false` at the end.
    fn read_frame(&mut self) -> io::Result<bool> {
        // A frame's name is the number of its stream and `dc` or `db`.
        let name = [b'0' + self.stream / 10, b'0' + self.stream % 10, b'd'];
        while let Some((id, bytes)) = self.riff.next_item()? {
            let Some(bytes) = bytes else { continue };
            let [tens, ones, d, kind] = id;
            if [tens, ones, d] != name || !matches!(kind, b'c' | b'b') {
                match self.riff.skip(bytes.into()) {
                    // A file that is cut off within its index has all of its frames.
                    Err(error) if error.kind() == ErrorKind::UnexpectedEof && id == *b"idx1" => return Ok(false),
                    skipped => skipped?,
                }
                continue;
            }
            self.jpeg_bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
            match self.jpeg.get_mut(..self.jpeg_bytes) {
                Some(jpeg) => self.riff.read_exact(jpeg)?,
                None => self.riff.skip(bytes.into())?,
            }
            self.read += 1;
            if bytes > 0 {
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
        let jpeg = self.jpeg.get(..self.jpeg_bytes).ok_or(bad(FrameFault::TooLarge))?;
        self.decoder.decode(jpeg).map_err(bad)?;
        let picture = self.decoder.picture().ok_or(bad(FrameFault::Layout))?;
        Ok(Some(Frame { content: Content::Picture(picture), captured_us: self.rate.stamp_us(number), number }))
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        if self.ended {
            return Ok(false);
        }
        let mut found = self.read_frame();
        if let (Ok(false), Some(rewind)) = (&found, self.rewind) {
            rewind(&mut self.riff.reader)?;
            self.riff.offset = 0;
            self.riff.end = None;
            self.riff.has_padding = false;
            self.riff.read_header()?;
            found = self.read_frame();
        }
        self.ended = !matches!(found, Ok(true));
        found.map_err(|error| CaptureError::cut_short(error, self.read, self.riff.offset))
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.decoder.size;
        Description { origin: &self.origin, format: "MJPEG", width, height, rate: Some(self.rate) }
    }
}

/// Reads the chunks of a RIFF stream one after the other, without seeking.
///
/// A `RIFF` or a `LIST` holds chunks in turn. The reader reports it and continues with its content, whatever its size. It
/// only remembers where a `RIFF` ends, to tell a complete file from one that is cut off between two chunks.
#[derive(Debug)]
struct Riff<R> {
    reader: R,
    offset: u64,
    /// Offset at which the current `RIFF` ends, if it states a size.
    end: Option<u64>,
    /// Whether a byte of padding comes next, as after a chunk of odd length.
    has_padding: bool,
}

impl<R: Read> Read for Riff<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let bytes = self.reader.read(buffer)?;
        self.offset += bytes as u64;
        Ok(bytes)
    }
}

impl<R: Read> Riff<R> {
    /// Reads the header, up to the first frame. Returns the number of the first video stream, the size of its pictures and its
    /// rate. The offsets are those of `AVISTREAMHEADER` and `BITMAPINFOHEADER`.
    fn read_header(&mut self) -> Result<(u8, [usize; 2], Option<FrameRate>), CaptureError> {
        let refuse = |reason| {
            let remedy = "convert it with `ffmpeg -i FILE -c:v mjpeg -q:v 3 out.avi`";
            CaptureError::BadFile(format!("the AVI file {reason}; {remedy}"))
        };
        let early = |error: io::Error| match error.kind() {
            ErrorKind::UnexpectedEof => refuse("ends within its header"),
            _ => error.into(),
        };
        if self.next_item().map_err(early)? != Some((*b"AVI ", None)) {
            return Err(refuse("is not an AVI file"));
        }
        let mut streams = 0_u8;
        let mut video = None;
        let mut picture = None;
        loop {
            let (id, bytes) = match self.next_item().map_err(early)?.ok_or_else(|| refuse("has no pictures"))? {
                (kind, None) if kind == *b"movi" => break,
                (_, None) => continue,
                (id, Some(bytes)) => (id, bytes),
            };
            let length = FIELD_BYTES.min(bytes as usize);
            let mut fields = [0; FIELD_BYTES];
            self.read_exact(fields.get_mut(..length).unwrap_or_default()).map_err(early)?;
            self.skip(u64::from(bytes) - length as u64).map_err(early)?;
            let word = |at: usize| fields.get(at..).and_then(<[u8]>::first_chunk).copied().unwrap_or_default();
            let number = |at| u32::from_le_bytes(word(at));
            if id == *b"strh" {
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
        match video.zip(picture) {
            Some(((stream @ ..=99, rate), (size, codec))) if [*b"MJPG", *b"JPEG"].contains(&codec) => {
                Ok((stream, size, rate))
            }
            Some(((..=99, _), _)) => Err(refuse("is not Motion-JPEG")),
            _ => Err(refuse("has no video stream")),
        }
    }

    /// Reads the beginning of the next list or chunk. Returns the kind of a list, or the name of a chunk and its number of
    /// bytes, which are to be read or skipped. Returns `None` at the proper end of the stream.
    fn next_item(&mut self) -> io::Result<Option<([u8; 4], Option<u32>)>> {
        if take(&mut self.has_padding) {
            self.skip_up_to(1)?;
        }
        let start = self.offset;
        let is_complete = self.end.is_none_or(|end| start >= end);
        let mut header = [[0; 4]; 2];
        if let Err(error) = self.read_exact(header.as_flattened_mut()) {
            let is_end = is_complete && (self.offset == start || self.end.is_some());
            return if is_end && error.kind() == ErrorKind::UnexpectedEof { Ok(None) } else { Err(error) };
        }
        let [id, size] = header;
        let bytes = u32::from_le_bytes(size);
        match &id {
            b"RIFF" => {
                // A RIFF of size 0 or of the largest size was not finished, so its end is not known.
                let is_known = bytes != 0 && bytes != u32::MAX;
                self.end = is_known.then_some(self.offset + u64::from(bytes));
            }
            // Data behind the last RIFF is not part of the film.
            _ if is_complete && self.end.is_some() => return Ok(None),
            b"LIST" => {}
            _ => {
                self.has_padding = bytes % 2 == 1;
                return Ok(Some((id, Some(bytes))));
            }
        }
        let mut kind = [0; 4];
        self.read_exact(&mut kind)?;
        Ok(Some((kind, None)))
    }

    fn skip(&mut self, bytes: u64) -> io::Result<()> {
        let is_whole = self.skip_up_to(bytes)? == bytes;
        is_whole.then_some(()).ok_or(ErrorKind::UnexpectedEof.into())
    }

    fn skip_up_to(&mut self, bytes: u64) -> io::Result<u64> {
        io::copy(&mut self.take(bytes), &mut io::sink())
    }
}

#[cfg(test)]
mod tests {
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
        for length in movi..index + 8 {
            let complete = starts.iter().filter(|&start| start + 8 + frame().len() <= length).count();
            let (numbers, errors) = play(&film[..length]);
            let place = format!("cut short at byte {length}, in frame {complete};");
            assert!(numbers.len() == complete && errors.len() == 1, "{length}: {errors:?}");
            assert!(errors[0].to_string().contains(&place), "{errors:?}");
        }
        for length in index + 8..=film.len() {
            assert_eq!(play(&film[..length]).1.len(), 0, "nothing is lost with the index");
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
    fn a_recording_without_sizes_and_all_parts_of_an_opendml_film_are_read_and_data_behind_them_is_not() {
        let mut film = avi(&[frame(), frame()]);
        let movi = position(&film, b"movi");
        let index = position(&film, b"idx1");
        film[4..8].fill(0);
        film[movi - 4..movi].fill(0xff);
        let groups = list(b"LIST", b"rec ", &[chunk(b"01dc", &frame()), chunk(b"01dc", &frame())]);
        let second = list(b"RIFF", b"AVIX", &[list(b"LIST", b"movi", &[groups])]);
        let open_dml = [avi(&[frame()]), second, chunk(b"01dc", &frame())].concat();
        for (film, frames) in [(&film[..index], &[0, 1][..]), (&open_dml, &[0, 1, 2])] {
            let (numbers, errors) = play(film);
            assert_eq!((numbers.as_slice(), errors.len()), (frames, 0));
        }
    }

    #[test]
    fn other_files_are_refused_with_their_reason() {
        let movi = list(b"LIST", b"movi", &[]);
        let film = |header| list(b"RIFF", b"AVI ", &[header, movi.clone()]);
        let table = [
            (list(b"RIFF", b"WAVE", &[chunk(b"data", &[0; 9])]), "is not an AVI file"),
            (film(avi_header(16, b"H264")), "is not Motion-JPEG"),
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
