#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

use super::super::testing::{jpeg, slopes};
use super::*;

const WIDTH: usize = 37;
const HEIGHT: usize = 21;
const COLOUR: [Subsamp; 6] =
    [Subsamp::None, Subsamp::Sub2x1, Subsamp::Sub2x2, Subsamp::Sub1x2, Subsamp::Sub4x1, Subsamp::Sub1x4];

fn decoder() -> JpegDecoder {
    JpegDecoder::new(WIDTH, HEIGHT).unwrap()
}

fn worst(a: &[u8], b: &[u8]) -> u8 {
    a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

/// The segments of `jpeg` whose marker is not `left_out`, up to the scan, which stays.
fn without(jpeg: &[u8], left_out: u8) -> Vec<u8> {
    let (mut out, mut at) = (jpeg[..2].to_vec(), 2);
    while jpeg[at + 1] != 0xda {
        let next = at + 2 + usize::from(jpeg[at + 2]) * 256 + usize::from(jpeg[at + 3]);
        if jpeg[at + 1] != left_out {
            out.extend_from_slice(&jpeg[at..next]);
        }
        at = next;
    }
    out.extend_from_slice(&jpeg[at..]);
    out
}

#[test]
fn every_chroma_subsampling_is_decoded_within_2_of_the_original() {
    for subsamp in COLOUR {
        let mut decoder = decoder();
        decoder.decode(&jpeg(WIDTH, HEIGHT, subsamp)).unwrap();
        let picture = decoder.picture().unwrap();
        assert!(picture.full_range);
        let Pixels::Planar { planes, strides, chroma_shift } = picture.pixels else { panic!("{subsamp:?}") };
        let truth = slopes(WIDTH, HEIGHT, subsamp);
        assert_eq!(strides, [truth.y_width(), truth.uv_width()]);
        assert_eq!(chroma_shift.map(|shift| 1 << shift), [subsamp.width(), subsamp.height()]);
        let luma_bytes = truth.y_width() * truth.y_height();
        let chroma_bytes = truth.uv_width() * truth.uv_height();
        let (luma, chroma) = truth.pixels.split_at(luma_bytes);
        assert!(worst(luma, planes[0]) <= 2, "{subsamp:?}");
        assert!(worst(&chroma[..chroma_bytes], planes[1]) <= 2, "{subsamp:?}");
        assert!(worst(&chroma[chroma_bytes..], planes[2]) <= 2, "{subsamp:?}");
    }
}

#[test]
fn grey_images_have_only_a_luma_plane() {
    let mut decoder = decoder();
    decoder.decode(&jpeg(WIDTH, HEIGHT, Subsamp::Gray)).unwrap();
    let Pixels::Grey { data, stride } = decoder.picture().unwrap().pixels else { panic!() };
    assert_eq!(stride, WIDTH);
    assert!(worst(&slopes(WIDTH, HEIGHT, Subsamp::Gray).pixels, data) <= 2);
}

#[test]
fn images_without_huffman_tables_are_decoded_with_the_standard_tables() {
    let whole = jpeg(WIDTH, HEIGHT, Subsamp::Sub2x1);
    let bare = without(&whole, 0xc4);
    assert!(bare.len() + 400 < whole.len());
    let mut decoders = [decoder(), decoder()];
    decoders[0].decode(&whole).unwrap();
    decoders[1].decode(&bare).unwrap();
    assert_eq!(decoders[0].strict.planes, decoders[1].strict.planes);
}

#[test]
fn another_size_is_refused_before_it_is_decoded() {
    let mut decoder = decoder();
    let fault = decoder.decode(&jpeg(WIDTH + 1, HEIGHT, Subsamp::Sub2x2));
    assert_eq!(fault, Err(FrameFault::WrongSize { width: WIDTH + 1, height: HEIGHT }));
    assert!(decoder.strict.planes.iter().all(|&sample| sample == 0));
    assert!(matches!(JpegDecoder::new(4097, 10), Err(CaptureError::PictureSize { .. })));
}

#[test]
fn every_truncation_that_loses_data_is_refused_and_leaves_no_picture() {
    let whole = jpeg(WIDTH, HEIGHT, Subsamp::Sub2x2);
    let mut decoder = decoder();
    for length in 0..whole.len() {
        let lacks_data = length + END_OF_IMAGE.len() < whole.len();
        assert_eq!(decoder.decode(&whole[..length]).is_err(), lacks_data, "{length}");
        assert_eq!(decoder.picture().is_none(), lacks_data);
        decoder.decode(&whole).unwrap();
        let closed = [&whole[..length], END_OF_IMAGE].concat();
        assert_eq!(decoder.decode(&closed).is_err(), lacks_data, "{length} with an end marker");
    }
}

#[test]
fn a_damaged_byte_neither_panics_nor_spoils_the_next_image() {
    let whole = jpeg(WIDTH, HEIGHT, Subsamp::Sub2x2);
    let mut decoder = decoder();
    for at in 0..whole.len() {
        for flip in [0xff, 0x01, 0x10] {
            let mut damaged = whole.clone();
            damaged[at] ^= flip;
            let good = decoder.decode(&damaged).is_ok();
            assert_eq!(decoder.picture().is_some(), good);
            decoder.decode(&whole).unwrap();
        }
    }
}

#[test]
fn an_image_of_endless_scans_is_refused() {
    let mut compressor = turbojpeg::Compressor::new().unwrap();
    compressor.set_progressive(true).unwrap();
    let whole = compressor.compress_yuv_to_vec(slopes(WIDTH, HEIGHT, Subsamp::Sub2x2).as_deref()).unwrap();
    decoder().decode(&whole).unwrap();
    let scan = whole.windows(2).rposition(|pair| pair == [0xff, 0xda]).unwrap();
    let (start, last) = (&whole[..scan], &whole[scan..whole.len() - 2]);
    let bomb = [start, &last.repeat(10_000), END_OF_IMAGE].concat();
    assert_eq!(decoder().decode(&bomb), Err(FrameFault::Corrupt));
}

#[test]
fn rgb_and_lossless_images_are_refused() {
    let mut compressor = turbojpeg::Compressor::new().unwrap();
    compressor.set_lossless(true).unwrap();
    let pixels = vec![90_u8; 3 * WIDTH * HEIGHT];
    let format = turbojpeg::PixelFormat::RGB;
    let image = turbojpeg::Image { pixels: &pixels[..], width: WIDTH, pitch: 3 * WIDTH, height: HEIGHT, format };
    let lossless = compressor.compress_to_vec(image).unwrap();
    assert_eq!(decoder().decode(&lossless), Err(FrameFault::Layout));
    assert_eq!(decoder().decode(b"GIF89a"), Err(FrameFault::NotJpeg));
    assert_eq!(decoder().decode(&[]), Err(FrameFault::NotJpeg));
    assert_eq!(decoder().decode(START_OF_IMAGE), Err(FrameFault::Incomplete));
}
