//! `facewire run`: the service.

use std::sync::Arc;

use clap::Args;

use super::log::{self, Level};
use super::{Failure, SettingsArgs};
use crate::config::{Faults, LogLevel, Settings};
use crate::service::{self, Program};

const EXAMPLES: &str = "\
Examples:
  facewire run                              the first camera; packets to 127.0.0.1:5252 and to a microcontroller
  facewire run --config facewire.toml
  facewire run --board pi4 --config facewire.toml

Without a camera, the service sends the neutral face with the reason, and uses the camera as soon as it appears.

Signals:
  TERM, INT  stop after sending the neutral face; a second signal stops at once
  HUP        read the settings again; invalid settings are refused and the current ones stay
  USR1       write the status line now";

/// Arguments of `facewire run`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct RunArgs {
    #[command(flatten)]
    settings: SettingsArgs,
}

pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    let level = log::start(settings.log.level);
    let program = RunCommand { settings: args.settings.clone(), level };
    let status = service::run(settings, Arc::new(program))?;
    tracing::info!("stopped: {status}");
    Ok(())
}

/// The program as the service sees it: loads the settings named by its arguments, and owns the log.
struct RunCommand {
    settings: SettingsArgs,
    level: Level,
}

impl Program for RunCommand {
    fn load(&self) -> Result<Settings, Faults> {
        self.settings.load()
    }

    fn set_log_level(&self, level: LogLevel) {
        self.level.set(level);
    }
}
