//! Where VRChat receives OSC. While OSC is switched on in VRChat, it answers mDNS questions for receivers of OSC.
//!
//! The question is for `_osc._udp.local`, the socket that links send to, and not for OSCQuery (`_oscjson._tcp.local`), which
//! VRChat on Windows serves only to its own machine. For the same reason, the address in an answer may be 127.0.0.1 on any
//! machine, so the address that the answer came from is used instead.

use std::{
    collections::HashMap,
    io,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use serde_json::{Map, Value, json};
use socket2::SockRef;
use tokio::{
    net::{UdpSocket, lookup_host},
    sync::watch,
    time::{Instant, sleep, timeout, timeout_at},
};

use crate::addresses;

const MDNS: (Ipv4Addr, u16) = (Ipv4Addr::new(224, 0, 0, 251), 5353);
const SERVICE: &str = "_osc._udp.local";
/// The names of VRChat begin like this, and end with six letters or digits.
const INSTANCE: &str = "vrchat-client";
/// How long to wait for answers to a question.
const PATIENCE: Duration = Duration::from_secs(1);
/// Time until the next question.
const PAUSE: Duration = Duration::from_secs(2);
/// How many unanswered questions show that VRChat does not answer. Wi-Fi loses some.
const QUESTIONS_TO_KNOW: u32 = 3;
/// How long an answer counts: three questions.
const LONGEST_SILENCE: Duration = Duration::from_secs(10);
/// The most datagrams that are received after a question, and the most that are read from one machine.
const MOST_DATAGRAMS: usize = 8192;
const MOST_OF_ONE: usize = 16;
/// The most machines whose answers are read, and the most whose answers are kept.
const MOST_MACHINES: usize = 64;
/// The most places that a link names beside its receiver.
const MOST_PLACES: usize = 4;
const MOST_BYTES: usize = 9000;
const MOST_NAME_BYTES: usize = 255;
/// The most questions and records in an answer.
const MOST_RECORDS: u32 = 64;
/// The most pointers from one label of a name to the next.
const MOST_POINTERS: usize = 4;
const PTR: u8 = 12;
const SRV: u16 = 33;
/// The flag of answers.
const RESPONSE: u16 = 0x8000;

/// What is known of VRChat, for each link to it.
#[derive(Debug, Default)]
pub struct Vrchat(Mutex<Known>);

#[derive(Debug, Default)]
struct Known {
    /// Questions sent since a page was opened.
    questions: u32,
    /// The machines on which VRChat has answered with the port of its OSC, and when. This machine is 127.0.0.1.
    heard: HashMap<Ipv4Addr, (u16, Instant)>,
    /// The addresses of receivers by the names that links have for them.
    receivers: HashMap<String, SocketAddr>,
}

impl Vrchat {
    /// Adds what is known to the links to VRChat in a status of the service.
    pub fn add_to(&self, service: &mut Map<String, Value>) {
        let known = self.known();
        for link in service.get_mut("links").and_then(Value::as_array_mut).into_iter().flatten() {
            let answers = receiver_of(link).and_then(|receiver| known.answers(receiver, Instant::now()));
            if let (Some(answers), Some(link)) = (answers, link.as_object_mut()) {
                link.insert("vrchat".to_owned(), answers);
            }
        }
    }

    /// Asks again and again while a page is open and the service has a link to VRChat.
    pub async fn watch(&self, mut pages: watch::Receiver<usize>, mut status: watch::Receiver<Value>) {
        loop {
            let is_open = *pages.borrow_and_update() > 0;
            let receivers = if is_open { receivers_in(&status.borrow_and_update()) } else { Vec::new() };
            if receivers.is_empty() {
                *self.known() = Known::default();
                let changed = if is_open { status.changed().await } else { pages.changed().await };
                if changed.is_err() {
                    return;
                }
                continue;
            }
            let this_machine = addresses::all();
            let receivers = resolved(receivers, &this_machine).await;
            let shares = Shares::new(receivers.values());
            self.known().receivers = receivers;
            if let Ok(answers) = ask(&this_machine, shares).await {
                self.known().take(answers, Instant::now());
            }
            sleep(PAUSE).await;
        }
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Known {
    /// Takes the answers to one question. Those of the receivers of links are kept, however many machines answer.
    fn take(&mut self, answers: HashMap<Ipv4Addr, u16>, now: Instant) {
        self.questions = self.questions.saturating_add(1);
        self.heard.retain(|_, (_, at)| now.saturating_duration_since(*at) < LONGEST_SILENCE);
        for (machine, port) in answers {
            let is_receiver = self.receivers.values().any(|receiver| receiver.ip() == machine);
            if is_receiver || self.heard.len() < MOST_MACHINES || self.heard.contains_key(&machine) {
                self.heard.insert(machine, (port, now));
            }
        }
    }

    /// Whether VRChat answers at the receiver of a link, and some other places where it does. `None` while that is not known.
    fn answers(&self, receiver: &str, now: Instant) -> Option<Value> {
        let receiver = self.receivers.get(receiver)?;
        let heard = self.heard.iter().filter(|(_, (_, at))| now.saturating_duration_since(*at) < LONGEST_SILENCE);
        let mut places: Vec<SocketAddr> = heard.map(|(machine, (port, _))| ((*machine), *port).into()).collect();
        let answers = places.contains(receiver);
        if places.is_empty() && self.questions < QUESTIONS_TO_KNOW {
            return None;
        }
        places.retain(|place| place != receiver);
        places.sort_unstable();
        places.truncate(MOST_PLACES);
        Some(json!({"answers": answers, "elsewhere": places}))
    }
}

/// The receiver of a link to VRChat, as it stands in the link's name. The service knows the host of an open link, so that its name
/// is known here soon, too.
fn receiver_of(link: &Value) -> Option<&str> {
    let name = link.get("name").and_then(Value::as_str)?;
    let is_open = link.get("open").and_then(Value::as_bool) == Some(true);
    let is_to_vrchat = link.get("kind").and_then(Value::as_str) == Some("vrchat");
    name.strip_prefix("vrchat ").filter(|_| is_open && is_to_vrchat)
}

fn receivers_in(status: &Value) -> Vec<String> {
    let links = status.pointer("/service/links").and_then(Value::as_array);
    links.into_iter().flatten().filter_map(receiver_of).map(str::to_owned).collect()
}

/// Returns the addresses of these receivers. VRChat answers by IPv4 alone, and nobody can say which one of a group does.
async fn resolved(receivers: Vec<String>, this_machine: &[IpAddr]) -> HashMap<String, SocketAddr> {
    let mut known = HashMap::new();
    for receiver in &receivers {
        let Ok(Ok(found)) = timeout(PATIENCE, lookup_host(receiver)).await else { continue };
        let mut found = found.map(|place| SocketAddr::new(here(place.ip(), this_machine), place.port()));
        // The network is not known; 255 at the end is mostly its broadcast.
        let is_one = |ip: Ipv4Addr| !ip.is_multicast() && !matches!(ip.octets(), [.., 255]);
        if let Some(place) = found.find(|place| matches!(place.ip(), IpAddr::V4(ip) if is_one(ip))) {
            known.insert(receiver.clone(), place);
        }
    }
    known
}

/// Returns 127.0.0.1 for any address of this machine, and others as they are.
fn here(ip: IpAddr, this_machine: &[IpAddr]) -> IpAddr {
    let is_here = ip.is_loopback() || this_machine.contains(&ip);
    if is_here { Ipv4Addr::LOCALHOST.into() } else { ip }
}

/// How many more datagrams are read from each machine.
#[derive(Debug)]
struct Shares(HashMap<IpAddr, usize>);

impl Shares {
    /// These receivers have their shares, however many other machines send.
    fn new<'a>(receivers: impl Iterator<Item = &'a SocketAddr>) -> Self {
        Self(receivers.map(|receiver| (receiver.ip(), MOST_OF_ONE)).collect())
    }

    /// Takes a datagram from the share of its sender. Returns whether it is to be read.
    fn take(&mut self, machine: IpAddr) -> bool {
        let is_full = self.0.len() >= MOST_MACHINES;
        let share = if is_full { self.0.get_mut(&machine) } else { Some(self.0.entry(machine).or_insert(MOST_OF_ONE)) };
        let Some(share) = share.filter(|share| **share > 0) else { return false };
        *share -= 1;
        true
    }
}

/// Asks all networks of this machine, and returns on which machines VRChat has answered, with its port. Fails if no network takes
/// the question.
async fn ask(this_machine: &[IpAddr], shares: Shares) -> io::Result<HashMap<Ipv4Addr, u16>> {
    // From another port than 5353, so that answers come to this socket alone, and not to everybody.
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).await?;
    let id = getrandom::u32().map_err(io::Error::other)? as u16;
    let question = question(id);
    let mut sent = Err(io::Error::from(io::ErrorKind::NetworkUnreachable));
    // Without another network, VRChat on this machine listens at its loopback.
    for ip in this_machine {
        let IpAddr::V4(ip) = ip else { continue };
        let is_chosen = SockRef::from(&socket).set_multicast_if_v4(ip).is_ok();
        if is_chosen && let Ok(bytes) = socket.send_to(&question, MDNS).await {
            sent = Ok(bytes);
        }
    }
    sent?;
    Ok(answers_until(Instant::now() + PATIENCE, &socket, id, this_machine, shares).await)
}

/// Returns what has come by then in answer to the question of this number. Anybody nearby may have sent it.
async fn answers_until(
    until: Instant,
    socket: &UdpSocket,
    id: u16,
    this_machine: &[IpAddr],
    mut shares: Shares,
) -> HashMap<Ipv4Addr, u16> {
    let mut answers = HashMap::new();
    let mut datagram = [0; MOST_BYTES];
    for _ in 0..MOST_DATAGRAMS {
        // What has come already is received even when the time is over.
        if Instant::now() >= until {
            break;
        }
        let Ok(received) = timeout_at(until, socket.recv_from(&mut datagram)).await else { break };
        let Ok((length, from)) = received else { continue };
        let machine = here(from.ip(), this_machine);
        if !shares.take(machine) {
            continue;
        }
        let port = datagram.get(..length).and_then(|datagram| port_of_vrchat(datagram, id));
        if let (Some(port), IpAddr::V4(machine)) = (port, machine) {
            answers.insert(machine, port);
        }
    }
    answers
}

/// Returns the question for receivers of OSC in the format of RFC 6762. Answers repeat its number.
fn question(id: u16) -> Vec<u8> {
    let mut bytes = id.to_be_bytes().to_vec();
    // A plain question, one in all, no records.
    bytes.extend([0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
    for label in SERVICE.split('.') {
        bytes.push(label.len() as u8);
        bytes.extend(label.as_bytes());
    }
    // The end of the name; of the type PTR, in the class of the Internet.
    bytes.extend([0, 0, PTR, 0, 1]);
    bytes
}

/// Returns the port at which VRChat receives OSC if this is an answer for it to the question of this number.
fn port_of_vrchat(answer: &[u8], id: u16) -> Option<u16> {
    let mut reader = Reader { bytes: answer, at: 0 };
    let (number, flags, questions) = (reader.u16()?, reader.u16()?, reader.u16()?);
    if number != id || flags & RESPONSE == 0 {
        return None;
    }
    let mut records = 0;
    for _ in 0..3 {
        records += u32::from(reader.u16()?);
    }
    if u32::from(questions) + records > MOST_RECORDS {
        return None;
    }
    for _ in 0..questions {
        reader.skip_name()?;
        reader.bytes(4)?;
    }
    for _ in 0..records {
        let name = Reader { ..reader };
        reader.skip_name()?;
        let kind = reader.u16()?;
        let [_, _, lifetime @ ..] = reader.bytes(6)? else { return None };
        let length = reader.u16()?;
        let data = reader.bytes(length.into())?;
        // Priority and weight come before the port.
        let [_, _, _, _, high, low, ..] = data else { continue };
        let port = u16::from_be_bytes([*high, *low]);
        // The lifetime of what has gone is 0.
        if kind == SRV && lifetime != [0; 4] && port != 0 && is_vrchat(name) {
            return Some(port);
        }
    }
    None
}

/// Whether the name that begins here is one of VRChat.
fn is_vrchat(mut name: Reader<'_>) -> bool {
    let instance = name.label().and_then(|label| label.get(..INSTANCE.len()));
    let is_instance = instance.is_some_and(|start| start.eq_ignore_ascii_case(INSTANCE.as_bytes()));
    let mut is_next = |want: &str| name.label().is_some_and(|label| label.eq_ignore_ascii_case(want.as_bytes()));
    // A name ends with an empty label.
    is_instance && SERVICE.split('.').chain([""]).all(&mut is_next)
}

/// Reads a message of the DNS.
#[derive(Debug)]
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let bytes = self.bytes.get(self.at..)?.get(..count)?;
        self.at += count;
        Some(bytes)
    }

    fn u16(&mut self) -> Option<u16> {
        self.bytes(2)?.try_into().ok().map(u16::from_be_bytes)
    }

    /// Steps over a name, of which the rest may stand elsewhere in the message.
    fn skip_name(&mut self) -> Option<()> {
        let start = self.at;
        while self.at - start <= MOST_NAME_BYTES {
            match self.bytes(1)? {
                [0] => return Some(()),
                [length @ 1..=63] => self.bytes((*length).into())?,
                [0xC0..=0xFF] => return self.bytes(1).map(|_| ()),
                _ => return None,
            };
        }
        None
    }

    /// Reads the next label of a name, wherever it stands. It is empty at the end of the name.
    fn label(&mut self) -> Option<&'a [u8]> {
        for _ in 0..=MOST_POINTERS {
            match self.bytes(1)? {
                [length @ 0..=63] => return self.bytes((*length).into()),
                [high @ 0xC0..=0xFF] => {
                    self.at = usize::from(u16::from_be_bytes([*high & 0x3F, *self.bytes(1)?.first()?]));
                }
                _ => return None,
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ID: u16 = 0x1234;
    /// What python-zeroconf 0.147 answered for two receivers of OSC, of which VRChat-Client-9F3A21 is the second.
    const RECORDED: &[u8] =
        b"\x124\x84\0\0\x01\0\x02\0\0\0\x08\x04_osc\x04_udp\x05local\0\0\x0c\0\x01\xc0\x0c\0\x0c\0\x01\0\0\x11\x94\0\
        \x17\x14VRChat-Client-9F3A21\xc0\x0c\xc0\x0c\0\x0c\0\x01\0\0\x11\x94\0\x19\x16VRCFaceTracking-7K2M9Q\xc0\x0c\
        \xc0-\0!\0\x01\0\0\0x\0!\0\0\0\0#(\x14VRChat-Client-9F3A21\x03osc\xc0\x16\xc0-\0\x10\0\x01\0\0\x11\x94\0\0\
        \xc0-\0/\0\x01\0\0\0x\0\x08\xc0-\0\x04\0\0\0\x08\xc0{\0\x01\0\x01\0\0\0x\0\x04\x7f\0\0\x01\x16VRCFaceTrackin\
        g-7K2M9Q\xc0\x90\0\x01\0\x01\0\0\0x\0\x04\x0aM\0\x02\xc0P\0\x10\0\x01\0\0\x11\x94\0\0\xc0P\0!\0\x01\0\0\0x\0\
        \x08\0\0\0\0#)\xc0\xc6\xc0P\0/\0\x01\0\0\0x\0\x08\xc0P\0\x04\0\0\0\x08";

    fn answer(records: &[&[u8]]) -> Vec<u8> {
        let count = records.len() as u8;
        [&[0x12, 0x34, 0x84, 0, 0, 0, 0, count, 0, 0, 0, 0], &*records.concat()].concat()
    }

    /// A record of a receiver of OSC at port 9000 with this name, which lives for so many seconds.
    fn record(name: &[u8], lifetime_s: u8) -> Vec<u8> {
        let mut record = Vec::new();
        for label in name.split(|byte| *byte == b'.').chain([&b"_osc"[..], b"_udp", b"local"]) {
            record.push(label.len() as u8);
            record.extend(label);
        }
        record.extend(b"\0\0\x21\0\x01\0\0\0");
        record.push(lifetime_s);
        record.extend(b"\0\x07\0\0\0\0\x23\x28\0");
        record
    }

    #[test]
    fn the_port_of_vrchat_is_found_in_what_other_programs_send_and_not_that_of_another_receiver() {
        assert_eq!(port_of_vrchat(RECORDED, ID), Some(9000));
        let other = record(b"VRCFaceTracking-7K2M9Q", 120);
        for (records, port) in [
            (vec![&*record(b"VRChat-Client-9F3A21", 120)], Some(9000)),
            (vec![&*other, &record(b"vrchat-client-9f3a21", 10)], Some(9000)),
            (vec![&*other], None),
            (vec![&*record(b"Not-VRChat-Client-9F3A21", 120)], None),
            // It has just ended.
            (vec![&*record(b"VRChat-Client-9F3A21", 0)], None),
        ] {
            assert_eq!(port_of_vrchat(&answer(&records), ID), port, "{records:x?}");
        }
        let mut without_port = record(b"VRChat-Client-9F3A21", 120);
        let end = without_port.len();
        without_port[end - 3..end - 1].fill(0);
        assert_eq!(port_of_vrchat(&answer(&[&without_port]), ID), None, "nobody receives at port 0");
        assert_eq!(port_of_vrchat(RECORDED, ID + 1), None, "the answer to somebody else's question");
        assert_eq!(port_of_vrchat(&question(ID), ID), None);
    }

    #[test]
    fn an_answer_that_would_take_long_to_read_is_refused_and_no_name_is_read_that_does_not_matter() {
        let vrchat = record(b"VRChat-Client-9F3A21", 120);
        // A name of 120 labels, to which the names of all other questions point.
        let long = [&b"\x01a".repeat(120)[..], b"\0\0\x0c\0\x01"].concat();
        let with_questions = |count: u16| {
            let others = b"\xc0\x0c\0\x0c\0\x01".repeat(usize::from(count) - 1);
            let [high, low] = count.to_be_bytes();
            [&[0x12, 0x34, 0x84, 0, high, low, 0, 1, 0, 0, 0, 0], &*long, &others, &vrchat].concat()
        };
        for (questions, port) in [(2, Some(9000)), (63, Some(9000)), (64, None), (1400, None)] {
            assert_eq!(port_of_vrchat(&with_questions(questions), ID), port, "{questions} questions");
        }
        for (records, port) in [(64, Some(9000)), (65, None)] {
            let mut all = vec![&b"\0\0\x01\0\x01\0\0\0\x78\0\0"[..]; records - 1];
            all.push(&vrchat);
            assert_eq!(port_of_vrchat(&answer(&all), ID), port, "{records} records");
        }
        // The name of an address goes on with itself.
        let address = b"\xc0\x0c\0\x01\0\x01\0\0\0\x78\0\x04\x0a\0\0\x02";
        assert_eq!(port_of_vrchat(&answer(&[address, &vrchat]), ID), Some(9000));
        // The data of the first record hold a name, and pointers of which each names the one before it.
        for (pointers, port) in [(MOST_POINTERS, Some(9000)), (MOST_POINTERS + 1, None)] {
            let mut data = vrchat.get(..vrchat.len() - 17).unwrap().to_vec();
            let mut place = 23;
            for _ in 1..pointers {
                let next = 23 + data.len();
                data.extend([0xC0, place as u8]);
                place = next;
            }
            let holder = [&b"\0\0\x10\0\x01\0\0\0\x78\0"[..], &[data.len() as u8], &data].concat();
            let pointing = [&[0xC0, place as u8], &vrchat[vrchat.len() - 17..]].concat();
            assert_eq!(port_of_vrchat(&answer(&[&holder, &pointing]), ID), port, "{pointers} pointers");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_no_answer_takes_no_place_of_one_and_nothing_is_read_after_the_time() {
        let [asker, machine] =
            [UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.1:0").await.unwrap()];
        let place = asker.local_addr().unwrap();
        for _ in 1..MOST_OF_ONE {
            machine.send_to(b"no answer", place).await.unwrap();
        }
        machine.send_to(&answer(&[&record(b"VRChat-Client-9F3A21", 120)]), place).await.unwrap();
        let heard = [(Ipv4Addr::LOCALHOST, 9000)].into();
        let ask = |until| answers_until(until, &asker, ID, &[], Shares::new([].iter()));
        assert_eq!(ask(Instant::now() + PATIENCE).await, heard);
        machine.send_to(&answer(&[&record(b"VRChat-Client-9F3A21", 120)]), place).await.unwrap();
        asker.readable().await.unwrap();
        assert_eq!(ask(Instant::now()).await, HashMap::new());
    }

    #[tokio::test(start_paused = true)]
    async fn an_answer_beyond_the_share_of_its_machine_is_not_read() {
        let [asker, machine] =
            [UdpSocket::bind("127.0.0.1:0").await.unwrap(), UdpSocket::bind("127.0.0.1:0").await.unwrap()];
        let place = asker.local_addr().unwrap();
        for (share, is_read) in [(2, true), (1, false)] {
            machine.send_to(b"no answer", place).await.unwrap();
            machine.send_to(&answer(&[&record(b"VRChat-Client-9F3A21", 120)]), place).await.unwrap();
            let shares = Shares([(Ipv4Addr::LOCALHOST.into(), share)].into());
            let answers = answers_until(Instant::now() + PATIENCE, &asker, ID, &[], shares).await;
            assert_eq!(answers.contains_key(&Ipv4Addr::LOCALHOST), is_read);
        }
    }

    #[test]
    fn no_machine_uses_up_the_share_of_another_and_no_number_of_machines_that_of_a_receiver() {
        let receiver: SocketAddr = "10.0.0.2:9000".parse().unwrap();
        let mut shares = Shares::new([receiver].iter());
        let machine = |number: usize| IpAddr::V4(Ipv4Addr::from_bits(0x0A01_0000 + number as u32));
        let read = (0..10_000).filter(|_| shares.take(machine(0))).count();
        assert_eq!(read, MOST_OF_ONE);
        assert!(shares.take(machine(1)));
        let read = (2..10_000).filter(|number| shares.take(machine(*number))).count();
        assert_eq!(read, MOST_MACHINES - 3);
        assert!(shares.take(machine(1)) && shares.take(receiver.ip()));
    }

    #[test]
    fn the_answer_of_a_receiver_is_kept_after_those_of_any_number_of_machines() {
        let mut asked = Asked::new("10.0.0.2:9000");
        let many: Vec<_> = (0..=255).map(|host| ([10, 0, 1, host], 9000)).collect();
        assert_eq!(asked.ask(0, &many)["answers"], false);
        assert_eq!(asked.ask(1, &[([10, 0, 0, 2], 9000)])["answers"], true);
    }

    #[test]
    fn names_that_go_on_with_themselves_counts_without_records_and_any_other_bytes_are_read_to_their_end() {
        let loops: [&[u8]; 4] = [b"\xc0\x0c", b"\x01a\xc0\x0c", b"\xc0\x0e\xc0\x0c", b"\xff\xff"];
        for name in loops {
            assert_eq!(port_of_vrchat(&answer(&[name, b"\0\x21\0\x01\0\0\0\x78\0\x07\0\0\0\0\x23\x28\0"]), ID), None);
        }
        let mut counts = answer(&[]);
        counts.iter_mut().skip(4).for_each(|byte| *byte = 255);
        assert_eq!(port_of_vrchat(&counts, ID), None);
        let end = RECORDED.windows(2).position(|bytes| bytes == 9000_u16.to_be_bytes()).unwrap();
        for length in 0..end {
            assert_eq!(port_of_vrchat(&RECORDED[..length], ID), None, "{length} bytes");
        }
        let mut random = fastrand::Rng::with_seed(7);
        for _ in 0..100_000 {
            let mut bytes = RECORDED.to_vec();
            for _ in 0..random.usize(1..9) {
                let place = random.usize(4..bytes.len());
                let any = random.u8(..);
                bytes[place] = *random.choice(&[0, 1, 12, 63, 64, 192, 255, any]).unwrap();
            }
            let _ = port_of_vrchat(&bytes, ID);
        }
    }

    /// What is known of the receiver `pc:9000`.
    struct Asked {
        known: Known,
        now: Instant,
    }

    impl Asked {
        fn new(receiver: &str) -> Self {
            let receivers = [("pc:9000".to_owned(), receiver.parse().unwrap())].into();
            Self { known: Known { receivers, ..Known::default() }, now: Instant::now() }
        }

        /// Asks once more, `after_s` seconds later, and returns whether VRChat answers there, and where else.
        fn ask(&mut self, after_s: u64, answers: &[([u8; 4], u16)]) -> Value {
            self.now += Duration::from_secs(after_s);
            let answers = answers.iter().map(|(machine, port)| ((*machine).into(), *port)).collect();
            self.known.take(answers, self.now);
            self.known.answers("pc:9000", self.now).unwrap_or_default()
        }
    }

    #[test]
    fn an_answer_counts_for_ten_seconds_and_three_questions_without_one_show_that_there_is_none() {
        let [here, none] = [true, false].map(|answers| json!({"answers": answers, "elsewhere": []}));
        let pc = ([10, 0, 0, 2], 9000);
        let mut asked = Asked::new("10.0.0.2:9000");
        for (after_s, answers, want) in [
            (0, &[][..], &Value::Null),
            (3, &[], &Value::Null),
            (3, &[], &none),
            (3, &[pc], &here),
            (9, &[], &here),
            (1, &[], &none),
        ] {
            assert_eq!(asked.ask(after_s, answers), *want, "{after_s} s, {answers:?}");
        }
        assert_eq!(asked.known.answers("unknown:9000", asked.now), None);
    }

    #[test]
    fn vrchat_on_another_machine_or_at_another_port_is_named_and_does_not_answer_for_the_receiver() {
        let mut asked = Asked::new("10.0.0.2:9000");
        let elsewhere = [([10, 0, 0, 3], 9000), ([10, 0, 0, 2], 9010)];
        let places = ["10.0.0.2:9010", "10.0.0.3:9000"];
        assert_eq!(asked.ask(0, &elsewhere), json!({"answers": false, "elsewhere": places}));
        let both = json!({"answers": true, "elsewhere": ["10.0.0.3:9000"]});
        assert_eq!(asked.ask(1, &[([10, 0, 0, 2], 9000)]), both);
    }

    #[test]
    fn four_of_many_places_are_named_and_sixty_four_machines_kept_and_none_of_them_is_lost_to_a_new_one() {
        let mut asked = Asked::new("10.0.0.2:9000");
        asked.ask(0, &[([10, 0, 0, 2], 9000), ([10, 0, 0, 9], 9000)]);
        let many: Vec<_> = (0..=255).map(|host| ([10, 0, 1, host], 9000)).collect();
        let answers = asked.ask(1, &many);
        assert_eq!(answers["answers"], true);
        assert_eq!(answers["elsewhere"].as_array().map(Vec::len), Some(4));
        assert_eq!(asked.known.heard.len(), 64);
        asked.ask(1, &[([10, 0, 0, 9], 9010)]);
        assert_eq!(asked.known.heard[&Ipv4Addr::new(10, 0, 0, 9)].0, 9010);
    }

    #[tokio::test]
    async fn all_addresses_of_this_machine_are_one_and_groups_and_ipv6_have_no_answer() {
        let this_machine = ["10.0.0.5", "fd00::5"].map(|ip| ip.parse().unwrap());
        for (receiver, want) in [
            ("10.0.0.2:9000", Some("10.0.0.2:9000")),
            ("127.0.0.1:9000", Some("127.0.0.1:9000")),
            ("10.0.0.5:9000", Some("127.0.0.1:9000")),
            ("[fd00::5]:9010", Some("127.0.0.1:9010")),
            ("[fd00::2]:9000", None),
            ("239.255.0.1:9000", None),
            ("255.255.255.255:9000", None),
            ("10.0.0.255:9000", None),
            ("nonsense", None),
        ] {
            let known = resolved(vec![receiver.to_owned()], &this_machine).await;
            assert_eq!(known.get(receiver).map(ToString::to_string).as_deref(), want, "{receiver}");
        }
    }
}
