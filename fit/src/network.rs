//! Layers and their training: `AdamW` (Loshchilov and Hutter, 2019) on the squared error, with noise on the
//! inputs and cosine decay of the learning rate. The same data and seed give the same weights.

use nalgebra::{DMatrix, DVector, DVectorView};
use rayon::prelude::*;

/// Faces per step, and the number of parts of them that threads share. Another number of parts would give other weights.
const BATCH: usize = 256;
const PARTS: usize = 4;
const DECAY: f32 = 0.1;
/// Decay rates of the moments, and the term that keeps their quotient finite.
const MOMENTS: [f32; 2] = [0.9, 0.999];
const TINY: f32 = 1e-8;
/// Weight of an error that clamping removes: an output below 0 for a truth of 0, or above 1 for a truth of 1.
const CLAMPED: f32 = 0.09;
/// Weight of a face at rest: few pictures show that turning the head must not move coefficients.
const REST: f32 = 3.0;
/// Smallest deviation of a blendshape, by which its errors are divided.
const LEAST_TRUTH: f32 = 0.01;

/// What hidden units return for their weighted sum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Units {
    /// The sum, or 0 if it is negative.
    Rectified,
    Linear,
}

/// A network with one hidden layer, `o = V max(0, W x + a) + b`, or `o = V (W x + a) + b`.
pub struct Network {
    units: Units,
    pub w: DMatrix<f32>,
    pub a: DVector<f32>,
    pub v: DMatrix<f32>,
    pub b: DVector<f32>,
}

#[derive(Debug, Clone, Copy)]
pub struct Training {
    pub hidden: usize,
    pub units: Units,
    pub start: f32,
    pub rate: f32,
    pub epochs: usize,
    pub seed: u64,
}

pub trait Examples: Sync {
    /// Returns the number of faces, and that of their inputs.
    fn size(&self) -> [usize; 2];

    fn importance(&self) -> &[f32];

    fn batch(&self, faces: &[usize], random: &mut fastrand::Rng) -> Batch;
}

pub struct Batch {
    pub inputs: DMatrix<f32>,
    /// What the network's outputs are added to, if it learns what another model leaves unexplained.
    pub start: Option<DMatrix<f32>>,
    pub truth: DMatrix<f32>,
}

pub struct TrainingData {
    pub inputs: DMatrix<f32>,
    pub truth: DMatrix<f32>,
    pub noise: Vec<f32>,
    pub importance: Vec<f32>,
}

impl Network {
    pub fn new(inputs: usize, outputs: usize, training: &Training, random: &mut fastrand::Rng) -> Self {
        let Training { hidden, units, start, .. } = *training;
        let mut matrix = |rows: usize, columns: usize| {
            let size = (1.5 / columns as f32).sqrt();
            DMatrix::from_fn(rows, columns, |_, _| size * noise(random))
        };
        let (w, v) = (matrix(hidden, inputs), start * matrix(outputs, hidden));
        Self { units, w, a: DVector::zeros(hidden), v, b: DVector::zeros(outputs) }
    }

    pub fn train(data: &impl Examples, training: &Training, on_epoch: impl Fn(usize)) -> Self {
        let (Training { rate, epochs, seed, .. }, [faces, inputs]) = (*training, data.size());
        let mut random = fastrand::Rng::with_seed(seed);
        let mut network = Self::new(inputs, data.importance().len(), training, &mut random);
        let mut adam = Adam::new(&network);
        let mut order: Vec<usize> = (0..faces).collect();
        let steps = (epochs * (order.len() / BATCH).max(1)) as f32;
        for epoch in 0..epochs {
            random.shuffle(&mut order);
            for faces in order.chunks(BATCH).filter(|faces| faces.len() == BATCH.min(order.len())) {
                let gradient = network.gradient_of(data, faces, &mut random);
                let rate = rate * 0.5 * (1.0 + (std::f32::consts::PI * adam.steps as f32 / steps).cos());
                adam.step(&mut network, gradient, rate);
            }
            on_epoch(epoch + 1);
        }
        network
    }

    /// Returns the gradient of the mean squared error of some faces, in the order of [`Network::parameters`].
    pub fn gradient_of(&self, data: &impl Examples, faces: &[usize], random: &mut fastrand::Rng) -> [DMatrix<f32>; 4] {
        let values = faces.len() * data.importance().len();
        let importance: Vec<f32> = data.importance().iter().map(|weight| 2.0 * weight / values as f32).collect();
        let parts: Vec<_> = faces.chunks(faces.len().div_ceil(PARTS)).map(|part| (part, random.fork())).collect();
        let gradient =
            |(part, mut random): (&[usize], fastrand::Rng)| self.gradient(data.batch(part, &mut random), &importance);
        // The sum is taken in the order of the parts, whichever thread is first.
        let gradients: Vec<_> = parts.into_par_iter().map(gradient).collect();
        let sum = |mut sum: [DMatrix<f32>; 4], other: [DMatrix<f32>; 4]| {
            sum.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
            sum
        };
        gradients.into_iter().reduce(sum).unwrap_or_else(|| [(); 4].map(|()| DMatrix::zeros(0, 0)))
    }

    pub fn outputs(&self, inputs: &DMatrix<f32>) -> (DMatrix<f32>, DMatrix<f32>) {
        let mut hidden = &self.w * inputs;
        hidden.column_iter_mut().for_each(|mut column| column += &self.a);
        if self.units == Units::Rectified {
            hidden.apply(|value| *value = value.max(0.0));
        }
        let mut output = &self.v * &hidden;
        output.column_iter_mut().for_each(|mut column| column += &self.b);
        (hidden, output)
    }

    /// Returns the gradient of the squared error, in which each output has a weight (`importance`).
    pub fn gradient(&self, batch: Batch, importance: &[f32]) -> [DMatrix<f32>; 4] {
        let Batch { inputs, start, truth } = batch;
        let (hidden, mut error) = self.outputs(&inputs);
        if let Some(start) = start {
            error += start;
        }
        error.zip_apply(&truth, |output, truth| {
            let is_clamped = truth <= 0.0 && *output < 0.0 || truth >= 1.0 && *output > 1.0;
            *output = (*output - truth) * if is_clamped { CLAMPED } else { 1.0 };
        });
        let at_rest = |truth: &DVectorView<'_, f32>| truth.iter().all(|value| *value == 0.0);
        let faces = error.column_iter_mut().zip(truth.column_iter());
        faces.filter(|(_, truth)| at_rest(truth)).for_each(|(mut error, _)| error *= REST);
        error.row_iter_mut().zip(importance).for_each(|(mut row, importance)| row *= *importance);
        let mut back = self.v.tr_mul(&error);
        if self.units == Units::Rectified {
            back.zip_apply(&hidden, |slope, value| *slope = if value > 0.0 { *slope } else { 0.0 });
        }
        let sum = |matrix: &DMatrix<f32>| DMatrix::from_column_slice(matrix.nrows(), 1, matrix.column_sum().as_slice());
        [&back * inputs.transpose(), sum(&back), &error * hidden.transpose(), sum(&error)]
    }

    pub fn parameters(&mut self) -> [&mut [f32]; 4] {
        [self.w.as_mut_slice(), self.a.as_mut_slice(), self.v.as_mut_slice(), self.b.as_mut_slice()]
    }
}

pub fn noise(random: &mut fastrand::Rng) -> f32 {
    (random.f32() - 0.5) * 12.0_f32.sqrt()
}

/// Returns the weight of each blendshape's error: the inverse of its standard deviation, scaled to a mean of 1. Without
/// weights, blendshapes that hardly move would not be learned. Dividing by the variance, as a correlation does, would
/// weigh them as much as all others.
pub fn importance(truth: &DMatrix<f32>) -> Vec<f32> {
    let inverse: Vec<f32> = truth.row_iter().map(|row| 1.0 / row.variance().sqrt().max(LEAST_TRUTH)).collect();
    let mean = inverse.iter().sum::<f32>() / inverse.len() as f32;
    inverse.iter().map(|inverse| inverse / mean).collect()
}

pub fn numbers<'a>(values: impl Iterator<Item = &'a f32>) -> Vec<f64> {
    values.map(|value| number(*value)).collect()
}

/// Rounds to four decimals, far below the accuracy of the weights, to keep the file short.
pub fn number(value: f32) -> f64 {
    rounded(f64::from(value), 4)
}

pub fn rounded(value: f64, decimals: i32) -> f64 {
    let unit = 10.0_f64.powi(decimals);
    (value * unit).round() / unit
}

impl Examples for TrainingData {
    fn size(&self) -> [usize; 2] {
        [self.inputs.ncols(), self.inputs.nrows()]
    }

    fn importance(&self) -> &[f32] {
        &self.importance
    }

    fn batch(&self, faces: &[usize], random: &mut fastrand::Rng) -> Batch {
        let mut inputs = self.inputs.select_columns(faces);
        for mut column in inputs.column_iter_mut() {
            column.iter_mut().zip(&self.noise).for_each(|(value, deviation)| *value += deviation * noise(random));
        }
        Batch { inputs, start: None, truth: self.truth.select_columns(faces) }
    }
}

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
