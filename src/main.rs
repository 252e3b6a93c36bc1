//! The `facewire` command. Everything it does is in the library.

use std::process::ExitCode;

use clap::Parser;
use facewire::cli::Cli;

fn main() -> ExitCode {
    Cli::parse().run()
}
