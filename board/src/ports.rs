//! Serial ports: what the vendor and product numbers of USB devices tell about them, and how late an adapter passes bytes on.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Vendors of boards: Arduino (two numbers), Adafruit, Raspberry Pi, Espressif, SparkFun, Seeed, Pololu.
/// `systemd/99-facewire.rules` has the same numbers.
const VENDORS: [u16; 8] = [0x2341, 0x2a03, 0x239a, 0x2e8a, 0x303a, 0x1b4f, 0x2886, 0x1ffb];
/// Teensy, whose vendor number belongs to many makers. The ports of its boards have products that begin with 048.
const TEENSY: (u16, u16) = (0x16c0, 0x048);
/// Raspberry Pi's debug probes. Anything may be connected to their serial line.
/// Source: <https://github.com/raspberrypi/usb-pid>
const PROBES: [UsbId; 2] = [(0x2e8a, 0x0004), (0x2e8a, 0x000c)];
/// Pololu's Maestros: the Micro Maestro 6 and the Mini Maestros 12, 18 and 24. They would take packets for commands, so a
/// link for packets never chooses them. Their first port is the one for commands.
/// Source: the udev rules and the source of Pololu's Maestro software for Linux.
const MAESTROS: [UsbId; 4] = [(0x1ffb, 0x0089), (0x1ffb, 0x008a), (0x1ffb, 0x008b), (0x1ffb, 0x008c)];
/// Arduinos whose serial chip is a microcontroller that uses the driver of modems (`ttyACM`): vendors, and the products of
/// Uno, Uno Mini, Mega and Mega ADK.
/// Source: `boards.txt` of <https://github.com/arduino/ArduinoCore-avr>
const ARDUINO_VENDORS: [u16; 2] = [0x2341, 0x2a03];
const ARDUINOS: [u16; 11] = [0x01, 0x43, 0x243, 0x6a, 0x62, 0x10, 0x42, 0x210, 0x242, 0x3f, 0x44];
/// Serial chips of WCH, such as the CH343, that use the driver of modems.
const MODEM_CHIPS: [UsbId; 2] = [(0x1a86, 0x55d3), (0x1a86, 0x55d4)];
/// Adapters that lead to bus servos, or to anything else: Robotis's U2D2 (an FTDI chip), and the boards of Waveshare and
/// Feetech (CH343, CH340).
const BUS_ADAPTERS: [UsbId; 3] = [(0x0403, 0x6014), (0x1a86, 0x55d3), (0x1a86, 0x7523)];
/// The longest time for which an FTDI adapter may hold bytes back, milliseconds. It is 16 unless somebody changes it.
const MOST_LATENCY_MS: u32 = 4;

/// The numbers of a USB device: vendor and product.
pub type UsbId = (u16, u16);

/// What `device = "auto"` stands for, or what is at the end of an adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Attached {
    Microcontroller,
    Maestro,
    /// An adapter whose line may lead to bus servos, or to anything else.
    BusServos,
}

/// Returns whether opening this port may restart the board. Drivers of serial chips such as the CH340 name their ports
/// `ttyUSB0`, or `ttyCH341USB0` if they come from the maker.
/// Whether the DTR of such a chip is connected is not known, so any board behind one counts. A board at another port
/// restarts only if the lists above contain it.
pub fn restarts(node: &Path, (vendor, product): UsbId) -> bool {
    let is_arduino = ARDUINO_VENDORS.contains(&vendor) && ARDUINOS.contains(&product);
    is_arduino || node.to_string_lossy().contains("USB") || MODEM_CHIPS.contains(&(vendor, product))
}

/// What is at this USB device, as far as its numbers tell.
pub fn attached(numbers: UsbId) -> Option<Attached> {
    let (vendor, product) = numbers;
    let is_board = VENDORS.contains(&vendor) && !PROBES.contains(&numbers) || (vendor, product >> 4) == TEENSY;
    if MAESTROS.contains(&numbers) {
        Some(Attached::Maestro)
    } else if BUS_ADAPTERS.contains(&numbers) {
        Some(Attached::BusServos)
    } else {
        is_board.then_some(Attached::Microcontroller)
    }
}

/// The links to a port in a folder of stable names.
pub fn links_to(port: &Path, folder: &Path) -> BTreeSet<PathBuf> {
    let Ok(port) = fs::canonicalize(port) else { return BTreeSet::new() };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    entries.filter(|link| fs::canonicalize(link).is_ok_and(|end| end == port)).collect()
}

/// Tells that an adapter passes answers on too late, and what to do. `root` is the folder that contains `sys`.
pub fn latency_remedy(root: &Path, device: &Path) -> Option<String> {
    let node = fs::canonicalize(device).ok()?;
    let timer = root.join("sys/class/tty").join(node.file_name()?).join("device/latency_timer");
    let ms = fs::read_to_string(timer).ok()?.trim().parse().ok().filter(|ms: &u32| *ms > MOST_LATENCY_MS)?;
    let rule = r#"ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1""#;
    let file = "/etc/udev/rules.d/99-latency.rules";
    Some(format!("the adapter holds answers back for {ms} ms; write {rule} to {file}, and plug it in again"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_adapter_that_holds_bytes_back_is_told_with_the_rule_that_ends_this() {
        let folder = tempfile::tempdir().unwrap();
        let (port, timer) = (folder.path().join("ttyUSB3"), folder.path().join("sys/class/tty/ttyUSB3/device"));
        fs::create_dir_all(&timer).unwrap();
        fs::write(&port, "").unwrap();
        let told = |ms: &str| {
            fs::write(timer.join("latency_timer"), ms).unwrap();
            latency_remedy(folder.path(), &port)
        };
        assert_eq!([told("1\n"), told("no number")], [None, None]);
        let told = told("16\n").unwrap();
        assert!(told.contains("for 16 ms") && told.contains("ATTR{latency_timer}=\"1\""), "{told}");
        assert_eq!(latency_remedy(folder.path(), Path::new("/dev/null")), None);
    }

    #[test]
    fn adapters_of_bus_servos_are_known_by_their_chips() {
        for numbers in [(0x0403, 0x6014), (0x1a86, 0x55d3), (0x1a86, 0x7523)] {
            assert_eq!(attached(numbers), Some(Attached::BusServos));
        }
        assert_eq!(attached((0x0403, 0x6001)), None);
    }

    #[test]
    fn boards_with_a_serial_chip_restart_and_boards_with_their_own_usb_uarts_and_maestros_do_not() {
        for (node, numbers, want) in [
            ("ttyUSB12", (0x10c4, 0xea60), true),
            ("ttyCH341USB0", (0x1a86, 0x7523), true),
            ("ttyACM1", (0x2341, 0x0001), true),
            ("ttyACM2", (0x2a03, 0x0042), true),
            ("ttyACM3", (0x1a86, 0x55d4), true),
            ("ttyACM4", (0x2341, 0x8036), false),
            ("ttyACM5", (0x2e8a, 0x000a), false),
            ("ttyACM6", (0x1ffb, 0x0089), false),
            ("ttyACM7", (0x1b4f, 0x0043), false),
            ("ttyAMA0", (0, 0), false),
        ] {
            assert_eq!(restarts(&Path::new("/dev").join(node), numbers), want, "{node} {numbers:x?}");
        }
    }

    #[test]
    fn the_udev_rules_name_the_same_makers() {
        let rules = include_str!("../../systemd/99-facewire.rules");
        let vendors = VENDORS.map(|vendor| format!("{vendor:04x}")).join("|");
        assert!(rules.contains(&format!("ATTRS{{idVendor}}==\"{vendors}\",")));
        let (vendor, products) = TEENSY;
        assert!(
            rules.contains(&format!("ATTRS{{idVendor}}==\"{vendor:04x}\", ATTRS{{idProduct}}==\"{products:03x}?\""))
        );
    }
}
