//! What receivers of the iPhone app get, with sockets of this machine.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::{fs, fs::File, net::Ipv4Addr};

use super::places::{MOST, MOST_LINES, PERIOD, RECENT};
use super::*;
use crate::config::LinkKind;

/// Longer than any step takes on a busy machine.
const ENOUGH: Duration = Duration::from_secs(10);
const FACE: &[u8] = b"jawOpen&50|=head#-1,0,0,0,0,0|";
const FACE_1: &[u8] = b"jawOpen-50|=head#-1,0,0,0,0,0|";

fn ask(ending: &str) -> Vec<u8> {
    [REQUEST, ending.as_bytes()].concat()
}

#[test]
fn only_the_apps_own_request_is_answered() {
    assert_eq!(request(&ask("")), Some(Version::First));
    assert_eq!(request(&ask("\n\0\0\0")), Some(Version::First));
    assert_eq!(request(&ask("|sendDataVersion=v2")), Some(Version::Second));
    assert_eq!(request(&ask("|sendDataVersion=v2\0\0\0")), Some(Version::Second));
    assert_eq!(request(&ask("|sendDataVersion=v3")), Some(Version::First));
    let others: [&[u8]; 5] = [
        b"",
        b"iFacialMocap_",
        b"\xff\0\x80",
        b"iFacialMocap_UDPTCP_sahuasouryya9218sauhuiayeta91555dy3719",
        &ask("x"),
    ];
    for other in others {
        assert_eq!(request(other), None, "{other:?}");
    }
}

/// A carrier that listens at a free port and answers to the port that the request came from.
struct Device {
    carrier: Subscribers,
    address: SocketAddr,
}

impl Device {
    fn start(keys: &str) -> Self {
        let free = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let text = format!("[[link]]\nkind = \"ifacialmocap\"\nlisten = \"{free}\"\nreply_port = 0\n{keys}");
        let settings = crate::config::parse("test", &text).unwrap();
        let LinkKind::IFacialMocap(settings) = &settings.links[0].kind else { unreachable!() };
        let carrier = Subscribers::open(settings, Arc::default()).unwrap();
        let device = Self { carrier, address: free };
        device.eventually("the port is open", Carrier::is_open);
        device
    }

    fn eventually(&self, what: &str, mut happens: impl FnMut(&Subscribers) -> bool) {
        let end = Instant::now() + ENOUGH;
        while !happens(&self.carrier) {
            assert!(Instant::now() < end, "{what}");
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// Sends the face until this socket gets it, and returns what it gets.
    fn face_at(&mut self, socket: &UdpSocket) -> Vec<u8> {
        let (mut bytes, end) = ([0; 100], Instant::now() + ENOUGH);
        socket.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
        loop {
            assert!(Instant::now() < end, "the face does not come");
            if self.carrier.has_receiver() {
                self.carrier.send(FACE);
            }
            if let Ok(length) = socket.recv(&mut bytes) {
                return bytes[..length].to_vec();
            }
        }
    }
}

fn receiver() -> UdpSocket {
    UdpSocket::bind("127.0.0.1:0").unwrap()
}

#[test]
fn whoever_asks_gets_the_face_in_the_version_asked_for() {
    let mut device = Device::start("");
    assert!(!device.carrier.has_receiver());
    let [first, second] = [receiver(), receiver()];
    first.send_to(&ask(""), device.address).unwrap();
    assert_eq!(device.face_at(&first), FACE_1);
    second.send_to(&ask("|sendDataVersion=v2"), device.address).unwrap();
    assert_eq!(device.face_at(&second), FACE);
    assert_eq!(device.face_at(&first), FACE_1);
    assert_eq!(device.carrier.traffic.dropped.load(Relaxed), 0);
}

#[test]
fn a_receiver_that_vanishes_is_dropped_and_the_others_keep_the_face() {
    let mut device = Device::start("");
    let [stays, leaves] = [receiver(), receiver()];
    for socket in [&stays, &leaves] {
        socket.send_to(&ask(""), device.address).unwrap();
        device.face_at(socket);
    }
    assert_eq!(device.carrier.list.peek_output_buffer().len(), 2);
    drop(leaves);
    let end = Instant::now() + ENOUGH;
    while device.carrier.list.read().len() > 1 {
        assert!(Instant::now() < end, "the receiver keeps its place");
        device.carrier.send(FACE);
        thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(device.face_at(&stays), FACE_1);
}

#[test]
fn ten_thousand_hostile_datagrams_change_nothing() {
    let mut device = Device::start("");
    let friend = receiver();
    friend.send_to(&ask(""), device.address).unwrap();
    device.face_at(&friend);
    let (enemy, fickle, mut random) = (receiver(), receiver(), fastrand::Rng::with_seed(7));
    for round in 0..10_000 {
        let mut bytes = ask("|sendDataVersion=v2");
        let at = random.usize(..bytes.len() - SECOND.len());
        bytes[at] ^= 1 << random.u8(..8);
        bytes.truncate(if round % 2 == 0 { bytes.len() } else { random.usize(..REQUEST.len()) });
        enemy.send_to(&bytes, device.address).unwrap();
        fickle.send_to(&ask(["", "|sendDataVersion=v2"][round % 2]), device.address).unwrap();
    }
    // These requests come after all of them.
    let late = receiver();
    let end = Instant::now() + ENOUGH;
    while device.carrier.list.read().len() < 3 {
        assert!(Instant::now() < end, "a request after the flood is not served");
        late.send_to(&ask(""), device.address).unwrap();
        thread::sleep(Duration::from_millis(5));
    }
    let forged: Vec<_> = (1..=100).map(|host| UdpSocket::bind((Ipv4Addr::new(127, 0, 1, host), 0)).unwrap()).collect();
    for socket in &forged {
        socket.send_to(&ask(""), device.address).unwrap();
    }
    device.face_at(&forged[0]);
    assert_eq!([device.face_at(&late), device.face_at(&friend)], [FACE_1, FACE_1]);
    assert!(device.carrier.list.read().len() <= MOST);
}

fn places() -> (Places, Newest<List>) {
    let (newest, list) = triple_buffer(&List::new());
    (Places::new(newest), list)
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
    let (mut places, mut list) = places();
    let begun = Instant::now();
    let ask_in_turn = |places: &mut Places| {
        for round in 0..10_000 {
            places.take(port(1), [Version::First, Version::Second][round % 2], begun);
        }
    };
    assert_eq!(log_lines(|| ask_in_turn(&mut places)), 1);
    let socket = Arc::clone(&list.read()[0]);
    assert!(socket.is_second.load(Relaxed), "the last request counts");
    // Each round comes when the places of the round before may be taken. All fall into one period.
    let forge = |places: &mut Places| {
        for number in 100..1000 {
            let now = begun + u32::from(number / 100) * (RECENT + Duration::from_secs(1));
            places.take(port(number), Version::First, now);
        }
    };
    assert_eq!(log_lines(|| forge(&mut places)), MOST_LINES as usize - 1);
    assert_eq!(list.read().len(), MOST);
    let later = begun + 2 * PERIOD;
    assert_eq!(log_lines(|| places.take(port(9999), Version::First, later)), 1, "a new period");
}

#[test]
fn places_are_limited_and_a_newcomer_takes_only_that_of_one_who_asked_long_ago() {
    let ((mut places, mut list), begun) = (places(), Instant::now());
    for number in 1..=20 {
        places.take(port(number), Version::First, begun);
    }
    let ports = |places: &Places| places.list.iter().map(|place| place.receiver.port()).collect::<Vec<_>>();
    assert_eq!(ports(&places), (1..=8).collect::<Vec<_>>());
    places.take(port(1), Version::First, begun + RECENT);
    let later = begun + RECENT + Duration::from_secs(1);
    // Nobody can connect to this address: nobody loses a place to it.
    places.take("[fe80::1]:9".parse().unwrap(), Version::First, later);
    assert_eq!(ports(&places), (1..=8).collect::<Vec<_>>());
    places.take(port(30), Version::First, later);
    assert_eq!(ports(&places), [1, 3, 4, 5, 6, 7, 8, 30]);
    assert_eq!(list.read().len(), MOST);
}

#[test]
fn a_new_link_waits_in_silence_for_the_port_of_the_one_that_it_replaces() {
    let mut old = Device::start("");
    let socket = receiver();
    socket.send_to(&ask(""), old.address).unwrap();
    old.face_at(&socket);
    let shared = Arc::<Shared>::default();
    let (listen, begun) = (old.address, Instant::now());
    let listener =
        RequestListener { listen, reply_port: 0, places: places().0, handover_end: begun + HANDOVER, shared };
    let in_use = listener.bind().unwrap_err();
    assert!(listener.is_handover(&in_use, begun) && !listener.is_handover(&in_use, begun + HANDOVER));
    assert!(!listener.is_handover(&ErrorKind::AddrNotAvailable.into(), begun));
    let settings = IFacialMocapSettings { listen: crate::config::ListenAddress(Some(listen)), ..Default::default() };
    let new = Subscribers::open(&settings, Arc::default()).unwrap();
    drop(old);
    let new = Device { carrier: new, address: listen };
    new.eventually("the new link has the port", Carrier::is_open);
}

#[test]
fn an_address_gets_the_face_without_asking() {
    let socket = receiver();
    let address = socket.local_addr().unwrap();
    let mut device = Device::start(&format!("address = \"{address}\"\nversion = 1\n"));
    assert_eq!(device.face_at(&socket), FACE_1);
}
