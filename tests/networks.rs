//! Compares the networks on every engine with the `TFLite` interpreter, which runs MediaPipe's own files.
//!
//! `scripts/setup onnxruntime` installs the interpreter. The test is skipped without it.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::path::Path;
use std::process::Command;

use common::program::Run;
use common::{project, python_with, skip};
use facewire_face::Engine;
use facewire_face::stages::Signature;

/// Largest difference, as a share of the largest value of an output: 0.003 px on the mesh. Libraries that add in
/// different orders differ by less than a tenth of it.
const TOLERANCE: f32 = 2e-5;
/// The same for kernels that compute in half precision, on ARM cores that have it. The landmarks of a face are nearer:
/// 0.013 px on average (`tests/golden.rs`).
const HALF_PRECISION_TOLERANCE: f32 = 3e-3;

const HEAD_INPUT: [usize; 3] = [16, 16, 32];
const EYE_OUTPUTS: &[(&str, &[usize])] = &[("points", &[142]), ("iris", &[10])];
static NETWORKS: [Signature; 5] = [
    Signature { name: "detector", input: [128, 128, 3], outputs: &[("boxes", &[896, 16]), ("scores", &[896, 1])] },
    Signature {
        name: "mesh",
        input: [192, 192, 3],
        outputs: &[("mesh", &[1404]), ("flag", &[1]), ("features", &[48, 48, 32])],
    },
    Signature { name: "lips", input: HEAD_INPUT, outputs: &[("points", &[160])] },
    Signature { name: "left_eye", input: HEAD_INPUT, outputs: EYE_OUTPUTS },
    Signature { name: "right_eye", input: HEAD_INPUT, outputs: EYE_OUTPUTS },
];

fn values(file: &Path) -> Vec<f32> {
    fs::read(file).unwrap().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

/// Returns the largest difference between the outputs of an engine and those of the interpreter in `folder`, as a share of
/// the largest value of an output.
fn difference(engine: &dyn Engine, signature: &'static Signature, folder: &Path) -> f32 {
    let mut network = engine.load(signature).unwrap_or_else(|error| panic!("{}: {error}", engine.name()));
    let [rows, columns, channels] = signature.input;
    let file = |part: &str| folder.join(format!("{}-{part}.f32", signature.name));
    let mut worst = 0.0_f32;
    for (case, input) in values(&file("input")).chunks_exact(rows * columns * channels).enumerate() {
        for (row, values) in input.chunks_exact(columns * channels).enumerate() {
            network.input_row(row).copy_from_slice(values);
        }
        network.run().unwrap();
        for (index, (name, shape)) in signature.outputs.iter().enumerate() {
            let count: usize = shape.iter().product();
            let expected = &values(&file(name))[case * count..][..count];
            let found = network.output(index);
            assert_eq!(found.len(), count, "{}: {name} of {}", engine.name(), signature.name);
            let range = expected.iter().fold(0.0_f32, |largest, value| largest.max(value.abs()));
            for (found, expected) in found.iter().zip(expected) {
                // Unlike `f32::max`, this keeps a difference that is not a number, so that the test fails.
                let difference = (found - expected).abs() / range;
                worst = if difference <= worst { worst } else { difference };
            }
        }
    }
    worst
}

#[test]
fn every_engine_computes_what_the_tflite_interpreter_computes() {
    let Some(python) = python_with("venv-onnx", "sys") else {
        return skip("no TFLite interpreter; run scripts/setup onnxruntime");
    };
    let folder = tempfile::tempdir().unwrap();
    let mut check = Command::new(python);
    check.arg(project("models/networks/check.py")).arg(folder.path()).env("PYTHONDONTWRITEBYTECODE", "1");
    Run::of(&mut check).succeeded();
    for engine in facewire_face::stages::engines("", 1).unwrap_or_else(|error| panic!("{error}")) {
        for signature in &NETWORKS {
            let difference = difference(&*engine, signature, folder.path());
            println!("{}: {} agrees to {difference:.1e} of its range", engine.name(), signature.name);
            let tolerance = if engine.name().contains("half") { HALF_PRECISION_TOLERANCE } else { TOLERANCE };
            assert!(difference <= tolerance, "{}: {} differs by {difference:.1e}", engine.name(), signature.name);
        }
    }
}
