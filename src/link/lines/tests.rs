//! What clients of a Unix socket get.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::os::unix::net::UnixListener;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;

use super::*;
use crate::link::Carrier as _;

/// Longer than any step takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(10);

fn eventually<T>(what: &str, mut happens: impl FnMut() -> Option<T>) -> T {
    let end = Instant::now() + PATIENCE;
    loop {
        if let Some(it) = happens() {
            return it;
        }
        assert!(Instant::now() < end, "{what}");
        thread::sleep(Duration::from_millis(1));
    }
}

fn connected(path: &Path) -> BufReader<UnixStream> {
    let stream = eventually("a connection", || UnixStream::connect(path).ok());
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    BufReader::new(stream)
}

/// Returns the number in the next line that arrives while the carrier sends numbered lines.
fn next(reader: &mut BufReader<UnixStream>) -> u64 {
    let mut line = String::new();
    reader.read_line(&mut line).unwrap();
    assert!(line.ends_with('\n'), "{line:?}");
    line.trim().parse().unwrap()
}

/// A carrier that sends numbered lines from a thread until it is dropped.
struct Sending(Arc<AtomicBool>, Option<thread::JoinHandle<()>>);

impl Sending {
    fn start(path: &Path, padding: usize) -> Self {
        let over = Arc::<AtomicBool>::default();
        let (is_over, mut carrier) = (Arc::clone(&over), socket_carrier(path, Arc::default()).unwrap());
        let thread = thread::spawn(move || {
            for number in 0.. {
                if is_over.load(Relaxed) {
                    break;
                }
                carrier.send(format!("{number:0padding$}\n").as_bytes());
                thread::sleep(Duration::from_micros(200));
            }
            carrier.stop();
            eventually("the end of the carrier", || carrier.has_ended().then_some(()));
        });
        Self(over, Some(thread))
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
        self.1.take().unwrap().join().unwrap();
    }
}

#[test]
fn every_client_gets_whole_lines_in_order_and_the_file_goes_with_the_link() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lines");
    let sending = Sending::start(&path, 8);
    let mut clients = [connected(&path), connected(&path)];
    for client in &mut clients {
        let mut last = next(client);
        for _ in 0..20 {
            let number = next(client);
            assert!(number > last);
            last = number;
        }
    }
    drop(sending);
    assert!(!path.exists());
}

#[test]
fn a_client_that_reads_nothing_delays_no_other_and_later_reads_whole_lines() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lines");
    let _sending = Sending::start(&path, 2000);
    let mut slow = connected(&path);
    next(&mut slow);
    let mut quick = connected(&path);
    // Far more than the buffer of a socket holds.
    let mut last = next(&mut quick);
    for _ in 0..1000 {
        let number = next(&mut quick);
        assert!(number > last);
        last = number;
    }
    let (mut gaps, mut before) = (0, next(&mut slow));
    for _ in 0..400 {
        let number = next(&mut slow);
        gaps += u64::from(number > before + 100);
        before = number;
    }
    assert!(gaps > 0, "the slow client missed nothing");
}

#[test]
fn clients_beyond_the_limit_are_disconnected_and_leaving_makes_room() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lines");
    let _sending = Sending::start(&path, 8);
    let mut clients: Vec<_> = (0..MOST_CLIENTS).map(|_| connected(&path)).collect();
    for client in &mut clients {
        next(client);
    }
    let mut line = String::new();
    assert_eq!(connected(&path).read_line(&mut line).unwrap_or(0), 0, "{line}");
    clients.pop();
    eventually("a free place", || {
        let mut line = String::new();
        connected(&path).read_line(&mut line).ok().filter(|length| *length > 0)
    });
}

#[test]
fn a_stale_socket_is_replaced_and_any_other_file_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lines");
    drop(UnixListener::bind(&path).unwrap());
    let sending = Sending::start(&path, 8);
    next(&mut connected(&path));
    drop(sending);
    fs::write(&path, "mine").unwrap();
    let mut server = Server::at(&path);
    let error = server.open(&Shared::default()).unwrap_err();
    assert!(matches!(error, LinkError::Listen { .. }), "{error}");
    server.close();
    assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
}

/// Returns a server that is open, and does not run by itself.
fn server(path: &Path) -> Server {
    let mut server = Server::at(path);
    assert!(server.open(&Shared::default()).unwrap());
    server
}

#[test]
fn a_crowd_is_disconnected_in_parts_so_that_it_delays_no_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lines");
    let mut server = server(&path);
    let mut crowd: Vec<_> = (0..2 * MOST_AT_ONCE).map(|_| UnixStream::connect(&path).unwrap()).collect();
    let mut disconnected = || {
        let is_disconnected = |client: &mut UnixStream| {
            client.set_nonblocking(true).unwrap();
            client.read(&mut [0; 1]).is_ok_and(|length| length == 0)
        };
        crowd.iter_mut().filter_map(|client| is_disconnected(client).then_some(())).count()
    };
    for most in [MOST_AT_ONCE, 2 * MOST_AT_ONCE] {
        server.attend().unwrap();
        assert_eq!((server.clients.len(), disconnected()), (MOST_CLIENTS, most - MOST_CLIENTS));
    }
}

#[test]
fn clients_keep_their_places_while_the_system_accepts_no_others() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("lines");
    let mut server = server(&path);
    let mut client = connected(&path);
    server.attend().unwrap();
    // A TCP listener accepts no client of a Unix socket, which stands for any error of the system.
    server.listener = Some(Listener::bind(&Listen::Tcp(([127, 0, 0, 1], 0).into())).unwrap());
    let refused = server.listener.as_ref().unwrap().accept_unix().unwrap_err();
    assert_ne!(refused.kind(), ErrorKind::WouldBlock);
    server.attend().unwrap();
    assert!(server.write(b"1\n").unwrap());
    assert_eq!(next(&mut client), 1);
}
