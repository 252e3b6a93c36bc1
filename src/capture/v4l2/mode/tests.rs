#![allow(clippy::unwrap_used)]

use super::*;
use PixelFormat::{Grey, Jpeg, Mjpeg, Nv12, Yuyv};

fn fps(frames: u32) -> FrameRate {
    FrameRate::new(frames, 1).unwrap()
}

fn mode(format: PixelFormat, [width, height]: [u32; 2], rates: &[u32]) -> Mode {
    let rates = rates.iter().map(|&rate| Rates { slowest: fps(rate), fastest: fps(rate) }).collect();
    Mode { format, width: Steps::one(width), height: Steps::one(height), rates }
}

fn wish(width: u32, height: u32, rate: u32) -> Wish {
    Wish { width, height, rate: fps(rate), format: None }
}

fn chosen(modes: &[Mode], wish: &Wish) -> String {
    let choice = choose(modes, wish).unwrap();
    let rate = choice.rate.map_or("?".to_owned(), |rate| rate.to_string());
    format!("{} {}x{} {rate}", choice.format, choice.width, choice.height)
}

/// The list of a common USB 2 webcam: raw pictures are slow at large sizes.
fn webcam() -> Vec<Mode> {
    vec![
        mode(Mjpeg, [1920, 1080], &[30, 15]),
        mode(Mjpeg, [1280, 720], &[60, 30]),
        mode(Mjpeg, [640, 480], &[60, 30]),
        mode(Yuyv, [1920, 1080], &[5]),
        mode(Yuyv, [1280, 720], &[10, 5]),
        mode(Yuyv, [640, 480], &[30, 15]),
        mode(Yuyv, [320, 240], &[30]),
    ]
}

#[test]
fn raw_formats_are_chosen_where_they_are_fast_enough_and_jpeg_elsewhere() {
    let table = [
        (wish(640, 480, 30), "YUYV 640x480 30 fps"),
        (wish(640, 480, 15), "YUYV 640x480 15 fps"),
        (wish(640, 480, 60), "MJPEG 640x480 60 fps"),
        (wish(640, 480, 120), "MJPEG 640x480 60 fps"),
        (wish(1280, 720, 30), "MJPEG 1280x720 30 fps"),
        (wish(1280, 720, 10), "YUYV 1280x720 10 fps"),
        (wish(1920, 1080, 30), "MJPEG 1920x1080 30 fps"),
        (wish(320, 240, 30), "YUYV 320x240 30 fps"),
        (wish(160, 120, 30), "YUYV 320x240 30 fps"),
        (wish(800, 600, 30), "MJPEG 1280x720 30 fps"),
        (wish(3840, 2160, 30), "MJPEG 1920x1080 30 fps"),
    ];
    for (wish, expected) in table {
        assert_eq!(chosen(&webcam(), &wish), expected, "{wish:?}");
    }
}

#[test]
fn a_named_format_is_the_only_one_taken() {
    let only = |format| Wish { format: Some(format), ..wish(640, 480, 30) };
    assert_eq!(chosen(&webcam(), &only(Mjpeg)), "MJPEG 640x480 30 fps");
    assert_eq!(choose(&webcam(), &only(Nv12)), None);
    assert_eq!(choose(&[], &wish(640, 480, 30)), None);
}

#[test]
fn formats_are_preferred_raw_then_jpeg_then_grey() {
    let mut modes: Vec<_> = [Grey, Jpeg, Mjpeg, Nv12, Yuyv].map(|format| mode(format, [640, 480], &[30])).into();
    for expected in ["YUYV", "NV12", "MJPEG", "JPEG", "GREY"] {
        assert!(chosen(&modes, &wish(640, 480, 30)).starts_with(expected));
        modes.pop();
    }
}

#[test]
fn the_ntsc_rate_counts_as_30() {
    let ntsc = FrameRate::new(30_000, 1001).unwrap();
    let rates = vec![Rates { slowest: ntsc, fastest: ntsc }];
    let modes = [Mode { rates, ..mode(Yuyv, [640, 480], &[]) }, mode(Mjpeg, [640, 480], &[30])];
    assert_eq!(chosen(&modes, &wish(640, 480, 30)), "YUYV 640x480 29.97 fps");
}

#[test]
fn ranges_of_sizes_and_rates_give_the_wanted_mode() {
    let stepwise = |width, height| Mode {
        width,
        height,
        rates: vec![Rates { slowest: fps(1), fastest: fps(60) }],
        ..mode(Yuyv, [0, 0], &[])
    };
    let camera = stepwise(Steps { min: 32, max: 2592, step: 2 }, Steps { min: 32, max: 1944, step: 2 });
    assert_eq!(chosen(std::slice::from_ref(&camera), &wish(640, 480, 30)), "YUYV 640x480 30 fps");
    assert_eq!(chosen(std::slice::from_ref(&camera), &wish(641, 481, 90)), "YUYV 642x482 60 fps");
    assert_eq!(chosen(std::slice::from_ref(&camera), &wish(9999, 16, 30)), "YUYV 2592x32 30 fps");
    assert_eq!(camera.to_string(), "YUYV 32..2592x32..1944 at 1 fps to 60 fps");
}

#[test]
fn steps_never_leave_their_range() {
    let table = [
        (Steps { min: 16, max: 100, step: 16 }, 99, 96),
        (Steps { min: 16, max: 100, step: 0 }, 50, 50),
        (Steps { min: 16, max: 10, step: 3 }, 50, 16),
        (Steps { min: 0, max: u32::MAX, step: u32::MAX }, 1, u32::MAX),
        (Steps::one(640), 4096, 640),
    ];
    for (steps, wish, expected) in table {
        assert_eq!(steps.at_least(wish), expected, "{steps:?}");
    }
}

#[test]
fn a_driver_that_lists_no_rates_counts_as_fast_enough() {
    let modes = [mode(Yuyv, [640, 480], &[]), mode(Mjpeg, [640, 480], &[30])];
    assert_eq!(chosen(&modes, &wish(640, 480, 30)), "YUYV 640x480 ?");
}

#[test]
fn names_and_codes_are_converted_back_to_their_format() {
    for format in PixelFormat::ALL {
        assert_eq!(PixelFormat::named(&format.name().to_lowercase()), Some(format));
        assert_eq!(PixelFormat::of(format.fourcc()), Some(format));
    }
    assert_eq!(PixelFormat::of(*b"H264"), None);
}

#[test]
fn a_smaller_mode_has_half_the_pixels_and_is_as_fast() {
    let is_smaller = |modes: &[Mode], wish: Wish| has_smaller(modes, &wish, &choose(modes, &wish).unwrap());
    assert!(is_smaller(&webcam(), wish(1280, 720, 30)));
    assert!(is_smaller(&webcam(), wish(640, 480, 30)));
    assert!(!is_smaller(&webcam(), wish(640, 480, 60)), "320x240 has no 60 fps");
    assert!(!is_smaller(&webcam(), wish(320, 240, 30)), "the smallest already");
    assert!(!is_smaller(&[mode(Mjpeg, [640, 480], &[30]), mode(Mjpeg, [352, 288], &[15])], wish(640, 480, 30)));
}
