//! Serial lines: one message, one write.
//!
//! Role: takes messages to a microcontroller by UART or USB.
//! Contract: [`SerialCarrier::send`](Carrier::send) hands the message to the carrier's own thread through a triple
//! buffer, where the newest message wins, so it never waits for the port. A port that is missing or disappears is opened
//! again by its path, after 100 ms at first and at most 1 s later. The newest message wins on the line as well: a
//! message that would wait behind more than one other is dropped. Every message is counted as sent or dropped.
//! Limits: input is discarded. A receiver that stops reading loses messages, which only the log shows.

mod board;
mod claim;
mod line;
mod port;

use std::{
    sync::Arc,
    thread::{Builder, JoinHandle},
};

use triple_buffer::{Input, triple_buffer};

pub use self::board::BoardSearch;
pub use self::claim::PortClaim;
use self::line::{Line, Message, Place, Shared};
pub use self::port::{PortError, PortTrouble, open as open_port};
use super::{Carrier, LinkError, Traffic};
use crate::config::SerialDevice;
use crate::retry::Retry;

/// A serial line with its thread. When it is dropped, the thread writes the last message and ends by itself.
#[derive(Debug)]
pub struct SerialCarrier {
    newest: Input<Message>,
    shared: Arc<Shared>,
    thread: JoinHandle<()>,
}

impl SerialCarrier {
    /// Starts the thread. The port may appear later. Each time the port opens, the thread writes `preamble` first.
    ///
    /// # Errors
    /// Returns an error if the system refuses a thread.
    pub fn open(
        device: &SerialDevice,
        baud: u32,
        preamble: &'static [u8],
        traffic: Arc<Traffic>,
    ) -> Result<Self, LinkError> {
        let (newest, output) = triple_buffer(&Message::new());
        let (place, claim) = match device {
            SerialDevice::Auto => (Place::Board(BoardSearch::default()), None),
            // Claimed here, so that the first of two links to one device gets it.
            SerialDevice::Path(path) => (Place::Path(path.clone()), PortClaim::acquire(path).ok()),
        };
        let shared = Arc::new(Shared::new(traffic, matches!(place, Place::Path(_))));
        let (name, line_shared) = (device.to_string(), Arc::clone(&shared));
        let line = Line { place, baud, preamble, newest: output, shared: line_shared, claim, retry: Retry::default() };
        let thread = Builder::new().name("fw-serial".to_owned()).spawn(move || line.run());
        let thread = thread.map_err(|error| LinkError::Thread { link: name, error })?;
        Ok(Self { newest, shared, thread })
    }
}

impl Carrier for SerialCarrier {
    /// Hands the message to the thread. It replaces a message that was not written yet.
    fn send(&mut self, message: &[u8]) {
        let buffer = self.newest.input_buffer_mut();
        buffer.clear();
        if buffer.extend_from_slice(message).is_err() || self.newest.publish() {
            self.shared.drop_one();
        }
        self.thread.thread().unpark();
    }

    fn is_open(&self) -> bool {
        self.shared.is_open()
    }

    fn has_receiver(&self) -> bool {
        self.shared.is_found()
    }

    fn stop(&self) {
        self.shared.stop();
        self.thread.thread().unpark();
    }

    fn has_ended(&self) -> bool {
        self.thread.is_finished()
    }
}

impl Drop for SerialCarrier {
    fn drop(&mut self) {
        self.stop();
    }
}
