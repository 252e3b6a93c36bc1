//! `facewire-fit tune`: finds parameters from clips with truth.

mod correction;
mod measure;
mod smoothing;

use anyhow::Result;
use clap::Subcommand;

/// What to find.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Find the corrective terms (eq. 7) of every blendshape, and write the model with them
    Correction(correction::Options),
    /// Try every filter with many times on each part of the face, and plot the delay against the jitter of a face at rest
    Smoothing(smoothing::Options),
}

pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Correction(options) => correction::run(options),
        Command::Smoothing(options) => smoothing::run(options),
    }
}
