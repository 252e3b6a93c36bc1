//! Runs one step of a frame a number of times and prints its time; with `COLD=1` after other data filled the caches. Under
//! callgrind or an emulator that counts instructions, the difference of two numbers of runs is what one run takes.
//!
//! - `steps crop FORMAT SIZE ANGLE TIMES`: a region of SIZE px, turned by ANGLE degrees, in a picture of 640 x 480 whose
//!   FORMAT is yuyv, nv12, grey or planar
//! - `steps detector FORMAT TIMES`: the crop of the whole picture
//! - `steps solve POINTS.npy TIMES`: the first landmarks of a file

use std::error::Error;
use std::fs::File;
use std::io::BufReader;
use std::time::Instant;

use facewire::config::Settings;
use facewire::pipeline::load_solver;
use facewire_face::Camera;
use facewire_face::stages::{Block, Border, CropShape, crop};
use facewire_face::{Appearance, Face, FaceBox};
use facewire_face::{Landmarks, Picture, Pixels};
use npyz::NpyFile;

const SIZE: [usize; 2] = [640, 480];

fn picture<'a>(format: &str, data: &'a [u8]) -> Option<Picture<'a>> {
    let [width, height] = SIZE;
    let (luma, rest) = data.split_at(width * height);
    let (cb, cr) = rest.split_at(width * height / 4);
    let pixels = match format {
        "yuyv" => Pixels::Yuyv { data, stride: 2 * width },
        "nv12" => Pixels::Nv12 { luma, chroma: rest, stride: width },
        "grey" => Pixels::Grey { data, stride: width },
        "planar" => Pixels::Planar { planes: [luma, cb, cr], strides: [width, width / 2], chroma_shift: [1, 1] },
        _ => return None,
    };
    Picture::new(width, height, pixels, format == "planar")
}

/// Runs a step a number of times and prints the median and the longest of the times that it took. `COLD=1` fills the
/// caches with other data before each run.
fn repeat(times: &str, mut step: impl FnMut()) -> Result<(), Box<dyn Error>> {
    let mut other = vec![0_u8; if std::env::var_os("COLD").is_some() { 3 << 20 } else { 0 }];
    let mut took_us = Vec::new();
    for _ in 0..times.parse()? {
        other.iter_mut().step_by(64).for_each(|byte| *byte = byte.wrapping_add(1));
        let begun = Instant::now();
        step();
        took_us.push(begun.elapsed().as_secs_f64() * 1e6);
    }
    took_us.sort_by(f64::total_cmp);
    let share =
        |share: usize| took_us.get((took_us.len() * share / 100).min(took_us.len() - 1)).copied().unwrap_or(0.0);
    println!("p50 {:.1} us, p99 {:.1} us", share(50), share(99));
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let mut random = fastrand::Rng::with_seed(1);
    let data: Vec<u8> = (0..SIZE[0] * SIZE[1] * 2).map(|_| random.u8(..)).collect();
    match arguments[..] {
        ["crop", format, size, angle, times] => {
            let picture = picture(format, &data).ok_or("no such format")?;
            let shape = CropShape { side: 192, range: [0.0, 1.0], border: Border::Replicate };
            let region =
                FaceBox { centre: [310.3, 241.7], size: size.parse()?, angle_rad: angle.parse::<f32>()?.to_radians() };
            let (mut block, mut input) = (Block::default(), vec![[0.0; 3 * 192]; 192]);
            repeat(times, || crop(&picture, &region, shape, &mut block, &mut input))
        }
        ["detector", format, times] => {
            let picture = picture(format, &data).ok_or("no such format")?;
            let shape = CropShape { side: 128, range: [-1.0, 1.0], border: Border::Black };
            let region = FaceBox { centre: [320.0, 240.0], size: 640.0, angle_rad: 0.0 };
            let (mut block, mut input) = (Block::default(), vec![[0.0; 3 * 128]; 128]);
            repeat(times, || crop(&picture, &region, shape, &mut block, &mut input))
        }
        ["solve", path, times] => {
            let mut solver = load_solver(&Settings::default())?;
            let values: Vec<f32> = NpyFile::new(BufReader::new(File::open(path)?))?.into_vec()?;
            let frame = values.as_chunks().0.first_chunk().ok_or("no frame")?;
            let face = &Landmarks(*frame);
            // A file does not tell how the face looks. The values make no difference to the time.
            let appearance = Appearance::zero();
            let face = Face { appearance: Some(&appearance), ..Face::from(face) };
            let camera = Camera::new([640.0, 480.0], 60.0);
            let mut time_us = 0;
            repeat(times, || {
                time_us += 33_333;
                let _ = std::hint::black_box(solver.solve(face, &camera, time_us));
            })
        }
        _ => Err("see the first lines of the source".into()),
    }
}
