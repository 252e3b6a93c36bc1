//! Runs a network on inputs from a file of little-endian `f32` and writes its outputs to another, for comparison with
//! other engines. Kernels: `reference`, or the name of an instruction set; the fastest if none is given.
//! Usage: run KERNELS NETWORK INPUT OUTPUT

use std::error::Error;
use std::{env, fs};

use facewire_engine::{Network, file, kernels, reference};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [name, network, input, output] = arguments.as_slice() else {
        return Err("usage: run KERNELS NETWORK INPUT OUTPUT".into());
    };
    let graph = file::read(&fs::read(network)?)?;
    let input: Vec<f32> = fs::read(input)?.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let elements = graph.tensors()[graph.input().tensor].elements();
    let mut network = match kernels::named(name) {
        Some(kernels) => Some(Network::new(&graph, kernels)?),
        None if name == "reference" => None,
        None => return Err(format!("no kernels for {name} here").into()),
    };
    let mut all = Vec::new();
    for input in input.chunks_exact(elements) {
        let outputs = match &mut network {
            None => reference::run(&graph, input),
            Some(network) => {
                let rows = network.input_rows();
                for (row, values) in input.chunks_exact(elements / rows).enumerate() {
                    network.input_row(row).copy_from_slice(values);
                }
                network.run();
                (0..network.outputs()).map(|index| network.output(index).to_vec()).collect()
            }
        };
        for values in outputs {
            all.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
    }
    fs::write(output, all)?;
    Ok(())
}
