//! Runs a network on inputs from a file of little-endian `f32` and writes its outputs to another, for comparison with
//! other engines. Usage: run NETWORK INPUT OUTPUT [KERNELS]

use std::error::Error;
use std::{env, fs};

use facewire_engine::{file, reference};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [network, input, output, ..] = arguments.as_slice() else {
        return Err("usage: run NETWORK INPUT OUTPUT [KERNELS]".into());
    };
    let graph = file::read(&fs::read(network)?)?;
    let input: Vec<f32> = fs::read(input)?.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let elements = graph.tensors()[graph.input().tensor].elements();
    let mut all = Vec::new();
    for input in input.chunks_exact(elements) {
        for values in reference::run(&graph, input) {
            all.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
    }
    fs::write(output, all)?;
    Ok(())
}
