//! An engine for tests. Its networks run a closure of the test.

use std::sync::Arc;

use super::{Engine, InferError, Network, Signature};

/// One run of a scripted network.
pub(crate) struct Run<'a> {
    /// Name of the network.
    pub(crate) network: &'static str,
    /// The outputs in the order of the signature, for the closure to fill in. They contain the values of the run before,
    /// and 0 in the first run.
    pub(crate) outputs: &'a mut [Vec<f32>],
}

type Script = dyn Fn(Run) -> Result<(), &'static str> + Send + Sync;

/// An engine that runs a closure in place of every network.
pub(crate) struct Scripted(Arc<Script>);

impl Scripted {
    /// An engine whose networks run `script`. The text of an error becomes the engine's message.
    pub(crate) fn new(script: impl Fn(Run) -> Result<(), &'static str> + Send + Sync + 'static) -> Self {
        Self(Arc::new(script))
    }
}

impl Engine for Scripted {
    fn name(&self) -> String {
        "scripted".to_owned()
    }

    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError> {
        let zeros = |shape: &[usize]| vec![0.0; shape.iter().product()];
        Ok(Box::new(ScriptedNetwork {
            name: signature.name,
            script: Arc::clone(&self.0),
            row: zeros(&signature.input[1..]),
            outputs: signature.outputs.iter().map(|(_, shape)| zeros(shape)).collect(),
        }))
    }
}

struct ScriptedNetwork {
    name: &'static str,
    script: Arc<Script>,
    /// The memory of every row of the input. All rows share it, because nothing reads the input.
    row: Vec<f32>,
    outputs: Vec<Vec<f32>>,
}

impl Network for ScriptedNetwork {
    fn input_row(&mut self, _: usize) -> &mut [f32] {
        &mut self.row
    }

    fn run(&mut self) -> Result<(), InferError> {
        let run = Run { network: self.name, outputs: &mut self.outputs };
        (self.script)(run).map_err(|reason| InferError::Run { network: self.name, reason: reason.to_owned() })
    }

    fn output(&self, index: usize) -> &[f32] {
        self.outputs.get(index).map_or(&[], Vec::as_slice)
    }
}
