//! Links: where the face is sent, in which format, and when.
//!
//! Role: a [`Link`] joins a [`Format`] (the bytes of an output), a [`Pace`] (when an output is due) and a [`Carrier`]
//! (how bytes reach the receiver).
//! Contract: an open link never fails, blocks, allocates or logs on the caller's thread. It counts what it could not
//! send, because a receiver may appear and disappear at any time. No link waits for another.
//! Limits: nothing is queued or sent again, because the next packet is newer.
//!
//! A new format takes a file with an `impl Format` and an arm in [`format_of`]; its settings are a table and a kind in
//! `config/link.rs`. A protocol whose receivers subscribe needs a carrier that also receives: see
//! [`Subscribers`].

mod angles;
mod background;
mod check;
mod ifacialmocap;
mod json;
mod lines;
mod live_link;
pub mod maestro;
mod osc;
mod output;
mod pace;
mod packet;
pub mod pca9685;
mod serial;
#[cfg(test)]
mod testing;
mod udp;
mod vmc;
mod vrchat;

use std::fmt::{Debug, Display};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

pub use background::{Background, Device};
pub use check::{check_settings, notes};
pub use ifacialmocap::request as ifacialmocap_request;
use output::Shown;
#[cfg(test)]
pub(crate) use output::test_output;
pub use output::{Output, Pose};
pub use pace::{Pace, Sent};
use serial::PortClaim;
pub use serial::{PortSearch, is_maestro, lost, open_port, serial_carrier};
pub use udp::UdpCarrier;

use self::ifacialmocap::{IFacialMocap, Subscribers};
use self::json::JsonLines;
use self::lines::{socket_carrier, stdout_carrier};
use self::live_link::LiveLink;
use self::maestro::Maestro;
use self::packet::{Datagrams, Frames};
use self::vmc::Vmc;
use self::vrchat::Vrchat;
use crate::config::{CarrierSettings, LinkKind, LinkSettings};

/// Turns outputs into bytes.
pub trait Format: Debug + Send {
    /// Encodes the output as the link's packet number `sequence`, in memory that was taken when the link was opened, and
    /// calls `send` once for each message. The output is as the settings of the link want it: adjusted, and held or
    /// neutral while no face is followed.
    fn encode(&mut self, output: &Output, sequence: u32, send: &mut dyn FnMut(&[u8]));

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

    /// The system's error number if the network refused the last message. Serial ports log their errors themselves.
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
    pub packets: AtomicU64,
    pub sent: AtomicU64,
    pub dropped: AtomicU64,
}

impl Traffic {
    fn count(counter: &AtomicU64) {
        counter.fetch_add(1, Relaxed);
    }
}

/// What `[send]` and `[failsafe]` say about the speed of all links.
#[derive(Debug, Clone, Copy)]
pub struct Rates {
    pub send_hz: u32,
    pub slew_per_s: f32,
}

/// A connection to one receiver.
#[derive(Debug)]
pub struct Link {
    format: Box<dyn Format>,
    carrier: Box<dyn Carrier>,
    traffic: Arc<Traffic>,
    sequence: u32,
    shown: Shown,
    last: Option<Sent>,
}

/// Why a link is not open, in one sentence for the operator.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("link {message}")]
pub struct LinkError {
    pub kind: LinkErrorKind,
    pub message: String,
}

/// What follows from a [`LinkError`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkErrorKind {
    /// The host does not resolve, or no network leads there.
    Host,
    /// Nobody reads standard output.
    Output,
    /// The board may be plugged in at any time: no fault.
    Waiting,
    /// Another link has the device, which may be the one that this link replaces.
    Claimed,
    Other,
}

impl LinkError {
    pub fn new(kind: LinkErrorKind, receiver: impl Display, sentence: impl Display) -> Self {
        Self { kind, message: format!("{receiver}: {sentence}") }
    }

    fn no_thread(receiver: impl Display, error: io::Error) -> Self {
        Self::new(LinkErrorKind::Other, receiver, format!("no thread ({error}); raise the limit of threads"))
    }

    fn no_listener(place: impl Display, error: io::Error) -> Self {
        let sentence =
            format!("nothing can listen there ({error}); stop what listens there already, or give another place");
        Self::new(LinkErrorKind::Other, place, sentence)
    }
}

impl Link {
    /// Opens a link that counts into `traffic`. Threads of its own look up its host or open its serial port, again and
    /// again until they succeed.
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
    pub fn check_all(settings: &[LinkSettings]) -> Vec<Result<String, LinkError>> {
        let mut claims = Vec::new();
        settings.iter().map(|settings| Self::check(settings, &mut claims)).collect()
    }

    fn check(settings: &LinkSettings, claims: &mut Vec<PortClaim>) -> Result<String, LinkError> {
        match settings.kind.carrier() {
            CarrierSettings::Udp(address) => udp::check(address)?,
            // A service that runs already listens there itself.
            CarrierSettings::Subscribers(_) | CarrierSettings::Stdout | CarrierSettings::UnixSocket(_) => {}
            CarrierSettings::I2c(board) => pca9685::Bus::open(board)?.probe()?,
            CarrierSettings::Serial { device, baud, auto } => {
                let port = match PortSearch::new(device, auto).find() {
                    Err(error) if error.kind == LinkErrorKind::Waiting => return Ok(error.message),
                    port => port?,
                };
                claims.push(PortClaim::acquire(&port)?);
                open_port(&port, baud, Duration::ZERO)?;
                return Ok(format!("{} at {baud} baud", port.display()));
            }
        }
        Ok(settings.to_string())
    }

    /// Returns an error if the link leads to a host name that does not resolve at this moment.
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
    pub fn is_held(&self) -> bool {
        self.shown.is_held()
    }

    fn encode(&mut self, output: &Output) {
        if !self.carrier.has_receiver() {
            return;
        }
        let Self { format, carrier, traffic, .. } = self;
        format.encode(output, self.sequence, &mut |message| {
            Traffic::count(&traffic.packets);
            carrier.send(message);
        });
        self.sequence = self.sequence.wrapping_add(1);
    }

    /// How the link reaches its receiver.
    pub fn carrier(&self) -> &dyn Carrier {
        &*self.carrier
    }
}

/// Returns the format of a kind of link.
fn format_of(kind: &LinkKind) -> Box<dyn Format> {
    match kind {
        // The thread of the chip takes packets.
        LinkKind::Udp(_) | LinkKind::Pca9685(_) => Box::new(Datagrams),
        LinkKind::Serial(_) => Box::new(Frames),
        LinkKind::LiveLink(settings) => Box::new(LiveLink::new(settings)),
        LinkKind::Vmc(settings) => Box::new(Vmc::new(settings)),
        LinkKind::Vrchat(settings) => Box::new(Vrchat::new(settings)),
        LinkKind::Maestro(settings) => Box::new(Maestro::new(settings)),
        LinkKind::IFacialMocap(_) => Box::new(IFacialMocap::new()),
        LinkKind::Json(_) => Box::new(JsonLines::new()),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use facewire_packet::{Packet, State};

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
        let output = Output { followed: false, ..test_output(State::Neutral) };
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
