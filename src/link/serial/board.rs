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

use crate::config::{AutoDevice, SerialDevice};
use crate::link::{LinkError, LinkErrorKind};

/// Links to the serial ports of USB devices, with names that stay with the device.
const LINKS: &str = "/dev/serial/by-id";
pub const CLASS: &str = "/sys/class/tty";
/// Vendors of boards: Arduino (two numbers), Adafruit, Raspberry Pi, Espressif, SparkFun, Seeed, Pololu.
/// `systemd/99-facewire.rules` has the same numbers.
const VENDORS: [&str; 8] = ["2341", "2a03", "239a", "2e8a", "303a", "1b4f", "2886", "1ffb"];
/// Teensy, whose vendor number belongs to many makers. The ports of its boards have products that begin like this.
const TEENSY: (&str, &str) = ("16c0", "048");
/// Raspberry Pi's debug probes. Anything may be connected to their serial line.
/// Source: <https://github.com/raspberrypi/usb-pid>
const PROBES: [(&str, &str); 2] = [("2e8a", "0004"), ("2e8a", "000c")];
/// Pololu's Maestros: the Micro Maestro 6 and the Mini Maestros 12, 18 and 24. They would take packets for commands, so a
/// link for packets never chooses them. Their first port is the one for commands.
/// Source: the udev rules and the source of Pololu's Maestro software for Linux.
const MAESTROS: [(&str, &str); 4] = [("1ffb", "0089"), ("1ffb", "008a"), ("1ffb", "008b"), ("1ffb", "008c")];
/// Arduinos whose serial chip is a microcontroller that uses the driver of modems (`ttyACM`): vendors, and the products of
/// Uno, Uno Mini, Mega and Mega ADK.
/// Source: `boards.txt` of <https://github.com/arduino/ArduinoCore-avr>
const ARDUINO_VENDORS: [&str; 2] = ["2341", "2a03"];
const ARDUINOS: [&str; 11] = ["0001", "0043", "0243", "006a", "0062", "0010", "0042", "0210", "0242", "003f", "0044"];
/// Serial chips of WCH, such as the CH343, that use the driver of modems.
const MODEM_CHIPS: [(&str, &str); 2] = [("1a86", "55d3"), ("1a86", "55d4")];
/// How long another board does not take the place of the chosen one: a board whose servos draw too much current is away
/// for some seconds.
const REPLACE_AFTER: Duration = Duration::from_secs(30);

/// Whether a USB device with these numbers is a Maestro.
pub fn is_maestro(vendor: u16, product: u16) -> bool {
    MAESTROS.contains(&(format!("{vendor:04x}").as_str(), format!("{product:04x}").as_str()))
}

/// Whether opening this port restarts the board behind it, if DTR was low. `class` is the folder [`CLASS`].
///
/// Drivers of serial chips such as the CH340 name their ports `ttyUSB0`, or `ttyCH341USB0` if they come from the maker.
/// Whether the DTR of such a chip is connected is not known, so any board behind one counts. A board at another port
/// restarts only if the lists above contain it.
pub fn restarts_board(device: &Path, class: &Path) -> bool {
    let node = device.canonicalize().unwrap_or_default();
    let name = node.file_name().unwrap_or_default().to_string_lossy();
    let (vendor, product) = usb_device(&node, class).map(|device| numbers(&device)).unwrap_or_default();
    let (vendor, product) = (vendor.as_str(), product.as_str());
    let is_arduino = ARDUINO_VENDORS.contains(&vendor) && ARDUINOS.contains(&product);
    is_arduino || name.contains("USB") || MODEM_CHIPS.contains(&(vendor, product))
}

pub struct PortSearch {
    device: SerialDevice,
    wanted: AutoDevice,
    chosen: Option<PathBuf>,
    missed_at: Option<Instant>,
}

impl PortSearch {
    /// `wanted` is what "auto" stands for.
    pub fn new(device: &SerialDevice, wanted: AutoDevice) -> Self {
        Self { device: device.clone(), wanted, chosen: None, missed_at: None }
    }

    /// Returns the path of the port. A path in the settings need not lead to a device.
    pub fn find(&mut self) -> Result<PathBuf, LinkError> {
        match &self.device {
            SerialDevice::Path(path) => Ok(path.clone()),
            SerialDevice::Auto => self.choose(ports(self.wanted, Path::new(LINKS), Path::new(CLASS)), Instant::now()),
        }
    }

    /// Chooses among the boards, and names the others if there is no board.
    fn choose(&mut self, [mut boards, others]: [Vec<PathBuf>; 2], now: Instant) -> Result<PathBuf, LinkError> {
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
                (self.chosen, self.missed_at) = (Some(board.clone()), None);
                Ok(board.clone())
            }
            [] if self.wanted == AutoDevice::Maestro => {
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

/// Lists the serial ports of USB devices that have a link in `links`, by the stable path of the first port of each device:
/// the wanted boards, and the others.
fn ports(wanted: AutoDevice, links: &Path, class: &Path) -> [Vec<PathBuf>; 2] {
    let mut paths: Vec<PathBuf> =
        fs::read_dir(links).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    let mut devices: Vec<(PathBuf, PathBuf)> =
        paths.into_iter().filter_map(|path| Some((usb_device(&path, class)?, path))).collect();
    devices.dedup_by(|later, earlier| later.0 == earlier.0);
    let mut ports = [Vec::new(), Vec::new()];
    let [boards, others] = &mut ports;
    for (device, path) in devices {
        match auto_device(&device) {
            Some(found) if found == wanted => boards.push(path),
            // The message would recommend the path.
            Some(AutoDevice::Maestro) => {}
            _ => others.push(path),
        }
    }
    ports
}

/// Returns the folder of the USB device that the port belongs to: the nearest above the port that has a vendor.
fn usb_device(port: &Path, class: &Path) -> Option<PathBuf> {
    let node = fs::canonicalize(port).ok()?;
    let port = fs::canonicalize(class.join(node.file_name()?).join("device")).ok()?;
    let device = port.ancestors().find(|folder| folder.join("idVendor").exists())?;
    Some(device.to_owned())
}

fn numbers(device: &Path) -> (String, String) {
    let read = |name| fs::read_to_string(device.join(name)).unwrap_or_default().trim().to_owned();
    (read("idVendor"), read("idProduct"))
}

fn auto_device(device: &Path) -> Option<AutoDevice> {
    let (vendor, product) = numbers(device);
    let numbers = (vendor.as_str(), product.as_str());
    if MAESTROS.contains(&numbers) {
        return Some(AutoDevice::Maestro);
    }
    let is_teensy = vendor == TEENSY.0 && product.starts_with(TEENSY.1);
    let is_board = is_teensy || (VENDORS.contains(&vendor.as_str()) && !PROBES.contains(&numbers));
    is_board.then_some(AutoDevice::Microcontroller)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use tempfile::TempDir;

    use AutoDevice::{Maestro, Microcontroller};

    use super::*;

    /// A machine with USB devices, in a folder.
    struct Machine(TempDir);

    impl Machine {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            for name in ["by-id", "tty", "dev"] {
                fs::create_dir(folder.path().join(name)).unwrap();
            }
            Self(folder)
        }

        /// Plugs in a USB device with this name and these numbers, and ports with these nodes.
        fn plug(&self, name: &str, numbers: &str, nodes: &[&str]) {
            let (root, (vendor, product)) = (self.0.path(), numbers.split_once(':').unwrap());
            let device = root.join("usb").join(name);
            for (index, node) in nodes.iter().enumerate() {
                let (port, class) = (device.join(format!("1.{index}/port")), root.join("tty").join(node));
                [&port, &class].into_iter().for_each(|folder| fs::create_dir_all(folder).unwrap());
                symlink(port, class.join("device")).unwrap();
                fs::write(root.join("dev").join(node), "").unwrap();
                symlink(Path::new("../dev").join(node), root.join(format!("by-id/usb-{name}-if0{index}"))).unwrap();
            }
            fs::write(device.join("idVendor"), format!("{vendor}\n")).unwrap();
            fs::write(device.join("idProduct"), format!("{product}\n")).unwrap();
        }

        fn unplug(&self, name: &str) {
            fs::remove_file(self.link(name)).unwrap();
        }

        /// The first port of a device.
        fn link(&self, name: &str) -> PathBuf {
            self.0.path().join(format!("by-id/usb-{name}-if00"))
        }

        fn find(&self, search: &mut PortSearch, now: Instant) -> Result<PathBuf, LinkError> {
            search.choose(ports(search.wanted, &self.0.path().join("by-id"), &self.0.path().join("tty")), now)
        }

        /// Asserts that this device is found, or none, and that the message names these devices.
        fn finds(&self, wanted: AutoDevice, found: Option<&str>, named: &[&str]) {
            let result = self.find(&mut PortSearch::new(&SerialDevice::Auto, wanted), Instant::now());
            assert_eq!(result.as_ref().ok(), found.map(|name| self.link(name)).as_ref(), "{result:?}");
            let message = result.err().map(|error| error.message).unwrap_or_default();
            let named_paths = joined(&named.iter().map(|name| self.link(name)).collect::<Vec<_>>());
            assert!(message.ends_with(&named_paths) && message.contains(".device") != named.is_empty(), "{message}");
        }
    }

    #[test]
    fn the_only_board_is_found_by_its_maker_among_ports_that_anything_may_be_connected_to() {
        let machine = Machine::new();
        machine.finds(Microcontroller, None, &[]);
        machine.plug("1a86_Serial", "1a86:7523", &["ttyUSB0"]);
        machine.plug("Raspberry_Pi_Debug_Probe", "2e8a:000c", &["ttyACM0"]);
        machine.plug("Van_Ooijen_Keyboard", "16c0:27dd", &["ttyACM1"]);
        let others: &[&str] = &["1a86_Serial", "Raspberry_Pi_Debug_Probe", "Van_Ooijen_Keyboard"];
        machine.finds(Microcontroller, None, others);
        machine.plug("Teensyduino", "16c0:0483", &["ttyACM2"]);
        machine.finds(Microcontroller, Some("Teensyduino"), &[]);
        machine.finds(Maestro, None, &[]);
        machine.plug("Pololu_Mini_Maestro_12", "1ffb:008a", &["ttyACM4", "ttyACM3"]);
        machine.finds(Maestro, Some("Pololu_Mini_Maestro_12"), &[]);
        machine.finds(Microcontroller, Some("Teensyduino"), &[]);
        machine.unplug("Teensyduino");
        // A Maestro would take packets for commands, so that its path is not recommended.
        machine.finds(Microcontroller, None, others);
    }

    #[test]
    fn of_several_boards_none_is_taken_but_the_one_that_is_in_use_is_kept() {
        let (machine, now) = (Machine::new(), Instant::now());
        machine.plug("Head", "2341:0043", &["ttyACM0"]);
        let mut search = PortSearch::new(&SerialDevice::Auto, Microcontroller);
        assert_eq!(machine.find(&mut search, now), Ok(machine.link("Head")));
        machine.plug("Other", "239a:80f4", &["ttyACM1"]);
        assert_eq!(machine.find(&mut search, now), Ok(machine.link("Head")));
        // Somebody must choose.
        machine.finds(Microcontroller, None, &["Head", "Other"]);
        // A board that is away for seconds is waited for, and later another takes its place.
        machine.unplug("Head");
        let days_later = now + 1000 * REPLACE_AFTER;
        let away = [days_later, days_later + REPLACE_AFTER / 2].map(|now| machine.find(&mut search, now).unwrap_err());
        assert!(away[1].message.contains(&format!("waits for {}", machine.link("Head").display())), "{away:?}");
        assert_eq!(machine.find(&mut search, days_later + REPLACE_AFTER), Ok(machine.link("Other")));
    }

    #[test]
    fn boards_with_a_serial_chip_restart_and_boards_with_their_own_usb_uarts_and_maestros_do_not() {
        let machine = Machine::new();
        for (node, numbers, restarts) in [
            ("ttyUSB12", "10c4:ea60", true),
            ("ttyCH341USB0", "1a86:7523", true),
            ("ttyACM1", "2341:0001", true),
            ("ttyACM2", "2a03:0042", true),
            ("ttyACM3", "1a86:55d4", true),
            ("ttyACM4", "2341:8036", false),
            ("ttyACM5", "2e8a:000a", false),
            ("ttyACM6", "1ffb:0089", false),
            ("ttyACM7", "1b4f:0043", false),
        ] {
            machine.plug(node, numbers, &[node]);
            let by_node = machine.0.path().join("dev").join(node);
            let found = [by_node, machine.link(node)].map(|path| restarts_board(&path, &machine.0.path().join("tty")));
            assert_eq!(found, [restarts; 2], "{node} {numbers}");
        }
        assert!(!restarts_board(Path::new("/dev/ttyAMA0"), &machine.0.path().join("tty")));
    }

    #[test]
    fn the_udev_rules_name_the_same_makers() {
        let rules = include_str!("../../../systemd/99-facewire.rules");
        assert!(rules.contains(&format!("ATTRS{{idVendor}}==\"{}\",", VENDORS.join("|"))));
        assert!(rules.contains(&format!("ATTRS{{idVendor}}==\"{}\", ATTRS{{idProduct}}==\"{}?\"", TEENSY.0, TEENSY.1)));
    }
}
