//! Receives datagrams on a thread of its own, and tells of those that are refused.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use facewire_packet::PACKET_BYTES;
use nix::net::if_::if_nametoindex;
use socket2::{Domain, InterfaceIndexOrAddress, Protocol, Socket, Type};

use crate::{
    Failure,
    fleet::{Refusal, Shared, Taken},
    say,
    settings::Settings,
};

/// Time until a socket that failed is read again.
const PAUSE: Duration = Duration::from_millis(200);
/// What the kernel keeps while this program does not run: half a second of 60 boards. It gives less if its limit is lower.
const BUFFER_BYTES: usize = 1 << 20;

/// Binds the port and joins the group, if the address is one.
pub fn bind(settings: &Settings) -> Result<UdpSocket, Failure> {
    let address = settings.udp;
    let index = settings
        .interface
        .as_deref()
        .map_or(Ok(0), |name| if_nametoindex(name).map_err(|_| Failure::Interface(name.to_owned())))?;
    let bound = bound(address, index).or_else(|error| {
        // Without IPv6, the unspecified address means that of IPv4.
        let is_any = address.is_ipv6() && address.ip().is_unspecified();
        if is_any && error.raw_os_error() == Some(nix::libc::EAFNOSUPPORT) {
            self::bound((Ipv4Addr::UNSPECIFIED, address.port()).into(), index)
        } else {
            Err(error)
        }
    });
    bound.map_err(|error| Failure::Receive { address, error })
}

fn bound(address: SocketAddr, interface: u32) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::for_address(address), Type::DGRAM, Some(Protocol::UDP))?;
    if address.is_ipv6() {
        socket.set_only_v6(!address.ip().is_unspecified())?;
    }
    // Each member of a group on this machine gets every datagram. Without a group, a second program on the port would take
    // the packets away from the first.
    socket.set_reuse_address(address.ip().is_multicast())?;
    socket.set_recv_buffer_size(BUFFER_BYTES)?;
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

/// Starts to read.
pub fn start(socket: UdpSocket, shared: Arc<Shared>) -> io::Result<()> {
    thread::Builder::new().name("receive".to_owned()).spawn(move || read(&socket, &shared))?;
    Ok(())
}

/// Reads datagrams for as long as the program runs.
fn read(socket: &UdpSocket, shared: &Shared) {
    // One byte more than a packet, so that longer datagrams are refused.
    let mut bytes = [0; PACKET_BYTES + 1];
    loop {
        match socket.recv_from(&mut bytes) {
            Ok((length, from)) => {
                let datagram = bytes.get(..length).unwrap_or_default();
                let mut fleet = shared.lock();
                match fleet.take(from.ip(), from.port(), datagram, Instant::now()) {
                    Taken::Newest => shared.ring(),
                    Taken::Late => {}
                    Taken::Added(at) => {
                        let name = fleet.boards.get(at).map(|board| board.name.clone()).unwrap_or_default();
                        drop(fleet);
                        say(&format!("{name} is new, from {}", from.ip().to_canonical()));
                        shared.ring();
                    }
                    Taken::Refused(why, count) => {
                        drop(fleet);
                        tell(why, count, from.ip().to_canonical());
                    }
                }
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => {
                say(&format!("the network fails ({error}); check that it is up"));
                thread::sleep(PAUSE);
            }
        }
    }
}

/// Tells of a refused datagram: of the first, second, fourth, eighth and so on, so that a flood makes few lines.
fn tell(why: Refusal, count: u64, from: IpAddr) {
    if !count.is_power_of_two() {
        return;
    }
    say(&match why {
        Refusal::Stranger => {
            format!("{from} is no named board: {count} packets refused. Name it, or set accept_others = true")
        }
        Refusal::Surplus => format!(
            "{from} is one board too many: {count} packets refused. Raise most_boards, or start again to forget old addresses"
        ),
        Refusal::Damaged(fault) => format!("{count} damaged datagrams, the last from {from}: {fault}"),
    });
}
