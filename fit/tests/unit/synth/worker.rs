use facewire_face::Landmarks;
use facewire_fit::synth::worker::*;
use glam::Vec2;

#[test]
fn landmarks_of_another_object_are_refused() {
    let mut landmarks = Landmarks::zero();
    landmarks.0[33] = [100.0, 50.0, 0.0];
    landmarks.0[263] = [160.0, 50.0, 0.0];
    landmarks.0[61] = [115.0, 110.0, 0.0];
    landmarks.0[291] = [145.0, 110.0, 0.0];
    let eyes = [Vec2::new(102.0, 52.0), Vec2::new(158.0, 49.0)];
    let mouth = [Vec2::new(114.0, 112.0), Vec2::new(146.0, 108.0)];
    let whole = [1.0; 5];
    let headset = [0.0, 0.0, 0.0, 1.0, 1.0];
    let mask = [1.0, 1.0, 1.0, 0.0, 0.2];
    let agrees = |eyes, mouth, visible| Seen { eyes, mouth, visible }.agrees(&landmarks);
    assert!(agrees(eyes, mouth, whole));
    let elsewhere = |points: [Vec2; 2]| points.map(|point| point + 30.0);
    assert!(!agrees(elsewhere(eyes), mouth, whole) && !agrees(eyes, elsewhere(mouth), whole));
    assert!(!agrees([eyes[1], eyes[0]], mouth, whole));
    // What is covered is not compared, because its landmarks are guessed.
    assert!(agrees(elsewhere(eyes), mouth, headset) && !agrees(eyes, elsewhere(mouth), headset));
    assert!(agrees(eyes, elsewhere(mouth), mask) && !agrees(elsewhere(eyes), mouth, mask));
}
