//! `facewire servo`: moves one channel of a servo board by keys, to find its ends.
//!
//! Contract: the servo gets no pulses until the first key, and none after the end unless `--end neutral` asks for them. The
//! terminal is restored however the command ends. A board that the service uses is refused.

mod board;
mod finder;
mod terminal;

use std::io::{self, IsTerminal as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::Duration;

use clap::{Args, ValueEnum};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use self::board::Board;
use self::finder::{Finder, Key};
use self::terminal::Terminal;
use facewire::cli::SettingsArgs;
use facewire::cli::{Failure, print};
use facewire::config::{LinkKind, MaestroSettings, Pca9685Settings, SerialDevice, Settings};

/// Time after which a pulse is sent again, so that a board with a time-out does not switch the servo off.
const RESEND_PERIOD: Duration = Duration::from_millis(200);

const EXAMPLES: &str = "\
Examples:
  facewire servo --channel 3                        the Maestro on USB
  facewire servo --channel 3 --config f.toml        the first servo board in this file
  facewire servo --channel 3 --pca9685 1            the PCA9685 at 0x40 of /dev/i2c-1
  facewire servo --channel 3 --maestro /dev/ttyACM0 the Maestro at this port

Keys:
  left, right   move by --step microseconds
  down, up      move by 5 steps
  0, 1          take this pulse as that of position 0 or 1
  n             take this pulse as the neutral one
  space         end or begin the pulses
  q             end, and print the lines for the settings

Move towards an end in small steps and stop before the servo hums or the mechanism binds. A service that uses the board \
must be stopped first: sudo systemctl stop facewire";

/// Arguments of `facewire servo`.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ServoArgs {
    /// The number of the channel, as it is printed on the board
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=23))]
    channel: u8,
    /// A Maestro at this serial port, or "auto" for the one on USB
    #[arg(long, value_name = "DEVICE")]
    maestro: Option<String>,
    /// A PCA9685 at the I2C bus of this number
    #[arg(long, value_name = "BUS", conflicts_with = "maestro")]
    pca9685: Option<u32>,
    /// The address of the PCA9685
    #[arg(long, value_name = "ADDRESS", default_value = "0x40", value_parser = address, requires = "pca9685")]
    address: u32,
    /// How far one key moves, microseconds
    #[arg(long, value_name = "US", default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=100))]
    step: u16,
    /// The pulse of the first key, microseconds
    #[arg(long, value_name = "US", default_value_t = 1500, value_parser = clap::value_parser!(u16).range(500..=2500))]
    start: u16,
    /// What the servo does after the end
    #[arg(long, value_name = "WHAT", default_value = "release")]
    end: End,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// What the servo does after the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum End {
    /// It gets no more pulses
    Release,
    /// It holds the neutral pulse, if one was taken
    Neutral,
}

impl ServoArgs {
    /// The link to the board.
    fn kind(&self, settings: &Settings) -> LinkKind {
        if let Some(device) = &self.maestro {
            let device = if device == "auto" { SerialDevice::Auto } else { SerialDevice::Path(device.into()) };
            return LinkKind::Maestro(MaestroSettings { device, ..MaestroSettings::default() });
        }
        if let Some(bus) = self.pca9685 {
            return LinkKind::Pca9685(Pca9685Settings { bus, address: self.address, ..Pca9685Settings::default() });
        }
        let kinds = settings.links.iter().map(|link| &link.kind);
        let found = kinds.clone().find(|kind| matches!(kind, LinkKind::Maestro(_) | LinkKind::Pca9685(_)));
        found.cloned().unwrap_or_else(|| LinkKind::Maestro(MaestroSettings::default()))
    }
}

/// Reads an address of I2C, such as 0x40 or 64.
fn address(text: &str) -> Result<u32, String> {
    let number = text.strip_prefix("0x").map_or_else(|| text.parse(), |hex| u32::from_str_radix(hex, 16));
    number
        .ok()
        .filter(|number| (0x40..=0x7F).contains(number))
        .ok_or_else(|| "write a number from 0x40 to 0x7f".to_owned())
}

pub fn run(args: &ServoArgs) -> Result<(), Failure> {
    let kind = args.kind(&args.settings.load()?);
    if !io::stdin().is_terminal() || !io::stdout().is_terminal() {
        return Err(Failure::failed("`facewire servo` reads keys from a terminal; run it in one".to_owned()));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).map_err(|error| Failure::failed(error.to_string()))?;
    }
    let mut board = Board::open(&kind, args.channel)?;
    let mut finder = Finder::new(args.start, args.step);
    let moved = by_keys(&mut board, &mut finder, &stop);
    let rest = finder.neutral_us().filter(|_| args.end == End::Neutral);
    let ended = board.set(rest);
    moved.and(ended)?;
    print(&finder.lines(args.channel))
}

/// Moves the servo until the user or a signal ends it. The terminal is restored on return.
fn by_keys(board: &mut Board, finder: &mut Finder, stop: &AtomicBool) -> Result<(), Failure> {
    let mut terminal = Terminal::enter()?;
    terminal.say("left/right, down/up: move   0, 1, n: take as an end or as neutral   space: pulses   q: end")?;
    while !stop.load(Relaxed) {
        terminal.show(&finder.status())?;
        match terminal::key(RESEND_PERIOD)? {
            Some(Key::End) => break,
            Some(key) => finder.press(key),
            None => {}
        }
        board.set(finder.pulse_us())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_data_sheets_write_them() {
        assert_eq!(["0x40", "64", "0x7F"].map(address), [Ok(0x40), Ok(64), Ok(0x7F)]);
        assert!(["0x3f", "128", "", "x"].map(address).iter().all(Result::is_err));
    }
}
