//! The receivers of iFacialMocap, each of which asks for the face and gets it in the version that it has asked for.
//!
//! A receiver asks once, when it starts, so no time limit applies: each has a connected socket of its own, to which the
//! system reports that its machine refuses datagrams, because nobody listens there. A receiver that has been refusing for some
//! seconds is dropped. Other errors are those of the network in between, or of an address that this machine has lost: the
//! receiver gets a new socket, and the face again once the network is back.

use std::fmt;
use std::io::{self, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use facewire_packet::formats::ifacialmocap::{LONGEST, request, set_version};

use super::background::Device;
use super::udp::socket_for;
use super::{LinkError, LinkErrorKind};

/// Most datagrams that are read between two messages of the stream: more than the system keeps.
const MOST_AT_ONCE: usize = 1000;
const MOST_SUBSCRIBERS: usize = 8;
/// A receiver that has not asked for this long may lose its place to a newcomer.
const RECENT: Duration = Duration::from_mins(1);
/// While a receiver is away, the system reports it at least this often: with every second datagram.
const REPORT_PERIOD: Duration = Duration::from_millis(500);
const LONGEST_AWAY: Duration = Duration::from_secs(3);
const REOPEN_PERIOD: Duration = Duration::from_secs(1);
/// Most lines of the log in a period. The last of them says that the log will be silent.
const MOST_LINES: u32 = 20;
const LOG_PERIOD: Duration = Duration::from_mins(10);

struct Subscriber {
    address: SocketAddr,
    socket: UdpSocket,
    version: u32,
    asked: Instant,
    /// When the network last took a datagram, and when the socket was opened.
    sent: Instant,
    opened: Instant,
    /// When the system last reported that the receiver is away, and since when it has reported that again and again.
    refused: Instant,
    away_since: Instant,
}

impl Subscriber {
    /// Replaces the socket, at most once a second. A socket keeps the address from which it sends, which this machine may have lost.
    fn reopen(&mut self, now: Instant) {
        if now.saturating_duration_since(self.opened) >= REOPEN_PERIOD
            && let Ok(socket) = connected(self.address)
        {
            self.socket = socket;
            self.opened = now;
        }
    }

    fn is_reached(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.sent) <= RECENT
    }
}

fn connected(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = socket_for(address, None)?;
    socket.connect(address)?;
    Ok(socket)
}

/// Datagrams to those who asked for them.
pub struct Server {
    listen: SocketAddr,
    /// The port to which the stream goes; 0 for the one that the request came from.
    reply_port: u16,
    subscribers: Vec<Subscriber>,
    /// The text in the version of one of them, in memory that is used again for each.
    changed: Vec<u8>,
    /// When the present period of the log began, and how many lines it got since then. Anybody can send requests, also in
    /// the name of others, so their number is limited.
    log_period: (Instant, u32),
}

impl Device for Server {
    type Open = UdpSocket;

    fn open(&mut self) -> Result<UdpSocket, LinkError> {
        let socket = UdpSocket::bind(self.listen).and_then(|socket| socket.set_nonblocking(true).map(|()| socket));
        socket.map_err(|error| {
            let is_claimed = error.kind() == ErrorKind::AddrInUse;
            let error = LinkError::no_listener(self.listen, error);
            if is_claimed { LinkError { kind: LinkErrorKind::Claimed, ..error } } else { error }
        })
    }

    fn write(&mut self, _: &mut UdpSocket, text: &[u8]) -> Result<bool, LinkError> {
        Ok(self.show(text, Instant::now()))
    }

    fn attend(&mut self, socket: &mut UdpSocket) -> Result<(), LinkError> {
        let now = Instant::now();
        let mut bytes = [0; LONGEST];
        for _ in 0..MOST_AT_ONCE {
            match socket.recv_from(&mut bytes) {
                Ok((length, from)) => {
                    if let Some(version) = bytes.get(..length).and_then(request) {
                        self.admit(from, version, now);
                    }
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => break,
                Err(error) => return Err(LinkError::no_listener(self.listen, error)),
            }
        }
        Ok(())
    }

    fn has_receiver(&self) -> bool {
        !self.subscribers.is_empty()
    }
}

impl Server {
    pub fn new(listen: SocketAddr, reply_port: u32) -> Self {
        Self {
            listen,
            reply_port: u16::try_from(reply_port).unwrap_or_default(),
            subscribers: Vec::with_capacity(MOST_SUBSCRIBERS),
            changed: Vec::with_capacity(LONGEST),
            log_period: (Instant::now(), 0),
        }
    }

    /// Gives a receiver that asks at `now` a place, if one is free or somebody has not asked recently. The one who has asked first
    /// makes room, but before that one, whoever has not been reached for as long.
    fn admit(&mut self, mut address: SocketAddr, version: u32, now: Instant) {
        if self.reply_port != 0 {
            address.set_port(self.reply_port);
        }
        if let Some(known) = self.subscribers.iter_mut().find(|subscriber| subscriber.address == address) {
            known.asked = now;
            known.version = version;
            known.reopen(now);
            return;
        }
        let is_full = self.subscribers.len() == MOST_SUBSCRIBERS;
        let old = self.subscribers.iter().enumerate();
        let old = old.filter(|(_, it)| is_full && now.saturating_duration_since(it.asked) > RECENT);
        let replaced = old.min_by_key(|(_, it)| (it.is_reached(now), it.asked)).map(|(index, _)| index);
        if is_full && replaced.is_none() {
            return;
        }
        // A receiver that this machine cannot reach gets no place.
        let Ok(socket) = connected(address) else { return };
        self.log(now, format_args!("{address} asks for the face and gets it"));
        replaced.map(|index| self.subscribers.remove(index));
        let [asked, sent, opened, refused, away_since] = [now; 5];
        self.subscribers.push(Subscriber { address, socket, version, asked, sent, opened, refused, away_since });
    }

    /// Sends the text to all receivers, and drops those whose machine says that nobody listens. Returns whether it reached the network.
    fn show(&mut self, text: &[u8], now: Instant) -> bool {
        let mut is_sent = false;
        for it in &mut self.subscribers {
            self.changed.clear();
            self.changed.extend_from_slice(text);
            set_version(&mut self.changed, it.version);
            match it.socket.send(&self.changed) {
                Ok(_) => {
                    is_sent = true;
                    it.sent = now;
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(error) if error.kind() != ErrorKind::ConnectionRefused => it.reopen(now),
                Err(_) => {
                    if now.saturating_duration_since(it.refused) > REPORT_PERIOD {
                        it.away_since = now;
                    }
                    it.refused = now;
                }
            }
        }
        let is_away = |it: &mut Subscriber| it.refused.saturating_duration_since(it.away_since) >= LONGEST_AWAY;
        for Subscriber { address, .. } in self.subscribers.extract_if(.., is_away).collect::<Vec<_>>() {
            self.log(now, format_args!("{address} is away, and no longer gets the face"));
        }
        is_sent
    }

    /// Writes a line about a receiver, unless the log got its share of this period.
    fn log(&mut self, now: Instant, line: fmt::Arguments<'_>) {
        let (begun, lines) = &mut self.log_period;
        if now.saturating_duration_since(*begun) >= LOG_PERIOD {
            *begun = now;
            *lines = 0;
        }
        *lines = lines.saturating_add(1);
        if *lines < MOST_LINES {
            tracing::info!("iFacialMocap: {line}");
        } else if *lines == MOST_LINES {
            let minutes = LOG_PERIOD.as_secs() / 60;
            tracing::warn!(
                "iFacialMocap: {line}; so many come and go that the log is silent about them for {minutes} minutes"
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;
    use std::sync::Arc;
    use std::sync::atomic::Ordering::Relaxed;

    use facewire_packet::formats::ifacialmocap::REQUEST;

    use super::*;
    use crate::config::LinkSettings;
    use crate::link::testing::{eventually, face, kind, logged};
    use crate::link::{Link, Traffic};

    const FACE: &[u8] = b"jawOpen&50|=head#-1,0,0,0,0,0|";
    const FACE_1: &[u8] = b"jawOpen-50|=head#-1,0,0,0,0,0|";
    const V2: &str = "|sendDataVersion=v2";

    fn ask(ending: &str) -> Vec<u8> {
        [REQUEST, ending.as_bytes()].concat()
    }

    fn port(port: u16) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, port).into()
    }

    fn receiver() -> UdpSocket {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_nonblocking(true).unwrap();
        socket
    }

    /// A server that runs only when the test calls it.
    struct Served {
        server: Server,
        socket: UdpSocket,
        now: Instant,
    }

    impl Served {
        fn new() -> Self {
            let mut server = Server::new(port(0), 0);
            Self { socket: server.open().unwrap(), server, now: Instant::now() }
        }

        fn gets(&self, ending: &str, from: &UdpSocket) {
            from.send_to(&ask(ending), self.socket.local_addr().unwrap()).unwrap();
        }

        /// Sends the face, and returns what this receiver gets.
        fn face_at(&mut self, socket: &UdpSocket) -> Vec<u8> {
            let mut bytes = [0; 100];
            while socket.recv(&mut bytes).is_ok() {}
            self.server.attend(&mut self.socket).unwrap();
            self.server.show(FACE, self.now);
            let length = socket.recv(&mut bytes).unwrap_or_default();
            bytes[..length].to_vec()
        }
    }

    #[test]
    fn a_receiver_that_vanishes_is_dropped_and_the_others_keep_the_face() {
        let mut served = Served::new();
        let stays = receiver();
        let leaves = receiver();
        served.gets(V2, &stays);
        assert_eq!([served.face_at(&stays), served.face_at(&leaves)], [FACE, b""]);
        served.gets("", &leaves);
        assert_eq!([served.face_at(&leaves), served.face_at(&stays)], [FACE_1, FACE]);
        served.gets("", &stays);
        drop(leaves);
        // The system reports with every second datagram that nobody took the one before it.
        let begun = Instant::now();
        for ms in (0..4000).step_by(200) {
            served.now = begun + Duration::from_millis(ms);
            assert_eq!(served.face_at(&stays), FACE_1, "the last request counts");
            let is_dropped = served.server.subscribers.len() == 1;
            assert!(if ms < 3000 { !is_dropped } else { is_dropped || ms < 3400 }, "{ms}");
        }
        drop(stays);
        for second in 4..10 {
            served.now = begun + Duration::from_secs(second);
            served.face_at(&receiver());
        }
        assert!(served.server.has_receiver(), "reports that are far apart may be lost datagrams");
        for ms in (10_000..14_000).step_by(100) {
            served.now = begun + Duration::from_millis(ms);
            served.face_at(&receiver());
        }
        assert!(!served.server.has_receiver(), "nobody is left");
    }

    #[test]
    fn ten_thousand_hostile_datagrams_change_nothing() {
        let mut served = Served::new();
        let friend = receiver();
        let enemy = receiver();
        let fickle = receiver();
        let mut random = fastrand::Rng::with_seed(7);
        let address = served.socket.local_addr().unwrap();
        served.gets("", &friend);
        for round in 0..10_000 {
            let mut bytes = ask(V2);
            let at = random.usize(..REQUEST.len());
            bytes[at] ^= 1 << random.u8(..8);
            bytes.truncate(if round % 2 == 0 { bytes.len() } else { random.usize(..REQUEST.len()) });
            enemy.send_to(&bytes, address).unwrap();
            served.gets(["", V2][round % 2], &fickle);
            if round % 50 == 49 {
                served.server.attend(&mut served.socket).unwrap();
            }
        }
        assert_eq!(served.server.subscribers.len(), 2);
        let forged = (1..=100).map(|host| UdpSocket::bind((Ipv4Addr::new(127, 0, 1, host), 0)).unwrap());
        forged.for_each(|socket| served.gets("", &socket));
        assert_eq!(served.face_at(&friend), FACE_1);
        assert_eq!(served.server.subscribers.len(), 8);
    }

    #[test]
    fn neither_a_fickle_receiver_nor_forged_addresses_fill_the_log() {
        let mut server = Server::new(port(0), 0);
        let begun = Instant::now();
        let lines = |work: &mut dyn FnMut()| logged(work).lines().count();
        assert_eq!(lines(&mut || (0..10_000).for_each(|round| server.admit(port(1), 1 + round % 2, begun))), 1);
        // Each round comes when the places of the round before may be taken. All fall into one period.
        let round = |number: u16| begun + u32::from(number / 100) * Duration::from_secs(61);
        let mut forge = || (100..1000).for_each(|number| server.admit(port(number), 1, round(number)));
        assert_eq!(lines(&mut forge), 19);
        let later = begun + Duration::from_mins(11);
        assert_eq!(lines(&mut || server.admit(port(9999), 1, later)), 1, "a new period");
    }

    #[test]
    fn places_are_limited_and_a_newcomer_takes_only_that_of_one_who_asked_long_ago() {
        let mut server = Server::new(port(0), 0);
        let begun = Instant::now();
        (1..=20).for_each(|number| server.admit(port(number), 1, begun));
        let later = begun + Duration::from_secs(61);
        server.admit(port(1), 1, begun + Duration::from_mins(1));
        // Nobody can connect to this address: nobody loses a place to it.
        server.admit("[fe80::1]:9".parse().unwrap(), 1, later);
        let ports = |server: &Server| server.subscribers.iter().map(|it| it.address.port()).collect::<Vec<_>>();
        assert_eq!(ports(&server), [1, 2, 3, 4, 5, 6, 7, 8]);
        server.admit(port(30), 1, later);
        assert_eq!(ports(&server), [1, 3, 4, 5, 6, 7, 8, 30]);
    }

    #[test]
    fn among_those_who_asked_long_ago_one_whom_nothing_reaches_loses_its_place_before_the_oldest() {
        let mut server = Server::new(port(0), 0);
        let begun = Instant::now();
        (1..=8).for_each(|number| server.admit(port(number), 1, begun + Duration::from_secs(number.into())));
        let later = begun + Duration::from_secs(100);
        let sent_at = |server: &mut Server, number: u16, sent: Instant| {
            server.subscribers.iter_mut().filter(|it| it.address.port() == number).for_each(|it| it.sent = sent);
        };
        (1..=8).for_each(|number| sent_at(&mut server, number, later));
        let unreached = later.checked_sub(Duration::from_secs(61)).unwrap();
        [5, 3].into_iter().for_each(|number| sent_at(&mut server, number, unreached));
        let ports = |server: &Server| server.subscribers.iter().map(|it| it.address.port()).collect::<Vec<_>>();
        server.admit(port(30), 1, later);
        assert_eq!(ports(&server), [1, 2, 4, 5, 6, 7, 8, 30], "of two who are not reached, the one who asked first");
        server.admit(port(31), 1, later);
        assert_eq!(ports(&server), [1, 2, 4, 6, 7, 8, 30, 31]);
        server.admit(port(32), 1, later);
        assert_eq!(ports(&server), [2, 4, 6, 7, 8, 30, 31, 32], "all are reached: the oldest");
        sent_at(&mut server, 30, unreached);
        server.admit(port(33), 1, later);
        assert_eq!(
            ports(&server),
            [4, 6, 7, 8, 30, 31, 32, 33],
            "one whom nothing reaches, but who has just asked, stays"
        );
    }

    /// A socket that has no receiver stands for one whose address this machine has lost: the system refuses to send by it.
    #[test]
    fn a_receiver_whose_socket_can_send_no_more_gets_a_new_one_after_a_second_or_as_soon_as_it_asks_then() {
        let mut served = Served::new();
        let stays = receiver();
        let begun = served.now;
        served.gets(V2, &stays);
        assert_eq!(served.face_at(&stays), FACE);
        let lose_address = |served: &mut Served| served.server.subscribers[0].socket = receiver();
        lose_address(&mut served);
        let opened = served.server.subscribers[0].opened;
        let after = |ms| opened + Duration::from_millis(ms);
        for ms in [0, 500, 999] {
            served.now = after(ms);
            assert_eq!(served.face_at(&stays), b"", "{ms}");
            assert_eq!(served.server.subscribers.len(), 1, "only a refusal of its machine drops a receiver");
        }
        served.now = after(1000);
        assert_eq!(served.face_at(&stays), b"", "it is opened again by the face that did not arrive");
        assert_eq!(served.face_at(&stays), FACE);
        assert!(served.now > begun);
        lose_address(&mut served);
        served.server.admit(stays.local_addr().unwrap(), 2, after(1500));
        assert_eq!(served.face_at(&stays), b"", "it has a socket of half a second ago");
        served.server.admit(stays.local_addr().unwrap(), 2, after(2000));
        assert_eq!(served.face_at(&stays), FACE);
    }

    #[test]
    fn a_link_sends_to_those_who_ask_and_to_its_address_and_hands_its_port_over_to_the_next_one() {
        let fixed = receiver();
        let asks = receiver();
        let traffic = Arc::<Traffic>::default();
        let [listen, address] = [receiver(), fixed.try_clone().unwrap()].map(|socket| socket.local_addr().unwrap());
        let open = |address: &str| {
            let keys = format!("listen = \"{listen}\"\nreply_port = 0\nversion = 1\naddress = \"{address}\"\n");
            let settings = LinkSettings { kind: kind("ifacialmocap", &keys), ..LinkSettings::default() };
            let link = Link::open(&settings, &traffic).unwrap();
            eventually("the port is open", || link.device.as_ref().unwrap().is_open());
            (link, settings)
        };
        let (mut old, settings) = open(&address.to_string());
        let claimed = Server::new(listen, 0).open().unwrap_err();
        assert_eq!(claimed.kind, LinkErrorKind::Claimed);
        let face = face(&[("jawOpen", 0.5)]);
        let mut bytes = [0; LONGEST];
        old.send_last(&settings, &face);
        let length = fixed.recv(&mut bytes).unwrap();
        assert!(String::from_utf8_lossy(&bytes[..length]).contains("|jawOpen-50|"));
        let counts = || [&traffic.sent, &traffic.dropped].map(|count| count.load(Relaxed));
        assert_eq!(counts(), [1, 0]);
        drop(old);
        let (mut new, settings) = open("");
        new.send_last(&settings, &face);
        assert_eq!(traffic.packets.load(Relaxed), 1, "without a receiver nothing is sent");
        asks.send_to(&ask(V2), listen).unwrap();
        eventually("the face", || {
            new.send_last(&settings, &face);
            asks.recv(&mut bytes).is_ok_and(|length| String::from_utf8_lossy(&bytes[..length]).contains("|jawOpen&50|"))
        });
        eventually("the counts", || counts().iter().sum::<u64>() == traffic.packets.load(Relaxed));
        assert!(counts()[0] > 1);
    }
}
