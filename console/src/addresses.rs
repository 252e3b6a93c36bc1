//! The addresses of this machine.

use std::net::{IpAddr, SocketAddr};

use nix::{ifaddrs::getifaddrs, net::if_::InterfaceFlags};

/// The most addresses that are shown.
const MOST: usize = 4;

/// Returns the addresses under which other machines reach this one, IPv4 first, as many as are shown.
pub fn of_this_machine() -> Vec<IpAddr> {
    let mut found = all();
    found.retain(is_reachable);
    found.truncate(MOST);
    found
}

/// Returns all addresses of this machine, IPv4 first.
pub fn all() -> Vec<IpAddr> {
    let interfaces = getifaddrs().into_iter().flatten();
    let mut found: Vec<IpAddr> = interfaces
        .filter(|interface| interface.flags.contains(InterfaceFlags::IFF_UP))
        .filter_map(|interface| {
            let address = interface.address?;
            let v4 = address.as_sockaddr_in().map(|address| IpAddr::V4(address.ip()));
            v4.or_else(|| address.as_sockaddr_in6().map(|address| IpAddr::V6(address.ip())))
        })
        .collect();
    found.sort_by_key(IpAddr::is_ipv6);
    found.dedup();
    found
}

/// Whether other machines can use the address as it is. A link-local address needs the name of an interface, too.
fn is_reachable(address: &IpAddr) -> bool {
    match address {
        IpAddr::V4(v4) => !v4.is_loopback() && !v4.is_link_local(),
        IpAddr::V6(v6) => !v6.is_loopback() && !v6.is_unicast_link_local(),
    }
}

/// Returns the addresses of the page, which end with this path: all of this machine's if it is served at all of them.
pub fn urls(address: SocketAddr, path: &str) -> Vec<String> {
    let mut hosts = if address.ip().is_unspecified() { of_this_machine() } else { vec![address.ip()] };
    if address.is_ipv4() {
        hosts.retain(IpAddr::is_ipv4);
    }
    if hosts.is_empty() {
        hosts.push(IpAddr::from([127, 0, 0, 1]));
    }
    hosts.into_iter().map(|host| format!("http://{}/{path}", SocketAddr::new(host, address.port()))).collect()
}
