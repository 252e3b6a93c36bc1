//! Receivers that ask for the stream of an iPhone, and get facewire's.
//!
//! A thread listens for requests and hands the receivers over through a triple buffer. A receiver asks once, when it
//! starts, so no time limit applies: each has a connected socket of its own, to which the system reports that nobody
//! listens or that the host is away, and one that has been away for some seconds is dropped. There are at most
//! 8 of them, and a newcomer takes the place only of one that asked more than a minute ago. The log gets a few lines at a
//! time, whatever strangers send.

mod places;

use std::{
    io::{self, ErrorKind},
    net::{SocketAddr, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU32, Ordering::Relaxed},
    },
    thread,
    time::{Duration, Instant},
};

use triple_buffer::{Output as Newest, triple_buffer};

use self::places::Places;
use crate::config::IFacialMocapSettings;
use crate::link::handover::HANDOVER;
use crate::link::udp::socket_for;
use crate::link::{Carrier, LinkError, Traffic, UdpCarrier};
use crate::retry::Retry;

/// What a receiver sends to ask for the stream.
const REQUEST: &[u8] = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719";
/// What follows the request if the receiver wants version 2.
const SECOND: &[u8] = b"|sendDataVersion=v2";
/// Room for one datagram of the stream.
const LONGEST: usize = 2048;
/// Time between two checks whether receivers are still there.
const LOOK: Duration = Duration::from_millis(500);
/// Time between two attempts to bind the port during a handover.
const BIND_RETRY_PERIOD: Duration = Duration::from_millis(20);

/// The version of the text that a receiver wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Version {
    /// `name-value`.
    First,
    /// `name&value`.
    Second,
}

/// Reads a request. Returns `None` for anything else. An unknown ending after `|` means version 1, as for the
/// app.
#[must_use]
pub fn request(datagram: &[u8]) -> Option<Version> {
    let ending = datagram.strip_prefix(REQUEST)?;
    // Some receivers fill a buffer of fixed size with zeros.
    let is_filling = |byte: &u8| *byte == 0 || byte.is_ascii_whitespace();
    let end = ending.iter().rposition(|byte| !is_filling(byte)).map_or(0, |last| last + 1);
    match ending.get(..end)? {
        SECOND => Some(Version::Second),
        [] | [b'|', ..] => Some(Version::First),
        _ => None,
    }
}

/// A receiver, with a socket that is connected to it.
#[derive(Debug)]
struct Subscriber {
    socket: UdpSocket,
    /// Whether it wants version 2.
    is_second: AtomicBool,
    /// How often the system has reported since the last check that the receiver is away.
    refusals: AtomicU32,
}

impl Subscriber {
    fn open(receiver: SocketAddr, version: Version) -> io::Result<Self> {
        let socket = socket_for(receiver)?;
        socket.connect(receiver)?;
        let subscriber = Self { socket, is_second: AtomicBool::default(), refusals: AtomicU32::default() };
        subscriber.choose(version);
        Ok(subscriber)
    }

    fn choose(&self, version: Version) {
        self.is_second.store(version == Version::Second, Relaxed);
    }

    /// Sends the text of its version. Returns whether the system took it.
    fn send(&self, first: &[u8], second: &[u8]) -> bool {
        let text = if self.is_second.load(Relaxed) { second } else { first };
        match self.socket.send(text) {
            Ok(_) => true,
            Err(error) => {
                self.refusals.fetch_add(u32::from(error.kind() != ErrorKind::WouldBlock), Relaxed);
                false
            }
        }
    }
}

/// The receivers at one moment.
type List = Vec<Arc<Subscriber>>;

/// Datagrams to those who asked for them, and to one address that gets them unasked.
#[derive(Debug)]
pub struct Subscribers {
    list: Newest<List>,
    fixed: Option<(UdpCarrier, Version)>,
    /// The text in version 1.
    first: Vec<u8>,
    traffic: Arc<Traffic>,
    shared: Arc<Shared>,
}

/// What the carrier and its thread share.
#[derive(Debug, Default)]
struct Shared {
    is_over: AtomicBool,
    is_listening: AtomicBool,
}

impl Subscribers {
    /// Starts to listen.
    ///
    /// # Errors
    /// Returns an error if the system refuses a thread, or a socket for an address in numbers.
    pub fn open(settings: &IFacialMocapSettings, traffic: Arc<Traffic>) -> Result<Self, LinkError> {
        let (input, list) = triple_buffer(&List::new());
        let shared = Arc::<Shared>::default();
        if let Some(listen) = settings.listen.0 {
            let reply_port = u16::try_from(settings.reply_port).unwrap_or_default();
            let places = Places::new(input);
            let handover_end = Instant::now() + HANDOVER;
            let listener = RequestListener { listen, reply_port, places, handover_end, shared: Arc::clone(&shared) };
            let thread = thread::Builder::new().name("fw-subscribe".to_owned()).spawn(|| listener.run());
            thread.map_err(|error| LinkError::Thread { link: listen.to_string(), error })?;
        }
        let version = if settings.version == 1 { Version::First } else { Version::Second };
        let fixed = settings.address.0.as_ref().map(|address| UdpCarrier::open(address, Arc::default())).transpose()?;
        let fixed = fixed.map(|carrier| (carrier, version));
        Ok(Self { list, fixed, first: Vec::with_capacity(LONGEST), traffic, shared })
    }
}

impl Carrier for Subscribers {
    fn send(&mut self, second: &[u8]) {
        self.first.clear();
        self.first.extend(second.iter().map(|byte| if *byte == b'&' { b'-' } else { *byte }));
        let mut is_sent = false;
        for subscriber in self.list.read() {
            is_sent |= subscriber.send(&self.first, second);
        }
        if let Some((carrier, version)) = &mut self.fixed {
            carrier.send(if *version == Version::First { &self.first } else { second });
            is_sent |= carrier.is_open();
        }
        Traffic::count(if is_sent { &self.traffic.sent } else { &self.traffic.dropped });
    }

    fn is_open(&self) -> bool {
        self.shared.is_listening.load(Relaxed) || self.fixed.as_ref().is_some_and(|(carrier, _)| carrier.is_open())
    }

    fn refusal(&self) -> Option<i32> {
        self.fixed.as_ref().and_then(|(carrier, _)| carrier.refusal())
    }

    /// Whether anybody wants the stream.
    fn has_receiver(&self) -> bool {
        // A new list is taken when the next message is sent.
        self.fixed.is_some() || self.list.updated() || !self.list.peek_output_buffer().is_empty()
    }

    fn refresh(&self) {
        self.fixed.iter().for_each(|(carrier, _)| carrier.refresh());
    }
}

impl Drop for Subscribers {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Relaxed);
    }
}

/// The thread that listens.
struct RequestListener {
    listen: SocketAddr,
    /// The port to which the stream goes; 0 for the one that the request came from.
    reply_port: u16,
    places: Places,
    /// Until when another link may hold the port.
    handover_end: Instant,
    shared: Arc<Shared>,
}

impl RequestListener {
    fn run(mut self) {
        let mut retry = Retry::default();
        while !self.shared.is_over.load(Relaxed) {
            let error = match self.bind() {
                Ok(socket) => {
                    retry = Retry::default();
                    self.shared.is_listening.store(true, Relaxed);
                    self.serve(&socket)
                }
                Err(error) if self.is_handover(&error, Instant::now()) => {
                    thread::sleep(BIND_RETRY_PERIOD);
                    continue;
                }
                Err(error) => error,
            };
            self.shared.is_listening.store(false, Relaxed);
            if !self.shared.is_over.load(Relaxed) {
                retry.warn(&LinkError::Listen { address: self.listen.to_string(), error });
                thread::sleep(retry.wait());
            }
        }
    }

    fn bind(&self) -> io::Result<UdpSocket> {
        let socket = UdpSocket::bind(self.listen)?;
        socket.set_read_timeout(Some(LOOK))?;
        Ok(socket)
    }

    /// Whether a link that a reload replaces may still hold the port.
    fn is_handover(&self, error: &io::Error, now: Instant) -> bool {
        error.kind() == ErrorKind::AddrInUse && now < self.handover_end
    }

    /// Takes requests until the link closes. Returns the error that ended this earlier.
    fn serve(&mut self, socket: &UdpSocket) -> io::Error {
        let mut bytes = [0; LONGEST];
        let mut look = Instant::now() + LOOK;
        while !self.shared.is_over.load(Relaxed) {
            match socket.recv_from(&mut bytes) {
                Ok((length, from)) => self.take(bytes.get(..length).unwrap_or_default(), from),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return error,
            }
            if Instant::now() >= look {
                look = Instant::now() + LOOK;
                self.places.look(Instant::now());
            }
        }
        ErrorKind::Interrupted.into()
    }

    fn take(&mut self, datagram: &[u8], mut from: SocketAddr) {
        let Some(version) = request(datagram) else { return };
        if self.reply_port != 0 {
            from.set_port(self.reply_port);
        }
        self.places.take(from, version, Instant::now());
    }
}

#[cfg(test)]
mod tests;
