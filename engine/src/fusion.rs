//! Turns the operators of a network into the few kinds of layers that the kernels compute.
//!
//! A depthwise convolution, the pointwise convolution of its output, the sum with the input of both and the activation
//! become one layer, so that what lies between them never leaves the cache. A network that does not consist of such
//! layers is refused.

use crate::error::Error;
use crate::graph::{Graph, Kind, Operator, Shape, Window};
use crate::values::Values;

/// Operators that are computed together.
#[derive(Debug)]
pub(crate) struct Layer<'a> {
    pub work: Work<'a>,
    /// The tensor that the layer reads; the first of them for [`Work::Gather`].
    pub input: usize,
    /// The tensor that the layer writes.
    pub output: usize,
    pub activation: Activation<'a>,
}

impl Layer<'_> {
    /// Number of multiply-adds.
    pub(crate) fn products(&self, graph: &Graph) -> usize {
        let pixels = graph.tensors().get(self.output).map_or(0, |shape| shape.pixels());
        match &self.work {
            Work::Stem { weights, .. } | Work::Dense { weights, .. } => pixels * weights.len(),
            Work::Block { depthwise, weights, .. } => {
                pixels * (weights.len() + depthwise.map_or(0, |depthwise| depthwise.weights.len()))
            }
            Work::Gather { .. } => 0,
        }
    }
}

/// What a layer computes before its activation.
#[derive(Debug)]
pub(crate) enum Work<'a> {
    /// A convolution of the network's input.
    Stem { window: Window, weights: &'a Values<'a>, bias: &'a Values<'a> },
    /// A depthwise convolution, if any, then a pointwise one, then the sum with the residual.
    Block { depthwise: Option<Depthwise<'a>>, weights: &'a Values<'a>, bias: &'a Values<'a>, residual: Residual },
    /// A convolution whose window is the whole map.
    Dense { weights: &'a Values<'a>, bias: &'a Values<'a> },
    /// The elements of some maps, one after the other.
    Gather { inputs: Vec<usize> },
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Depthwise<'a> {
    pub stride: usize,
    pub weights: &'a Values<'a>,
    pub bias: &'a Values<'a>,
}

/// What a block adds to its sums.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Residual {
    None,
    /// The block's input.
    Input,
    /// The largest value of every 2 x 2 pixels of the block's input.
    Largest,
}

#[derive(Debug, Clone, Copy)]
pub(crate) enum Activation<'a> {
    None,
    Relu,
    Prelu(&'a Values<'a>),
}

/// Returns the layers of a network, in an order in which they can run.
///
/// # Errors
/// [`Error::Unsupported`] if the operators do not form layers.
pub(crate) fn layers<'a>(graph: &'a Graph<'a>) -> Result<Vec<Layer<'a>>, Error> {
    let mut fusion = Fusion { graph, taken: vec![false; graph.operators().len()] };
    let mut layers = Vec::new();
    for index in 0..graph.operators().len() {
        layers.extend(fusion.layer_at(index)?);
    }
    if fusion.taken.iter().all(|taken| *taken) {
        Ok(layers)
    } else {
        Err(Error::Unsupported("an operator belongs to no layer"))
    }
}

struct Fusion<'a> {
    graph: &'a Graph<'a>,
    /// Which operators are part of a layer already.
    taken: Vec<bool>,
}

impl<'a> Fusion<'a> {
    /// The layer that begins with an operator, if one does.
    fn layer_at(&mut self, index: usize) -> Result<Option<Layer<'a>>, Error> {
        let operator = &self.graph.operators()[index];
        if self.taken[index] || matches!(operator.kind, Kind::MaxPool { .. } | Kind::PadChannels) {
            return Ok(None);
        }
        self.taken[index] = true;
        let input = operator.inputs[0];
        let (work, sum) = match &operator.kind {
            Kind::Convolution { window, weights, bias } => {
                (self.convolution(operator, *window, weights, bias)?, operator.output)
            }
            Kind::Depthwise { window, weights, bias } => {
                let depthwise = self.depthwise(operator, *window, weights, bias)?;
                self.block(input, depthwise, operator.output)?
            }
            Kind::Concatenation => (Work::Gather { inputs: operator.inputs.clone() }, operator.output),
            _ => return Err(Error::Unsupported("an operator follows no convolution")),
        };
        let (activation, output) = self.activation(sum);
        if !matches!(activation, Activation::None) && matches!(work, Work::Dense { .. } | Work::Gather { .. }) {
            return Err(Error::Unsupported("an activation follows a layer that has none"));
        }
        Ok(Some(Layer { work, input, output, activation }))
    }

    fn convolution(
        &self,
        operator: &Operator,
        window: Window,
        weights: &'a Values<'a>,
        bias: &'a Values<'a>,
    ) -> Result<Work<'a>, Error> {
        let (from, to) = (self.shape(operator.inputs[0]), self.shape(operator.output));
        let whole = to.pixels() == 1 && from.rows == window.size && from.columns == window.size;
        if is_pointwise(window, from, to) {
            return Ok(Work::Block { depthwise: None, weights, bias, residual: Residual::None });
        }
        if whole && window.top == 0 && window.left == 0 {
            return Ok(Work::Dense { weights, bias });
        }
        if operator.inputs[0] == self.graph.input().tensor {
            return Ok(Work::Stem { window, weights, bias });
        }
        Err(Error::Unsupported("a convolution is neither the first layer nor pointwise nor as large as its input"))
    }

    fn depthwise(
        &self,
        operator: &Operator,
        window: Window,
        weights: &'a Values<'a>,
        bias: &'a Values<'a>,
    ) -> Result<Depthwise<'a>, Error> {
        let (from, to) = (self.shape(operator.inputs[0]), self.shape(operator.output));
        let twice = (from.rows, from.columns) == (2 * to.rows, 2 * to.columns);
        let same = (from.rows, from.columns) == (to.rows, to.columns);
        match (window.size, window.stride, window.top, window.left) {
            (3, 1, 1, 1) if same => Ok(Depthwise { stride: 1, weights, bias }),
            (3, 2, 0, 0) if twice => Ok(Depthwise { stride: 2, weights, bias }),
            _ => Err(Error::Unsupported("a depthwise convolution is not 3 x 3 with the padding of TFLite")),
        }
    }

    /// The block that goes on from a depthwise convolution, and the tensor of its sums.
    fn block(&mut self, input: usize, depthwise: Depthwise<'a>, middle: usize) -> Result<(Work<'a>, usize), Error> {
        let graph = self.graph;
        let Some((index, Operator { kind: Kind::Convolution { window, weights, bias }, output, .. })) =
            self.only_user(middle)
        else {
            return Err(Error::Unsupported("no pointwise convolution follows a depthwise one"));
        };
        if !is_pointwise(*window, self.shape(middle), self.shape(*output)) {
            return Err(Error::Unsupported("no pointwise convolution follows a depthwise one"));
        }
        self.taken[index] = true;
        let block = |residual| Work::Block { depthwise: Some(depthwise), weights, bias, residual };
        let Some((add, Operator { kind: Kind::Add, inputs, output: sum })) = self.only_user(*output) else {
            return Ok((block(Residual::None), *output));
        };
        self.taken[add] = true;
        let mut other = if inputs[0] == *output { inputs[1] } else { inputs[0] };
        let mut residual = Residual::Input;
        while other != input {
            let found = graph.operators().iter().position(|operator| operator.output == other);
            let found = found.filter(|_| self.only_user(other).is_some());
            let index = found.ok_or(Error::Unsupported("a sum has an operand that is not the input of its block"))?;
            match &graph.operators()[index].kind {
                Kind::PadChannels => {}
                Kind::MaxPool { window: Window { size: 2, stride: 2, top: 0, left: 0 } }
                    if residual == Residual::Input =>
                {
                    residual = Residual::Largest;
                }
                _ => return Err(Error::Unsupported("a sum has an operand that is not the input of its block")),
            }
            self.taken[index] = true;
            other = graph.operators()[index].inputs[0];
        }
        if (residual == Residual::Largest) != (depthwise.stride == 2) {
            return Err(Error::Unsupported("a sum has operands of different resolution"));
        }
        Ok((block(residual), *sum))
    }

    /// The activation that follows the sums of a layer, and the tensor it writes.
    fn activation(&mut self, sum: usize) -> (Activation<'a>, usize) {
        let (index, activation) = match self.only_user(sum) {
            Some((index, Operator { kind: Kind::Relu, .. })) => (index, Activation::Relu),
            Some((index, Operator { kind: Kind::Prelu { slopes }, .. })) => (index, Activation::Prelu(slopes)),
            _ => return (Activation::None, sum),
        };
        self.taken[index] = true;
        (activation, self.graph.operators()[index].output)
    }

    /// The operator that reads a tensor, if there is exactly one and the caller does not read it.
    fn only_user(&self, tensor: usize) -> Option<(usize, &'a Operator<'a>)> {
        let is_output = self.graph.outputs().iter().any(|port| port.tensor == tensor);
        let all = self.graph.operators().iter().enumerate();
        let mut users = all.filter(|(_, operator)| operator.inputs.contains(&tensor));
        let first = users.next().filter(|_| !is_output)?;
        users.next().is_none().then_some(first)
    }

    fn shape(&self, tensor: usize) -> Shape {
        self.graph.tensors()[tensor]
    }
}

fn is_pointwise(window: Window, from: Shape, to: Shape) -> bool {
    (window.size, window.stride) == (1, 1) && (from.rows, from.columns) == (to.rows, to.columns)
}
