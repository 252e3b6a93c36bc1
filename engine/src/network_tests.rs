//! Whole networks of odd shapes against the plain operators, on all kernels of this machine.

use std::sync::Arc;

use crate::graph::{Graph, Kind, Operator, Port, Shape, Window};
use crate::testing::{Random, assert_within, tolerance};
use crate::{Error, Network, Team, kernels, reference};

/// Builds a network operator by operator.
struct Draft {
    random: Random,
    tensors: Vec<Shape>,
    operators: Vec<Operator<'static>>,
    outputs: Vec<usize>,
}

impl Draft {
    fn new(seed: u64, [rows, columns, channels]: [usize; 3]) -> Self {
        let tensors = vec![Shape { rows, columns, channels }];
        Self { random: Random::new(seed), tensors, operators: Vec::new(), outputs: Vec::new() }
    }

    fn add(&mut self, kind: Kind<'static>, inputs: Vec<usize>, output: Shape) -> usize {
        self.tensors.push(output);
        let output = self.tensors.len() - 1;
        self.operators.push(Operator { kind, inputs, output });
        output
    }

    fn convolution(&mut self, input: usize, window: Window, output: Shape) -> usize {
        let count = window.size * window.size * self.tensors[input].channels * output.channels;
        let weights = self.random.values(count).iter().map(|weight| weight / 4.0).collect::<Vec<_>>().into();
        let bias = self.random.values(output.channels).into();
        self.add(Kind::Convolution { window, weights, bias }, vec![input], output)
    }

    fn activation(&mut self, input: usize) -> usize {
        let shape = self.tensors[input];
        match self.random.below(3) {
            0 => self.add(Kind::Relu, vec![input], shape),
            1 => {
                let slopes =
                    self.random.values(shape.channels).iter().map(|slope| slope * 1.5).collect::<Vec<_>>().into();
                self.add(Kind::Prelu { slopes }, vec![input], shape)
            }
            _ => input,
        }
    }

    /// A depthwise and a pointwise convolution, mostly with a sum.
    fn block(&mut self, input: usize, stride: usize, added: usize) -> usize {
        let from = self.tensors[input];
        let middle = Shape { rows: from.rows / stride, columns: from.columns / stride, ..from };
        let to = Shape { channels: from.channels + added, ..middle };
        let window = Window { size: 3, stride, top: 2 - stride, left: 2 - stride };
        let [weights, bias] = [9, 1].map(|count| self.random.values(count * from.channels).into());
        let depthwise = self.add(Kind::Depthwise { window, weights, bias }, vec![input], middle);
        let pointwise = self.convolution(depthwise, POINT, to);
        if self.random.below(4) == 0 {
            return self.activation(pointwise);
        }
        let mut other = input;
        if stride == 2 {
            let window = Window { size: 2, stride: 2, top: 0, left: 0 };
            other = self.add(Kind::MaxPool { window }, vec![other], middle);
        }
        if added > 0 {
            other = self.add(Kind::PadChannels, vec![other], to);
        }
        let mut operands = vec![other, pointwise];
        if self.random.below(2) == 0 {
            operands.reverse();
        }
        let sum = self.add(Kind::Add, operands, to);
        self.activation(sum)
    }

    fn graph(self) -> Graph<'static> {
        let port = |(index, tensor)| Port { name: format!("output {index}"), tensor };
        let outputs = self.outputs.into_iter().enumerate().map(port).collect();
        let input = Port { name: "input".to_owned(), tensor: 0 };
        Graph::new(self.tensors, self.operators, input, outputs).expect("the draft is sound")
    }
}

const POINT: Window = Window { size: 1, stride: 1, top: 0, left: 0 };

/// A network of random blocks behind a first convolution.
pub(crate) fn random_network(seed: u64) -> Graph<'static> {
    let mut random = Random::new(seed);
    let mut pick = |from: &[usize]| from[random.below(from.len())];
    let (size, stride) = (pick(&[3, 5]), pick(&[1, 2]));
    let [rows, columns] = [pick(&[2, 6, 12, 20, 34, 50]), pick(&[2, 4, 10, 24, 26, 60])];
    let mut draft = Draft::new(seed + 1, [rows, columns, 3]);
    let to = Shape { rows: rows / stride, columns: columns / stride, channels: pick(&[3, 8, 17, 24, 33]) };
    let before = (size - stride) / 2;
    let first = draft.convolution(0, Window { size, stride, top: before, left: before }, to);
    let mut tensor = draft.activation(first);
    for _ in 0..pick(&[1, 2, 5, 8]) {
        let Shape { rows, columns, .. } = draft.tensors[tensor];
        let stride = if rows % 2 == 0 && columns % 2 == 0 { pick(&[1, 1, 2]) } else { 1 };
        tensor = draft.block(tensor, stride, pick(&[0, 0, 5, 8, 20]));
        if pick(&[0, 1, 2]) == 0 {
            draft.outputs.push(tensor);
        }
    }
    let Shape { rows, columns, .. } = draft.tensors[tensor];
    let pointwise = draft.convolution(tensor, POINT, Shape { rows, columns, channels: pick(&[1, 6, 32]) });
    draft.outputs.push(pointwise);
    if rows == columns && rows < 7 {
        let window = Window { size: rows, ..POINT };
        let dense = draft.convolution(tensor, window, Shape { rows: 1, columns: 1, channels: pick(&[1, 10, 142]) });
        draft.outputs.push(dense);
    }
    let both = [pointwise, tensor];
    let channels = both.map(|tensor| draft.tensors[tensor].channels).iter().sum();
    let joined = draft.add(Kind::Concatenation, both.to_vec(), Shape { rows: rows * columns, columns: 1, channels });
    draft.outputs.push(joined);
    draft.graph()
}

#[test]
pub(crate) fn random_networks_agree_with_the_plain_operators_and_repeat_their_outputs() {
    for seed in 0..60 {
        let graph = random_network(seed);
        let shape = graph.tensors()[0];
        for kernels in kernels::available() {
            let mut network = Network::new(&graph, kernels).expect("the network consists of layers");
            let mut random = Random::new(seed);
            for _ in 0..2 {
                let input = random.values(shape.elements());
                for (row, values) in input.chunks(shape.columns * 3).enumerate() {
                    network.input_row(row).copy_from_slice(values);
                }
                for _ in 0..2 {
                    network.run();
                    for (index, expected) in reference::run(&graph, &input).iter().enumerate() {
                        let scale = expected.iter().fold(1.0_f32, |scale, value| scale.max(value.abs()));
                        let scaled = |values: &[f32]| values.iter().map(|value| value / scale).collect::<Vec<_>>();
                        let what = format!("{}, seed {seed}, output {index}", kernels.name);
                        assert_within(tolerance(kernels), &scaled(network.output(index)), &scaled(expected), &what);
                    }
                }
            }
        }
    }
}

#[test]
fn several_threads_compute_the_same_bits_as_one() {
    let teams: Vec<_> = [2, 3, 5, 9].map(|size| Arc::new(Team::new(size).expect("threads"))).into();
    for seed in 0..40 {
        let graph = random_network(seed);
        let shape = graph.tensors()[0];
        let inputs = [1, 2].map(|round| Random::new(seed + round).values(shape.elements()));
        for kernels in kernels::available() {
            let mut alone = Network::new(&graph, kernels).expect("the network consists of layers");
            for team in &teams {
                // These numbers of multiply-adds are so small that small maps are divided too.
                let min_products = [1, 500, 5000][usize::try_from(seed).unwrap() % 3];
                let network = Network::divided(&graph, kernels, Arc::clone(team), min_products);
                let mut network = network.expect("the network consists of layers");
                for input in &inputs {
                    for (row, values) in input.chunks(shape.columns * 3).enumerate() {
                        alone.input_row(row).copy_from_slice(values);
                        network.input_row(row).copy_from_slice(values);
                    }
                    alone.run();
                    network.run();
                    for index in 0..network.outputs() {
                        let bits =
                            |network: &Network| network.output(index).iter().map(|value| value.to_bits()).collect();
                        let [expected, found]: [Vec<u32>; 2] = [bits(&alone), bits(&network)];
                        assert_eq!(found, expected, "{}, {} threads, seed {seed}", kernels.name, team.size());
                    }
                }
            }
        }
    }
}

#[test]
fn operators_that_form_no_layer_are_refused() {
    let shape = Shape { rows: 4, columns: 4, channels: 8 };
    let mut relu_only = Draft::new(1, [4, 4, 8]);
    let tensor = relu_only.add(Kind::Relu, vec![0], shape);
    relu_only.outputs.push(tensor);
    let mut no_pointwise = Draft::new(2, [4, 4, 8]);
    let window = Window { size: 3, stride: 1, top: 1, left: 1 };
    let kind = Kind::Depthwise { window, weights: vec![0.0; 72].into(), bias: vec![0.0; 8].into() };
    let tensor = no_pointwise.add(kind, vec![0], shape);
    no_pointwise.outputs.push(tensor);
    let mut other_sum = Draft::new(3, [4, 4, 3]);
    let first = other_sum.convolution(0, window, shape);
    let kind = Kind::Depthwise { window, weights: vec![0.0; 72].into(), bias: vec![0.0; 8].into() };
    let depthwise = other_sum.add(kind, vec![first], shape);
    let pointwise = other_sum.convolution(depthwise, POINT, shape);
    let second = other_sum.convolution(0, window, shape);
    let tensor = other_sum.add(Kind::Add, vec![second, pointwise], shape);
    other_sum.outputs.push(tensor);
    for draft in [relu_only, no_pointwise, other_sum] {
        let result = Network::new(&draft.graph(), kernels::available()[0]);
        assert!(matches!(result.err(), Some(Error::Unsupported(_))));
    }
}
