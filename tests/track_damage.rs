//! `facewire track`: what it says of input that is damaged or missing, and of output that cannot be written.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::sync::LazyLock;

use common::coefficients::rows;
use common::film::{demo_avi, demo_y4m, empty_y4m};
use common::points::write_npy;
use common::program::{Run, facewire, text, track_stream};
use facewire_face::LANDMARKS;
use tempfile::NamedTempFile;

/// Output for the first frames of the built-in clip.
struct Whole {
    csv: String,
    points: Vec<u8>,
}

static WHOLE: LazyLock<Whole> = LazyLock::new(|| {
    let file = NamedTempFile::with_suffix(".npy").unwrap();
    let run = Run::fed(&mut facewire(["track", "-", "--landmarks", text(file.path())]), &demo_y4m(9));
    Whole { csv: run.succeeded().out, points: fs::read(file.path()).unwrap() }
});

/// Asserts that the run has printed the header and the first `rows` rows of the whole clip.
fn assert_begins(run: &Run, rows: usize) {
    assert!(run.out.lines().eq(WHOLE.csv.lines().take(1 + rows)), "{}", run.out);
}

/// Tracks a file of this name with these bytes.
fn track_file(name: &str, bytes: &[u8]) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    Run::of(&mut facewire(["track", text(&path)]))
}

#[test]
fn a_film_that_is_cut_off_gives_the_rows_before_the_cut() {
    let y4m = demo_y4m(4);
    let avi = fs::read(demo_avi()).unwrap();
    let runs = [
        (3, track_stream(&y4m[..y4m.len() - 1])),
        (3, track_file("cut.y4m", &y4m[..y4m.len() - 1000])),
        (8, track_file("cut.avi", &avi[..100_000])),
    ];
    for (whole, run) in runs {
        let sentence = run.sentence(65);
        assert!(sentence.contains("cut short at byte") && sentence.contains(&format!("in frame {whole}")));
        assert_begins(&run, whole);
    }
}

#[test]
fn a_damaged_frame_keeps_its_row_and_the_next_frames_follow() {
    let mut avi = fs::read(demo_avi()).unwrap();
    let frames: Vec<usize> =
        (0..avi.len() - 10).filter(|&at| avi[at..].starts_with(b"00dc") && avi[at + 8] == 0xff).collect();
    avi[frames[6] + 8..][..2].fill(0);
    avi.truncate(frames[9]);
    let run = track_file("damaged.avi", &avi);
    let rows = rows(&run.out);
    assert!(rows.iter().map(|row| row.frame).eq(0..9), "{}", run.err);
    assert!(run.err.contains("9 frames, 8 with a face, 1 damaged"), "{}", run.err);
    assert_eq!(rows[6].coefficients(), rows[5].coefficients(), "what the service would send");
}

#[test]
fn a_file_that_is_no_film_is_refused_with_the_reason() {
    let y4m = |fields| format!("YUV4MPEG2 {fields}\nFRAME\n");
    let cases = [
        ("text.avi", "a letter\n".to_owned(), "neither an AVI nor a y4m"),
        ("nothing.y4m", String::new(), "neither an AVI nor a y4m"),
        ("riff.avi", "RIFF".to_owned(), "the AVI file"),
        ("sizeless.y4m", y4m("F30:1"), "each side must be 1 to 4096"),
        ("huge.y4m", y4m("W99999 H99999 F30:1"), "each side must be 1 to 4096"),
        ("deep.y4m", y4m("W64 H64 F30:1 C420p10"), "more than 8 bits"),
        ("header.y4m", "YUV4MPEG2 W64 H64".to_owned(), "ends within its header"),
    ];
    for (name, content, reason) in cases {
        let run = track_file(name, content.as_bytes());
        assert!(run.sentence(65).contains(reason), "{name}: {}", run.err);
        assert!(run.out.is_empty());
    }
    assert!(track_stream(b"a letter\n").sentence(65).contains("does not begin with YUV4MPEG2"));
    assert!(track_stream(b"").sentence(65).contains("does not begin with YUV4MPEG2"));
}

#[test]
fn a_missing_input_is_named() {
    for input in ["nowhere/film.avi", "nowhere/points.npy"] {
        let run = Run::of(&mut facewire(["track", input]));
        assert!(run.sentence(66).contains(input), "{}", run.err);
    }
    let folder = Run::of(&mut facewire(["track", env!("CARGO_MANIFEST_DIR")]));
    assert!(folder.sentence(66).contains(env!("CARGO_MANIFEST_DIR")));
}

#[test]
fn landmarks_of_another_shape_or_type_are_refused() {
    let cases = [
        (write_npy(&[2, 468, 3], &[0.0_f32; 2 * 468 * 3]), "has shape [2, 468, 3]"),
        (write_npy(&[478, 3], &[0.0_f32; 478 * 3]), "has shape [478, 3]"),
        (write_npy(&[1, 478, 3], &[0_i32; 478 * 3]), "holds numbers of another kind"),
        (b"a letter".to_vec(), "is not a .npy file"),
        (Vec::new(), "is not a .npy file"),
    ];
    for (bytes, reason) in cases {
        let run = track_file("points.npy", &bytes);
        assert!(run.sentence(65).contains(reason), "{}", run.err);
    }
}

#[test]
fn landmarks_in_fortran_order_or_of_an_impossible_shape_are_refused() {
    let points = write_npy(&[1, 478, 3], &[0.0_f32; 478 * 3]);
    let header = String::from_utf8(points[10..128].to_vec()).unwrap();
    let with = |header: String| track_file("points.npy", &[&points[..10], header.as_bytes(), &points[128..]].concat());
    assert!(with(header.replace("False", "True ")).sentence(65).contains("Fortran order"));
    for frames in ["9999999999999999", "99999999999999999", "18446744073709551615"] {
        let (shape, padding) = (format!("({frames}, 478, 3)"), " ".repeat(frames.len() - 1));
        let run = with(header.replace("(1, 478, 3)", &shape).replacen(&padding, "", 1));
        run.sentence(65);
        assert!(run.out.lines().count() <= 2);
    }
}

#[test]
fn a_npy_header_that_keeps_its_parser_busy_is_refused() {
    let file = |header: &[u8]| {
        [b"\x93NUMPY\x01\x00", &u16::try_from(header.len()).unwrap().to_le_bytes()[..], header].concat()
    };
    let shape = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, 478, 3), }}", i64::MAX);
    for bytes in
        [file(&[b'{'; 40]), file(&[b'('; 15_000]), file(shape.as_bytes()), b"\x93NUMPY\x02\0\xff\xff\xff\xff".to_vec()]
    {
        let run = track_file("points.npy", &bytes);
        assert!(run.sentence(65).contains("is not a .npy file of plain numbers"), "{}", run.err);
    }
}

#[test]
fn a_npy_file_that_is_cut_off_gives_the_rows_before_the_cut() {
    let run = track_file("cut.npy", &WHOLE.points[..128 + 5 * LANDMARKS * 12 + 1000]);
    assert!(run.sentence(65).contains("cut short in frame 5"), "{}", run.err);
    let whole = track_file("whole.npy", &WHOLE.points).succeeded().out;
    assert!(run.out.lines().eq(whole.lines().take(1 + 5)), "{}", run.out);
}

#[test]
fn landmarks_that_form_no_face_count_as_no_face() {
    let zero = vec![0.0_f32; LANDMARKS * 3];
    let wild: Vec<f32> = (0..LANDMARKS * 3).map(|index| if index % 2 == 0 { 1e30 } else { -1e30 }).collect();
    for values in [zero, wild, vec![f32::NAN; LANDMARKS * 3], vec![f32::INFINITY; LANDMARKS * 3]] {
        let run = track_file("points.npy", &write_npy(&[1, LANDMARKS as u64, 3], &values)).succeeded();
        assert_eq!(rows(&run.out)[0].state, "neutral", "{}", run.out);
    }
}

#[test]
fn an_output_that_cannot_be_written_is_named() {
    let file = NamedTempFile::with_suffix(".npy").unwrap();
    fs::write(file.path(), &WHOLE.points).unwrap();
    let points = text(file.path());
    for (option, path) in [("--out", "/nowhere/x.csv"), ("--out", "/"), ("--landmarks", "/nowhere/x.npy")] {
        let run = Run::of(&mut facewire(["track", points, option, path]));
        assert!(run.sentence(74).contains(&format!("cannot write {path}: ")), "{}", run.err);
    }
    for option in ["--out", "--landmarks"] {
        let run = Run::of(&mut facewire(["track", points, option, "/dev/full"]));
        assert!(run.sentence(74).contains("No space left on device"), "{}", run.err);
    }
}

#[test]
fn a_neutral_range_without_a_face_is_refused() {
    for (range, reason) in [("0..2", "none of these frames shows a face"), ("7..9", "the input has 4 frames")] {
        let run = Run::fed(&mut facewire(["track", "-", "--neutral", range]), &empty_y4m(4));
        let want = format!("--neutral {range}: {reason}; ");
        assert!(run.sentence(65).starts_with(&want), "{}", run.err);
    }
}

#[test]
fn arguments_that_make_no_sense_are_refused_with_what_to_write() {
    let cases = [
        ["--neutral", "5..5", "such as 0..30"],
        ["--fps", "0", "from 0.1 to 1000"],
        ["--size", "640", "such as 640x480"],
        ["--stage", "cooked", "raw, corrected, smoothed"],
    ];
    for [option, value, hint] in cases {
        let run = Run::of(&mut facewire(["track", "demo", option, value]));
        assert_eq!(run.status, Some(2));
        assert!(run.err.contains(hint), "{}", run.err);
    }
}
