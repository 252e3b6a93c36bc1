//! Ports that programs of a test use, and that no other program of this machine can take meanwhile.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, TcpListener};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, socket_with, sockopt};

use super::PATIENCE;

/// A TCP port on which the programs of one test may listen, one after the other. A socket that is bound to the port but does
/// not listen keeps the system from giving it to another program. The programs must set `SO_REUSEADDR`, as almost all do.
pub struct HeldPort(TcpListener);

impl HeldPort {
    pub fn new() -> Self {
        let socket = socket_with(AddressFamily::INET, SocketType::STREAM, SocketFlags::CLOEXEC, None).unwrap();
        sockopt::set_socket_reuseaddr(&socket, true).unwrap();
        bind(&socket, &SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0)).unwrap();
        Self(socket.into())
    }

    pub fn address(&self) -> SocketAddr {
        self.0.local_addr().unwrap()
    }
}

/// Waits until this process has bound a UDP port of 127.0.0.1, and returns its number. The process may leave the choice of
/// the port to the system.
pub fn udp_port_of(process: u32) -> u16 {
    let begun = Instant::now();
    loop {
        if let Some(port) = bound_udp_port(process) {
            return port;
        }
        assert!(begun.elapsed() < PATIENCE, "process {process} has bound no UDP port");
        sleep(Duration::from_millis(5));
    }
}

/// 127.0.0.1 and the colon before the port in `/proc/net/udp`, on a little-endian machine.
const LOOPBACK: &str = "0100007F:";

/// The kernel lists the ports of all processes by the numbers of their sockets, which `/proc/PID/fd` names.
fn bound_udp_port(process: u32) -> Option<u16> {
    let descriptors = fs::read_dir(format!("/proc/{process}/fd")).ok()?;
    let targets: Vec<String> = descriptors
        .filter_map(|descriptor| Some(fs::read_link(descriptor.ok()?.path()).ok()?.to_string_lossy().into_owned()))
        .collect();
    let table = fs::read_to_string(format!("/proc/{process}/net/udp")).ok()?;
    table.lines().skip(1).find_map(|line| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let (local, socket) = (fields.get(1)?, format!("socket:[{}]", fields.get(9)?));
        let port = local.strip_prefix(LOOPBACK)?;
        if targets.contains(&socket) { u16::from_str_radix(port, 16).ok() } else { None }
    })
}
