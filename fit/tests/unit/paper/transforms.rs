use facewire_face::Landmarks;
use facewire_fit::paper::transforms::*;
use nalgebra::{Rotation3, Vector3};

/// Turns, scales and moves the points of the built-in clip's face.
fn turned(face: &Landmarks, angles_deg: [f64; 3], scale: f64) -> Landmarks {
    let [roll, pitch, yaw] = angles_deg.map(f64::to_radians);
    let rotation = Rotation3::from_euler_angles(pitch, yaw, roll);
    let mut seen = face.clone();
    for point in &mut seen.0 {
        let moved = scale * (rotation * Vector3::from(*point).cast::<f64>()) + Vector3::new(40.0, -20.0, 5.0);
        *point = moved.cast::<f32>().into();
    }
    seen
}

#[test]
fn r1_r2_and_r3_bring_any_face_into_the_same_place() {
    let face = crate::dataset::test_faces().remove(0).landmarks;
    let [_, first, second, third, _] = steps(&turned(&face, [10.0, -15.0, 20.0], 1.3)).expect("a face");
    let eye = |points: &Points, side: usize| EYES[side].iter().map(|at| points[*at]).sum::<Vector3<f64>>() / 2.0;
    for points in [&first, &second, &third] {
        assert!((eye(points, 0) + eye(points, 1)).norm() < 1e-5, "the origin lies between the eyes");
        assert!(((eye(points, 1) - eye(points, 0)).norm() - 1.0).abs() < 1e-5, "their distance is 1");
    }
    assert!(eye(&first, 1).yz().norm() > 0.05, "R1 turns nothing");
    assert!(eye(&second, 1).yz().norm() < 1e-5 && second[NOSE].z.abs() > 0.05, "R2 levels the eyes alone");
    assert!(eye(&third, 1).yz().norm() < 1e-5 && third[NOSE].z.abs() < 1e-5, "R3 removes the pitch");
    let straight = steps(&face).expect("a face");
    let apart = third.iter().zip(&straight[3]).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(apart < 1e-3, "{apart}");
}
