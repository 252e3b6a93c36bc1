//! iFacialMocap, versions 1 and 2: text that the iPhone app of this name streams to whoever asks for it.
//!
//! One datagram has the coefficients as whole percent, then the rotation of the head (degrees) with its position (metres,
//! in the camera's axes: x right in the picture, y up, z towards the camera), and the rotations of the right and of the left
//! eye. The axes are those of ARKit's face: positive are down, to the person's left, and to the right shoulder. The
//! versions differ in the character between a name and its value: `-` in version 1, `&` in version 2. The format writes
//! version 2; the carrier turns it into version 1 for those who ask for that.
//!
//! A receiver asks once, when it starts, so no time limit applies: each has a connected socket of its own, to which the
//! system reports that nobody listens or that the host is away, and one that has been away for some seconds is dropped.

use std::fmt;
use std::io::{self, ErrorKind, Write as _};
use std::mem;
use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use facewire_packet::BLENDSHAPES;

use super::angles::{Angles, Gaze};
use super::background::{Device, Session};
use super::udp::socket_for;
use super::{Background, Carrier, Format, LinkError, LinkErrorKind, Output, Traffic, UdpCarrier};
use crate::config::IFacialMocapSettings;

/// Longest text, bytes.
const LONGEST: usize = 2048;
/// What a receiver sends to ask for the stream, and what follows if it wants version 2.
const REQUEST: &[u8] = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719";
const SECOND: &[u8] = b"|sendDataVersion=v2";
/// Most datagrams that are read between two messages of the stream: more than the system keeps.
const MOST_AT_ONCE: usize = 1000;
/// Most receivers at a time.
const MOST: usize = 8;
/// A receiver that has not asked for this long may lose its place to a newcomer.
const RECENT: Duration = Duration::from_mins(1);
const CHECK_PERIOD: Duration = Duration::from_millis(500);
/// A receiver that this many checks in a row found away is dropped.
const MOST_CHECKS_AWAY: u32 = 6;
/// Most lines of the log in a period. The last of them says that the log will be silent.
const MOST_LINES: u32 = 20;
const LOG_PERIOD: Duration = Duration::from_mins(10);

#[derive(Debug)]
pub struct IFacialMocap {
    names: Vec<String>,
    text: Vec<u8>,
}

impl IFacialMocap {
    pub fn new() -> Self {
        let names = BLENDSHAPES.iter().map(|name| short(name)).collect();
        Self { names, text: Vec::with_capacity(LONGEST) }
    }

    fn write(&mut self, output: &Output, gaze: Gaze) -> io::Result<()> {
        let text = &mut self.text;
        text.clear();
        for (name, value) in self.names.iter().zip(output.pose.coefficients) {
            write!(text, "{name}&{:.0}|", 100.0 * value)?;
        }
        let [right_mm, down_mm, away_mm] = output.pose.position_mm;
        let [x, y, z] = [right_mm, 0.0 - down_mm, 0.0 - away_mm].map(|mm| 0.001 * mm);
        write_angles(text, "=head", Angles::of(output.pose.rotation))?;
        write!(text, ",{x:.4},{y:.4},{z:.4}")?;
        write_angles(text, "|rightEye", gaze.right)?;
        write_angles(text, "|leftEye", gaze.left)?;
        text.write_all(b"|")
    }
}

impl Format for IFacialMocap {
    fn encode(&mut self, output: &Output, gaze: Gaze, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        if self.write(output, gaze).is_ok() {
            send(&self.text);
        }
    }
}

fn write_angles(text: &mut Vec<u8>, name: &str, angles: Angles) -> io::Result<()> {
    let [x, y, z] = [0.0 - angles.pitch, angles.yaw, angles.roll].map(f32::to_degrees);
    write!(text, "{name}#{x:.3},{y:.3},{z:.3}")
}

/// Returns the app's name of a blendshape: `_L` and `_R` for `Left` and `Right` where a blendshape has two sides.
fn short(name: &str) -> String {
    let is_direction = ["jawLeft", "jawRight", "mouthLeft", "mouthRight"].contains(&name);
    let ending = |ending, short: &str| name.strip_suffix(ending).map(|stem| format!("{stem}{short}"));
    let short = ending("Left", "_L").or_else(|| ending("Right", "_R"));
    short.filter(|_| !is_direction).unwrap_or_else(|| name.to_owned())
}

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

/// Makes version 1 of a text, in memory that is used again for each text.
fn first<'a>(second: &[u8], text: &'a mut Vec<u8>) -> &'a [u8] {
    text.clear();
    text.extend(second.iter().map(|byte| if *byte == b'&' { b'-' } else { *byte }));
    text
}

/// Datagrams to those who asked for them, and to one address that gets them unasked.
#[derive(Debug)]
pub struct Subscribers {
    server: Option<Background>,
    has_subscriber: Arc<AtomicBool>,
    /// The carrier to the address, and the version that goes there.
    fixed: Option<UdpCarrier>,
    version: u32,
    first: Vec<u8>,
}

impl Subscribers {
    pub fn open(settings: &IFacialMocapSettings, traffic: Arc<Traffic>) -> Result<Self, LinkError> {
        let IFacialMocapSettings { listen, reply_port, address, version } = settings;
        let has_subscriber = Arc::<AtomicBool>::default();
        // With an address, only the messages to it are counted.
        let others = if address.is_some() { Arc::default() } else { Arc::clone(&traffic) };
        let server = listen.map(|listen| {
            let server = Server::new(listen, *reply_port, Arc::clone(&has_subscriber));
            Background::start(listen, "fw-subscribe", server, true, others)
        });
        let fixed = address.as_ref().map(|address| UdpCarrier::open(address, traffic)).transpose()?;
        let first = Vec::with_capacity(LONGEST);
        Ok(Self { server: server.transpose()?, has_subscriber, fixed, version: *version, first })
    }

    fn carriers(&self) -> impl Iterator<Item = &dyn Carrier> {
        let server = self.server.iter().map(|server| server as &dyn Carrier);
        server.chain(self.fixed.iter().map(|fixed| fixed as &dyn Carrier))
    }
}

impl Carrier for Subscribers {
    fn send(&mut self, second: &[u8]) {
        self.server.iter_mut().for_each(|server| server.send(second));
        if let Some(carrier) = &mut self.fixed {
            carrier.send(if self.version == 1 { first(second, &mut self.first) } else { second });
        }
    }

    fn is_open(&self) -> bool {
        self.carriers().any(Carrier::is_open)
    }

    fn refusal(&self) -> Option<i32> {
        self.carriers().find_map(Carrier::refusal)
    }

    fn has_receiver(&self) -> bool {
        self.fixed.is_some() || self.has_subscriber.load(Relaxed)
    }

    fn refresh(&self) {
        self.carriers().for_each(Carrier::refresh);
    }

    fn stop(&self) {
        self.carriers().for_each(Carrier::stop);
    }

    fn has_ended(&self) -> bool {
        self.carriers().all(Carrier::has_ended)
    }
}

#[derive(Debug)]
struct Subscriber {
    address: SocketAddr,
    socket: UdpSocket,
    version: u32,
    asked: Instant,
    /// Whether the system has reported since the last check that the receiver is away.
    is_refused: bool,
    checks_away: u32,
}

#[derive(Debug)]
struct Server {
    listen: SocketAddr,
    /// The port to which the stream goes; 0 for the one that the request came from.
    reply_port: u16,
    subscribers: Vec<Subscriber>,
    has_subscriber: Arc<AtomicBool>,
    checked: Instant,
    first: Vec<u8>,
    /// When the present period of the log began, and how many lines it got since then. Anybody can send requests, also in
    /// the name of others, so their number is limited.
    log: Option<(Instant, u32)>,
}

struct Listening<'a> {
    server: &'a mut Server,
    socket: UdpSocket,
}

impl Device for Server {
    type Session<'a> = Listening<'a>;

    fn open(&mut self) -> Result<Listening<'_>, LinkError> {
        let socket = UdpSocket::bind(self.listen).and_then(|socket| socket.set_nonblocking(true).map(|()| socket));
        let socket = socket.map_err(|error| {
            let is_claimed = error.kind() == ErrorKind::AddrInUse;
            let error = LinkError::no_listener(self.listen, error);
            if is_claimed { LinkError { kind: LinkErrorKind::Claimed, ..error } } else { error }
        })?;
        Ok(Listening { server: self, socket })
    }
}

impl Session for Listening<'_> {
    fn write(&mut self, second: &[u8]) -> Result<bool, LinkError> {
        let Server { first, subscribers, .. } = self.server;
        let (first, mut is_sent) = (self::first(second, first), false);
        for subscriber in subscribers {
            let sent = subscriber.socket.send(if subscriber.version == 1 { first } else { second });
            subscriber.is_refused |= sent.as_ref().is_err_and(|error| error.kind() != ErrorKind::WouldBlock);
            is_sent |= sent.is_ok();
        }
        Ok(is_sent)
    }

    fn attend(&mut self) -> Result<(), LinkError> {
        let (now, mut bytes) = (Instant::now(), [0; LONGEST]);
        for _ in 0..MOST_AT_ONCE {
            match self.socket.recv_from(&mut bytes) {
                Ok((length, from)) => {
                    if let Some(version) = bytes.get(..length).and_then(request) {
                        self.server.admit(from, version, now);
                    }
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => break,
                Err(error) => return Err(LinkError::no_listener(self.server.listen, error)),
            }
        }
        if now.saturating_duration_since(self.server.checked) >= CHECK_PERIOD {
            self.server.check(now);
        }
        Ok(())
    }
}

impl Server {
    fn new(listen: SocketAddr, reply_port: u32, has_subscriber: Arc<AtomicBool>) -> Self {
        let reply_port = u16::try_from(reply_port).unwrap_or_default();
        let (subscribers, checked, first) = (Vec::with_capacity(MOST), Instant::now(), Vec::new());
        Self { listen, reply_port, subscribers, has_subscriber, checked, first, log: None }
    }

    /// Gives a receiver that asks at `now` a place, if one is free or the oldest request is not recent.
    fn admit(&mut self, mut address: SocketAddr, version: u32, now: Instant) {
        if self.reply_port != 0 {
            address.set_port(self.reply_port);
        }
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
        self.log(now, format_args!("{address} asks for the face and gets it"));
        replaced.map(|index| self.subscribers.remove(index));
        self.subscribers.push(Subscriber { address, socket, version, asked: now, is_refused: false, checks_away: 0 });
        self.has_subscriber.store(true, Relaxed);
    }

    fn check(&mut self, now: Instant) {
        self.checked = now;
        for it in &mut self.subscribers {
            it.checks_away = if mem::take(&mut it.is_refused) { it.checks_away + 1 } else { 0 };
        }
        let is_away = |it: &mut Subscriber| it.checks_away >= MOST_CHECKS_AWAY;
        for Subscriber { address, .. } in self.subscribers.extract_if(.., is_away).collect::<Vec<_>>() {
            self.log(now, format_args!("{address} is away, and no longer gets the face"));
        }
        self.has_subscriber.store(!self.subscribers.is_empty(), Relaxed);
    }

    /// Writes a line about a receiver, unless the log got its share of this period.
    fn log(&mut self, now: Instant, line: fmt::Arguments<'_>) {
        let period = self.log.filter(|(begun, _)| now.saturating_duration_since(*begun) < LOG_PERIOD);
        let (begun, lines) = period.map_or((now, 1), |(begun, lines)| (begun, lines.saturating_add(1)));
        self.log = Some((begun, lines));
        if lines < MOST_LINES {
            tracing::info!("iFacialMocap: {line}");
        } else if lines == MOST_LINES {
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
    use crate::link::testing::{LEFT, encoded, eventually, face};

    const FACE: &[u8] = b"jawOpen&50|=head#-1,0,0,0,0,0|";
    const FACE_1: &[u8] = b"jawOpen-50|=head#-1,0,0,0,0,0|";
    const V2: &str = "|sendDataVersion=v2";

    #[test]
    fn a_frame_names_blendshapes_as_the_app_does_and_then_head_and_eyes_and_no_network_divides_it() {
        let look = [("eyeLookInRight", 1.0), ("eyeLookDownLeft", 1.0), ("mouthSmileRight", 0.126), ("jawLeft", 1.0)];
        let mut output = face(&look);
        (output.pose.rotation, output.pose.position_mm) = (LEFT, [100.0, 50.0, 600.0]);
        let text = |output: &Output| String::from_utf8(encoded(&mut IFacialMocap::new(), output).concat()).unwrap();
        let frame = text(&output);
        let end =
            "|=head#0.000,30.000,0.000,0.1000,-0.0500,-0.6000|rightEye#0.000,35.000,0.000|leftEye#35.000,0.000,0.000|";
        for part in ["|mouthSmile_R&13|", "eyeBlink_L&0|", "|jawLeft&100|", "|browInnerUp&0|", "|mouthRight&0|", end] {
            assert!(frame.contains(part), "{part} in {frame}");
        }
        assert_eq!(frame.matches('&').count(), 52);
        (output.pose.coefficients, output.pose.position_mm) = ([1.0; 52], [-30_000.0; 3]);
        assert!(text(&output).len() < 1400);
    }

    fn ask(ending: &str) -> Vec<u8> {
        [REQUEST, ending.as_bytes()].concat()
    }

    #[test]
    fn only_the_apps_own_request_is_answered() {
        let endings = ["", "\n\0\0\0", V2, "|sendDataVersion=v2\0\0\0", "|sendDataVersion=v3", "x"];
        let versions = endings.map(|ending| request(&ask(ending)));
        assert_eq!(versions, [Some(1), Some(1), Some(2), Some(2), Some(1), None]);
        let other = [b"iFacialMocap_UDPTCP_", &REQUEST[13..]].concat();
        assert_eq!([b"iFacialMocap_", &other[..]].map(request), [None; 2]);
    }

    fn port(port: u16) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, port).into()
    }

    fn server() -> Server {
        Server::new(port(0), 0, Arc::default())
    }

    fn receiver() -> UdpSocket {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_nonblocking(true).unwrap();
        socket
    }

    impl Listening<'_> {
        fn gets(&self, ending: &str, from: &UdpSocket) {
            from.send_to(&ask(ending), self.socket.local_addr().unwrap()).unwrap();
        }

        /// Sends the face, and returns what this receiver gets.
        fn face_at(&mut self, socket: &UdpSocket) -> Vec<u8> {
            let mut bytes = [0; 100];
            while socket.recv(&mut bytes).is_ok() {}
            self.attend().unwrap();
            self.write(FACE).unwrap();
            let length = socket.recv(&mut bytes).unwrap_or_default();
            bytes[..length].to_vec()
        }
    }

    #[test]
    fn a_receiver_that_vanishes_is_dropped_and_the_others_keep_the_face() {
        let (mut server, stays, leaves) = (server(), receiver(), receiver());
        let mut session = server.open().unwrap();
        session.gets(V2, &stays);
        assert_eq!([session.face_at(&stays), session.face_at(&leaves)], [FACE, b""]);
        session.gets("", &leaves);
        assert_eq!([session.face_at(&leaves), session.face_at(&stays)], [FACE_1, FACE]);
        session.gets("", &stays);
        drop(leaves);
        for check in 1..=MOST_CHECKS_AWAY {
            // The system reports with the second datagram that nobody took the first. The last request of `stays` counts.
            assert_eq!([(); 2].map(|()| session.face_at(&stays)), [FACE_1; 2]);
            session.server.check(Instant::now());
            assert_eq!(session.server.subscribers.len(), if check < MOST_CHECKS_AWAY { 2 } else { 1 });
        }
        assert_eq!(session.face_at(&stays), FACE_1);
        drop(stays);
        for _ in 0..MOST_CHECKS_AWAY {
            let _ = [(); 2].map(|()| session.write(FACE));
            session.server.check(Instant::now());
        }
        assert!(!server.has_subscriber.load(Relaxed), "nobody is left");
    }

    #[test]
    fn ten_thousand_hostile_datagrams_change_nothing() {
        let (mut server, friend, enemy, fickle) = (server(), receiver(), receiver(), receiver());
        let (mut session, mut random) = (server.open().unwrap(), fastrand::Rng::with_seed(7));
        let address = session.socket.local_addr().unwrap();
        session.gets("", &friend);
        for round in 0..10_000 {
            let mut bytes = ask(V2);
            let at = random.usize(..REQUEST.len());
            bytes[at] ^= 1 << random.u8(..8);
            bytes.truncate(if round % 2 == 0 { bytes.len() } else { random.usize(..REQUEST.len()) });
            enemy.send_to(&bytes, address).unwrap();
            session.gets(["", V2][round % 2], &fickle);
            if round % 50 == 49 {
                session.attend().unwrap();
            }
        }
        assert_eq!(session.server.subscribers.len(), 2);
        let forged = (1..=100).map(|host| UdpSocket::bind((Ipv4Addr::new(127, 0, 1, host), 0)).unwrap());
        forged.for_each(|socket| session.gets("", &socket));
        assert_eq!(session.face_at(&friend), FACE_1);
        assert_eq!(session.server.subscribers.len(), MOST);
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
        let (mut server, begun) = (server(), Instant::now());
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
        let (mut server, begun) = (server(), Instant::now());
        (1..=20).for_each(|number| server.admit(port(number), 1, begun));
        let later = begun + RECENT + Duration::from_secs(1);
        server.admit(port(1), 1, begun + RECENT);
        // Nobody can connect to this address: nobody loses a place to it.
        server.admit("[fe80::1]:9".parse().unwrap(), 1, later);
        let ports = |server: &Server| server.subscribers.iter().map(|it| it.address.port()).collect::<Vec<_>>();
        assert_eq!(ports(&server), [1, 2, 3, 4, 5, 6, 7, 8]);
        server.admit(port(30), 1, later);
        assert_eq!(ports(&server), [1, 3, 4, 5, 6, 7, 8, 30]);
    }

    #[test]
    fn a_link_sends_to_those_who_ask_and_to_its_address_and_hands_its_port_over_to_the_next_one() {
        let (fixed, asks, traffic) = (receiver(), receiver(), Arc::<Traffic>::default());
        let listen = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let open = |address: Option<&UdpSocket>| {
            let address = address.and_then(|it| Address::new(&it.local_addr().unwrap().to_string()));
            let settings = IFacialMocapSettings { listen: Some(listen), reply_port: 0, address, version: 1 };
            let link = Subscribers::open(&settings, Arc::clone(&traffic)).unwrap();
            eventually("the port is open", || link.server.as_ref().unwrap().is_open());
            link
        };
        let mut old = open(Some(&fixed));
        let claimed = Server::new(listen, 0, Arc::default()).open().map(drop).unwrap_err();
        assert_eq!(claimed.kind, LinkErrorKind::Claimed);
        old.send(FACE);
        let mut bytes = [0; 100];
        assert_eq!(fixed.recv(&mut bytes).map(|length| bytes[..length].to_vec()).unwrap(), FACE_1);
        assert_eq!([&traffic.sent, &traffic.dropped].map(|count| count.load(Relaxed)), [1, 0]);
        drop(old);
        let mut new = open(None);
        assert!(!new.has_receiver());
        asks.send_to(&ask(""), listen).unwrap();
        eventually("somebody has asked", || new.has_receiver());
        new.send(FACE);
        eventually("the face", || asks.recv(&mut bytes).is_ok());
        eventually("the count", || traffic.sent.load(Relaxed) == 2);
    }
}
