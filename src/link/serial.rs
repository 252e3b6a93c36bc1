//! Serial lines: one message, one write. Raw bytes, 8N1, no flow control.
//!
//! Contract: a port that is missing or disappears is opened again by its path. The newest message wins on the line as
//! well: a message that would wait behind more than one other is dropped. A board that restarts gets not a byte until its
//! boot loader has started the sketch: the boot loader of an Uno takes bytes for commands, and 0x64 erases its memory.
//! Limits: input that is no answer is discarded. A receiver that stops reading loses messages: the log says so, and those
//! that the port does not take are counted as dropped.
//!
//! `serialport` locks an open port against other processes with TIOCEXCL and `flock`. Its attempt to open a locked port
//! takes TIOCEXCL off the port, though, and its error does not say who has it. Links therefore claim a port before they
//! touch it.
//!
//! Arduino-like boards restart when DTR rises. Linux raises DTR when a port is opened, and lowers it when the port is
//! closed unless HUPCL is cleared. HUPCL is therefore cleared, so that a board restarts only when its port is opened for the
//! first time; for a board that restarts, it is cleared only when the restart is over. Whoever closes the port earlier
//! lowers DTR, so that the next one to open it restarts the board again and waits again.

mod board;

use std::fmt::Display;
use std::fs::metadata;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use facewire_board::serial_refusal;
use facewire_servo::maestro::{ANSWER_BYTES, NONSENSE, Reminder, SILENCE, errors, has_obeyed, preamble, question};
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};
use serialport::{ClearBuffer, SerialPort as _, TTYPort};

use self::board::restarts_board;
pub use self::board::{PortSearch, serial_ports};
use super::background::{Background, Device};
use super::{LinkError, LinkErrorKind, Panel};
use crate::config::{LinkKind, MaestroSettings, SerialDevice};
use crate::retry::LoggedReasons;

/// A port that takes no bytes for this long has lost the message: the next one is newer.
const WRITE_TIMEOUT: Duration = Duration::from_millis(50);
/// A line that is behind for this long is stuck, not slow. The slowest line sends two packets in 0.14 s.
const STUCK_AFTER: Duration = Duration::from_millis(500);
/// How long a board that restarts gets nothing. The boot loader of an Uno waits for a new sketch for 1 s.
const RESTART: Duration = Duration::from_secs(2);
const INQUIRY_PERIOD: Duration = Duration::from_secs(1);
const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);
/// Largest tolerated error of the driver's rate, as a share: a line tolerates 3 to 5 percent between its two ends.
const MOST_RATE_ERROR: f64 = 0.02;
const CANNOT_BE_OPENED: &str = "cannot be opened";

pub fn lost(device: &Path, error: impl Display) -> LinkError {
    failed(device, "went away", error)
}

fn failed(device: &Path, how: &str, error: impl Display) -> LinkError {
    let sentence = format!("{how} ({error}); check its cable, and plug it in again");
    LinkError::new(LinkErrorKind::Other, device.display(), sentence)
}

fn refused(device: &Path, error: Errno) -> LinkError {
    serial_refusal(error).map_or_else(
        || failed(device, CANNOT_BE_OPENED, io::Error::from(error)),
        |sentence| LinkError::new(LinkErrorKind::Other, device.display(), sentence),
    )
}

/// The claimed devices by their device numbers, and the path of the link that claimed each.
static CLAIMS: Mutex<Vec<(u64, PathBuf)>> = Mutex::new(Vec::new());

fn claims() -> MutexGuard<'static, Vec<(u64, PathBuf)>> {
    CLAIMS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The exclusive right of one link of this process to a serial port, until it is dropped.
pub struct PortClaim(u64);

impl PortClaim {
    /// Claims the port by its device number, which is the same under all names of a device.
    pub fn acquire(device: &Path) -> Result<Self, LinkError> {
        let node = metadata(device);
        let node = node.map_err(|error| refused(device, Errno::from_io_error(&error).unwrap_or(Errno::IO)))?;
        if !node.file_type().is_char_device() {
            return Err(refused(device, Errno::NOTTY));
        }
        let mut claims = claims();
        let Some((_, holder)) = claims.iter().find(|(claimed, _)| *claimed == node.rdev()) else {
            claims.push((node.rdev(), device.to_owned()));
            return Ok(Self(node.rdev()));
        };
        let sentence = if holder == device {
            "the link that the reload replaced has not closed it yet; check that its receiver reads, or unplug it and plug \
             it in again"
        } else {
            &format!(
                "it is the same device as {} at the moment, which another link uses; plug in the device that is missing, \
                 or give each link a port of its own",
                holder.display()
            )
        };
        Err(LinkError::new(LinkErrorKind::Claimed, device.display(), sentence))
    }
}

impl Drop for PortClaim {
    fn drop(&mut self) {
        claims().retain(|(claimed, _)| *claimed != self.0);
    }
}

/// Opens a serial port without claiming it. Reading and writing wait for `timeout` at most. If this restarts the board,
/// it is restarted again by whoever opens the port next.
pub fn open_port(device: &Path, baud: u32, timeout: Duration) -> Result<TTYPort, LinkError> {
    open_at_rate(device, baud, timeout).map(|(tty, _)| tty)
}

/// As [`open_port`], with the rate that the driver makes.
pub fn open_at_rate(device: &Path, baud: u32, timeout: Duration) -> Result<(TTYPort, u32), LinkError> {
    open(device, baud, timeout).map(|(tty, made, _)| (tty, made))
}

/// Logs the rate of a port that was opened, and what to do if that is not the one that it was asked for.
pub fn log_rate(device: &Path, baud: u32, made: u32) {
    let device = device.display();
    tracing::info!("link opened: {device} at {made} baud");
    if made.abs_diff(baud) > (f64::from(baud) * MOST_RATE_ERROR) as u32 {
        tracing::warn!(
            "link {device}: its driver runs at {made} baud instead of {baud}, so that the other end may not understand it; set \
             both ends to a rate that the driver supports, or use another adapter"
        );
    }
}

/// Opens the port. Returns the rate that its driver makes as well, and, if a board there may restart now, what [`keep_dtr`] takes
/// when the restart is over.
fn open(device: &Path, baud: u32, timeout: Duration) -> Result<(TTYPort, u32, Option<OwnedFd>), LinkError> {
    let prepare = || {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let prepared = rustix::fs::open(device, flags, Mode::empty())?;
        let dtr_rose = tcgetattr(&prepared)?.control_modes.contains(ControlModes::HUPCL);
        let restarts = dtr_rose && restarts_board(device);
        if !restarts {
            keep_dtr(&prepared)?;
        }
        Ok((prepared, restarts))
    };
    // Stays open until the port is open for good: otherwise DTR would fall in between.
    let (prepared, restarts) = prepare().map_err(|error| refused(device, error))?;
    let tty = serialport::new(device.to_string_lossy(), baud).timeout(timeout).open_native();
    let tty = tty.map_err(|error| match error.kind {
        serialport::ErrorKind::NoDevice => refused(device, Errno::BUSY),
        _ => failed(device, CANNOT_BE_OPENED, error.description),
    })?;
    let made = tcgetattr(&prepared).map_or(baud, |modes| modes.output_speed());
    Ok((tty, made, restarts.then_some(prepared)))
}

fn keep_dtr(port: &OwnedFd) -> rustix::io::Result<()> {
    let mut modes = tcgetattr(port)?;
    modes.control_modes.remove(ControlModes::HUPCL);
    tcsetattr(port, OptionalActions::Now, &modes)
}

/// Starts the thread of a serial line, if the link has one. The port may appear later. Each time that the port opens, the
/// thread writes the preamble, as soon as the board has restarted if it restarts; later it asks a Maestro again and again.
pub fn serial_carrier(kind: &LinkKind, panel: Arc<Panel>) -> Result<Option<Background>, LinkError> {
    let Some((device, baud, auto)) = kind.line() else { return Ok(None) };
    let maestro = if let LinkKind::Maestro(settings) = kind { Some(settings.clone()) } else { None };
    // Claimed here, so that the first of two links to one device gets it.
    let path = if let SerialDevice::Path(path) = device { Some(path) } else { None };
    let first_claim = path.and_then(|path| PortClaim::acquire(path).ok());
    let is_found = path.is_some();
    let release = maestro.as_ref().map(|it| it.commands().release(&it.channels, it.multiple_targets));
    let search = PortSearch::new(device, auto);
    let line = Line {
        search,
        is_found,
        baud,
        maestro,
        release,
        first_claim,
        panel: Arc::clone(&panel),
        logged: LoggedReasons::default(),
    };
    Background::start(device, "fw-serial", line, panel).map(Some)
}

struct Line {
    search: PortSearch,
    /// Whether a port was found before, even if it is away now.
    is_found: bool,
    baud: u32,
    maestro: Option<MaestroSettings>,
    /// The message that ends the pulses of a Maestro.
    release: Option<Vec<u8>>,
    first_claim: Option<PortClaim>,
    panel: Arc<Panel>,
    logged: LoggedReasons,
}

/// An open port. While its board restarts, it gets nothing; then it may be asked, and answers.
struct Port {
    device: PathBuf,
    tty: TTYPort,
    /// The rate that the driver makes.
    made_baud: u32,
    /// The port of a board that restarts: DTR falls if it is closed before the restart is over.
    dtr: Option<OwnedFd>,
    is_asked: bool,
    /// Whether the last message that a Maestro was given ended its pulses, and whether it was asked after that. It obeys
    /// commands in their order, so its answer acknowledges the release.
    is_released: bool,
    is_asked_released: bool,
    /// Whether the last answer came in time. If not, the next question waits, so that a late answer is not taken for its own.
    answers: bool,
    /// When the restart, the preamble or the last question began.
    since: Instant,
    /// Whether the port takes messages. A message that a slow line leaves out does not count.
    takes: bool,
    took_at: Instant,
    /// The limits for a Maestro, and what was written last: a message, and the limits before it.
    reminder: Option<Reminder>,
    written: Vec<u8>,
    /// Released after the port is closed.
    _claim: PortClaim,
}

impl Device for Line {
    type Open = Port;

    fn open(&mut self) -> Result<Port, LinkError> {
        let found = self.search.find();
        self.is_found |= !found.as_ref().is_err_and(|error| error.kind == LinkErrorKind::Waiting);
        let device = found?;
        let claim = self.first_claim.take().map_or_else(|| PortClaim::acquire(&device), Ok)?;
        let (tty, made, dtr) = open(&device, self.baud, WRITE_TIMEOUT)?;
        let mut port = Port::new(device, tty, dtr, claim);
        port.made_baud = made;
        if port.dtr.is_none() {
            self.begin(&mut port);
        }
        Ok(port)
    }

    fn log_opened(&mut self, port: &Port) {
        self.logged = LoggedReasons::default();
        log_rate(&port.device, self.baud, port.made_baud);
        if port.dtr.is_some() {
            tracing::info!("link {}: a board there may restart now, so it gets nothing for 2 s", port.device.display());
        }
    }

    fn write(&mut self, port: &mut Port, message: &[u8]) -> Result<bool, LinkError> {
        let is_release = self.release.as_deref() == Some(message);
        if !is_release {
            // What the port takes of it may give pulses, even if that is not all of it.
            (port.is_released, port.is_asked_released) = (false, false);
            self.panel.dials.note_released(false);
        }
        let took = port.write(message, &self.panel).map_err(|error| lost(&port.device, error))?;
        if took && is_release {
            port.is_released = true;
            // A Maestro that is never asked acknowledges nothing, so that what the port takes must do.
            if self.maestro.as_ref().is_some_and(|it| !it.read_errors) {
                self.panel.dials.note_released(true);
            }
        }
        Ok(took)
    }

    fn let_go(&mut self, port: &mut Port) -> Result<(), LinkError> {
        let Some(release) = self.release.as_ref().filter(|_| port.dtr.is_none()) else { return Ok(()) };
        port.put(release).map(drop).map_err(|error| lost(&port.device, error))
    }

    fn attend(&mut self, port: &mut Port) -> Result<(), LinkError> {
        self.advance(port).map_err(|error| lost(&port.device, error))
    }

    fn has_receiver(&self) -> bool {
        self.is_found
    }
}

impl Line {
    fn begin(&self, port: &mut Port) {
        if let Some(port) = port.dtr.take() {
            // If this fails, the board restarts once more at the next opening.
            let _ = keep_dtr(&port);
        }
        // The end of a frame separates the first frame from leftovers on the line.
        let preamble =
            self.maestro.as_ref().map_or(vec![0], |it| preamble(it.pololu_commands(), it.commands(), &it.channels));
        let _ = port.tty.write(&preamble);
        port.reminder = self.maestro.as_ref().map(|it| {
            // By USB, which is where "auto" finds a Maestro, a baud rate means nothing.
            let baud = if it.device == SerialDevice::Auto { u32::MAX } else { self.baud };
            Reminder::new(it.commands(), &it.channels, baud)
        });
        port.since = Instant::now();
        port.took_at = Instant::now();
    }

    fn is_unacknowledged(&self, port: &Port) -> bool {
        port.is_released && !self.panel.dials.has_released()
    }

    /// Does what is due: ends the restart, asks, or takes the answer.
    fn advance(&mut self, port: &mut Port) -> io::Result<()> {
        let elapsed = port.since.elapsed();
        let available = port.tty.bytes_to_read().map_or(0, |bytes| bytes as usize);
        if port.dtr.is_some() {
            if elapsed >= RESTART {
                self.begin(port);
            }
            return Ok(());
        }
        let Some(settings) = &self.maestro else { return Ok(()) };
        if port.is_asked && (available >= ANSWER_BYTES || elapsed >= ANSWER_TIMEOUT) {
            port.is_asked = false;
            let mut answer = [0; ANSWER_BYTES];
            let found = match available {
                0 | 1 => Err(SILENCE),
                ANSWER_BYTES => port.tty.read_exact(&mut answer).map(|()| errors(answer))?,
                _ => Err(NONSENSE),
            };
            port.answers = found.is_ok();
            match found {
                Ok(found) => {
                    if port.is_asked_released {
                        // What was lost may be the release: the next message repeats it.
                        let has_obeyed = has_obeyed(answer);
                        self.panel.dials.note_released(has_obeyed);
                        port.is_released &= has_obeyed;
                    }
                    found.for_each(|error| port.warn(error, &self.panel, &mut self.logged));
                }
                Err(trouble) => {
                    self.panel.dials.note_released(false);
                    port.warn(trouble, &self.panel, &mut self.logged);
                }
            }
        } else if !port.is_asked && (elapsed >= INQUIRY_PERIOD || (port.answers && self.is_unacknowledged(port))) {
            port.is_asked = settings.read_errors;
            port.is_asked_released = port.is_released;
            port.since = Instant::now();
            let _ = port.tty.clear(ClearBuffer::Input);
            // A question that the port does not take now is asked again a second later.
            in_time(port.tty.write(&question(settings.commands(), &settings.channels, settings.read_errors)))?;
        }
        Ok(())
    }
}

impl Port {
    fn new(device: PathBuf, tty: TTYPort, dtr: Option<OwnedFd>, _claim: PortClaim) -> Self {
        let now = Instant::now();
        Self {
            device,
            tty,
            made_baud: 0,
            dtr,
            is_asked: false,
            is_released: false,
            is_asked_released: false,
            answers: true,
            since: now,
            takes: true,
            took_at: now,
            reminder: None,
            written: Vec::new(),
            _claim,
        }
    }

    /// Reports the trouble of a Maestro, which may have missed its limits, or have restarted.
    fn warn(&mut self, trouble: &str, panel: &Panel, logged: &mut LoggedReasons) {
        self.doubt();
        panel.note(Some(trouble));
        if logged.is_new(trouble) {
            tracing::warn!("link {}: {trouble}", self.device.display());
        }
    }

    fn write(&mut self, message: &[u8], panel: &Panel) -> io::Result<bool> {
        if self.dtr.is_some() {
            return Ok(false);
        }
        // Input that is no answer is discarded, because a board whose output nobody takes may stop.
        if !self.is_asked {
            let _ = self.tty.clear(ClearBuffer::Input);
        }
        let took_before = self.takes;
        // A port that does not know its unsent bytes is written to.
        let longest = message.len().max(self.written.len());
        let is_behind = self.tty.bytes_to_write().is_ok_and(|unsent| is_behind(unsent, longest));
        let took = !is_behind && self.put(message)?;
        if took {
            self.took_at = Instant::now();
        }
        self.takes = took || (is_behind && self.takes && self.took_at.elapsed() < STUCK_AFTER);
        if took_before != self.takes {
            let trouble = (!self.takes).then_some("it takes no packets; check that the receiver reads");
            panel.note(trouble);
            if let Some(trouble) = trouble {
                tracing::warn!("link {}: {trouble}", self.device.display());
            }
        }
        Ok(took)
    }

    /// Writes a message, and before it the limits for a Maestro. Returns whether the port took all of it.
    fn put(&mut self, message: &[u8]) -> io::Result<bool> {
        self.written.clear();
        if let Some(reminder) = &mut self.reminder {
            reminder.write(message.len(), self.took_at.elapsed(), &mut self.written);
        }
        self.written.extend(message);
        let took = in_time(self.tty.write(&self.written))? == Some(self.written.len());
        if !took {
            self.doubt();
        }
        Ok(took)
    }

    fn doubt(&mut self) {
        self.reminder.iter_mut().for_each(Reminder::doubt);
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

/// Whether the system holds more unsent bytes than one message. A further message would come late, and each one after
/// it later.
///
/// UARTs and most USB adapters count bytes, except those in their own chips. CDC ACM counts buffers in use, each larger
/// than a packet, so that one packet is under way at a time. Pseudo-terminals always report 0.
fn is_behind(unsent_bytes: u32, message_bytes: usize) -> bool {
    unsent_bytes as usize > message_bytes
}

/// Returns `None` for an error which only means that there was no room in time.
pub(super) fn in_time(written: io::Result<usize>) -> io::Result<Option<usize>> {
    match written {
        Err(error) if !matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
            Err(error)
        }
        written => Ok(written.ok()),
    }
}

#[cfg(test)]
mod tests {
    use facewire_board::Attached;
    use facewire_packet::FRAME_BYTES;
    use facewire_servo::ChannelSettings;

    use super::*;
    use crate::link::testing::{eventually, logged};

    /// A line at 115,200 baud whose port was found.
    fn line(attached: Attached, maestro: Option<MaestroSettings>) -> Line {
        Line {
            search: PortSearch::new(&SerialDevice::Auto, attached),
            is_found: true,
            baud: 115_200,
            maestro,
            release: None,
            first_claim: None,
            panel: Arc::default(),
            logged: LoggedReasons::default(),
        }
    }

    #[test]
    fn a_line_that_is_too_slow_is_always_busy_and_no_packet_waits_for_two_others_and_a_fast_one_drops_none() {
        // 57,600 baud carry 42.99 packets a second.
        for (packets_hz, most_taken) in [(60_u32, 428..=432), (42, 420..=420)] {
            let bytes_per_s = 5760.0;
            let mut unsent_bytes = 0.0;
            let mut taken = 0;
            let mut longest_s = 0.0_f64;
            for _ in 0..10 * packets_hz {
                if !is_behind(unsent_bytes as u32, FRAME_BYTES) {
                    longest_s = longest_s.max(unsent_bytes / bytes_per_s);
                    unsent_bytes += FRAME_BYTES as f64;
                    taken += 1;
                }
                unsent_bytes = f64::max(0.0, unsent_bytes - bytes_per_s / f64::from(packets_hz));
            }
            let is_in_time = longest_s <= FRAME_BYTES as f64 / bytes_per_s;
            assert!(most_taken.contains(&taken) && is_in_time, "{taken} {longest_s}");
        }
    }

    #[test]
    fn a_board_that_restarts_gets_nothing_and_then_the_preamble_once_and_only_then_its_port_keeps_dtr() {
        let (mut board, tty) = TTYPort::pair().unwrap();
        board.set_timeout(Duration::from_mins(1)).unwrap();
        let device = PathBuf::from(tty.name().unwrap());
        let open = || rustix::fs::open(&device, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
        let other = open();
        let mut modes = tcgetattr(&other).unwrap();
        modes.control_modes |= ControlModes::HUPCL;
        tcsetattr(&other, OptionalActions::Now, &modes).unwrap();
        let keeps_dtr = || !tcgetattr(&other).unwrap().control_modes.contains(ControlModes::HUPCL);
        let maestro = Some(MaestroSettings::default());
        let mut line = line(Attached::Microcontroller, maestro);
        let mut port = Port::new(device.clone(), tty, Some(open()), PortClaim::acquire(&device).unwrap());
        for _ in 0..3 {
            assert!(!port.write(b"dropped", &line.panel).unwrap());
            line.attend(&mut port).unwrap();
        }
        assert_eq!((board.bytes_to_read().unwrap(), keeps_dtr()), (0, false));
        // Returns whether an answer is awaited so long after the restart or the last question.
        let mut after = |port: &mut Port, elapsed| {
            port.since = Instant::now().checked_sub(elapsed).unwrap();
            line.attend(port).unwrap();
            port.is_asked
        };
        // A boot loader waits for a sketch for 1 s.
        assert!(!after(&mut port, Duration::from_secs(1)) && !keeps_dtr());
        assert!(!after(&mut port, Duration::from_secs(2)) && keeps_dtr());
        let panel = Panel::default();
        assert!(port.write(b"first", &panel).unwrap() && port.write(b"second", &panel).unwrap());
        // Then the receiver is asked once a second, and its answer is read when it is whole, or given up.
        let asked = [500, 1000, 500, 1000].map(|ms| after(&mut port, Duration::from_millis(ms)));
        assert_eq!(asked, [false, true, false, true]);
        for (byte, is_asked) in [(b"a", true), (b"b", false)] {
            board.write_all(byte).unwrap();
            eventually("the answer", || after(&mut port, Duration::ZERO) == is_asked);
        }
        let mut bytes = [0; 16];
        board.read_exact(&mut bytes).unwrap();
        assert_eq!((&bytes, board.bytes_to_read().unwrap()), (b"\xAA\x0C\x21firstsecond\xA1\xA1", 0));
    }

    #[test]
    fn a_maestro_gets_its_limits_before_the_targets_as_far_as_the_line_carries_them_and_all_of_them_after_a_trouble() {
        let (mut board, tty) = TTYPort::pair().unwrap();
        board.set_timeout(Duration::from_mins(1)).unwrap();
        let device = PathBuf::from(tty.name().unwrap());
        let channel = ChannelSettings { speed_per_s: 2.0, ..ChannelSettings::default() };
        let at = SerialDevice::Path(device.clone());
        let maestro = Some(MaestroSettings { device: at, channels: vec![channel], ..MaestroSettings::default() });
        let mut line = line(Attached::Maestro, maestro);
        let mut port = Port::new(device.clone(), tty, None, PortClaim::acquire(&device).unwrap());
        line.begin(&mut port);
        let limits = b"\x87\x00\x50\x00\x89\x00\x00\x00";
        let target = b"\x84\x00\x70\x2E";
        let mut heard = [0; 11];
        board.read_exact(&mut heard).unwrap();
        assert_eq!((&heard[..3], &heard[3..]), (&b"\xAA\x0C\x21"[..], &limits[..]), "the preamble");
        // Writes a target so long after the last one, and returns what the Maestro hears.
        let mut after = |port: &mut Port, ms| {
            port.took_at = Instant::now().checked_sub(Duration::from_millis(ms)).unwrap();
            if ms == 0 {
                // No time passes until a moment in the future.
                port.took_at += Duration::from_mins(1);
            }
            assert!(port.write(target, &line.panel).unwrap());
            let mut heard = vec![0; port.written.len()];
            board.read_exact(&mut heard).unwrap();
            heard
        };
        let both = [&limits[..], target].concat();
        assert_eq!(after(&mut port, 0), both, "the first target");
        assert_eq!(after(&mut port, 0), target, "no room");
        assert_eq!(after(&mut port, 20), both);
        assert_eq!(after(&mut port, 0), target, "no room");
        port.warn("an error", &line.panel, &mut line.logged);
        assert_eq!(after(&mut port, 0), both);
    }

    #[test]
    fn a_trouble_of_a_port_that_opens_and_fails_again_and_again_is_logged_once_and_again_once_the_port_lasts() {
        let mut line = line(Attached::Maestro, Some(MaestroSettings::default()));
        let mut warn = |has_lasted: bool| {
            let (_board, tty) = TTYPort::pair().unwrap();
            let device = PathBuf::from(tty.name().unwrap());
            let mut port = Port::new(device.clone(), tty, None, PortClaim::acquire(&device).unwrap());
            if has_lasted {
                line.log_opened(&port);
            }
            let log = logged(|| port.warn(SILENCE, &line.panel, &mut line.logged));
            log.matches(SILENCE).count()
        };
        assert_eq!([false, false, true, false].map(&mut warn), [1, 0, 1, 0]);
    }

    #[test]
    fn what_comes_late_or_is_no_answer_acknowledges_no_release_and_a_part_of_another_message_ends_it() {
        let (mut board, tty) = TTYPort::pair().unwrap();
        let device = PathBuf::from(tty.name().unwrap());
        let release = b"\x84\x00\x00\x00";
        let maestro = line(Attached::Maestro, Some(MaestroSettings::default()));
        let mut line = Line { release: Some(release.to_vec()), ..maestro };
        let mut port = Port::new(device.clone(), tty, None, PortClaim::acquire(&device).unwrap());
        let dials = Arc::clone(&line.panel.dials);
        // Returns whether an answer is awaited so long after the last question.
        let after = |line: &mut Line, port: &mut Port, ms| {
            port.since = Instant::now().checked_sub(Duration::from_millis(ms)).unwrap();
            line.attend(port).unwrap();
            port.is_asked
        };
        let mut answer = |port: &Port, bytes: &[u8]| {
            board.write_all(bytes).unwrap();
            eventually("the bytes", || port.tty.bytes_to_read().unwrap() as usize == bytes.len());
        };
        assert!(after(&mut line, &mut port, 1000), "asked while there are pulses");
        assert!(line.write(&mut port, release).unwrap());
        assert!(!after(&mut line, &mut port, 500));
        answer(&port, &[0, 0]);
        assert!(!after(&mut line, &mut port, 0) && !dials.has_released(), "a late answer to what was asked before");
        for nonsense in [&b"\xA1\x9F"[..], &[0; 3]] {
            assert!(after(&mut line, &mut port, 1000));
            answer(&port, nonsense);
            assert!(!after(&mut line, &mut port, 0) && !dials.has_released(), "{nonsense:?}");
            assert_eq!(line.panel.trouble().as_deref(), Some(NONSENSE));
        }
        assert!(after(&mut line, &mut port, 1000));
        answer(&port, &[0, 0]);
        assert!(!after(&mut line, &mut port, 0) && dials.has_released());
        while port.tty.write(&[0; 1024]).is_ok() {}
        let _ = line.write(&mut port, b"\x84\x00\x70\x2E");
        assert!(!dials.has_released());
    }

    #[test]
    fn a_port_that_the_user_may_not_open_names_the_group_and_one_that_the_unit_excludes_its_device_rules() {
        let [user, unit] =
            [Errno::ACCESS, Errno::PERM].map(|error| refused(Path::new("/dev/rfcomm0"), error).to_string());
        assert!(user.contains("/dev/rfcomm0") && user.contains("group dialout"), "{user}");
        assert!(unit.contains("DeviceAllow=") && !unit.contains("dialout"), "{unit}");
    }
}
