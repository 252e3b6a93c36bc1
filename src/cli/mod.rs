//! The subcommands of `facewire`: arguments, exit status, and what is printed.

mod bench;
mod check;
mod devices;
mod failure;
mod log;
mod monitor;
mod run;
mod track;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use self::failure::Failure;
use crate::config::{self, Faults, Settings};

const EXAMPLES: &str = "\
Examples:
  facewire devices                          what cameras and serial ports there are
  facewire defaults > facewire.toml         a configuration to edit
  facewire check --config facewire.toml     says what works and what does not
  facewire run --config facewire.toml       the service, until Ctrl-C
  facewire monitor                          see the packets arrive (in another terminal)
  facewire track demo --out demo.csv        the coefficients of a clip";

/// At the end of every help.
const EXIT_STATUS: &str = "\
Exit status:
   0  done                         68  a host does not resolve
   1  failed                       69  networks, ONNX Runtime or a serial port missing
   2  wrong arguments              74  reading or writing failed
  65  damaged input                78  bad settings
  66  no such input, or trouble   130  run: ended by a second signal
      with the camera";

const DEVICES_EXAMPLE: &str = "\
Example:
  facewire devices                          a stable path is the one to write into the settings";

const DEFAULTS_EXAMPLE: &str = "\
Example:
  facewire defaults > facewire.toml         take the \"# \" off the lines to change";

/// A webcam becomes the 52 ARKit blendshape coefficients and the head pose, sent as packets.
#[derive(Debug, Parser)]
#[command(name = "facewire", version, after_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The service: camera to links, until SIGTERM or Ctrl-C.
    Run(run::RunArgs),
    /// The same pipeline over a file: one CSV row for every frame.
    Track(track::TrackArgs),
    /// Time every stage over a clip: latency, CPU, memory.
    Bench(bench::BenchArgs),
    /// Validate settings, then try camera, networks, model and links.
    Check(check::CheckArgs),
    /// List cameras with their formats and stable paths, and serial ports.
    #[command(after_help = DEVICES_EXAMPLE)]
    Devices,
    /// Print every setting with its default, commented out.
    #[command(after_help = DEFAULTS_EXAMPLE)]
    Defaults,
    /// Receive packets and show them live.
    Monitor(monitor::MonitorArgs),
}

/// Where settings come from.
#[derive(Debug, Clone, Args)]
struct SettingsArgs {
    /// Configuration file; without it the defaults hold.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Settings for a board, under those of the file and in place of the file's `board`; a wrong name lists them all.
    #[arg(long, value_name = "NAME")]
    board: Option<String>,
}

impl SettingsArgs {
    fn load(&self) -> Result<Settings, Faults> {
        config::load(self.board.as_deref(), self.config.as_deref())
    }
}

impl Cli {
    /// The arguments of this program. Wrong ones, and those that ask for help, end the process.
    #[must_use]
    pub fn of_arguments() -> Self {
        let command = with_exit_status(Self::command()).mut_subcommands(with_exit_status);
        Self::from_arg_matches(&command.get_matches()).unwrap_or_else(|error| error.exit())
    }

    /// Runs the subcommand and says how it ended, on standard error and as exit status.
    #[must_use]
    pub fn run(self) -> ExitCode {
        let outcome = match self.command {
            Command::Run(args) => run::run(&args),
            Command::Track(args) => track::run(&args),
            Command::Bench(args) => bench::run(&args),
            Command::Check(args) => check::run(&args),
            Command::Devices => devices::run(),
            Command::Defaults => failure::print(&config::defaults()),
            Command::Monitor(args) => monitor::run(&args).map_err(Failure::from),
        };
        match outcome {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => failure.report(),
        }
    }
}

/// The command with the exit statuses at the end of its help.
fn with_exit_status(command: clap::Command) -> clap::Command {
    let examples = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    command.after_help(format!("{examples}\n\n{EXIT_STATUS}"))
}
