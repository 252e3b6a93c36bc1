//! Runs the landmark networks, on the first [`Engine`] that this build contains.
//!
//! A network has fixed shapes: one input and a few outputs, all `f32`. The caller writes the input in place, runs the
//! network and reads the outputs in place. Nothing is allocated between [`Engine::load`] and the end of the network's
//! life, unless a run fails.
//!
//! To add an engine, write its module and add one line to [`ENGINES`].

mod error;
mod folder;
#[cfg(feature = "ort")]
mod onnx_runtime;
#[cfg(test)]
pub(crate) mod scripted;

pub use error::InferError;
pub use folder::NetworkFolder;

use crate::config::NetworkSettings;

/// Makes an engine for the networks of a folder and for the number of threads that one inference may use.
type NewEngine = fn(NetworkFolder, usize) -> Box<dyn Engine>;

/// The engines of this build; the preferred one comes first.
const ENGINES: &[NewEngine] = &[
    #[cfg(feature = "ort")]
    |folder, threads| Box::new(onnx_runtime::OnnxRuntime::new(folder, threads)),
];

/// The name of a network and the shapes of its input and outputs. An engine refuses a file that differs from them,
/// so that networks of another version are found at start-up.
#[derive(Debug)]
pub struct Signature {
    /// File name without its extension, which is the engine's own.
    pub name: &'static str,
    /// Shape of the only input: pictures in a batch (1), channels, rows, columns.
    pub input: [usize; 4],
    /// Names and shapes of the outputs, in the order in which [`Network::output`] numbers them.
    pub outputs: &'static [(&'static str, &'static [usize])],
}

/// Loads networks.
pub trait Engine: Send + Sync {
    /// The name that operators and tests see, in lower case.
    fn name(&self) -> &'static str;

    /// Loads the network that `signature` describes and takes all memory that its runs need, so that the first frame
    /// does not wait for any.
    ///
    /// # Errors
    /// [`InferError`], if a file is missing, unreadable or damaged, or if the network does not run.
    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError>;
}

/// A network that is ready to run.
pub trait Network: Send {
    /// The input values: channel by channel, and row by row within a channel.
    fn input(&mut self) -> &mut [f32];

    /// Computes the outputs from the input.
    ///
    /// # Errors
    /// [`InferError::Run`] if the engine fails. The outputs are then unspecified.
    fn run(&mut self) -> Result<(), InferError>;

    /// The values of output `index` of the signature, in the engine's memory. Empty if there is no such output.
    fn output(&self, index: usize) -> &[f32];
}

/// Returns the engine that runs the networks with these settings.
///
/// # Errors
/// Those of [`engines`].
pub fn engine(settings: &NetworkSettings) -> Result<Box<dyn Engine>, InferError> {
    engines(settings)?.into_iter().next().ok_or(InferError::NoEngine)
}

/// Returns every engine of this build; the preferred one comes first.
///
/// # Errors
/// [`InferError::NoEngine`] if this build contains none, and those of [`NetworkFolder::find`].
pub fn engines(settings: &NetworkSettings) -> Result<Vec<Box<dyn Engine>>, InferError> {
    if ENGINES.is_empty() {
        return Err(InferError::NoEngine);
    }
    let folder = NetworkFolder::find(&settings.folder)?;
    Ok(ENGINES.iter().map(|new| new(folder.clone(), settings.threads as usize)).collect())
}
