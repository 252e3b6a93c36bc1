//! Serial lines: one message, one write.
//!
//! Role: takes messages to a microcontroller by UART or USB, on a thread of its own ([`Background`]). May also ask the
//! receiver about its state ([`Inquiry`]).
//! Contract: a port that is missing or disappears is opened again by its path. The newest message wins on the line as
//! well: a message that would wait behind more than one other is dropped. A board that restarts gets not a byte until its
//! boot loader has started the sketch: the boot loader of an Uno takes bytes for commands, and 0x64 erases its memory.
//! Limits: input that is no answer is discarded. A receiver that stops reading loses messages, which only the log shows.

mod board;
mod port;

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use serialport::{ClearBuffer, SerialPort as _, TTYPort};

pub use self::board::{PortSearch, is_maestro};
pub use self::port::{PortClaim, lost};
use super::background::{Background, Device};
use super::{Inquiry, LinkError, Traffic};
use crate::config::{AutoDevice, SerialDevice};
use crate::retry::LoggedReasons;

/// A port that takes no bytes for this long has lost the message: the next one is newer.
const WRITE_TIMEOUT: Duration = Duration::from_millis(50);
/// A line that is behind for this long is stuck, not slow. The slowest line sends two packets in 0.14 s.
const STUCK_AFTER: Duration = Duration::from_millis(500);
/// How long a board that restarts gets nothing. The boot loader of an Uno waits for a new sketch for 1 s.
const RESTART: Duration = Duration::from_secs(2);
/// Time between two questions.
const INQUIRY_PERIOD: Duration = Duration::from_secs(1);
/// A receiver that has not answered by then does not answer.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// Opens a serial port without claiming it. Reading and writing wait for `timeout` at most. If this restarts the board,
/// it is restarted again by whoever opens the port next.
pub fn open_port(device: &Path, baud: u32, timeout: Duration) -> Result<TTYPort, LinkError> {
    port::open(device, baud, timeout).map(|(tty, _)| tty)
}

/// Starts the thread of a serial line. The port may appear later. Each time that the port opens, the thread writes the
/// preamble, as soon as the board has restarted if it restarts; later it asks the inquiry again and again.
pub fn serial_carrier(
    device: &SerialDevice,
    baud: u32,
    auto: AutoDevice,
    (preamble, inquiry): (Vec<u8>, Option<Inquiry>),
    traffic: Arc<Traffic>,
) -> Result<Background, LinkError> {
    // Claimed here, so that the first of two links to one device gets it.
    let first_claim = match device {
        SerialDevice::Path(path) => PortClaim::acquire(path).ok(),
        SerialDevice::Auto => None,
    };
    let search = PortSearch::new(device, auto);
    let line = Line { search, baud, preamble, inquiry, first_claim, open: None };
    Background::start(device.to_string(), "fw-serial", line, *device != SerialDevice::Auto, traffic)
}

/// A serial line, whose port may be closed.
#[derive(Debug)]
struct Line {
    search: PortSearch,
    baud: u32,
    preamble: Vec<u8>,
    inquiry: Option<Inquiry>,
    first_claim: Option<PortClaim>,
    open: Option<Port>,
}

impl Device for Line {
    fn open(&mut self) -> Result<(), LinkError> {
        let device = self.search.find()?;
        let claim = self.first_claim.take().map_or_else(|| PortClaim::acquire(&device), Ok)?;
        let (tty, dtr) = port::open(&device, self.baud, WRITE_TIMEOUT)?;
        tracing::info!("link opened: {} at {} baud", device.display(), self.baud);
        if dtr.is_some() {
            tracing::info!("link {}: a board there may restart now, so it gets nothing for 2 s", device.display());
        }
        let mut port = Port::new(device, tty, dtr, claim);
        if port.dtr.is_none() {
            port.begin(&self.preamble);
        }
        self.open = Some(port);
        Ok(())
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        let Some(port) = &mut self.open else { return Ok(false) };
        port.write(message).map_err(|error| lost(&port.device, error))
    }

    fn attend(&mut self) -> Result<(), LinkError> {
        let Some(port) = &mut self.open else { return Ok(()) };
        port.attend(&self.preamble, self.inquiry.as_ref()).map_err(|error| lost(&port.device, error))
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// What an open port is doing: `Restarting -> Idle <-> Asked`. Messages are written in all phases but the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// A board may restart, and gets nothing.
    Restarting,
    Idle,
    /// The receiver was asked, and has not answered.
    Asked,
}

/// What is due in a phase.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Action {
    /// The board has restarted: write the preamble.
    Begin,
    Ask,
    /// Read the answer, which is available.
    Read,
    /// Log that no answer came.
    GiveUp,
}

impl Phase {
    /// Returns what is due so long after the restart, the preamble or the last question began, while `available` bytes can
    /// be read. `answer_bytes` is `None` if the receiver is not asked at all.
    fn due(self, elapsed: Duration, available: usize, answer_bytes: Option<usize>) -> Option<Action> {
        match (self, answer_bytes) {
            (Self::Restarting, _) if elapsed >= RESTART => Some(Action::Begin),
            (Self::Idle, Some(_)) if elapsed >= INQUIRY_PERIOD => Some(Action::Ask),
            (Self::Asked, Some(bytes)) if available >= bytes => Some(Action::Read),
            (Self::Asked, _) if elapsed >= ANSWER_TIMEOUT => Some(Action::GiveUp),
            _ => None,
        }
    }
}

/// An open port.
#[derive(Debug)]
struct Port {
    device: PathBuf,
    tty: TTYPort,
    phase: Phase,
    /// When the restart, the preamble or the last question began.
    since: Instant,
    /// The port of a board that restarts: DTR falls if it is closed before the restart is over.
    dtr: Option<OwnedFd>,
    /// Whether the port takes messages. A message that a slow line leaves out does not count.
    takes: bool,
    took_at: Instant,
    logged: LoggedReasons,
    /// Released after the port is closed.
    _claim: PortClaim,
}

impl Port {
    fn new(device: PathBuf, tty: TTYPort, dtr: Option<OwnedFd>, claim: PortClaim) -> Self {
        let (phase, now, logged) = (Phase::Restarting, Instant::now(), LoggedReasons::default());
        Self { device, tty, phase, since: now, dtr, takes: true, took_at: now, logged, _claim: claim }
    }

    fn begin(&mut self, preamble: &[u8]) {
        if let Some(port) = self.dtr.take() {
            // If this fails, the board restarts once more at the next opening.
            let _ = port::keep_dtr(&port);
        }
        // A port that takes no bytes yet does not need the preamble.
        let _ = self.tty.write(preamble);
        (self.phase, self.since, self.took_at) = (Phase::Idle, Instant::now(), Instant::now());
    }

    fn attend(&mut self, preamble: &[u8], inquiry: Option<&Inquiry>) -> io::Result<()> {
        let available = self.tty.bytes_to_read().map_or(0, |bytes| bytes as usize);
        let due = self.phase.due(self.since.elapsed(), available, inquiry.map(|inquiry| inquiry.answer_bytes));
        match (due, inquiry) {
            (Some(Action::Begin), _) => self.begin(preamble),
            (Some(Action::Ask), Some(inquiry)) => {
                self.phase = if inquiry.answer_bytes > 0 { Phase::Asked } else { Phase::Idle };
                self.since = Instant::now();
                let _ = self.tty.clear(ClearBuffer::Input);
                // A question that the port does not take now is asked again a second later.
                in_time(self.tty.write(&inquiry.question))?;
            }
            (Some(Action::Read), Some(inquiry)) => {
                self.phase = Phase::Idle;
                let mut answer = vec![0; inquiry.answer_bytes];
                self.tty.read_exact(&mut answer)?;
                (inquiry.troubles)(&answer).into_iter().for_each(|trouble| self.warn(trouble));
            }
            (Some(Action::GiveUp), Some(inquiry)) => {
                self.phase = Phase::Idle;
                self.warn(inquiry.silence);
            }
            _ => {}
        }
        Ok(())
    }

    fn warn(&mut self, trouble: &str) {
        if self.logged.is_new(trouble) {
            tracing::warn!("link {}: {trouble}", self.device.display());
        }
    }

    /// Writes the message. Returns whether the port took all of it in time.
    fn write(&mut self, message: &[u8]) -> io::Result<bool> {
        if self.phase == Phase::Restarting {
            return Ok(false);
        }
        // Input that is no answer is discarded, because a board whose output nobody takes may stop.
        if self.phase != Phase::Asked {
            let _ = self.tty.clear(ClearBuffer::Input);
        }
        let took_before = self.takes;
        // A port that does not know its unsent bytes is written to.
        let is_behind = self.tty.bytes_to_write().is_ok_and(|unsent| is_behind(unsent, message.len()));
        let took = !is_behind && in_time(self.tty.write(message))? == Some(message.len());
        if took {
            self.took_at = Instant::now();
        }
        self.takes = took || (is_behind && self.takes && self.took_at.elapsed() < STUCK_AFTER);
        if took_before && !self.takes {
            tracing::warn!("link {}: it takes no packets; check that the receiver reads", self.device.display());
        }
        Ok(took)
    }
}

/// Whether the system holds more unsent bytes than one message. A further message would come late, and each one after
/// it later.
///
/// UARTs and most USB adapters count bytes, except those in their own chips. CDC ACM counts buffers in use, each larger
/// than a packet, so that one packet is under way at a time. Pseudo-terminals always report 0.
fn is_behind(unsent_bytes: u32, message_bytes: usize) -> bool {
    unsent_bytes as usize > message_bytes
}

/// Returns `None` for an error which only means that there was no room in time.
fn in_time(written: io::Result<usize>) -> io::Result<Option<usize>> {
    match written {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) => match error.kind() {
            ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted => Ok(None),
            _ => Err(error),
        },
    }
}

impl Drop for Port {
    /// Discards unsent bytes if the receiver does not read: closing would wait half a minute for them.
    fn drop(&mut self) {
        if !self.takes {
            let _ = self.tty.clear(ClearBuffer::Output);
        }
    }
}

#[cfg(test)]
mod tests {
    use facewire_packet::FRAME_BYTES;
    use rustix::fs::{Mode, OFlags};
    use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};

    use super::*;

    /// Returns how many of the packets given in 10 s a line takes, and the longest time that one of them waits.
    fn given(packets_hz: u32, baud: u32) -> (u32, f64) {
        let (bytes_per_s, mut unsent_bytes, mut taken, mut longest_s) = (f64::from(baud) / 10.0, 0.0, 0, 0.0);
        for _ in 0..10 * packets_hz {
            if !is_behind(unsent_bytes as u32, FRAME_BYTES) {
                longest_s = f64::max(longest_s, unsent_bytes / bytes_per_s);
                unsent_bytes += FRAME_BYTES as f64;
                taken += 1;
            }
            unsent_bytes = f64::max(0.0, unsent_bytes - bytes_per_s / f64::from(packets_hz));
        }
        (taken, longest_s)
    }

    #[test]
    fn a_line_that_is_too_slow_is_always_busy_and_no_packet_waits_for_two_others_and_a_fast_one_drops_none() {
        let (taken, waited_s) = given(60, 57_600);
        assert!((428..=432).contains(&taken), "{taken}: 57,600 baud carry 42.99 a second");
        assert!(waited_s <= 10.0 * FRAME_BYTES as f64 / 57_600.0, "{waited_s}");
        assert_eq!(given(42, 57_600).0, 420);
    }

    #[test]
    fn a_receiver_is_asked_once_a_second_and_its_answer_is_read_when_it_is_whole_or_given_up_after_half_a_second() {
        let due = |phase: Phase, ms, available, answer| phase.due(Duration::from_millis(ms), available, answer);
        for (phase, ms, available, answer_bytes, action) in [
            (Phase::Restarting, 1999, 2, Some(2), None),
            (Phase::Restarting, 2000, 0, None, Some(Action::Begin)),
            (Phase::Idle, 9000, 2, None, None),
            (Phase::Idle, 999, 2, Some(2), None),
            (Phase::Idle, 1000, 0, Some(0), Some(Action::Ask)),
            (Phase::Idle, 1000, 2, Some(2), Some(Action::Ask)),
            (Phase::Asked, 499, 1, Some(2), None),
            (Phase::Asked, 499, 2, Some(2), Some(Action::Read)),
            (Phase::Asked, 500, 1, Some(2), Some(Action::GiveUp)),
        ] {
            assert_eq!(due(phase, ms, available, answer_bytes), action, "{phase:?} {ms} {available}");
        }
    }

    #[test]
    fn a_board_that_restarts_gets_nothing_and_then_the_preamble_once_and_only_then_its_port_keeps_dtr() {
        let (mut board, tty) = TTYPort::pair().unwrap();
        board.set_timeout(Duration::from_secs(10)).unwrap();
        let device = PathBuf::from(tty.name().unwrap());
        let open = || rustix::fs::open(&device, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
        let port = open();
        let mut modes = tcgetattr(&port).unwrap();
        modes.control_modes |= ControlModes::HUPCL;
        tcsetattr(&port, OptionalActions::Now, &modes).unwrap();
        let keeps_dtr = || !tcgetattr(&port).unwrap().control_modes.contains(ControlModes::HUPCL);
        let search = PortSearch::new(&SerialDevice::Auto, AutoDevice::Microcontroller);
        let inquiry = Inquiry { question: b"?".to_vec(), answer_bytes: 0, troubles: |_| Vec::new(), silence: "" };
        let opened = Port::new(device.clone(), tty, Some(open()), PortClaim::acquire(&device).unwrap());
        let (inquiry, first_claim, open) = (Some(inquiry), None, Some(opened));
        let mut line = Line { search, baud: 115_200, preamble: vec![0], inquiry, first_claim, open };
        for _ in 0..3 {
            assert!(!line.write(b"dropped").unwrap());
            line.attend().unwrap();
        }
        assert_eq!((board.bytes_to_read().unwrap(), keeps_dtr()), (0, false));
        line.open.as_mut().unwrap().since = Instant::now().checked_sub(RESTART).unwrap();
        line.attend().unwrap();
        assert!(keeps_dtr());
        assert!(line.write(b"first").unwrap() && line.write(b"second").unwrap());
        let mut bytes = [0; 12];
        board.read_exact(&mut bytes).unwrap();
        assert_eq!(&bytes, b"\0firstsecond");
        assert_eq!(board.bytes_to_read().unwrap(), 0);
    }
}
