//! What UDP links promise, with sockets of this machine.
#![allow(clippy::unwrap_used)]

use std::sync::Mutex;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::{Duration, Instant};

use super::*;

const MESSAGE: &[u8] = b"message";
/// Longer than any step takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(10);

fn open(address: &str) -> UdpCarrier {
    UdpCarrier::open(&Address::new(address).unwrap(), Arc::default()).unwrap()
}

fn receiver(address: &str) -> UdpSocket {
    let socket = UdpSocket::bind(address).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    socket
}

/// Messages sent, and messages dropped.
fn counts(link: &UdpCarrier) -> (u64, u64) {
    (link.traffic.sent.load(Relaxed), link.traffic.dropped.load(Relaxed))
}

fn eventually(what: &str, mut happens: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !happens() {
        assert!(Instant::now() < end, "{what}");
        thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn a_message_arrives_as_one_datagram() {
    for any in ["127.0.0.1:0", "[::1]:0"] {
        let Ok(socket) = UdpSocket::bind(any) else {
            crate::skip::skip(&format!("this machine has no address {any}"));
            continue;
        };
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut link = open(&socket.local_addr().unwrap().to_string());
        link.send(MESSAGE);
        let mut bytes = [0; 1024];
        let length = socket.recv(&mut bytes).unwrap();
        assert_eq!(bytes.get(..length), Some(MESSAGE));
        assert_eq!(counts(&link), (1, 0));
    }
}

#[test]
fn a_receiver_that_starts_late_gets_every_message_from_then_on() {
    let early = receiver("127.0.0.1:0");
    let address = early.local_addr().unwrap().to_string();
    drop(early);
    let mut link = open(&address);
    for _ in 0..10 {
        link.send(MESSAGE);
    }
    let late = receiver(&address);
    link.send(MESSAGE);
    assert_eq!(late.recv(&mut [0; 1024]).unwrap(), MESSAGE.len());
    assert_eq!(counts(&link), (11, 0));
}

#[test]
fn a_message_that_the_network_refuses_is_counted_and_the_link_lives_on() {
    // An IPv4 socket cannot reach an IPv6 address, whatever routes this machine has.
    let receiver = SocketAddr::from((Ipv6Addr::LOCALHOST, 9));
    let (mut input, destination) = TripleBuffer::default().split();
    input.write(Some(Destination { socket: UdpSocket::bind("127.0.0.1:0").unwrap(), receiver }));
    let mut link = UdpCarrier { destination, lookup: None, traffic: Arc::default(), refusal: None };
    link.send(MESSAGE);
    assert_eq!(counts(&link), (0, 1));
    assert!(!link.is_open() && link.refusal().is_some());
}

#[test]
fn an_address_without_a_route_is_reported_with_what_to_check() {
    // A link-local address leads nowhere without the name of an interface. Without IPv6 there is no socket.
    let error = check(&Address::new("[fe80::1]:5252").unwrap()).unwrap_err().to_string();
    let beginning = ["link [fe80::1]:5252: no network leads there (", "link [fe80::1]:5252: no socket ("];
    assert!(beginning.iter().any(|beginning| error.starts_with(beginning)), "{error}");
}

#[test]
fn broadcasting_is_allowed() {
    let address = Address::new("255.255.255.255:9").unwrap();
    let destination = Destination::new(&address, resolve(&address).unwrap()).unwrap();
    assert!(destination.socket.broadcast().unwrap());
}

#[test]
fn an_unknown_host_is_reported_with_its_address_and_what_to_check() {
    let text = resolve(&Address::new("nowhere.invalid:5252").unwrap()).unwrap_err().to_string();
    assert!(text.starts_with("link nowhere.invalid:5252: the host does not resolve ("), "{text}");
    assert!(text.contains("check the spelling"), "{text}");
}

#[test]
fn messages_to_an_unknown_host_are_counted_as_dropped() {
    let mut link = open("nowhere.invalid:5252");
    link.send(MESSAGE);
    assert_eq!((link.is_open(), counts(&link)), (false, (0, 1)));
}

#[test]
fn localhost_is_found_and_reached_by_ipv4() {
    let socket = receiver("127.0.0.1:0");
    let mut link = open(&format!("localhost:{}", socket.local_addr().unwrap().port()));
    eventually("localhost resolves", || {
        link.send(MESSAGE);
        link.is_open()
    });
    assert_eq!(socket.recv(&mut [0; 1024]).unwrap(), MESSAGE.len());
}

/// A name server whose answer a test can change.
#[derive(Clone, Default)]
struct NameServer {
    answer: Arc<Mutex<Vec<SocketAddr>>>,
    lookups: Arc<Mutex<u32>>,
}

impl NameServer {
    fn answers(&self, sockets: &[&UdpSocket]) {
        *self.answer.lock().unwrap() = sockets.iter().map(|socket| socket.local_addr().unwrap()).collect();
    }

    /// Opens a link to a host name that this server knows.
    /// A link that looks its host name up only when it is asked to.
    fn link(&self) -> UdpCarrier {
        self.link_with_period(Duration::from_hours(1))
    }

    fn link_with_period(&self, period: Duration) -> UdpCarrier {
        let server = self.clone();
        let resolve = move |_: &Address| {
            *server.lookups.lock().unwrap() += 1;
            let found = server.answer.lock().unwrap().clone();
            if found.is_empty() { Err(io::Error::other("no such host")) } else { Ok(found) }
        };
        UdpCarrier::open_with(&Address::new("head.local:5252").unwrap(), Arc::default(), resolve, period).unwrap()
    }

    /// Lets the link look up its host name, and waits until it has.
    fn refresh(&self, link: &UdpCarrier) {
        // A look-up may have begun before the answer changed; the second one has not.
        for _ in 0..2 {
            let before = *self.lookups.lock().unwrap();
            eventually("the name is looked up", || {
                link.refresh();
                *self.lookups.lock().unwrap() > before
            });
        }
    }
}

/// Whether the link's packets arrive at this socket.
fn arrives(link: &mut UdpCarrier, socket: &UdpSocket) -> bool {
    socket.set_nonblocking(true).unwrap();
    while socket.recv(&mut [0; 1024]).is_ok() {}
    link.send(MESSAGE);
    socket.recv(&mut [0; 1024]).is_ok()
}

#[test]
fn packets_follow_a_host_name_to_its_new_address() {
    let [old, new] = ["127.0.0.1:0", "127.0.0.1:0"].map(receiver);
    let server = NameServer::default();
    server.answers(&[&old]);
    let mut link = server.link();
    eventually("packets arrive at the first address", || arrives(&mut link, &old));
    server.answers(&[&new]);
    server.refresh(&link);
    eventually("packets arrive at the new address", || arrives(&mut link, &new));
    assert!(!arrives(&mut link, &old));
}

#[test]
fn a_host_name_is_looked_up_again_without_being_asked() {
    let socket = receiver("127.0.0.1:0");
    let server = NameServer::default();
    server.answers(&[&socket]);
    let _link = server.link_with_period(Duration::from_millis(5));
    eventually("a second look-up", || *server.lookups.lock().unwrap() > 1);
}

#[test]
fn while_look_ups_fail_packets_go_to_the_last_known_address() {
    let socket = receiver("127.0.0.1:0");
    let server = NameServer::default();
    server.answers(&[&socket]);
    let mut link = server.link();
    eventually("packets arrive", || arrives(&mut link, &socket));
    server.answers(&[]);
    server.refresh(&link);
    assert!(arrives(&mut link, &socket) && link.is_open());
}

#[test]
fn another_order_of_the_same_addresses_changes_nothing() {
    let [first, second] = ["127.0.0.1:0", "127.0.0.1:0"].map(receiver);
    let server = NameServer::default();
    server.answers(&[&first, &second]);
    let mut link = server.link();
    eventually("packets arrive at the first address", || arrives(&mut link, &first));
    server.answers(&[&second, &first]);
    server.refresh(&link);
    assert!(arrives(&mut link, &first));
}

#[test]
fn look_ups_end_with_the_link() {
    let server = NameServer::default();
    let link = server.link();
    assert_eq!(Arc::strong_count(&server.lookups), 2);
    drop(link);
    eventually("the thread ends", || Arc::strong_count(&server.lookups) == 1);
}

/// Returns the number of an interface other than the loopback interface that has an IPv6 address.
fn interface() -> Option<u32> {
    let addresses = std::fs::read_to_string("/proc/net/if_inet6").ok()?;
    let interface = |line: &str| u32::from_str_radix(line.split_whitespace().nth(1)?, 16).ok();
    addresses.lines().filter(|line| !line.ends_with(" lo")).find_map(interface)
}

/// A group of the local network reaches its members on the interface whose number the address names, without a route.
#[test]
fn an_ipv6_multicast_group_gets_each_message_on_the_interface_that_the_address_names() {
    let Some(interface) = interface() else {
        crate::skip::skip("this machine has no network with IPv6");
        return;
    };
    let group = Ipv6Addr::new(0xff02, 0, 0, 0, 0, 0, 0xface, 0x1e);
    let member = receiver("[::]:0");
    member.join_multicast_v6(&group, interface).unwrap();
    let mut link = open(&format!("[{group}%{interface}]:{}", member.local_addr().unwrap().port()));
    link.send(MESSAGE);
    assert_eq!((link.refusal(), counts(&link)), (None, (1, 0)));
    assert_eq!(member.recv(&mut [0; 1024]).unwrap(), MESSAGE.len());
}

/// The system sends to a group by its route, or by the default route.
#[test]
fn an_ipv4_multicast_group_gets_each_message_and_no_router_passes_it_on() {
    let group = Ipv4Addr::new(239, 255, 70, 87);
    let member = UdpSocket::bind("0.0.0.0:0").unwrap();
    if member.join_multicast_v4(&group, &Ipv4Addr::UNSPECIFIED).is_err() {
        crate::skip::skip("this machine has no route for multicast");
        return;
    }
    member.set_read_timeout(Some(PATIENCE)).unwrap();
    let address = Address::new(&format!("{group}:{}", member.local_addr().unwrap().port())).unwrap();
    let destination = Destination::new(&address, resolve(&address).unwrap()).unwrap();
    assert_eq!(destination.socket.multicast_ttl_v4().unwrap(), 1);
    let mut link = open(address.as_str());
    link.send(MESSAGE);
    assert_eq!((link.refusal(), counts(&link)), (None, (1, 0)));
    assert_eq!(member.recv(&mut [0; 1024]).unwrap(), MESSAGE.len());
}
