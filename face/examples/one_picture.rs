//! From a picture to blendshape coefficients and the pose of the head:
//! `cargo run -p facewire-face --example one_picture --features testing`
//!
//! The networks here are scripted, so that the example runs without any. With those that `scripts/setup` installs, the
//! engine is `engine(EngineChoice::Auto, "", 1)?`.

use facewire_face::stages::normalise;
use facewire_face::testing::{Scripted, face, show};
use facewire_face::{
    BLENDSHAPES, Camera, FilterKind, Filters, Model, Neutral, Picture, Pixels, Profile, Shaping, Solver, Tracker,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let engine = Scripted::new(|mut run| {
        // A head that is turned by 20 degrees to its left, in the middle of the picture.
        show(&mut run, &face([20.0, 0.0, 0.0], 48.0, [96.0, 80.0]));
        Ok(())
    });
    let mut tracker = Tracker::load(&engine)?;
    // What is known of the wearer: the face at rest, which looks into the camera.
    let at_rest = normalise(&face([0.0; 3], 80.0, [320.0, 240.0]))?;
    let profile = Profile { neutral: Some(Neutral::from_points(&at_rest.points)?), ..Profile::default() };
    let shaping = Shaping::only(Filters::uniform(FilterKind::GatedAverage, 0.18));
    let mut solver = Solver::new(Model::embedded(), profile, shaping);

    let [width, height] = [640, 480];
    let samples = vec![128; width * height];
    let pixels = Pixels::Grey { data: &samples, stride: width };
    let picture = Picture::new(width, height, pixels, true).ok_or("not a whole picture")?;
    let region = tracker.detect(&picture)?.ok_or("no face in the picture")?;
    tracker.landmarks(&picture, &region)?;
    let found = tracker.face().ok_or("no face in the region")?;
    let captured_us = 0;
    let camera = Camera::new([640.0, 480.0], 60.0);
    let solution = solver.solve(found, &camera, captured_us)?;
    let [yaw, pitch, roll] = solution.head.yaw_pitch_roll_deg();
    println!("yaw {yaw:.1}, pitch {pitch:.1}, roll {roll:.1} degrees, at {:.0?} mm", solution.head.position_mm);
    for (name, value) in BLENDSHAPES.iter().zip(solution.smoothed.0).filter(|(_, value)| *value > 0.005) {
        println!("{name} {value:.2}");
    }
    Ok(())
}
