//! The commands of `facewire` that watch, measure and record, and which the service does not need: `facewire NAME` starts
//! the program `facewire-tools` beside itself, which takes the same arguments.

mod bench;
mod input;
mod monitor;
mod progress;
mod record;
mod replay;
mod servo;
mod track;

use std::{ffi::OsString, io, process::ExitCode, sync::Arc, sync::atomic::AtomicBool};

use clap::{CommandFactory as _, FromArgMatches as _, Parser};
use facewire::cli::{Failure, TOOLS, with_exit_status};

/// Track, record, replay, measure and monitor, and the ends of servos.
#[derive(Debug, Parser)]
#[command(name = "facewire", bin_name = "facewire", version)]
// `TOOLS` says what they do, because the service lists these commands in its help, too.
enum Command {
    Track(track::TrackArgs),
    Record(record::RecordArgs),
    Replay(replay::ReplayArgs),
    Bench(bench::BenchArgs),
    Servo(servo::ServoArgs),
    Monitor(monitor::MonitorArgs),
}

/// The definitions of all arguments, from which `examples/manual.rs` makes the manual pages and the shell completions.
pub fn command() -> clap::Command {
    let describe = |tools: clap::Command, (name, about)| tools.mut_subcommand(name, |tool| tool.about(about));
    TOOLS.into_iter().fold(with_exit_status(Command::command()).mut_subcommands(with_exit_status), describe)
}

/// Runs the command that these arguments name, after the name of the program. Prints its failure on standard error, and
/// returns the exit status. Ends the process if the arguments are invalid or ask for help.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let matches = command().get_matches_from(arguments);
    let outcome = match Command::from_arg_matches(&matches).unwrap_or_else(|error| error.exit()) {
        Command::Track(args) => track::run(&args),
        Command::Record(args) => record::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Servo(args) => servo::run(&args),
        Command::Monitor(args) => monitor::run(&args),
    };
    outcome.map_or_else(|failure| failure.report(), |()| ExitCode::SUCCESS)
}

/// Returns a flag that these signals set.
fn stopped_by(signals: &[i32]) -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::<AtomicBool>::default();
    for signal in signals {
        let registered = signal_hook::flag::register(*signal, Arc::clone(&stop));
        registered.map_err(|error| Failure::failed(format!("the system refused a signal handler: {error}")))?;
    }
    Ok(stop)
}

/// Restores the terminal when it is dropped. A terminal that has gone cannot be restored.
struct Restore(fn() -> io::Result<()>);

impl Drop for Restore {
    fn drop(&mut self) {
        let _ = (self.0)();
    }
}
