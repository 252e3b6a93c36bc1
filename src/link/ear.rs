//! What comes back from the receiver of a link by UDP: its machine's word that nobody listens there, or an answer.
//!
//! The system reports such words to a connected socket alone, and that of a link is not connected. An ear is a second socket
//! at the same port, which is connected to the receiver: whatever comes back from there, the system gives to the ear. The
//! thread that sends knows nothing of it.

use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use rustix::net::sockopt::set_socket_reuseaddr;
use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, socket_with};

use crate::config::Address;

/// Linux sends one word a second at most to each machine. Of several links to one machine on which nobody listens, perhaps
/// only the first hears it: the others then say that they know nothing, which is true.
const LONGEST_UNHEARD: Duration = Duration::from_secs(3);
/// A connected socket keeps the address of this machine that it was connected from, which the machine may lose.
const RECONNECT_PERIOD: Duration = Duration::from_secs(5);
/// Most answers that are read at once.
const MOST_AT_ONCE: usize = 100;
/// Time in which the log says at most once that nobody listens.
const LOG_PERIOD: Duration = Duration::from_mins(10);

#[derive(Debug)]
pub struct Ear {
    /// The sentence about a receiver that is not there.
    sentence: String,
    local: SocketAddr,
    receiver: SocketAddr,
    socket: Option<UdpSocket>,
    connected: Instant,
    /// When its machine last said that nobody listens, and how many messages had been sent by then.
    refused: Option<(Instant, u64)>,
    answered: Option<Instant>,
    pub is_unheard: bool,
    logged: Option<Instant>,
}

impl Ear {
    /// An ear for what comes back to this socket, which sends to `receiver`. There is none for a group of receivers.
    pub fn new(address: &Address, socket: &UdpSocket, receiver: SocketAddr) -> Option<Self> {
        if receiver.ip().is_multicast() || receiver.ip() == IpAddr::V4(Ipv4Addr::BROADCAST) {
            return None;
        }
        set_socket_reuseaddr(socket, true).ok()?;
        let local = socket.local_addr().ok()?;
        let (host, port) = address.parts()?;
        let sentence = format!(
            "nobody listens on port {port} of {host}; start the receiver there, or give the port at which it listens; a \
             firewall that refuses packets looks the same"
        );
        Some(Self {
            sentence,
            local,
            receiver,
            socket: connected(local, receiver).ok(),
            connected: Instant::now(),
            refused: None,
            answered: None,
            is_unheard: false,
            logged: None,
        })
    }

    /// Hears what has come back so far. `sent` counts the messages. Returns the sentence if the log should have it.
    pub fn hear(&mut self, sent: &AtomicU64, now: Instant) -> Option<&str> {
        let mut byte = [0];
        for _ in 0..MOST_AT_ONCE {
            match self.socket.as_ref().map(|socket| socket.recv(&mut byte)) {
                Some(Ok(_)) => {
                    self.answered = Some(now);
                    self.refused = None;
                }
                Some(Err(error)) if error.kind() == ErrorKind::ConnectionRefused => {
                    self.refused = Some((now, sent.load(Relaxed)));
                }
                _ => break,
            }
        }
        let last = [Some(self.connected), self.answered, self.refused.map(|(at, _)| at)].into_iter().flatten().max();
        if last.is_some_and(|last| now.saturating_duration_since(last) >= RECONNECT_PERIOD) {
            self.connected = now;
            self.socket = None;
            self.socket = connected(self.local, self.receiver).ok();
        }
        let sent = sent.load(Relaxed);
        // While nothing is sent, nothing shows that somebody listens now.
        self.is_unheard = self
            .refused
            .is_some_and(|(at, before)| sent <= before || now.saturating_duration_since(at) < LONGEST_UNHEARD);
        let is_logged = self.logged.is_some_and(|at| now.saturating_duration_since(at) < LOG_PERIOD);
        if !self.is_unheard || is_logged {
            return None;
        }
        self.logged = Some(now);
        Some(&self.sentence)
    }

    /// What is wrong with the receiver.
    pub fn trouble(&self) -> Option<&str> {
        self.is_unheard.then_some(&*self.sentence)
    }

    /// Time since the last answer.
    pub fn answered_ago(&self, now: Instant) -> Option<Duration> {
        self.answered.map(|at| now.saturating_duration_since(at))
    }
}

/// Opens a socket at `local` that hears `receiver` alone.
fn connected(local: SocketAddr, receiver: SocketAddr) -> io::Result<UdpSocket> {
    let family = if receiver.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let socket = socket_with(family, SocketType::DGRAM, SocketFlags::CLOEXEC | SocketFlags::NONBLOCK, None)?;
    set_socket_reuseaddr(&socket, true)?;
    bind(&socket, &local)?;
    let socket = UdpSocket::from(socket);
    socket.connect(receiver)?;
    // It would take what is sent to a receiver at the very same place.
    if socket.local_addr()? == receiver { Err(ErrorKind::AddrInUse.into()) } else { Ok(socket) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::testing::{PATIENCE, eventually};
    use crate::skip::skip;

    /// A socket that sends to a receiver, whose ear hears on a clock of the test.
    struct Heard {
        mouth: UdpSocket,
        ear: Ear,
        receiver: SocketAddr,
        sent: AtomicU64,
        now: Instant,
    }

    impl Heard {
        fn new(any: &str, receiver: SocketAddr) -> Self {
            let mouth = UdpSocket::bind(any).unwrap();
            let address = Address::new(&receiver.to_string()).unwrap();
            let ear = Ear::new(&address, &mouth, receiver).unwrap();
            let now = ear.connected;
            Self { mouth, ear, receiver, sent: AtomicU64::new(0), now }
        }

        fn send(&self) {
            self.mouth.send_to(b"message", self.receiver).unwrap();
            self.sent.fetch_add(1, Relaxed);
        }

        /// Whether nobody listens, as the ear knows some seconds later.
        fn is_unheard_after(&mut self, seconds: f32) -> bool {
            self.now += Duration::from_secs_f32(seconds);
            self.ear.hear(&self.sent, self.now);
            self.ear.is_unheard
        }

        fn until_unheard(&mut self) {
            eventually("the word that nobody listens", || {
                self.send();
                self.is_unheard_after(0.0)
            });
        }
    }

    fn bound(any: &str) -> Option<UdpSocket> {
        let socket = UdpSocket::bind(any).ok()?;
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        Some(socket)
    }

    #[test]
    fn a_port_is_one_that_nobody_listens_on_until_packets_have_gone_there_for_3_s_without_such_a_word() {
        for (any, loopback) in [("0.0.0.0:0", "127.0.0.1:0"), ("[::]:0", "[::1]:0")] {
            let Some(socket) = bound(loopback) else {
                skip(&format!("this machine has no address {loopback}"));
                continue;
            };
            let receiver = socket.local_addr().unwrap();
            let mut heard = Heard::new(any, receiver);
            heard.send();
            socket.recv(&mut [0; 9]).unwrap();
            assert!(!heard.is_unheard_after(0.0), "somebody listens");
            drop(socket);
            heard.until_unheard();
            assert!(heard.is_unheard_after(1000.0), "nothing was sent since then, and the ear is connected again");
            heard.until_unheard();
            let socket = bound(&receiver.to_string()).unwrap();
            heard.send();
            socket.recv(&mut [0; 9]).unwrap();
            assert!(heard.is_unheard_after(2.9) && !heard.is_unheard_after(0.2));
        }
    }

    #[test]
    fn an_answer_is_known_by_its_age_and_somebody_who_answers_is_there() {
        let socket = bound("127.0.0.1:0").unwrap();
        let receiver = socket.local_addr().unwrap();
        drop(socket);
        let mut heard = Heard::new("0.0.0.0:0", receiver);
        heard.until_unheard();
        assert_eq!(heard.ear.answered_ago(heard.now), None);
        let [socket, stranger] = [&*receiver.to_string(), "127.0.0.1:0"].map(|place| bound(place).unwrap());
        heard.send();
        let (_, from) = socket.recv_from(&mut [0; 9]).unwrap();
        stranger.send_to(b"ok", from).unwrap();
        assert!(heard.is_unheard_after(0.0), "an answer of somebody else is none");
        socket.send_to(b"ok", from).unwrap();
        eventually("the answer", || !heard.is_unheard_after(0.0));
        assert_eq!(heard.ear.answered_ago(heard.now + Duration::from_secs(40)), Some(Duration::from_secs(40)));
    }

    #[test]
    fn the_log_has_it_at_most_once_in_ten_minutes() {
        let socket = bound("127.0.0.1:0").unwrap();
        let receiver = socket.local_addr().unwrap();
        drop(socket);
        let mut heard = Heard::new("0.0.0.0:0", receiver);
        let mut logged = Vec::new();
        let mut is_logged = |heard: &mut Heard| {
            let line = heard.ear.hear(&heard.sent, heard.now).map(str::to_owned);
            let is_new = line.is_some();
            logged.extend(line);
            is_new
        };
        eventually("a line", || {
            heard.send();
            is_logged(&mut heard)
        });
        for (seconds, is_due) in [(599, false), (1, true), (1, false)] {
            heard.now += Duration::from_secs(seconds);
            assert_eq!(is_logged(&mut heard), is_due, "{seconds}");
        }
        let want = format!("nobody listens on port {} of 127.0.0.1; start the receiver there, ", receiver.port());
        assert!(logged.len() == 2 && logged.iter().all(|line| line.starts_with(&want)), "{logged:?}");
    }

    #[test]
    fn an_ear_takes_nothing_from_a_receiver_at_its_own_place_and_there_is_none_for_a_group() {
        let receiver = bound("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut heard = Heard::new(&receiver.to_string(), receiver);
        heard.send();
        assert!(heard.ear.socket.is_none() && !heard.is_unheard_after(0.0));
        for group in ["239.255.0.1:5568", "255.255.255.255:6454", "[ff18::1]:5568"] {
            let address = Address::new(group).unwrap();
            assert!(Ear::new(&address, &heard.mouth, group.parse().unwrap()).is_none(), "{group}");
        }
    }
}
