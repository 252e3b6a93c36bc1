//! Frames of every layout, and frames as real webcams send them and frames that lost data, beside what OpenCV makes of them.
//!
//! The two images of `testdata` show a part of frame 100 of the built-in clip and were encoded by OpenCV. The sums of luma
//! samples are those that OpenCV 5.0.0 decodes from the same bytes by `cv2.imdecode(bytes, cv2.IMREAD_GRAYSCALE)`.

use std::ops::Range;

use allocation_counter::measure;
use turbojpeg::{Compressor, yuv_pixels_len};

use super::*;

/// Returns a smooth picture. Each plane has another slope, so that tests notice a swapped or shifted plane.
fn slopes(width: usize, height: usize, subsamp: Subsamp) -> YuvImage<Vec<u8>> {
    let length = yuv_pixels_len(width, 1, height, subsamp).unwrap();
    let mut image = YuvImage { pixels: vec![0; length], width, align: 1, height, subsamp };
    let luma_width = image.y_width();
    let luma_height = image.y_height();
    let chroma_width = image.uv_width().max(1);
    let (luma, chroma) = image.pixels.split_at_mut(luma_width * luma_height);
    let (cb, cr) = chroma.split_at_mut(chroma.len() / 2);
    luma.iter_mut().enumerate().for_each(|(at, sample)| *sample = (40 + at % luma_width + at / luma_width) as u8);
    cb.iter_mut().enumerate().for_each(|(at, sample)| *sample = (100 + at % chroma_width) as u8);
    cr.iter_mut().enumerate().for_each(|(at, sample)| *sample = (200 - at / chroma_width) as u8);
    image
}

/// Returns [`slopes`] as a JPEG image of the best quality.
pub(in super::super) fn jpeg(width: usize, height: usize, subsamp: Subsamp) -> Vec<u8> {
    let mut compressor = Compressor::new().unwrap();
    compressor.set_quality(100).unwrap();
    compressor.compress_yuv_to_vec(slopes(width, height, subsamp).as_deref()).unwrap()
}

const WIDTH: usize = 37;
const HEIGHT: usize = 21;

fn decoder() -> JpegDecoder {
    JpegDecoder::new(WIDTH, HEIGHT).unwrap()
}

#[test]
fn every_chroma_subsampling_is_decoded_within_2_of_the_original() {
    use Subsamp::{Gray, None, Sub1x2, Sub1x4, Sub2x1, Sub2x2, Sub4x1};
    let is_near = |a: &[u8], b: &[u8]| a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) <= 2);
    for subsamp in [None, Sub2x1, Sub2x2, Sub1x2, Sub4x1, Sub1x4, Gray] {
        let mut decoder = decoder();
        let truth = slopes(WIDTH, HEIGHT, subsamp);
        decoder.decode(&jpeg(WIDTH, HEIGHT, subsamp)).unwrap();
        let picture = decoder.picture().unwrap();
        assert!(picture.full_range());
        match picture.pixels() {
            Pixels::Planar { planes, strides, chroma_shift } => {
                assert_eq!(strides, [truth.y_width(), truth.uv_width()]);
                assert_eq!(chroma_shift.map(|shift| 1 << shift), [subsamp.width(), subsamp.height()]);
                assert!(is_near(&truth.pixels, &planes.concat()), "{subsamp:?}");
            }
            Pixels::Grey { data, stride } => {
                assert!(subsamp == Gray && stride == WIDTH && is_near(&truth.pixels, data))
            }
            _ => panic!("{subsamp:?}"),
        }
    }
}

#[test]
fn an_image_of_red_green_and_blue_is_decoded_and_one_of_cyan_magenta_yellow_and_black_is_refused() {
    let rgb: Vec<u8> = (0..WIDTH * HEIGHT).flat_map(|at| [(at % WIDTH) as u8, 200, 90 + (at / WIDTH) as u8]).collect();
    let encoded = |pixels: &[u8], format: turbojpeg::PixelFormat, colorspace| {
        let mut compressor = Compressor::new().unwrap();
        compressor.set_quality(100).unwrap();
        compressor.set_colorspace(colorspace).unwrap();
        let image = turbojpeg::Image { pixels, width: WIDTH, pitch: format.size() * WIDTH, height: HEIGHT, format };
        compressor.compress_to_vec(image).unwrap()
    };
    let mut decoder = decoder();
    decoder.decode(&encoded(&rgb, PixelFormat::RGB, Colorspace::RGB)).unwrap();
    let Pixels::Packed { data, stride, step: 3, rgb: [0, 1, 2] } = decoder.picture().unwrap().pixels() else {
        panic!()
    };
    assert_eq!(stride, 3 * WIDTH);
    assert!(rgb.iter().zip(data).all(|(a, b)| a.abs_diff(*b) <= 2));
    let cmyk = vec![90; 4 * WIDTH * HEIGHT];
    for colorspace in [Colorspace::CMYK, Colorspace::YCCK] {
        let image = encoded(&cmyk, PixelFormat::CMYK, colorspace);
        assert_eq!(decoder.decode(&image), Err(FrameFault::Unsupported("a CMYK image")));
    }
    decoder.decode(&jpeg(WIDTH, HEIGHT, Subsamp::Gray)).unwrap();
}

#[test]
fn every_truncation_that_loses_data_is_refused_and_no_damaged_byte_panics_or_spoils_the_next_image() {
    let whole = jpeg(WIDTH, HEIGHT, Subsamp::Sub2x2);
    let mut decoder = decoder();
    for (at, flip) in (0..whole.len()).flat_map(|at| [(at, 0xff), (at, 0x01), (at, 0x10)]) {
        let mut damaged = whole.clone();
        damaged[at] ^= flip;
        assert_eq!(decoder.decode(&damaged).is_ok(), decoder.picture().is_some());
        decoder.decode(&whole).unwrap();
    }
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
fn an_image_of_another_kind_or_size_is_refused_with_its_fault() {
    let mut compressor = Compressor::new().unwrap();
    compressor.set_lossless(true).unwrap();
    let pixels = vec![90_u8; 3 * WIDTH * HEIGHT];
    let format = turbojpeg::PixelFormat::RGB;
    let image = turbojpeg::Image { pixels: &pixels[..], width: WIDTH, pitch: 3 * WIDTH, height: HEIGHT, format };
    let lossless = compressor.compress_to_vec(image).unwrap();
    let mut compressor = Compressor::new().unwrap();
    compressor.set_progressive(true).unwrap();
    let progressive = compressor.compress_yuv_to_vec(slopes(WIDTH, HEIGHT, Subsamp::Sub2x2).as_deref()).unwrap();
    decoder().decode(&progressive).unwrap();
    let scan = progressive.windows(2).rposition(|pair| pair == [0xff, 0xda]).unwrap();
    let start = &progressive[..scan];
    let last = &progressive[scan..progressive.len() - 2];
    let endless_scans = [start, &last.repeat(10_000), END_OF_IMAGE].concat();
    let wider = jpeg(WIDTH + 1, HEIGHT, Subsamp::Sub2x2);
    let table: [(&[u8], _); 6] = [
        (&lossless, FrameFault::Unsupported("a lossless JPEG image")),
        (&endless_scans, FrameFault::Corrupt),
        (&wider, FrameFault::WrongSize { width: WIDTH + 1, height: HEIGHT }),
        (b"GIF89a", FrameFault::NotJpeg),
        (&[], FrameFault::NotJpeg),
        (START_OF_IMAGE, FrameFault::Incomplete),
    ];
    for (image, fault) in table {
        let mut decoder = decoder();
        assert_eq!(decoder.decode(image), Err(fault));
        assert!(decoder.planes.iter().all(|&sample| sample == 0) || fault == FrameFault::Corrupt, "{fault}");
    }
    assert!(JpegDecoder::new(4097, 10).is_err_and(|error| error.to_string().contains("the picture is 4097x10")));
}

/// Sum of the luma of either image as OpenCV decodes it.
const OPENCV_SUM: u64 = 10_850_651;
const SIZE: [usize; 2] = [320, 240];
/// 4:2:2, a restart marker after every 7 units, so that the intervals end anywhere in a row.
const IMAGE_422: &[u8] = include_bytes!("testdata/clip_422_interval_7.jpg");
/// 4:2:0, a restart marker after each row of 20 units.
const IMAGE_420: &[u8] = include_bytes!("testdata/clip_420_interval_20.jpg");

/// The luma of an image, if it is accepted by a decoder that saw `before` first.
fn luma(before: &[u8], image: &[u8]) -> Result<Vec<u8>, FrameFault> {
    let mut decoder = JpegDecoder::new(SIZE[0], SIZE[1]).unwrap();
    let _ = decoder.decode(before);
    decoder.decode(image)?;
    let Pixels::Planar { planes: [luma, ..], .. } = decoder.picture().unwrap().pixels() else { panic!("no luma") };
    Ok(luma.to_vec())
}

/// Where the segment with this marker lies.
fn segment(image: &[u8], wanted: u8) -> Range<usize> {
    let mut at = 2;
    loop {
        let end = at + 2 + usize::from(u16::from_be_bytes([image[at + 2], image[at + 3]]));
        if image[at + 1] == wanted {
            return at..end;
        }
        at = end;
    }
}

/// Positions of all restart markers and of the end marker.
fn markers(image: &[u8]) -> Vec<usize> {
    let data = segment(image, 0xda).end;
    (data..image.len() - 1).filter(|at| image[*at] == 0xff && matches!(image[at + 1], 0xd0..=0xd9)).collect()
}

/// The image with `bytes` in place of a part of it.
fn replaced(image: &[u8], part: Range<usize>, bytes: &[u8]) -> Vec<u8> {
    [&image[..part.start], bytes, &image[part.end..]].concat()
}

fn inserted(image: &[u8], at: usize, bytes: &[u8]) -> Vec<u8> {
    replaced(image, at..at, bytes)
}

/// The image with stray bytes before the markers of these numbers.
fn strewn(image: &[u8], numbers: impl DoubleEndedIterator<Item = usize>, bytes: &[u8]) -> Vec<u8> {
    let markers = markers(image);
    numbers.rev().fold(image.to_vec(), |image, number| inserted(&image, markers[number], bytes))
}

fn segment_of(marker: u8, content: &[u8]) -> Vec<u8> {
    [&[0xff, marker], &u16::try_from(content.len() + 2).unwrap().to_be_bytes()[..], content].concat()
}

/// Frames that have all their blocks. OpenCV decodes all of them to [`OPENCV_SUM`], except for those with two start
/// markers or no end marker, which it refuses.
fn whole_frames(image: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let last = markers(image).len() - 1;
    let data = segment(image, 0xda);
    let avi1 = segment_of(0xe0, &[&b"AVI1"[..], &[0; 27]].concat());
    let fields = [avi1.clone(), segment_of(0xe4, &[0x55; 10_000]), segment_of(0xfe, b"X")].concat();
    let without_tables =
        |image: &[u8]| (0..4).fold(image.to_vec(), |image, _| replaced(&image, segment(&image, 0xc4), &[]));
    let c910 = strewn(image, (0..last).step_by(3), &[0x5a; 9]);
    vec![
        ("unaltered", image.to_vec()),
        ("a stray byte before one restart marker", strewn(image, 4..5, &[0])),
        ("stray bytes before many restart markers", c910.clone()),
        ("stuffed and fill bytes before a marker", strewn(image, 2..5, &[0xff, 0, 0x12, 0xff])),
        ("stray bytes before the end marker", strewn(image, last..=last, &[0; 8])),
        ("no Huffman tables", without_tables(image)),
        ("zeros behind the end marker", [image, &[0; 1000]].concat()),
        ("the rest of an older frame behind the end marker", [image, &image[image.len() / 2..]].concat()),
        ("AVI1 and APP4 fields and a comment", inserted(image, 2, &fields)),
        ("a stray byte between segments", inserted(image, segment(image, 0xdb).end, &[0])),
        ("a JFIF field of version 0", replaced(image, 11..13, &[0, 0])),
        ("zeros as parameters of the scan", replaced(image, data.end - 3..data.end, &[0; 3])),
        ("two start markers", inserted(image, 2, START_OF_IMAGE)),
        ("no end marker", image[..image.len() - 2].to_vec()),
        ("all of a C910", [&inserted(&without_tables(&c910), 2, &avi1)[..], &[0; 300]].concat()),
    ]
}

/// Frames that lost data. In most of them a stray byte makes libjpeg-turbo's first warning a harmless one.
fn damaged_frames(image: &[u8]) -> Vec<(&'static str, Vec<u8>)> {
    let stray = strewn(image, 1..2, &[0]);
    let markers = markers(&stray);
    let part = |number: usize| markers[number]..markers[number + 1];
    let after = |number: usize, bytes: Range<usize>| markers[number] + bytes.start..markers[number] + bytes.end;
    let swapped = [&stray[part(7)], &stray[part(6)]].concat();
    vec![
        ("cut, with an end marker", [&image[..image.len() / 2], END_OF_IMAGE].concat()),
        ("cut, without an end marker", stray[..stray.len() - 30].to_vec()),
        ("data lost after a stray byte", replaced(&stray, after(6, 20..40), &[])),
        ("data lost before a stray byte", replaced(&stray, markers[0] - 10..markers[0], &[])),
        ("an interval lost", replaced(&stray, part(6), &[])),
        ("eight intervals lost", replaced(&stray, markers[3]..markers[11], &[])),
        ("two intervals swapped", replaced(&stray, markers[6]..markers[8], &swapped)),
        ("a restart marker lost", replaced(&stray, after(6, 0..2), &[])),
        ("data overwritten", replaced(&stray, after(6, 20..60), &[0xfe; 40])),
    ]
}

#[test]
fn frames_as_webcams_send_them_are_decoded_as_by_opencv_and_frames_that_lost_data_refused_whatever_came_before() {
    let before = [whole_frames(IMAGE_420), damaged_frames(IMAGE_420)].concat();
    for (image, before) in [(IMAGE_422, before.as_slice()), (IMAGE_420, &before[..1])] {
        let expected = luma(&[], image).unwrap();
        assert_eq!(expected.iter().map(|sample| u64::from(*sample)).sum::<u64>(), OPENCV_SUM);
        for (what, frame) in whole_frames(image) {
            for (what_before, before) in before {
                assert!(luma(before, &frame).as_ref() == Ok(&expected), "{what} after {what_before}");
            }
        }
        for (what, frame) in damaged_frames(image) {
            let alone = luma(&[], &frame).unwrap_err();
            for (what_before, before) in before {
                assert_eq!(luma(before, &frame).unwrap_err(), alone, "{what} after {what_before}");
            }
        }
    }
}

/// OpenCV decodes such a frame, too. But codes that were damaged often end at the wrong place, and then leave many bytes.
#[test]
fn more_stray_bytes_than_a_webcam_leaves_are_refused() {
    let last = markers(IMAGE_422).len() - 1;
    for number in [4, last] {
        assert!(luma(&[], &strewn(IMAGE_422, number..=number, &[0x33; 32])).is_ok());
        assert_eq!(luma(&[], &strewn(IMAGE_422, number..=number, &[0x33; 33])), Err(FrameFault::Corrupt));
    }
    let header = inserted(IMAGE_422, segment(IMAGE_422, 0xc0).start, &[0x33; 608]);
    assert!(luma(&[], &header).is_ok(), "no code lies before the segments of the header");
}

#[test]
fn a_camera_that_sends_stray_bytes_causes_no_allocation_after_its_first_frame() {
    let mut decoder = JpegDecoder::new(SIZE[0], SIZE[1]).unwrap();
    let stray = strewn(IMAGE_422, 4..5, &[0]);
    let mut allocations = |frame| measure(|| decoder.decode(frame).unwrap()).count_total;
    assert!(allocations(&stray) > 0, "libjpeg-turbo warns");
    for frame in [&stray, &stray, IMAGE_422, IMAGE_422, &stray, IMAGE_422, &stray] {
        assert_eq!(allocations(frame), 0);
    }
}
