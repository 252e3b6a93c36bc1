//! A servo board of which one channel is moved.

use std::io::{Read as _, Write as _};
use std::path::PathBuf;
use std::time::Duration;

use serialport::{ClearBuffer, SerialPort as _, TTYPort};

use facewire::cli::Failure;
use facewire::config::{AutoDevice, LinkKind, MaestroSettings};
use facewire::link::maestro::{ANSWER_BYTES, Code, Protocol, SILENCE, data, speed, target};
use facewire::link::pca9685::{Bus, CHANNELS};
use facewire::link::{PortSearch, lost, open_port};

/// How long a Maestro has for its answer.
const PATIENCE: Duration = Duration::from_millis(500);
/// Speed of the servo, microseconds of the pulse per second: a large step takes a few hundredths of a second.
const SPEED_US_PER_S: f32 = 2000.0;

/// A channel of a board.
pub enum Board {
    Maestro { tty: TTYPort, device: PathBuf, protocol: Protocol, channel: u8 },
    Pca9685 { bus: Bus, channel: u8 },
}

impl Board {
    /// Opens the board. Another program that uses it, such as the service, is told as the reason.
    pub fn open(kind: &LinkKind, channel: u8) -> Result<Self, Failure> {
        match kind {
            LinkKind::Pca9685(settings) => {
                if channel >= CHANNELS {
                    return Err(Failure::failed(format!("a PCA9685 has the channels 0 to {}", CHANNELS - 1)));
                }
                let mut bus = Bus::open(settings)?;
                bus.probe()?;
                Ok(Self::Pca9685 { bus, channel })
            }
            LinkKind::Maestro(settings) => Self::maestro(settings, channel),
            _ => Err(Failure::failed("this link leads to no servo board".to_owned())),
        }
    }

    fn maestro(board: &MaestroSettings, channel: u8) -> Result<Self, Failure> {
        let device = PortSearch::new(&board.device, AutoDevice::Maestro).find()?;
        let tty = open_port(&device, board.baud, PATIENCE)?;
        let mut maestro = Self::Maestro { tty, device, protocol: Protocol::new(board), channel };
        if board.read_errors {
            maestro.ask(board)?;
        }
        let [low, high] = data(speed(SPEED_US_PER_S));
        maestro.command(Code::SetSpeed, [channel, low, high])?;
        Ok(maestro)
    }

    /// Asks a Maestro for its errors, to check that it answers. The errors are ignored, because they are older than
    /// this command.
    fn ask(&mut self, board: &MaestroSettings) -> Result<(), Failure> {
        let Self::Maestro { tty, device, protocol, .. } = self else { return Ok(()) };
        let mut question = Vec::new();
        // A Maestro that detects its baud rate needs a command of this protocol first.
        for protocol in [Protocol::pololu(board), *protocol] {
            protocol.write(&mut question, Code::GetErrors, []);
        }
        let _ = tty.clear(ClearBuffer::Input);
        let answered = tty.write_all(&question).and_then(|()| tty.read_exact(&mut [0; ANSWER_BYTES]));
        answered.map_err(|_| Failure::unavailable(format!("{}: {SILENCE}", device.display())))
    }

    /// Gives the channel this pulse, or none.
    pub fn set(&mut self, pulse_us: Option<f32>) -> Result<(), Failure> {
        match self {
            Self::Maestro { channel, .. } => {
                let [low, high] = data(target(pulse_us));
                let channel = *channel;
                self.command(Code::SetTarget, [channel, low, high])
            }
            Self::Pca9685 { bus, channel } => Ok(bus.set_pulse(*channel, pulse_us)?),
        }
    }

    fn command(&mut self, code: Code, data: [u8; 3]) -> Result<(), Failure> {
        let Self::Maestro { tty, device, protocol, .. } = self else { return Ok(()) };
        let mut command = Vec::new();
        protocol.write(&mut command, code, data);
        // Answers to earlier commands are discarded, because nobody reads them.
        let _ = tty.clear(ClearBuffer::Input);
        tty.write_all(&command).map_err(|error| lost(device, error).into())
    }
}
