//! The engine that runs ONNX networks on ONNX Runtime.
//!
//! Its threads sleep rather than spin while they wait for work, because facewire shares its board with other programs.
//! Output tensors are preallocated in the run options, so that a run allocates nothing on the Rust heap.

use std::fmt::Display;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::memory::Allocator;
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use ort::session::{HasSelectedOutputs, OutputSelector, RunOptions, Session};
use ort::value::{Outlet, Tensor};

use super::{Engine, InferError, Network, NetworkFolder, Signature, remedy};

const LIBRARY: &str = "libonnxruntime.so";
/// Runs of a network when it is loaded. ONNX Runtime plans its memory in the first run and allocates it in the second.
const WARM_UP_RUNS: usize = 2;
const GREY: f32 = 0.5;

pub(super) struct OnnxRuntime {
    pub(super) folder: NetworkFolder,
    pub(super) threads: usize,
}

impl Engine for OnnxRuntime {
    fn name(&self) -> String {
        "onnxruntime".to_owned()
    }

    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError> {
        let path = self.folder.file(&format!("{}.onnx", signature.name))?;
        let environment = environment(&self.folder.file(LIBRARY)?)?;
        let session = session(&environment, &path, self.threads).map_err(one_line);
        let network = session.and_then(|session| OnnxNetwork::new(session, signature));
        let mut network = network.map_err(|reason| InferError::damaged(&path, &reason))?;
        network.warm_up().map_err(|reason| InferError::run(signature.name, &reason))?;
        Ok(Box::new(network))
    }
}

struct OnnxNetwork {
    signature: &'static Signature,
    session: Session,
    options: RunOptions<HasSelectedOutputs>,
    /// The caller's values, in the order of [`Signature::input`].
    values: Vec<f32>,
    input: Tensor<f32>,
    /// The preallocated outputs of `options`, which every run overwrites.
    outputs: Vec<Tensor<f32>>,
    /// For each output that is a map, its values in the order of rows, columns and channels. Empty for other outputs.
    maps: Vec<Vec<f32>>,
}

impl OnnxNetwork {
    fn new(session: Session, signature: &'static Signature) -> Result<Self, String> {
        check(&session, signature)?;
        let options = preallocate(signature).map_err(one_line)?;
        let values = vec![GREY; signature.input.iter().product()];
        let input = Tensor::new(&Allocator::default(), onnx_shape(&signature.input)).map_err(one_line)?;
        let maps = signature.outputs.iter().map(|(_, shape)| vec![0.0; map_values(shape)]).collect();
        Ok(Self { signature, session, options, values, input, outputs: Vec::new(), maps })
    }

    /// Runs the network until ONNX Runtime has all memory that it needs, and keeps the outputs.
    fn warm_up(&mut self) -> Result<(), String> {
        self.write_input();
        for _ in 0..WARM_UP_RUNS {
            let inputs = ort::inputs![&self.input];
            let mut values = self.session.run_with_options(inputs, &self.options).map_err(one_line)?;
            let mut keep = |name: &str| {
                values.remove(name).ok_or_else(|| format!("no output {name}"))?.downcast().map_err(one_line)
            };
            self.outputs = self.signature.outputs.iter().map(|&(name, _)| keep(name)).collect::<Result<_, _>>()?;
        }
        Ok(())
    }

    /// Copies the caller's values into the input of the network, which stores one channel after the other.
    fn write_input(&mut self) {
        let [_, _, channels] = self.signature.input;
        let planes = self.input.extract_tensor_mut().1.chunks_exact_mut(self.values.len() / channels);
        for (channel, plane) in planes.enumerate() {
            let values = self.values.iter().skip(channel).step_by(channels);
            plane.iter_mut().zip(values).for_each(|(to, from)| *to = *from);
        }
    }

    /// Copies the outputs that are maps into `maps`. The network stores their channels one after the other.
    fn read_maps(&mut self) {
        for (output, map) in self.outputs.iter().zip(&mut self.maps) {
            let Some(&channels) = output.shape().get(1).filter(|_| !map.is_empty()) else { continue };
            let channels = usize::try_from(channels).unwrap_or(1);
            let pixels = map.len() / channels;
            for (channel, plane) in output.extract_tensor().1.chunks_exact(pixels).enumerate() {
                let values = map.iter_mut().skip(channel).step_by(channels);
                values.zip(plane).for_each(|(to, from)| *to = *from);
            }
        }
    }
}

impl Network for OnnxNetwork {
    fn input_row(&mut self, row: usize) -> &mut [f32] {
        let [_, columns, channels] = self.signature.input;
        self.values.chunks_exact_mut(columns * channels).nth(row).unwrap_or(&mut [])
    }

    fn run(&mut self) -> Result<(), InferError> {
        self.write_input();
        let outcome = self.session.run_with_options(ort::inputs![&self.input], &self.options).map(drop);
        outcome.map_err(|error| InferError::run(self.signature.name, &one_line(error)))?;
        self.read_maps();
        Ok(())
    }

    fn output(&self, index: usize) -> &[f32] {
        let map = self.maps.get(index).filter(|map| !map.is_empty());
        let list = || self.outputs.get(index).map_or(&[][..], |output| output.extract_tensor().1);
        map.map_or_else(list, Vec::as_slice)
    }
}

/// Returns the shape that a tensor of the signature has in an ONNX file: the number of pictures comes first, and the
/// channels of a map come before its rows and columns.
fn onnx_shape(shape: &[usize]) -> Vec<usize> {
    match *shape {
        [rows, columns, channels] => vec![1, channels, rows, columns],
        ref list => [&[1], list].concat(),
    }
}

fn map_values(shape: &[usize]) -> usize {
    if shape.len() == 3 { shape.iter().product() } else { 0 }
}

/// Returns the environment, of which a process can have only one. It belongs to the library that was loaded first.
fn environment(library: &Path) -> Result<Environment, InferError> {
    static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();
    if let Some(environment) = ENVIRONMENT.get() {
        return Ok(environment.clone());
    }
    check_library(library)?;
    let failed = |reason: String| cannot_load(library, &reason);
    let builder = ort::init_from(library).map_err(|error| failed(one_line(error)))?;
    let environment = builder.with_telemetry(false).build().map_err(|error| failed(one_line(error)))?;
    environment.set_log_level(LogLevel::Error);
    Ok(ENVIRONMENT.get_or_init(|| environment).clone())
}

fn cannot_load(library: &Path, reason: &str) -> InferError {
    let path = library.display();
    InferError(format!("ONNX Runtime cannot be loaded from {path}: {reason}; run {}", remedy(library)))
}

/// Refuses a library that is damaged, or that other users can change: they would run code as the user of this process.
fn check_library(library: &Path) -> Result<(), InferError> {
    let changeable = changeable_by_others(library).map_err(|error| cannot_load(library, &error.to_string()))?;
    if let Some(place) = changeable {
        let place = place.display();
        return Err(InferError(format!(
            "ONNX Runtime is not loaded from {}, because other users can change {place}: give it to root, and let nobody else \
             write to it (chown root {place} && chmod go-w {place})",
            library.display()
        )));
    }
    if !is_whole(library) {
        return Err(cannot_load(library, "the file is cut short or is not a library"));
    }
    Ok(())
}

/// Returns the first of a file and the folders around it that somebody else than root, the user of this process and its group
/// owns or may write to. In a folder with the sticky bit, such as /tmp, nobody can replace what belongs to another.
fn changeable_by_others(file: &Path) -> io::Result<Option<PathBuf>> {
    const WRITABLE_BY_GROUP: u32 = 0o020;
    const WRITABLE_BY_ALL: u32 = 0o002;
    const STICKY: u32 = 0o1000;
    let own = fs::metadata("/proc/self")?;
    for place in fs::canonicalize(file)?.ancestors() {
        let status = fs::metadata(place)?;
        let has_strange_owner = ![0, own.uid()].contains(&status.uid());
        let has_strange_group = ![0, own.gid()].contains(&status.gid());
        let writable = if has_strange_group { WRITABLE_BY_GROUP | WRITABLE_BY_ALL } else { WRITABLE_BY_ALL };
        let is_sticky = status.is_dir() && status.mode() & STICKY != 0;
        if has_strange_owner || (status.mode() & writable != 0 && !is_sticky) {
            return Ok(Some(place.to_owned()));
        }
    }
    Ok(None)
}

/// Returns whether the file is as long as its ELF header (64 bits, little-endian) says: up to the end of its section table.
/// The system's loader does not check the length, and a bus error would end the process.
fn is_whole(library: &Path) -> bool {
    let mut header = [0; 64];
    let Ok(mut file) = File::open(library) else { return false };
    if file.read_exact(&mut header).is_err() || !header.starts_with(b"\x7fELF\x02\x01") {
        return false;
    }
    let number =
        |at: usize, bytes: usize| header.iter().skip(at).take(bytes).rfold(0, |sum, byte| sum << 8 | u64::from(*byte));
    let start = number(40, 8);
    let entry_bytes = number(58, 2);
    let entries = number(60, 2);
    file.metadata().is_ok_and(|found| start.saturating_add(entry_bytes * entries) <= found.len())
}

fn session(environment: &Environment, path: &Path, threads: usize) -> ort::Result<Session> {
    SessionBuilder::new(environment)?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .with_intra_threads(threads)?
        .with_intra_op_spinning(false)?
        .with_flush_to_zero()?
        .commit_from_file(path)
}

fn preallocate(signature: &Signature) -> ort::Result<RunOptions<HasSelectedOutputs>> {
    let mut selector = OutputSelector::default();
    for &(name, shape) in signature.outputs {
        selector = selector.preallocate(name, Tensor::<f32>::new(&Allocator::default(), onnx_shape(shape))?);
    }
    Ok(RunOptions::new()?.with_outputs(selector))
}

fn check(session: &Session, signature: &Signature) -> Result<(), String> {
    let [input] = session.inputs() else {
        return Err(format!("{} inputs in place of 1", session.inputs().len()));
    };
    check_shape(input, &signature.input)?;
    for &(name, shape) in signature.outputs {
        let output = session.outputs().iter().find(|output| output.name() == name);
        check_shape(output.ok_or_else(|| format!("no output {name}"))?, shape)?;
    }
    Ok(())
}

fn check_shape(outlet: &Outlet, expected: &[usize]) -> Result<(), String> {
    let name = outlet.name();
    let shape = outlet.dtype().tensor_shape();
    let expected = onnx_shape(expected);
    let sizes = shape.map(|shape| shape.iter().map(|&size| usize::try_from(size).unwrap_or(0)));
    if sizes.is_some_and(|sizes| sizes.eq(expected.iter().copied())) {
        Ok(())
    } else {
        Err(format!("{name} has shape {shape:?} in place of {expected:?}"))
    }
}

/// Returns a message on one line, without control characters and cut to three lines of a terminal.
fn one_line(message: impl Display) -> String {
    let message = message.to_string();
    let words = message.split(|character: char| character.is_whitespace() || character.is_control());
    let line = words.filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ");
    line.chars().take(240).collect()
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::{PermissionsExt as _, symlink};

    use super::*;

    #[test]
    fn a_message_becomes_one_line_that_is_cut_at_a_character() {
        assert_eq!(one_line("\nno memory:\r\n\t 4 GB\x1b[31m\u{85}wanted \n"), "no memory: 4 GB [31m wanted");
        assert_eq!(one_line("ü".repeat(500)), "ü".repeat(240));
    }

    #[test]
    fn a_library_that_other_users_can_change_is_named() {
        let set = |path: &Path, mode| fs::set_permissions(path, Permissions::from_mode(mode)).unwrap();
        let top = tempfile::tempdir().unwrap();
        let folder = top.path().join("networks");
        fs::create_dir(&folder).unwrap();
        let library = folder.join(LIBRARY);
        fs::write(&library, "").unwrap();
        let link = top.path().join("link");
        symlink(&library, &link).unwrap();
        for (path, good, bad) in [(&library, 0o664, 0o646), (&folder, 0o775, 0o757), (&folder, 0o1777, 0o777)] {
            for named in [&library, &link] {
                set(path, good);
                assert_eq!(changeable_by_others(named).unwrap(), None);
                set(path, bad);
                let found = changeable_by_others(named).unwrap().unwrap();
                assert_eq!(found, fs::canonicalize(path).unwrap());
                set(path, good);
            }
        }
        if std::os::unix::fs::chown(&library, Some(12_345), None).is_ok() {
            assert_eq!(changeable_by_others(&link).unwrap(), Some(fs::canonicalize(&library).unwrap()));
        }
        set(&folder, 0o777);
        let error = check_library(&library).expect_err("a library that others can change").to_string();
        assert!(error.contains("other users can change") && error.contains("chmod go-w"), "{error}");
    }

    static LIPS: Signature = Signature { name: "lips", input: [16, 16, 32], outputs: &[("points", &[160])] };

    #[test]
    fn the_error_of_a_run_that_fails_contains_the_message_of_onnx_runtime() {
        let folder = NetworkFolder::find("").expect("installed networks");
        let [library, path] = [LIBRARY, "lips.onnx"].map(|name| folder.file(name).expect("an installed file"));
        let session = session(&environment(&library).expect("the library"), &path, 1).expect("a session");
        let mut network = OnnxNetwork::new(session, &LIPS).expect("the network of the signature");
        network.run().expect("a run");
        network.input = Tensor::new(&Allocator::default(), [1_usize, 32, 16, 15]).expect("a tensor of another shape");
        let error = network.run().expect_err("a wrong input").to_string();
        assert!(error.starts_with("network lips failed to run ("), "{error}");
        assert!(error.contains("Got invalid dimensions for input"), "{error}");
    }
}
