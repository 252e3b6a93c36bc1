#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

use super::super::Pixels;
use super::*;

fn stream(header: &str, frame_bytes: usize, frames: usize) -> Vec<u8> {
    let frame = [&b"FRAME\n"[..], &vec![7; frame_bytes]].concat();
    [format!("YUV4MPEG2 {header}\n").as_bytes(), &frame.repeat(frames)].concat()
}

fn open(bytes: &[u8]) -> Result<Y4mSource<&[u8]>, CaptureError> {
    Y4mSource::open(bytes, "stream")
}

#[test]
fn every_8_bit_layout_is_read_at_odd_sizes() {
    let cases = [
        ("C420jpeg", 15 + 2 * 6, Some([1, 1])),
        ("C420mpeg2 Ip XYSCSS=420MPEG2", 15 + 2 * 6, Some([1, 1])),
        ("C420paldv", 15 + 2 * 6, Some([1, 1])),
        ("A1:1", 15 + 2 * 6, Some([1, 1])),
        ("C422", 15 + 2 * 9, Some([1, 0])),
        ("C444", 15 * 3, Some([0, 0])),
        ("C411", 15 + 2 * 6, Some([2, 0])),
        ("Cmono", 15, None),
    ];
    for (fields, bytes, shift) in cases {
        let stream = stream(&format!("W5 H3 F30:1 {fields}"), bytes, 2);
        let mut source = open(&stream).unwrap();
        let frame = source.next().unwrap().unwrap();
        assert!(!frame.picture().unwrap().full_range);
        match frame.picture().unwrap().pixels {
            Pixels::Planar { planes, chroma_shift, .. } => {
                assert_eq!((Some(chroma_shift), planes.concat()), (shift, vec![7; bytes]), "{fields}");
            }
            Pixels::Grey { data, .. } => assert_eq!((None, data.len()), (shift, bytes)),
            _ => panic!("{fields}"),
        }
        assert_eq!(source.next().unwrap().unwrap().captured_us, 33_333);
        assert!(source.next().unwrap().is_none());
    }
}

#[test]
fn the_range_and_the_rate_are_taken_from_the_header() {
    let ntsc = stream("W4 H2 F30000:1001 C444 XCOLORRANGE=FULL", 24, 1);
    let mut source = open(&ntsc).unwrap();
    assert_eq!(source.describe().to_string(), "stream: YUV 4x2 at 29.97 fps");
    assert!(source.next().unwrap().unwrap().picture().unwrap().full_range);
    assert_eq!(open(&stream("W4 H2 F0:0", 12, 1)).unwrap().frame_period_us(), None);
}

#[test]
fn every_truncation_gives_the_frames_before_it_and_names_the_frame() {
    let whole = stream("W4 H2 F25:1 Cmono", 8, 3);
    let header = whole.iter().position(|&byte| byte == b'\n').unwrap() + 1;
    for length in 0..header {
        assert!(matches!(open(&whole[..length]), Err(CaptureError::Y4m(_))), "{length}");
    }
    for length in header..=whole.len() {
        let (complete, rest) = ((length - header) / 14, (length - header) % 14);
        let mut source = open(&whole[..length]).unwrap();
        for _ in 0..complete {
            assert!(source.skip().unwrap());
        }
        match source.next() {
            Ok(None) => assert_eq!(rest, 0, "{length}"),
            Err(CaptureError::CutShort { frame, offset }) => {
                assert_eq!((frame, offset), (complete as u64, length as u64));
            }
            other => panic!("{length}: {other:?}"),
        }
        assert!(source.next().unwrap().is_none(), "one error, then the end");
    }
}

#[test]
fn deep_colour_and_unknown_layouts_are_refused_by_name() {
    for layout in ["420p10", "422p12", "444p16", "420p9", "mono16", "mono12"] {
        let error = open(&stream(&format!("W4 H2 F25:1 C{layout}"), 0, 0)).unwrap_err();
        assert!(error.to_string().contains("more than 8 bits"), "{layout}");
    }
    let error = open(&stream("W4 H2 F25:1 C444alpha", 0, 0)).unwrap_err();
    assert!(error.to_string().contains("not supported"));
}

#[test]
fn absurd_sizes_and_other_files_are_refused() {
    for size in ["W0 H2", "W4097 H2", "W4", "W99999999999999999999 H4", "W-4 H4", "W4294967295 H4294967295"] {
        assert!(matches!(open(&stream(size, 0, 0)), Err(CaptureError::PictureSize { .. })), "{size}");
    }
    assert!(matches!(open(b"RIFF"), Err(CaptureError::Y4m("does not begin with YUV4MPEG2"))));
    let endless = [&b"YUV4MPEG2 "[..], &[b'W'; 5000]].concat();
    assert!(matches!(open(&endless), Err(CaptureError::Y4m(_))));
}

#[test]
fn bytes_that_are_no_frame_are_an_error_with_their_offset() {
    let mut whole = stream("W4 H2 F25:1 Cmono", 8, 2);
    let second = whole.len() - 14;
    whole[second] = b'X';
    let mut source = open(&whole).unwrap();
    assert!(source.skip().unwrap());
    let error = source.next().unwrap_err();
    assert!(matches!(error, CaptureError::Damaged { frame: 1, offset } if offset == second as u64));
}
