use facewire_fit::synth::rig::*;
use glam::Vec3;

#[test]
fn normals_point_to_the_side_from_which_corners_run_counter_clockwise() {
    let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE];
    assert_eq!(normals(&points, &[[0, 1, 2]]), [Vec3::Z, Vec3::Z, Vec3::Z, Vec3::ZERO]);
}
