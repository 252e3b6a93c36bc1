//! The hidden layer and its training: `AdamW` (Loshchilov and Hutter, 2019) on the squared error, with noise on the
//! inputs and cosine decay of the learning rate. The same data and seed give the same weights.

use nalgebra::{DMatrix, DVector, DVectorView};

/// Faces per step.
const BATCH: usize = 256;
/// Initial learning rate.
const RATE: f32 = 2e-3;
/// Weight decay, multiplied by the learning rate in each step.
const DECAY: f32 = 0.1;
/// Decay rates of the moments, and the term that keeps their quotient finite.
const MOMENTS: [f32; 2] = [0.9, 0.999];
const TINY: f32 = 1e-8;
/// Weight of an error that clamping removes: an output below 0 for a truth of 0, or above 1 for a truth of 1.
const CLAMPED: f32 = 0.09;
/// Weight of a face at rest. It exceeds 1 because turning the head must not move coefficients, and few of the pictures
/// show it.
const REST: f32 = 3.0;

/// A network with one hidden layer, `o = V max(0, W x + a) + b`.
pub struct Network {
    /// Hidden units x inputs.
    pub w: DMatrix<f32>,
    pub a: DVector<f32>,
    /// Outputs x hidden units.
    pub v: DMatrix<f32>,
    pub b: DVector<f32>,
}

/// Inputs and expected outputs, one column per face.
pub struct TrainingData {
    pub inputs: DMatrix<f32>,
    pub truth: DMatrix<f32>,
    /// Standard deviation of the noise on each input.
    pub noise: Vec<f32>,
    /// Weight of the error of each output.
    pub importance: Vec<f32>,
}

impl Network {
    fn new(inputs: usize, hidden: usize, outputs: usize, random: &mut fastrand::Rng) -> Self {
        let mut matrix = |rows: usize, columns: usize| {
            let size = (1.5 / columns as f32).sqrt();
            DMatrix::from_fn(rows, columns, |_, _| size * noise(random))
        };
        let (w, v) = (matrix(hidden, inputs), matrix(outputs, hidden));
        Self { w, a: DVector::zeros(hidden), v, b: DVector::zeros(outputs) }
    }

    /// Trains a network for a number of epochs and calls `on_epoch` after each of them.
    pub fn train(data: &TrainingData, hidden: usize, epochs: usize, seed: u64, on_epoch: impl Fn(usize)) -> Self {
        let mut random = fastrand::Rng::with_seed(seed);
        let mut network = Self::new(data.inputs.nrows(), hidden, data.truth.nrows(), &mut random);
        let mut adam = Adam::new(&network);
        let mut order: Vec<usize> = (0..data.inputs.ncols()).collect();
        let steps = (epochs * (order.len() / BATCH).max(1)) as f32;
        for epoch in 0..epochs {
            random.shuffle(&mut order);
            for faces in order.chunks(BATCH).filter(|faces| faces.len() == BATCH.min(order.len())) {
                let gradient = network.gradient(&data.batch(faces, &mut random));
                let rate = RATE * 0.5 * (1.0 + (std::f32::consts::PI * adam.steps as f32 / steps).cos());
                adam.step(&mut network, gradient, rate);
            }
            on_epoch(epoch + 1);
        }
        network
    }

    /// Returns the gradient of the squared error, in the order of [`Network::parameters`].
    fn gradient(&self, data: &TrainingData) -> [DMatrix<f32>; 4] {
        let mut hidden = &self.w * &data.inputs;
        hidden.column_iter_mut().for_each(|mut column| column += &self.a);
        hidden.apply(|value| *value = value.max(0.0));
        let mut error = &self.v * &hidden;
        error.column_iter_mut().for_each(|mut column| column += &self.b);
        error.zip_apply(&data.truth, |output, truth| *output = weighted_error(*output, truth));
        let at_rest = |truth: &DVectorView<'_, f32>| truth.iter().all(|value| *value == 0.0);
        let faces = error.column_iter_mut().zip(data.truth.column_iter());
        faces.filter(|(_, truth)| at_rest(truth)).for_each(|(mut error, _)| error *= REST);
        let importance = data.importance.iter().map(|importance| 2.0 * importance / data.truth.len() as f32);
        error.row_iter_mut().zip(importance).for_each(|(mut row, importance)| row *= importance);
        let mut back = self.v.tr_mul(&error);
        back.zip_apply(&hidden, |slope, value| *slope = if value > 0.0 { *slope } else { 0.0 });
        let sum = |matrix: &DMatrix<f32>| DMatrix::from_column_slice(matrix.nrows(), 1, matrix.column_sum().as_slice());
        [&back * data.inputs.transpose(), sum(&back), &error * hidden.transpose(), sum(&error)]
    }

    fn parameters(&mut self) -> [&mut [f32]; 4] {
        [self.w.as_mut_slice(), self.a.as_mut_slice(), self.v.as_mut_slice(), self.b.as_mut_slice()]
    }
}

fn weighted_error(output: f32, truth: f32) -> f32 {
    let is_clamped = truth <= 0.0 && output < 0.0 || truth >= 1.0 && output > 1.0;
    (output - truth) * if is_clamped { CLAMPED } else { 1.0 }
}

/// Returns uniform noise with mean 0 and standard deviation 1.
fn noise(random: &mut fastrand::Rng) -> f32 {
    (random.f32() - 0.5) * 12.0_f32.sqrt()
}

impl TrainingData {
    /// Returns some of the faces, with noise added to their inputs.
    fn batch(&self, faces: &[usize], random: &mut fastrand::Rng) -> Self {
        let mut inputs = self.inputs.select_columns(faces);
        for mut column in inputs.column_iter_mut() {
            column.iter_mut().zip(&self.noise).for_each(|(value, deviation)| *value += deviation * noise(random));
        }
        let truth = self.truth.select_columns(faces);
        Self { inputs, truth, noise: self.noise.clone(), importance: self.importance.clone() }
    }
}

/// The state of `AdamW`: first and second moments of the gradient.
struct Adam {
    moments: [[Vec<f32>; 2]; 4],
    steps: u32,
}

impl Adam {
    fn new(network: &Network) -> Self {
        let lengths = [network.w.len(), network.a.len(), network.v.len(), network.b.len()];
        Self { moments: lengths.map(|length| [vec![0.0; length], vec![0.0; length]]), steps: 0 }
    }

    fn step(&mut self, network: &mut Network, gradient: [DMatrix<f32>; 4], rate: f32) {
        self.steps += 1;
        let exponent = f32::from(u16::try_from(self.steps).unwrap_or(u16::MAX));
        let [first, second] = MOMENTS.map(|decay| 1.0 - decay.powf(exponent));
        for ((values, gradient), [means, squares]) in
            network.parameters().into_iter().zip(gradient).zip(&mut self.moments)
        {
            let moments = means.iter_mut().zip(squares);
            for ((value, slope), (mean, square)) in values.iter_mut().zip(gradient.as_slice()).zip(moments) {
                *mean += (1.0 - MOMENTS[0]) * (slope - *mean);
                *square += (1.0 - MOMENTS[1]) * (slope * slope - *square);
                *value -= rate * (*mean / first / ((*square / second).sqrt() + TINY) + DECAY * *value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns faces of two inputs whose output is their product, which no affine map can represent.
    fn products() -> TrainingData {
        let at = |index: usize| [(index % 16) as f32 / 8.0 - 1.0, (index / 16) as f32 / 8.0 - 1.0];
        let inputs = DMatrix::from_fn(2, 256, |row, column| at(column)[row]);
        let truth = DMatrix::from_fn(1, 256, |_, column| 0.5 + 0.4 * at(column)[0] * at(column)[1]);
        TrainingData { inputs, truth, noise: vec![0.0; 2], importance: vec![1.0] }
    }

    fn error(network: &Network, data: &TrainingData) -> f32 {
        let mut hidden = &network.w * &data.inputs;
        hidden.column_iter_mut().for_each(|mut column| column += &network.a);
        hidden.apply(|value| *value = value.max(0.0));
        let mut output = &network.v * hidden;
        output.column_iter_mut().for_each(|mut column| column += &network.b);
        (output - &data.truth).norm_squared() / data.truth.len() as f32
    }

    #[test]
    fn a_function_that_no_affine_map_can_represent_is_learned() {
        let data = products();
        let network = Network::train(&data, 12, 2000, 1, |_| ());
        let variance = data.truth.variance();
        assert!(error(&network, &data) < 0.2 * variance, "{} of {variance}", error(&network, &data));
    }

    #[test]
    fn gradient_is_the_slope_of_the_error() {
        let data = products();
        let mut network = Network::new(2, 5, 1, &mut fastrand::Rng::with_seed(3));
        let gradient = network.gradient(&data);
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
    fn the_same_seed_gives_the_same_weights() {
        let data = products();
        let train = |seed| Network::train(&data, 4, 2, seed, |_| ()).w;
        assert_eq!(train(1), train(1));
        assert_ne!(train(1), train(2));
    }
}
