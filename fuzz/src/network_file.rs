//! Checks the reader of network files.

use facewire_engine::{Error, Graph, Network, file, kernels};

/// Networks with more values in their tensors are not run. Smaller ones can have every kind of layer, and run within a
/// millisecond.
const MOST_VALUES: usize = 1 << 14;

/// Checks that any file is refused or describes a network. A small network is refused with an error of one line, or gives
/// the same bits in every run. `data` is the part of a file that follows the checksum, because the fuzzer would hardly ever
/// guess a correct checksum.
pub fn network_file(data: &[u8]) {
    assert!(file::read(data).is_err(), "a file without the first bytes of a network");
    let content = [&b"fwnet\0\0\0\x02\0\0\0"[..], &file::checksum(data).to_le_bytes(), data].concat();
    match file::read(&content) {
        Ok(graph) => run_twice(&graph),
        Err(error) => judge(error),
    }
}

fn run_twice(graph: &Graph) {
    let values: usize = graph.tensors().iter().map(|shape| shape.elements()).sum();
    if values > MOST_VALUES {
        return;
    }
    for kernels in kernels::available() {
        let mut network = match Network::new(graph, kernels) {
            Ok(network) => network,
            Err(error) => return judge(error),
        };
        for row in 0..network.input_rows() {
            network.input_row(row).iter_mut().zip(row..).for_each(|(value, at)| *value = (at % 7) as f32 - 3.0);
        }
        network.run();
        let bits = |network: &Network, output| network.output(output).iter().map(|value| value.to_bits()).collect();
        let first: Vec<Vec<u32>> = (0..network.outputs()).map(|output| bits(&network, output)).collect();
        network.run();
        let second: Vec<Vec<u32>> = (0..network.outputs()).map(|output| bits(&network, output)).collect();
        assert_eq!(first, second, "{}", kernels.name);
    }
}

/// Checks that an error fills one line.
fn judge(error: Error) {
    let text = error.to_string();
    assert!(!text.is_empty() && !text.contains(char::is_control), "{text:?}");
}
