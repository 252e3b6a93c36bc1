//! Serial lines: one message, one write.
//!
//! Role: takes messages to a microcontroller by UART or USB, on a thread of its own ([`Background`]).
//! Contract: a port that is missing or disappears is opened again by its path. The newest message wins on the line as
//! well: a message that would wait behind more than one other is dropped.
//! Limits: input is discarded. A receiver that stops reading loses messages, which only the log shows.

mod board;
mod claim;
mod dialogue;
mod line;
mod port;
mod restart;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use serialport::TTYPort;

pub use self::board::{BoardSearch, is_maestro};
pub use self::claim::PortClaim;
use self::line::{Line, Place};
pub use self::port::{PortError, PortTrouble};
use super::background::Background;
use super::{Inquiry, LinkError, Traffic};
use crate::config::{AutoDevice, SerialDevice};

/// Returns the command port of a Maestro.
///
/// # Errors
/// Says why there is none.
pub fn maestro_port(device: &SerialDevice) -> Result<PathBuf, PortError> {
    match device {
        SerialDevice::Path(path) => Ok(path.clone()),
        SerialDevice::Auto => BoardSearch::new(AutoDevice::Maestro).find().map_err(PortError::of_the_board),
    }
}

/// Opens a serial port. Reading and writing wait for `patience` at most. Where this restarts the board, it is restarted again
/// by whoever opens the port next.
///
/// # Errors
/// Says what is wrong with the port.
pub fn open_port(device: &Path, baud: u32, patience: Duration) -> Result<TTYPort, PortError> {
    port::open(device, baud, patience).map(|(tty, _)| tty)
}

/// Starts the thread of a serial line. The port may appear later. Each time the port opens, the thread writes the first
/// bytes given, the preamble, as soon as the board has restarted if it restarts; later it asks the inquiry again and again.
///
/// # Errors
/// Returns an error if the system refuses a thread.
pub fn serial_carrier(
    device: &SerialDevice,
    baud: u32,
    auto: AutoDevice,
    (preamble, inquiry): (Vec<u8>, Option<Inquiry>),
    traffic: Arc<Traffic>,
) -> Result<Background, LinkError> {
    let (place, is_found) = match device {
        SerialDevice::Auto => (Place::Board(BoardSearch::new(auto)), false),
        SerialDevice::Path(path) => (Place::Path(path.clone()), true),
    };
    Background::start(device.to_string(), "fw-serial", Line::new(place, baud, preamble, inquiry), is_found, traffic)
}
