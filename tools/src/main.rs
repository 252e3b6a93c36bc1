//! The commands of `facewire` that the service does not need. `facewire NAME` starts them.

use std::process::ExitCode;

fn main() -> ExitCode {
    facewire_tools::run(std::env::args_os())
}
