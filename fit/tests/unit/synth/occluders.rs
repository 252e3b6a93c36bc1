use facewire_fit::synth::occluders::*;
use facewire_fit::synth::rig::Rig;
use glam::{Vec2, Vec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// Both eyes and the mouth of the rig.
const PLACES: [Vec2; 3] = [Vec2::new(-3.15, 3.3), Vec2::new(3.15, 3.3), Vec2::new(0.0, -3.4)];

#[test]
fn an_occluder_lies_before_the_face_and_nearly_always_leaves_an_eye_or_the_mouth_free() {
    let rig = Rig::load(std::path::Path::new(crate::reference::RIG)).expect("a rig");
    let behind = Behind { rig: &rig, base: &rig.neutral, skin: Vec3::splat(0.4), hair: Vec3::splat(0.1) };
    let mut hidden = 0;
    for seed in 0..300 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let occluder = Occluder::random(&mut rng, if seed % 2 == 0 { &USUAL } else { &STRANGE });
        let prop = occluder.build(&mut rng, &behind);
        let skin = |at: Vec2| 11.5 - 0.09 * at.x * at.x - 0.03 * (at.y + 1.0).powi(2);
        let before = |point: &Vec3| point.x.abs() < 7.0 && point.y > -11.0 && point.z > skin(point.truncate());
        assert!(prop.points.iter().any(before), "{seed}: {occluder:?}");
        let near = |place: &Vec2| prop.points.iter().any(|point| point.truncate().distance(*place) < 1.0);
        hidden += u32::from(PLACES.iter().all(near));
    }
    assert!(hidden <= 9, "{hidden} of 300");
}
