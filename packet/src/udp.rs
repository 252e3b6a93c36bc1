//! A socket for packets by UDP, also from multicast groups.

use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};

use nix::errno::Errno;
use socket2::{Domain, InterfaceIndexOrAddress, Protocol, Socket, Type};

/// Binds the address, and joins the group if it is one, at the interface of this index; 0 leaves the choice to the system.
///
/// The unspecified address of IPv6 receives IPv4 as well, and stands for that of IPv4 on a system without IPv6. Other programs
/// can join the same group, but cannot share another address.
///
/// # Errors
///
/// If the address is taken or not one of this machine, or the group cannot be joined.
pub fn bind(address: SocketAddr, interface: u32) -> io::Result<UdpSocket> {
    bind_exactly(address, interface).or_else(|error| {
        let is_without_v6 = error.raw_os_error() == Some(Errno::EAFNOSUPPORT as i32);
        let is_any = address.is_ipv6() && address.ip().is_unspecified();
        if is_without_v6 && is_any {
            bind_exactly((Ipv4Addr::UNSPECIFIED, address.port()).into(), interface)
        } else {
            Err(error)
        }
    })
}

fn bind_exactly(address: SocketAddr, interface: u32) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::for_address(address), Type::DGRAM, Some(Protocol::UDP))?;
    if address.is_ipv6() {
        socket.set_only_v6(!address.ip().is_unspecified())?;
    }
    // Each member of a group on this machine gets every datagram. Without a group, a second program on the port would take
    // the packets away from the first.
    socket.set_reuse_address(address.ip().is_multicast())?;
    socket.bind(&address.into())?;
    match address.ip() {
        IpAddr::V4(group) if group.is_multicast() => {
            socket.join_multicast_v4_n(&group, &InterfaceIndexOrAddress::Index(interface))?;
        }
        IpAddr::V6(group) if group.is_multicast() => socket.join_multicast_v6(&group, interface)?,
        _ => {}
    }
    Ok(socket.into())
}
