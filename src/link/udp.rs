//! UDP: one message, one datagram.
//!
//! The socket is not connected. An ICMP error from a receiver that is not running yet, a route that appears late, and
//! a change of this machine's own address therefore do not break the link.
//!
//! A host name is looked up again and again, because it may resolve only after the network has come up, and its address
//! may change at any time. A look-up may take seconds, so it has a thread of its own, which hands over each new destination
//! by a triple buffer.

use std::net::{IpAddr, SocketAddr, ToSocketAddrs as _, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread::{self, Thread};
use std::time::Duration;
use std::{fs, io};

use triple_buffer::{Input, Output as Newest, TripleBuffer};

use super::{LinkError, LinkErrorKind, Traffic};
use crate::config::Address;
use crate::retry::Retry;

const LOOKUP_PERIOD: Duration = Duration::from_secs(5);

/// Datagrams to one address.
#[derive(Debug)]
pub struct UdpCarrier {
    destination: Newest<Option<Destination>>,
    /// The thread that looks a host name up, and a token: the thread ends when the token is dropped.
    lookup: Option<(Thread, Arc<()>)>,
    traffic: Arc<Traffic>,
    refusal: Option<i32>,
}

impl UdpCarrier {
    /// Opens a carrier to `address`. Messages are dropped until the host name is found.
    pub fn open(address: &Address, traffic: Arc<Traffic>) -> Result<Self, LinkError> {
        let (mut input, destination) = TripleBuffer::default().split();
        let lookup = if let Ok(receiver) = address.as_str().parse() {
            input.write(Some(Destination::new(address, receiver)?));
            None
        } else {
            let host = Host { address: address.clone(), current: None, destination: input };
            Some(host.start(LOOKUP_PERIOD, system_resolver)?)
        };
        Ok(Self { destination, lookup, traffic, refusal: None })
    }

    /// Sends the message or drops it, without waiting, and counts it.
    pub fn send(&mut self, message: &[u8]) {
        let destination = self.destination.read().as_ref();
        let sent = destination.map(|to| to.socket.send_to(message, to.receiver));
        let is_sent = matches!(sent, Some(Ok(_)));
        (if is_sent { &self.traffic.sent } else { &self.traffic.dropped }).fetch_add(1, Relaxed);
        // A full buffer drops this message and says nothing about the network.
        let error = sent.and_then(Result::err).filter(|error| error.kind() != io::ErrorKind::WouldBlock);
        self.refusal = error.and_then(|error| error.raw_os_error());
    }

    /// Whether messages reach the network at present.
    pub fn is_open(&self) -> bool {
        self.destination.peek_output_buffer().is_some() && self.refusal.is_none()
    }

    /// The system's error number if the network refused the last message.
    pub fn refusal(&self) -> Option<i32> {
        self.refusal
    }

    /// Asks to look up the receiver's address now.
    pub fn refresh(&self) {
        self.lookup.iter().for_each(|(thread, _)| thread.unpark());
    }
}

#[derive(Debug)]
struct Destination {
    socket: UdpSocket,
    receiver: SocketAddr,
}

impl Destination {
    fn new(address: &Address, receiver: SocketAddr) -> Result<Self, LinkError> {
        let opened = socket_for(receiver).and_then(|socket| {
            if receiver.is_ipv4() {
                socket.set_broadcast(true)?;
            }
            Ok(Self { socket, receiver })
        });
        opened.map_err(|error| {
            let sentence = format!("no socket ({error}); check that the service may use the network");
            LinkError::new(LinkErrorKind::Other, address, sentence)
        })
    }
}

/// Opens a socket for datagrams to this receiver that never blocks.
pub fn socket_for(receiver: SocketAddr) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind(if receiver.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" })?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

/// Tests whether this machine has a route to the address at this moment. Nothing is sent.
pub fn check(address: &Address) -> Result<(), LinkError> {
    let Destination { socket, receiver } = Destination::new(address, resolve(address)?)?;
    socket.connect(receiver).map_err(|error| {
        let sentence = format!("no network leads there ({error}); check this machine's cable or Wi-Fi and the address");
        LinkError::new(LinkErrorKind::Host, address, sentence)
    })
}

pub fn resolve(address: &Address) -> Result<SocketAddr, LinkError> {
    choose(address, system_resolver(address), None)
}

fn system_resolver(address: &Address) -> io::Result<Vec<SocketAddr>> {
    address.as_str().to_socket_addrs().map(Iterator::collect)
}

/// A host name, and the address to which its packets go at present.
struct Host {
    address: Address,
    current: Option<SocketAddr>,
    destination: Input<Option<Destination>>,
}

impl Host {
    /// Starts a thread that looks the host up now, after each `period`, and when it is woken.
    fn start(
        mut self,
        period: Duration,
        resolve: impl Fn(&Address) -> io::Result<Vec<SocketAddr>> + Send + 'static,
    ) -> Result<(Thread, Arc<()>), LinkError> {
        let (address, link) = (self.address.clone(), Arc::new(()));
        let is_wanted = Arc::downgrade(&link);
        let run = move || {
            let mut retry = Retry::default();
            while is_wanted.strong_count() > 0 {
                let found = resolve(&self.address);
                match (self.take(found), self.current) {
                    (Ok(()), _) => retry = Retry::default(),
                    (Err(error), Some(current)) if retry.logged.is_new(&error.to_string()) => {
                        tracing::warn!("{error}; packets still go to {current}");
                    }
                    (Err(_), Some(_)) => {}
                    (Err(error), None) => retry.tell(&error, false),
                }
                thread::park_timeout(if self.current.is_some() { period } else { retry.back_off.wait() });
            }
        };
        let thread = thread::Builder::new().name("fw-lookup".to_owned()).spawn(run);
        let thread = thread.map_err(|error| LinkError::no_thread(address, error))?;
        Ok((thread.thread().clone(), link))
    }

    /// Takes the result of a look-up. On an error the current destination stays.
    fn take(&mut self, found: io::Result<Vec<SocketAddr>>) -> Result<(), LinkError> {
        let receiver = choose(&self.address, found, self.current)?;
        if self.current != Some(receiver) {
            self.destination.write(Some(Destination::new(&self.address, receiver)?));
            tracing::info!("link {}: packets go to {receiver}", self.address);
            self.current = Some(receiver);
        }
        Ok(())
    }
}

/// Chooses one of the addresses found: the current one if it is among them, so that the order in which a name server
/// lists addresses does not matter; otherwise the first IPv4 address, because small receivers seldom listen to IPv6.
fn choose(
    address: &Address,
    found: io::Result<Vec<SocketAddr>>,
    current: Option<SocketAddr>,
) -> Result<SocketAddr, LinkError> {
    let unresolved = |reason| {
        let files = ["/proc/self/cgroup", "/etc/resolv.conf"].map(|path| fs::read_to_string(path).unwrap_or_default());
        let sentence =
            format!("the host does not resolve ({reason}); {}", remedy(files.each_ref().map(String::as_str)));
        LinkError::new(LinkErrorKind::Host, address, sentence)
    };
    let found = found.map_err(|error| unresolved(error.to_string()))?;
    let kept = current.filter(|current| found.contains(current));
    let chosen = kept.or_else(|| found.into_iter().min_by_key(SocketAddr::is_ipv6));
    chosen.ok_or_else(|| unresolved("it has no address".to_owned()))
}

/// Says what may help if a host does not resolve. `cgroup` and `resolver` are `/proc/self/cgroup` and `/etc/resolv.conf`.
///
/// The unit allows nearby addresses only. A name server elsewhere then gets no question, and the C library reports a
/// temporary failure.
fn remedy([cgroup, resolver]: [&str; 2]) -> String {
    let is_service = cgroup.lines().any(|line| line.contains(":/system.slice/") && line.ends_with(".service"));
    let server = |line: &str| {
        let address = line.trim().strip_prefix("nameserver")?.split_whitespace().next()?;
        address.split('%').next()?.parse().ok()
    };
    let far = resolver.lines().filter_map(server).find(|server| !is_nearby(*server)).filter(|_| is_service);
    let blocked = far.map(|server| {
        format!(
            ". If the unit keeps the service from the name server {server}, add it to the drop-in name-server.conf \
             (docs/service.md)"
        )
    });
    format!("check the spelling and the network, or give its address in numbers{}", blocked.unwrap_or_default())
}

fn is_nearby(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(it) => it.is_loopback() || it.is_private() || it.is_link_local() || it.is_unspecified(),
        IpAddr::V6(it) => it.is_loopback() || it.is_unique_local() || it.is_unicast_link_local() || it.is_unspecified(),
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;

    use super::*;
    use crate::link::testing::{PATIENCE, eventually};
    use crate::skip::skip;

    const MESSAGE: &[u8] = b"message";

    fn open(address: &str) -> UdpCarrier {
        UdpCarrier::open(&Address::new(address).unwrap(), Arc::default()).unwrap()
    }

    /// A host name without an address yet, and the link to it.
    fn host() -> (Host, UdpCarrier) {
        let (input, destination) = TripleBuffer::default().split();
        let host = Host { address: Address::new("head.local:5252").unwrap(), current: None, destination: input };
        (host, UdpCarrier { destination, lookup: None, traffic: Arc::default(), refusal: None })
    }

    fn receiver(address: &str) -> UdpSocket {
        let socket = UdpSocket::bind(address).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        socket
    }

    /// Messages sent, and messages dropped.
    fn counts(link: &UdpCarrier) -> [u64; 2] {
        [&link.traffic.sent, &link.traffic.dropped].map(|counter| counter.load(Relaxed))
    }

    #[test]
    fn a_receiver_that_starts_late_gets_every_message_from_then_on_as_one_datagram() {
        for any in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(socket) = UdpSocket::bind(any) else {
                skip(&format!("this machine has no address {any}"));
                continue;
            };
            let (address, mut bytes) = (socket.local_addr().unwrap().to_string(), [0; 100]);
            drop(socket);
            let mut link = open(&address);
            (0..10).for_each(|_| link.send(b"early"));
            let socket = receiver(&address);
            link.send(MESSAGE);
            let length = socket.recv(&mut bytes).unwrap();
            assert_eq!((&bytes[..length], link.refusal(), counts(&link)), (MESSAGE, None, [11, 0]));
        }
    }

    #[test]
    fn an_address_that_cannot_be_reached_is_reported_with_what_to_check() {
        // A link-local address leads nowhere without the name of an interface. Without IPv6 there is no socket.
        for (address, causes, advice) in [
            ("[fe80::1]:5252", ["no network leads there (", "no socket ("], "check th"),
            ("nowhere.invalid:5252", ["the host does not resolve ("; 2], "check the spelling"),
        ] {
            let error = check(&Address::new(address).unwrap()).unwrap_err().to_string();
            let is_named = causes.iter().any(|cause| error.starts_with(&format!("link {address}: {cause}")));
            assert!(is_named && error.contains(advice), "{error}");
        }
    }

    #[test]
    fn in_the_unit_a_name_server_at_a_public_address_is_named_with_the_drop_in() {
        // 100.100.100.100 resolves in private networks that go by the addresses of providers.
        let far = ["9.9.9.9", "2620:fe::fe", "100.100.100.100"].map(|server| (server, true));
        let near = ["127.0.0.53", "192.168.1.1", "172.20.0.1", "fe80::1%eth0", "fd00::1", "::1"];
        for (server, is_named) in far.into_iter().chain(near.map(|server| (server, false))) {
            let resolver =
                format!("# nameserver 8.8.8.8\nsearch lan\nnameserver 10.0.0.1\nnameserver\t{server}\noptions edns0\n");
            let [unit, user] = ["0::/system.slice/facewire.service\n", "0::/user.slice/session-3.scope\n"]
                .map(|cgroup| remedy([cgroup, &resolver]));
            let name = format!("the name server {server}, add it to the drop-in name-server.conf");
            assert_eq!((unit.contains(&name), unit.contains("drop-in")), (is_named, is_named), "{unit}");
            assert!(unit.contains("check the spelling") && !user.contains("drop-in"), "{unit} {user}");
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
    fn localhost_is_found_and_reached_by_ipv4_which_may_be_a_broadcast() {
        let socket = receiver("127.0.0.1:0");
        let mut link = open(&format!("localhost:{}", socket.local_addr().unwrap().port()));
        eventually("localhost resolves", || arrives(&mut link, &socket));
        assert!(link.destination.read().as_ref().unwrap().socket.broadcast().unwrap());
    }

    #[test]
    fn packets_follow_a_host_name_to_its_new_address() {
        let [old, new] = ["127.0.0.1:0", "127.0.0.1:0"].map(receiver);
        let [old_address, new_address] = [&old, &new].map(|socket| socket.local_addr().unwrap());
        let (mut host, mut link) = host();
        // Another order of the same addresses changes nothing.
        for found in [[old_address, new_address], [new_address, old_address]] {
            host.take(Ok(found.to_vec())).unwrap();
            assert!(arrives(&mut link, &old));
        }
        host.take(Ok(vec![new_address])).unwrap();
        assert!(arrives(&mut link, &new) && !arrives(&mut link, &old));
    }

    #[test]
    fn while_look_ups_fail_packets_go_to_the_last_known_address() {
        let (socket, (mut host, mut link)) = (receiver("127.0.0.1:0"), host());
        host.take(Ok(vec![socket.local_addr().unwrap()])).unwrap();
        for failure in [Ok(Vec::new()), Err(io::Error::other("no such host"))] {
            assert!(host.take(failure).is_err());
            assert!(arrives(&mut link, &socket) && link.is_open());
        }
    }

    #[test]
    fn a_host_is_looked_up_again_and_again_until_the_link_ends_and_without_an_address_messages_are_dropped() {
        for found in [None, Some(SocketAddr::from((Ipv4Addr::LOCALHOST, 9)))] {
            let ((host, mut link), (tell, told)) = (host(), std::sync::mpsc::channel());
            let resolve = move |_: &Address| {
                let _ = tell.send(());
                found.map(|address| vec![address]).ok_or_else(|| io::Error::other("no such host"))
            };
            link.lookup = Some(host.start(Duration::from_millis(1), resolve).unwrap());
            (0..3).for_each(|_| told.recv_timeout(PATIENCE).unwrap());
            link.send(MESSAGE);
            let is_sent = found.is_some();
            assert_eq!((link.is_open(), counts(&link)), (is_sent, [is_sent.into(), (!is_sent).into()]));
            drop(link);
            // This would not return if the thread went on.
            told.iter().for_each(drop);
        }
    }
}
