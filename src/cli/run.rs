//! `facewire run`: the service.

use clap::Args;
use tracing::level_filters::LevelFilter;

use super::{Failure, SettingsArgs};
use crate::config::LogLevel;
use crate::service;

const EXAMPLES: &str = "\
Examples:
  facewire run                              the first camera, packets to 127.0.0.1:5252
  facewire run --config facewire.toml
  facewire run --board pi4 --config facewire.toml

Without a camera it runs on, sends the neutral face with the reason, and takes the camera when it comes.";

/// Arguments of `facewire run`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct RunArgs {
    #[command(flatten)]
    settings: SettingsArgs,
}

pub(super) fn run(args: &RunArgs) -> Result<(), Failure> {
    let settings = args.settings.load()?;
    start_log(settings.log.level);
    let status = service::run(&settings)?;
    tracing::info!("stopped: {status}");
    Ok(())
}

/// The log goes to standard error; the journal adds its own times.
fn start_log(level: LogLevel) {
    let level = match level {
        LogLevel::Error => LevelFilter::ERROR,
        LogLevel::Warn => LevelFilter::WARN,
        LogLevel::Info => LevelFilter::INFO,
        LogLevel::Debug => LevelFilter::DEBUG,
        LogLevel::Trace => LevelFilter::TRACE,
    };
    let log = tracing_subscriber::fmt().with_max_level(level).with_target(false).with_writer(std::io::stderr);
    // That nobody reads standard error any more would be told on standard error, by a panic.
    let log = log.log_internal_errors(false);
    let to_journal = std::env::var_os("JOURNAL_STREAM").is_some();
    if to_journal {
        log.without_time().with_ansi(false).init();
    } else {
        log.with_timer(tracing_subscriber::fmt::time::uptime())
            .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()))
            .init();
    }
}
