//! Running the landmark networks, by any engine that can stand behind [`Network`].
//!
//! A network has fixed shapes: one input, a few outputs, all `f32`. Its caller writes the input in place, runs it
//! and reads the outputs in place; nothing is allocated between [`load`] and the end of the process.

mod folder;
#[cfg(feature = "ort")]
mod onnx_runtime;

use std::fs::File;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

pub use folder::NetworkFolder;

/// Runs before the first frame: in its first run ONNX Runtime plans the memory for the next, and takes it in the second.
const WARM_UP_RUNS: usize = 2;
/// All values of their input: a grey picture, to the detector as to the mesh.
const GREY: f32 = 0.5;

/// The names and lengths that a network file must have, so that a file of another version is refused at start-up.
#[derive(Debug)]
pub struct Signature {
    /// File name without its ending.
    pub name: &'static str,
    /// Shape of the only input: pictures in a batch (1), channels, rows, columns.
    pub input: [usize; 4],
    /// Names and shapes of the outputs, in the order in which [`Network::output`] numbers them.
    pub outputs: &'static [(&'static str, &'static [usize])],
}

/// A network ready to run.
pub trait Network: Send {
    /// The input values, row by row, channel by channel.
    fn input(&mut self) -> &mut [f32];

    /// Computes the outputs from the input.
    ///
    /// # Errors
    /// [`InferError::Run`] when the engine refuses; the outputs are then those of an earlier run.
    fn run(&mut self) -> Result<(), InferError>;

    /// Values of output `index` of the signature; empty for an index it does not have.
    fn output(&self, index: usize) -> &[f32];
}

/// Why a network cannot be loaded or run.
#[derive(Debug, thiserror::Error)]
pub enum InferError {
    /// No folder on the search path holds the networks.
    #[error(
        "the landmark networks are not installed: looked in {}; run scripts/setup, or set networks.folder",
        list(.0)
    )]
    NoFolder(Vec<PathBuf>),
    /// A folder or a file of it may not be looked at.
    #[error("{} cannot be read ({error}); give this user the right to read it and all folders above it", path.display())]
    Unreadable {
        /// The folder or file.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// One file of the folder is missing.
    #[error("{} is missing: run scripts/setup again", .0.display())]
    Missing(PathBuf),
    /// The ONNX Runtime library is not there or does not load.
    #[error("ONNX Runtime cannot be loaded from {}: {reason}; run scripts/setup again", path.display())]
    Library {
        /// The library file.
        path: PathBuf,
        /// What the loader said.
        reason: String,
    },
    /// The file is no network, or one with other inputs and outputs.
    #[error("{} is damaged or of another version ({reason}): run scripts/setup again", path.display())]
    Damaged {
        /// The network file.
        path: PathBuf,
        /// What does not fit.
        reason: String,
    },
    /// This build has no engine.
    #[error("this facewire was built without an engine for the networks: build it with the feature `ort`")]
    NoEngine,
    /// The engine failed on a frame.
    #[error("network {0} failed to run; free some memory, and if that does not help run scripts/setup again")]
    Run(&'static str),
}

fn list(paths: &[PathBuf]) -> String {
    let shown: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
    shown.join(", ")
}

/// Loads the network `signature.name` from `folder`, to run on `threads` threads, and warms it up with a grey picture:
/// engines take memory in their first runs, and the first frame must not wait for it.
///
/// # Errors
/// Every [`InferError`] but [`InferError::NoFolder`].
pub fn load(
    folder: &NetworkFolder,
    signature: &'static Signature,
    threads: usize,
) -> Result<Box<dyn Network>, InferError> {
    let path = folder.network(signature.name);
    require(&path)?;
    let mut network = engine(folder, &path, signature, threads)?;
    for _ in 0..WARM_UP_RUNS {
        network.input().fill(GREY);
        network.run()?;
    }
    Ok(network)
}

#[cfg(feature = "ort")]
fn engine(
    folder: &NetworkFolder,
    path: &Path,
    signature: &'static Signature,
    threads: usize,
) -> Result<Box<dyn Network>, InferError> {
    let library = folder.onnx_runtime();
    require(&library)?;
    let network = onnx_runtime::OnnxRuntimeNetwork::load(&library, path, signature, threads)?;
    Ok(Box::new(network))
}

#[cfg(not(feature = "ort"))]
fn engine(_: &NetworkFolder, _: &Path, _: &'static Signature, _: usize) -> Result<Box<dyn Network>, InferError> {
    Err(InferError::NoEngine)
}

fn require(path: &Path) -> Result<(), InferError> {
    match File::open(path) {
        Ok(file) if file.metadata().is_ok_and(|found| found.is_file()) => Ok(()),
        Err(error) if error.kind() == ErrorKind::PermissionDenied => {
            Err(InferError::Unreadable { path: path.to_path_buf(), error })
        }
        _ => Err(InferError::Missing(path.to_path_buf())),
    }
}
