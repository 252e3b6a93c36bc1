//! Finds the microcontroller board for `device = "auto"`.
//!
//! Role: among the serial ports of USB devices, tells boards from everything else by the numbers of their makers.
//! Contract: only one board that is the only one is chosen. A line to a modem, a printer or a radio must not carry
//! packets by surprise, so an adapter that anything may be connected to is never chosen, nor one of several boards. A
//! board that was chosen before is chosen again, and is waited for while its power is off for a moment.
//! Limits: ports must have their names from udev.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::port::PortTrouble;
use crate::config::AutoDevice;

/// Links to the serial ports of USB devices, with names that stay with the device.
const LINKS: &str = "/dev/serial/by-id";
/// What the kernel knows of serial ports.
pub const CLASS: &str = "/sys/class/tty";
/// Vendors of boards: Arduino (two numbers), Adafruit, Raspberry Pi, Espressif, SparkFun, Seeed, Pololu.
/// `systemd/99-facewire.rules` has the same numbers.
const VENDORS: [&str; 8] = ["2341", "2a03", "239a", "2e8a", "303a", "1b4f", "2886", "1ffb"];
/// Teensy, whose vendor number belongs to many makers. The ports of its boards have products that begin like this.
const TEENSY: (&str, &str) = ("16c0", "048");
/// Raspberry Pi's debug probes. Anything may be connected to their serial line.
/// Source: <https://github.com/raspberrypi/usb-pid>
const PROBES: [(&str, &str); 2] = [("2e8a", "0004"), ("2e8a", "000c")];
/// How long another board does not take the place of the chosen one: a board whose servos draw too much current is away
/// for some seconds.
const LOYALTY: Duration = Duration::from_secs(30);

/// Pololu's Maestros: the Micro Maestro 6 and the Mini Maestros 12, 18 and 24. They would take packets for commands, so a
/// link for packets never chooses them. Their first port is the one for commands.
/// Source: the udev rules and the source of Pololu's Maestro software for Linux.
const MAESTROS: [(&str, &str); 4] = [("1ffb", "0089"), ("1ffb", "008a"), ("1ffb", "008b"), ("1ffb", "008c")];

/// Whether a USB device with these numbers is a Maestro.
#[must_use]
pub fn is_maestro(vendor: u16, product: u16) -> bool {
    MAESTROS.contains(&(format!("{vendor:04x}").as_str(), format!("{product:04x}").as_str()))
}

/// The search for the board of one link.
#[derive(Debug, Default)]
pub struct BoardSearch {
    wanted: AutoDevice,
    /// The board that was chosen last.
    chosen: Option<PathBuf>,
    /// When the search first missed it.
    missed_at: Option<Instant>,
}

impl BoardSearch {
    /// The search for a device of this kind.
    #[must_use]
    pub fn new(wanted: AutoDevice) -> Self {
        Self { wanted, ..Self::default() }
    }

    /// Returns the port of the board.
    ///
    /// # Errors
    /// Says why there is none.
    pub fn find(&mut self) -> Result<PathBuf, PortTrouble> {
        self.choose(Ports::look(self.wanted, Path::new(LINKS), Path::new(CLASS)), Instant::now())
    }

    fn choose(&mut self, mut ports: Ports, now: Instant) -> Result<PathBuf, PortTrouble> {
        if let Some(chosen) = &self.chosen {
            if ports.boards.contains(chosen) {
                ports.boards = vec![chosen.clone()];
            } else if now.duration_since(*self.missed_at.get_or_insert(now)) < LOYALTY && !ports.boards.is_empty() {
                return Err(PortTrouble::Away(chosen.clone()));
            }
        }
        match ports.boards.as_slice() {
            [board] => {
                (self.chosen, self.missed_at) = (Some(board.clone()), None);
                Ok(board.clone())
            }
            [] if self.wanted == AutoDevice::Maestro => Err(PortTrouble::NoMaestro),
            [] => Err(PortTrouble::NoBoard(ports.others)),
            _ => Err(PortTrouble::SeveralBoards(ports.boards)),
        }
    }
}

/// The serial ports of USB devices, by the stable path of the first port of each device.
#[derive(Debug, Default, PartialEq, Eq)]
struct Ports {
    boards: Vec<PathBuf>,
    others: Vec<PathBuf>,
}

impl Ports {
    /// Lists the ports that have a link in `links`, with what `class` tells of them.
    fn look(wanted: AutoDevice, links: &Path, class: &Path) -> Self {
        let mut paths: Vec<PathBuf> =
            fs::read_dir(links).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        paths.sort();
        let mut devices: Vec<(PathBuf, PathBuf)> =
            paths.into_iter().filter_map(|path| Some((usb_device(&path, class)?, path))).collect();
        devices.dedup_by(|later, earlier| later.0 == earlier.0);
        let mut ports = Self::default();
        for (device, path) in devices {
            match (kind(&device), wanted) {
                (Some(kind), wanted) if kind == wanted => ports.boards.push(path),
                // A path that the message would recommend.
                (Some(AutoDevice::Maestro), AutoDevice::Microcontroller) => {}
                _ => ports.others.push(path),
            }
        }
        ports
    }
}

/// Returns the folder of the USB device that the port belongs to: the nearest above the port that has a vendor.
fn usb_device(port: &Path, class: &Path) -> Option<PathBuf> {
    let node = fs::canonicalize(port).ok()?;
    let port = fs::canonicalize(class.join(node.file_name()?).join("device")).ok()?;
    let device = port.ancestors().find(|folder| folder.join("idVendor").exists())?;
    Some(device.to_owned())
}

/// Returns the numbers of the vendor and the product of the USB device that the port belongs to.
pub fn numbers(port: &Path, class: &Path) -> Option<(String, String)> {
    usb_device(port, class).map(|device| numbers_of(&device))
}

fn numbers_of(device: &Path) -> (String, String) {
    let read = |name| fs::read_to_string(device.join(name)).unwrap_or_default().trim().to_owned();
    (read("idVendor"), read("idProduct"))
}

/// What kind of device this is, if its numbers tell.
fn kind(device: &Path) -> Option<AutoDevice> {
    let (vendor, product) = numbers_of(device);
    let numbers = (vendor.as_str(), product.as_str());
    if MAESTROS.contains(&numbers) {
        return Some(AutoDevice::Maestro);
    }
    let is_teensy = vendor == TEENSY.0 && product.starts_with(TEENSY.1);
    let is_board = is_teensy || (VENDORS.contains(&vendor.as_str()) && !PROBES.contains(&numbers));
    is_board.then_some(AutoDevice::Microcontroller)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::os::unix::fs::symlink;

    use tempfile::TempDir;

    use super::super::restart::restarts_board;
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
                let port = device.join(format!("1.{index}/port"));
                fs::create_dir_all(&port).unwrap();
                fs::create_dir(root.join("tty").join(node)).unwrap();
                symlink(port, root.join("tty").join(node).join("device")).unwrap();
                fs::write(root.join("dev").join(node), "").unwrap();
                symlink(Path::new("../dev").join(node), self.link(name, index)).unwrap();
            }
            fs::write(device.join("idVendor"), format!("{vendor}\n")).unwrap();
            fs::write(device.join("idProduct"), format!("{product}\n")).unwrap();
        }

        fn unplug(&self, name: &str) {
            fs::remove_file(self.link(name, 0)).unwrap();
        }

        fn link(&self, name: &str, index: usize) -> PathBuf {
            self.0.path().join(format!("by-id/usb-{name}-if0{index}"))
        }

        fn find(&self, search: &mut BoardSearch, now: Instant) -> Result<PathBuf, PortTrouble> {
            search.choose(Ports::look(search.wanted, &self.0.path().join("by-id"), &self.0.path().join("tty")), now)
        }

        fn find_first(&self) -> Result<PathBuf, PortTrouble> {
            self.find(&mut BoardSearch::default(), Instant::now())
        }
    }

    #[test]
    fn the_only_board_is_found_by_its_maker_among_ports_that_anything_may_be_connected_to() {
        let machine = Machine::new();
        assert_eq!(machine.find_first(), Err(PortTrouble::NoBoard(vec![])));
        machine.plug("1a86_Serial", "1a86:7523", &["ttyUSB0"]);
        machine.plug("Raspberry_Pi_Debug_Probe", "2e8a:000c", &["ttyACM0"]);
        machine.plug("Van_Ooijen_Keyboard", "16c0:27dd", &["ttyACM1"]);
        let others =
            ["1a86_Serial", "Raspberry_Pi_Debug_Probe", "Van_Ooijen_Keyboard"].map(|name| machine.link(name, 0));
        assert_eq!(machine.find_first(), Err(PortTrouble::NoBoard(others.to_vec())));
        machine.plug("Teensyduino", "16c0:0483", &["ttyACM2"]);
        assert_eq!(machine.find_first(), Ok(machine.link("Teensyduino", 0)));
    }

    #[test]
    fn a_maestro_is_found_by_a_link_for_maestros_at_its_first_port_and_gets_no_packets() {
        let machine = Machine::new();
        let find = || machine.find(&mut BoardSearch::new(AutoDevice::Maestro), Instant::now());
        machine.plug("Arduino", "2341:0043", &["ttyACM0"]);
        assert_eq!(find(), Err(PortTrouble::NoMaestro));
        machine.plug("Pololu_Mini_Maestro_12", "1ffb:008a", &["ttyACM2", "ttyACM1"]);
        assert_eq!(find(), Ok(machine.link("Pololu_Mini_Maestro_12", 0)));
        assert_eq!(machine.find_first(), Ok(machine.link("Arduino", 0)));
        machine.unplug("Arduino");
        assert_eq!(machine.find_first(), Err(PortTrouble::NoBoard(vec![])));
        machine.plug("Pololu_Micro_Maestro_6", "1ffb:0089", &["ttyACM3", "ttyACM4"]);
        assert!(matches!(find(), Err(PortTrouble::SeveralBoards(boards)) if boards.len() == 2));
    }

    #[test]
    fn opening_the_port_of_an_uno_restarts_it_whatever_the_name_of_its_port() {
        let machine = Machine::new();
        machine.plug("Uno", "2341:0043", &["ttyACM0"]);
        machine.plug("Leonardo", "2341:8036", &["ttyACM1"]);
        let restarts = |path: &Path| restarts_board(path, &machine.0.path().join("tty"));
        let ports = ["dev/ttyACM0", "dev/ttyACM1", "dev/ttyACM2"].map(|port| machine.0.path().join(port));
        assert_eq!(ports.map(|port| restarts(&port)), [true, false, false]);
        assert_eq!(["Uno", "Leonardo"].map(|name| restarts(&machine.link(name, 0))), [true, false]);
    }

    #[test]
    fn of_a_board_with_several_ports_the_first_is_taken() {
        let machine = Machine::new();
        machine.plug("Pico", "2e8a:000a", &["ttyACM1", "ttyACM0"]);
        assert_eq!(machine.find_first(), Ok(machine.link("Pico", 0)));
    }

    #[test]
    fn of_several_boards_none_is_taken_but_the_one_that_is_in_use_is_kept() {
        let (machine, now) = (Machine::new(), Instant::now());
        machine.plug("B", "2341:0043", &["ttyACM0"]);
        let mut search = BoardSearch::default();
        assert_eq!(machine.find(&mut search, now), Ok(machine.link("B", 0)));
        machine.plug("A", "239a:80f4", &["ttyACM1"]);
        assert_eq!(machine.find(&mut search, now), Ok(machine.link("B", 0)));
        let both = ["A", "B"].map(|name| machine.link(name, 0));
        assert_eq!(machine.find_first(), Err(PortTrouble::SeveralBoards(both.to_vec())));
    }

    #[test]
    fn a_board_that_is_away_for_seconds_is_waited_for_and_later_another_takes_its_place() {
        let (machine, now) = (Machine::new(), Instant::now());
        machine.plug("Head", "2341:0043", &["ttyACM0"]);
        let mut search = BoardSearch::default();
        assert_eq!(machine.find(&mut search, now), Ok(machine.link("Head", 0)));
        machine.unplug("Head");
        let days_later = now + 1000 * LOYALTY;
        assert_eq!(machine.find(&mut search, days_later), Err(PortTrouble::NoBoard(vec![])));
        machine.plug("Other", "2341:0043", &["ttyACM1"]);
        let away = Err(PortTrouble::Away(machine.link("Head", 0)));
        assert_eq!(machine.find(&mut search, days_later + LOYALTY / 2), away);
        assert_eq!(machine.find(&mut search, days_later + LOYALTY), Ok(machine.link("Other", 0)));
    }

    #[test]
    fn the_udev_rules_name_the_same_makers() {
        let rules = include_str!("../../../systemd/99-facewire.rules");
        assert!(rules.contains(&format!("ATTRS{{idVendor}}==\"{}\",", VENDORS.join("|"))));
        assert!(rules.contains(&format!("ATTRS{{idVendor}}==\"{}\", ATTRS{{idProduct}}==\"{}?\"", TEENSY.0, TEENSY.1)));
    }
}
