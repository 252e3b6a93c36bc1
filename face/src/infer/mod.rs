//! Runs the landmark networks on an [`Engine`].
//!
//! A network has one input and a few outputs of fixed shapes, all `f32`. The input and those outputs that are maps are
//! stored row by row, pixel by pixel within a row, and channel by channel within a pixel. The caller writes the input in
//! place, runs the network and reads the outputs in place. After [`Engine::load`] a network allocates nothing, unless a run
//! fails.
//!
//! To add an engine, write its module, and add it to [`engine`], to [`engines`] and to [`EngineChoice`].

mod native;
#[cfg(feature = "ort")]
mod onnx_runtime;

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::{env, sync::Arc};

use facewire_engine::{Team, kernels};

use native::Native;

/// The environment variable that names the folder of the networks and replaces the search.
const VARIABLE: &str = "FACEWIRE_NETWORKS";
/// The folder that a package installs.
const INSTALLED: &str = "/usr/lib/facewire/networks";

/// Why a network cannot be loaded or run: a sentence that names the file or the network, and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct InferError(String);

impl InferError {
    fn unreadable(path: &Path, error: &io::Error) -> Self {
        let path = path.display();
        Self(format!("{path} cannot be read ({error}); give this user the right to read it and all folders above it"))
    }

    fn damaged(path: &Path, reason: &str) -> Self {
        Self(format!("{} is damaged or of another version ({reason}): run {}", path.display(), remedy(path)))
    }

    #[cfg(any(feature = "ort", feature = "testing", test))]
    pub(crate) fn run(network: &str, reason: &str) -> Self {
        Self(format!(
            "network {network} failed to run ({reason}); free some memory, and if that does not help, run scripts/setup \
             onnxruntime"
        ))
    }
}

/// Returns the command that installs a file of the folder.
fn remedy(path: &Path) -> &'static str {
    let is_native = path.extension().is_some_and(|extension| extension == native::EXTENSION);
    if is_native { "scripts/setup" } else { "scripts/setup onnxruntime" }
}

/// What runs the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EngineChoice {
    /// The engine that is best for this machine.
    Auto,
    /// facewire's own engine.
    Native,
    /// ONNX Runtime.
    OnnxRuntime,
}

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
    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError>;
}

/// A network that is ready to run.
pub trait Network: Send {
    /// Returns one row of the input, pixel by pixel, and channel by channel within a pixel. The slice is empty if there is no
    /// such row.
    fn input_row(&mut self, row: usize) -> &mut [f32];

    /// Computes the outputs from the input. After a failure, the outputs are unspecified.
    fn run(&mut self) -> Result<(), InferError>;

    /// Returns the values of output `index` of the signature, in the engine's memory. The slice is empty if there is no such
    /// output.
    fn output(&self, index: usize) -> &[f32];
}

/// The folder that holds the networks and the libraries of the engines. `scripts/setup` or a package fills it.
#[derive(Debug, Clone)]
pub struct NetworkFolder(PathBuf);

impl NetworkFolder {
    /// Returns the folder that `setting` names. If `setting` is empty, returns the folder that `$FACEWIRE_NETWORKS`
    /// names. If that is not set either, returns the first that exists of `facewire/networks` in the user's cache,
    /// which `scripts/setup` fills, and the folder of an installed package.
    pub fn find(setting: &str) -> Result<Self, InferError> {
        let tried = candidates(setting);
        let mut refused = None;
        for folder in &tried {
            match fs::metadata(folder) {
                Ok(found) if found.is_dir() => return Ok(Self(folder.clone())),
                Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                    refused.get_or_insert(InferError::unreadable(folder, &error));
                }
                _ => {}
            }
        }
        Err(refused.unwrap_or_else(|| {
            let tried: Vec<_> = tried.iter().map(|path| path.display().to_string()).collect();
            InferError(format!(
                "the landmark networks are not installed: looked in {}; run scripts/setup, or set networks.folder",
                tried.join(", ")
            ))
        }))
    }

    /// The path of the folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Returns the path of the file `name` in this folder, after a check that the file can be opened.
    fn file(&self, name: &str) -> Result<PathBuf, InferError> {
        let path = self.0.join(name);
        match File::open(&path) {
            Ok(file) if file.metadata().is_ok_and(|found| found.is_file()) => Ok(path),
            Err(error) if error.kind() == ErrorKind::PermissionDenied => Err(InferError::unreadable(&path, &error)),
            _ => Err(InferError(format!("{} is missing: run {}", path.display(), remedy(&path)))),
        }
    }
}

fn candidates(setting: &str) -> Vec<PathBuf> {
    if !setting.is_empty() {
        return vec![setting.into()];
    }
    if let Some(named) = env::var_os(VARIABLE) {
        return vec![named.into()];
    }
    let cache = env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let home = || env::var_os("HOME").map(|home| Path::new(&home).join(".cache"));
    let user = cache.or_else(home).map(|cache| cache.join("facewire/networks"));
    user.into_iter().chain([INSTALLED.into()]).collect()
}

/// Returns the engine of this choice, whose networks are in `folder` ([`NetworkFolder::find`]) and run on this many threads.
pub fn engine(choice: EngineChoice, folder: &str, threads: u32) -> Result<Box<dyn Engine>, InferError> {
    let folder = NetworkFolder::find(folder)?;
    match choice {
        EngineChoice::Auto | EngineChoice::Native => {
            Ok(Box::new(Native::new(folder, kernels::fastest(), team(threads)?)))
        }
        EngineChoice::OnnxRuntime => onnx_runtime(folder, threads as usize).ok_or_else(|| {
            let remedy = "set networks.engine = \"native\", or build it with the feature `ort`";
            InferError(format!("this facewire was built without ONNX Runtime: {remedy}"))
        }),
    }
}

/// Returns every engine of this build, and the native one once for each instruction set of this machine. The preferred
/// engine comes first.
pub fn engines(folder: &str, threads: u32) -> Result<Vec<Box<dyn Engine>>, InferError> {
    let folder = NetworkFolder::find(folder)?;
    let team = team(threads)?;
    let native = |kernels| Box::new(Native::new(folder.clone(), kernels, Arc::clone(&team))) as Box<dyn Engine>;
    let all = kernels::available().into_iter().map(native);
    Ok(all.chain(onnx_runtime(folder.clone(), threads as usize)).collect())
}

/// Loads the network `name` on the native engine with these kernels and one thread, so that its layers can be measured.
pub fn native_network(
    folder: &str,
    kernels: &'static kernels::Kernels,
    name: &str,
) -> Result<facewire_engine::Network, InferError> {
    Native::new(NetworkFolder::find(folder)?, kernels, team(1)?).network(name, |_| Ok(()))
}

/// Starts the threads that run the networks of the native engine. The calling thread is one of them.
fn team(threads: u32) -> Result<Arc<Team>, InferError> {
    Team::new(threads as usize).map(Arc::new).map_err(|error| {
        InferError(format!(
            "the system refused a thread for the networks ({error}); raise the limit of threads (systemd: TasksMax), or \
             lower networks.threads"
        ))
    })
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
mod tests {
    use std::thread;
    use std::time::{Duration, Instant};

    use super::*;

    #[test]
    fn folder_named_by_the_setting_is_the_only_one_tried() {
        let error = NetworkFolder::find("/nonexistent/networks").expect_err("no such folder").to_string();
        assert!(error.contains("/nonexistent/networks") && !error.contains(INSTALLED), "{error}");
    }

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
    fn the_native_engine_runs_the_number_of_threads_it_was_asked_for_until_it_is_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().to_str().unwrap().to_owned();
        let engine = engine(EngineChoice::Native, &folder, 3).unwrap();
        await_network_threads(&["fw-net-1", "fw-net-2"]);
        drop(engine);
        await_network_threads(&[]);
    }
}
