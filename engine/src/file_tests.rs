//! Damaged and hostile files: each is refused, or describes a network that runs.

use crate::graph::{Graph, Kind, Port};
use crate::network_tests::random_network;
use crate::testing::Random;
use crate::{Error, Network, Values, file, kernels};

/// The file of a network, with single precision weights.
fn write(graph: &Graph) -> Vec<u8> {
    let mut bytes = b"fwnet\0\0\0".to_vec();
    bytes.extend(2_u32.to_le_bytes());
    bytes.extend([0; 4]);
    let number = |bytes: &mut Vec<u8>, number: usize| bytes.extend(u16::try_from(number).unwrap().to_le_bytes());
    for count in [graph.tensors().len(), graph.operators().len(), graph.outputs().len()] {
        number(&mut bytes, count);
    }
    for shape in graph.tensors() {
        for side in [shape.rows, shape.columns, shape.channels] {
            number(&mut bytes, side);
        }
    }
    for Port { name, tensor } in [graph.input()].into_iter().chain(graph.outputs()) {
        number(&mut bytes, *tensor);
        bytes.push(u8::try_from(name.len()).unwrap());
        bytes.extend(name.as_bytes());
    }
    for operator in graph.operators() {
        let (kind, window, arrays): (u8, _, Vec<&Values>) = match &operator.kind {
            Kind::Convolution { window, weights, bias } => (0, Some(window), vec![weights, bias]),
            Kind::Depthwise { window, weights, bias } => (1, Some(window), vec![weights, bias]),
            Kind::Prelu { slopes } => (2, None, vec![slopes]),
            Kind::Relu => (3, None, vec![]),
            Kind::Add => (4, None, vec![]),
            Kind::MaxPool { window } => (5, Some(window), vec![]),
            Kind::PadChannels => (6, None, vec![]),
            Kind::Concatenation => (7, None, vec![]),
        };
        let window = window.map_or([1, 1, 0, 0], |window| [window.size, window.stride, window.top, window.left]);
        bytes.push(kind);
        bytes.extend(window.map(|side| u8::try_from(side).unwrap()));
        bytes.push(u8::try_from(operator.inputs.len()).unwrap());
        operator.inputs.iter().for_each(|input| number(&mut bytes, *input));
        number(&mut bytes, operator.output);
        for array in arrays {
            bytes.push(2);
            bytes.extend(array.iter().flat_map(f32::to_le_bytes));
        }
    }
    seal(&mut bytes);
    bytes
}

/// Writes the checksum that belongs to the content.
fn seal(content: &mut [u8]) {
    let checksum = file::checksum(&content[16..]);
    content[12..16].copy_from_slice(&checksum.to_le_bytes());
}

#[test]
fn a_network_reads_back_as_it_was_written() {
    for seed in 0..20 {
        let graph = random_network(seed);
        assert_eq!(file::read(&write(&graph)).expect("the file is sound"), graph);
    }
}

#[test]
fn a_file_that_is_cut_short_or_goes_on_is_refused_even_with_the_right_checksum() {
    let mut content = write(&random_network(3));
    let step = 1 + content.len() / 300;
    for length in (0..content.len()).step_by(step).chain(content.len() - 8..content.len()) {
        let mut cut = content[..length].to_vec();
        assert!(matches!(file::read(&cut), Err(Error::Damaged(_))), "{length} bytes");
        if length >= 16 {
            seal(&mut cut);
            assert!(matches!(file::read(&cut), Err(Error::Damaged(_))), "{length} bytes with the right checksum");
        }
    }
    content.push(0);
    assert!(file::read(&content).is_err());
    seal(&mut content);
    assert_eq!(file::read(&content), Err(Error::Damaged("bytes follow the last operator")));
}

#[test]
fn a_file_with_a_changed_bit_is_refused() {
    let content = write(&random_network(3));
    let step = 1 + content.len() / 300;
    for at in (0..16).chain((16..content.len()).step_by(step)) {
        for bit in 0..8 {
            let mut changed = content.clone();
            changed[at] ^= 1 << bit;
            assert!(file::read(&changed).is_err(), "bit {bit} of byte {at}");
        }
    }
}

#[test]
fn a_file_with_changed_bytes_and_the_right_checksum_is_refused_or_runs() {
    let mut runs = 0;
    for seed in 0..12 {
        let sound = write(&random_network(seed));
        let mut random = Random::new(seed);
        for round in 0..400 {
            let mut content = sound.clone();
            // Most of a file is weights; what hurts is in front of them.
            let reach = if round % 2 == 0 { content.len().min(400) } else { content.len() };
            for _ in 0..=random.below(3) {
                content[random.below(reach)] = [0, 1, 2, 3, 7, 16, 0x7f, 0xff][random.below(8)];
            }
            seal(&mut content);
            let Ok(graph) = file::read(&content) else { continue };
            for kernels in [kernels::available()[0], *kernels::available().last().unwrap()] {
                if let Ok(mut network) = Network::new(&graph, kernels) {
                    network.run();
                    runs += 1;
                }
            }
        }
    }
    assert!(runs > 100, "{runs} of the changed files ran: the changes are too coarse to reach the planner");
}
