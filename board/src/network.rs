//! The identifier of this machine, and remedies for a host name that does not resolve.

use std::fs;
use std::net::IpAddr;

/// Returns an identifier of this installation, or of the time since the last start if the system has none. It is secret: hash
/// it before it leaves the machine.
#[must_use]
pub fn machine_id() -> String {
    let files = ["/etc/machine-id", "/proc/sys/kernel/random/boot_id"];
    let ids = files.iter().filter_map(|file| fs::read_to_string(file).ok());
    ids.map(|id| id.trim().to_owned()).find(|id| !id.is_empty()).unwrap_or_default()
}

/// Says what may help if a host does not resolve.
#[must_use]
pub fn name_server_remedy() -> String {
    let files = ["/proc/self/cgroup", "/etc/resolv.conf"].map(|path| fs::read_to_string(path).unwrap_or_default());
    remedy(files.each_ref().map(String::as_str))
}

/// `cgroup` and `resolver` are `/proc/self/cgroup` and `/etc/resolv.conf`.
///
/// The unit allows nearby addresses only. A name server elsewhere then gets no question, and the C library reports a
/// temporary failure.
fn remedy([cgroup, resolver]: [&str; 2]) -> String {
    let is_service = cgroup.lines().any(|line| line.contains(":/system.slice/") && line.ends_with(".service"));
    let server = |line: &str| {
        let address = line.trim().strip_prefix("nameserver")?.split_whitespace().next()?;
        address.split('%').next()?.parse().ok()
    };
    let far = resolver.lines().filter_map(server).find(|server| !is_nearby(*server)).filter(|_| is_service);
    let blocked = far.map(|server| {
        format!(
            ". If the unit keeps the service from the name server {server}, add it to the drop-in name-server.conf \
             (docs/reference.md)"
        )
    });
    format!("check the spelling and the network, or give its address in numbers{}", blocked.unwrap_or_default())
}

fn is_nearby(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(it) => it.is_loopback() || it.is_private() || it.is_link_local() || it.is_unspecified(),
        IpAddr::V6(it) => it.is_loopback() || it.is_unique_local() || it.is_unicast_link_local() || it.is_unspecified(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_the_unit_a_name_server_at_a_public_address_is_named_with_the_drop_in() {
        // 100.100.100.100 is a name server of private networks that use the shared range 100.64.0.0/10.
        let far = ["9.9.9.9", "2620:fe::fe", "100.100.100.100"].map(|server| (server, true));
        let near = ["127.0.0.53", "192.168.1.1", "172.20.0.1", "fe80::1%eth0", "fd00::1", "::1"];
        for (server, is_named) in far.into_iter().chain(near.map(|server| (server, false))) {
            let resolver =
                format!("# nameserver 8.8.8.8\nsearch lan\nnameserver 10.0.0.1\nnameserver\t{server}\noptions edns0\n");
            let [unit, user] = ["0::/system.slice/facewire.service\n", "0::/user.slice/session-3.scope\n"]
                .map(|cgroup| remedy([cgroup, &resolver]));
            let name = format!("the name server {server}, add it to the drop-in name-server.conf");
            assert_eq!((unit.contains(&name), unit.contains("drop-in")), (is_named, is_named), "{unit}");
            assert!(unit.contains("check the spelling") && !user.contains("drop-in"), "{unit} {user}");
        }
    }
}
