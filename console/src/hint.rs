//! What to write into facewire's settings, so that its packets come here.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};

use serde::Serialize;

use crate::{addresses, source::Source};

/// The port to which the default link of facewire sends.
const DEFAULT_PORT: u16 = 5252;

/// Where packets are expected, and the settings that send them there.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Hint {
    /// The port or the device.
    pub place: String,
    /// Settings for facewire, one for each way to reach this program.
    pub links: Vec<LinkHint>,
}

/// The lines of a link.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinkHint {
    /// Where facewire runs.
    pub sender: &'static str,
    /// The lines for its settings.
    pub lines: String,
}

impl Hint {
    /// Returns the hint for a source.
    pub fn of(source: &Source) -> Self {
        match source {
            Source::Udp { address, .. } => Self::of_udp(*address, &addresses::of_this_machine()),
            Source::Serial { device, baud } => Self {
                place: format!("{} with {baud} baud", device.display()),
                links: vec![LinkHint {
                    sender: "On the machine at the other end of the line, with the path of its serial port",
                    lines: format!("[[link]]\nkind = \"serial\"\ndevice = \"/dev/ttyUSB0\"\nbaud = {baud}\n"),
                }],
            },
        }
    }

    fn of_udp(address: SocketAddr, machine: &[IpAddr]) -> Self {
        let link = |sender, ip: IpAddr| LinkHint {
            sender,
            lines: format!("[[link]]\nkind = \"udp\"\naddress = \"{}\"\n", SocketAddr::new(ip, address.port())),
        };
        let ip = address.ip();
        let links = if ip.is_multicast() {
            vec![link("On any machine of this network", ip)]
        } else if ip.is_unspecified() {
            let others = machine.iter().map(|ip| link("If facewire runs on another machine", *ip));
            let here = if address.port() == DEFAULT_PORT {
                "If facewire runs on this machine, it sends here without any settings, which is the same as"
            } else {
                "If facewire runs on this machine"
            };
            [link(here, Ipv4Addr::LOCALHOST.into())].into_iter().chain(others).collect()
        } else if ip.is_loopback() {
            vec![link("On this machine", ip)]
        } else {
            vec![link("On this machine or another", ip)]
        };
        let place = if ip.is_unspecified() { format!("UDP port {}", address.port()) } else { format!("UDP {address}") };
        Self { place, links }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn addresses_of(address: &str) -> Vec<String> {
        let machine = ["192.168.1.5".parse().unwrap(), "2001:db8::5".parse().unwrap()];
        let hint = Hint::of_udp(address.parse().unwrap(), &machine);
        hint.links.iter().map(|link| link.lines.lines().last().unwrap().to_owned()).collect()
    }

    #[test]
    fn the_lines_name_addresses_that_lead_here() {
        let all =
            ["address = \"127.0.0.1:5252\"", "address = \"192.168.1.5:5252\"", "address = \"[2001:db8::5]:5252\""];
        assert_eq!(addresses_of("[::]:5252"), all);
        assert_eq!(addresses_of("127.0.0.1:6000"), ["address = \"127.0.0.1:6000\""]);
        assert_eq!(addresses_of("239.1.2.3:7000"), ["address = \"239.1.2.3:7000\""]);
    }
}
