//! Bus servos on a serial line.
//!
//! Role: for each packet of the link, the thread of the line takes what servos have answered, and writes one message.
//! Contract: whoever closes the line brings its servos to rest, for a second at most, and takes their torque.
//! Limits: if the process is killed, `facewire rest` takes their torque. Servos of a line that is unplugged keep it.

use std::io::{self, Read as _, Write as _};
use std::path::PathBuf;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use facewire_board::{Attached, latency_remedy, root};
use facewire_packet::{Packet, Reason};
use facewire_servo::bus::Line;
use serialport::{SerialPort as _, TTYPort};

use super::background::Device;
use super::serial::{PortClaim, PortSearch, in_time, log_rate, lost, open_at_rate};
use super::{LinkError, Panel};
use crate::config::BusServoSettings;
use crate::retry::LoggedReasons;

/// The longest message of 30 servos at the usual 1,000,000 baud takes 4 ms.
const WRITE_TIMEOUT: Duration = Duration::from_millis(10);
const STEP: Duration = Duration::from_millis(20);
/// How long servos have for their way to rest when the line is closed: a second.
const STEPS_TO_REST: usize = 50;

pub struct Servos {
    settings: BusServoSettings,
    panel: Arc<Panel>,
    logged: LoggedReasons,
}

impl Servos {
    pub fn new(settings: &BusServoSettings, panel: Arc<Panel>) -> Self {
        Self { settings: settings.clone(), panel, logged: LoggedReasons::default() }
    }
}

pub struct Port {
    device: PathBuf,
    tty: TTYPort,
    /// The rate that the driver makes.
    made_baud: u32,
    line: Line,
    told_troubles: String,
    panel: Arc<Panel>,
    _claim: PortClaim,
}

impl Device for Servos {
    type Open = Port;

    fn open(&mut self) -> Result<Port, LinkError> {
        let BusServoSettings { device, baud, family, unit, channels } = &self.settings;
        let device = PortSearch::new(device, Attached::BusServos).find()?;
        let _claim = PortClaim::acquire(&device)?;
        let (tty, made_baud) = open_at_rate(&device, *baud, WRITE_TIMEOUT)?;
        let line = Line::new(family, *unit, *baud, channels, &self.panel.dials);
        Ok(Port { device, tty, made_baud, line, told_troubles: String::new(), panel: Arc::clone(&self.panel), _claim })
    }

    fn log_opened(&mut self, port: &Port) {
        self.logged = LoggedReasons::default();
        log_rate(&port.device, self.settings.baud, port.made_baud);
        if let Some(late) = latency_remedy(&root(), &port.device) {
            tracing::warn!("link {}: {late}", port.device.display());
        }
    }

    fn write(&mut self, port: &mut Port, message: &[u8]) -> Result<bool, LinkError> {
        let Ok(packet) = Packet::decode(message) else { return Ok(false) };
        // Closing the port brings the servos to rest, so the reason "stopping" is not passed on.
        let is_made = port.step(&Packet { reason: Reason::None, ..packet });
        port.tell(&mut self.logged);
        is_made.map_err(|error| lost(&port.device, error))
    }

    fn let_go(&mut self, port: &mut Port) -> Result<(), LinkError> {
        port.let_go().map_err(|error| lost(&port.device, error))
    }
}

impl Port {
    /// Moves the servos on, unless the system or the line still has the last message.
    fn step(&mut self, packet: &Packet) -> io::Result<bool> {
        if self.tty.bytes_to_write().is_ok_and(|unsent| unsent > 0) {
            return Ok(false);
        }
        let mut input = [0; 1024];
        let waiting = input.get_mut(..(self.tty.bytes_to_read()? as usize).min(1024)).unwrap_or_default();
        self.tty.read_exact(waiting)?;
        let mut message = Vec::new();
        let is_made = self.line.step(packet, waiting, Instant::now(), &mut message);
        Ok(is_made && in_time(self.tty.write(&message))? == Some(message.len()))
    }

    fn tell(&mut self, logged: &mut LoggedReasons) {
        let troubles = self.line.troubles();
        if troubles == self.told_troubles {
            return;
        }
        self.panel.note(Some(troubles.as_str()).filter(|troubles| !troubles.is_empty()));
        for trouble in troubles.lines() {
            if !self.told_troubles.contains(trouble) && logged.is_new(trouble) {
                tracing::warn!("link {}: {trouble}", self.device.display());
            }
        }
        self.told_troubles = troubles;
    }

    fn let_go(&mut self) -> io::Result<()> {
        for _ in 0..STEPS_TO_REST {
            thread::sleep(STEP);
            self.step(&Packet::NEUTRAL)?;
            if self.line.is_at_rest() {
                break;
            }
        }
        // The answer to the last question must be over before the line carries the message that takes the torque.
        thread::sleep(STEP);
        let mut message = Vec::new();
        self.line.release(&mut message);
        in_time(self.tty.write(&message)).map(drop)
    }
}
