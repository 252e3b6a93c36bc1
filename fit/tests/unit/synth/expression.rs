use facewire_fit::synth::expression::*;
use facewire_fit::synth::rig::Rig;
use glam::Vec3;

use crate::reference;
use crate::synth::anatomy::face;

#[test]
fn eyes_rotate_34_7_degrees_sideways_and_31_9_up_and_down() {
    let angle = |look, out: f32| {
        let seen = gaze(look, out) * Vec3::Z;
        [seen.x.atan2(seen.z).to_degrees(), seen.y.asin().to_degrees()]
    };
    let near = |[a, b]: [f32; 2], [c, d]: [f32; 2]| (a - c).abs() < 1e-3 && (b - d).abs() < 1e-3;
    assert!(near(angle([0.0, 1.0, 0.0, 0.0], 1.0), [34.7, 0.0]), "left eye out is to the left");
    assert!(near(angle([1.0, 0.0, 0.0, 0.0], -1.0), [34.7, 0.0]), "right eye in is to the left");
    assert!(near(angle([0.0, 0.0, 1.0, 0.0], 1.0), [0.0, 31.9]));
    assert!(near(angle([0.0, 0.0, 0.0, 0.5], -1.0), [0.0, -15.95]));
}

fn rig() -> Rig {
    Rig::load(std::path::Path::new(reference::RIG)).expect("a rig")
}

fn deformed(rig: &Rig, moved: &[(&str, f32)]) -> Vec<Vec3> {
    let mut points = Vec::new();
    Deformer::new(rig).expect("shapes").deform(rig, &rig.neutral, &face(moved), &mut points);
    points
}

#[test]
fn eye_blink_left_shuts_only_the_persons_left_lid_and_the_iris_rotates_with_the_gaze() {
    let rig = rig();
    let points = deformed(&rig, &[("eyeBlinkLeft", 1.0)]);
    let gap = |points: &[Vec3], [upper, lower]: [usize; 2]| {
        (points[rig.landmarks[upper]] - points[rig.landmarks[lower]]).length()
    };
    let [left, right] = [[43, 47], [38, 40]];
    assert!(rig.landmark(43).x > 0.0, "the person's left is at positive x, right in the picture");
    assert!(gap(&points, left) < 0.2 * gap(&rig.neutral, left));
    assert!(gap(&points, right) > 0.98 * gap(&rig.neutral, right));
    let eye = rig.parts.eyes[0].concat();
    let depth = |vertex: &u32| rig.neutral[*vertex as usize].z;
    let iris = *eye.iter().max_by(|a, b| depth(a).total_cmp(&depth(b))).expect("a vertex") as usize;
    let moved = |look| deformed(&rig, &[(look, 1.0)])[iris] - rig.neutral[iris];
    assert!(moved("eyeLookOutLeft").x > 0.7 && moved("eyeLookDownLeft").y < -0.7, "the iris turns");
}

#[test]
fn weight_1_moves_vertices_by_arkits_amplitude() {
    let rig = rig();
    for (name, shape, ratio) in [
        ("browDownLeft", "browDown_L", 0.74),
        ("mouthPressRight", "mouthPress_R", 0.42),
        ("noseSneerLeft", "noseSneer_L", 2.14),
        ("mouthLeft", "mouthLeft", 1.57),
        ("jawOpen", "jawOpen", 1.05),
    ] {
        let points = deformed(&rig, &[(name, 1.0)]);
        let moved = points.iter().zip(&rig.neutral).map(|(point, rest)| (*point - *rest).length());
        let shape = &rig.shapes[rig.shape(shape).expect("a shape")];
        let rig_moves = shape.moves.iter().map(|(_, offset)| offset.length());
        let [moved, rig_moves] = [moved.fold(0.0, f32::max), rig_moves.fold(0.0, f32::max)];
        assert!((moved * ratio / rig_moves - 1.0).abs() < 1e-3, "{name}");
    }
}

#[test]
fn both_halves_of_a_shape_move_and_closed_lips_meet_over_an_open_jaw() {
    let rig = rig();
    let brows = deformed(&rig, &[("browInnerUp", 1.0)]);
    let lifts = [21, 22].map(|index| brows[rig.landmarks[index]].y - rig.landmark(index).y);
    assert!(lifts.iter().all(|lift| *lift > 0.3) && (lifts[0] - lifts[1]).abs() < 0.05);
    let lips = |points: &[Vec3]| points[rig.landmarks[62]].y - points[rig.landmarks[66]].y;
    let open = deformed(&rig, &[("jawOpen", 1.0)]);
    let closed = deformed(&rig, &[("jawOpen", 1.0), ("mouthClose", 1.0)]);
    assert!(lips(&open) > 2.0 && (lips(&closed) - lips(&rig.neutral)).abs() < 0.1);
}

#[test]
fn a_lip_that_is_rolled_in_meets_the_other_and_bares_no_teeth() {
    let rig = rig();
    let lips = [62, 66].map(|index| rig.landmarks[index]);
    let jaw = deformed(&rig, &[("jawOpen", 1.0)]);
    let teeth: Vec<usize> = rig.parts.teeth.iter().flatten().map(|vertex| *vertex as usize).collect();
    let is_lower = |vertex: &usize| jaw[*vertex] != rig.neutral[*vertex];
    // The depth of the foremost tooth of the row behind the upper or the lower lip.
    let front = |points: &[Vec3], lip: usize| {
        let row = teeth.iter().filter(|vertex| is_lower(vertex) == (lip == 1)).map(|vertex| points[*vertex].z);
        row.fold(f32::NEG_INFINITY, f32::max)
    };
    for (rolled, row) in ROLLS.iter().zip([0, 1]) {
        for weight in [0.3, 0.6, 1.0] {
            let points = deformed(&rig, &[(rolled, weight)]);
            let gap_cm = points[lips[0]].y - points[lips[1]].y;
            assert!((-0.5..0.1).contains(&gap_cm), "{rolled} {weight}: {gap_cm}");
            assert!(front(&points, row) < points[lips[row]].z, "{rolled} {weight}");
            assert!((front(&points, 1 - row) - front(&rig.neutral, 1 - row)).abs() < 1e-4, "the other row stays");
        }
    }
}
