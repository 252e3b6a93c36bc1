use facewire_fit::synth::scene::*;
use glam::Vec3;

#[test]
fn a_head_away_from_the_middle_faces_the_camera_and_what_is_behind_the_camera_is_not_seen() {
    let placement = Placement { angles_deg: [0.0; 3], position: Vec3::new(20.0, -5.0, -60.0) };
    let mut points = [PIVOT, PIVOT + 9.0 * Vec3::Z];
    placement.place(&mut points, [0.0; 2]);
    let lens = Lens { size: [640, 480], focal_px: 500.0 };
    let screen = points.map(|point| lens.project(point).map(|(pixel, _)| pixel).unwrap_or_default());
    assert!((screen[0] - screen[1]).length() < 1e-2, "the nose attributes the middle of the head");
    assert_eq!(lens.project(5.0 * Vec3::Z), None);
}

#[test]
fn shoulders_follow_a_quarter_of_the_heads_rotation() {
    let placement = Placement { angles_deg: [40.0, 0.0, 0.0], position: Vec3::new(0.0, 0.0, -60.0) };
    let mut points = [PIVOT + Vec3::Z, PIVOT + Vec3::Z];
    placement.place(&mut points, [0.0, 1.0]);
    let [head, shoulder] = points.map(|point| (point - placement.position).x.asin().to_degrees());
    assert!((head - 40.0).abs() < 1e-3 && (shoulder - 10.0).abs() < 1e-3);
}
