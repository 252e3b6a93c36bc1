//! Pictures and files for the tests of this module.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::trivially_copy_pass_by_ref)]

use turbojpeg::{Compressor, Subsamp, YuvImage, yuv_pixels_len};

/// Returns a smooth picture. Each plane has another slope, so that tests notice a swapped or shifted plane.
pub fn slopes(width: usize, height: usize, subsamp: Subsamp) -> YuvImage<Vec<u8>> {
    let length = yuv_pixels_len(width, 1, height, subsamp).unwrap();
    let mut image = YuvImage { pixels: vec![0; length], width, align: 1, height, subsamp };
    let luma_bytes = image.y_width() * image.y_height();
    let (luma_width, chroma_width) = (image.y_width(), image.uv_width().max(1));
    let chroma_bytes = (length - luma_bytes) / 2;
    for (at, sample) in image.pixels.iter_mut().enumerate() {
        let value = match at.checked_sub(luma_bytes) {
            None => 40 + at % luma_width + at / luma_width,
            Some(at) if at < chroma_bytes => 100 + at % chroma_width,
            Some(at) => 200 - (at - chroma_bytes) / chroma_width,
        };
        *sample = u8::try_from(value).unwrap();
    }
    image
}

/// Returns [`slopes`] as a JPEG image of the best quality.
pub fn jpeg(width: usize, height: usize, subsamp: Subsamp) -> Vec<u8> {
    let mut compressor = Compressor::new().unwrap();
    compressor.set_quality(100).unwrap();
    compressor.compress_yuv_to_vec(slopes(width, height, subsamp).as_deref()).unwrap()
}

/// Returns a chunk with its padding.
pub fn chunk(id: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let mut chunk = [&id[..], &u32::try_from(content.len()).unwrap().to_le_bytes(), content].concat();
    if content.len() % 2 == 1 {
        chunk.push(0);
    }
    chunk
}

/// Returns a `LIST` or `RIFF`.
pub fn list(id: &[u8; 4], kind: &[u8; 4], chunks: &[Vec<u8>]) -> Vec<u8> {
    chunk(id, &[&kind[..], &chunks.concat()].concat())
}

/// Returns the header of a film of 30 frames per second, in which stream 0 is sound and stream 1 is video.
pub fn avi_header(width: u32, height: u32, codec: &[u8; 4]) -> Vec<u8> {
    let sound = chunk(b"strh", &[&b"auds"[..], &[0; 52]].concat());
    let mut video = [&b"vids"[..], codec, &[0; 48]].concat();
    video[20..24].copy_from_slice(&1_u32.to_le_bytes());
    video[24..28].copy_from_slice(&30_u32.to_le_bytes());
    let mut format = [0; 40];
    format[4..8].copy_from_slice(&width.to_le_bytes());
    format[8..12].copy_from_slice(&height.to_le_bytes());
    format[16..20].copy_from_slice(codec);
    let streams = [
        list(b"LIST", b"strl", &[sound, chunk(b"strf", &[0; 18])]),
        list(b"LIST", b"strl", &[chunk(b"strh", &video), chunk(b"strf", &format)]),
    ];
    list(b"LIST", b"hdrl", &[vec![chunk(b"avih", &[0; 56])], streams.to_vec()].concat())
}

/// Returns a complete file with an index, and with sound between the frames.
pub fn avi(width: u32, height: u32, frames: &[Vec<u8>]) -> Vec<u8> {
    let chunks = frames.iter().flat_map(|frame| [chunk(b"01dc", frame), chunk(b"00wb", &[1, 2, 3])]);
    let movi = list(b"LIST", b"movi", &chunks.collect::<Vec<_>>());
    list(b"RIFF", b"AVI ", &[avi_header(width, height, b"MJPG"), movi, chunk(b"idx1", &[0; 32])])
}
