//! ONNX Runtime behind [`Network`].
//!
//! The library is loaded from a path, never downloaded. Each session runs without spinning threads, because facewire
//! shares its board with other work. Outputs are preallocated in the run options, which makes a run free of
//! allocations on the Rust side.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;
use std::sync::OnceLock;

use ort::environment::Environment;
use ort::logging::LogLevel;
use ort::memory::Allocator;
use ort::session::builder::{GraphOptimizationLevel, SessionBuilder};
use ort::session::{HasSelectedOutputs, OutputSelector, RunOptions, Session};
use ort::value::{Outlet, Tensor};

use super::{InferError, Network, Signature};

pub(super) struct OnnxRuntimeNetwork {
    signature: &'static Signature,
    session: Session,
    options: RunOptions<HasSelectedOutputs>,
    input: Tensor<f32>,
    outputs: Vec<Vec<f32>>,
}

impl OnnxRuntimeNetwork {
    pub(super) fn load(
        library: &Path,
        path: &Path,
        signature: &'static Signature,
        threads: usize,
    ) -> Result<Self, InferError> {
        let environment = environment(library)?;
        let damaged = |reason: String| InferError::Damaged { path: path.to_path_buf(), reason: one_line(&reason) };
        let session = session(&environment, path, threads).map_err(|error| damaged(error.to_string()))?;
        check(&session, signature).map_err(damaged)?;
        let options = preallocate(signature).map_err(|error| damaged(error.to_string()))?;
        let shape = signature.input;
        let input = Tensor::new(&Allocator::default(), shape).map_err(|error| damaged(error.to_string()))?;
        let outputs = signature.outputs.iter().map(|(_, shape)| vec![0.0; shape.iter().product()]).collect();
        Ok(Self { signature, session, options, input, outputs })
    }
}

impl Network for OnnxRuntimeNetwork {
    fn input(&mut self) -> &mut [f32] {
        self.input.extract_tensor_mut().1
    }

    fn run(&mut self) -> Result<(), InferError> {
        let failed = |_| InferError::Run(self.signature.name);
        let values = self.session.run_with_options(ort::inputs![&self.input], &self.options).map_err(failed)?;
        for (&(name, _), copy) in self.signature.outputs.iter().zip(&mut self.outputs) {
            let Some(value) = values.get(name) else { return Err(InferError::Run(self.signature.name)) };
            let (_, value) = value.try_extract_tensor::<f32>().map_err(failed)?;
            if value.len() != copy.len() {
                return Err(InferError::Run(self.signature.name));
            }
            copy.copy_from_slice(value);
        }
        Ok(())
    }

    fn output(&self, index: usize) -> &[f32] {
        self.outputs.get(index).map_or(&[], Vec::as_slice)
    }
}

/// The process has one environment; the first library loaded is the one used.
fn environment(library: &Path) -> Result<Environment, InferError> {
    static ENVIRONMENT: OnceLock<Environment> = OnceLock::new();
    if let Some(environment) = ENVIRONMENT.get() {
        return Ok(environment.clone());
    }
    let failed = |reason: String| InferError::Library { path: library.to_path_buf(), reason };
    if !is_whole(library) {
        return Err(failed("it is cut short or no library".to_owned()));
    }
    let builder = ort::init_from(library).map_err(|error| failed(error.to_string()))?;
    let environment = builder.with_telemetry(false).build().map_err(|error| failed(error.to_string()))?;
    environment.set_log_level(LogLevel::Error);
    Ok(ENVIRONMENT.get_or_init(|| environment).clone())
}

/// Whether the file reaches to the end of its section table, which comes last in a library (ELF-64, little-endian).
/// The loader of the system does not look, and the process would end by a bus error.
fn is_whole(library: &Path) -> bool {
    let mut header = [0; 64];
    let Ok(mut file) = File::open(library) else { return false };
    if file.read_exact(&mut header).is_err() || !header.starts_with(b"\x7fELF\x02\x01") {
        return false;
    }
    let number =
        |at: usize, bytes: usize| header.iter().skip(at).take(bytes).rfold(0, |sum, byte| sum << 8 | u64::from(*byte));
    let [start, entry_bytes, entries] = [number(40, 8), number(58, 2), number(60, 2)];
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

/// ONNX Runtime breaks some of its sentences.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn preallocate(signature: &Signature) -> ort::Result<RunOptions<HasSelectedOutputs>> {
    let mut selector = OutputSelector::default();
    for &(name, shape) in signature.outputs {
        selector = selector.preallocate(name, Tensor::<f32>::new(&Allocator::default(), shape)?);
    }
    Ok(RunOptions::new()?.with_outputs(selector))
}

fn check(session: &Session, signature: &Signature) -> Result<(), String> {
    let [input] = session.inputs() else { return Err(format!("{} inputs in place of 1", session.inputs().len())) };
    check_shape(input, &signature.input)?;
    for &(name, shape) in signature.outputs {
        let output = session.outputs().iter().find(|output| output.name() == name);
        check_shape(output.ok_or_else(|| format!("no output {name}"))?, shape)?;
    }
    Ok(())
}

fn check_shape(outlet: &Outlet, expected: &[usize]) -> Result<(), String> {
    let shape = outlet.dtype().tensor_shape().ok_or_else(|| format!("{} is no tensor", outlet.name()))?;
    if shape.iter().map(|&size| usize::try_from(size).unwrap_or(0)).eq(expected.iter().copied()) {
        Ok(())
    } else {
        Err(format!("{} has shape {shape:?} in place of {expected:?}", outlet.name()))
    }
}
