//! UDP: one message, one datagram.
//!
//! The socket is not connected. An ICMP error from a receiver that is not running yet, a route that appears late, and
//! a change of this machine's own address therefore do not break the link.

use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs as _, UdpSocket},
    sync::Arc,
    time::Duration,
};

use triple_buffer::{Output as Newest, TripleBuffer};

use super::{
    Carrier, LinkError, Traffic,
    lookup::{Lookup, choose},
};
use crate::config::Address;

/// Time from one successful look-up of a host name to the next.
const LOOKUP_PERIOD: Duration = Duration::from_secs(5);

/// A receiver, and a socket for it.
#[derive(Debug)]
pub struct Destination {
    socket: UdpSocket,
    receiver: SocketAddr,
}

/// Datagrams to one address.
#[derive(Debug)]
pub struct UdpCarrier {
    destination: Newest<Option<Destination>>,
    /// `None` for an address in numbers.
    lookup: Option<Lookup>,
    traffic: Arc<Traffic>,
    refusal: Option<i32>,
}

impl UdpCarrier {
    /// Opens a carrier to `address`. Messages are dropped until the host name is found.
    ///
    /// # Errors
    /// Returns an error if the system refuses a socket for an address in numbers, or a thread to look up a host name.
    pub fn open(address: &Address, traffic: Arc<Traffic>) -> Result<Self, LinkError> {
        Self::open_with(address, traffic, system_resolver, LOOKUP_PERIOD)
    }

    fn open_with<R>(address: &Address, traffic: Arc<Traffic>, resolve: R, period: Duration) -> Result<Self, LinkError>
    where
        R: Fn(&Address) -> io::Result<Vec<SocketAddr>> + Send + 'static,
    {
        let (mut input, destination) = TripleBuffer::default().split();
        let lookup = if let Ok(receiver) = address.as_str().parse() {
            input.write(Some(Destination::new(address, receiver)?));
            None
        } else {
            Some(Lookup::start(address.clone(), resolve, period, input)?)
        };
        Ok(Self { destination, lookup, traffic, refusal: None })
    }
}

impl Carrier for UdpCarrier {
    fn send(&mut self, message: &[u8]) {
        let destination = self.destination.read().as_ref();
        let sent = destination.map(|to| to.socket.send_to(message, to.receiver));
        let is_sent = matches!(sent, Some(Ok(_)));
        Traffic::count(if is_sent { &self.traffic.sent } else { &self.traffic.dropped });
        // A full buffer drops this message and says nothing about the network.
        let error = sent.and_then(Result::err).filter(|error| error.kind() != io::ErrorKind::WouldBlock);
        self.refusal = error.and_then(|error| error.raw_os_error());
    }

    /// Whether the address is known and the network took the last message.
    fn is_open(&self) -> bool {
        self.destination.peek_output_buffer().is_some() && self.refusal.is_none()
    }

    fn refusal(&self) -> Option<i32> {
        self.refusal
    }

    fn refresh(&self) {
        self.lookup.iter().for_each(Lookup::refresh);
    }
}

impl Destination {
    /// Opens a socket for the receiver that never blocks and may broadcast.
    ///
    /// # Errors
    /// Returns an error if the system refuses a socket.
    pub fn new(address: &Address, receiver: SocketAddr) -> Result<Self, LinkError> {
        let may_broadcast = |socket: UdpSocket| {
            if receiver.is_ipv4() {
                socket.set_broadcast(true)?;
            }
            Ok(socket)
        };
        let socket = socket_for(receiver).and_then(may_broadcast);
        let socket = socket.map_err(|error| LinkError::Socket { address: address.to_string(), error })?;
        Ok(Self { socket, receiver })
    }
}

/// Tests whether this machine has a route to the address at this moment. Nothing is sent.
///
/// # Errors
/// Returns an error if the host does not resolve, the system refuses a socket, or there is no route.
pub fn check(address: &Address) -> Result<(), LinkError> {
    let Destination { socket, receiver } = Destination::new(address, resolve(address)?)?;
    socket.connect(receiver).map_err(|error| LinkError::Route { address: address.to_string(), error })
}

/// Looks up the address.
///
/// # Errors
/// Returns an error if the host does not resolve.
pub fn resolve(address: &Address) -> Result<SocketAddr, LinkError> {
    choose(address, system_resolver(address), None)
}

fn system_resolver(address: &Address) -> io::Result<Vec<SocketAddr>> {
    address.as_str().to_socket_addrs().map(Iterator::collect)
}

/// Opens a socket for datagrams to this receiver that never blocks.
pub fn socket_for(receiver: SocketAddr) -> io::Result<UdpSocket> {
    let socket = match receiver {
        SocketAddr::V4(_) => UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?,
        SocketAddr::V6(_) => UdpSocket::bind((Ipv6Addr::UNSPECIFIED, 0))?,
    };
    socket.set_nonblocking(true)?;
    Ok(socket)
}

#[cfg(test)]
mod tests;
