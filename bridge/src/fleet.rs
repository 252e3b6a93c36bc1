//! The boards: who they are, what their faces show, and what came that was no face.
//!
//! A board is known by the address from which it sends. Each has the receiver's rule of the packet crate, so that what is
//! published goes to neutral in silence and never jumps. Nothing is queued: an output reads the newest face of each board and
//! tells by [`Board::taken`] how many packets it has missed. Memory is bounded by the most boards that are taken.

use std::{
    net::IpAddr,
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    time::{Duration, Instant},
};

use facewire_packet::{DecodeError, Face, Packet, State, TRAVEL_MS, Tally};

use crate::settings::{NamedBoard, Settings};

/// A board that is silent for this long is away.
const AWAY: Duration = Duration::from_secs(2);

/// What came that is no packet of a board here.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct Counts {
    /// Packets of boards without a name, where only named ones are taken.
    pub strangers: u64,
    /// Packets of boards beyond the most.
    pub surplus: u64,
    /// Damaged datagrams of unknown senders. Each board counts its own in its tally.
    pub damaged: u64,
}

/// What became of a datagram.
#[derive(Debug, PartialEq, Eq)]
pub enum Taken {
    /// It is the newest face of a board.
    Newest,
    /// It came twice or late.
    Late,
    /// It is the first of a board without a name, which is called this now.
    Added(String),
    /// It was refused, with the reason and how many were refused for it so far.
    Refused(Refusal, u64),
}

/// Why a datagram was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    Stranger,
    Surplus,
    Damaged(DecodeError),
}

/// A board.
#[derive(Debug)]
pub struct Board {
    pub name: String,
    pub address: IpAddr,
    pub tally: Tally<u16>,
    /// How many packets were taken: an output that knows the number it saw last knows how many it missed.
    pub taken: u64,
    receiver: facewire_packet::Receiver,
}

impl Board {
    fn new(name: String, address: IpAddr) -> Self {
        Self { name, address, tally: Tally::default(), taken: 0, receiver: facewire_packet::Receiver::new(TRAVEL_MS) }
    }

    /// Whether the board sends.
    pub fn is_here(&self, now: Instant) -> bool {
        self.tally.newest.as_ref().is_some_and(|newest| now.saturating_duration_since(newest.at) < AWAY)
    }

    /// The newest packet.
    pub fn packet(&self) -> &Packet {
        self.receiver.newest()
    }

    /// Whether a face is followed.
    pub fn has_face(&self, now: Instant) -> bool {
        matches!(self.packet().state, State::Live | State::Hold) && self.tally.silence(now).is_none() && self.taken > 0
    }

    /// How many packets an output has missed before the newest one. `None` if it has seen the newest. Sets `seen` to the newest.
    pub fn missed_since(&self, seen: &mut u64) -> Option<u64> {
        let new = self.taken - std::mem::replace(seen, self.taken);
        new.checked_sub(1)
    }
}

/// All boards.
#[derive(Debug)]
pub struct Fleet {
    pub boards: Vec<Board>,
    pub counts: Counts,
    most: usize,
    accepts_others: bool,
    start: Instant,
}

impl Fleet {
    pub fn new(settings: &Settings, start: Instant) -> Self {
        let named = |NamedBoard { name, address }: &NamedBoard| Board::new(name.clone(), address.to_canonical());
        Self {
            boards: settings.board.iter().map(named).collect(),
            counts: Counts::default(),
            most: settings.most_boards,
            accepts_others: settings.accepts_others(),
            start,
        }
    }

    /// Takes a datagram from this address and port.
    pub fn take(&mut self, address: IpAddr, port: u16, datagram: &[u8], now: Instant) -> Taken {
        let address = address.to_canonical();
        let known = self.boards.iter().position(|board| board.address == address);
        let packet = match Packet::decode(datagram) {
            Ok(packet) => packet,
            Err(fault) => {
                let count = match known.and_then(|at| self.boards.get_mut(at)) {
                    Some(board) => {
                        board.tally.refuse(fault);
                        board.tally.refused
                    }
                    None => counted(&mut self.counts.damaged),
                };
                return Taken::Refused(Refusal::Damaged(fault), count);
            }
        };
        let at = match known {
            Some(at) => at,
            None if !self.accepts_others => {
                return Taken::Refused(Refusal::Stranger, counted(&mut self.counts.strangers));
            }
            None if self.boards.len() >= self.most => {
                return Taken::Refused(Refusal::Surplus, counted(&mut self.counts.surplus));
            }
            None => {
                self.boards.push(Board::new(self.free_name(address), address));
                self.boards.len() - 1
            }
        };
        let now_ms = self.ms(now);
        let Some(board) = self.boards.get_mut(at) else { return Taken::Late };
        board.tally.count(&packet, port, now);
        if !board.receiver.receive(&packet, now_ms) {
            return Taken::Late;
        }
        board.taken += 1;
        if known.is_none() { Taken::Added(board.name.clone()) } else { Taken::Newest }
    }

    /// The face that a board shows now.
    pub fn face(&mut self, at: usize, now: Instant) -> Option<Face> {
        let now_ms = self.ms(now);
        Some(self.boards.get_mut(at)?.receiver.show(now_ms))
    }

    /// A name after the address that no other board has: two addresses may differ in their punctuation alone.
    fn free_name(&self, address: IpAddr) -> String {
        let base = name_of(address);
        let is_free = |name: &String| self.boards.iter().all(|board| !board.name.eq_ignore_ascii_case(name));
        let numbered = (2..=self.boards.len() + 2).map(|number| format!("{base}_{number}"));
        std::iter::once(base.clone()).chain(numbered).find(is_free).unwrap_or(base)
    }

    /// Milliseconds since the start, which wrap after 49 days as the receiver expects.
    #[allow(clippy::cast_possible_truncation, reason = "it wraps")]
    fn ms(&self, now: Instant) -> u32 {
        now.saturating_duration_since(self.start).as_millis() as u32
    }
}

fn counted(count: &mut u64) -> u64 {
    *count += 1;
    *count
}

/// A name for topics and ROS: `board_192_168_1_21`.
fn name_of(address: IpAddr) -> String {
    let words = address.to_string();
    let words: Vec<&str> = words.split(|character: char| !character.is_ascii_alphanumeric()).collect();
    let words: Vec<&str> = words.into_iter().filter(|word| !word.is_empty()).collect();
    format!("board_{}", words.join("_"))
}

/// The fleet for several threads.
#[derive(Debug)]
pub struct Shared {
    fleet: Mutex<Fleet>,
    /// Tells who publishes every packet that one has come. It holds one message.
    bell: SyncSender<()>,
    pub is_stopped: AtomicBool,
}

impl Shared {
    /// Returns the fleet, and what tells of packets.
    pub fn new(fleet: Fleet) -> (Self, Receiver<()>) {
        let (bell, rings) = sync_channel(1);
        (Self { fleet: Mutex::new(fleet), bell, is_stopped: AtomicBool::new(false) }, rings)
    }

    pub fn lock(&self) -> MutexGuard<'_, Fleet> {
        self.fleet.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn ring(&self) {
        let _ = self.bell.try_send(());
    }

    pub fn is_stopped(&self) -> bool {
        self.is_stopped.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn fleet(settings: Settings) -> (Fleet, Instant) {
        let now = Instant::now();
        (Fleet::new(&settings, now), now)
    }

    fn live(sequence: u16, jaw: f32) -> [u8; 132] {
        let mut packet = Packet { state: State::Live, sequence, ..Packet::NEUTRAL };
        packet.coefficients[17] = jaw;
        packet.encode()
    }

    fn ip(last: u8) -> IpAddr {
        [10, 0, 0, last].into()
    }

    #[test]
    fn strangers_surplus_and_damaged_datagrams_are_counted_and_take_no_place() {
        let board = vec![NamedBoard { name: "left".to_owned(), address: ip(1) }];
        let (mut named, now) = fleet(Settings { board, ..Settings::default() });
        assert_eq!(named.take(ip(2), 1, &live(1, 0.0), now), Taken::Refused(Refusal::Stranger, 1));
        assert_eq!(named.take(ip(1), 1, &live(1, 0.0), now), Taken::Newest);
        let (mut open, now) = fleet(Settings { most_boards: 2, ..Settings::default() });
        assert_eq!(open.take(ip(1), 1, &live(1, 0.0), now), Taken::Added("board_10_0_0_1".to_owned()));
        assert_eq!(open.take(ip(2), 1, &live(1, 0.0), now), Taken::Added("board_10_0_0_2".to_owned()));
        assert_eq!(open.take(ip(3), 1, &live(1, 0.0), now), Taken::Refused(Refusal::Surplus, 1));
        assert_eq!(open.take(ip(3), 1, &live(2, 0.0), now), Taken::Refused(Refusal::Surplus, 2));
        let fault = DecodeError::Length(5);
        assert_eq!(open.take(ip(4), 1, b"hello", now), Taken::Refused(Refusal::Damaged(fault), 1));
        assert_eq!(open.take(ip(1), 1, b"hello", now), Taken::Refused(Refusal::Damaged(fault), 1));
        assert_eq!((open.counts.damaged, open.boards[0].tally.refused, open.boards.len()), (1, 1, 2));
    }

    #[test]
    fn boards_get_names_that_topics_and_ros_allow_and_that_differ() {
        let (mut fleet, now) = fleet(Settings::default());
        for address in ["192.168.1.21", "::ffff:192.168.1.21", "fe80::1:2", "fe80:1::2"] {
            fleet.take(address.parse().unwrap(), 1, &live(1, 0.0), now);
        }
        let names: Vec<&str> = fleet.boards.iter().map(|board| board.name.as_str()).collect();
        assert_eq!(names, ["board_192_168_1_21", "board_fe80_1_2", "board_fe80_1_2_2"]);
    }

    #[test]
    fn a_silent_board_has_no_face_after_500_ms_goes_to_neutral_and_is_away_after_2_s() {
        let (mut fleet, now) = fleet(Settings::default());
        for (sequence, ms) in (0..).zip((0..=1000).step_by(20)) {
            fleet.take(ip(1), 1, &live(sequence, 1.0), now + MS * ms);
            fleet.face(0, now + MS * ms);
        }
        let told = |fleet: &mut Fleet, ms: u32| {
            let at = now + MS * ms;
            let face = fleet.face(0, at).unwrap();
            (fleet.boards[0].has_face(at), fleet.boards[0].is_here(at), face.coefficients[17])
        };
        assert_eq!(told(&mut fleet, 1000), (true, true, 1.0));
        for ms in (1500..2000).step_by(50) {
            told(&mut fleet, ms);
        }
        assert_eq!(told(&mut fleet, 2100), (false, true, 0.0));
        assert_eq!(told(&mut fleet, 3001), (false, false, 0.0));
    }

    #[test]
    fn an_output_knows_how_many_packets_it_has_missed() {
        let (mut fleet, now) = fleet(Settings::default());
        for sequence in 1..=5 {
            fleet.take(ip(1), 1, &live(sequence, 0.0), now);
        }
        let mut seen = 0;
        assert_eq!(fleet.boards[0].missed_since(&mut seen), Some(4));
        assert_eq!(fleet.boards[0].missed_since(&mut seen), None);
        assert_eq!(fleet.take(ip(1), 1, &live(5, 0.0), now), Taken::Late);
        assert_eq!(fleet.boards[0].missed_since(&mut seen), None);
    }
}
