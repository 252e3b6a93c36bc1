//! UDP: one message, one datagram.
//!
//! The socket is not connected. An ICMP error from a receiver that is not running yet, a route that appears late, and
//! a change of this machine's own address therefore do not break the link. What the receiver's machine says of it, an [`Ear`]
//! hears.
//!
//! A host name is looked up again and again, because it may resolve only after the network has come up, and its address
//! may change at any time. A look-up may take seconds, so it has a thread of its own, which hands over each new destination
//! by a triple buffer.

use std::io;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs as _, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, Builder};
use std::time::Duration;

use facewire_board::name_server_remedy;
use facewire_packet::formats::dmx::{DISCOVERY_UNIVERSE, group};
use triple_buffer::{Input, Output as Newest, TripleBuffer};

use super::ear::Ear;
use super::{LINK_STACK_BYTES, LinkError, LinkErrorKind, PANIC_PAUSE, Panel, panics};
use crate::config::Address;
use crate::retry::Retry;

/// What the system does for a carrier, which it may refuse.
struct System<R> {
    resolve: R,
    socket: fn(SocketAddr, Option<SocketAddr>) -> io::Result<UdpSocket>,
}

const LOOKUP_PERIOD: Duration = Duration::from_secs(5);

/// A socket, and the address to which it sends.
type Destination = (UdpSocket, SocketAddr);

pub struct UdpCarrier {
    destination: Newest<Option<Destination>>,
    /// Wakes the thread that looks a host name up. The thread ends when this is dropped.
    lookup: Option<SyncSender<()>>,
    panel: Arc<Panel>,
    /// The system's error number if the network refused the last message.
    pub refusal: Option<i32>,
}

impl UdpCarrier {
    /// Opens a carrier to `address`. Messages are dropped until the host name is found.
    pub fn open(address: &Address, panel: Arc<Panel>) -> Result<Self, LinkError> {
        Self::by(System { resolve: system_resolver, socket: socket_for }, address, panel)
    }

    fn by(
        system: System<impl Fn(&Address) -> io::Result<Vec<SocketAddr>> + Send + 'static>,
        address: &Address,
        panel: Arc<Panel>,
    ) -> Result<Self, LinkError> {
        let (mut input, destination) = TripleBuffer::default().split();
        let from = panel.kind.universe().and_then(|(_, from)| from);
        // The address to send from may appear later, like that of a host name, and so may the right to use the network.
        let literal = address.as_str().parse().ok().filter(|_| from.is_none());
        let lookup =
            if let Some(destination) = literal.and_then(|receiver| open(address, receiver, None, system.socket).ok()) {
                panel.listen_by(Ear::new(address, &destination.0, destination.1));
                input.write(Some(destination));
                None
            } else {
                let (wake, woken) = sync_channel(1);
                let host = address.clone();
                let shared = Arc::clone(&panel);
                let thread = Builder::new().name("fw-lookup".to_owned()).stack_size(LINK_STACK_BYTES);
                let started = thread.spawn(move || {
                    while panics(&host, &shared, || look_up(&host, from, &system, &mut input, &woken, &shared)) {
                        thread::sleep(PANIC_PAUSE);
                    }
                });
                started.map_err(|error| LinkError::no_thread(address, error))?;
                Some(wake)
            };
        Ok(Self { destination, lookup, panel, refusal: None })
    }

    /// Sends the message or drops it, without waiting, and counts it. Returns whether the network took it.
    pub fn send(&mut self, message: &[u8]) -> bool {
        let destination = self.destination.read().as_ref();
        let sent = destination.map(|(socket, receiver)| socket.send_to(message, receiver));
        let is_taken = matches!(sent, Some(Ok(_)));
        self.panel.count(is_taken);
        // A full buffer drops this message and says nothing about the network.
        let error = sent.and_then(Result::err).filter(|error| error.kind() != io::ErrorKind::WouldBlock);
        self.refusal = error.and_then(|error| error.raw_os_error());
        is_taken
    }

    /// Sends a message about the stream to where consoles listen for it, without counting it: the receiver, or, if that is a
    /// multicast group, the group of discovery. A message that is lost is sent again later.
    pub fn announce(&mut self, message: &[u8]) {
        if let Some((socket, receiver)) = self.destination.read() {
            let _ = socket.send_to(message, discovery_of(*receiver));
        }
    }

    /// Whether messages reach the network at present.
    pub fn is_open(&self) -> bool {
        self.destination.peek_output_buffer().is_some() && self.refusal.is_none()
    }

    /// Asks to look up the receiver's address now.
    pub fn refresh(&self) {
        // A thread that was woken before and has not looked it up yet will do so anyway.
        let _ = self.lookup.as_ref().map(|lookup| lookup.try_send(()));
    }
}

/// Where the sources that send to this receiver are looked for.
fn discovery_of(receiver: SocketAddr) -> SocketAddr {
    let ip = match receiver.ip() {
        IpAddr::V4(ip) if ip.is_multicast() => group(DISCOVERY_UNIVERSE).ip(),
        IpAddr::V6(ip) if ip.is_multicast() => {
            let [a, b, c, d, e, f, g, _] = ip.segments();
            [a, b, c, d, e, f, g, DISCOVERY_UNIVERSE].into()
        }
        ip => ip,
    };
    let mut place = receiver;
    place.set_ip(ip);
    place
}

/// Opens a socket to this receiver. With an address of this machine, multicasts and broadcasts leave by its interface.
fn open(
    address: &Address,
    receiver: SocketAddr,
    from: Option<SocketAddr>,
    socket: fn(SocketAddr, Option<SocketAddr>) -> io::Result<UdpSocket>,
) -> Result<Destination, LinkError> {
    let opened = socket(receiver, from).and_then(|socket| socket.set_broadcast(receiver.is_ipv4()).map(|()| socket));
    let socket = opened.map_err(|error| {
        let remedy = from
            .map(|from| format!("this machine has the address {}, and that no other program uses its port", from.ip()));
        let remedy = remedy.as_deref().unwrap_or("the service may use the network");
        let sentence = format!("no socket ({error}); check that {remedy}");
        LinkError::new(LinkErrorKind::Other, address, sentence)
    })?;
    Ok((socket, receiver))
}

/// Opens a socket for datagrams to this receiver that never blocks.
pub fn socket_for(receiver: SocketAddr, from: Option<SocketAddr>) -> io::Result<UdpSocket> {
    let any = if receiver.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let socket = from.map_or_else(|| UdpSocket::bind(any), UdpSocket::bind)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

/// Tests whether this machine has a route to the address at this moment, and returns what the host name stands for. Nothing is
/// sent.
pub fn check(address: &Address, from: Option<SocketAddr>) -> Result<SocketAddr, LinkError> {
    let (socket, receiver) = open(address, resolve(address)?, from, socket_for)?;
    socket.connect(receiver).map(|()| receiver).map_err(|error| {
        let sentence = format!("no network leads there ({error}); check this machine's cable or Wi-Fi and the address");
        LinkError::new(LinkErrorKind::Host, address, sentence)
    })
}

fn resolve(address: &Address) -> Result<SocketAddr, LinkError> {
    choose(address, system_resolver(address), None)
}

fn system_resolver(address: &Address) -> io::Result<Vec<SocketAddr>> {
    address.parts().ok_or(io::ErrorKind::InvalidInput)?.to_socket_addrs().map(Iterator::collect)
}

/// Looks a host name up at once, then periodically, and whenever it is woken. If that fails, the last destination stays.
fn look_up(
    address: &Address,
    from: Option<SocketAddr>,
    system: &System<impl Fn(&Address) -> io::Result<Vec<SocketAddr>>>,
    destination: &mut Input<Option<Destination>>,
    woken: &Receiver<()>,
    panel: &Panel,
) {
    let mut current = None;
    let mut retry = Retry::default();
    loop {
        let found = choose(address, (system.resolve)(address), current).and_then(|receiver| {
            if current != Some(receiver) {
                let opened = open(address, receiver, from, system.socket)?;
                panel.listen_by(Ear::new(address, &opened.0, receiver));
                destination.write(Some(opened));
                tracing::info!("link {address}: packets go to {receiver}");
                current = Some(receiver);
            }
            Ok(())
        });
        panel.note(found.as_ref().err().map(|error| &*error.message));
        match (found, current) {
            (Ok(()), _) => retry = Retry::default(),
            (Err(error), Some(current)) => retry.warn(&format!("{error}; packets still go to {current}")),
            (Err(error), None) => retry.warn(&error),
        }
        let wait = if current.is_some() { LOOKUP_PERIOD } else { retry.back_off.wait() };
        if woken.recv_timeout(wait) == Err(RecvTimeoutError::Disconnected) {
            return;
        }
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
        let interface = |name| format!("check that this machine has the interface {name}");
        let remedy = address.interface().map_or_else(name_server_remedy, interface);
        let sentence = format!("the host does not resolve ({reason}); {remedy}");
        LinkError::new(LinkErrorKind::Host, address, sentence)
    };
    let found = found.map_err(|error| unresolved(error.to_string()))?;
    let kept = current.filter(|current| found.contains(current));
    let chosen = kept.or_else(|| found.into_iter().min_by_key(SocketAddr::is_ipv6));
    chosen.ok_or_else(|| unresolved("it has no address".to_owned()))
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
    use std::time::Instant;

    use rustix::io::Errno;

    use super::*;
    use crate::config::LinkSettings;
    use crate::link::testing::{PATIENCE, counts, eventually, kind};
    use crate::skip::skip;

    const MESSAGE: &[u8] = b"message";

    fn open(address: &str) -> UdpCarrier {
        UdpCarrier::open(&Address::new(address).unwrap(), Arc::default()).unwrap()
    }

    /// Answers look-ups: returns once the next one has begun.
    type Answers = SyncSender<Vec<SocketAddr>>;

    /// A link to a host name, and what answers its look-ups.
    fn host() -> (UdpCarrier, Answers) {
        let (answers, asked) = sync_channel(0);
        let resolve = move |_: &Address| asked.recv().map_err(io::Error::other);
        let address = Address::new("head.local:5252").unwrap();
        (UdpCarrier::by(System { resolve, socket: socket_for }, &address, Arc::default()).unwrap(), answers)
    }

    /// Finds these addresses. When the second look-up has begun, the first one has had its effect.
    fn find(link: &UdpCarrier, answers: &Answers, found: &[SocketAddr]) {
        for _ in 0..2 {
            link.refresh();
            answers.send(found.to_vec()).unwrap();
        }
    }

    fn receiver(address: &str) -> UdpSocket {
        let socket = UdpSocket::bind(address).unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        socket
    }

    #[test]
    fn a_receiver_that_starts_late_gets_every_message_from_then_on_as_one_datagram() {
        for any in ["127.0.0.1:0", "[::1]:0"] {
            let Ok(socket) = UdpSocket::bind(any) else {
                skip(&format!("this machine has no address {any}"));
                continue;
            };
            let address = socket.local_addr().unwrap().to_string();
            let mut bytes = [0; 100];
            drop(socket);
            let mut link = open(&address);
            (0..10).for_each(|_| {
                link.send(b"early");
            });
            let socket = receiver(&address);
            link.send(MESSAGE);
            let length = socket.recv(&mut bytes).unwrap();
            assert_eq!((&bytes[..length], link.refusal, counts(&link.panel)), (MESSAGE, None, [11, 0]));
        }
    }

    #[test]
    fn an_address_that_cannot_be_reached_is_reported() {
        // A link-local address leads nowhere without the name of an interface. Without IPv6 there is no socket.
        let error = check(&Address::new("[fe80::1]:5252").unwrap(), None).unwrap_err().to_string();
        let causes = ["no network leads there (", "no socket ("].map(|cause| format!("link [fe80::1]:5252: {cause}"));
        assert!(causes.iter().any(|cause| error.starts_with(cause)), "{error}");
    }

    fn arrives(link: &mut UdpCarrier, socket: &UdpSocket) -> bool {
        socket.set_nonblocking(true).unwrap();
        while socket.recv(&mut [0; 1024]).is_ok() {}
        link.send(MESSAGE);
        socket.recv(&mut [0; 1024]).is_ok()
    }

    #[test]
    fn an_ipv6_address_is_reached_by_the_name_of_its_interface_and_an_interface_that_is_not_there_is_named() {
        let told = check(&Address::new("[fe80::1%nowhere7]:5252").unwrap(), None).unwrap_err().to_string();
        assert!(told.ends_with("; check that this machine has the interface nowhere7"), "{told}");
        let Ok(socket) = UdpSocket::bind("[::1]:0") else { return skip("this machine has no IPv6") };
        let address = Address::new(&format!("[::1%lo]:{}", socket.local_addr().unwrap().port())).unwrap();
        match system_resolver(&address) {
            Ok(found) => {
                assert_eq!(found.iter().map(SocketAddr::ip).collect::<Vec<_>>(), ["::1".parse::<IpAddr>().unwrap()])
            }
            // Some systems take the interface for an address that is link-local alone.
            Err(_) => {
                let link_local = Address::new("[fe80::1%lo]:5252").unwrap();
                let [SocketAddr::V6(found)] = system_resolver(&link_local).unwrap()[..] else { panic!() };
                assert_ne!(found.scope_id(), 0);
            }
        }
    }

    #[test]
    fn localhost_is_reached_by_ipv4_which_may_be_a_broadcast() {
        let socket = receiver("127.0.0.1:0");
        let mut link = open(&format!("localhost:{}", socket.local_addr().unwrap().port()));
        eventually("localhost resolves", || arrives(&mut link, &socket));
        assert!(link.destination.read().as_ref().unwrap().0.broadcast().unwrap());
    }

    #[test]
    fn a_link_says_that_nobody_listens_at_its_receiver_also_by_a_host_name_and_sends_on() {
        let port = receiver("127.0.0.1:0").local_addr().unwrap().port();
        let (mut by_name, answers) = host();
        find(&by_name, &answers, &[(Ipv4Addr::LOCALHOST, port).into()]);
        let mut by_address = open(&format!("127.0.0.1:{port}"));
        for (link, name) in [(&mut by_name, "5252 of head.local"), (&mut by_address, &*format!("{port} of 127.0.0.1"))]
        {
            eventually("a word", || {
                assert!(link.send(MESSAGE) && link.is_open());
                link.panel.listen(Instant::now());
                link.panel.is_unheard()
            });
            let status = link.panel.status();
            let want = format!("nobody listens on port {name}; start the receiver there");
            assert!(status.unheard && status.trouble.as_ref().is_some_and(|told| told.contains(&want)), "{status:?}");
            assert_eq!((status.answered_s_ago, status.dropped), (None, 0));
        }
    }

    /// A link that sends from this address.
    fn open_from(from: &str, address: &Address) -> UdpCarrier {
        let kind = kind("artnet", &format!("from = \"{from}:0\""));
        let settings = LinkSettings { kind, ..LinkSettings::default() };
        UdpCarrier::open(address, Panel::new(&settings, &Arc::default())).unwrap()
    }

    #[test]
    fn a_multicast_leaves_by_the_network_of_the_address_that_the_link_sends_from() {
        let socket = receiver("0.0.0.0:0");
        let group = Ipv4Addr::new(239, 255, 7, 9);
        socket.join_multicast_v4(&group, &Ipv4Addr::LOCALHOST).unwrap();
        let address = Address::new(&format!("{group}:{}", socket.local_addr().unwrap().port())).unwrap();
        let mut link = open_from("127.0.0.1", &address);
        eventually("the socket", || arrives(&mut link, &socket));
    }

    #[test]
    fn an_address_that_this_machine_lacks_is_waited_for_and_told() {
        let mut link = open_from("192.0.2.1", &Address::new("127.0.0.1:9").unwrap());
        eventually("a word", || link.panel.trouble().is_some_and(|told| told.contains("has the address 192.0.2.1")));
        link.send(MESSAGE);
        assert_eq!((link.is_open(), counts(&link.panel)), (false, [0, 1]));
    }

    /// A unit with RestrictAddressFamilies= or another sandbox.
    #[test]
    fn a_network_that_the_system_forbids_is_waited_for_and_told_and_refuses_no_link() {
        /// How many more times the system refuses a socket, by these errors in turn.
        static REFUSALS: AtomicU32 = AtomicU32::new(u32::MAX);
        const ERRORS: [Errno; 3] = [Errno::AFNOSUPPORT, Errno::PERM, Errno::ACCESS];
        let socket = |receiver: SocketAddr, from: Option<SocketAddr>| {
            let refusals = REFUSALS.load(Relaxed);
            REFUSALS.store(refusals.saturating_sub(1), Relaxed);
            let error = ERRORS[refusals as usize % ERRORS.len()];
            if refusals > 0 { Err(error.into()) } else { socket_for(receiver, from) }
        };
        let receiver = receiver("127.0.0.1:0");
        let address = Address::new(&receiver.local_addr().unwrap().to_string()).unwrap();
        let panel = Arc::<Panel>::default();
        let mut link =
            UdpCarrier::by(System { resolve: system_resolver, socket }, &address, Arc::clone(&panel)).unwrap();
        for error in ERRORS {
            let want = format!("no socket ({}); check that the service may use the network", io::Error::from(error));
            eventually("a word", || {
                link.refresh();
                panel.trouble().is_some_and(|told| told.contains(&want))
            });
        }
        assert!(!arrives(&mut link, &receiver) && !link.is_open());
        REFUSALS.store(2, Relaxed);
        eventually("the packets arrive", || {
            link.refresh();
            arrives(&mut link, &receiver)
        });
        assert_eq!((link.is_open(), panel.trouble()), (true, None));
    }

    /// A unit with IPAddressDeny=, whose filter lets a socket be opened and refuses each datagram, as the system refuses one that
    /// is too long.
    #[test]
    fn a_datagram_that_the_system_refuses_leaves_the_link_waiting_for_the_next_one() {
        let socket = receiver("127.0.0.1:0");
        let mut link = open(&socket.local_addr().unwrap().to_string());
        assert!(!link.send(&[0; 70_000]) && !link.is_open());
        assert_eq!(link.refusal, Some(Errno::MSGSIZE.raw_os_error()));
        assert!(arrives(&mut link, &socket) && link.is_open());
        assert_eq!(counts(&link.panel), [1, 1]);
    }

    #[test]
    fn packets_follow_a_host_name_to_its_new_address() {
        let [old, new] = ["127.0.0.1:0", "127.0.0.1:0"].map(receiver);
        let [old_address, new_address] = [&old, &new].map(|socket| socket.local_addr().unwrap());
        let (mut link, answers) = host();
        // Another order of the same addresses changes nothing.
        for found in [[old_address, new_address], [new_address, old_address]] {
            find(&link, &answers, &found);
            assert!(arrives(&mut link, &old));
        }
        find(&link, &answers, &[new_address]);
        assert!(arrives(&mut link, &new) && !arrives(&mut link, &old));
    }

    #[test]
    fn a_look_up_that_panics_is_tried_again_and_told() {
        let socket = receiver("127.0.0.1:0");
        let found = socket.local_addr().unwrap();
        let (begins, begun) = sync_channel(0);
        let tries = AtomicU32::new(0);
        let resolve = move |_: &Address| {
            let _ = begins.send(());
            assert!(tries.fetch_add(1, Relaxed) > 0, "tried");
            Ok(vec![found])
        };
        let address = Address::new("head.local:5252").unwrap();
        let mut link = UdpCarrier::by(System { resolve, socket: socket_for }, &address, Arc::default()).unwrap();
        begun.recv().unwrap();
        eventually("a word", || link.panel.trouble().is_some_and(|trouble| trouble.contains("fault of facewire")));
        begun.recv().unwrap();
        drop(begun);
        eventually("the packets arrive", || arrives(&mut link, &socket));
    }

    #[test]
    fn while_look_ups_fail_packets_go_to_the_last_known_address() {
        let socket = receiver("127.0.0.1:0");
        let (mut link, answers) = host();
        find(&link, &answers, &[]);
        assert!(!arrives(&mut link, &socket) && !link.is_open() && counts(&link.panel) == [0, 1]);
        for found in [&[socket.local_addr().unwrap()][..], &[]] {
            find(&link, &answers, found);
            assert!(arrives(&mut link, &socket) && link.is_open());
        }
        drop(link);
        // This would not end if the thread went on.
        while answers.send(Vec::new()).is_ok() {}
    }
}
