//! UDP: one packet, one datagram.
//!
//! The socket is not connected, so that a receiver that is not there yet (an ICMP refusal), a route that comes late and
//! a change of this machine's own address cannot break the link.

use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket},
};

use facewire_packet::Packet;

use super::{LinkCounts, LinkError};
use crate::config::Address;

/// A socket and where its packets go.
#[derive(Debug)]
pub struct UdpLink {
    socket: UdpSocket,
    receiver: SocketAddr,
    counts: LinkCounts,
}

impl UdpLink {
    /// Resolves the address and opens a socket that may broadcast and never blocks.
    ///
    /// # Errors
    /// The host does not resolve, or there is no socket.
    pub fn open(address: &Address) -> Result<Self, LinkError> {
        let receiver =
            resolved(address).map_err(|reason| LinkError::Resolve { address: address.to_string(), reason })?;
        let socket = socket_for(receiver).map_err(|error| LinkError::Socket { address: address.to_string(), error })?;
        Ok(Self { socket, receiver, counts: LinkCounts::default() })
    }

    /// Where packets go.
    #[must_use]
    pub fn receiver(&self) -> SocketAddr {
        self.receiver
    }

    /// Sends the packet or drops it.
    pub fn send(&mut self, packet: &Packet) {
        let counter = match self.socket.send_to(&packet.encode(), self.receiver) {
            Ok(_) => &mut self.counts.sent,
            Err(_) => &mut self.counts.dropped,
        };
        *counter = counter.wrapping_add(1);
    }

    /// What became of the packets so far.
    #[must_use]
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }
}

/// The first address of the host, of IPv4 if it has one: a small receiver seldom listens to IPv6, and "localhost"
/// would else be one.
fn resolved(address: &Address) -> Result<SocketAddr, String> {
    let found = address.as_str().to_socket_addrs().map_err(|error| error.to_string())?;
    let first = found.min_by_key(SocketAddr::is_ipv6);
    first.ok_or_else(|| "it has no address".to_owned())
}

fn socket_for(receiver: SocketAddr) -> io::Result<UdpSocket> {
    let socket = match receiver {
        SocketAddr::V4(_) => UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?,
        SocketAddr::V6(_) => UdpSocket::bind((Ipv6Addr::UNSPECIFIED, 0))?,
    };
    socket.set_nonblocking(true)?;
    if receiver.is_ipv4() {
        socket.set_broadcast(true)?;
    }
    Ok(socket)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::Duration;

    use facewire_packet::{PACKET_BYTES, State};

    use super::*;

    fn open(address: &str) -> UdpLink {
        UdpLink::open(&Address::new(address).unwrap()).unwrap()
    }

    fn receiver(address: &str) -> UdpSocket {
        let socket = UdpSocket::bind(address).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        socket
    }

    #[test]
    fn a_packet_arrives_as_one_datagram() {
        for any in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(socket) = UdpSocket::bind(any) else {
                eprintln!("skipped {any}: this machine has no such address");
                continue;
            };
            socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
            let mut link = open(&socket.local_addr().unwrap().to_string());
            let packet = Packet { state: State::Live, sequence: 9, age_us: 100, ..Packet::NEUTRAL };
            link.send(&packet);
            let mut bytes = [0; 1024];
            let length = socket.recv(&mut bytes).unwrap();
            assert_eq!(length, PACKET_BYTES);
            assert_eq!(Packet::decode(bytes.get(..length).unwrap()), Ok(packet));
            assert_eq!(link.counts(), LinkCounts { sent: 1, dropped: 0 });
        }
    }

    #[test]
    fn a_receiver_that_comes_late_gets_what_is_sent_from_then_on() {
        let early = receiver("127.0.0.1:0");
        let address = early.local_addr().unwrap().to_string();
        drop(early);
        let mut link = open(&address);
        for _ in 0..10 {
            link.send(&Packet::NEUTRAL);
        }
        let late = receiver(&address);
        link.send(&Packet::NEUTRAL);
        assert_eq!(late.recv(&mut [0; 1024]).unwrap(), PACKET_BYTES);
        assert_eq!(link.counts(), LinkCounts { sent: 11, dropped: 0 });
    }

    #[test]
    fn what_the_network_refuses_is_counted_and_not_fatal() {
        let mut link = open("127.0.0.1:9");
        // An IPv4 socket cannot reach it, whatever routes this machine has.
        link.receiver = SocketAddr::from((Ipv6Addr::LOCALHOST, 9));
        link.send(&Packet::NEUTRAL);
        assert_eq!(link.counts(), LinkCounts { sent: 0, dropped: 1 });
    }

    #[test]
    fn broadcasting_is_allowed() {
        assert!(open("255.255.255.255:9").socket.broadcast().unwrap());
    }

    #[test]
    fn an_unknown_host_is_refused_with_its_address_and_what_to_check() {
        let error = UdpLink::open(&Address::new("nowhere.invalid:5252").unwrap()).unwrap_err();
        let text = error.to_string();
        assert!(text.starts_with("link nowhere.invalid:5252: the host does not resolve ("), "{text}");
        assert!(text.contains("check the spelling"), "{text}");
    }

    #[test]
    fn localhost_is_reached_by_ipv4() {
        assert!(open("localhost:5252").receiver().is_ipv4());
    }
}
