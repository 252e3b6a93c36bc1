//! `facewire-fit tune`: finds parameters from clips with truth.

mod correction;
mod search;

use anyhow::Result;
use clap::Subcommand;

/// What to find.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Find the corrective terms (eq. 7) of every blendshape, and write the model with them
    Correction(correction::Options),
}

/// Runs the command.
pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Correction(options) => correction::run(options),
    }
}
