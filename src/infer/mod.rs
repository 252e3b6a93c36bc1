//! Runs the landmark networks, on the [`Engine`] that the settings choose.
//!
//! A network has one input and a few outputs of fixed shapes, all `f32`. The input and those outputs that are maps are
//! stored row by row, pixel by pixel within a row, and channel by channel within a pixel. The caller writes the input in
//! place, runs the network and reads the outputs in place. After [`Engine::load`] a network allocates nothing, unless a run
//! fails.
//!
//! To add an engine, write its module, and add it to [`engine`], to [`engines`] and to [`EngineChoice`].

mod error;
mod folder;
mod native;
#[cfg(feature = "ort")]
mod onnx_runtime;
#[cfg(test)]
pub(crate) mod scripted;

pub use error::InferError;
pub use folder::NetworkFolder;
use native::Native;

use std::sync::Arc;

use facewire_engine::{Team, kernels};

use crate::config::{EngineChoice, NetworkSettings};

/// The name of a network and the shapes of its input and outputs. An engine refuses a file that differs from them,
/// so that networks of another version are found at start-up.
#[derive(Debug)]
pub struct Signature {
    /// File name without its extension, which is the engine's own.
    pub name: &'static str,
    /// Shape of the only input: rows, columns, channels.
    pub input: [usize; 3],
    /// Names and shapes of the outputs, in the order in which [`Network::output`] numbers them. A shape of three numbers is
    /// that of a map: rows, columns, channels.
    pub outputs: &'static [(&'static str, &'static [usize])],
}

/// Loads networks.
pub trait Engine: Send + Sync {
    /// The name that operators and tests see.
    fn name(&self) -> String;

    /// Loads the network that `signature` describes and takes all memory that its runs need, so that the first frame
    /// does not wait for any.
    ///
    /// # Errors
    /// [`InferError`], if a file is missing, unreadable or damaged, or if the network does not run.
    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError>;
}

/// A network that is ready to run.
pub trait Network: Send {
    /// Returns one row of the input, pixel by pixel, and channel by channel within a pixel. The slice is empty if there is no
    /// such row.
    fn input_row(&mut self, row: usize) -> &mut [f32];

    /// Computes the outputs from the input.
    ///
    /// # Errors
    /// [`InferError::Run`] if the engine fails. The outputs are then unspecified.
    fn run(&mut self) -> Result<(), InferError>;

    /// Returns the values of output `index` of the signature, in the engine's memory. The slice is empty if there is no such
    /// output.
    fn output(&self, index: usize) -> &[f32];
}

/// Returns the engine that the settings choose.
///
/// # Errors
/// [`InferError::NotBuilt`] if this build does not contain it, [`InferError::Threads`] if the system refuses the threads
/// of the settings, and those of [`NetworkFolder::find`].
pub fn engine(settings: &NetworkSettings) -> Result<Box<dyn Engine>, InferError> {
    let folder = NetworkFolder::find(&settings.folder)?;
    match settings.engine {
        EngineChoice::Auto | EngineChoice::Native => {
            Ok(Box::new(Native::new(folder, kernels::fastest(), team(settings.threads)?)))
        }
        EngineChoice::OnnxRuntime => onnx_runtime(folder, settings.threads as usize).ok_or(InferError::NotBuilt),
    }
}

/// Returns every engine of this build, and the native one once for each instruction set of this machine. The preferred
/// engine comes first.
///
/// # Errors
/// [`InferError::Threads`] if the system refuses the threads of the settings, and those of [`NetworkFolder::find`].
pub fn engines(settings: &NetworkSettings) -> Result<Vec<Box<dyn Engine>>, InferError> {
    let folder = NetworkFolder::find(&settings.folder)?;
    let team = team(settings.threads)?;
    let native = |kernels| Box::new(Native::new(folder.clone(), kernels, Arc::clone(&team))) as Box<dyn Engine>;
    let all = kernels::available().into_iter().map(native);
    Ok(all.chain(onnx_runtime(folder.clone(), settings.threads as usize)).collect())
}

/// Loads the network `name` on the native engine with these kernels and one thread, so that its layers can be measured.
///
/// # Errors
/// Those of [`NetworkFolder::find`] and of [`Engine::load`].
pub(crate) fn native_network(
    settings: &NetworkSettings,
    kernels: &'static kernels::Kernels,
    name: &str,
) -> Result<facewire_engine::Network, InferError> {
    Native::new(NetworkFolder::find(&settings.folder)?, kernels, team(1)?).network(name, |_| Ok(()))
}

/// Starts the threads that run the networks of the native engine. The calling thread is one of them.
fn team(threads: u32) -> Result<Arc<Team>, InferError> {
    Team::new(threads as usize).map(Arc::new).map_err(InferError::Threads)
}

/// Returns ONNX Runtime, if this build contains it.
#[cfg(feature = "ort")]
#[expect(clippy::unnecessary_wraps, reason = "not every build contains the engine")]
fn onnx_runtime(folder: NetworkFolder, threads: usize) -> Option<Box<dyn Engine>> {
    Some(Box::new(onnx_runtime::OnnxRuntime::new(folder, threads)))
}

#[cfg(not(feature = "ort"))]
fn onnx_runtime(_: NetworkFolder, _: usize) -> Option<Box<dyn Engine>> {
    None
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::time::{Duration, Instant};
    use std::{fs, thread};

    use super::*;

    /// Returns the names of the threads that run networks in this process.
    fn network_threads() -> Vec<String> {
        let names = fs::read_dir("/proc/self/task").unwrap().filter_map(|task| {
            let name = fs::read_to_string(task.unwrap().path().join("comm")).ok()?;
            Some(name.trim().to_owned()).filter(|name| name.starts_with("fw-net"))
        });
        let mut names: Vec<_> = names.collect();
        names.sort();
        names
    }

    /// Waits until the threads with these names run. A new thread does not have its name until it has set it itself.
    fn await_network_threads(expected: &[&str]) {
        let start = Instant::now();
        while network_threads() != expected {
            assert!(start.elapsed() < Duration::from_secs(10), "{:?} in place of {expected:?}", network_threads());
            thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn the_native_engine_runs_the_number_of_threads_in_the_settings_until_it_is_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().to_str().unwrap().to_owned();
        let settings = NetworkSettings { folder, threads: 3, ..NetworkSettings::default() };
        let engine = engine(&settings).unwrap();
        await_network_threads(&["fw-net-1", "fw-net-2"]);
        drop(engine);
        await_network_threads(&[]);
    }
}
