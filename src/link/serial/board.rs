//! What the vendor and product numbers of USB devices tell about serial ports: which is the board for `device = "auto"`,
//! and which board restarts when its port is opened.
//!
//! A board is chosen only if it is the only one. A line to a modem, a printer or a radio must not carry packets by
//! surprise, so an adapter that anything may be connected to is never chosen. A board that was chosen before is chosen
//! again, and is waited for while its power is off for a moment.
//!
//! Limits: ports must have their names from the kernel and from udev. A board at the pins of a UART is not recognised.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use facewire_board::{Attached, UsbId, attached, links_to, restarts};
use serialport::{SerialPortInfo, SerialPortType, available_ports};

use crate::config::SerialDevice;
use crate::link::{LinkError, LinkErrorKind};

/// Links to the serial ports of USB devices, with names that stay with the device.
const LINKS: &str = "/dev/serial/by-id";
/// How long another board does not take the place of the chosen one: a board whose servos draw too much current is away
/// for some seconds.
const REPLACE_AFTER: Duration = Duration::from_secs(30);

/// Whether opening this port restarts the board behind it, if DTR was low.
pub fn restarts_board(device: &Path) -> bool {
    let node = device.canonicalize().unwrap_or_default();
    let found = usb_ports().find(|(port, _)| *port == node);
    restarts(&node, found.map(|(_, numbers)| numbers).unwrap_or_default())
}

pub struct PortSearch {
    device: SerialDevice,
    wanted: Attached,
    chosen: Option<PathBuf>,
    missed_at: Option<Instant>,
}

impl PortSearch {
    /// `wanted` is what "auto" stands for.
    pub fn new(device: &SerialDevice, wanted: Attached) -> Self {
        Self { device: device.clone(), wanted, chosen: None, missed_at: None }
    }

    /// Returns the path of the port. A path in the settings need not lead to a device.
    pub fn find(&mut self) -> Result<PathBuf, LinkError> {
        match &self.device {
            SerialDevice::Path(path) => Ok(path.clone()),
            SerialDevice::Auto => self.choose(stable_ports(), Instant::now()),
        }
    }

    /// Chooses among the boards at these ports, and names the others if there is no board.
    fn choose(&mut self, ports: Vec<(PathBuf, UsbId)>, now: Instant) -> Result<PathBuf, LinkError> {
        let [mut boards, others] = sorted(ports, self.wanted);
        let error = |kind, sentence: &str| Err(LinkError::new(kind, "auto", sentence));
        if let Some(chosen) = &self.chosen {
            if boards.contains(chosen) {
                boards = vec![chosen.clone()];
            } else if now.duration_since(*self.missed_at.get_or_insert(now)) < REPLACE_AFTER && !boards.is_empty() {
                let away = format!("waits for {}; another board takes its place after half a minute", chosen.display());
                return error(LinkErrorKind::Other, &away);
            }
        }
        match boards.as_slice() {
            [board] => {
                self.chosen = Some(board.clone());
                self.missed_at = None;
                Ok(board.clone())
            }
            [] if self.wanted == Attached::Maestro => {
                error(LinkErrorKind::Waiting, "waits for a Pololu Maestro; none is plugged into USB")
            }
            [] => {
                let hint =
                    format!("; if your board is one of these, give its path as link.device: {}", joined(&others));
                let hint = if others.is_empty() { "" } else { &hint };
                let sentence = "waits for a microcontroller board; none of a known maker is plugged in";
                error(LinkErrorKind::Waiting, &[sentence, hint].concat())
            }
            boards => {
                let sentence = "more than one such board is plugged in; give the path of one as link.device: ";
                error(LinkErrorKind::Other, &[sentence, &joined(boards)].concat())
            }
        }
    }
}

fn joined(ports: &[PathBuf]) -> String {
    ports.iter().map(|port| port.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// Lists all serial ports. There is none if the system cannot list them.
pub fn serial_ports() -> Vec<SerialPortInfo> {
    // `available_ports` panics if this folder cannot be read.
    let ports = fs::read_dir("/sys/class/tty").ok().and_then(|_| available_ports().ok());
    ports.unwrap_or_default()
}

/// Lists the serial ports of USB devices by their nodes.
fn usb_ports() -> impl Iterator<Item = (PathBuf, UsbId)> {
    serial_ports().into_iter().filter_map(|port| match port.port_type {
        SerialPortType::UsbPort(usb) => Some((port.port_name.into(), (usb.vid, usb.pid))),
        _ => None,
    })
}

/// Lists the serial ports of USB devices by their stable paths.
fn stable_ports() -> Vec<(PathBuf, UsbId)> {
    let links = |(port, _): &(PathBuf, UsbId)| links_to(port, LINKS.as_ref());
    usb_ports().flat_map(|port| links(&port).into_iter().map(move |link| (link, port.1))).collect()
}

/// Returns the first port of each device: the wanted boards, and the others. A stable path has the name of the device, and
/// after `-if` the number of the port.
fn sorted(mut ports: Vec<(PathBuf, UsbId)>, wanted: Attached) -> [Vec<PathBuf>; 2] {
    let device = |path: &Path| {
        let path = path.to_string_lossy();
        path.rsplit_once("-if").map_or(path.to_string(), |(device, _)| device.to_owned())
    };
    ports.sort();
    ports.dedup_by(|(later, _), (earlier, _)| device(later) == device(earlier));
    // A Maestro is not among the others, because the message would recommend its path.
    ports.retain(|(_, numbers)| attached(*numbers) != Some(Attached::Maestro) || wanted == Attached::Maestro);
    let (boards, others): (Vec<_>, _) = ports.into_iter().partition(|(_, numbers)| attached(*numbers) == Some(wanted));
    [boards, others].map(|ports| ports.into_iter().map(|(path, _)| path).collect())
}

#[cfg(test)]
mod tests {
    use Attached::{Maestro, Microcontroller};

    use super::*;

    /// The ports of devices with these names and numbers. Each device has two.
    fn ports(devices: &[(&str, UsbId)]) -> Vec<(PathBuf, UsbId)> {
        let ports = ["-if02", "-if00"].iter().flat_map(|port| devices.iter().map(move |device| (port, device)));
        ports.map(|(port, (name, numbers))| (format!("{name}{port}").into(), *numbers)).collect()
    }

    /// Asserts that this device is found among others, or none, and that the message names these devices.
    fn finds(devices: &[(&str, UsbId)], wanted: Attached, found: Option<&str>, named: &str) {
        let result = PortSearch::new(&SerialDevice::Auto, wanted).choose(ports(devices), Instant::now());
        assert_eq!(result.as_ref().ok(), found.map(|name| format!("{name}-if00").into()).as_ref(), "{result:?}");
        let message = result.err().map(|error| error.message).unwrap_or_default();
        assert!(message.ends_with(named) && message.contains(".device") != named.is_empty(), "{message}");
    }

    #[test]
    fn the_only_board_is_found_by_its_maker_among_ports_that_anything_may_be_connected_to() {
        finds(&[], Microcontroller, None, "");
        let mut devices =
            vec![("CH340", (0x1a86, 0x7523)), ("Probe", (0x2e8a, 0x000c)), ("Keyboard", (0x16c0, 0x27dd))];
        finds(&devices, Microcontroller, None, ": CH340-if00, Keyboard-if00, Probe-if00");
        devices.push(("Maestro", (0x1ffb, 0x008a)));
        finds(&devices, Maestro, Some("Maestro"), "");
        // A Maestro would take packets for commands, so that its path is not recommended.
        finds(&devices, Microcontroller, None, ": CH340-if00, Keyboard-if00, Probe-if00");
        devices.push(("Teensy", (0x16c0, 0x0483)));
        finds(&devices, Microcontroller, Some("Teensy"), "");
        finds(&devices, Maestro, Some("Maestro"), "");
        finds(&devices[..3], Maestro, None, "");
    }

    #[test]
    fn of_several_boards_none_is_taken_but_the_one_that_is_in_use_is_kept() {
        let head = ("Head", (0x2341, 0x0043));
        let other = ("Other", (0x239a, 0x80f4));
        let now = Instant::now();
        // Somebody must choose.
        finds(&[head, other], Microcontroller, None, ": Head-if00, Other-if00");
        let mut search = PortSearch::new(&SerialDevice::Auto, Microcontroller);
        let mut find = |devices: &[(&str, UsbId)], now| search.choose(ports(devices), now);
        assert_eq!(find(&[head], now), Ok("Head-if00".into()));
        assert_eq!(find(&[head, other], now), Ok("Head-if00".into()));
        // A board that is away for seconds is waited for, and later another takes its place.
        let days_later = |s| now + Duration::from_hours(100) + Duration::from_secs(s);
        let away = [0, 29].map(|s| find(&[other], days_later(s)).unwrap_err());
        assert!(away[1].message.contains("waits for Head-if00"), "{away:?}");
        assert_eq!(find(&[other], days_later(30)), Ok("Other-if00".into()));
    }
}
