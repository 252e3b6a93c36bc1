//! Receives datagrams on a thread of its own, and tells of those that are refused.

use std::{
    io,
    net::{IpAddr, SocketAddr, UdpSocket},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use facewire_packet::{PACKET_BYTES, udp};
use nix::net::if_::if_nametoindex;
use socket2::SockRef;

use crate::{
    Failure,
    fleet::{Refusal, Shared, Taken},
    say,
    settings::Settings,
};

/// Time until a network that is away is tried again.
const PAUSE: Duration = Duration::from_secs(1);
/// What the kernel keeps while this program does not run: half a second of 60 boards. It gives less if its limit is lower.
const BUFFER_BYTES: usize = 1 << 20;

/// Starts to receive. A port that is taken is an error; a network or an interface that is away is waited for.
pub fn start(settings: &Settings, shared: Arc<Shared>) -> Result<(), Failure> {
    let (address, interface) = (settings.udp, settings.interface.clone());
    let mut bound = bind(address, interface.as_deref());
    if let Err(error) = &bound
        && matches!(error.kind(), io::ErrorKind::AddrInUse | io::ErrorKind::PermissionDenied)
    {
        return bound.map(drop).map_err(|error| Failure::Receive { address, error });
    }
    let receive = move || {
        let mut is_told = false;
        loop {
            let error = match bound {
                Ok(socket) => {
                    is_told = false;
                    read(&socket, &shared)
                }
                Err(error) => error,
            };
            if !is_told {
                say(&format!("cannot receive at {address} ({error}); check network and --interface. Trying again"));
                is_told = true;
            }
            thread::sleep(PAUSE);
            bound = bind(address, interface.as_deref());
        }
    };
    let spawned = thread::Builder::new().name("receive".to_owned()).spawn(receive);
    spawned.map(drop).map_err(|error| Failure::System { what: "a thread", error })
}

/// Binds the port and joins the group, if the address is one.
fn bind(address: SocketAddr, interface: Option<&str>) -> io::Result<UdpSocket> {
    let index = interface.map_or(Ok(0), if_nametoindex)?;
    let socket = udp::bind(address, index)?;
    SockRef::from(&socket).set_recv_buffer_size(BUFFER_BYTES)?;
    Ok(socket)
}

/// Reads datagrams until the socket fails, and returns why.
fn read(socket: &UdpSocket, shared: &Shared) -> io::Error {
    // One byte more than a packet, so that longer datagrams are refused.
    let mut bytes = [0; PACKET_BYTES + 1];
    loop {
        let (length, from) = match socket.recv_from(&mut bytes) {
            Ok((length, from)) => (length, from),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return error,
        };
        let (datagram, address) = (bytes.get(..length).unwrap_or_default(), from.ip().to_canonical());
        let taken = shared.lock().take(address, from.port(), datagram, Instant::now());
        match taken {
            Taken::Newest => shared.ring(),
            Taken::Late => {}
            Taken::Added(name) => say(&format!("{name} is new, from {address}")),
            // A flood makes few lines: the first, second, fourth, eighth and so on.
            Taken::Refused(why, count) if count.is_power_of_two() => say(&refusal(why, count, address)),
            Taken::Refused(..) => {}
        }
    }
}

fn refusal(why: Refusal, count: u64, from: IpAddr) -> String {
    match why {
        Refusal::Stranger => {
            format!(
                "packets refused because their board has no name: {count}, the last from {from}. Name it, or set accept_others = true"
            )
        }
        Refusal::Surplus => format!(
            "packets refused because there are too many boards: {count}, the last from {from}. Raise most_boards, or restart the \
             bridge to forget old addresses"
        ),
        Refusal::Damaged(fault) => format!("damaged datagrams: {count}, the last from {from}: {fault}"),
    }
}
