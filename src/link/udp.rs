//! UDP: one packet, one datagram.
//!
//! The socket is not connected, so that a receiver that is not there yet (an ICMP refusal), a route that comes late and
//! a change of this machine's own address cannot break the link. A name is looked up until it is found, on a thread of
//! its own, because the network may come up after the service and the answer may take seconds; then once and for all.

use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket},
    sync::{Arc, OnceLock, Weak},
    thread,
};

use facewire_packet::Packet;

use super::{LinkCounts, LinkError};
use crate::config::Address;
use crate::retry::Retry;

/// A socket and where its packets go.
#[derive(Debug)]
struct Way {
    socket: UdpSocket,
    receiver: SocketAddr,
}

/// Packets to one address.
#[derive(Debug)]
pub struct UdpLink {
    way: Arc<OnceLock<Way>>,
    counts: LinkCounts,
    /// Why the network did not take the last packet, as the system's number.
    refusal: Option<i32>,
}

impl UdpLink {
    /// Opens a socket that may broadcast and never blocks, at once for an address in numbers, and else when the name is
    /// found.
    ///
    /// # Errors
    /// There is no socket for the address in numbers, or no thread to look up the name.
    pub fn open(address: &Address) -> Result<Self, LinkError> {
        let in_numbers = address.as_str().parse::<SocketAddr>().is_ok();
        let way = Arc::new(if in_numbers { OnceLock::from(Way::find(address)?) } else { OnceLock::new() });
        if !in_numbers {
            look_up(Arc::downgrade(&way), address.clone())?;
        }
        Ok(Self { way, counts: LinkCounts::default(), refusal: None })
    }

    /// Where packets would go if the link opened at this moment.
    ///
    /// # Errors
    /// The host does not resolve, or there is no socket.
    pub fn find(address: &Address) -> Result<SocketAddr, LinkError> {
        Way::find(address).map(|way| way.receiver)
    }

    /// Whether this machine has a way there at this moment. Nothing is sent.
    ///
    /// # Errors
    /// As [`UdpLink::find`], or no network leads there.
    pub fn check(address: &Address) -> Result<(), LinkError> {
        let Way { socket, receiver } = Way::find(address)?;
        socket.connect(receiver).map_err(|error| LinkError::Route { address: address.to_string(), error })
    }

    /// Whether it is known where packets go, and the network takes them.
    #[must_use]
    pub fn is_open(&self) -> bool {
        self.way.get().is_some() && self.refusal.is_none()
    }

    /// Why the network did not take the last packet.
    #[must_use]
    pub fn refusal(&self) -> Option<i32> {
        self.refusal
    }

    /// Sends the packet or drops it.
    pub fn send(&mut self, packet: &Packet) {
        let sent = self.way.get().map(|way| way.socket.send_to(&packet.encode(), way.receiver));
        let counter = if let Some(Ok(_)) = sent { &mut self.counts.sent } else { &mut self.counts.dropped };
        *counter = counter.wrapping_add(1);
        self.refusal = sent.and_then(|sent| sent.err()?.raw_os_error());
    }

    /// What became of the packets so far.
    #[must_use]
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }
}

impl Way {
    fn find(address: &Address) -> Result<Self, LinkError> {
        let receiver =
            resolved(address).map_err(|reason| LinkError::Resolve { address: address.to_string(), reason })?;
        let socket = socket_for(receiver).map_err(|error| LinkError::Socket { address: address.to_string(), error })?;
        Ok(Self { socket, receiver })
    }
}

/// Looks for the way on a thread of its own until it is found, or the link is gone.
fn look_up(way: Weak<OnceLock<Way>>, address: Address) -> Result<(), LinkError> {
    let link = address.to_string();
    let look = move || {
        let mut retry = Retry::default();
        while let Some(way) = way.upgrade() {
            match Way::find(&address) {
                Ok(found) => return drop(way.set(found)),
                Err(error) => retry.warn(&error),
            }
            drop(way);
            thread::sleep(retry.wait());
        }
    };
    let thread = thread::Builder::new().name("fw-lookup".to_owned()).spawn(look);
    thread.map(drop).map_err(|error| LinkError::Thread { link, error })
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
                crate::skip::skip(&format!("this machine has no address {any}"));
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
        // An IPv4 socket cannot reach it, whatever routes this machine has.
        let receiver = SocketAddr::from((Ipv6Addr::LOCALHOST, 9));
        let way = Way { socket: UdpSocket::bind("127.0.0.1:0").unwrap(), receiver };
        let mut link = UdpLink { way: Arc::new(way.into()), counts: LinkCounts::default(), refusal: None };
        assert!(link.is_open());
        link.send(&Packet::NEUTRAL);
        assert_eq!(link.counts(), LinkCounts { sent: 0, dropped: 1 });
        assert!(!link.is_open() && link.refusal().is_some());
    }

    #[test]
    fn an_address_to_which_no_network_leads_is_told_with_what_to_check() {
        // It leads nowhere without the name of an interface. No IPv6 at all is another error.
        let error = UdpLink::check(&Address::new("[fe80::1]:5252").unwrap()).unwrap_err().to_string();
        let beginning = ["link [fe80::1]:5252: no network leads there (", "link [fe80::1]:5252: no socket ("];
        assert!(beginning.iter().any(|beginning| error.starts_with(beginning)), "{error}");
    }

    #[test]
    fn broadcasting_is_allowed() {
        let way = Way::find(&Address::new("255.255.255.255:9").unwrap()).unwrap();
        assert!(way.socket.broadcast().unwrap());
    }

    #[test]
    fn an_unknown_host_is_told_with_its_address_and_what_to_check() {
        let error = UdpLink::find(&Address::new("nowhere.invalid:5252").unwrap()).unwrap_err();
        let text = error.to_string();
        assert!(text.starts_with("link nowhere.invalid:5252: the host does not resolve ("), "{text}");
        assert!(text.contains("check the spelling"), "{text}");
    }

    #[test]
    fn packets_for_an_unknown_host_are_counted_as_dropped() {
        let mut link = open("nowhere.invalid:5252");
        link.send(&Packet::NEUTRAL);
        assert_eq!((link.is_open(), link.counts()), (false, LinkCounts { sent: 0, dropped: 1 }));
    }

    #[test]
    fn localhost_is_found_beside_the_service_and_reached_by_ipv4() {
        let socket = receiver("127.0.0.1:0");
        let mut link = open(&format!("localhost:{}", socket.local_addr().unwrap().port()));
        let mut tries = 0;
        while !link.is_open() {
            tries += 1;
            assert!(tries < 1000);
            thread::sleep(Duration::from_millis(10));
        }
        link.send(&Packet::NEUTRAL);
        assert_eq!(socket.recv(&mut [0; 1024]).unwrap(), PACKET_BYTES);
    }
}
