//! The subcommands of `facewire`: their arguments, output and exit status.

mod calibrate;
mod check;
mod devices;
mod failure;
pub mod log;

use std::ffi::OsString;
use std::io::{self, IsTerminal as _};
use std::net::SocketAddr;
use std::os::unix::process::CommandExt as _;
use std::path::PathBuf;
use std::process::{self, ExitCode};
use std::sync::Arc;
use std::thread;

use clap::builder::PossibleValuesParser;
use clap::{Args, CommandFactory as _, FromArgMatches as _, Parser};

pub use self::failure::{Failure, STANDARD_OUTPUT, print, say};
use crate::config::{self, Faults, LinkKind, LinkSettings, Settings, UdpSettings};
use crate::link::{check_settings, release_servos};
use crate::service::{self, Kept};
use facewire_board::{self as board, Machine};
use facewire_packet::control::sockets;

const EXAMPLES: &str = "\
Examples:
  facewire devices                          list cameras and serial ports
  facewire defaults > facewire.toml         write a configuration to edit
  facewire check --config facewire.toml     report what works and what does not
  facewire run --config facewire.toml       run the service until Ctrl-C
  facewire calibrate --wearer anna          make a profile of the person in front of the camera
  facewire monitor                          show the packets as they arrive (in another terminal)
  facewire track demo --out demo.csv        write the coefficients of a clip";

const EXIT_STATUS: &str = "\
Exit status:
   0  success                      68  a host name does not resolve
   1  failure                      69  networks, a serial port or a servo board missing or
   2  invalid arguments                failing, or a camera that cannot be stopped
  65  damaged input                74  reading or writing failed
  66  no such input, or a fault    78  invalid settings
      of the camera               130  run: ended by a second signal";

const RUN_EXAMPLES: &str = "\
Examples:
  facewire run                              the first camera; packets to 127.0.0.1:5252 and to a microcontroller
  facewire run --config facewire.toml
  facewire run --board pi4 --config facewire.toml

Without a camera, the service sends the neutral face with the reason, and uses the camera as soon as it appears.

Signals:
  TERM, INT  stop after sending the neutral face; a second signal stops at once
  HUP        read the settings again; invalid settings are refused and the current ones stay
  USR1       write the status line now";

const DEFAULTS_EXAMPLE: &str = "\
Examples:
  facewire defaults > facewire.toml         remove the \"# \" from the lines you change
  facewire defaults --link serial           the settings of one kind of link";

/// Turns a webcam into 52 ARKit blendshape coefficients and a head pose, sent as packets.
#[derive(Debug, Parser)]
#[command(name = "facewire", version, after_help = EXAMPLES)]
enum Command {
    /// Run the service: camera to links, until SIGTERM or Ctrl-C.
    #[command(after_help = RUN_EXAMPLES)]
    Run(SettingsArgs),
    /// Guide the wearer through some poses, and learn the wearer's face from them.
    Calibrate(calibrate::CalibrateArgs),
    /// Validate the settings, then try camera, networks, model and links.
    #[command(after_help = check::EXAMPLES)]
    Check {
        #[command(flatten)]
        settings: SettingsArgs,
        /// Only validate the settings, and touch no device
        #[arg(long)]
        settings_only: bool,
    },
    /// Switch off bus servos and the servos of a PCA9685, which stay on when the service is killed
    #[command(after_help = "Example:\n  facewire rest --config facewire.toml      run it while the service is stopped")]
    Rest(SettingsArgs),
    /// List cameras with their formats and stable paths, and serial ports.
    #[command(after_help = "Example:\n  facewire devices                          use a stable path in the settings")]
    Devices {
        /// Print the same, and the I2C buses, as JSON
        #[arg(long)]
        json: bool,
        /// Search for bus servos at this serial port, for half a minute, without moving any
        #[arg(long, value_name = "DEVICE", conflicts_with = "json")]
        scan: Option<PathBuf>,
    },
    /// Print every setting with its default, commented out.
    #[command(after_help = DEFAULTS_EXAMPLE)]
    Defaults {
        /// Print only a link of this kind, with all its settings
        #[arg(long, value_name = "KIND", value_parser = PossibleValuesParser::new(config::LinkKind::NAMES))]
        link: Option<String>,
        /// Print the types, bounds, choices, defaults and comments of all settings as JSON Schema
        #[arg(long, conflicts_with = "link")]
        schema: bool,
    },
}

/// The commands of the program `facewire-tools`, which stands beside this one, and what they do.
pub const TOOLS: [(&str, &str); 6] = [
    ("track", "Run the same pipeline on a file, with one CSV row per frame"),
    ("record", "Record the landmarks and the outputs of every frame"),
    ("replay", "Send a recording again, with its original timing"),
    ("bench", "Measure latency, CPU and memory of every stage on a clip"),
    ("servo", "Move one channel of a servo board by keys, to find its ends"),
    ("monitor", "Receive packets and show them live"),
];

#[derive(Debug, Clone, Args)]
pub struct SettingsArgs {
    /// Configuration file [default: built-in settings]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Board whose settings replace the defaults; overrides `board` in the file. An unknown name lists all boards
    #[arg(long, value_name = "NAME")]
    board: Option<String>,
}

impl SettingsArgs {
    pub fn load(&self) -> Result<Settings, Faults> {
        let detected = Machine::detect(&board::root()).name;
        let check = |settings: &Settings, faults: &mut Faults| check_settings(settings, &sockets(), faults);
        config::load(self.board.as_deref(), detected, self.config.as_deref(), check)
    }

    /// The links in the last settings of this file with which a service has run.
    fn last_good_links(&self) -> Vec<LinkSettings> {
        let Some(path) = &self.config else { return Vec::new() };
        let kept = Kept::new(path.to_str()).settings();
        let settings = kept.and_then(|text| config::parse("the last settings that were good", &text).ok());
        settings.map_or_else(Vec::new, |settings| settings.links)
    }
}

/// Runs the command that these arguments name, after the name of the program. Prints its failure on standard error, and
/// returns the exit status. Ends the process if the arguments are invalid or ask for help.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let asks_for_help = arguments.get(1).is_some_and(|first| first == "help");
    let name = arguments.get(1 + usize::from(asks_for_help));
    let tool = TOOLS.iter().find(|(tool, _)| name.is_some_and(|name| name == tool));
    let outcome = match tool {
        Some((tool, _)) => Err(start_tools(tool, arguments.get(1..).unwrap_or_default())),
        None => {
            Command::from_arg_matches(&command().get_matches_from(arguments)).unwrap_or_else(|error| error.exit()).run()
        }
    };
    outcome.map_or_else(|failure| failure.report(), |()| ExitCode::SUCCESS)
}

impl Command {
    fn run(self) -> Result<(), Failure> {
        match self {
            Self::Run(arguments) => {
                let settings = arguments.load()?;
                let level = log::start(settings.log.level);
                announce(&settings.links);
                // This fails only after the log has been dropped.
                let set_log_level = move |wanted| drop(level.reload(wanted));
                let config = arguments.config.as_ref().map(|path| path.display().to_string());
                let load_settings = Arc::new(move || arguments.load());
                let status = service::run(settings, config, load_settings, Box::new(set_log_level))?;
                tracing::info!("stopped: {status}");
                Ok(())
            }
            Self::Calibrate(args) => calibrate::run(&args),
            Self::Check { settings, settings_only } => check::run(&settings, settings_only),
            Self::Rest(arguments) => rest(&arguments),
            Self::Devices { scan: Some(device), .. } => devices::scan(&device),
            Self::Devices { json, .. } => devices::run(json),
            Self::Defaults { schema: true, .. } => print(&format!("{}\n", config::schema())),
            Self::Defaults { link, .. } => {
                let link = link.and_then(|kind| config::default_link(&kind));
                print(link.as_deref().unwrap_or(config::DEFAULTS))
            }
        }
    }
}

/// Says where the datagrams go, and how somebody who has started the service in a terminal can see them. Other links say that
/// they are open, and those to host names say which address that is.
fn announce(links: &[LinkSettings]) {
    let is_monitored = LinkKind::Udp(UdpSettings::default());
    for link in links {
        let Some(address) = link.kind.address() else { continue };
        if address.as_str().parse::<SocketAddr>().is_err() {
            continue;
        }
        let is_seen = link.kind == is_monitored && io::stderr().is_terminal();
        let hint = if is_seen { ", where `facewire monitor` shows them" } else { "" };
        tracing::info!("link {}: packets go to {address}{hint}", link.kind.name());
    }
}

/// Releases the servos of all links, and fails if a board does not acknowledge that. Nothing that it prints holds up a release.
/// The last settings of this file with which a service has run say where servos are, too: the present ones may have faults,
/// or be newer than the pulses.
fn rest(arguments: &SettingsArgs) -> Result<(), Failure> {
    let loaded = arguments.load();
    let links = loaded.as_ref().map_or_else(|_| Vec::new(), |settings| settings.links.clone());
    let mut former = arguments.last_good_links();
    former.retain(|former| !links.iter().any(|link| has_servos_of(link, former)));
    let mut released = String::new();
    let mut troubles = Vec::new();
    // If nobody takes the words, they hold up no release.
    let warn = |words: String| drop(thread::spawn(move || say(&words)));
    // One after the other, because both may lead to one port by different names or channels. Those that a service has used come
    // first: their servos may have power.
    for (link, outcome) in [former, links].iter().flat_map(|links| release_servos(links, warn)) {
        match outcome {
            Ok(()) => released += &format!("{link}: released\n"),
            Err(trouble) => troubles.push(trouble),
        }
    }
    let printed = print(&released);
    if let Err(faults) = loaded {
        troubles.iter().for_each(say);
        return Err(faults.into());
    }
    if troubles.is_empty() { printed } else { Err(Failure::unavailable(troubles.join("\n"))) }
}

/// Whether a link leads to the same board as a former one, and has all of its channels.
fn has_servos_of(link: &LinkSettings, former: &LinkSettings) -> bool {
    let [channels, former_channels] = [link, former].map(|link| link.kind.channels().map_or(&[][..], Vec::as_slice));
    let has = |number| channels.iter().any(|channel| channel.channel == number);
    link.kind.has_same_board(&former.kind) && former_channels.iter().all(|channel| has(channel.channel))
}

/// Replaces this process by `facewire-tools` with these arguments. Returns only if there is no such program.
fn start_tools(tool: &str, arguments: &[OsString]) -> Failure {
    // The path is that of the file itself, not of a link to it.
    let path = std::env::current_exe().unwrap_or_default().with_file_name("facewire-tools");
    let error = process::Command::new(&path).args(arguments).exec();
    Failure::unavailable(format!(
        "`facewire {tool}` needs the program {}, which does not start: {error}; install it beside `facewire`, or build \
         it: cargo build --release --workspace",
        path.display()
    ))
}

/// The definitions of all arguments. The commands of `facewire-tools` are listed by name.
pub fn command() -> clap::Command {
    let tools = TOOLS.map(|(name, about)| clap::Command::new(name).about(about));
    with_exit_status(Command::command()).mut_subcommands(with_exit_status).subcommands(tools)
}

pub fn with_exit_status(command: clap::Command) -> clap::Command {
    let examples = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    command.after_help(format!("{examples}\n\n{EXIT_STATUS}"))
}
