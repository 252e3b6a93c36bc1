//! The promises of [`FaceTracker`], on the built-in clip of the service.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, clippy::float_cmp)]

#[path = "common/films.rs"]
mod films;
#[path = "../../tests/common/skip.rs"]
mod skip;

use std::ffi::OsStr;
use std::os::unix::{ffi::OsStrExt as _, fs::symlink};
use std::time::Duration;

use facewire::calibration::ProfileFile;
use facewire::capture::{Clip, Content, Frame, Source};
use facewire::config::{Settings, parse, schema};
use facewire::pipeline::{Pipeline, shaping};
use facewire_face::stages::NetworkFolder;
use facewire_library::{
    BLENDSHAPES, Error, Face, FaceTracker, Format, Method, Neutral, NeutralFace, NeutralMode, Options, Picture, Pixels,
    Profile, Rotation, default_shaping, neutral_of, parse_profile, parse_shaping, profile_text, read_profile,
};
use films::films;
use serde_json::Value;

const SIZE: [usize; 2] = [640, 480];

/// Calls `each` with every picture of the clip and its time.
fn play(frames: usize, mut each: impl FnMut(&Picture, Duration)) {
    let mut clip = Clip::once().unwrap();
    for _ in 0..frames {
        let frame = clip.next().unwrap().unwrap();
        each(frame.picture().unwrap(), Duration::from_micros(frame.captured_us));
    }
}

/// Every face of the first frames of the clip.
fn faces(
    mut tracker: FaceTracker,
    frames: usize,
    mut alter: impl FnMut(&Picture) -> Vec<u8>,
    format: Format,
) -> Vec<Face> {
    let mut faces = Vec::new();
    play(frames, |picture, time| {
        let samples = alter(picture);
        let picture = format.picture(&samples, SIZE).unwrap();
        faces.push(tracker.process(&picture, time).unwrap().unwrap().clone());
    });
    faces
}

/// The picture in red, green and blue, by the definition of BT.601, with the bytes of a pixel in this order.
fn coloured(picture: &Picture, order: &[usize]) -> Vec<u8> {
    let Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift: [1, 0] } = picture.pixels() else { panic!() };
    let places = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| [y * strides[0] + x, y * strides[1] + x / 2]));
    let pixel = |[at, chroma]: [usize; 2]| {
        let [y, cb, cr] = [f32::from(luma[at]), f32::from(cb[chroma]) - 128.0, f32::from(cr[chroma]) - 128.0];
        let rgb = [y + 1.402 * cr, y - 0.344_136 * cb - 0.714_136 * cr, y + 1.772 * cb, 77.0];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let bytes = order.iter().map(move |&channel| rgb[channel].round() as u8);
        bytes
    };
    places.flat_map(pixel).collect()
}

/// A tracker, and what the service is made of.
fn both(mode: NeutralMode) -> (FaceTracker, Pipeline) {
    let mut settings = Settings::default();
    settings.wearer.neutral = mode;
    (Options::default().neutral(mode).open().unwrap(), Pipeline::load(&settings, true).unwrap())
}

/// Compares both on a frame, and returns whether it shows a face.
fn is_same((tracker, pipeline): &mut (FaceTracker, Pipeline), frame: &Frame) -> bool {
    let ours = tracker.process(frame.picture().unwrap(), Duration::from_micros(frame.captured_us)).unwrap();
    let processed = pipeline.process(frame);
    let theirs = processed.solved.as_ref().ok();
    assert_eq!(ours.is_some(), theirs.is_some(), "frame {}", frame.number);
    let Some((ours, theirs)) = ours.zip(theirs) else { return false };
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&ours.coefficients), bits(&theirs.smoothed.0), "frame {}", frame.number);
    assert_eq!((ours.head, ours.neutral, ours.visibility), (theirs.head, theirs.neutral_face, theirs.visibility));
    assert_eq!(ours.score.to_bits(), processed.face.unwrap().appearance.unwrap().score.to_bits());
    assert_eq!(bits(ours.landmarks.0.as_flattened()), bits(processed.face.unwrap().landmarks.0.as_flattened()));
    true
}

#[test]
fn coefficients_and_poses_are_those_of_the_service_to_the_last_bit() {
    for mode in [NeutralMode::Off, NeutralMode::Auto] {
        let (mut both, mut clip, mut solved) = (both(mode), Clip::once().unwrap(), 0);
        while let Some(frame) = clip.next().unwrap() {
            solved += usize::from(is_same(&mut both, &frame));
        }
        assert!(solved > 200, "{solved} frames");
    }
    assert_eq!(default_shaping(), shaping(&Settings::default()));
}

#[test]
fn the_method_of_the_paper_gives_the_bits_of_the_service_built_in_and_from_its_file() {
    let formulas = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/formulas.toml");
    let mut settings = Settings::default();
    settings.solver.method = Method::Paper;
    for options in [Options::default().method(Method::Paper), Options::default().model(formulas)] {
        let mut both = (options.open().unwrap(), Pipeline::load(&settings, true).unwrap());
        let mut clip = Clip::once().unwrap();
        assert!((0..30).all(|_| is_same(&mut both, &clip.next().unwrap().unwrap())));
    }
    let both = Options::default().method(Method::Paper).model(formulas).open();
    assert!(both.err().unwrap().to_string().contains("a file brings its own method"));
}

/// Every key of the tables of the service's settings that shape the output, with values that the service takes and others.
fn entries() -> Vec<String> {
    let schema = schema();
    let keys = |table: &Value| table["properties"].as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    let definitions = &schema["$defs"];
    let mut paths = Vec::new();
    for table in ["smoothing", "plausibility"] {
        paths.extend(keys(&schema["properties"][table]).iter().map(|key| format!("{table}.{key}")));
    }
    for key in keys(&definitions["adjust"]) {
        let limits = if key == "mirror" { Vec::new() } else { keys(&definitions["coefficient"]) };
        paths.push(format!("adjust.{key}"));
        paths.extend(limits.iter().map(|limit| format!("adjust.{key}.{limit}")));
    }
    let kinds = schema["properties"]["smoothing"]["properties"]["lids"]["enum"].as_array().unwrap();
    let kinds = kinds.iter().map(ToString::to_string);
    let others =
        ["true", "false", "0", "1", "0.05", "0.21", "1.5", "10.1", "-0.5", "-1.5", "350", "351", "nan", "\"none\""];
    let values: Vec<_> = kinds.chain(others.map(str::to_owned)).collect();
    paths.iter().flat_map(|path| values.iter().map(move |value| format!("{path} = {value}"))).collect()
}

#[test]
fn a_text_of_settings_gives_the_shaping_of_the_service_or_is_refused_as_by_the_service() {
    let [mut taken, mut refused] = [0, 0];
    for entry in entries() {
        let ours = parse_shaping(&entry);
        if let Ok(settings) = parse("", &entry) {
            assert_eq!(ours.unwrap(), shaping(&settings), "{entry}");
            taken += 1;
        } else {
            let (key, _) = entry.split_once(" =").unwrap();
            assert!(matches!(ours, Err(Error::Settings(message)) if message.contains(key)), "{entry}");
            refused += 1;
        }
    }
    assert!(taken > 1000 && refused > 1000, "{taken} {refused}");
    for wrong in [
        "[smothing]",
        "smoothing.jwa = \"off\"",
        "adjust.jawOpen = {min = 0.5, max = 0.4}",
        "= 3",
        "[camera]",
        "adjust = 1",
    ] {
        assert!(matches!(parse_shaping(wrong), Err(Error::Settings(_))), "{wrong}");
    }
    let error = parse_shaping("[smoothing]\njwa_ms = 100").unwrap_err().to_string();
    assert_eq!(error, "settings:2: smoothing.jwa_ms is not a setting; did you mean jaw_ms?");
}

#[test]
fn a_focal_length_counts_in_pictures_of_any_rotation_and_positions_are_in_proportion_to_eye_distance() {
    let focal_px = 320.0 / 30.0_f32.to_radians().tan();
    play(1, |picture, _| {
        let upright = grey(picture);
        let column = |x: usize| (0..SIZE[1]).map(move |y| y * SIZE[0] + x);
        let on_its_side: Vec<u8> = (0..SIZE[0]).rev().flat_map(column).map(|at| upright[at]).collect();
        let upright = Format::Grey.picture(&upright, SIZE).unwrap();
        let on_its_side = Format::Grey.picture(&on_its_side, [SIZE[1], SIZE[0]]).unwrap().rotated(Rotation::Quarter);
        let position_mm = |options: Options, picture: &Picture| {
            let mut tracker = options.open().unwrap();
            tracker.process(picture, Duration::ZERO).unwrap().unwrap().head.position_mm
        };
        let wanted = position_mm(Options::default(), &upright);
        let by_length = Options::default().focal_length_px(focal_px);
        let near = position_mm(Options::default().eye_distance_mm(31.5), &upright).map(|part_mm| 2.0 * part_mm);
        for found in [position_mm(by_length.clone(), &upright), position_mm(by_length, &on_its_side), near] {
            assert!(wanted.iter().zip(&found).all(|(one, other)| (one - other).abs() < 0.5), "{wanted:?} {found:?}");
        }
    });
    for options in [Options::default().focal_length_px(0.0), Options::default().eye_distance_mm(f32::NAN)] {
        assert!(matches!(options.open(), Err(Error::Option(_))));
    }
}

#[test]
fn what_is_known_of_a_wearer_goes_out_as_a_text_that_the_service_reads_too_and_comes_back() {
    let mut clip = Vec::new();
    play(1, |picture, _| clip.push(grey(picture)));
    let mut tracker = FaceTracker::new().unwrap();
    assert!(only_face(&mut tracker, &clip[0], 0).is_some());
    assert_eq!(tracker.profile(), None, "nobody is known by one picture");
    let last = (1..100).map(|time| only_face(&mut tracker, &clip[0], time).unwrap()).last().unwrap();
    assert_eq!(last.neutral, NeutralFace::Estimated);
    let known = tracker.profile().unwrap();
    assert!(tracker.profile_of(last.id) == Some(known.clone()) && tracker.profile_of(last.id + 1).is_none());
    let text = profile_text(&known).unwrap();
    let read = parse_profile(&text).unwrap();
    assert_eq!(read, ProfileFile::parse(&text).unwrap().profile);
    let points = [&known, &read].map(|profile| profile.neutral.iter().flat_map(Neutral::points).collect::<Vec<_>>());
    let pairs = || points[0].as_flattened().iter().zip(points[1].as_flattened());
    assert!(pairs().count() == 3 * 478 && pairs().all(|(one, other)| (one - other).abs() < 1e-4));
    let mut later = Options::default().profile(read.clone()).open().unwrap();
    assert_eq!(only_face(&mut later, &clip[0], 0).unwrap().neutral, NeutralFace::Calibrated);
    assert_eq!(later.profile(), Some(read));
    assert_eq!(profile_text(&Profile::default()), None);
    assert!(matches!(parse_profile("format = 1"), Err(Error::File(_))));
}

#[test]
fn faces_at_rest_become_the_neutral_face_of_the_wearer_or_of_the_one_whose_they_are() {
    let mut clip = Vec::new();
    play(3, |picture, _| clip.push(grey(picture)));
    let pictures: Vec<_> = clip.iter().map(|samples| pair(samples, &stranger(samples, 1.3))).collect();
    let [mut one, mut two] = [1, 2].map(|faces| Options::default().max_faces(faces).open().unwrap());
    let seen = only_face(&mut one, &clip[0], 0).unwrap();
    one.set_neutral([&seen]).unwrap();
    assert_eq!(only_face(&mut one, &clip[1], 1).unwrap().neutral, NeutralFace::Calibrated);
    let show = |two: &mut FaceTracker, number: usize| {
        let picture = Format::Grey.picture(&pictures[number], [2 * SIZE[0], SIZE[1]]).unwrap();
        let mut faces: Vec<_> = two.process_all(&picture, Duration::from_millis(33)).unwrap().cloned().collect();
        faces.sort_by_key(|face| face.id);
        faces
    };
    let faces = show(&mut two, 0);
    assert!(matches!(two.set_neutral(&faces), Err(Error::Face(message)) if message.contains("different ids")));
    let mut gone = faces[1].clone();
    gone.id = 7;
    assert!(matches!(two.set_neutral([&gone]), Err(Error::Face(message)) if message.contains("face 7")));
    assert!(matches!(two.set_neutral([]), Err(Error::Neutral(_))));
    two.set_neutral([&faces[1]]).unwrap();
    let neutral: Vec<_> = show(&mut two, 1).iter().map(|face| face.neutral).collect();
    assert_eq!(neutral, [NeutralFace::Mean, NeutralFace::Calibrated]);
}

/// The picture with something dark over the upper half of this face, as a headset is.
fn covered(picture: &Picture, face: &Face) -> Vec<u8> {
    let Pixels::Planar { planes, strides, chroma_shift: [1, 0] } = picture.pixels() else { panic!() };
    let [left, top, right, bottom] = face.box_px();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "places in a picture")]
    let [left, right, top, bottom] = [left, right, top, top + 0.55 * (bottom - top)].map(|place| place as usize);
    let strides = [strides[0], strides[1], strides[1]];
    let plane = |(plane, stride, dark): (&[u8], usize, u8)| {
        let mut samples = plane[..stride * SIZE[1]].to_vec();
        let part = SIZE[0] / stride;
        for row in samples.chunks_exact_mut(stride).take(bottom).skip(top) {
            row[left / part..right / part].fill(dark);
        }
        samples
    };
    (0..3).flat_map(|at| plane((planes[at], strides[at], [30, 128, 128][at]))).collect()
}

#[test]
fn a_face_in_view_scores_17_to_30_and_one_whose_upper_half_is_covered_less_than_15() {
    let [mut tracker, mut doubting] = [FaceTracker::new().unwrap(), FaceTracker::new().unwrap()];
    let [mut clear, mut doubtful] = [Vec::new(), Vec::new()];
    play(30, |picture, time| {
        let face = tracker.process(picture, time).unwrap().unwrap();
        clear.push(face.score);
        let samples = covered(picture, face);
        let picture = Format::I422.picture(&samples, SIZE).unwrap();
        doubtful.extend(doubting.process(&picture, time).unwrap().map(|face| face.score));
    });
    assert!(clear.iter().all(|score| (17.0..30.0).contains(score)), "{clear:?}");
    doubtful.sort_by(f32::total_cmp);
    assert!(doubtful.len() > 20 && doubtful[0] >= 0.0 && doubtful[doubtful.len() / 2] < 15.0, "{doubtful:?}");
}

#[test]
fn the_box_of_a_face_is_the_smallest_around_its_landmarks() {
    let face = faces(FaceTracker::new().unwrap(), 1, grey, Format::Grey).remove(0);
    let [left, top, right, bottom] = face.box_px();
    let all = || face.landmarks.0.iter();
    assert!(all().all(|[x, y, _]| (left..=right).contains(x) && (top..=bottom).contains(y)));
    assert!([left, right].iter().all(|side| all().any(|[x, ..]| x == side)), "{left} {right}");
    assert!([top, bottom].iter().all(|side| all().any(|[_, y, _]| y == side)), "{top} {bottom}");
}

#[test]
fn films_of_people_who_come_and_go_give_the_bits_of_the_service() {
    for (size, film) in films() {
        let mut both = both(NeutralMode::Auto);
        let solved = film.chunks(2 * size[0] * size[1]).zip(0..).filter(|(samples, number)| {
            let content = Content::Picture(Format::I422.picture(samples, size).unwrap());
            is_same(&mut both, &Frame { content, captured_us: number * 1_000_000 / 30, number: *number })
        });
        let solved = solved.count();
        assert!(solved > 50, "{solved} frames");
    }
}

#[test]
fn nothing_is_allocated_while_faces_are_followed_lost_and_found() {
    let mut tracker = Options::default().max_faces(2).open().unwrap();
    let empty = vec![128; SIZE[0] * SIZE[1]];
    play(90, |picture, time| {
        let is_face = !(Duration::from_secs(1)..Duration::from_millis(1500)).contains(&time);
        let empty = Format::Grey.picture(&empty, SIZE).unwrap();
        let mut is_seen = false;
        let allocated = allocation_counter::measure(|| {
            is_seen = tracker.process(if is_face { picture } else { &empty }, time).unwrap().is_some();
        });
        assert_eq!((allocated.count_total, is_seen), (0, is_face), "{time:?}");
    });
}

#[test]
fn every_order_of_colours_gives_the_same_face_which_is_that_of_the_planes() {
    let track = |format: Format, order: &[usize]| {
        faces(FaceTracker::new().unwrap(), 20, |picture| coloured(picture, order), format)
    };
    let rgb = track(Format::Rgb, &[0, 1, 2]);
    for (format, order) in [(Format::Bgr, &[2, 1, 0][..]), (Format::Rgba, &[0, 1, 2, 3]), (Format::Bgra, &[2, 1, 0, 3])]
    {
        assert_eq!(track(format, order), rgb, "{format:?}");
    }
    let mut tracker = FaceTracker::new().unwrap();
    let mut rgb = rgb.iter();
    play(20, |picture, time| {
        let (planar, rgb) = (tracker.process(picture, time).unwrap().unwrap(), rgb.next().unwrap());
        let pairs = planar.landmarks.0.as_flattened().iter().zip(rgb.landmarks.0.as_flattened());
        let worst = pairs.map(|(one, other)| (one - other).abs()).fold(0.0, f32::max);
        assert!(worst < 1.5, "{worst} px");
    });
}

/// Two frames of the clip side by side.
fn pair(left: &[u8], right: &[u8]) -> Vec<u8> {
    left.chunks(SIZE[0]).zip(right.chunks(SIZE[0])).flat_map(|(left, right)| [left, right].concat()).collect()
}

/// All faces in each of sixty pictures, from left to right.
fn follow(max_faces: usize, samples: impl Fn(usize) -> Vec<u8>) -> Vec<Vec<Face>> {
    let mut tracker = Options::default().max_faces(max_faces).open().unwrap();
    let mut faces = |frame: usize| {
        let samples = samples(frame);
        let picture = Format::Grey.picture(&samples, [2 * SIZE[0], SIZE[1]]).unwrap();
        let time = Duration::from_millis(33 * frame as u64);
        let mut found: Vec<_> = tracker.process_all(&picture, time).unwrap().cloned().collect();
        found.sort_by(|one, other| one.landmarks.0[1][0].total_cmp(&other.landmarks.0[1][0]));
        found
    };
    (0..60).map(&mut faces).collect()
}

fn grey(picture: &Picture) -> Vec<u8> {
    let Pixels::Planar { planes: [luma, ..], strides: [640, _], .. } = picture.pixels() else { panic!() };
    luma[..SIZE[0] * SIZE[1]].to_vec()
}

#[test]
fn each_of_two_faces_has_an_identity_and_a_history_and_reads_like_the_same_face_alone() {
    let mut films = Vec::new();
    play(120, |picture, _| films.push(grey(picture)));
    let nobody = vec![128; SIZE[0] * SIZE[1]];
    let both = |frame: usize| pair(&films[frame], &films[60 + frame]);
    // The same size and place as in the pair, because the detector sees a smaller face differently. The region that it finds
    // still depends a little on what is beside the face, and the next regions come from it.
    let left = |frame: usize| pair(&films[frame], &nobody);
    let right = |frame: usize| pair(&nobody, &films[60 + frame]);
    let only = |film: Vec<Vec<Face>>| film.into_iter().flatten().collect::<Vec<_>>();
    let (alone_left, alone_right, one_of_both) = (only(follow(1, left)), only(follow(1, right)), only(follow(1, both)));
    let found = follow(3, both);
    let ids: Vec<_> = found.iter().map(|faces| faces.iter().map(|face| face.id).collect::<Vec<_>>()).collect();
    assert!(ids.iter().all(|pair| *pair == ids[0] && pair.len() == 2 && pair[0] != pair[1]), "{ids:?}");
    for (frame, faces) in found.iter().enumerate() {
        assert!(faces.contains(&one_of_both[frame]), "a second face changes no bit of the first: frame {frame}");
        for (face, alone) in faces.iter().zip([&alone_left[frame], &alone_right[frame]]).filter(|_| frame > 6) {
            let pairs = || face.coefficients.iter().zip(&alone.coefficients);
            let mean = pairs().map(|(one, other)| (one - other).abs()).sum::<f32>() / 52.0;
            assert!(mean < 0.005, "frame {frame}: {mean}");
            for ((one, other), name) in pairs().zip(BLENDSHAPES) {
                // A lid that closes is half way for one frame, in which the smallest shift of the region shows.
                let most = if name.starts_with("eyeBlink") { 0.15 } else { 0.05 };
                assert!((one - other).abs() < most, "frame {frame}, {name}: {one} {other}");
            }
        }
    }
}

/// The face of another person: darker, and so many times as wide.
fn stranger(samples: &[u8], width: f32) -> Vec<u8> {
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates"
    )]
    let place = |x: usize| ((x as f32 - 320.0) / width + 320.0) as usize;
    let widened = |row: &[u8]| (0..SIZE[0]).map(|x| row[place(x).min(SIZE[0] - 1)] / 3 * 2).collect::<Vec<_>>();
    samples.chunks(SIZE[0]).flat_map(widened).collect()
}

/// The only face in a picture that was taken at this time.
fn only_face(tracker: &mut FaceTracker, samples: &[u8], number: u64) -> Option<Face> {
    let picture = Format::Grey.picture(samples, SIZE).unwrap();
    tracker.process(&picture, Duration::from_millis(100 * number)).unwrap().cloned()
}

#[test]
fn of_several_faces_a_stranger_begins_anew_and_who_comes_back_has_the_neutral_face_of_before() {
    let mut clip = Vec::new();
    play(20, |picture, _| clip.push(grey(picture)));
    let [mut tracker, mut fresh] = [(); 2].map(|()| Options::default().max_faces(2).open().unwrap());
    let nobody = vec![128; SIZE[0] * SIZE[1]];
    let at_rest: Vec<_> = (0..100).map(|time| only_face(&mut tracker, &clip[0], time).unwrap().neutral).collect();
    assert_eq!((at_rest[0], at_rest[99]), (NeutralFace::Mean, NeutralFace::Estimated));
    // Two strangers, one after the other, for whom there is memory of one.
    for (began, width) in [(100, 1.3), (200, 0.75)] {
        assert!(only_face(&mut tracker, &nobody, began).is_none());
        fresh.reset();
        for (samples, time) in clip.iter().zip(began + 1..) {
            let samples = stranger(samples, width);
            let [face, wanted] = [&mut tracker, &mut fresh].map(|tracker| only_face(tracker, &samples, time).unwrap());
            assert!(with_id(face, &wanted) == wanted, "at {time}");
        }
    }
    assert!(only_face(&mut tracker, &nobody, 300).is_none());
    assert_eq!(only_face(&mut tracker, &clip[0], 301).unwrap().neutral, NeutralFace::Estimated);
}

#[test]
fn the_profile_is_that_of_the_first_face_alone_and_another_one_can_be_given_to_each() {
    let mut clip = Vec::new();
    play(60, |picture, _| clip.push(grey(picture)));
    let pictures: Vec<_> = clip.iter().map(|samples| pair(samples, &stranger(samples, 1.3))).collect();
    let profile = Profile::from(neutral_of(&follow(1, |_| pictures[0].clone())[9]).unwrap());
    let mut tracker = Options::default().max_faces(2).profile(profile.clone()).open().unwrap();
    let show = |tracker: &mut FaceTracker, samples: &[u8], number: usize| {
        let picture = Format::Grey.picture(samples, [2 * SIZE[0], SIZE[1]]).unwrap();
        let found = tracker.process_all(&picture, Duration::from_millis(33 * number as u64)).unwrap();
        let mut found: Vec<_> = found.map(|face| (face.id, face.neutral)).collect();
        found.sort_by_key(|(id, _)| *id);
        found
    };
    let (calibrated, mean) = (NeutralFace::Calibrated, NeutralFace::Mean);
    assert_eq!(show(&mut tracker, &pictures[0], 0), [(1, calibrated), (2, mean)]);
    assert!(tracker.set_profile_of(2, &profile) && !tracker.set_profile_of(3, &profile));
    assert!(tracker.set_profile_of(1, &Profile::default()));
    assert_eq!(show(&mut tracker, &pictures[1], 1), [(1, mean), (2, calibrated)]);
    tracker.set_profile(&profile);
    assert_eq!(show(&mut tracker, &pictures[2], 2), [(1, calibrated), (2, calibrated)]);
    tracker.reset();
    assert_eq!(show(&mut tracker, &pictures[3], 3), [(3, calibrated), (4, mean)]);
}

#[test]
fn a_face_that_has_left_is_gone_while_the_other_stays() {
    let mut tracker = Options::default().max_faces(2).open().unwrap();
    let mut count = |samples: &[u8]| {
        let picture = Format::Grey.picture(samples, [2 * SIZE[0], SIZE[1]]).unwrap();
        tracker.process_all(&picture, Duration::ZERO).unwrap().map(|face| face.id).collect::<Vec<_>>()
    };
    play(1, |picture, _| {
        let (face, nobody) = (grey(picture), vec![128; SIZE[0] * SIZE[1]]);
        let both = count(&pair(&face, &face));
        let left = count(&pair(&face, &nobody));
        assert!(both.len() == 2 && left.len() == 1 && both.contains(&left[0]), "{both:?} {left:?}");
    });
}

#[test]
fn single_pictures_have_no_history() {
    let mut tracker = Options::for_stills().max_faces(2).open().unwrap();
    let (mut first, mut last) = (None, None);
    play(40, |picture, _| {
        let samples = grey(picture);
        let mut find = |samples: &[u8]| {
            let picture = Format::Grey.picture(samples, SIZE).unwrap();
            tracker.process(&picture, Duration::ZERO).unwrap().unwrap().clone()
        };
        let (before, samples) = first.get_or_insert_with(|| (find(&samples), samples.clone()));
        last = Some(*before == with_id(find(samples), before));
    });
    assert_eq!(last, Some(true));
}

fn with_id(mut face: Face, of: &Face) -> Face {
    face.id = of.id;
    face
}

#[test]
fn the_profile_of_a_calibration_is_read_as_the_service_reads_it_and_another_file_is_refused() {
    let seen = faces(FaceTracker::new().unwrap(), 10, grey, Format::Grey);
    let neutral: Neutral = neutral_of(&seen).unwrap();
    let mut profile = Profile::from(neutral);
    (profile.rest, profile.gain) = ([-0.05; 52], [1.25; 52]);
    let file = ProfileFile { profile, model: Some(7), takes: Vec::new(), made_at_unix_s: 7 };
    let (folder, text) = (tempfile::tempdir().unwrap(), file.text());
    let path = folder.path().join("anna.toml");
    std::fs::write(&path, &text).unwrap();
    assert_eq!(read_profile(&path).unwrap(), ProfileFile::parse(&text).unwrap().profile);
    let mut tracker = FaceTracker::new().unwrap();
    tracker.set_profile(&read_profile(&path).unwrap());
    for damaged in [
        text.replace("gain = 1.25", "gain = 99.0"),
        text.replace("format = 1", "format = 2"),
        text.replace("takes = ", "wears = \"headset\"\ntakes = "),
        text[..900].to_owned(),
    ] {
        std::fs::write(&path, damaged).unwrap();
        assert!(matches!(read_profile(&path), Err(Error::File(message)) if message.contains("anna.toml")));
    }
    assert!(matches!(neutral_of(&[]), Err(Error::Neutral(_))));
}

#[test]
fn a_new_neutral_face_does_not_move_the_gaze_of_a_still_face() {
    play(1, |picture, _| {
        let mut tracker = Options::default().neutral(NeutralMode::Off).open().unwrap();
        let show = |tracker: &mut FaceTracker, tenths_s: u64| {
            tracker.process(picture, Duration::from_millis(100 * tenths_s)).unwrap().unwrap().clone()
        };
        let before: Vec<_> = (0..100).map(|time| show(&mut tracker, time)).collect();
        tracker.set_profile(&neutral_of(&before[80..]).unwrap().into());
        let was_deg = before[99].gaze.yaw_pitch_deg;
        for time in 100..300 {
            let face = show(&mut tracker, time);
            assert_eq!(face.neutral, NeutralFace::Calibrated);
            let moved_deg = [0, 1].map(|axis| (face.gaze.yaw_pitch_deg[axis] - was_deg[axis]).abs());
            assert!(moved_deg.iter().all(|deg| *deg < 0.3), "{moved_deg:?} after {} tenths of a second", time - 99);
        }
    });
}

#[test]
fn options_that_make_no_sense_and_missing_files_are_errors_that_name_them() {
    let error = |options: Options| options.open().err().unwrap().to_string();
    assert!(error(Options::default().max_faces(0)).contains("max_faces"));
    assert!(error(Options::default().threads(1000)).contains("threads"));
    assert!(error(Options::default().horizontal_fov_deg(f32::NAN)).contains("horizontal_fov_deg"));
    let both = Options::default().horizontal_fov_deg(f32::NAN).focal_length_px(500.0);
    assert!(error(both).contains("horizontal_fov_deg"));
    assert!(error(Options::default().networks("/nonexistent")).contains("/nonexistent"));
    assert!(error(Options::default().model("/nonexistent.toml")).contains("/nonexistent.toml"));
    let filtered = parse_shaping("smoothing.jaw_ms = 100").unwrap();
    for (options, by) in [
        (Options::for_stills(), "for_stills()"),
        (Options::for_stills().smoothing(true), "for_stills()"),
        (Options::default().smoothing(false), "smoothing(false)"),
    ] {
        let error = error(options.shaping(filtered.clone()));
        assert!(error.contains("[smoothing]") && error.contains(by), "{error}");
    }
}

#[test]
fn networks_are_loaded_from_a_folder_of_any_name() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join(OsStr::from_bytes(b"no UTF-8: \xff"));
    symlink(NetworkFolder::find("").unwrap().path(), &link).unwrap();
    Options::default().networks(link).open().unwrap();
}

#[test]
fn trackers_work_in_threads_of_their_own() {
    let run = || faces(FaceTracker::new().unwrap(), 10, grey, Format::Grey);
    let tracker = FaceTracker::new().unwrap();
    let moved = std::thread::spawn(move || faces(tracker, 10, grey, Format::Grey));
    let others: Vec<_> = (0..2).map(|_| std::thread::spawn(run)).collect();
    let wanted = moved.join().unwrap();
    assert!(others.into_iter().all(|other| other.join().unwrap() == wanted));
}
