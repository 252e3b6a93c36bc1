//! Runs networks a number of times, to count instructions under emulation: run it twice with different numbers and
//! subtract. Usage: frames FOLDER KERNELS TIMES NETWORK...

use std::error::Error;
use std::path::Path;
use std::{env, fs};

use facewire_engine::{Network, file, kernels};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [folder, name, times, names @ ..] = arguments.as_slice() else {
        return Err("usage: frames FOLDER KERNELS TIMES NETWORK...".into());
    };
    let kernels = kernels::named(name).ok_or("no such kernels here")?;
    for name in names {
        let graph = file::read(&fs::read(Path::new(folder).join(format!("{name}.fwnet")))?)?;
        let mut network = Network::new(&graph, kernels)?;
        (0..times.parse()?).for_each(|_: usize| network.run());
    }
    Ok(())
}
