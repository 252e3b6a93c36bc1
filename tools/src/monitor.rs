//! `facewire monitor`: receives packets and shows them.
//!
//! Role: a receiver for trying out a sender. On a terminal it draws bars; otherwise it writes one line per second, or
//! with `--json` one object per packet.
//! Contract: the monitor only listens. It ends with a summary after Ctrl-C, SIGTERM, a closed output, or its limits.
//! Limits: a serial port that disappears ends the monitor. If several senders use one port, the newest packet is shown.

mod bars;
mod receiver;
mod report;
mod screen;
mod tally;

use std::{
    io::{self, IsTerminal as _, Write as _},
    net::SocketAddr,
    ops::RangeInclusive,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use facewire_packet::Packet;
use signal_hook::consts::{SIGINT, SIGTERM};

pub use self::report::yaw_pitch_roll_deg;
use self::{
    receiver::{Endpoint, Receiver},
    report::Json,
    screen::Screen,
    tally::Tally,
};
use facewire::cli::Failure;
use facewire::link::LinkError;

/// Time between two pictures. 30 pictures per second look smooth, and more would only load the board.
const SCREEN_PERIOD: Duration = Duration::from_millis(33);
/// The values of `--seconds`, up to a year.
const SECONDS: RangeInclusive<f64> = 0.001..=31_536_000.0;
/// Time between two lines.
const LINE_PERIOD: Duration = Duration::from_secs(1);

const EXAMPLES: &str = "\
Examples:
  facewire monitor
  facewire monitor --listen 0.0.0.0:6000 --seconds 10
  facewire monitor --serial /dev/ttyUSB0
  facewire monitor --json --packets 100 > packets.jsonl";

/// Receive packets by UDP, or from a serial port, and show them live
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct MonitorArgs {
    /// Address and port to listen to
    #[arg(long, value_name = "ADDRESS", default_value = "0.0.0.0:5252")]
    pub listen: SocketAddr,
    /// Serial port to read instead
    #[arg(long, value_name = "DEVICE", conflicts_with = "listen")]
    pub serial: Option<PathBuf>,
    /// Baud rate of the serial port
    #[arg(long, value_name = "N", default_value_t = 115_200, requires = "serial",
        value_parser = clap::value_parser!(u32).range(9600..=4_000_000))]
    pub baud: u32,
    /// Write each packet as one line of JSON
    #[arg(long)]
    pub json: bool,
    /// End after this number of valid packets
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub packets: Option<u64>,
    /// End after this number of seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub seconds: Option<Duration>,
}

/// Why the monitor fails.
#[derive(Debug, thiserror::Error)]
pub enum MonitorError {
    /// The port is in use, or the address does not belong to this machine.
    #[error("cannot listen to {listen} ({error}); end what uses the port, or give --listen another address")]
    Listen {
        /// The address to listen to.
        listen: SocketAddr,
        /// The error of the system.
        error: io::Error,
    },
    /// The serial port does not open, or has disappeared.
    #[error("cannot listen to {}", .0.message)]
    Port(#[from] LinkError),
    /// No valid packet came by UDP.
    #[error("no packet came to {listen}; check [[link]] address in the sender's configuration, and the firewall")]
    NoPacket {
        /// The address that the monitor listened to.
        listen: SocketAddr,
    },
    /// No valid packet came on the serial line.
    #[error("no packet came by {}; check the wires, and that both sides have the same baud rate", device.display())]
    NoFrame {
        /// The serial port.
        device: PathBuf,
    },
    /// The terminal or the output cannot be written to.
    #[error("cannot write the output ({0}); check where it goes")]
    Output(#[from] io::Error),
}

/// How packets are shown.
enum View {
    Screen(Box<Screen>),
    Lines,
    Json,
}

/// Receives packets and shows them until a signal or a limit ends it.
pub fn run(args: &MonitorArgs) -> Result<(), MonitorError> {
    let mut receiver = Receiver::open(args)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let mut tally = Tally::default();
    match watch(args, &mut receiver, &stop, &mut tally) {
        Err(MonitorError::Output(error)) if error.kind() == io::ErrorKind::BrokenPipe => {}
        watched => watched?,
    }
    if tally.packets.packets == 0 {
        return Err(match args.endpoint() {
            Endpoint::Udp(listen) => MonitorError::NoPacket { listen },
            Endpoint::Serial(device) => MonitorError::NoFrame { device },
        });
    }
    summarise(args, &tally)
}

/// Writes the summary: to standard error if standard output carries JSON.
fn summarise(args: &MonitorArgs, tally: &Tally) -> Result<(), MonitorError> {
    let line = tally.summary();
    let written = if args.json { writeln!(io::stderr(), "{line}") } else { writeln!(io::stdout(), "{line}") };
    match written {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// Shows packets until a signal or a limit ends it. The screen is restored on return.
fn watch(
    args: &MonitorArgs,
    receiver: &mut Receiver,
    stop: &AtomicBool,
    tally: &mut Tally,
) -> Result<(), MonitorError> {
    let listen = args.endpoint();
    let mut view = View::new(args)?;
    let begin = Instant::now();
    let end = args.seconds.map(|seconds| begin + seconds);
    let mut shown = begin;
    while !stop.load(Ordering::Relaxed)
        && args.packets.is_none_or(|packets| tally.packets.packets < packets)
        && end.is_none_or(|end| Instant::now() < end)
    {
        let left = end.map_or(SCREEN_PERIOD, |end| end.saturating_duration_since(Instant::now()));
        let packet = receive(receiver, left.min(SCREEN_PERIOD), tally)?;
        view.packet(packet.as_ref(), tally)?;
        if shown.elapsed() >= view.period() {
            shown = Instant::now();
            view.refresh(&listen, tally)?;
        }
    }
    Ok(())
}

/// Waits for a packet and counts it.
fn receive(receiver: &mut Receiver, wait: Duration, tally: &mut Tally) -> Result<Option<Packet>, MonitorError> {
    Ok(match receiver.next(wait)? {
        Some(Ok((packet, from))) => {
            tally.count(&packet, from, Instant::now());
            Some(packet)
        }
        Some(Err(fault)) => {
            tally.packets.refuse(fault);
            None
        }
        None => None,
    })
}

impl View {
    fn new(args: &MonitorArgs) -> io::Result<Self> {
        if args.json {
            Ok(Self::Json)
        } else if io::stdout().is_terminal() {
            Ok(Self::Screen(Box::new(Screen::enter()?)))
        } else {
            Ok(Self::Lines)
        }
    }

    /// Time between two refreshes.
    fn period(&self) -> Duration {
        match self {
            Self::Screen(_) | Self::Json => SCREEN_PERIOD,
            Self::Lines => LINE_PERIOD,
        }
    }

    /// Shows a packet if every packet is shown.
    fn packet(&self, packet: Option<&Packet>, tally: &Tally) -> io::Result<()> {
        let (Self::Json, Some(packet)) = (self, packet) else {
            return Ok(());
        };
        let mut line = serde_json::to_string(&Json::new(packet, tally))?;
        line.push('\n');
        io::stdout().write_all(line.as_bytes())
    }

    /// Shows the current state.
    fn refresh(&mut self, listen: &Endpoint, tally: &Tally) -> io::Result<()> {
        let now = Instant::now();
        match self {
            Self::Screen(screen) => screen.draw(listen, tally, now),
            Self::Lines => writeln!(io::stdout(), "{}", report::line(listen, tally, now)),
            Self::Json => Ok(()),
        }
    }
}

/// Reads the value of `--seconds`.
fn seconds(text: &str) -> Result<Duration, String> {
    let number = text.parse().unwrap_or(f64::NAN);
    if SECONDS.contains(&number) {
        Ok(Duration::from_secs_f64(number))
    } else {
        Err(format!("write a number from {} to {}", SECONDS.start(), SECONDS.end()))
    }
}

impl From<MonitorError> for Failure {
    fn from(error: MonitorError) -> Self {
        let message = error.to_string();
        match error {
            MonitorError::Listen { .. } | MonitorError::NoPacket { .. } | MonitorError::NoFrame { .. } => {
                Self::failed(message)
            }
            MonitorError::Port(_) => Self::unavailable(message),
            MonitorError::Output(_) => Self::unwritten(message),
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Arguments {
        #[command(flatten)]
        monitor: MonitorArgs,
    }

    fn parsed(arguments: &[&str]) -> Result<MonitorArgs, clap::Error> {
        Arguments::try_parse_from([&["monitor"], arguments].concat()).map(|arguments| arguments.monitor)
    }

    #[test]
    fn limits_and_baud_rates_that_make_no_sense_are_refused() {
        for wrong in ["0", "-1", "1e19", "1e308", "inf", "NaN", "1e-320", "31536001", "ten"] {
            assert!(parsed(&[&format!("--seconds={wrong}")]).is_err(), "--seconds {wrong}");
        }
        for wrong in ["0", "-1", "300", "4000001", "4294967296"] {
            assert!(parsed(&["--serial", "/dev/ttyUSB0", &format!("--baud={wrong}")]).is_err(), "--baud {wrong}");
        }
        for wrong in ["0", "-1", "18446744073709551616"] {
            assert!(parsed(&[&format!("--packets={wrong}")]).is_err(), "--packets {wrong}");
        }
    }

    #[test]
    fn the_longest_time_does_not_overflow_the_clock() {
        let longest = parsed(&["--seconds", "31536000"]).unwrap().seconds.unwrap();
        assert!(Instant::now().checked_add(longest).is_some());
    }
}
