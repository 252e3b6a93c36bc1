//! A network as its file states it: tensors, and operators in the order in which they run.
//!
//! A [`Graph`] exists only if it passed every check of [`Graph::new`]: each operator reads tensors that earlier
//! operators have written, all shapes agree, and memory and work stay within [`Limits`].

use crate::error::Error;
use crate::values::Values;

/// The size of a tensor. Elements lie row by row, column by column within a row, and channel by channel within a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shape {
    /// Number of rows.
    pub rows: usize,
    /// Number of pixels in a row.
    pub columns: usize,
    /// Number of values in a pixel.
    pub channels: usize,
}

impl Shape {
    /// Number of pixels.
    #[must_use]
    pub fn pixels(self) -> usize {
        self.rows.saturating_mul(self.columns)
    }

    /// Number of values. The product saturates, because a shape from a hostile file can overflow a `usize` of 32 bits.
    #[must_use]
    pub fn elements(self) -> usize {
        self.pixels().saturating_mul(self.channels)
    }
}

/// The square window that a convolution or a maximum slides over its input. Pixels outside the input count as zero in a
/// convolution and are left out of a maximum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// Rows, and columns, of the window.
    pub size: usize,
    /// Rows, and columns, from one position of the window to the next.
    pub stride: usize,
    /// Rows of the first window that lie above the input.
    pub top: usize,
    /// Columns of the first window that lie left of the input.
    pub left: usize,
}

/// What an operator computes.
#[derive(Debug, Clone, PartialEq)]
pub enum Kind<'a> {
    /// Weighted sums over a window and all channels. Weights: output channel, row, column, input channel.
    Convolution {
        /// The window.
        window: Window,
        /// One weight for each output channel and each value of the window.
        weights: Values<'a>,
        /// One addend for each output channel.
        bias: Values<'a>,
    },
    /// Weighted sums over a window, each channel by itself. Weights: row, column, channel.
    Depthwise {
        /// The window.
        window: Window,
        /// One weight for each value of the window.
        weights: Values<'a>,
        /// One addend for each channel.
        bias: Values<'a>,
    },
    /// Multiplies negative values by the slope of their channel.
    Prelu {
        /// One factor for each channel.
        slopes: Values<'a>,
    },
    /// Replaces negative values by zero.
    Relu,
    /// Adds two tensors of one shape.
    Add,
    /// The largest value in a window, each channel by itself.
    MaxPool {
        /// The window.
        window: Window,
    },
    /// Appends channels of zeros to each pixel.
    PadChannels,
    /// Puts the elements of its inputs one after the other.
    Concatenation,
}

/// One step of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct Operator<'a> {
    /// What it computes.
    pub kind: Kind<'a>,
    /// The tensors it reads.
    pub inputs: Vec<usize>,
    /// The tensor it writes.
    pub output: usize,
}

/// A tensor that the caller writes or reads, and its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Port {
    /// The name in the file.
    pub name: String,
    /// The tensor.
    pub tensor: usize,
}

/// Bounds on what a file may ask for. The networks of facewire need less than a third of each.
struct Limits;

impl Limits {
    /// Values in all tensors together.
    const ELEMENTS: usize = 1 << 23;
    /// Rows, columns or channels of a tensor.
    const SIDE: usize = (1 << 16) - 1;
    /// Operators.
    const OPERATORS: usize = 1 << 10;
    /// Multiplications of all convolutions together.
    const PRODUCTS: usize = 1 << 29;
    /// Rows of a window, and its stride.
    const WINDOW: usize = 7;
}

/// A network that passed all checks. Its numbers lie in the file.
#[derive(Debug, Clone, PartialEq)]
pub struct Graph<'a> {
    tensors: Vec<Shape>,
    operators: Vec<Operator<'a>>,
    input: Port,
    outputs: Vec<Port>,
}

impl<'a> Graph<'a> {
    /// Checks a network.
    ///
    /// # Errors
    /// [`Error::Damaged`] with the first rule that the network breaks.
    pub fn new(
        tensors: Vec<Shape>,
        operators: Vec<Operator<'a>>,
        input: Port,
        outputs: Vec<Port>,
    ) -> Result<Self, Error> {
        ensure(operators.len() <= Limits::OPERATORS, "the network has too many operators")?;
        let mut elements = 0_usize;
        for shape in &tensors {
            let sides = [shape.rows, shape.columns, shape.channels];
            let in_range = sides.iter().all(|side| (1..=Limits::SIDE).contains(side));
            ensure(in_range, "the shape of a tensor is out of range")?;
            elements = elements.saturating_add(shape.elements());
            ensure(elements <= Limits::ELEMENTS, "the tensors are too large")?;
        }
        let mut written = vec![false; tensors.len()];
        mark(&mut written, input.tensor)?;
        let mut products = 0_usize;
        for operator in &operators {
            for &tensor in &operator.inputs {
                ensure(written.get(tensor) == Some(&true), "an operator reads a tensor that nothing has written")?;
            }
            mark(&mut written, operator.output)?;
            products = products.saturating_add(operator.check(&tensors)?);
            ensure(products <= Limits::PRODUCTS, "the network takes too many multiplications")?;
        }
        ensure(!outputs.is_empty(), "the network has no output")?;
        for port in &outputs {
            ensure(written.get(port.tensor) == Some(&true), "nothing writes an output")?;
            ensure(port.tensor != input.tensor, "an output is the input")?;
        }
        Ok(Self { tensors, operators, input, outputs })
    }

    /// The shapes of all tensors.
    #[must_use]
    pub fn tensors(&self) -> &[Shape] {
        &self.tensors
    }

    /// All operators, in an order in which they can run.
    #[must_use]
    pub fn operators(&self) -> &[Operator<'a>] {
        &self.operators
    }

    /// The tensor that the caller writes.
    #[must_use]
    pub fn input(&self) -> &Port {
        &self.input
    }

    /// The tensors that the caller reads.
    #[must_use]
    pub fn outputs(&self) -> &[Port] {
        &self.outputs
    }
}

impl Operator<'_> {
    /// Checks the shapes and returns the number of multiplications.
    fn check(&self, tensors: &[Shape]) -> Result<usize, Error> {
        let shape = |tensor: &usize| tensors.get(*tensor).copied();
        let inputs: Vec<Shape> = self.inputs.iter().filter_map(shape).collect();
        let output = shape(&self.output).ok_or(Error::Damaged("an operator writes a tensor that does not exist"))?;
        let first = *inputs.first().ok_or(Error::Damaged("an operator has no input"))?;
        let count = if matches!(self.kind, Kind::Add) { 2 } else { 1 };
        let any_count = matches!(self.kind, Kind::Concatenation);
        ensure(any_count || inputs.len() == count, "an operator has the wrong number of inputs")?;
        let same_pixels = (first.rows, first.columns) == (output.rows, output.columns);
        let same_channels = first.channels == output.channels;
        let shapes_agree = match &self.kind {
            Kind::Convolution { window, weights, bias } => {
                let fits = window.fits(first, output) && bias.len() == output.channels;
                let values = if fits { window.size * window.size * first.channels } else { 0 };
                let fits = fits && Some(weights.len()) == values.checked_mul(output.channels);
                ensure(fits, "a convolution does not fit its tensors")?;
                return Ok(values.saturating_mul(output.elements()));
            }
            Kind::Depthwise { window, weights, bias } => {
                let fits = same_channels && window.fits(first, output) && bias.len() == output.channels;
                let values = if fits { window.size * window.size } else { 0 };
                let fits = fits && weights.len() == values * output.channels;
                ensure(fits, "a depthwise convolution does not fit its tensors")?;
                return Ok(values.saturating_mul(output.elements()));
            }
            Kind::Prelu { slopes } => first == output && slopes.len() == output.channels,
            Kind::Relu => first == output,
            Kind::Add => inputs.iter().all(|shape| *shape == output),
            Kind::MaxPool { window } => same_channels && window.fits(first, output),
            Kind::PadChannels => same_pixels && first.channels <= output.channels,
            Kind::Concatenation => inputs.iter().map(|shape| shape.elements()).sum::<usize>() == output.elements(),
        };
        ensure(shapes_agree, "the tensors of an operator do not fit together")?;
        Ok(0)
    }
}

impl Window {
    /// Whether the window is within limits and each of its positions, one for each pixel of `output`, covers a pixel of
    /// `input`.
    fn fits(self, input: Shape, output: Shape) -> bool {
        let range = 1..=Limits::WINDOW;
        let covers = |outputs: usize, before: usize, inputs: usize| (outputs - 1) * self.stride < inputs + before;
        range.contains(&self.size)
            && range.contains(&self.stride)
            && self.top < self.size
            && self.left < self.size
            && covers(output.rows, self.top, input.rows)
            && covers(output.columns, self.left, input.columns)
    }
}

fn mark(written: &mut [bool], tensor: usize) -> Result<(), Error> {
    let mark = written.get_mut(tensor).ok_or(Error::Damaged("an operator writes a tensor that does not exist"))?;
    ensure(!*mark, "two operators write the same tensor")?;
    *mark = true;
    Ok(())
}

fn ensure(holds: bool, otherwise: &'static str) -> Result<(), Error> {
    if holds { Ok(()) } else { Err(Error::Damaged(otherwise)) }
}
