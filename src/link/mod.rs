//! Where coefficients go: carriers and the formats they carry.
//!
//! Role: each [`Link`] takes the packet to one receiver.
//! Contract: once open, a link never fails, blocks or allocates: what could not be sent is counted, because the
//! receiver may come, go and come back at any time.
//! Limits: nothing is queued or sent again. The next packet is newer.

mod udp;

pub use udp::UdpLink;

use facewire_packet::Packet;

use crate::config::{LinkKind, LinkSettings};

/// A way to one receiver.
#[derive(Debug)]
pub enum Link {
    /// Packets of version 1, each one datagram.
    Udp(UdpLink),
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
}

/// What became of the packets of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkCounts {
    /// Given to the network.
    pub sent: u64,
    /// Dropped because the network took none, as when a cable is out.
    pub dropped: u64,
}

impl Link {
    /// Opens the link. Names are resolved here, once.
    ///
    /// # Errors
    /// The host does not resolve, or there is no socket. Neither is for ever: try again later.
    pub fn open(settings: &LinkSettings) -> Result<Self, LinkError> {
        match settings.kind {
            LinkKind::Udp => UdpLink::open(&settings.address).map(Self::Udp),
        }
    }

    /// Sends the packet or drops it.
    pub fn send(&mut self, packet: &Packet) {
        match self {
            Self::Udp(link) => link.send(packet),
        }
    }

    /// What became of the packets so far.
    #[must_use]
    pub fn counts(&self) -> LinkCounts {
        match self {
            Self::Udp(link) => link.counts(),
        }
    }
}
