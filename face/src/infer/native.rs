//! facewire's own engine, whose arithmetic is in the crate [`facewire_engine`].

use std::fs;
use std::sync::Arc;

use facewire_engine::kernels::Kernels;
use facewire_engine::{Graph, Team, file};

use super::{Engine, InferError, Network, NetworkFolder, Signature};

/// Extension of the names of network files.
pub(super) const EXTENSION: &str = "fwnet";

/// The native engine with the networks of one folder.
pub(super) struct Native {
    folder: NetworkFolder,
    kernels: &'static Kernels,
    team: Arc<Team>,
}

impl Native {
    /// Makes an engine whose networks run on these kernels and on the threads of this team.
    pub(super) fn new(folder: NetworkFolder, kernels: &'static Kernels, team: Arc<Team>) -> Self {
        Self { folder, kernels, team }
    }

    /// Reads the file of the network `name` and prepares the network. If `check` returns an error for its graph, the file
    /// counts as damaged.
    pub(super) fn network(
        &self,
        name: &str,
        check: impl FnOnce(&Graph) -> Result<(), String>,
    ) -> Result<facewire_engine::Network, InferError> {
        let path = self.folder.file(&format!("{name}.{EXTENSION}"))?;
        let content = fs::read(&path).map_err(|error| InferError::unreadable(&path, &error))?;
        let damaged = |reason: String| InferError::damaged(&path, &reason);
        let graph = file::read(&content).map_err(|error| damaged(error.to_string()))?;
        check(&graph).map_err(damaged)?;
        let network = facewire_engine::Network::with_team(&graph, self.kernels, Arc::clone(&self.team));
        network.map_err(|error| damaged(error.to_string()))
    }
}

impl Engine for Native {
    fn name(&self) -> String {
        format!("native, {}", self.kernels.name)
    }

    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError> {
        let mut network = NativeNetwork(self.network(signature.name, |graph| check(graph, signature))?);
        // The first run touches all memory, so that no later run causes a page fault.
        network.run()?;
        Ok(Box::new(network))
    }
}

struct NativeNetwork(facewire_engine::Network);

impl Network for NativeNetwork {
    fn input_row(&mut self, row: usize) -> &mut [f32] {
        if row < self.0.input_rows() { self.0.input_row(row) } else { &mut [] }
    }

    fn run(&mut self) -> Result<(), InferError> {
        self.0.run();
        Ok(())
    }

    fn output(&self, index: usize) -> &[f32] {
        if index < self.0.outputs() { self.0.output(index) } else { &[] }
    }
}

/// Checks that the network has the input and the outputs of the signature. The file describes an output that is a list as
/// a map, so only the number of its values is compared.
fn check(graph: &Graph, signature: &Signature) -> Result<(), String> {
    let shape = |tensor: usize| {
        let shape = graph.tensors().get(tensor).map_or([0; 3], |shape| [shape.rows, shape.columns, shape.channels]);
        shape.to_vec()
    };
    let found = shape(graph.input().tensor);
    if found != signature.input {
        return Err(format!("the input has shape {found:?} in place of {:?}", signature.input));
    }
    if graph.outputs().len() != signature.outputs.len() {
        return Err(format!("{} outputs in place of {}", graph.outputs().len(), signature.outputs.len()));
    }
    for (output, &(name, expected)) in graph.outputs().iter().zip(signature.outputs) {
        let found = shape(output.tensor);
        let is_map = expected.len() == 3;
        let is_same = if is_map {
            found == expected
        } else {
            found.iter().product::<usize>() == expected.iter().product::<usize>()
        };
        if output.name != name || !is_same {
            return Err(format!("{} has shape {found:?} in place of {name} with {expected:?}", output.name));
        }
    }
    Ok(())
}
