//! Packets by UDP, also from multicast groups.

use std::{
    io,
    net::{SocketAddr, UdpSocket},
    thread,
    time::Duration,
};

use facewire_packet::{PACKET_BYTES, Packet, udp};
use nix::net::if_::if_nametoindex;

use super::PacketCounter;
use crate::{Failure, snapshot::Sender};

/// Time until a socket that failed is read again.
const PAUSE: Duration = Duration::from_millis(200);

/// Binds the socket and joins the group, if the address is one.
///
/// Returns the socket with the address that it is bound to.
pub fn bind(address: SocketAddr, interface: Option<&str>) -> Result<(UdpSocket, SocketAddr), Failure> {
    let index =
        interface.map_or(Ok(0), |name| if_nametoindex(name).map_err(|_| Failure::Interface(name.to_owned())))?;
    let failed = |error| Failure::Receive { address, error };
    let socket = udp::bind(address, index).map_err(failed)?;
    let address = socket.local_addr().map_err(failed)?;
    Ok((socket, address))
}

/// Reads datagrams for as long as the program runs.
pub fn read(socket: &UdpSocket, mut counter: PacketCounter) {
    // One byte more than a packet, so that longer datagrams are refused.
    let mut bytes = [0; PACKET_BYTES + 1];
    loop {
        match socket.recv_from(&mut bytes) {
            Ok((length, from)) => {
                counter.take(Packet::decode(bytes.get(..length).unwrap_or_default()), Sender::Udp(from));
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => {
                counter.tell(Some(&format!("the network fails ({error}); check that it is up")));
                thread::sleep(PAUSE);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use socket2::{Domain, Socket, Type};

    use super::*;

    #[test]
    fn the_default_address_receives_ipv4() {
        let (socket, address) = bind("[::]:0".parse().unwrap(), None).unwrap();
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        sender.send_to(b"hello", (Ipv4Addr::LOCALHOST, address.port())).unwrap();
        let mut bytes = [0; 9];
        assert_eq!(socket.recv(&mut bytes).unwrap(), 5);
    }

    #[test]
    fn two_programs_can_join_a_group_but_not_share_a_port() {
        let group = |port| SocketAddr::from(([239, 255, 52, 52], port));
        let (_first, address) = bind(group(0), Some("lo")).unwrap();
        assert!(bind(address, Some("lo")).is_ok());
        let (_taken, address) = bind("127.0.0.1:0".parse().unwrap(), None).unwrap();
        let error = bind(address, None).unwrap_err().to_string();
        assert!(error.contains("give --udp another address"), "{error}");
    }

    #[test]
    fn a_group_delivers() {
        let (socket, address) = bind("239.255.52.52:0".parse().unwrap(), Some("lo")).unwrap();
        let sender = Socket::new(Domain::IPV4, Type::DGRAM, None).unwrap();
        sender.set_multicast_if_v4(&Ipv4Addr::LOCALHOST).unwrap();
        sender.send_to(b"hello", &address.into()).unwrap();
        let mut bytes = [0; 9];
        assert_eq!(socket.recv(&mut bytes).unwrap(), 5);
    }

    #[test]
    fn an_interface_that_does_not_exist_is_named() {
        let error = bind("239.255.52.52:0".parse().unwrap(), Some("nothere")).unwrap_err();
        assert_eq!(error.to_string(), "there is no network interface nothere; `ip link` lists them");
    }
}
