//! Decodes JPEG into planar `YCbCr` or packed RGB, without colour conversion, in memory of fixed capacity.
//!
//! The header is checked before the image is decoded, so no image can write past the buffer: libjpeg-turbo lays out the
//! planes by the subsampling of the image, and the buffer holds the announced size at 4:4:4. libjpeg-turbo takes the
//! standard Huffman tables for an image that has none.
//!
//! An image that libjpeg-turbo warns of is cleaned first ([`clean`]) and then must decode without a warning.
//!
//! Decoding allocates on the Rust heap only where libjpeg-turbo gives a message: for images that are refused, and for
//! the first image of a camera that had to be cleaned. The next [`CLEANED_AT_ONCE`] images are cleaned at once, without
//! first trying to decode them as they came.

mod cleaner;

use std::mem::take;

use turbojpeg::{Colorspace, DecompressHeader, Decompressor, Image, PixelFormat, Subsamp, YuvImage};

use self::cleaner::clean;
pub(super) use self::cleaner::{image_length, image_size};
use super::{CaptureError, FrameFault};
use facewire_face::{MAX_SIDE_PX, Picture, Pixels};

/// Largest number of scans of a progressive image. The usual script has 10; an image of thousands is built to keep a
/// decoder busy.
const MAX_SCANS: u32 = 20;
/// Largest number of columns or rows that share one chroma sample (4:1:1, 4:4:1).
const MAX_SUBSAMPLING: usize = 4;
/// Bytes of a pixel of an image whose components are red, green and blue.
const RGB_BYTES: usize = 3;
/// Images that are cleaned at once after one that needed it. Cameras that send stray bytes do so in most of their images.
const CLEANED_AT_ONCE: u32 = 300;
pub(super) const START_OF_IMAGE: &[u8] = &[0xff, 0xd8];
pub(super) const END_OF_IMAGE: &[u8] = &[0xff, 0xd9];

/// Decodes JPEG images of one size.
#[derive(Debug)]
pub struct JpegDecoder {
    decompressor: Decompressor,
    planes: Vec<u8>,
    /// Size of an image.
    size: [usize; 2],
    /// How often each of its rows is in the picture.
    repeats: usize,
    decoded: Option<DecompressHeader>,
    /// Memory for an image that was cleaned.
    clean: Vec<u8>,
    clean_at_once: u32,
}

impl JpegDecoder {
    pub fn new(width: usize, height: usize) -> Result<Self, CaptureError> {
        if ![width, height].iter().all(|side| (1..=MAX_SIDE_PX).contains(side)) {
            return Err(CaptureError::picture_size(width, height));
        }
        let no_memory = |_| CaptureError::Unusable("the JPEG decoder could not start; free some memory".to_owned());
        let [columns, rows] = [width, height].map(|side| side.next_multiple_of(MAX_SUBSAMPLING));
        let decompressor = decompressor().map_err(no_memory)?;
        let planes = vec![0; 3 * columns * rows];
        let size = [width, height];
        let clean = Vec::new();
        let mut decoder = Self { decompressor, planes, size, repeats: 1, decoded: None, clean, clean_at_once: 0 };
        decoder.clean.reserve_exact(decoder.max_jpeg_bytes());
        Ok(decoder)
    }

    /// Makes a decoder for images of every second row of a picture. The picture has each of their rows twice.
    pub(super) fn of_fields(width: usize, height: usize) -> Result<Self, CaptureError> {
        let decoder = Self::new(width, 2 * height)?;
        Ok(Self { size: [width, height], repeats: 2, ..decoder })
    }

    /// Width and height of the picture.
    pub(super) fn picture_size(&self) -> [usize; 2] {
        let [width, height] = self.size;
        [width, self.repeats * height]
    }

    /// Largest number of bytes that an image of this size can sensibly have. Sources bound their buffers by it.
    pub fn max_jpeg_bytes(&self) -> usize {
        self.planes.len() + 64 * 1024
    }

    /// Decodes one image, which [`JpegDecoder::picture`] then returns. After an error there is no picture.
    pub fn decode(&mut self, jpeg: &[u8]) -> Result<(), FrameFault> {
        self.decoded = None;
        if !jpeg.starts_with(START_OF_IMAGE) {
            return Err(FrameFault::NotJpeg);
        }
        let is_cleaned_at_once = self.clean_at_once > 0;
        if !is_cleaned_at_once {
            match self.decode_strictly(jpeg) {
                Err(FrameFault::Corrupt) => {}
                tried => return tried,
            }
        }
        match clean(jpeg, &mut self.clean) {
            Ok(()) => {
                let had_need = !jpeg.starts_with(&self.clean);
                self.clean_at_once = if had_need { CLEANED_AT_ONCE } else { self.clean_at_once.saturating_sub(1) };
                let clean = take(&mut self.clean);
                let decoded = self.decode_strictly(&clean);
                self.clean = clean;
                decoded
            }
            // The cleaner knows only the images of a camera, and libjpeg-turbo others, too.
            Err(fault) if is_cleaned_at_once => {
                self.clean_at_once = 0;
                self.decode_strictly(jpeg).map_err(|tried| if tried == FrameFault::Corrupt { fault } else { tried })
            }
            Err(fault) => Err(fault),
        }
    }

    pub fn picture(&self) -> Option<Picture<'_>> {
        let [width, height] = self.picture_size();
        Picture::new(width, height, self.pixels()?, true)
    }

    /// Decodes an image, and refuses every image that libjpeg-turbo warns about.
    fn decode_strictly(&mut self, jpeg: &[u8]) -> Result<(), FrameFault> {
        let header = self.decompressor.read_header(jpeg).map_err(|_| self.corrupt())?;
        self.check(&header)?;
        let [width, height] = self.size;
        let pixels = self.planes.as_mut_slice();
        let decoded = if header.colorspace == Colorspace::RGB {
            let image = Image { pixels, width, pitch: RGB_BYTES * width, height, format: PixelFormat::RGB };
            self.decompressor.decompress(jpeg, image)
        } else {
            let image = YuvImage { pixels, width, align: 1, height, subsamp: header.subsamp };
            self.decompressor.decompress_to_yuv(jpeg, image)
        };
        decoded.map_err(|_| self.corrupt())?;
        if self.repeats > 1 {
            self.double_rows(&header);
        }
        self.decoded = Some(header);
        Ok(())
    }

    /// Shows every row of all planes twice, the last one first, so that no row is overwritten before it was copied.
    fn double_rows(&mut self, header: &DecompressHeader) {
        let planes = layout(header);
        let mut at: usize = planes.iter().map(|[stride, rows]| stride * rows).sum();
        for [stride, rows] in planes.into_iter().rev() {
            for _ in 0..rows {
                at -= stride;
                self.planes.copy_within(at..at + stride, 2 * at + stride);
                self.planes.copy_within(at..at + stride, 2 * at);
            }
        }
    }

    /// Replaces the instance of libjpeg-turbo: after a bad header the old one would continue within that header, and
    /// refuse every later image.
    fn corrupt(&mut self) -> FrameFault {
        if let Ok(fresh) = decompressor() {
            self.decompressor = fresh;
        }
        FrameFault::Corrupt
    }

    /// Refuses an image that does not fit the buffer, or that no camera makes.
    fn check(&self, header: &DecompressHeader) -> Result<(), FrameFault> {
        let &DecompressHeader { width, height, subsamp, colorspace, .. } = header;
        if [width, height] != self.size {
            return Err(FrameFault::WrongSize { width, height });
        }
        let unsupported = |kind| Err(FrameFault::Unsupported(kind));
        match colorspace {
            _ if header.is_lossless => unsupported("a lossless JPEG image"),
            _ if header.is_arithmetic => unsupported("a JPEG image with arithmetic coding"),
            Colorspace::CMYK | Colorspace::YCCK => unsupported("a CMYK image"),
            Colorspace::YCbCr if chroma_shift(subsamp).is_none() => {
                unsupported("a JPEG image with an unusual chroma subsampling")
            }
            _ => Ok(()),
        }
    }

    fn pixels(&self) -> Option<Pixels<'_>> {
        let header = self.decoded?;
        let data = self.planes.as_slice();
        let [[stride, rows], [chroma_stride, chroma_rows], _] = layout(&header);
        match header.colorspace {
            Colorspace::Gray => Some(Pixels::Grey { data, stride }),
            Colorspace::RGB => Some(Pixels::Packed { data, stride, step: RGB_BYTES, rgb: [0, 1, 2] }),
            _ => {
                let (luma, rest) = data.split_at_checked(stride * rows * self.repeats)?;
                let (cb, cr) = rest.split_at_checked(chroma_stride * chroma_rows * self.repeats)?;
                let strides = [stride, chroma_stride];
                Some(Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift: chroma_shift(header.subsamp)? })
            }
        }
    }
}

/// The stride and the number of rows of each plane of an image as it is decoded.
fn layout(header: &DecompressHeader) -> [[usize; 2]; 3] {
    let &DecompressHeader { width, height, subsamp, .. } = header;
    match header.colorspace {
        Colorspace::Gray => [[width, height], [0; 2], [0; 2]],
        Colorspace::RGB => [[RGB_BYTES * width, height], [0; 2], [0; 2]],
        _ => {
            let [columns, rows] = [subsamp.width(), subsamp.height()];
            let chroma = [width.div_ceil(columns), height.div_ceil(rows)];
            [[width.next_multiple_of(columns), height.next_multiple_of(rows)], chroma, chroma]
        }
    }
}

fn decompressor() -> turbojpeg::Result<Decompressor> {
    let mut decompressor = Decompressor::new()?;
    decompressor.set_scan_limit(MAX_SCANS)?;
    Ok(decompressor)
}

/// Returns the powers of two by which chroma is narrower and lower than luma.
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

#[cfg(test)]
pub(super) mod tests;
