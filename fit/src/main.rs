//! The program `facewire-fit`.

use std::process::ExitCode;

fn main() -> ExitCode {
    facewire_fit::cli::main()
}
