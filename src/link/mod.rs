//! Where coefficients go: carriers and the formats they carry.
//!
//! Role: each [`Link`] takes the packet to one receiver.
//! Contract: once open, a link never fails, blocks or allocates: what could not be sent is counted, because the
//! receiver may come, go and come back at any time. No link waits for another.
//! Limits: nothing is queued or sent again. The next packet is newer.

mod serial;
mod udp;

use std::iter::Sum;
use std::time::Duration;

use facewire_packet::Packet;

pub use serial::{PortError, PortTrouble, SerialLink, device_number, open_port};
pub use udp::UdpLink;

use crate::config::{LinkKind, LinkSettings};

/// A way to one receiver.
#[derive(Debug)]
pub enum Link {
    /// Packets of version 1, each one datagram.
    Udp(UdpLink),
    /// Packets of version 1, each one frame.
    Serial(SerialLink),
}

/// Why a link cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The host of the address has no address of its own.
    #[error(
        "link {address}: the host does not resolve ({reason}); check the spelling and the network, or give its address in numbers"
    )]
    Resolve {
        /// The address as configured.
        address: String,
        /// What the resolver says.
        reason: String,
    },
    /// The system gives no socket.
    #[error("link {address}: no socket ({error}); check that the service may use the network")]
    Socket {
        /// The address as configured.
        address: String,
        /// What the system says.
        error: std::io::Error,
    },
    /// This machine has no route to the address.
    #[error("link {address}: no network leads there ({error}); check this machine's cable or Wi-Fi and the address")]
    Route {
        /// The address as configured.
        address: String,
        /// What the system says.
        error: std::io::Error,
    },
    /// The serial port does not open.
    #[error("link {0}")]
    Port(#[from] PortError),
    /// The system gives no thread.
    #[error("link {link}: no thread ({error}); raise the limit of threads")]
    Thread {
        /// Where the link leads.
        link: String,
        /// What the system says.
        error: std::io::Error,
    },
}

/// What became of the packets of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkCounts {
    /// Given to the network or the serial port.
    pub sent: u64,
    /// Dropped because it took none, as when a cable is out.
    pub dropped: u64,
}

impl Sum for LinkCounts {
    fn sum<I: Iterator<Item = Self>>(counts: I) -> Self {
        counts
            .fold(Self::default(), |sum, next| Self { sent: sum.sent + next.sent, dropped: sum.dropped + next.dropped })
    }
}

impl Link {
    /// Opens the link. A host by its name is looked up, and a serial port opened, on threads of their own, again and again
    /// until they are there: no link waits for another.
    ///
    /// # Errors
    /// The system gives no thread, or no socket for an address in numbers.
    pub fn open(settings: &LinkSettings) -> Result<Self, LinkError> {
        match settings.kind {
            LinkKind::Udp => UdpLink::open(&settings.address).map(Self::Udp),
            LinkKind::Serial => SerialLink::open(&settings.device, settings.baud).map(Self::Serial),
        }
    }

    /// Says where the link leads if it opens at this moment. Nothing is sent.
    ///
    /// # Errors
    /// Why it does not open.
    pub fn check(settings: &LinkSettings) -> Result<String, LinkError> {
        match settings.kind {
            LinkKind::Udp => UdpLink::check(&settings.address).map(|()| settings.address.to_string()),
            LinkKind::Serial => {
                open_port(&settings.device, settings.baud, Duration::ZERO)?;
                Ok(format!("{} at {} baud", settings.device.display(), settings.baud))
            }
        }
    }

    /// Sends the packet or drops it.
    pub fn send(&mut self, packet: &Packet) {
        match self {
            Self::Udp(link) => link.send(packet),
            Self::Serial(link) => link.send(packet),
        }
    }

    /// What became of the packets so far.
    #[must_use]
    pub fn counts(&self) -> LinkCounts {
        match self {
            Self::Udp(link) => link.counts(),
            Self::Serial(link) => link.counts(),
        }
    }

    /// Lets the link write what it was given and end, without waiting for it. What it is given after that may be lost.
    pub fn stop(&self) {
        match self {
            Self::Udp(_) => {}
            Self::Serial(link) => link.stop(),
        }
    }

    /// Closes the link; what became of its packets in the end.
    #[must_use]
    pub fn close(self) -> LinkCounts {
        match self {
            Self::Udp(link) => link.counts(),
            Self::Serial(link) => link.close(),
        }
    }

    /// Why the network did not take the last packet, as the system's number. Serial links tell by themselves.
    #[must_use]
    pub fn refusal(&self) -> Option<i32> {
        match self {
            Self::Udp(link) => link.refusal(),
            Self::Serial(_) => None,
        }
    }

    /// Whether packets have a way out at present.
    #[must_use]
    pub fn is_open(&self) -> bool {
        match self {
            Self::Udp(link) => link.is_open(),
            Self::Serial(link) => link.is_open(),
        }
    }
}
