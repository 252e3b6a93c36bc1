//! `facewire run`: the service.

use std::sync::Arc;

use clap::Args;
use tracing::level_filters::LevelFilter;
use tracing_subscriber::fmt::time::uptime;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;
use tracing_subscriber::{Registry, reload};

use super::{Failure, SettingsArgs};
use crate::config::{Faults, LogLevel, Settings};
use crate::service::{self, Program};

const EXAMPLES: &str = "\
Examples:
  facewire run                              the first camera, packets to 127.0.0.1:5252
  facewire run --config facewire.toml
  facewire run --board pi4 --config facewire.toml

Without a camera it runs on, sends the neutral face with the reason, and takes the camera when it comes.

Signals:
  TERM, INT  stop, with the neutral face as the last word; the second one ends at once
  HUP        read the settings again; bad ones are refused and the old ones stay
  USR1       write the status line now";

/// Arguments of `facewire run`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct RunArgs {
    #[command(flatten)]
    settings: SettingsArgs,
}

pub(super) fn run(args: &RunArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    let level = start_log(settings.log.level);
    let program = RunCommand { settings: args.settings.clone(), level };
    let status = service::run(settings, Arc::new(program))?;
    tracing::info!("stopped: {status}");
    Ok(())
}

/// This program as the service sees it: its arguments name the settings, and it owns the log.
struct RunCommand {
    settings: SettingsArgs,
    level: reload::Handle<LevelFilter, Registry>,
}

impl Program for RunCommand {
    fn load(&self) -> Result<Settings, Faults> {
        self.settings.load()
    }

    /// It fails only when there is no log any more.
    fn set_log_level(&self, level: LogLevel) {
        let _ = self.level.reload(filter(level));
    }
}

/// The log goes to standard error; the journal adds its own times.
fn start_log(level: LogLevel) -> reload::Handle<LevelFilter, Registry> {
    let (filter, handle) = reload::Layer::new(filter(level));
    let lines = tracing_subscriber::fmt::layer().with_target(false).with_writer(std::io::stderr);
    // That nobody reads standard error any more would be told on standard error, by a panic.
    let lines = lines.log_internal_errors(false);
    let registry = tracing_subscriber::registry().with(filter);
    let to_journal = std::env::var_os("JOURNAL_STREAM").is_some();
    if to_journal {
        registry.with(lines.without_time().with_ansi(false)).init();
    } else {
        let is_terminal = std::io::IsTerminal::is_terminal(&std::io::stderr());
        registry.with(lines.with_timer(uptime()).with_ansi(is_terminal)).init();
    }
    handle
}

fn filter(level: LogLevel) -> LevelFilter {
    match level {
        LogLevel::Error => LevelFilter::ERROR,
        LogLevel::Warn => LevelFilter::WARN,
        LogLevel::Info => LevelFilter::INFO,
        LogLevel::Debug => LevelFilter::DEBUG,
        LogLevel::Trace => LevelFilter::TRACE,
    }
}
