use facewire_face::Model;
use facewire_fit::dataset;
use facewire_fit::dataset::Sample;
use facewire_fit::faces::*;
use facewire_fit::statistics::mean;

use crate::dataset::test_faces;
use crate::reference;

fn assert_correlates(samples: &[Sample], bounds: [(bool, f64, f64); 2]) {
    let model = Model::embedded();
    for (neutral_known, least_r, most_mse) in bounds {
        let faces = Faces::new(samples, neutral_known).expect("faces");
        let scores = scores(&model, &faces, &faces.rows(true).expect("all")).expect("scores");
        let shown = || scores[..scores.len() - 1].iter();
        let [r, mse] = [0, 1].map(|figure: usize| mean(shown().map(|score| score[figure])));
        assert!(r >= least_r && mse <= most_mse, "neutral known: {neutral_known}, r {r}, MSE {mse}");
    }
}

#[test]
fn the_shipped_model_correlates_on_faces_that_the_fit_never_saw() {
    assert_correlates(&test_faces(), [(true, 0.72, 0.013), (false, 0.68, 0.015)]);
}

#[test]
fn the_shipped_model_correlates_on_held_out_people_of_another_renderer_and_tracker() {
    let Some(path) = reference::shared("dataset/train.npz") else { return };
    let mut samples = dataset::load(&path).expect("a dataset");
    samples.retain(Sample::held_out);
    assert_correlates(&samples, [(true, 0.68, 0.012), (false, 0.63, 0.0145)]);
}
