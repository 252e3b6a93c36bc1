//! `facewire servo`: moves one channel of a servo board by keys, to find its ends.
//!
//! Contract: the servo gets no pulses until the first key, and none after the end unless `--end neutral` asks for them. The
//! terminal is restored however the command ends. A board that the service uses is refused.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use clap::builder::PossibleValuesParser;
use clap::{Args, ValueEnum};
use crossterm::event::{self, KeyCode, KeyEvent, KeyModifiers};
use crossterm::style::Print;
use crossterm::terminal::{Clear, ClearType, disable_raw_mode, enable_raw_mode};
use crossterm::{cursor, execute};
use serialport::{ClearBuffer, SerialPort as _};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::{Restore, stopped_by};
use facewire::cli::{Failure, STANDARD_OUTPUT, SettingsArgs, print};
use facewire::config::{BusServoSettings, LinkKind, MaestroSettings, Pca9685Settings, SerialDevice, Settings};
use facewire::link::pca9685::Bus;
use facewire::link::{PortSearch, lost, open_port};
use facewire_board::Attached;
use facewire_servo::bus::{FAMILIES, Family, Single};
use facewire_servo::finder::{Finder, Press, REACH_US};
use facewire_servo::maestro::{Code, SILENCE, check_answer, speed, target};
use facewire_servo::pca9685::{CHANNELS, address};

/// Time after which a pulse is sent again, so that a board with a time-out does not switch the servo off.
const RESEND_PERIOD: Duration = Duration::from_millis(200);
/// Number of steps by which the keys up and down move.
const STEPS_OF_UP_AND_DOWN: f32 = 5.0;
/// How long a Maestro has for its answer.
const PATIENCE: Duration = Duration::from_millis(500);
/// How long a bus servo has, behind an adapter that holds bytes back for 16 ms.
const BUS_PATIENCE: Duration = Duration::from_millis(50);
/// Speed of the servo, microseconds of the pulse per second: a large step takes a few hundredths of a second.
const SPEED_US_PER_S: f32 = 2000.0;

const EXAMPLES: &str = "\
Examples:
  facewire servo --channel 3                        the Maestro on USB
  facewire servo --channel 3 --config f.toml        the first servo board in this file
  facewire servo --channel 3 --pca9685 1            the PCA9685 at 0x40 of /dev/i2c-1
  facewire servo --channel 3 --maestro /dev/ttyACM0 the Maestro at this port
  facewire servo --channel 3 --bus /dev/ttyUSB0 --family feetech-sts     the bus servo with the ID 3

Keys:
  left, right   move by --step microseconds, or steps of a bus servo
  down, up      move by 5 steps
  0, 1          take this pulse as that of position 0 or 1
  n             take this pulse as the neutral one
  space         end or begin the pulses
  q             end, and print the lines for the settings

Move towards an end in small steps and stop before the servo hums or the mechanism binds. A service that uses the board \
must be stopped first: sudo systemctl stop facewire";

#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct ServoArgs {
    /// The number of the channel, as it is printed on the board, or the ID of a bus servo
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=252))]
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
    /// A bus servo at this serial port
    #[arg(long, value_name = "DEVICE", conflicts_with_all = ["maestro", "pca9685"], requires = "family")]
    bus: Option<PathBuf>,
    /// The family of the bus servo, as in the settings
    #[arg(long, value_name = "NAME", requires = "bus",
        value_parser = PossibleValuesParser::new(FAMILIES.iter().map(|(name, _)| *name)))]
    family: Option<String>,
    /// The baud rate of the bus servo
    #[arg(long, value_name = "BAUD", default_value_t = 1_000_000, requires = "bus")]
    baud: u32,
    /// How far one key moves, microseconds, or steps of a bus servo
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum End {
    /// It gets no more pulses
    Release,
    /// It holds the neutral pulse, if one was taken
    Neutral,
}

impl ServoArgs {
    fn kind(&self, settings: &Settings) -> LinkKind {
        if let Some(device) = &self.maestro {
            let device = if device == "auto" { SerialDevice::Auto } else { SerialDevice::Path(device.into()) };
            return LinkKind::Maestro(MaestroSettings { device, ..MaestroSettings::default() });
        }
        if let Some(bus) = self.pca9685 {
            return LinkKind::Pca9685(Pca9685Settings { bus, address: self.address, ..Pca9685Settings::default() });
        }
        if let (Some(device), Some(name)) = (&self.bus, &self.family) {
            let device = SerialDevice::Path(device.clone());
            let baud = self.baud;
            let family = FAMILIES.iter().find(|(known, _)| known == name).map_or(Family::DYNAMIXEL_X, |it| it.1);
            return LinkKind::BusServo(BusServoSettings { device, family, baud, ..BusServoSettings::default() });
        }
        let kinds = settings.links.iter().map(|link| &link.kind);
        let found = kinds.clone().find(|kind| kind.moves_servos() && kind.universe().is_none());
        found.cloned().unwrap_or_else(|| LinkKind::Maestro(MaestroSettings::default()))
    }
}

pub fn run(args: &ServoArgs) -> Result<(), Failure> {
    let kind = args.kind(&args.settings.load()?);
    if !io::stdin().is_terminal() || !io::stdout().is_terminal() {
        return Err(Failure::failed("`facewire servo` reads keys from a terminal; run it in one".to_owned()));
    }
    let stop = stopped_by(&[SIGINT, SIGTERM, SIGHUP])?;
    let start = args.start.into();
    let step = args.step.into();
    let (mut set_pulse, mut finder) = if let LinkKind::BusServo(settings) = &kind {
        open_bus(settings, args.channel, step)?
    } else {
        (open(&kind, args.channel)?, Finder::new(start, step, REACH_US, false))
    };
    let mut move_by_keys = || -> Result<(), Failure> {
        let _restore = Restore(|| execute!(io::stdout(), Print("\r\n"), cursor::Show).and(disable_raw_mode()));
        enable_raw_mode().and_then(|()| execute!(io::stdout(), cursor::Hide)).map_err(gone)?;
        // What was on the line behind the text is cleared.
        let write = |text: &str| execute!(io::stdout(), Print(text), Clear(ClearType::UntilNewLine)).map_err(gone);
        write("left/right, down/up: move   0, 1, n: take as an end or as neutral   space: pulses   q: end\r\n")?;
        while !stop.load(Relaxed) {
            write(&format!("\r{}", finder.status()))?;
            match key()? {
                Some(key) if is_end(key) => break,
                key => key.and_then(|key| press(key.code)).into_iter().for_each(|press| finder.press(press)),
            }
            set_pulse(finder.place())?;
        }
        Ok(())
    };
    let moved = move_by_keys();
    let rest = finder.neutral().filter(|_| args.end == End::Neutral);
    let ended = set_pulse(rest);
    moved.and(ended)?;
    print(&finder.lines(args.channel))
}

/// Gives the channel of a board this pulse, or none.
type SetPulse = Box<dyn FnMut(Option<f32>) -> Result<(), Failure>>;

/// Opens the board. Another program that uses it, such as the service, is told as the reason.
fn open(kind: &LinkKind, channel: u8) -> Result<SetPulse, Failure> {
    match kind {
        LinkKind::Pca9685(_) if channel >= CHANNELS => {
            Err(Failure::failed(format!("a PCA9685 has the channels 0 to {}", CHANNELS - 1)))
        }
        LinkKind::Pca9685(settings) => {
            let mut bus = Bus::open(settings)?;
            Ok(Box::new(move |pulse_us| Ok(bus.set_pulse(channel, pulse_us)?)))
        }
        LinkKind::Maestro(_) if channel > 23 => Err(Failure::failed("a Maestro has the channels 0 to 23".to_owned())),
        LinkKind::Maestro(settings) => open_maestro(settings, channel),
        _ => Err(Failure::failed("this link leads to no servo board".to_owned())),
    }
}

fn open_maestro(settings: &MaestroSettings, channel: u8) -> Result<SetPulse, Failure> {
    let device = PortSearch::new(&settings.device, Attached::Maestro).find()?;
    let mut tty = open_port(&device, settings.baud, PATIENCE)?;
    let protocol = settings.commands();
    let _ = tty.clear(ClearBuffer::Input);
    if settings.read_errors && check_answer(&mut tty, settings.pololu_commands(), protocol).is_err() {
        return Err(Failure::unavailable(format!("{}: {SILENCE}", device.display())));
    }
    let mut command = move |code, value| {
        // Answers to earlier commands are discarded, because nobody reads them.
        let _ = tty.clear(ClearBuffer::Input);
        tty.write_all(&protocol.command(code, channel, value)).map_err(|error| lost(&device, error).into())
    };
    command(Code::SetSpeed, speed(SPEED_US_PER_S))?;
    Ok(Box::new(move |pulse_us| command(Code::SetTarget, target(pulse_us))))
}

/// Opens a bus servo, and begins where it stands.
fn open_bus(settings: &BusServoSettings, id: u8, step: f32) -> Result<(SetPulse, Finder), Failure> {
    let device = PortSearch::new(&settings.device, Attached::BusServos).find()?;
    let servo = Single::open(open_port(&device, settings.baud, BUS_PATIENCE)?, settings.family, id);
    let mut servo = servo.map_err(|trouble| Failure::unavailable(format!("{}: {trouble}", device.display())))?;
    let finder = Finder::new(servo.place(), step, servo.reach(), true);
    Ok((Box::new(move |place| servo.set(place).map_err(|error| lost(&device, error).into())), finder))
}

fn gone(error: io::Error) -> Failure {
    Failure::unwritable(Path::new(STANDARD_OUTPUT), &error)
}

/// Waits for a key, until a pulse is due again.
fn key() -> Result<Option<KeyEvent>, Failure> {
    match event::poll(RESEND_PERIOD) {
        Ok(true) => Ok(event::read().map_err(gone)?.as_key_press_event()),
        Ok(false) => Ok(None),
        // A signal is no failure of the terminal.
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(None),
        Err(error) => Err(gone(error)),
    }
}

fn press(key: KeyCode) -> Option<Press> {
    Some(match key {
        KeyCode::Left => Press::Move(-1.0),
        KeyCode::Right => Press::Move(1.0),
        KeyCode::Down => Press::Move(-STEPS_OF_UP_AND_DOWN),
        KeyCode::Up => Press::Move(STEPS_OF_UP_AND_DOWN),
        KeyCode::Char('0') => Press::End(0),
        KeyCode::Char('1') => Press::End(1),
        KeyCode::Char('n') => Press::Neutral,
        KeyCode::Char(' ') => Press::Toggle,
        _ => return None,
    })
}

fn is_end(key: KeyEvent) -> bool {
    let is_control = key.modifiers.contains(KeyModifiers::CONTROL);
    matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) || is_control && matches!(key.code, KeyCode::Char('c' | 'd'))
}
