use facewire_face::COEFFS;
use facewire_fit::curves::LIDS;
use facewire_fit::judge::figures::SolvedFaces;
use facewire_fit::judge::gaze::*;
use facewire_fit::synth::anatomy::Gaze;

#[test]
fn gaze_is_judged_in_degrees_by_the_turn_of_the_head_and_not_behind_shut_lids() {
    let looking = |left: f32| {
        let mut face = [0.0_f32; COEFFS];
        Gaze { left, up: 0.0, convergence: 0.0 }.set(&mut face);
        face.map(f64::from)
    };
    let mut faces = SolvedFaces::default();
    for left in [-0.8_f32, -0.2, 0.4, 0.6] {
        faces.truths.push(looking(left));
        faces.estimates.push(looking(0.5 * left));
        faces.head_yaw_deg.push(-15.0);
    }
    let sums = GazeSums::new(&faces);
    let (moments, error_deg) = sums.axis(0, 1..2);
    assert!((moments.slope() - 0.5).abs() < 1e-3 && (moments.pearson() - 1.0).abs() < 1e-6);
    assert!((error_deg / 4.0 - 0.5 * 0.5 * 34.7).abs() < 1e-3, "{error_deg}");
    assert!(sums.axis(0, 0..1).0.count < 1.0);
    faces.truths.iter_mut().for_each(|truth| truth[LIDS[1]] = 0.9);
    assert!(GazeSums::new(&faces).axis(0, 0..3).0.count < 1.0);
}
