//! Shows the strongest blendshapes of whoever sits before the first camera, as bars in the terminal:
//! `cargo run --release -p facewire-library --example webcam [DEVICE]`

use std::time::{Duration, Instant};
use std::{env, error::Error};

use facewire::capture::v4l2::Wish;
use facewire::capture::{FrameRate, open_camera};
use facewire_library::{BLENDSHAPES, FaceTracker};

fn main() -> Result<(), Box<dyn Error>> {
    let device = env::args().nth(1).unwrap_or_else(|| "auto".to_owned());
    let wish = Wish { width: 640, height: 480, rate: FrameRate::FPS_30, format: None };
    let mut camera = open_camera(&device, &wish, Duration::from_secs(2))?;
    let (mut tracker, begun) = (FaceTracker::new()?, Instant::now());
    while let Some(frame) = camera.next()? {
        let picture = frame.picture().ok_or("a camera gives pictures")?;
        // Clears the screen.
        print!("\x1b[2J\x1b[H");
        match tracker.process(picture, begun.elapsed())? {
            None => println!("no face"),
            Some(face) => {
                for (name, value) in BLENDSHAPES.iter().zip(face.coefficients).filter(|(_, value)| *value > 0.05) {
                    println!(
                        "{name:<20} {}",
                        (0_u8..40).filter(|step| f32::from(*step) / 40.0 < value).map(|_| '#').collect::<String>()
                    );
                }
            }
        }
    }
    Ok(())
}
