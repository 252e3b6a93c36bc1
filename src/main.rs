//! The `facewire` command. Everything it does is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    facewire::cli::run(std::env::args_os())
}
