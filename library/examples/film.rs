//! Writes the coefficients of each frame that shows a face of a Motion-JPEG film as CSV to standard output:
//! `cargo run --release -p facewire-library --example film FILE.avi`
//!
//! The decoder is that of the service. With another one, only the picture of a frame comes from elsewhere.

use std::fs::File;
use std::io::{self, Write as _};
use std::time::Duration;
use std::{env, error::Error};

use facewire::capture::{AviSource, FrameRate, Source as _};
use facewire_library::{BLENDSHAPES, FaceTracker};

fn main() -> Result<(), Box<dyn Error>> {
    let path = env::args().nth(1).ok_or("usage: film FILE.avi")?;
    let mut film = AviSource::open(File::open(&path)?, &path, FrameRate::FPS_30)?;
    let (mut tracker, mut out) = (FaceTracker::new()?, io::stdout().lock());
    writeln!(out, "time_s,{},yaw_deg,pitch_deg,roll_deg", BLENDSHAPES.join(","))?;
    while let Some(frame) = film.next()? {
        let time = Duration::from_micros(frame.captured_us);
        let picture = frame.picture().ok_or("a film has pictures")?;
        if let Some(face) = tracker.process(picture, time)? {
            let angles = face.head.yaw_pitch_roll_deg();
            let numbers = face.coefficients.iter().chain(&angles).map(|value| format!(",{value:.4}"));
            writeln!(out, "{:.3}{}", time.as_secs_f64(), numbers.collect::<String>())?;
        }
    }
    Ok(())
}
