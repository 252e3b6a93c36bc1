//! Shows whoever sits before the first camera in a window, with the landmarks and a bar for each blendshape; the title names the
//! strongest: `cargo run --release -p facewire-library --example webcam [DEVICE]`

use std::time::{Duration, Instant};
use std::{env, error::Error};

use facewire::capture::v4l2::Wish;
use facewire::capture::{FrameRate, open_camera};
use facewire_library::{BLENDSHAPES, Face, FaceTracker, Picture, Pixels};
use minifb::{Window, WindowOptions};

const BAR_PX: usize = 8;

fn main() -> Result<(), Box<dyn Error>> {
    let device = env::args().nth(1).unwrap_or_else(|| "auto".to_owned());
    let wish = Wish { width: 640, height: 480, rate: FrameRate::FPS_30, format: None };
    let mut camera = open_camera(&device, &wish, Duration::from_secs(2))?;
    let (mut tracker, begun) = (FaceTracker::new()?, Instant::now());
    let mut window = Window::new("facewire", 640, 480, WindowOptions { resize: true, ..WindowOptions::default() })?;
    while let Some(frame) = camera.next()?.filter(|_| window.is_open()) {
        let picture = frame.picture().ok_or("a camera gives pictures")?;
        let mut canvas = grey(picture);
        let face = tracker.process(picture, begun.elapsed())?;
        let strongest =
            face.and_then(|face| BLENDSHAPES.iter().zip(face.coefficients).max_by(|a, b| a.1.total_cmp(&b.1)));
        window.set_title(&strongest.map_or("no face".to_owned(), |(name, value)| format!("{name} {value:.2}")));
        if let Some(face) = face {
            draw(face, picture.width(), &mut canvas);
        }
        window.update_with_buffer(&canvas, picture.width(), picture.height())?;
    }
    Ok(())
}

/// The brightness of a picture, as the window takes it.
fn grey(picture: &Picture) -> Vec<u32> {
    let (samples, stride, step) = match picture.pixels() {
        Pixels::Grey { data: luma, stride }
        | Pixels::Nv12 { luma, stride, .. }
        | Pixels::Planar { planes: [luma, ..], strides: [stride, _], .. } => (luma, stride, 1),
        Pixels::Yuyv { data, stride } => (data, stride, 2),
        // Green is most of the brightness.
        Pixels::Packed { data, stride, step, rgb: [_, green, _] } => {
            (data.get(green..).unwrap_or_default(), stride, step)
        }
    };
    let rows = samples.chunks(stride).take(picture.height());
    rows.flat_map(|row| row.iter().step_by(step).take(picture.width()))
        .map(|luma| u32::from(*luma) * 0x01_01_01)
        .collect()
}

/// Draws landmarks and bars into a picture of this width.
fn draw(face: &Face, width: usize, canvas: &mut [u32]) {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    let whole = |number: f32| number as usize;
    for [x, y, _] in &face.landmarks.0 {
        if let Some(pixel) = canvas.get_mut(whole(*y) * width + whole(*x).min(width - 1)) {
            *pixel = 0x40_ff_40;
        }
    }
    for (rows, value) in canvas.chunks_mut(BAR_PX * width).zip(face.coefficients) {
        for row in rows.chunks_mut(width).skip(1) {
            row.iter_mut().take(whole(value * 150.0)).for_each(|pixel| *pixel = 0xff_a0_20);
        }
    }
}
