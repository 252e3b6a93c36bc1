//! Links: where the face is sent, in which format, and when.
//!
//! Role: a [`Link`] joins a [`Format`] (the bytes of an output), a [`Pace`] (when an output is due) and a [`Carrier`]
//! (how bytes reach the receiver).
//! Contract: an open link never fails, blocks, allocates or logs on the caller's thread. It counts what it could not
//! send, because a receiver may appear and disappear at any time. No link waits for another.
//! Limits: nothing is queued or sent again, because the next packet is newer.
//!
//! A new format takes a file with an `impl Format` and an arm in [`format_of`]; its settings are a table and a kind in
//! `config/link.rs`. A protocol whose receivers subscribe needs a carrier that also receives: like
//! [`Lookup`](lookup::Lookup), it does so on a thread of its own and hands over destinations through a triple buffer.

mod background;
mod clock;
mod gaze;
mod handover;
mod head;
mod ifacialmocap;
mod json;
mod lines;
mod live_link;
mod lookup;
pub mod maestro;
mod osc;
mod output;
mod pace;
mod packet;
pub mod pca9685;
mod serial;
mod shown;
mod udp;
mod vmc;
mod vrchat;

use std::fmt::Debug;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

pub use background::{Background, Device, Shared};
pub use ifacialmocap::{Version, request as ifacialmocap_request};
#[cfg(test)]
pub(crate) use output::test_output;
pub use output::{Output, Pose};
pub use pace::{Pace, Sent};
use serial::{BoardSearch, PortClaim};
pub use serial::{PortError, PortTrouble, is_maestro, maestro_port, open_port, serial_carrier};
pub use udp::UdpCarrier;
pub(crate) use vrchat::parameter_names as vrchat_parameters;

use self::ifacialmocap::{IFacialMocap, Subscribers};
use self::json::JsonLines;
use self::lines::{socket_carrier, stdout_carrier};
use self::live_link::LiveLink;
use self::maestro::Maestro;
use self::packet::{Datagrams, Frames};
use self::pca9685::{I2cError, Pca9685};
use self::shown::Shown;
use self::vmc::Vmc;
use self::vrchat::Vrchat;
use crate::config::{CarrierSettings, LinkKind, LinkSettings, SerialDevice};

/// Turns outputs into bytes.
pub trait Format: Debug + Send {
    /// Encodes the output as the link's packet number `sequence`, in memory that was taken when the link was opened, and
    /// calls `send` once for each message. The output is as the settings of the link want it: adjusted, and held or
    /// neutral while no face is followed.
    fn encode(&mut self, output: &Output, sequence: u32, send: &mut dyn FnMut(&[u8]));

    /// Called before [`Format::encode`] if the last message has not reached the device yet: what moves by itself stays where
    /// it is.
    fn pause_motion(&mut self) {}

    /// The bytes to write to a serial port that has just been opened.
    fn preamble(&self) -> Vec<u8> {
        Vec::new()
    }

    /// What to ask the receiver on a serial port about once a second.
    fn inquiry(&self) -> Option<Inquiry> {
        None
    }
}

/// A question to a receiver on a serial port, and what its answer means.
#[derive(Debug, Clone)]
pub struct Inquiry {
    /// The bytes to write.
    pub question: Vec<u8>,
    /// Length of the answer; 0 if there is none.
    pub answer_bytes: usize,
    /// Returns a sentence for each trouble in an answer. The log gets each once until the port is opened again.
    pub troubles: fn(&[u8]) -> Vec<&'static str>,
    /// The sentence if no answer comes.
    pub silence: &'static str,
}

/// Takes bytes to a receiver.
pub trait Carrier: Debug + Send {
    /// Sends the message or drops it, without waiting, and counts it.
    fn send(&mut self, message: &[u8]);

    /// Whether messages reach the network or the serial port at present.
    fn is_open(&self) -> bool;

    /// Whether the device took a message since the last one was sent. Only carriers with a thread of their own know it.
    fn took_last(&self) -> bool {
        true
    }

    /// The error number of the system if the network refused the last message. Serial ports log their errors themselves.
    fn refusal(&self) -> Option<i32> {
        None
    }

    /// Whether the receiver is known. Until then nothing is sent or counted.
    fn has_receiver(&self) -> bool {
        true
    }

    /// Asks to look up the receiver's address now.
    fn refresh(&self) {}

    /// Asks the carrier to send what it was given and end, without waiting for it.
    fn stop(&self) {}

    /// Whether the carrier has ended after [`Carrier::stop`].
    fn has_ended(&self) -> bool {
        true
    }
}

/// Counters of the messages of all links. They only grow, and each message is counted as sent or dropped in the end.
#[derive(Debug, Default)]
pub struct Traffic {
    /// Messages that links were given to send.
    pub packets: AtomicU64,
    /// Messages that the network or a serial port took.
    pub sent: AtomicU64,
    /// Messages that were not sent, for example because a cable is unplugged.
    pub dropped: AtomicU64,
}

impl Traffic {
    fn count(counter: &AtomicU64) {
        counter.fetch_add(1, Relaxed);
    }
}

/// What the settings of all links say about speed.
#[derive(Debug, Clone, Copy)]
pub struct Rates {
    /// `rate_hz` of `[send]`.
    pub send_hz: u32,
    /// `slew_per_s` of `[failsafe]`.
    pub slew_per_s: f32,
}

/// A connection to one receiver.
#[derive(Debug)]
pub struct Link {
    format: Box<dyn Format>,
    carrier: Box<dyn Carrier>,
    traffic: Arc<Traffic>,
    /// Number of the next packet.
    sequence: u32,
    shown: Shown,
    last: Option<Sent>,
}

/// Why a link cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The host name has no address.
    #[error(
        "link {address}: the host does not resolve ({reason}); check the spelling and the network, or give its address in numbers"
    )]
    Resolve {
        /// The address in the settings.
        address: String,
        /// The error of the resolver.
        reason: String,
    },
    /// The system refused a socket.
    #[error("link {address}: no socket ({error}); check that the service may use the network")]
    Socket {
        /// The address in the settings.
        address: String,
        /// The error of the system.
        error: std::io::Error,
    },
    /// This machine has no route to the address.
    #[error("link {address}: no network leads there ({error}); check this machine's cable or Wi-Fi and the address")]
    Route {
        /// The address in the settings.
        address: String,
        /// The error of the system.
        error: std::io::Error,
    },
    /// The serial port does not open.
    #[error("link {0}")]
    Port(#[from] PortError),
    /// The chip on the I2C bus cannot be reached.
    #[error("link {0}")]
    I2c(#[from] I2cError),
    /// This machine does not let the link listen.
    #[error(
        "link {address}: nothing can listen there ({error}); stop what listens there already, or give another place"
    )]
    Listen {
        /// The address or the path in the settings.
        address: String,
        /// The error of the system.
        error: std::io::Error,
    },
    /// Nobody reads the standard output.
    #[error("link standard output: it takes no lines ({0}); start a program that reads them")]
    Output(std::io::Error),
    /// The system refused a thread.
    #[error("link {link}: no thread ({error}); raise the limit of threads")]
    Thread {
        /// The receiver in the settings.
        link: String,
        /// The error of the system.
        error: std::io::Error,
    },
}

impl LinkError {
    /// Whether the link waits for what may come at any time, which is no fault.
    #[must_use]
    pub fn is_patient(&self) -> bool {
        matches!(self, Self::Port(error) if error.waits_for_a_board())
    }
}

impl Link {
    /// Opens a link that counts into `traffic`. Threads of its own look up its host or open its serial port, again and
    /// again until they succeed.
    ///
    /// # Errors
    /// Returns an error if the system refuses a thread, or a socket for an address in numbers.
    pub fn open(settings: &LinkSettings, traffic: &Arc<Traffic>) -> Result<Self, LinkError> {
        let (format, counters) = (format_of(&settings.kind), Arc::clone(traffic));
        let carrier: Box<dyn Carrier> = match settings.kind.carrier() {
            CarrierSettings::Udp(address) => Box::new(UdpCarrier::open(address, counters)?),
            CarrierSettings::Serial { device, baud, auto } => {
                Box::new(serial_carrier(device, baud, auto, (format.preamble(), format.inquiry()), counters)?)
            }
            CarrierSettings::I2c(board) => Box::new(pca9685::carrier(board, counters)?),
            CarrierSettings::Subscribers(settings) => Box::new(Subscribers::open(settings, counters)?),
            CarrierSettings::Stdout => Box::new(stdout_carrier(counters)?),
            CarrierSettings::UnixSocket(path) => Box::new(socket_carrier(path, counters)?),
        };
        Ok(Self::new(format, carrier, traffic))
    }

    fn new(format: Box<dyn Format>, carrier: Box<dyn Carrier>, traffic: &Arc<Traffic>) -> Self {
        Self { format, carrier, traffic: Arc::clone(traffic), sequence: 0, shown: Shown::default(), last: None }
    }

    /// Tests whether these links can be opened together at this moment, without sending anything, and describes each.
    #[must_use]
    pub fn check_all(settings: &[LinkSettings]) -> Vec<Result<String, LinkError>> {
        let mut claims = Vec::new();
        settings.iter().map(|settings| Self::check(settings, &mut claims)).collect()
    }

    fn check(settings: &LinkSettings, claims: &mut Vec<PortClaim>) -> Result<String, LinkError> {
        match settings.kind.carrier() {
            CarrierSettings::Udp(address) => udp::check(address).map(|()| address.to_string()),
            // A service that runs already listens there itself.
            CarrierSettings::Subscribers(_) | CarrierSettings::Stdout | CarrierSettings::UnixSocket(_) => {
                Ok(settings.to_string())
            }
            CarrierSettings::Serial { device: SerialDevice::Path(port), baud, .. } => check_port(port, baud, claims),
            CarrierSettings::I2c(board) => Ok(pca9685::Bus::check(board.place()).map(|()| settings.to_string())?),
            CarrierSettings::Serial { device: SerialDevice::Auto, baud, auto } => {
                match BoardSearch::new(auto).find().map_err(PortError::of_the_board) {
                    Ok(port) => check_port(&port, baud, claims),
                    Err(error) if error.waits_for_a_board() => Ok(error.to_string()),
                    Err(error) => Err(error.into()),
                }
            }
        }
    }

    /// Returns an error if the link leads to a host name that does not resolve at this moment.
    ///
    /// # Errors
    /// [`LinkError::Resolve`].
    pub fn resolve(settings: &LinkSettings) -> Result<(), LinkError> {
        match settings.kind.carrier() {
            CarrierSettings::Udp(address) => udp::resolve(address).map(drop),
            _ => Ok(()),
        }
    }

    /// Sends the output if it is due. The settings may differ from those of the last call in everything but the kind.
    /// Returns how long the link can wait for the next output, in microseconds.
    pub fn offer(&mut self, settings: &LinkSettings, rates: Rates, now_us: u64, output: &Output) -> u64 {
        let pace = Pace::new(settings, rates.send_hz);
        let output = &self.shown.next(settings, rates.slew_per_s, now_us, output);
        if pace.is_due(self.last.as_ref(), now_us, output) {
            self.encode(output);
            self.last = Some(pace.sent(self.last.as_ref(), now_us, output));
        }
        pace.wait_us(self.last.as_ref(), now_us, output)
    }

    /// Sends the output at once, as the last one.
    pub fn send_last(&mut self, settings: &LinkSettings, output: &Output) {
        let output = Shown::last(settings, output);
        self.encode(&output);
    }

    /// Whether the link still shows a pose that it has held, or is on its way from there.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.shown.is_held()
    }

    fn encode(&mut self, output: &Output) {
        if !self.carrier.has_receiver() {
            return;
        }
        let Self { format, carrier, traffic, .. } = self;
        if !carrier.took_last() {
            format.pause_motion();
        }
        format.encode(output, self.sequence, &mut |message| {
            Traffic::count(&traffic.packets);
            carrier.send(message);
        });
        self.sequence = self.sequence.wrapping_add(1);
    }

    /// How the link reaches its receiver.
    #[must_use]
    pub fn carrier(&self) -> &dyn Carrier {
        &*self.carrier
    }
}

fn check_port(port: &Path, baud: u32, claims: &mut Vec<PortClaim>) -> Result<String, LinkError> {
    claims.push(PortClaim::acquire(port).map_err(|holder| PortError::claimed(port, holder))?);
    open_port(port, baud, Duration::ZERO)?;
    Ok(format!("{} at {baud} baud", port.display()))
}

/// Returns the format of a kind of link.
fn format_of(kind: &LinkKind) -> Box<dyn Format> {
    match kind {
        LinkKind::Udp(_) => Box::new(Datagrams),
        LinkKind::Serial(_) => Box::new(Frames),
        LinkKind::LiveLink(settings) => Box::new(LiveLink::new(settings)),
        LinkKind::Vmc(settings) => Box::new(Vmc::new(settings)),
        LinkKind::Vrchat(settings) => Box::new(Vrchat::new(settings)),
        LinkKind::Maestro(settings) => Box::new(Maestro::new(settings)),
        LinkKind::Pca9685(settings) => Box::new(Pca9685::new(settings)),
        LinkKind::IFacialMocap(_) => Box::new(IFacialMocap::new()),
        LinkKind::Json(_) => Box::new(JsonLines::new()),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::mpsc;

    use facewire_packet::{Packet, Reason, State};

    use super::*;

    /// A carrier that keeps what it is given.
    #[derive(Debug)]
    struct Kept(mpsc::Sender<Packet>);

    impl Carrier for Kept {
        fn send(&mut self, message: &[u8]) {
            self.0.send(Packet::decode(message).unwrap()).unwrap();
        }

        fn is_open(&self) -> bool {
            true
        }
    }

    #[test]
    fn each_link_numbers_its_own_packets_and_all_count_into_the_same_counters() {
        let traffic = Arc::<Traffic>::default();
        let open = || {
            let (sender, kept) = mpsc::channel();
            let (format, carrier) = (Box::new(Datagrams), Box::new(Kept(sender)));
            (Link::new(format, carrier, &traffic), kept)
        };
        let (state, reason, pose) = (State::Neutral, Reason::NoFace, Pose::NEUTRAL);
        let output = Output { state, reason, pose, age_us: 0, capture_us: 0, followed: false, moving: false };
        let ((mut first, kept_first), (mut second, kept_second)) = (open(), open());
        let settings = LinkSettings::default();
        (0..3).for_each(|_| first.send_last(&settings, &output));
        for now_us in [0, 1] {
            second.offer(&settings, Rates { send_hz: 60, slew_per_s: 4.0 }, now_us, &output);
        }
        let sequences =
            |kept: mpsc::Receiver<Packet>| kept.try_iter().map(|packet| packet.sequence).collect::<Vec<_>>();
        assert_eq!((sequences(kept_first), sequences(kept_second)), (vec![0, 1, 2], vec![0]));
        assert_eq!(traffic.packets.load(Relaxed), 4);
    }
}
