use facewire_face::Landmarks;
use facewire_fit::synth::worker::*;
use glam::Vec2;

#[test]
fn landmarks_of_another_object_are_refused() {
    let mut landmarks = Landmarks::zero();
    landmarks.0[33] = [100.0, 50.0, 0.0];
    landmarks.0[263] = [160.0, 50.0, 0.0];
    let eyes = [Vec2::new(102.0, 52.0), Vec2::new(158.0, 49.0)];
    assert!(agrees(&landmarks, eyes));
    assert!(!agrees(&landmarks, eyes.map(|eye| eye + 30.0)));
    assert!(!agrees(&landmarks, [eyes[1], eyes[0]]));
}
