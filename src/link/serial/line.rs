//! A serial port as a device: finds it, claims it, opens it and writes messages.

use std::{
    io::{self, ErrorKind, Read as _, Write as _},
    mem,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use serialport::{ClearBuffer, SerialPort as _, TTYPort};

use super::board::BoardSearch;
use super::claim::PortClaim;
use super::dialogue::{Dialogue, Turn};
use super::port::{self, PortError};
use super::restart::Restart;
use crate::link::background::{Device, Shared};
use crate::link::handover::Handover;
use crate::link::{Inquiry, LinkError};

/// A port that takes no bytes for this long has lost the message: the next one is newer.
const PATIENCE: Duration = Duration::from_millis(50);
/// A line that is behind for this long is stuck, not slow. The slowest line sends two packets in 0.14 s.
const STUCK: Duration = Duration::from_millis(500);

/// Where the port is.
#[derive(Debug)]
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

/// A serial line.
#[derive(Debug)]
pub struct Line {
    place: Place,
    baud: u32,
    /// Written each time the port is opened, after the restart of the board if there is one.
    preamble: Vec<u8>,
    inquiry: Option<Inquiry>,
    /// The claim for the first attempt to open the port.
    first_claim: Option<PortClaim>,
    handover: Handover,
    open: Option<Port>,
}

impl Line {
    pub fn new(place: Place, baud: u32, preamble: Vec<u8>, inquiry: Option<Inquiry>) -> Self {
        // Claimed here, so that the first of two links to one device gets it.
        let first_claim = match &place {
            Place::Path(path) => PortClaim::acquire(path).ok(),
            Place::Board(_) => None,
        };
        Self { place, baud, preamble, inquiry, first_claim, handover: Handover::begin(), open: None }
    }

    /// Claims the port. Returns `None` when told to stop.
    fn claim(&mut self, device: &Path, shared: &Shared) -> Result<Option<PortClaim>, PortError> {
        if let Some(claim) = self.first_claim.take() {
            return Ok(Some(claim));
        }
        let claimed = self.handover.claim(shared, |_| true, || PortClaim::acquire(device));
        claimed.map_err(|holder| PortError::claimed(device, holder))
    }
}

impl Device for Line {
    fn open(&mut self, shared: &Shared) -> Result<bool, LinkError> {
        let device = self.place.find()?;
        shared.note_receiver();
        let Some(claim) = self.claim(&device, shared)? else { return Ok(false) };
        let (tty, restart) = port::open(&device, self.baud, PATIENCE)?;
        if claim.is_empty() {
            // The device appeared after the claim: the next attempt claims it.
            return Ok(false);
        }
        tracing::info!("link opened: {} at {} baud", device.display(), self.baud);
        if restart.is_some() {
            tracing::info!("link {}: a board there may restart now, so it gets nothing for 2 s", device.display());
        }
        let mut port = Port::new(device, tty, restart, claim);
        port.is_ready(&self.preamble, Instant::now());
        self.open = Some(port);
        Ok(true)
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        let Some(port) = &mut self.open else { return Ok(false) };
        if !port.is_ready(&self.preamble, Instant::now()) {
            return Ok(false);
        }
        let took_before = port.takes;
        let took = port.write(message).map_err(|error| PortError::lost(&port.device, error))?;
        if took_before && !port.takes {
            tracing::warn!("link {}: it takes no packets; check that the receiver reads", port.device.display());
        }
        Ok(took)
    }

    fn attend(&mut self) -> Result<(), LinkError> {
        let Some(port) = &mut self.open else { return Ok(()) };
        if let (true, Some(inquiry)) = (port.is_ready(&self.preamble, Instant::now()), &self.inquiry) {
            port.ask(inquiry).map_err(|error| PortError::lost(&port.device, error))?;
        }
        Ok(())
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// An open port.
#[derive(Debug)]
struct Port {
    device: PathBuf,
    tty: TTYPort,
    /// The restart of the board that the opening has caused, until it is over.
    restart: Option<Restart>,
    /// Whether the preamble was written.
    has_begun: bool,
    /// Whether the port takes messages. A message that a slow line leaves out does not count.
    takes: bool,
    /// When the port took the last message.
    took_at: Instant,
    dialogue: Dialogue,
    /// Released after the port is closed.
    _claim: PortClaim,
}

impl Port {
    fn new(device: PathBuf, tty: TTYPort, restart: Option<Restart>, claim: PortClaim) -> Self {
        let (took_at, dialogue) = (Instant::now(), Dialogue::default());
        Self { device, tty, restart, has_begun: false, takes: true, took_at, dialogue, _claim: claim }
    }

    /// Whether the port may be written to. The first time that it may, writes the preamble.
    fn is_ready(&mut self, preamble: &[u8], now: Instant) -> bool {
        if self.restart.as_ref().is_some_and(|restart| !restart.is_over(now)) {
            return false;
        }
        if !mem::replace(&mut self.has_begun, true) {
            self.restart.take().into_iter().for_each(Restart::end);
            // A port that takes no bytes yet does not need the preamble.
            let _ = self.tty.write(preamble);
            self.took_at = now;
        }
        true
    }

    /// Asks the receiver if it is time, or takes its answer.
    fn ask(&mut self, inquiry: &Inquiry) -> io::Result<()> {
        let there = self.tty.bytes_to_read().map_or(0, |bytes| bytes as usize);
        match self.dialogue.next(there, inquiry, Instant::now()) {
            Turn::Ask => {
                let _ = self.tty.clear(ClearBuffer::Input);
                // A question that the port does not take now is asked again a second later.
                return self
                    .tty
                    .write(&inquiry.question)
                    .map(drop)
                    .or_else(|error| if is_timeout(&error) { Ok(()) } else { Err(error) });
            }
            Turn::Hear => {
                let mut answer = vec![0; inquiry.answer_bytes];
                self.tty.read_exact(&mut answer)?;
                for trouble in (inquiry.troubles)(&answer) {
                    self.tell(trouble);
                }
            }
            Turn::GiveUp => self.tell(inquiry.silence),
            Turn::Wait => {}
        }
        Ok(())
    }

    fn tell(&mut self, trouble: &str) {
        if self.dialogue.told.is_new(trouble) {
            tracing::warn!("link {}: {trouble}", self.device.display());
        }
    }

    /// Writes the message. Returns whether the port took all of it in time.
    fn write(&mut self, message: &[u8]) -> io::Result<bool> {
        // Input that is no answer is discarded, because a board whose output nobody takes may stop.
        if !self.dialogue.is_waiting() {
            let _ = self.tty.clear(ClearBuffer::Input);
        }
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
mod tests;
