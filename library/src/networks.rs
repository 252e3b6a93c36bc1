//! The networks that are part of the program.

use std::sync::Arc;

use facewire_engine::kernels::{self, Kernels};
use facewire_engine::{Network, Team, file};
use facewire_face::stages::{Network as Runs, Signature};
use facewire_face::{Engine, InferError};

static CONTENTS: [(&str, &[u8]); 5] = include!(concat!(env!("OUT_DIR"), "/networks.rs"));

/// facewire's own engine with the built-in networks.
pub struct BuiltIn {
    kernels: &'static Kernels,
    team: Arc<Team>,
}

impl BuiltIn {
    pub fn new(threads: u32) -> Result<Self, InferError> {
        let team = Team::new(threads as usize);
        let team =
            team.map_err(|error| InferError(format!("the system refused a thread for the networks ({error})")))?;
        Ok(Self { kernels: kernels::fastest(), team: Arc::new(team) })
    }
}

impl Engine for BuiltIn {
    fn name(&self) -> String {
        format!("native, {}", self.kernels.name)
    }

    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Runs>, InferError> {
        let damaged =
            |reason: &str| InferError(format!("the built-in network {} is damaged: {reason}", signature.name));
        let found = CONTENTS.iter().find(|(name, _)| *name == signature.name);
        let (_, content) = found.ok_or_else(|| damaged("it is missing"))?;
        let graph = file::read(content).map_err(|error| damaged(&error.to_string()))?;
        let network = Network::with_team(&graph, self.kernels, Arc::clone(&self.team));
        let mut network = network.map_err(|error| damaged(&error.to_string()))?;
        // The first run touches all memory, so that no later run causes a page fault.
        network.run();
        Ok(Box::new(network))
    }
}
