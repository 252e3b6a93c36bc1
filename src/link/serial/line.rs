//! The thread of a serial link: opens the port, writes the newest packet, and on any error opens it again.

use std::{
    io::{self, ErrorKind, Write as _},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{
            AtomicBool, AtomicU64,
            Ordering::{Acquire, Relaxed, Release},
        },
    },
    thread,
    time::{Duration, Instant},
};

use facewire_packet::{FRAME_BYTES, Packet};
use serialport::{ClearBuffer, SerialPort as _, TTYPort};
use triple_buffer::Output as Newest;

use super::port::{self, PortError};
use super::turn::Turn;
use crate::link::{LinkCounts, LinkError};
use crate::retry::Retry;

/// A port that takes nothing for so long has lost a packet: the next is newer.
const PATIENCE: Duration = Duration::from_millis(50);
/// A line that is behind for so long is not slow but stuck. The slowest takes two packets in 0.14 s.
const STUCK: Duration = Duration::from_millis(500);
/// Longest sleep. Every packet ends it.
const IDLE: Duration = Duration::from_millis(100);
/// How long a link that new settings have ended may take to close the port without a word about it.
const CLOSING: Duration = Duration::from_secs(2);
/// How often that is looked at.
const CLOSING_LOOK: Duration = Duration::from_millis(2);

/// What the link and its thread both see.
#[derive(Debug, Default)]
pub struct Shared {
    stop: AtomicBool,
    open: AtomicBool,
    sent: AtomicU64,
    dropped: AtomicU64,
}

impl Shared {
    /// Lets the thread write what it was given and end.
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

    /// Packets written, and those that were not.
    pub fn counts(&self) -> LinkCounts {
        LinkCounts { sent: self.sent(), dropped: self.dropped.load(Relaxed) }
    }

    fn sent(&self) -> u64 {
        self.sent.load(Relaxed)
    }

    /// Counts a packet that is not written.
    pub fn drop_one(&self) {
        self.dropped.fetch_add(1, Relaxed);
    }
}

/// A serial line and the packets for it.
pub struct Line {
    pub device: PathBuf,
    pub baud: u32,
    pub newest: Newest<Packet>,
    pub shared: Arc<Shared>,
}

impl Line {
    /// Writes packets until told to stop. What becomes of the port is logged here, on no thread that a packet waits for.
    pub fn run(mut self) {
        let mut retry = Retry::default();
        while !self.shared.stopping() {
            let sent_before = self.shared.sent();
            if let Err(error) = self.session() {
                self.shared.open.store(false, Relaxed);
                retry.warn(&LinkError::from(error));
            }
            if self.shared.sent() != sent_before {
                retry = Retry::default();
            }
            self.pause(retry.wait());
        }
        // Given while there was no port, and never taken.
        if self.newest.update() {
            self.shared.drop_one();
        }
    }

    /// From opening to the first error, or to the end.
    fn session(&mut self) -> Result<(), PortError> {
        let Some(_turn) = self.turn()? else { return Ok(()) };
        let mut port = Port::open(port::open(&self.device, self.baud, PATIENCE)?);
        self.shared.open.store(true, Relaxed);
        tracing::info!("link opened: {} at {} baud", self.device.display(), self.baud);
        loop {
            // Asked first, so that what was given before the end is still written.
            let stopping = self.shared.stopping();
            if self.newest.update() {
                self.write(&mut port).map_err(|error| PortError::lost(&self.device, error))?;
            } else if stopping {
                return Ok(());
            } else {
                thread::park_timeout(IDLE);
            }
        }
    }

    /// Waits until no other link is at the port. `None` when told to stop.
    fn turn(&self) -> Result<Option<Turn>, PortError> {
        let end = Instant::now() + CLOSING;
        while !self.shared.stopping() {
            if let Some(turn) = Turn::take(&self.device) {
                return Ok(Some(turn));
            }
            if Instant::now() >= end {
                return Err(PortError::closing(&self.device));
            }
            thread::park_timeout(CLOSING_LOOK);
        }
        Ok(None)
    }

    fn write(&self, port: &mut Port) -> io::Result<()> {
        let took_before = port.takes;
        let took = port.write(&self.newest.peek_output_buffer().encode_frame());
        match took {
            Ok(true) => _ = self.shared.sent.fetch_add(1, Relaxed),
            Ok(false) | Err(_) => self.shared.drop_one(),
        }
        took?;
        if took_before && !port.takes {
            tracing::warn!("link {}: it takes no packets; check that the receiver reads", self.device.display());
        }
        Ok(())
    }

    /// Waits, however many packets come meanwhile.
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
    /// Whether it takes packets; one that a slow line leaves out does not count.
    takes: bool,
    /// When it took the last one.
    took_at: Instant,
}

impl Port {
    /// Begins with the end of a frame, so that a part of one from earlier does not spoil the first packet. A port that
    /// takes nothing yet needs none.
    fn open(mut tty: TTYPort) -> Self {
        let _ = tty.write(&[0]);
        Self { tty, takes: true, took_at: Instant::now() }
    }

    /// Whether the port took the frame, all of it and in time.
    fn write(&mut self, frame: &[u8; FRAME_BYTES]) -> io::Result<bool> {
        // What the board says is for nobody; left unread, it could make the board wait.
        let _ = self.tty.clear(ClearBuffer::Input);
        // A port that cannot tell is written to.
        if self.tty.bytes_to_write().is_ok_and(is_behind) {
            self.takes &= self.took_at.elapsed() < STUCK;
            return Ok(false);
        }
        let took = match self.tty.write(frame) {
            Ok(bytes) => Ok(bytes == FRAME_BYTES),
            Err(error) if is_wait(&error) => Ok(false),
            Err(error) => Err(error),
        };
        self.takes = matches!(took, Ok(true));
        if self.takes {
            self.took_at = Instant::now();
        }
        took
    }
}

/// Whether so many bytes that the system has not sent yet are more than a packet. Another behind them would come late,
/// and each after it later.
///
/// UARTs and most USB adapters count bytes, without those in their own chips; CDC ACM counts buffers in use, of more than
/// a packet each, so that there one packet is under way at a time; pseudo-terminals always say 0.
fn is_behind(unsent_bytes: u32) -> bool {
    unsent_bytes as usize > FRAME_BYTES
}

/// Whether nothing is wrong but that there was no room in time.
fn is_wait(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

impl Drop for Port {
    /// Closing waits until all is sent, for half a minute where nobody reads.
    fn drop(&mut self) {
        if !self.takes {
            let _ = self.tty.clear(ClearBuffer::Output);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The packets that a line takes of those given in 10 s, and the longest that one waits for those before it.
    fn given(packets_hz: u32, baud: u32) -> (u32, Duration) {
        let (bytes_per_s, mut unsent_bytes, mut taken, mut longest) = (f64::from(baud) / 10.0, 0.0, 0, 0.0);
        for _ in 0..10 * packets_hz {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some hundreds")]
            if !is_behind(unsent_bytes as u32) {
                longest = f64::max(longest, unsent_bytes / bytes_per_s);
                unsent_bytes += FRAME_BYTES as f64;
                taken += 1;
            }
            unsent_bytes = f64::max(0.0, unsent_bytes - bytes_per_s / f64::from(packets_hz));
        }
        (taken, Duration::from_secs_f64(longest))
    }

    #[test]
    fn a_line_that_is_given_more_than_it_carries_sends_what_it_carries_and_no_packet_waits_for_two() {
        let packet = Duration::from_secs_f64(10.0 * FRAME_BYTES as f64 / 57_600.0);
        let (taken, waited) = given(60, 57_600);
        assert!((428..=432).contains(&taken), "{taken}: 57,600 baud carry 42.99 a second");
        assert!(waited <= packet, "{waited:?}");
    }

    #[test]
    fn a_line_that_carries_all_it_is_given_leaves_no_packet_out() {
        assert_eq!(given(42, 57_600).0, 420);
    }
}
