//! The hidden layer and how it is trained: `AdamW` (Loshchilov and Hutter, 2019) on the squared error, with noise on the
//! inputs and a learning rate that falls to 0 along a cosine. The same data and seed give the same weights.

use nalgebra::{DMatrix, DVector, DVectorView};

/// Faces that a step looks at.
const BATCH: usize = 256;
/// Learning rate at first.
const RATE: f32 = 2e-3;
/// Weight decay, a step's part of the learning rate.
const DECAY: f32 = 0.1;
/// Decays of the moments, and what keeps their quotient finite.
const MOMENTS: [f32; 2] = [0.9, 0.999];
const TINY: f32 = 1e-8;
/// How much an estimate below 0 of a coefficient that is 0 counts, and one above 1 of one that is 1: both are clamped.
const HARMLESS: f32 = 0.09;
/// How much a face at rest counts: that a turned head says nothing is worth more than its share of the pictures.
const REST: f32 = 3.0;

/// `o = V max(0, W x + a) + b`.
pub struct Network {
    /// Hidden units x inputs.
    pub w: DMatrix<f32>,
    pub a: DVector<f32>,
    /// Outputs x hidden units.
    pub v: DMatrix<f32>,
    pub b: DVector<f32>,
}

/// Inputs and what the outputs should be, a column for each face.
pub struct Lesson {
    pub inputs: DMatrix<f32>,
    pub truth: DMatrix<f32>,
    /// How loud the noise on each input is.
    pub noise: Vec<f32>,
    /// How much an error of each output counts.
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

    /// Trains a network by so many looks at every face; `tell` hears after each.
    pub fn train(lesson: &Lesson, hidden: usize, epochs: usize, seed: u64, tell: impl Fn(usize)) -> Self {
        let mut random = fastrand::Rng::with_seed(seed);
        let mut network = Self::new(lesson.inputs.nrows(), hidden, lesson.truth.nrows(), &mut random);
        let mut adam = Adam::new(&network);
        let mut order: Vec<usize> = (0..lesson.inputs.ncols()).collect();
        let steps = (epochs * (order.len() / BATCH).max(1)) as f32;
        for epoch in 0..epochs {
            random.shuffle(&mut order);
            for faces in order.chunks(BATCH).filter(|faces| faces.len() == BATCH.min(order.len())) {
                let gradient = network.gradient(&lesson.batch(faces, &mut random));
                let rate = RATE * 0.5 * (1.0 + (std::f32::consts::PI * adam.steps as f32 / steps).cos());
                adam.step(&mut network, gradient, rate);
            }
            tell(epoch + 1);
        }
        network
    }

    /// Gradient of the squared error, in the order of [`Network::parameters`].
    fn gradient(&self, lesson: &Lesson) -> [DMatrix<f32>; 4] {
        let mut hidden = &self.w * &lesson.inputs;
        hidden.column_iter_mut().for_each(|mut column| column += &self.a);
        hidden.apply(|value| *value = value.max(0.0));
        let mut error = &self.v * &hidden;
        error.column_iter_mut().for_each(|mut column| column += &self.b);
        error.zip_apply(&lesson.truth, |output, truth| *output = weighed_error(*output, truth));
        let at_rest = |truth: &DVectorView<'_, f32>| truth.iter().all(|value| *value == 0.0);
        let faces = error.column_iter_mut().zip(lesson.truth.column_iter());
        faces.filter(|(_, truth)| at_rest(truth)).for_each(|(mut error, _)| error *= REST);
        let importance = lesson.importance.iter().map(|importance| 2.0 * importance / lesson.truth.len() as f32);
        error.row_iter_mut().zip(importance).for_each(|(mut row, importance)| row *= importance);
        let mut back = self.v.tr_mul(&error);
        back.zip_apply(&hidden, |slope, value| *slope = if value > 0.0 { *slope } else { 0.0 });
        let sum = |matrix: &DMatrix<f32>| DMatrix::from_column_slice(matrix.nrows(), 1, matrix.column_sum().as_slice());
        [&back * lesson.inputs.transpose(), sum(&back), &error * hidden.transpose(), sum(&error)]
    }

    fn parameters(&mut self) -> [&mut [f32]; 4] {
        [self.w.as_mut_slice(), self.a.as_mut_slice(), self.v.as_mut_slice(), self.b.as_mut_slice()]
    }
}

fn weighed_error(output: f32, truth: f32) -> f32 {
    let is_clamped = truth <= 0.0 && output < 0.0 || truth >= 1.0 && output > 1.0;
    (output - truth) * if is_clamped { HARMLESS } else { 1.0 }
}

/// Of mean 0 and deviation 1.
fn noise(random: &mut fastrand::Rng) -> f32 {
    (random.f32() - 0.5) * 12.0_f32.sqrt()
}

impl Lesson {
    /// Some of the faces, with noise.
    fn batch(&self, faces: &[usize], random: &mut fastrand::Rng) -> Self {
        let mut inputs = self.inputs.select_columns(faces);
        for mut column in inputs.column_iter_mut() {
            column.iter_mut().zip(&self.noise).for_each(|(value, loudness)| *value += loudness * noise(random));
        }
        let truth = self.truth.select_columns(faces);
        Self { inputs, truth, noise: self.noise.clone(), importance: self.importance.clone() }
    }
}

/// Moments of the gradient.
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

    /// Faces of two inputs whose output is their product, which no affine map gives.
    fn products() -> Lesson {
        let at = |index: usize| [(index % 16) as f32 / 8.0 - 1.0, (index / 16) as f32 / 8.0 - 1.0];
        let inputs = DMatrix::from_fn(2, 256, |row, column| at(column)[row]);
        let truth = DMatrix::from_fn(1, 256, |_, column| 0.5 + 0.4 * at(column)[0] * at(column)[1]);
        Lesson { inputs, truth, noise: vec![0.0; 2], importance: vec![1.0] }
    }

    fn error(network: &Network, lesson: &Lesson) -> f32 {
        let mut hidden = &network.w * &lesson.inputs;
        hidden.column_iter_mut().for_each(|mut column| column += &network.a);
        hidden.apply(|value| *value = value.max(0.0));
        let mut output = &network.v * hidden;
        output.column_iter_mut().for_each(|mut column| column += &network.b);
        (output - &lesson.truth).norm_squared() / lesson.truth.len() as f32
    }

    #[test]
    fn what_no_affine_map_gives_is_learned() {
        let lesson = products();
        let network = Network::train(&lesson, 12, 2000, 1, |_| ());
        let variance = lesson.truth.variance();
        assert!(error(&network, &lesson) < 0.2 * variance, "{} of {variance}", error(&network, &lesson));
    }

    #[test]
    fn gradient_is_the_slope_of_the_error() {
        let lesson = products();
        let mut network = Network::new(2, 5, 1, &mut fastrand::Rng::with_seed(3));
        let gradient = network.gradient(&lesson);
        for (group, expected) in gradient.iter().enumerate() {
            let step = 1e-2;
            let mut errors = [step, -step].map(|step| {
                network.parameters()[group][0] += step;
                let error = f64::from(error(&network, &lesson));
                network.parameters()[group][0] -= step;
                error
            });
            errors[0] = (errors[0] - errors[1]) / (2.0 * f64::from(step));
            assert!((errors[0] - f64::from(expected[0])).abs() < 2e-3, "{group}: {} for {}", expected[0], errors[0]);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_weights() {
        let lesson = products();
        let train = |seed| Network::train(&lesson, 4, 2, seed, |_| ()).w;
        assert_eq!(train(1), train(1));
        assert_ne!(train(1), train(2));
    }
}
