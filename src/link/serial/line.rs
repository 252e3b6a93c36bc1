//! The thread of a serial line: opens the port, writes the newest message, and opens the port again after any error.

use std::{
    io::{self, ErrorKind, Write as _},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{
            AtomicBool,
            Ordering::{Acquire, Relaxed, Release},
        },
    },
    thread,
    time::{Duration, Instant},
};

use serialport::{ClearBuffer, SerialPort as _, TTYPort};
use triple_buffer::Output as Newest;

use super::board::BoardSearch;
use super::claim::PortClaim;
use super::port::{self, PortError};
use crate::link::{LinkError, Traffic};
use crate::retry::Retry;

/// Longest message, bytes. A line of JSON with all coefficients takes about 1500.
const MESSAGE_BYTES: usize = 2048;
/// A port that takes no bytes for this long has lost the message: the next one is newer.
const PATIENCE: Duration = Duration::from_millis(50);
/// A line that is behind for this long is stuck, not slow. The slowest line sends two packets in 0.14 s.
const STUCK: Duration = Duration::from_millis(500);
/// Longest sleep. Every message ends it.
const IDLE: Duration = Duration::from_millis(100);
/// How long a new link waits in silence for the link that it replaces to close the port.
const HANDOVER: Duration = Duration::from_secs(2);
/// Time between two looks at the port during a handover.
const HANDOVER_LOOK: Duration = Duration::from_millis(2);

/// The encoded bytes of one message.
pub type Message = heapless::Vec<u8, MESSAGE_BYTES>;

/// State that the carrier and its thread share.
#[derive(Debug, Default)]
pub struct Shared {
    stop: AtomicBool,
    open: AtomicBool,
    /// Whether the port is known. A board that was found once is known even while it is unplugged.
    found: AtomicBool,
    traffic: Arc<Traffic>,
}

impl Shared {
    pub fn new(traffic: Arc<Traffic>, is_found: bool) -> Self {
        Self { traffic, found: is_found.into(), ..Self::default() }
    }

    /// Asks the thread to write the message that it was given last, and to end.
    pub fn stop(&self) {
        self.stop.store(true, Release);
    }

    fn stopping(&self) -> bool {
        self.stop.load(Acquire)
    }

    /// Whether the port is open.
    pub fn is_open(&self) -> bool {
        self.open.load(Relaxed)
    }

    /// Whether the port is known.
    pub fn is_found(&self) -> bool {
        self.found.load(Relaxed)
    }

    /// Counts a message that is not written.
    pub fn drop_one(&self) {
        Traffic::count(&self.traffic.dropped);
    }
}

/// Where the port is.
pub enum Place {
    Path(PathBuf),
    Board(BoardSearch),
}

impl Place {
    /// Returns the path of the port.
    fn find(&mut self) -> Result<PathBuf, PortError> {
        match self {
            Self::Path(path) => Ok(path.clone()),
            Self::Board(search) => search.find().map_err(PortError::of_the_board),
        }
    }
}

/// A serial line and its messages.
pub struct Line {
    pub place: Place,
    pub baud: u32,
    /// Written each time the port is opened.
    pub preamble: &'static [u8],
    pub newest: Newest<Message>,
    pub shared: Arc<Shared>,
    /// The claim for the first attempt to open the port.
    pub claim: Option<PortClaim>,
    /// The attempts to open the port since the last message was written.
    pub retry: Retry,
}

impl Line {
    /// Writes messages until it is told to stop. This thread also logs what happens to the port, because no message
    /// waits for it.
    pub fn run(mut self) {
        let handover_end = Instant::now() + HANDOVER;
        while !self.shared.stopping() {
            if let Err(error) = self.session(handover_end) {
                self.shared.open.store(false, Relaxed);
                self.tell(error);
            }
            let wait = self.retry.wait();
            self.pause(wait);
        }
        self.shared.open.store(false, Relaxed);
        // A message that came while there was no port.
        if self.newest.update() {
            self.shared.drop_one();
        }
    }

    /// Logs why the port is not open, once for each reason. That no board is plugged in is no fault.
    fn tell(&mut self, error: PortError) {
        let waits = error.waits_for_a_board();
        let error = LinkError::from(error);
        if !waits {
            self.retry.warn(&error);
        } else if self.retry.logged.is_new(&error.to_string()) {
            tracing::info!("{error}");
        }
    }

    /// Runs from opening the port to the first error, or to the end.
    fn session(&mut self, handover_end: Instant) -> Result<(), PortError> {
        let device = self.place.find()?;
        self.shared.found.store(true, Relaxed);
        let Some(claim) = self.claim(&device, handover_end)? else { return Ok(()) };
        let mut port = Port::open(port::open(&device, self.baud, PATIENCE)?, self.preamble);
        if claim.is_empty() {
            // The device appeared after the claim: the next attempt claims it.
            return Ok(());
        }
        self.shared.open.store(true, Relaxed);
        tracing::info!("link opened: {} at {} baud", device.display(), self.baud);
        loop {
            // Read before the message, so that a message given before the end is still written.
            let stopping = self.shared.stopping();
            if self.newest.update() {
                self.write(&mut port, &device).map_err(|error| PortError::lost(&device, error))?;
            } else if stopping {
                return Ok(());
            } else {
                thread::park_timeout(IDLE);
            }
        }
    }

    /// Claims the port. Up to `handover_end`, waits for another link to release it. Returns `None` when told to stop.
    fn claim(&mut self, device: &Path, handover_end: Instant) -> Result<Option<PortClaim>, PortError> {
        if let Some(claim) = self.claim.take() {
            return Ok(Some(claim));
        }
        while !self.shared.stopping() {
            match PortClaim::acquire(device) {
                Ok(claim) => return Ok(Some(claim)),
                Err(holder) if Instant::now() >= handover_end => return Err(PortError::claimed(device, holder)),
                Err(_) => thread::park_timeout(HANDOVER_LOOK),
            }
        }
        Ok(None)
    }

    fn write(&mut self, port: &mut Port, device: &Path) -> io::Result<()> {
        let took_before = port.takes;
        let took = port.write(self.newest.peek_output_buffer());
        match took {
            Ok(true) => {
                self.retry = Retry::default();
                Traffic::count(&self.shared.traffic.sent);
            }
            Ok(false) | Err(_) => self.shared.drop_one(),
        }
        took?;
        if took_before && !port.takes {
            tracing::warn!("link {}: it takes no packets; check that the receiver reads", device.display());
        }
        Ok(())
    }

    /// Waits, however many messages come meanwhile.
    fn pause(&self, wait: Duration) {
        let end = Instant::now() + wait;
        while !self.shared.stopping() && Instant::now() < end {
            thread::park_timeout(end.saturating_duration_since(Instant::now()));
        }
    }
}

/// An open port.
struct Port {
    tty: TTYPort,
    /// Whether the port takes messages. A message that a slow line leaves out does not count.
    takes: bool,
    /// When the port took the last message.
    took_at: Instant,
}

impl Port {
    /// Writes the preamble. A port that takes no bytes yet does not need it.
    fn open(mut tty: TTYPort, preamble: &[u8]) -> Self {
        let _ = tty.write(preamble);
        Self { tty, takes: true, took_at: Instant::now() }
    }

    /// Writes the message. Returns whether the port took all of it in time.
    fn write(&mut self, message: &[u8]) -> io::Result<bool> {
        // Input is discarded, because a board whose output nobody takes may stop.
        let _ = self.tty.clear(ClearBuffer::Input);
        // A port that does not know its unsent bytes is written to.
        if self.tty.bytes_to_write().is_ok_and(|unsent| is_behind(unsent, message.len())) {
            self.takes &= self.took_at.elapsed() < STUCK;
            return Ok(false);
        }
        let took = match self.tty.write(message) {
            Ok(bytes) => Ok(bytes == message.len()),
            Err(error) if is_timeout(&error) => Ok(false),
            Err(error) => Err(error),
        };
        self.takes = matches!(took, Ok(true));
        if self.takes {
            self.took_at = Instant::now();
        }
        took
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

/// Whether the error only means that there was no room in time.
fn is_timeout(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
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

    use super::*;

    /// Returns how many of the packets given in 10 s a line takes, and the longest time that one of them waits.
    fn given(packets_hz: u32, baud: u32) -> (u32, Duration) {
        let (bytes_per_s, mut unsent_bytes, mut taken, mut longest) = (f64::from(baud) / 10.0, 0.0, 0, 0.0);
        for _ in 0..10 * packets_hz {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some hundreds")]
            if !is_behind(unsent_bytes as u32, FRAME_BYTES) {
                longest = f64::max(longest, unsent_bytes / bytes_per_s);
                unsent_bytes += FRAME_BYTES as f64;
                taken += 1;
            }
            unsent_bytes = f64::max(0.0, unsent_bytes - bytes_per_s / f64::from(packets_hz));
        }
        (taken, Duration::from_secs_f64(longest))
    }

    #[test]
    fn a_line_that_is_given_too_many_packets_is_always_busy_and_no_packet_waits_for_two_others() {
        let packet = Duration::from_secs_f64(10.0 * FRAME_BYTES as f64 / 57_600.0);
        let (taken, waited) = given(60, 57_600);
        assert!((428..=432).contains(&taken), "{taken}: 57,600 baud carry 42.99 a second");
        assert!(waited <= packet, "{waited:?}");
    }

    #[test]
    fn a_line_that_is_fast_enough_drops_no_packet() {
        assert_eq!(given(42, 57_600).0, 420);
    }
}
