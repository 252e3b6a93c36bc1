//! Writes what the Python package is compared with, to the last bit: the planes of a Motion-JPEG film as `film.FORMAT`, its size
//! as `size`, the times of its frames in microseconds as `times.u64`, and what is found in them as `crate.f32` (by
//! facewire-library) and `service.f32` (by the pipeline behind `facewire track --neutral auto`): for each frame 52 coefficients,
//! the rotation, the position and 478 landmarks, all not-a-number without a face. Numbers are little-endian.
//!
//! `cargo run -p facewire-python --example exact FILM.avi FOLDER`

use std::error::Error;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Duration;
use std::{env, io};

use facewire::capture::{AviSource, FrameRate, Source as _};
use facewire::config::Settings;
use facewire::pipeline::Pipeline;
use facewire::playback::Playback;
use facewire_library::{FaceTracker, Landmarks, NeutralMode, Picture, Pixels};

fn main() -> Result<(), Box<dyn Error>> {
    let usage = "usage: exact FILM.avi FOLDER";
    let (path, folder) = (env::args().nth(1).ok_or(usage)?, env::args().nth(2).ok_or(usage)?);
    fs::create_dir_all(&folder)?;
    let create = |name: &str| File::create(Path::new(&folder).join(name)).map(BufWriter::new);
    let open = || -> Result<_, Box<dyn Error>> { Ok(AviSource::open(File::open(&path)?, &path, FrameRate::FPS_30)?) };

    let (mut film, mut tracker, mut out, mut times) =
        (open()?, FaceTracker::new()?, create("crate.f32")?, create("times.u64")?);
    let mut planes = None;
    while let Some(frame) = film.next()? {
        let picture = frame.picture().ok_or("the film has a frame without a picture")?;
        let (file, format) = match &mut planes {
            Some(begun) => begun,
            None => {
                let format = format_of(picture)?;
                let [width, height] = [picture.width(), picture.height()];
                write!(create("size")?, "{width} {height} {format}")?;
                planes.insert((create(&format!("film.{format}"))?, format))
            }
        };
        (*format == format_of(picture)?).then_some(()).ok_or("the pictures of the film differ in format")?;
        write_planes(picture, file)?;
        times.write_all(&frame.captured_us.to_le_bytes())?;
        let found = tracker.process(picture, Duration::from_micros(frame.captured_us))?;
        let numbers =
            found.map(|face| (face.coefficients, face.head.rotation_xyzw, face.head.position_mm, &face.landmarks));
        write_numbers(numbers, &mut out)?;
    }
    out.flush()?;

    let (mut film, settings, mut out) = (open()?, Settings::default(), create("service.f32")?);
    let mut pipeline = Pipeline::load(&settings, true)?;
    pipeline.solver.neutral_mode = NeutralMode::Auto;
    let mut playback = Playback::new(pipeline, &settings.failsafe);
    while let Some(face) = playback.find(&mut film)? {
        let solution = playback.show(&face).solution;
        let numbers = solution.as_ref().zip(face.landmarks.as_deref());
        let numbers = numbers.map(|(solution, landmarks)| {
            (solution.smoothed.0, solution.head.rotation_xyzw, solution.head.position_mm, landmarks)
        });
        write_numbers(numbers, &mut out)?;
    }
    Ok(out.flush()?)
}

fn format_of(picture: &Picture) -> Result<&'static str, &'static str> {
    match picture.pixels() {
        Pixels::Planar { chroma_shift: [1, 1], .. } => Ok("i420"),
        Pixels::Planar { chroma_shift: [1, 0], .. } => Ok("i422"),
        Pixels::Planar { chroma_shift: [0, 0], .. } => Ok("i444"),
        _ => Err("the film is not in colour"),
    }
}

fn write_planes(picture: &Picture, out: &mut impl Write) -> io::Result<()> {
    let Pixels::Planar { planes, strides: [luma, chroma], chroma_shift: [right, down] } = picture.pixels() else {
        return Ok(());
    };
    for (plane, stride, size) in [
        (planes[0], luma, [picture.width(), picture.height()]),
        (planes[1], chroma, [picture.width().div_ceil(1 << right), picture.height().div_ceil(1 << down)]),
        (planes[2], chroma, [picture.width().div_ceil(1 << right), picture.height().div_ceil(1 << down)]),
    ] {
        for row in plane.chunks(stride).take(size[1]) {
            out.write_all(row.get(..size[0]).unwrap_or(row))?;
        }
    }
    Ok(())
}

/// What is found in a frame: coefficients, rotation, position and landmarks.
type Found<'a> = ([f32; 52], [f32; 4], [f32; 3], &'a Landmarks);

fn write_numbers(found: Option<Found>, out: &mut impl Write) -> io::Result<()> {
    let missing = Landmarks([[f32::NAN; 3]; 478]);
    let (coefficients, rotation, position, landmarks) =
        found.unwrap_or(([f32::NAN; 52], [f32::NAN; 4], [f32::NAN; 3], &missing));
    let all = coefficients.iter().chain(&rotation).chain(&position).chain(landmarks.0.as_flattened());
    let bytes: Vec<u8> = all.flat_map(|number| number.to_le_bytes()).collect();
    out.write_all(&bytes)
}
