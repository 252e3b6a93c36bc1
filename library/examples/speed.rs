//! Times a tracker on the built-in clip in several formats, and prints what it adds to the memory of the process:
//! `cargo run --release -p facewire-library --features built-in --example speed [ROUNDS]`
//!
//! A round plays the first two seconds once in each format, so that all formats see the same state of the machine. Each picture
//! is first copied into the same memory, as a camera does.

use std::time::{Duration, Instant};
use std::{env, error::Error, fs, iter};

use facewire::capture::{Clip, Source as _};
use facewire_library::{FaceTracker, Format, Picture, Pixels};

const FRAMES: usize = 60;
const SIZE: [usize; 2] = [640, 480];
const FORMATS: [Format; 4] = [Format::I422, Format::Grey, Format::Rgb, Format::Bgra];

fn main() -> Result<(), Box<dyn Error>> {
    let rounds = env::args().nth(1).map_or(Ok(5), |rounds| rounds.parse())?;
    let [rss, peak] = memory_kb()?;
    let (begun, mut tracker) = (Instant::now(), FaceTracker::new()?);
    let opened_ms = begun.elapsed().as_secs_f64() * 1e3;
    let [now, most] = memory_kb()?;
    let (more, most) = ((now - rss) / 1e3, (most - peak) / 1e3);
    println!("opened in {opened_ms:.1} ms; memory {more:.2} MB more, at its peak {most:.2} MB more");
    let films = FORMATS.map(film).into_iter().collect::<Result<Vec<_>, _>>()?;
    let (mut memory, mut times) = (Vec::new(), FORMATS.map(|_| Vec::new()));
    for _ in 0..rounds {
        for ((format, film), times) in FORMATS.into_iter().zip(&films).zip(&mut times) {
            tracker.reset();
            for (number, samples) in (0..).zip(film) {
                memory.clone_from(samples);
                let picture = format.picture(&memory, SIZE)?;
                let begun = Instant::now();
                let is_found = tracker.process(&picture, Duration::from_millis(33 * number))?.is_some();
                // The first picture does not count, because the detector must find the face in it.
                if number > 0 && is_found {
                    times.push(begun.elapsed());
                }
            }
        }
    }
    for (format, times) in FORMATS.iter().zip(&mut times) {
        times.sort_unstable();
        let at = |share: usize| times.get(times.len() * share / 100).map_or(0.0, |time| time.as_secs_f64() * 1e3);
        println!("{:<5}{:.3} ms median, {:.3} to {:.3} ms for 80 % of pictures", format.name(), at(50), at(10), at(90));
    }
    Ok(())
}

/// The first pictures of the clip in a format. What colours they have does not matter here.
fn film(format: Format) -> Result<Vec<Vec<u8>>, Box<dyn Error>> {
    let (mut clip, mut film) = (Clip::once()?, Vec::new());
    while film.len() < FRAMES {
        let frame = clip.next()?.ok_or("the clip is too short")?;
        let Some(Pixels::Planar { planes: [luma, cb, cr], strides: [640, 320], .. }) =
            frame.picture().map(Picture::pixels)
        else {
            return Err("the clip is 4:2:2 without padding".into());
        };
        let luma = luma.get(..SIZE[0] * SIZE[1]).ok_or("a plane of the clip is too short")?;
        film.push(match format {
            Format::I422 => [luma, cb, cr].concat(),
            _ => luma.iter().flat_map(|luma| iter::repeat_n(*luma, format.row_bytes(1))).collect(),
        });
    }
    Ok(film)
}

/// Memory that the process has now, and had at most.
fn memory_kb() -> Result<[f64; 2], Box<dyn Error>> {
    let status = fs::read_to_string("/proc/self/status")?;
    let value = |name: &str| -> Result<f64, Box<dyn Error>> {
        let line = status.lines().find(|line| line.starts_with(name)).ok_or("/proc/self/status lacks a line")?;
        Ok(line.split_whitespace().nth(1).ok_or("/proc/self/status lacks a number")?.parse()?)
    };
    Ok([value("VmRSS:")?, value("VmHWM:")?])
}
