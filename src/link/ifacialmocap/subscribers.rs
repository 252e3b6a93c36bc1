//! Receivers that ask for the stream of an iPhone, and get facewire's.
//!
//! A receiver asks once, when it starts, so no time limit applies: each has a connected socket of its own, to which the
//! system reports that nobody listens or that the host is away, and one that has been away for some seconds is dropped.
//! There are at most 8 of them, and a newcomer takes the place only of one that asked more than a minute ago. The log gets
//! a few lines at a time, whatever strangers send.

use std::{
    fmt,
    io::{self, ErrorKind},
    mem,
    net::{SocketAddr, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    time::{Duration, Instant},
};

use super::LONGEST;
use crate::config::IFacialMocapSettings;
use crate::link::udp::socket_for;
use crate::link::{Background, Carrier, Device, LinkError, LinkErrorKind, Traffic, UdpCarrier};

/// What a receiver sends to ask for the stream.
const REQUEST: &[u8] = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719";
/// What follows the request if the receiver wants version 2.
const SECOND: &[u8] = b"|sendDataVersion=v2";
/// Most datagrams that are read between two messages of the stream: more than the system keeps.
const MOST_AT_ONCE: usize = 1000;
/// Most receivers that asked.
const MOST: usize = 8;
/// A receiver that has not asked for this long may lose its place to a newcomer.
const RECENT: Duration = Duration::from_mins(1);
/// Time between two checks whether receivers are still there.
const CHECK_PERIOD: Duration = Duration::from_millis(500);
/// A receiver that this many checks in a row found away is dropped.
const MOST_CHECKS_AWAY: u32 = 6;
/// Most lines of the log in a period. The last of them says that the log will be silent.
const MOST_LINES: u32 = 20;
/// Length of a period of the log, from its first line on.
const LOG_PERIOD: Duration = Duration::from_mins(10);

/// Reads a request for version 1 or 2 of the text. Returns `None` for anything else. An unknown ending after `|` means
/// version 1, as for the app.
pub fn request(datagram: &[u8]) -> Option<u32> {
    let ending = datagram.strip_prefix(REQUEST)?;
    // Some receivers fill a buffer of fixed size with zeros.
    let is_filling = |byte: &u8| *byte == 0 || byte.is_ascii_whitespace();
    let end = ending.iter().rposition(|byte| !is_filling(byte)).map_or(0, |last| last + 1);
    match ending.get(..end)? {
        SECOND => Some(2),
        [] | [b'|', ..] => Some(1),
        _ => None,
    }
}

/// A text of version 2, and the same in version 1.
#[derive(Debug, Default)]
struct First(Vec<u8>);

impl First {
    fn of(&mut self, second: &[u8]) -> &[u8] {
        self.0.clear();
        self.0.extend(second.iter().map(|byte| if *byte == b'&' { b'-' } else { *byte }));
        &self.0
    }
}

/// Datagrams to those who asked for them, and to one address that gets them unasked.
#[derive(Debug)]
pub struct Subscribers {
    server: Option<Background>,
    has_subscriber: Arc<AtomicBool>,
    /// The carrier to the address, and the version that goes there.
    fixed: Option<(UdpCarrier, u32)>,
    first: First,
}

impl Subscribers {
    /// Starts to listen.
    pub fn open(settings: &IFacialMocapSettings, traffic: Arc<Traffic>) -> Result<Self, LinkError> {
        let has_subscriber = Arc::<AtomicBool>::default();
        // A message to the address counts, whoever else gets it.
        let others = if settings.address.is_some() { Arc::default() } else { Arc::clone(&traffic) };
        let server = settings.listen.map(|listen| {
            let server = Server::new(listen, settings.reply_port, Arc::clone(&has_subscriber));
            Background::start(listen.to_string(), "fw-subscribe", server, true, others)
        });
        let fixed = settings.address.as_ref().map(|address| UdpCarrier::open(address, traffic)).transpose()?;
        let fixed = fixed.map(|carrier| (carrier, settings.version));
        Ok(Self { server: server.transpose()?, has_subscriber, fixed, first: First(Vec::with_capacity(LONGEST)) })
    }
}

impl Carrier for Subscribers {
    fn send(&mut self, second: &[u8]) {
        self.server.iter_mut().for_each(|server| server.send(second));
        if let Some((carrier, version)) = &mut self.fixed {
            carrier.send(if *version == 1 { self.first.of(second) } else { second });
        }
    }

    fn is_open(&self) -> bool {
        let is_fixed_open = self.fixed.as_ref().is_some_and(|(carrier, _)| carrier.is_open());
        is_fixed_open || self.server.as_ref().is_some_and(Carrier::is_open)
    }

    fn refusal(&self) -> Option<i32> {
        self.fixed.as_ref().and_then(|(carrier, _)| carrier.refusal())
    }

    /// Whether anybody wants the stream.
    fn has_receiver(&self) -> bool {
        self.fixed.is_some() || self.has_subscriber.load(Relaxed)
    }

    fn refresh(&self) {
        self.fixed.iter().for_each(|(carrier, _)| carrier.refresh());
    }

    fn stop(&self) {
        self.server.iter().for_each(Carrier::stop);
    }

    fn has_ended(&self) -> bool {
        self.server.iter().all(Carrier::has_ended)
    }
}

/// A receiver that asked, with a socket that is connected to it.
#[derive(Debug)]
struct Subscriber {
    address: SocketAddr,
    socket: UdpSocket,
    version: u32,
    asked: Instant,
    /// Whether the system has reported since the last check that the receiver is away.
    is_refused: bool,
    /// The number of checks in a row that found it away.
    checks_away: u32,
}

impl Subscriber {
    /// Sends the text. Returns whether the system took it.
    fn send(&mut self, text: &[u8]) -> bool {
        let sent = self.socket.send(text);
        self.is_refused |= sent.as_ref().is_err_and(|error| error.kind() != ErrorKind::WouldBlock);
        sent.is_ok()
    }
}

/// Takes requests, and sends to those who asked.
#[derive(Debug)]
struct Server {
    listen: SocketAddr,
    /// The port to which the stream goes; 0 for the one that the request came from.
    reply_port: u16,
    socket: Option<UdpSocket>,
    subscribers: Vec<Subscriber>,
    has_subscriber: Arc<AtomicBool>,
    checked: Instant,
    first: First,
    log: Log,
}

impl Device for Server {
    fn open(&mut self) -> Result<(), LinkError> {
        let socket = UdpSocket::bind(self.listen).and_then(|socket| socket.set_nonblocking(true).map(|()| socket));
        self.socket = Some(socket.map_err(|error| self.no_listener(error))?);
        Ok(())
    }

    fn write(&mut self, second: &[u8]) -> Result<bool, LinkError> {
        let (first, mut is_sent) = (self.first.of(second), false);
        for subscriber in &mut self.subscribers {
            is_sent |= subscriber.send(if subscriber.version == 1 { first } else { second });
        }
        Ok(is_sent)
    }

    fn attend(&mut self) -> Result<(), LinkError> {
        let now = Instant::now();
        self.take_requests(now)?;
        if now.saturating_duration_since(self.checked) >= CHECK_PERIOD {
            self.check(now);
        }
        Ok(())
    }

    fn close(&mut self) {
        self.socket = None;
    }
}

impl Server {
    fn new(listen: SocketAddr, reply_port: u32, has_subscriber: Arc<AtomicBool>) -> Self {
        let reply_port = u16::try_from(reply_port).unwrap_or_default();
        let (subscribers, checked) = (Vec::with_capacity(MOST), Instant::now());
        let (first, log) = (First::default(), Log::default());
        Self { listen, reply_port, socket: None, subscribers, has_subscriber, checked, first, log }
    }

    /// Another program, or the link that this one replaces, may have the port.
    fn no_listener(&self, error: io::Error) -> LinkError {
        let is_claimed = error.kind() == ErrorKind::AddrInUse;
        let error = LinkError::no_listener(self.listen, error);
        if is_claimed { LinkError { kind: LinkErrorKind::Claimed, ..error } } else { error }
    }

    fn take_requests(&mut self, now: Instant) -> Result<(), LinkError> {
        let mut bytes = [0; LONGEST];
        for _ in 0..MOST_AT_ONCE {
            let Some(socket) = &self.socket else { break };
            match socket.recv_from(&mut bytes) {
                Ok((length, mut from)) => {
                    let Some(version) = bytes.get(..length).and_then(request) else { continue };
                    if self.reply_port != 0 {
                        from.set_port(self.reply_port);
                    }
                    self.admit(from, version, now);
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => break,
                Err(error) => return Err(self.no_listener(error)),
            }
        }
        Ok(())
    }

    /// Gives a receiver that asks at `now` a place, if one is free or the oldest request is not recent.
    fn admit(&mut self, address: SocketAddr, version: u32, now: Instant) {
        if let Some(known) = self.subscribers.iter_mut().find(|subscriber| subscriber.address == address) {
            (known.asked, known.version) = (now, version);
            return;
        }
        let is_full = self.subscribers.len() == MOST;
        let oldest = self.subscribers.iter().enumerate().min_by_key(|(_, it)| it.asked).filter(|_| is_full);
        if oldest.is_some_and(|(_, oldest)| now.saturating_duration_since(oldest.asked) <= RECENT) {
            return;
        }
        let replaced = oldest.map(|(index, _)| index);
        // A receiver that this machine cannot reach gets no place.
        let Ok(socket) = socket_for(address).and_then(|socket| socket.connect(address).map(|()| socket)) else {
            return;
        };
        self.log.info(now, format_args!("{address} asks for the face and gets it"));
        replaced.map(|index| self.subscribers.remove(index));
        self.subscribers.push(Subscriber { address, socket, version, asked: now, is_refused: false, checks_away: 0 });
        self.has_subscriber.store(true, Relaxed);
    }

    /// Drops receivers that have been away for long.
    fn check(&mut self, now: Instant) {
        self.checked = now;
        self.subscribers.retain_mut(|it| {
            it.checks_away = if mem::take(&mut it.is_refused) { it.checks_away + 1 } else { 0 };
            let stays = it.checks_away < MOST_CHECKS_AWAY;
            if !stays {
                self.log.info(now, format_args!("{} is away, and no longer gets the face", it.address));
            }
            stays
        });
        self.has_subscriber.store(!self.subscribers.is_empty(), Relaxed);
    }
}

/// Lines about receivers. Anybody can send requests, also in the name of others, so their number is limited.
#[derive(Debug, Default)]
struct Log {
    begun: Option<Instant>,
    /// How many lines the log got since then.
    lines: u32,
}

impl Log {
    /// Writes the line, unless the log got its share of this period.
    fn info(&mut self, now: Instant, line: fmt::Arguments<'_>) {
        if self.begun.is_none_or(|begun| now.saturating_duration_since(begun) >= LOG_PERIOD) {
            (self.begun, self.lines) = (Some(now), 0);
        }
        self.lines = self.lines.saturating_add(1);
        if self.lines < MOST_LINES {
            tracing::info!("iFacialMocap: {line}");
        } else if self.lines == MOST_LINES {
            let minutes = LOG_PERIOD.as_secs() / 60;
            tracing::warn!(
                "iFacialMocap: {line}; so many come and go that the log is silent about them for {minutes} minutes"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, fs::File, net::Ipv4Addr};

    use super::*;
    use crate::config::Address;
    use crate::link::testing::eventually;

    const FACE: &[u8] = b"jawOpen&50|=head#-1,0,0,0,0,0|";
    const FACE_1: &[u8] = b"jawOpen-50|=head#-1,0,0,0,0,0|";

    fn ask(ending: &str) -> Vec<u8> {
        [REQUEST, ending.as_bytes()].concat()
    }

    #[test]
    fn only_the_apps_own_request_is_answered() {
        for (ending, version) in [
            ("", Some(1)),
            ("\n\0\0\0", Some(1)),
            ("|sendDataVersion=v2", Some(2)),
            ("|sendDataVersion=v2\0\0\0", Some(2)),
            ("|sendDataVersion=v3", Some(1)),
            ("x", None),
        ] {
            assert_eq!(request(&ask(ending)), version, "{ending:?}");
        }
        for other in [&b""[..], b"iFacialMocap_", b"\xff\0\x80", &[b"iFacialMocap_UDPTCP_", &REQUEST[13..]].concat()] {
            assert_eq!(request(other), None, "{other:?}");
        }
    }

    /// A server that runs only when it is called, with its address.
    fn server() -> (Server, SocketAddr) {
        let mut server = Server::new((Ipv4Addr::LOCALHOST, 0).into(), 0, Arc::default());
        server.open().unwrap();
        let address = server.socket.as_ref().unwrap().local_addr().unwrap();
        (server, address)
    }

    fn receiver() -> UdpSocket {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_nonblocking(true).unwrap();
        socket
    }

    /// Sends the face, and returns what this receiver gets.
    fn face_at(server: &mut Server, socket: &UdpSocket) -> Vec<u8> {
        let mut bytes = [0; 100];
        while socket.recv(&mut bytes).is_ok() {}
        server.attend().unwrap();
        server.write(FACE).unwrap();
        let length = socket.recv(&mut bytes).unwrap_or_default();
        bytes[..length].to_vec()
    }

    #[test]
    fn whoever_asks_gets_the_face_in_the_version_asked_for() {
        let (mut server, address) = server();
        let [first, second] = [receiver(), receiver()];
        first.send_to(&ask(""), address).unwrap();
        assert_eq!([face_at(&mut server, &first), face_at(&mut server, &second)], [FACE_1, b""]);
        second.send_to(&ask("|sendDataVersion=v2"), address).unwrap();
        assert_eq!([face_at(&mut server, &second), face_at(&mut server, &first)], [FACE, FACE_1]);
        first.send_to(&ask("|sendDataVersion=v2"), address).unwrap();
        assert_eq!(face_at(&mut server, &first), FACE, "the last request counts");
    }

    #[test]
    fn a_receiver_that_vanishes_is_dropped_and_the_others_keep_the_face() {
        let (mut server, address) = server();
        let [stays, leaves] = [receiver(), receiver()];
        for socket in [&stays, &leaves] {
            socket.send_to(&ask(""), address).unwrap();
            assert_eq!(face_at(&mut server, socket), FACE_1);
        }
        drop(leaves);
        for check in 1..=MOST_CHECKS_AWAY {
            // The system reports with the second datagram that nobody took the first.
            assert_eq!([(); 2].map(|()| face_at(&mut server, &stays)), [FACE_1; 2]);
            server.check(Instant::now());
            assert_eq!(server.subscribers.len(), if check < MOST_CHECKS_AWAY { 2 } else { 1 });
        }
        assert_eq!(face_at(&mut server, &stays), FACE_1);
        drop(stays);
        (0..MOST_CHECKS_AWAY).for_each(|_| {
            let _ = [(); 2].map(|()| server.write(FACE));
            server.check(Instant::now());
        });
        assert!(!server.has_subscriber.load(Relaxed), "nobody is left");
    }

    #[test]
    fn ten_thousand_hostile_datagrams_change_nothing() {
        let (mut server, address) = server();
        let friend = receiver();
        friend.send_to(&ask(""), address).unwrap();
        let (enemy, fickle, mut random) = (receiver(), receiver(), fastrand::Rng::with_seed(7));
        for round in 0..10_000 {
            let mut bytes = ask("|sendDataVersion=v2");
            let at = random.usize(..REQUEST.len());
            bytes[at] ^= 1 << random.u8(..8);
            bytes.truncate(if round % 2 == 0 { bytes.len() } else { random.usize(..REQUEST.len()) });
            enemy.send_to(&bytes, address).unwrap();
            fickle.send_to(&ask(["", "|sendDataVersion=v2"][round % 2]), address).unwrap();
            if round % 50 == 0 {
                server.attend().unwrap();
            }
        }
        server.attend().unwrap();
        assert_eq!(server.subscribers.len(), 2);
        let forged = (1..=100).map(|host| UdpSocket::bind((Ipv4Addr::new(127, 0, 1, host), 0)).unwrap());
        forged.for_each(|socket| _ = socket.send_to(&ask(""), address).unwrap());
        assert_eq!(face_at(&mut server, &friend), FACE_1);
        assert_eq!(server.subscribers.len(), MOST);
    }

    fn port(port: u16) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, port).into()
    }

    /// Returns how many lines the log gets.
    fn log_lines(work: impl FnOnce()) -> usize {
        let file = tempfile::NamedTempFile::new().unwrap();
        let writer = Arc::<File>::new(file.reopen().unwrap());
        tracing::subscriber::with_default(tracing_subscriber::fmt().with_writer(writer).finish(), work);
        fs::read_to_string(file.path()).unwrap().lines().count()
    }

    #[test]
    fn neither_a_fickle_receiver_nor_forged_addresses_fill_the_log() {
        let (mut server, begun) = (server().0, Instant::now());
        assert_eq!(log_lines(|| (0..10_000).for_each(|round| server.admit(port(1), 1 + round % 2, begun))), 1);
        // Each round comes when the places of the round before may be taken. All fall into one period.
        let round = |number: u16| begun + u32::from(number / 100) * (RECENT + Duration::from_secs(1));
        let forge = || (100..1000).for_each(|number| server.admit(port(number), 1, round(number)));
        assert_eq!(log_lines(forge), MOST_LINES as usize - 1);
        let later = begun + 2 * LOG_PERIOD;
        assert_eq!(log_lines(|| server.admit(port(9999), 1, later)), 1, "a new period");
    }

    #[test]
    fn places_are_limited_and_a_newcomer_takes_only_that_of_one_who_asked_long_ago() {
        let (mut server, begun) = (server().0, Instant::now());
        (1..=20).for_each(|number| server.admit(port(number), 1, begun));
        let ports = |server: &Server| server.subscribers.iter().map(|it| it.address.port()).collect::<Vec<_>>();
        assert_eq!(ports(&server), (1..=8).collect::<Vec<_>>());
        server.admit(port(1), 1, begun + RECENT);
        let later = begun + RECENT + Duration::from_secs(1);
        // Nobody can connect to this address: nobody loses a place to it.
        server.admit("[fe80::1]:9".parse().unwrap(), 1, later);
        assert_eq!(ports(&server), (1..=8).collect::<Vec<_>>());
        server.admit(port(30), 1, later);
        assert_eq!(ports(&server), [1, 3, 4, 5, 6, 7, 8, 30]);
    }

    #[test]
    fn a_link_sends_to_those_who_ask_and_to_its_address_and_hands_its_port_over_to_the_next_one() {
        let (fixed, asks) = (receiver(), receiver());
        let listen = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let settings = |address: Option<&UdpSocket>| IFacialMocapSettings {
            listen: Some(listen),
            reply_port: 0,
            address: address.and_then(|it| Address::new(&it.local_addr().unwrap().to_string())),
            version: 1,
        };
        let traffic = Arc::<Traffic>::default();
        let mut old = Subscribers::open(&settings(Some(&fixed)), Arc::clone(&traffic)).unwrap();
        eventually("the port is open", || old.server.as_ref().unwrap().is_open());
        let mut other = server().0;
        other.listen = listen;
        assert_eq!(other.open().unwrap_err().kind, LinkErrorKind::Claimed);
        old.send(FACE);
        let mut bytes = [0; 100];
        assert_eq!(fixed.recv(&mut bytes).map(|length| bytes[..length].to_vec()).unwrap(), FACE_1);
        assert_eq!([&traffic.sent, &traffic.dropped].map(|count| count.load(Relaxed)), [1, 0]);
        drop(old);
        let mut new = Subscribers::open(&settings(None), Arc::clone(&traffic)).unwrap();
        eventually("the new link has the port", || new.is_open());
        assert!(!new.has_receiver());
        asks.send_to(&ask(""), listen).unwrap();
        eventually("somebody has asked", || new.has_receiver());
        new.send(FACE);
        eventually("the face", || asks.recv(&mut bytes).is_ok());
        eventually("the count", || traffic.sent.load(Relaxed) == 2);
    }
}
