//! The `facewire` command. Everything it does is in the library.

use std::process::ExitCode;

use facewire::cli::Cli;

fn main() -> ExitCode {
    Cli::of_arguments().run()
}
