//! Writes what the bindings for other languages are compared with: the pictures of the built-in clip as `film.i422` (640 x 480,
//! full range), and what this crate finds in them as `expected.f32`: for each picture 52 coefficients, the rotation, the
//! position and 478 landmarks, little-endian; all not-a-number without a face.
//!
//! `cargo run -p facewire-library --example golden FOLDER [FRAMES]`

use std::fs::{self, File};
use std::io::{BufWriter, Write as _};
use std::path::Path;
use std::time::Duration;
use std::{env, error::Error};

use facewire::capture::{Clip, Source as _};
use facewire_library::{FaceTracker, LANDMARKS, Pixels};

const VALUES: usize = 52 + 4 + 3 + 3 * LANDMARKS;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = env::args().nth(1).ok_or("usage: golden FOLDER [FRAMES]")?;
    let frames = env::args().nth(2).map_or(Ok(usize::MAX), |frames| frames.parse())?;
    fs::create_dir_all(&folder)?;
    let create = |name: &str| File::create(Path::new(&folder).join(name)).map(BufWriter::new);
    let (mut film, mut expected) = (create("film.i422")?, create("expected.f32")?);
    let (mut clip, mut tracker) = (Clip::once()?, FaceTracker::new()?);
    for _ in 0..frames {
        let Some(frame) = clip.next()? else { break };
        let picture = frame.picture().ok_or("the clip has pictures")?;
        let Pixels::Planar { planes: [luma, cb, cr], strides: [640, 320], chroma_shift: [1, 0] } = picture.pixels
        else {
            return Err("the clip is 4:2:2 without padding".into());
        };
        for (plane, bytes) in [(luma, 640 * 480), (cb, 320 * 480), (cr, 320 * 480)] {
            film.write_all(plane.get(..bytes).ok_or("a whole plane")?)?;
        }
        let mut values = [f32::NAN; VALUES];
        if let Some(face) = tracker.process(picture, Duration::from_micros(frame.captured_us))? {
            let numbers = face.coefficients.iter().chain(&face.head.rotation_xyzw).chain(&face.head.position_mm);
            let all = numbers.chain(face.landmarks.0.as_flattened());
            values.iter_mut().zip(all).for_each(|(value, found)| *value = *found);
        }
        for value in values {
            expected.write_all(&value.to_le_bytes())?;
        }
    }
    film.flush()?;
    Ok(expected.flush()?)
}
