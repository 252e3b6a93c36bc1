//! Serial lines: one packet, one frame, one write.
//!
//! Role: takes packets to a microcontroller by UART or USB.
//! Contract: [`SerialLink::send`] hands the packet to the link's own thread through a triple buffer, newest wins: it
//! never waits, whatever the port does. A port that is not there, or goes away, is opened again by its path, after
//! 100 ms and then ever later up to 1 s. Newest wins on the line too: a packet that would wait behind more than one
//! other is dropped. Every packet is counted, as sent or as dropped.
//! Limits: nothing is read. A receiver that stops reading loses packets and is not noticed otherwise.

mod line;
mod port;
mod turn;

use std::{
    path::Path,
    sync::Arc,
    thread::{self, Builder, JoinHandle},
    time::{Duration, Instant},
};

use facewire_packet::Packet;
use triple_buffer::{Input, triple_buffer};

use self::line::{Line, Shared};
pub use self::port::{PortError, PortTrouble, open as open_port};
pub use self::turn::device_number;
use super::{LinkCounts, LinkError};

/// How long the last packet may take when the link is dropped. A thread that hangs in the system longer than that ends
/// with the process.
const LAST_PACKET: Duration = Duration::from_millis(500);

/// A serial line with its thread.
#[derive(Debug)]
pub struct SerialLink {
    newest: Input<Packet>,
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

impl SerialLink {
    /// Starts the link; the port need not be there yet.
    ///
    /// # Errors
    /// The system gives no thread.
    pub fn open(device: &Path, baud: u32) -> Result<Self, LinkError> {
        let (newest, output) = triple_buffer(&Packet::NEUTRAL);
        let shared = Arc::new(Shared::default());
        let line = Line { device: device.to_owned(), baud, newest: output, shared: Arc::clone(&shared) };
        let thread = Builder::new().name("fw-serial".to_owned()).spawn(move || line.run());
        let thread = thread.map_err(|error| LinkError::Thread { link: device.display().to_string(), error })?;
        Ok(Self { newest, shared, thread })
    }

    /// Hands the packet to the thread. One that was not written yet is dropped for it.
    pub fn send(&mut self, packet: &Packet) {
        *self.newest.input_buffer_mut() = *packet;
        if self.newest.publish() {
            self.shared.drop_one();
        }
        self.thread.thread().unpark();
    }

    /// What became of the packets so far; the last may be on its way.
    #[must_use]
    pub fn counts(&self) -> LinkCounts {
        self.shared.counts()
    }

    /// Lets the thread write what it was given and end.
    pub fn stop(&self) {
        self.shared.stop();
        self.thread.thread().unpark();
    }

    /// Stops the link and waits for its thread; what became of all packets, unless it hangs in the system.
    #[must_use]
    pub fn close(self) -> LinkCounts {
        let shared = Arc::clone(&self.shared);
        drop(self);
        shared.counts()
    }

    /// Whether the port is open.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.shared.is_open()
    }
}

impl Drop for SerialLink {
    fn drop(&mut self) {
        self.stop();
        let end = Instant::now() + LAST_PACKET;
        while !self.thread.is_finished() && Instant::now() < end {
            thread::sleep(Duration::from_millis(5));
        }
    }
}
