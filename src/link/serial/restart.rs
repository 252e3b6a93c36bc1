//! Boards that restart when their port is opened.
//!
//! Role: says which ports belong to a board with a serial chip of its own, whose DTR resets the microcontroller, and for
//! how long nothing may be written to such a board.
//! Contract: until the boot loader has started the sketch, not a byte is written. The boot loader of an Uno takes bytes for
//! commands, and 0x64 is the one that erases memory. HUPCL stays set until then: whoever closes the port earlier lowers
//! DTR, so that the next one to open it restarts the board again and waits again.
//! Limits: ports must have the names that the kernel gives them. A board at the pins of a UART is not recognised. What
//! is behind an adapter is not known: even if it is a board whose DTR is not connected, or a Maestro, it gets nothing
//! for 2 s.

use std::os::fd::OwnedFd;
use std::path::Path;
use std::time::{Duration, Instant};

use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};

use super::board::numbers;

/// How long nothing is written. The boot loader of an Uno waits for a new sketch for 1 s.
const SILENCE: Duration = Duration::from_secs(2);
/// Vendors of Arduinos whose serial chip is a microcontroller with the driver of modems.
const VENDORS: [&str; 2] = ["2341", "2a03"];
/// The products of Uno, Uno Mini, Mega and Mega ADK.
/// Source: `boards.txt` of <https://github.com/arduino/ArduinoCore-avr>
const PRODUCTS: [&str; 11] = ["0001", "0043", "0243", "006a", "0062", "0010", "0042", "0210", "0242", "003f", "0044"];
/// Serial chips of WCH, such as the CH343, that use the driver of modems.
const CHIPS: [(&str, &str); 2] = [("1a86", "55d3"), ("1a86", "55d4")];

/// Whether opening this port restarts the board behind it, if DTR was low. `class` is what the kernel knows of ports.
pub fn restarts_board(device: &Path, class: &Path) -> bool {
    let node = device.canonicalize().unwrap_or_default();
    let name = node.file_name().unwrap_or_default().to_string_lossy();
    let (vendor, product) = numbers(&node, class).unwrap_or_default();
    is_restarted_by_dtr(&name, &vendor, &product)
}

/// Drivers of serial chips such as the CH340 name their ports `ttyUSB0`, or `ttyCH341USB0` if they come from the maker.
/// A board at any other port restarts only if the lists above contain it.
fn is_restarted_by_dtr(name: &str, vendor: &str, product: &str) -> bool {
    let is_arduino = VENDORS.contains(&vendor) && PRODUCTS.contains(&product);
    is_arduino || name.contains("USB") || CHIPS.contains(&(vendor, product))
}

/// The restart of a board whose port has just been opened.
#[derive(Debug)]
pub struct Restart {
    port: OwnedFd,
    opened: Instant,
}

impl Restart {
    pub fn new(port: OwnedFd, opened: Instant) -> Self {
        Self { port, opened }
    }

    /// Whether the board's own program runs.
    pub fn is_over(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.opened) >= SILENCE
    }

    /// Lets DTR stay when the port is closed. If that fails, the board restarts once more at the next opening.
    pub fn end(self) {
        let _ = keep_dtr(&self.port);
    }
}

/// Clears HUPCL, so that closing the port does not lower DTR.
pub fn keep_dtr(port: &OwnedFd) -> rustix::io::Result<()> {
    let mut modes = tcgetattr(port)?;
    modes.control_modes.remove(ControlModes::HUPCL);
    tcsetattr(port, OptionalActions::Now, &modes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn boards_with_a_serial_chip_restart_and_boards_with_their_own_usb_uarts_and_maestros_do_not() {
        let restarting = [
            ("ttyUSB0", "1a86", "7523"),
            ("ttyUSB1", "0403", "6001"),
            ("ttyUSB12", "10c4", "ea60"),
            ("ttyCH341USB0", "1a86", "7523"),
            ("ttyACM0", "2341", "0043"),
            ("ttyACM1", "2341", "0001"),
            ("ttyACM0", "2a03", "0042"),
            ("ttyACM0", "1a86", "55d4"),
        ];
        let others = [
            ("ttyACM0", "2341", "8036"),
            ("ttyACM0", "2e8a", "000a"),
            ("ttyACM0", "16c0", "0483"),
            ("ttyACM0", "303a", "1001"),
            ("ttyACM0", "1ffb", "0089"),
            ("ttyACM0", "1b4f", "0043"),
            ("ttyS1", "", ""),
            ("ttyAMA0", "", ""),
            ("3", "", ""),
        ];
        for (name, vendor, product) in restarting {
            assert!(is_restarted_by_dtr(name, vendor, product), "{name} {vendor}:{product}");
        }
        for (name, vendor, product) in others {
            assert!(!is_restarted_by_dtr(name, vendor, product), "{name} {vendor}:{product}");
        }
    }

    #[test]
    fn a_restart_is_over_after_2_seconds() {
        let (port, now) = (tempfile::tempfile().unwrap().into(), Instant::now());
        let restart = Restart::new(port, now);
        let over = [0, 1999, 2000, 9000].map(|ms| restart.is_over(now + Duration::from_millis(ms)));
        assert_eq!(over, [false, false, true, true]);
    }
}
