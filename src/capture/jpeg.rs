//! JPEG to planar YCbCr, without colour conversion, into memory of fixed capacity.
//!
//! The header is read and checked before anything is decoded, so no image can write past the buffer: libjpeg-turbo
//! lays the planes out by the image's own subsampling, and the buffer holds the announced size at 4:4:4.
//! Cameras that leave out the Huffman tables are served: libjpeg-turbo then takes the standard ones.
//!
//! Rust's heap is not touched by a good frame; a corrupt one costs libjpeg-turbo's message, freed at once.

use turbojpeg::{Colorspace, DecompressHeader, Decompressor, Error, Subsamp, YuvImage};

use super::{CaptureError, FrameFault, MAX_SIDE_PX, Picture, Pixels};

/// Scans of a progressive image. The usual script has 10; an image of thousands is built to keep a decoder busy.
const MAX_SCANS: u32 = 20;
/// Largest number of columns or rows that share one chroma sample (4:1:1, 4:4:1).
const MAX_SUBSAMPLING: usize = 4;
/// Stray bytes before the end marker that are forgiven: many webcams leave a few.
const MAX_STRAY_BYTES: u32 = 16;
const START_OF_IMAGE: &[u8] = &[0xff, 0xd8];
const END_OF_IMAGE: &[u8] = &[0xff, 0xd9];

/// Decodes JPEG images of one size.
#[derive(Debug)]
pub struct JpegDecoder {
    decompressor: Decompressor,
    planes: Vec<u8>,
    size: [usize; 2],
    decoded: Option<Subsamp>,
}

impl JpegDecoder {
    /// A decoder for images of `width` x `height` pixels.
    ///
    /// # Errors
    /// [`CaptureError::PictureSize`] beyond [`MAX_SIDE_PX`], [`CaptureError::Decoder`] without memory.
    pub fn new(width: usize, height: usize) -> Result<Self, CaptureError> {
        if !(1..=MAX_SIDE_PX).contains(&width) || !(1..=MAX_SIDE_PX).contains(&height) {
            return Err(CaptureError::PictureSize { width, height });
        }
        let decompressor = decompressor().map_err(|_| CaptureError::Decoder)?;
        let padded = |side: usize| side.next_multiple_of(MAX_SUBSAMPLING);
        let planes = vec![0; 3 * padded(width) * padded(height)];
        Ok(Self { decompressor, planes, size: [width, height], decoded: None })
    }

    /// Most bytes that an image of this size can sensibly have; sources bound their buffers by it.
    #[must_use]
    pub fn max_jpeg_bytes(&self) -> usize {
        self.planes.len() + 64 * 1024
    }

    /// Decodes one image; [`JpegDecoder::picture`] then shows it. After an error there is no picture.
    ///
    /// # Errors
    /// What is wrong with the image.
    pub fn decode(&mut self, jpeg: &[u8]) -> Result<(), FrameFault> {
        self.decoded = None;
        let jpeg = trimmed(jpeg)?;
        let subsamp = self.read_header(jpeg)?;
        let [width, height] = self.size;
        let pixels = self.planes.as_mut_slice();
        let image = YuvImage { pixels, width, align: 1, height, subsamp };
        match self.decompressor.decompress_to_yuv(jpeg, image) {
            Err(error) if !is_harmless(&error) => Err(self.corrupt()),
            _ => {
                self.decoded = Some(subsamp);
                Ok(())
            }
        }
    }

    fn read_header(&mut self, jpeg: &[u8]) -> Result<Subsamp, FrameFault> {
        match self.decompressor.read_header(jpeg) {
            Ok(header) => self.check(&header).map(|()| header.subsamp),
            Err(_) => Err(self.corrupt()),
        }
    }

    /// Takes a fresh instance of libjpeg-turbo: after a bad header the old one would go on inside that header
    /// and refuse every later image.
    fn corrupt(&mut self) -> FrameFault {
        if let Ok(fresh) = decompressor() {
            self.decompressor = fresh;
        }
        FrameFault::Corrupt
    }

    /// The picture decoded last.
    #[must_use]
    pub fn picture(&self) -> Option<Picture<'_>> {
        let [width, height] = self.size;
        let pixels = self.pixels(self.decoded?)?;
        Picture::new(width, height, pixels, true)
    }

    /// Refuses what does not fit the buffer or is no camera picture.
    fn check(&self, header: &DecompressHeader) -> Result<(), FrameFault> {
        let &DecompressHeader { width, height, subsamp, colorspace, .. } = header;
        if [width, height] != self.size {
            return Err(FrameFault::WrongSize { width, height });
        }
        let grey = subsamp == Subsamp::Gray && colorspace == Colorspace::Gray;
        let colour = chroma_shift(subsamp).is_some() && colorspace == Colorspace::YCbCr;
        let camera_like = (grey || colour) && !header.is_lossless && !header.is_arithmetic;
        camera_like.then_some(()).ok_or(FrameFault::Layout)
    }

    fn pixels(&self, subsamp: Subsamp) -> Option<Pixels<'_>> {
        let [width, height] = self.size;
        if subsamp == Subsamp::Gray {
            return Some(Pixels::Grey { data: &self.planes, stride: width });
        }
        let (columns, rows) = (subsamp.width(), subsamp.height());
        let strides = [width.next_multiple_of(columns), width.div_ceil(columns)];
        let [stride, chroma_stride] = strides;
        let (luma, rest) = self.planes.split_at_checked(stride * height.next_multiple_of(rows))?;
        let (cb, cr) = rest.split_at_checked(chroma_stride * height.div_ceil(rows))?;
        Some(Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift: chroma_shift(subsamp)? })
    }
}

fn decompressor() -> turbojpeg::Result<Decompressor> {
    let mut decompressor = Decompressor::new()?;
    decompressor.set_scan_limit(MAX_SCANS)?;
    Ok(decompressor)
}

/// Powers of two by which chroma is narrower and lower.
fn chroma_shift(subsamp: Subsamp) -> Option<[u8; 2]> {
    match subsamp {
        Subsamp::None => Some([0, 0]),
        Subsamp::Sub2x1 => Some([1, 0]),
        Subsamp::Sub2x2 => Some([1, 1]),
        Subsamp::Sub1x2 => Some([0, 1]),
        Subsamp::Sub4x1 => Some([2, 0]),
        Subsamp::Sub1x4 => Some([0, 2]),
        _ => None,
    }
}

/// The image from its start marker to its end marker, without the padding that some cameras send.
fn trimmed(jpeg: &[u8]) -> Result<&[u8], FrameFault> {
    if !jpeg.starts_with(START_OF_IMAGE) {
        return Err(FrameFault::NotJpeg);
    }
    let end = jpeg.windows(2).rposition(|pair| pair == END_OF_IMAGE).ok_or(FrameFault::Incomplete)?;
    jpeg.get(..end + END_OF_IMAGE.len()).ok_or(FrameFault::Incomplete)
}

/// Whether the image is whole all the same: only a few bytes too many before the end marker.
fn is_harmless(error: &Error) -> bool {
    let Error::TurboJpegError(text) = error else {
        return false;
    };
    let count = text
        .strip_prefix("Corrupt JPEG data: ")
        .and_then(|text| text.strip_suffix(" extraneous bytes before marker 0xd9"));
    count.and_then(|count| count.parse().ok()).is_some_and(|count: u32| count <= MAX_STRAY_BYTES)
}

#[cfg(test)]
mod tests;
