//! Runs the landmark networks on an [`Engine`].
//!
//! A network has one input and a few outputs of fixed shapes, all `f32`. The input and those outputs that are maps are
//! stored row by row, pixel by pixel, and channel by channel. After [`Engine::load`] a network allocates nothing, unless a
//! run fails.

#[cfg(feature = "ort")]
mod onnx_runtime;

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::{env, sync::Arc};

use facewire_engine::kernels::{self, Kernels};
use facewire_engine::{Graph, Team, file};

/// The environment variable that names the folder of the networks and replaces the search.
const VARIABLE: &str = "FACEWIRE_NETWORKS";
/// The folder that a package installs.
const INSTALLED: &str = "/usr/lib/facewire/networks";
const EXTENSION: &str = "fwnet";

/// Why a network cannot be loaded or run: a sentence that names the file or the network, and the remedy.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct InferError(pub String);

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

fn remedy(path: &Path) -> &'static str {
    let is_native = path.extension().is_some_and(|extension| extension == EXTENSION);
    if is_native { "scripts/setup" } else { "scripts/setup onnxruntime" }
}

/// What runs the networks. `Auto` is the engine that is best for this machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names say it")]
pub enum EngineChoice {
    Auto,
    Native,
    OnnxRuntime,
}

/// What the file of a network must contain. Networks of another version are thus found at start-up.
#[derive(Debug)]
pub struct Signature {
    /// File name without its extension, which is the engine's own.
    pub name: &'static str,
    /// Shape of the only input: rows, columns, channels.
    pub input: [usize; 3],
    /// Names and shapes of the outputs. A shape of three numbers is that of a map: rows, columns, channels.
    pub outputs: &'static [(&'static str, &'static [usize])],
}

/// Loads networks.
pub trait Engine: Send + Sync {
    /// The name that operators and tests see.
    fn name(&self) -> String;

    /// Loads the network that `signature` describes and takes all memory that its runs need.
    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError>;
}

/// A network that is ready to run.
pub trait Network: Send {
    /// Returns one row of the input. The slice is empty if there is no such row.
    fn input_row(&mut self, row: usize) -> &mut [f32];

    /// Computes the outputs from the input. After a failure, the outputs are unspecified.
    fn run(&mut self) -> Result<(), InferError>;

    /// Returns the values of output `index` of the signature. The slice is empty if there is no such output.
    fn output(&self, index: usize) -> &[f32];
}

/// The folder that holds the networks and the libraries of the engines. `scripts/setup` or a package fills it.
#[derive(Debug, Clone)]
pub struct NetworkFolder(PathBuf);

impl NetworkFolder {
    /// Returns the folder that `setting` names, else the one that `$FACEWIRE_NETWORKS` names, else the first that exists of
    /// `facewire/networks` in the user's cache and the folder of an installed package.
    pub fn find(setting: impl AsRef<Path>) -> Result<Self, InferError> {
        let user = || {
            let home = || env::var_os("HOME").map(|home| Path::new(&home).join(".cache"));
            let cache = env::var_os("XDG_CACHE_HOME").map(PathBuf::from).or_else(home);
            cache.map(|cache| cache.join("facewire/networks"))
        };
        let tried: Vec<PathBuf> = match (setting.as_ref(), env::var_os(VARIABLE)) {
            (setting, _) if !setting.as_os_str().is_empty() => vec![setting.into()],
            (_, Some(named)) => vec![named.into()],
            (_, None) => user().into_iter().chain([INSTALLED.into()]).collect(),
        };
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

/// Returns the engine whose networks are in `folder` ([`NetworkFolder::find`]) and run on this many threads.
pub fn engine(choice: EngineChoice, folder: impl AsRef<Path>, threads: u32) -> Result<Box<dyn Engine>, InferError> {
    let folder = NetworkFolder::find(folder)?;
    match choice {
        EngineChoice::Auto | EngineChoice::Native => {
            Ok(Box::new(Native { folder, kernels: kernels::fastest(), team: team(threads)? }))
        }
        EngineChoice::OnnxRuntime => onnx_runtime(folder, threads as usize).ok_or_else(|| {
            let remedy = "set networks.engine = \"native\", or build it with the feature `ort`";
            InferError(format!("this facewire was built without ONNX Runtime: {remedy}"))
        }),
    }
}

/// Loads a network that the program contains. It runs on the native engine and on the caller's thread, whatever the choice.
pub(crate) fn built_in(content: &[u8]) -> Result<Box<dyn Network>, InferError> {
    let damaged = |error| InferError(format!("a network that the program contains is damaged ({error})"));
    let graph = file::read(content).map_err(damaged)?;
    let mut network = facewire_engine::Network::with_team(&graph, kernels::fastest(), team(1)?).map_err(damaged)?;
    network.run();
    Ok(Box::new(network))
}

/// Returns every engine of this build, the native one for each instruction set of this machine, the preferred one first.
pub fn engines(folder: &str, threads: u32) -> Result<Vec<Box<dyn Engine>>, InferError> {
    let folder = NetworkFolder::find(folder)?;
    let team = team(threads)?;
    let native = |kernels| Native { folder: folder.clone(), kernels, team: Arc::clone(&team) };
    let all = kernels::available().into_iter().map(|kernels| Box::new(native(kernels)) as Box<dyn Engine>);
    Ok(all.chain(onnx_runtime(folder.clone(), threads as usize)).collect())
}

/// Loads the network `name` on the native engine with these kernels and one thread, so that its layers can be measured.
pub fn native_network(
    folder: &str,
    kernels: &'static Kernels,
    name: &str,
) -> Result<facewire_engine::Network, InferError> {
    Native { folder: NetworkFolder::find(folder)?, kernels, team: team(1)? }.network(name, |_| Ok(()))
}

fn team(threads: u32) -> Result<Arc<Team>, InferError> {
    Team::new(threads as usize).map(Arc::new).map_err(|error| {
        InferError(format!(
            "the system refused a thread for the networks ({error}); raise the limit of threads (systemd: TasksMax), or \
             lower networks.threads"
        ))
    })
}

#[cfg(feature = "ort")]
#[expect(clippy::unnecessary_wraps, reason = "not every build contains the engine")]
fn onnx_runtime(folder: NetworkFolder, threads: usize) -> Option<Box<dyn Engine>> {
    Some(Box::new(onnx_runtime::OnnxRuntime { folder, threads }))
}

#[cfg(not(feature = "ort"))]
fn onnx_runtime(_: NetworkFolder, _: usize) -> Option<Box<dyn Engine>> {
    None
}

/// facewire's own engine with the networks of one folder. Its arithmetic is in the crate [`facewire_engine`].
struct Native {
    folder: NetworkFolder,
    kernels: &'static Kernels,
    team: Arc<Team>,
}

impl Native {
    /// Prepares the network `name`. If `check` returns an error for its graph, the file counts as damaged.
    fn network(
        &self,
        name: &str,
        check: impl FnOnce(&Graph) -> Result<(), String>,
    ) -> Result<facewire_engine::Network, InferError> {
        let path = self.folder.file(&format!("{name}.{EXTENSION}"))?;
        let content = file::load(&path).map_err(|error| InferError::unreadable(&path, &error))?;
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
        let mut network = self.network(signature.name, |graph| check(graph, signature))?;
        // The first run touches all memory, so that no later run causes a page fault.
        network.run();
        Ok(Box::new(network))
    }
}

impl Network for facewire_engine::Network {
    fn input_row(&mut self, row: usize) -> &mut [f32] {
        if row < self.input_rows() { self.input_row(row) } else { &mut [] }
    }

    fn run(&mut self) -> Result<(), InferError> {
        self.run();
        Ok(())
    }

    fn output(&self, index: usize) -> &[f32] {
        if index < self.outputs() { self.output(index) } else { &[] }
    }
}

/// Checks that the network has the input and the outputs of the signature. The file describes an output that is a list as
/// a map, so only the number of its values is compared.
fn check(graph: &Graph, signature: &Signature) -> Result<(), String> {
    let shape = |tensor: usize| {
        graph.tensors().get(tensor).map_or([0; 3], |shape| [shape.rows, shape.columns, shape.channels]).to_vec()
    };
    let found = shape(graph.input().tensor);
    if found != signature.input {
        return Err(format!("the input has shape {found:?} in place of {:?}", signature.input));
    }
    let found = graph.outputs().len();
    let expected = signature.outputs.len();
    if found != expected {
        return Err(format!("{found} outputs in place of {expected}"));
    }
    for (output, &(name, expected)) in graph.outputs().iter().zip(signature.outputs) {
        let found = shape(output.tensor);
        let has_as_many = expected.len() < 3 && found.iter().product::<usize>() == expected.iter().product::<usize>();
        if output.name != name || !(found == expected || has_as_many) {
            return Err(format!("{} has shape {found:?} in place of {name} with {expected:?}", output.name));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_named_by_the_setting_is_the_only_one_tried() {
        let error = NetworkFolder::find("/nonexistent/networks").expect_err("no such folder").to_string();
        assert!(error.contains("/nonexistent/networks") && !error.contains(INSTALLED), "{error}");
    }

    #[test]
    fn the_team_of_an_engine_has_as_many_threads_as_were_asked_for() {
        assert_eq!([1, 3].map(|threads| team(threads).unwrap().workers().len()), [0, 2], "one is the caller's");
    }
}
