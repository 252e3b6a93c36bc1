//! `facewire monitor`: receives packets and shows them.
//!
//! Role: the receiver that is always at hand, to see what a sender does. On a terminal it draws bars, elsewhere it
//! writes a line a second; `--json` writes one object a packet.
//! Contract: it listens, changes nothing, and ends on Ctrl-C, SIGTERM, a closed output or its limits with a summary.
//! Limits: several senders to one port are shown as they come, the newest packet wins.

mod bars;
mod report;
mod screen;
mod tally;

use std::{
    io::{self, IsTerminal as _, Write as _},
    net::{SocketAddr, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use facewire_packet::{PACKET_BYTES, Packet};
use signal_hook::consts::{SIGINT, SIGTERM};

pub(super) use self::report::yaw_pitch_roll_deg;
use self::{report::Json, screen::Screen, tally::Tally};

/// 30 pictures a second are smooth, and more would load a board for nothing.
const SCREEN_PERIOD: Duration = Duration::from_millis(33);
/// A log wants a line a second.
const LINE_PERIOD: Duration = Duration::from_secs(1);

const EXAMPLES: &str = "\
Examples:
  facewire monitor
  facewire monitor --listen 0.0.0.0:6000 --seconds 10
  facewire monitor --json --packets 100 > packets.jsonl";

/// Receive packets by UDP and show them live
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct MonitorArgs {
    /// Address and port to listen to
    #[arg(long, value_name = "ADDRESS", default_value = "0.0.0.0:5252")]
    pub listen: SocketAddr,
    /// Write each packet as one line of JSON
    #[arg(long)]
    pub json: bool,
    /// End after so many valid packets
    #[arg(long, value_name = "N")]
    pub packets: Option<u64>,
    /// End after so many seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub seconds: Option<Duration>,
}

/// Why the monitor ends without success.
#[derive(Debug, thiserror::Error)]
pub enum MonitorError {
    /// The port is taken, or the address is not this machine's.
    #[error("cannot listen to {listen} ({error}); end what uses the port, or give --listen another address")]
    Listen {
        /// The address asked for.
        listen: SocketAddr,
        /// What the system says.
        error: io::Error,
    },
    /// Nothing valid came.
    #[error("no packet came to {listen}; check [[link]] address in the sender's configuration, and the firewall")]
    NoPacket {
        /// The address listened to.
        listen: SocketAddr,
    },
    /// The terminal or the output cannot be written.
    #[error("cannot write the output ({0}); check where it goes")]
    Output(#[from] io::Error),
}

/// How packets are shown.
enum View {
    Screen(Box<Screen>),
    Lines,
    Json,
}

/// Receives and shows packets until told to stop.
///
/// # Errors
/// The address cannot be listened to, the output cannot be written, or no packet came at all.
pub fn run(args: &MonitorArgs) -> Result<(), MonitorError> {
    let cannot_listen = |error| MonitorError::Listen { listen: args.listen, error };
    let socket = UdpSocket::bind(args.listen).map_err(cannot_listen)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let mut tally = Tally::new();
    let watched = watch(args, &socket, &stop, &mut tally);
    match watched {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => return Err(error.into()),
        _ => {}
    }
    if tally.packets() == 0 {
        return Err(MonitorError::NoPacket { listen: args.listen });
    }
    summarise(args, &tally)
}

/// The summary goes beside the JSON, not into it.
fn summarise(args: &MonitorArgs, tally: &Tally) -> Result<(), MonitorError> {
    let line = tally.summary();
    let written = if args.json { writeln!(io::stderr(), "{line}") } else { writeln!(io::stdout(), "{line}") };
    match written {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// Shows packets until a limit or a signal ends it. The screen is restored on return.
fn watch(args: &MonitorArgs, socket: &UdpSocket, stop: &AtomicBool, tally: &mut Tally) -> io::Result<()> {
    let mut view = View::new(args)?;
    let begin = Instant::now();
    let end = args.seconds.map(|seconds| begin + seconds);
    let mut shown = begin;
    while !stop.load(Ordering::Relaxed)
        && args.packets.is_none_or(|packets| tally.packets() < packets)
        && end.is_none_or(|end| Instant::now() < end)
    {
        let left = end.map_or(SCREEN_PERIOD, |end| end.saturating_duration_since(Instant::now()));
        let packet = receive(socket, left.min(SCREEN_PERIOD), tally)?;
        view.packet(packet.as_ref(), tally)?;
        if shown.elapsed() >= view.period() {
            shown = Instant::now();
            view.refresh(args, tally)?;
        }
    }
    Ok(())
}

/// Waits for a packet and counts what came.
fn receive(socket: &UdpSocket, wait: Duration, tally: &mut Tally) -> io::Result<Option<Packet>> {
    // One byte more than a packet, so that longer datagrams are seen to be too long.
    let mut bytes = [0; PACKET_BYTES + 1];
    socket.set_read_timeout(Some(wait.max(Duration::from_millis(1))))?;
    let (length, from) = match socket.recv_from(&mut bytes) {
        Ok(received) => received,
        Err(error) => match error.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted => {
                return Ok(None);
            }
            _ => return Err(error),
        },
    };
    let packet = Packet::decode(bytes.get(..length).unwrap_or_default()).ok();
    match &packet {
        Some(packet) => tally.count(packet, from, Instant::now()),
        None => tally.refuse(),
    }
    Ok(packet)
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

    /// Time from one refresh to the next.
    fn period(&self) -> Duration {
        match self {
            Self::Screen(_) | Self::Json => SCREEN_PERIOD,
            Self::Lines => LINE_PERIOD,
        }
    }

    /// Takes a packet.
    fn packet(&self, packet: Option<&Packet>, tally: &Tally) -> io::Result<()> {
        let (Self::Json, Some(packet)) = (self, packet) else {
            return Ok(());
        };
        let mut line = serde_json::to_string(&Json::new(packet, tally))?;
        line.push('\n');
        io::stdout().write_all(line.as_bytes())
    }

    /// Shows how things stand.
    fn refresh(&mut self, args: &MonitorArgs, tally: &Tally) -> io::Result<()> {
        let now = Instant::now();
        match self {
            Self::Screen(screen) => screen.draw(args.listen, tally, now),
            Self::Lines => writeln!(io::stdout(), "{}", report::line(args.listen, tally, now)),
            Self::Json => Ok(()),
        }
    }
}

/// Seconds on the command line.
fn seconds(text: &str) -> Result<Duration, String> {
    let number: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    Duration::try_from_secs_f64(number).map_err(|error| error.to_string())
}
