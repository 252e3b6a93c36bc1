//! A network that is ready to run: weights in the order of the kernels, a schedule of strips of rows, and its memory.

mod block;
mod builder;
mod layer;
mod map;
mod packing;
mod strips;

use std::ops::Range;
use std::sync::Arc;

use self::builder::Builder;
use self::layer::{Layer, Share, Sources, Work, gather};
use self::map::{Input, Map};
use self::strips::Sharing;
use crate::arena::Memory;
use crate::error::Error;
use crate::graph::{Graph, Shape};
use crate::kernels::Kernels;
use crate::schedule::Step;
use crate::team::Team;

/// The largest number of threads among which a layer is divided.
const MAX_SHARES: usize = 8;

/// A network with its memory. Running it allocates nothing, locks nothing and cannot fail.
pub struct Network {
    kernels: &'static Kernels,
    layers: Vec<Layer>,
    steps: Vec<Step>,
    maps: Vec<Map>,
    input: Input,
    outputs: Vec<Range<usize>>,
    weights: Memory,
    /// A row of zeros, then all maps in the order in which the layers write them.
    arena: Memory,
    /// Intermediate results of each thread, which are valid within one strip only.
    scratch: Memory,
    /// Number of values in one thread's part of the scratch memory.
    scratch_length: usize,
    team: Option<Arc<Team>>,
}

impl Network {
    /// Prepares a network that runs on one thread, with the kernels of an instruction set.
    ///
    /// # Errors
    /// [`Error::Unsupported`] if the network does not consist of the layers that this engine knows.
    pub fn new(graph: &Graph, kernels: &'static Kernels) -> Result<Self, Error> {
        Builder::new(graph, kernels, Sharing::NONE)?.network(None)
    }

    /// Prepares a network whose runs are shared by a team of threads. The outputs have the same bits as those of one
    /// thread. The network needs more memory than on one thread, because its strips of rows are larger. At most eight
    /// threads share a run, even if the team has more.
    ///
    /// # Errors
    /// Those of [`new`](Self::new).
    pub fn with_team(graph: &Graph, kernels: &'static Kernels, team: Arc<Team>) -> Result<Self, Error> {
        Self::divided(graph, kernels, team, Sharing::MIN_PRODUCTS)
    }

    /// [`with_team`](Self::with_team) with a choice of [`Sharing::min_products`].
    pub(crate) fn divided(
        graph: &Graph,
        kernels: &'static Kernels,
        team: Arc<Team>,
        min_products: usize,
    ) -> Result<Self, Error> {
        let threads = team.size().min(MAX_SHARES);
        Builder::new(graph, kernels, Sharing { threads, min_products })?.network(Some(team))
    }

    /// One row of the input, to be written before a run: pixel by pixel, and channel by channel within a pixel.
    ///
    /// # Panics
    /// If the input has no such row.
    pub fn input_row(&mut self, row: usize) -> &mut [f32] {
        let Shape { rows, columns, channels } = self.input.shape;
        assert!(row < rows, "the input has {rows} rows");
        let start = self.input.start + row * self.input.step;
        &mut self.arena.all_mut()[start..start + columns * channels]
    }

    /// Number of rows of the input.
    #[must_use]
    pub fn input_rows(&self) -> usize {
        self.input.shape.rows
    }

    /// The values of an output after a run: row by row, pixel by pixel and channel by channel.
    ///
    /// # Panics
    /// If there is no such output.
    #[must_use]
    pub fn output(&self, index: usize) -> &[f32] {
        &self.arena.all()[self.outputs[index].clone()]
    }

    /// Number of outputs.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.outputs.len()
    }

    /// Computes the outputs from the input.
    pub fn run(&mut self) {
        self.run_watched(|_| {});
    }

    /// Computes the outputs and calls `seen` after each strip of rows, with the index of its layer in
    /// [`layers`](Self::layers). A layer has several strips, and the strips of different layers alternate. A strip takes
    /// the time from the previous call, or from the start of the run, to its own call. The time of a layer is the sum over
    /// its strips.
    pub fn run_watched(&mut self, mut seen: impl FnMut(usize)) {
        for step in 0..self.steps.len() {
            self.run_step(step);
            seen(self.steps[step].layer);
        }
    }

    /// A description and the number of multiply-adds of each layer.
    #[must_use]
    pub fn layers(&self) -> Vec<(String, usize)> {
        let describe = |layer: &Layer| layer.describe(&self.maps[layer.input], &self.maps[layer.output]);
        self.layers.iter().map(|layer| (describe(layer), layer.products)).collect()
    }

    /// Bytes of packed weights, and of activations.
    #[must_use]
    pub fn memory(&self) -> [usize; 2] {
        let [weights, arena, scratch] =
            [&self.weights, &self.arena, &self.scratch].map(|memory| size_of_val(memory.all()));
        [weights, arena + scratch]
    }

    fn run_step(&mut self, step: usize) {
        let Step { layer, rows } = &self.steps[step];
        let layer = &self.layers[*layer];
        let (from, to) = (&self.maps[layer.input], &self.maps[layer.output]);
        // Every map that a layer reads lies before the map that it writes.
        let (before, after) = self.arena.all_mut().split_at_mut(to.area.start);
        if let Work::Gather { inputs } = &layer.work {
            return gather(inputs.iter().map(|input| &self.maps[*input]), before, after);
        }
        let sources = Sources {
            kernels: self.kernels,
            layer,
            from,
            to,
            weights: self.weights.all(),
            input: &before[from.area.clone()],
            zeros: before,
        };
        let output = &mut after[to.rows(rows.clone())];
        let (range, values) = match layer.work {
            Work::Dense { .. } => (0..to.channels / self.kernels.dense_panel, self.kernels.dense_panel),
            _ => (rows.clone(), to.row),
        };
        let mut whole = Share { range, output, scratch: self.scratch.all_mut() };
        match &self.team {
            Some(team) if layer.division.shares > 1 => {
                let (mut shares, count) = whole.divide(&layer.division, values, self.scratch_length);
                team.for_each(&mut shares[..count], |share| sources.compute(share));
            }
            _ => sources.compute(&mut whole),
        }
    }
}
