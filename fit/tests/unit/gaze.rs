use facewire_face::Gaze;
use facewire_face::model::{FeatureId, InputTable};
use facewire_fit::design::{Design, Scale};
use facewire_fit::gaze::*;
use facewire_fit::statistics::pearson;

use crate::dataset::test_faces;

#[test]
fn map_follows_the_turn_of_the_eyes_in_faces_of_many_people() {
    let faces = test_faces();
    let design = Design::new(&faces).expect("faces");
    let table = fit(&design, &Scale::of(&design, 0.005)).expect("eyes that move");
    let turn = |face: usize| {
        let input = |(name, input): (&String, &InputTable)| {
            input.weights[0] * f64::from(design.value(face, FeatureId::from_name(name).expect("known").index()))
        };
        table.offsets.neutral_known[0] + table.inputs.iter().map(input).sum::<f64>()
    };
    let truth = |face| f64::from(Gaze::of(&design.coefficients(face)).yaw_pitch_deg[0]);
    let (turns, truths): (Vec<f64>, Vec<f64>) = (0..faces.len()).map(|face| (turn(face), truth(face))).unzip();
    let r = pearson(&turns, &truths);
    assert!(r > 0.4, "{r}");
}
