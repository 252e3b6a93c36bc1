//! The subcommands of `facewire`: their arguments, output and exit status.

mod bench;
mod calibrate;
mod check;
mod devices;
mod failure;
mod log;
mod monitor;
mod record;
mod replay;
mod run;
mod servo;
mod track;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::builder::PossibleValuesParser;
use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

use self::failure::Failure;
use crate::config::{self, Faults, Settings};
use crate::hardware::{self, Board};

const EXAMPLES: &str = "\
Examples:
  facewire devices                          list cameras and serial ports
  facewire defaults > facewire.toml         write a configuration to edit
  facewire check --config facewire.toml     report what works and what does not
  facewire run --config facewire.toml       run the service until Ctrl-C
  facewire calibrate --wearer anna          make a profile of the person in front of the camera
  facewire monitor                          show the packets as they arrive (in another terminal)
  facewire track demo --out demo.csv        write the coefficients of a clip";

/// Printed at the end of every help text.
const EXIT_STATUS: &str = "\
Exit status:
   0  success                      68  a host name does not resolve
   1  failure                      69  networks, a serial port or a servo board missing or
   2  invalid arguments                failing, or a camera that cannot be stopped
  65  damaged input                74  reading or writing failed
  66  no such input, or a fault    78  invalid settings
      of the camera               130  run: ended by a second signal";

const DEVICES_EXAMPLE: &str = "\
Example:
  facewire devices                          use a stable path in the settings";

const DEFAULTS_EXAMPLE: &str = "\
Examples:
  facewire defaults > facewire.toml         remove the \"# \" from the lines you change
  facewire defaults --link serial           the settings of one kind of link";

/// Turns a webcam into 52 ARKit blendshape coefficients and a head pose, sent as packets.
#[derive(Debug, Parser)]
#[command(name = "facewire", version, after_help = EXAMPLES)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the service: camera to links, until SIGTERM or Ctrl-C.
    Run(run::RunArgs),
    /// Run the same pipeline on a file, with one CSV row per frame.
    Track(track::TrackArgs),
    /// Guide the wearer through some poses, and learn the wearer's face from them.
    Calibrate(calibrate::CalibrateArgs),
    /// Record the landmarks and the outputs of every frame.
    Record(record::RecordArgs),
    /// Send a recording again, with its original timing.
    Replay(replay::ReplayArgs),
    /// Measure latency, CPU and memory of every stage on a clip.
    Bench(bench::BenchArgs),
    /// Validate the settings, then try camera, networks, model and links.
    Check(check::CheckArgs),
    /// Move one channel of a servo board by keys, to find its ends.
    Servo(servo::ServoArgs),
    /// List cameras with their formats and stable paths, and serial ports.
    #[command(after_help = DEVICES_EXAMPLE)]
    Devices,
    /// Print every setting with its default, commented out.
    #[command(after_help = DEFAULTS_EXAMPLE)]
    Defaults {
        /// Print only a link of this kind, with all its settings
        #[arg(long, value_name = "KIND", value_parser = PossibleValuesParser::new(config::LinkKind::NAMES))]
        link: Option<String>,
    },
    /// Receive packets and show them live.
    Monitor(monitor::MonitorArgs),
}

/// The sources of the settings.
#[derive(Debug, Clone, Args)]
struct SettingsArgs {
    /// Configuration file [default: built-in settings]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Board whose settings replace the defaults; overrides `board` in the file. An unknown name lists all boards
    #[arg(long, value_name = "NAME")]
    board: Option<String>,
}

impl SettingsArgs {
    fn load(&self) -> Result<Settings, Faults> {
        let detected = Board::detect(&hardware::root()).name;
        config::load(self.board.as_deref(), detected, self.config.as_deref())
    }
}

impl Cli {
    /// Parses the arguments of this program. Ends the process if they are invalid or ask for help.
    #[must_use]
    pub fn of_arguments() -> Self {
        Self::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit())
    }

    /// Runs the subcommand, prints its failure on standard error, and returns the exit status.
    #[must_use]
    pub fn run(self) -> ExitCode {
        let outcome = match self.command {
            Command::Run(args) => run::run(&args),
            Command::Track(args) => track::run(&args),
            Command::Calibrate(args) => calibrate::run(&args),
            Command::Record(args) => record::run(&args),
            Command::Replay(args) => replay::run(&args),
            Command::Bench(args) => bench::run(&args),
            Command::Check(args) => check::run(&args),
            Command::Servo(args) => servo::run(&args),
            Command::Devices => devices::run(),
            Command::Defaults { link } => {
                failure::print(&link.and_then(|kind| config::default_link(&kind)).unwrap_or_else(config::defaults))
            }
            Command::Monitor(args) => monitor::run(&args).map_err(Failure::from),
        };
        match outcome {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => failure.report(),
        }
    }
}

/// The definitions of all arguments, from which `examples/manual.rs` makes the manual pages and the shell completions.
#[must_use]
pub fn command() -> clap::Command {
    with_exit_status(Cli::command()).mut_subcommands(with_exit_status)
}

/// Appends the exit statuses to the help of a command.
fn with_exit_status(command: clap::Command) -> clap::Command {
    let examples = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    command.after_help(format!("{examples}\n\n{EXIT_STATUS}"))
}
