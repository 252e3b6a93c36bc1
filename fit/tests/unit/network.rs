use facewire_fit::network::*;
use nalgebra::DMatrix;

fn training(hidden: usize, epochs: usize, seed: u64) -> Training {
    Training { hidden, units: Units::Rectified, start: 1.0, rate: 2e-3, epochs, seed }
}

/// Returns faces of two inputs whose output is their product, which no affine map can represent.
fn products() -> TrainingData {
    let at = |index: usize| [(index % 16) as f32 / 8.0 - 1.0, (index / 16) as f32 / 8.0 - 1.0];
    let inputs = DMatrix::from_fn(2, 256, |row, column| at(column)[row]);
    let truth = DMatrix::from_fn(1, 256, |_, column| 0.5 + 0.4 * at(column)[0] * at(column)[1]);
    TrainingData { inputs, truth, noise: vec![0.0; 2], importance: vec![1.0] }
}

fn error(network: &Network, data: &TrainingData) -> f32 {
    (network.outputs(&data.inputs).1 - &data.truth).norm_squared() / data.truth.len() as f32
}

#[test]
fn gradient_is_the_slope_of_the_error() {
    let data = products();
    let mut network = Network::new(2, 1, &training(5, 0, 3), &mut fastrand::Rng::with_seed(3));
    let faces: Vec<usize> = (0..256).collect();
    let gradient = network.gradient_of(&data, &faces, &mut fastrand::Rng::with_seed(1));
    for (group, expected) in gradient.iter().enumerate() {
        let step = 1e-2;
        let mut errors = [step, -step].map(|step| {
            network.parameters()[group][0] += step;
            let error = f64::from(error(&network, &data));
            network.parameters()[group][0] -= step;
            error
        });
        errors[0] = (errors[0] - errors[1]) / (2.0 * f64::from(step));
        assert!((errors[0] - f64::from(expected[0])).abs() < 2e-3, "{group}: {} for {}", expected[0], errors[0]);
    }
}

#[test]
fn a_function_that_no_affine_map_can_represent_is_learned_and_the_same_seed_gives_the_same_weights() {
    let data = products();
    let train = |seed| Network::train(&data, &training(12, 2000, seed), |_| ());
    let [network, same, other] = [1, 1, 2].map(train);
    let (error, variance) = (error(&network, &data), data.truth.variance());
    assert!(error < 0.2 * variance, "{error} of {variance}");
    assert!(network.w == same.w && network.w != other.w);
}
