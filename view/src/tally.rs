//! Counts of the packets received so far.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use facewire_packet::{DecodeError, Packet};

/// The time over which the rate is measured, and after which a sender that is silent no longer counts.
const WINDOW: Duration = Duration::from_secs(1);
/// The most arrivals that are remembered: a port that is flooded costs no more memory.
const MOST_ARRIVALS: usize = 1024;

/// Who sent a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sender {
    /// A UDP address.
    Udp(std::net::SocketAddr),
    /// The other end of the serial line.
    Line,
}

/// The newest packet.
#[derive(Debug, Clone, Copy)]
pub struct Newest {
    pub packet: Packet,
    pub from: Sender,
    /// The time of arrival.
    pub at: Instant,
}

/// The counts, as shown.
#[derive(Debug, Clone, Copy, Default)]
pub struct Counts {
    pub packets: u64,
    pub lost: u64,
    /// Datagrams and frames that were not valid packets.
    pub refused: u64,
    /// Packets per second, over the last second.
    pub rate_hz: f64,
    /// What was wrong with the last refused one.
    pub fault: Option<DecodeError>,
    /// A second sender, if packets of two arrived within a second.
    pub rival: Option<Sender>,
}

/// Counts packets.
#[derive(Debug, Default)]
pub struct Tally {
    counts: Counts,
    newest: Option<Newest>,
    arrivals: VecDeque<Instant>,
    rival_at: Option<Instant>,
}

impl Tally {
    /// Counts a valid packet.
    pub fn count(&mut self, packet: &Packet, from: Sender, at: Instant) {
        self.counts.packets += 1;
        self.counts.lost += u64::from(self.gap_before(packet, from));
        self.meet(from, at);
        self.arrivals.push_back(at);
        while self.arrivals.len() > MOST_ARRIVALS
            || self.arrivals.front().is_some_and(|first| at.duration_since(*first) > WINDOW)
        {
            self.arrivals.pop_front();
        }
        self.newest = Some(Newest { packet: *packet, from, at });
    }

    /// Counts a datagram or a frame that is not a valid packet.
    pub fn refuse(&mut self, fault: DecodeError) {
        self.counts.refused += 1;
        self.counts.fault = Some(fault);
    }

    /// The newest packet.
    pub fn newest(&self) -> Option<Newest> {
        self.newest
    }

    /// The counts at this time.
    pub fn counts(&self, now: Instant) -> Counts {
        let rival = self.counts.rival.filter(|_| self.rival_at.is_some_and(|at| now.duration_since(at) <= WINDOW));
        Counts { rate_hz: self.rate_hz(now), rival, ..self.counts }
    }

    /// Returns how many packets of this sender are missing before this one.
    fn gap_before(&self, packet: &Packet, from: Sender) -> u16 {
        let last = self.newest.filter(|newest| newest.from == from);
        last.map_or(0, |last| packet.lost_since(&last.packet))
    }

    /// Notes a second sender.
    fn meet(&mut self, from: Sender, at: Instant) {
        let other = self.newest.filter(|newest| newest.from != from && at.duration_since(newest.at) <= WINDOW);
        if let Some(other) = other {
            (self.counts.rival, self.rival_at) = (Some(other.from), Some(at));
        }
    }

    fn rate_hz(&self, now: Instant) -> f64 {
        let (Some(first), Some(last)) = (self.arrivals.front(), self.arrivals.back()) else {
            return 0.0;
        };
        let span_s = last.duration_since(*first).as_secs_f64();
        let is_over = now.saturating_duration_since(*last) > WINDOW;
        if is_over || span_s <= 0.0 { 0.0 } else { (self.arrivals.len() - 1) as f64 / span_s }
    }
}

#[cfg(test)]
mod tests {
    use facewire_packet::State;

    use super::*;

    fn sender(port: u16) -> Sender {
        Sender::Udp(([127, 0, 0, 1], port).into())
    }

    fn packet(sequence: u16) -> Packet {
        Packet { state: State::Live, sequence, ..Packet::NEUTRAL }
    }

    #[test]
    fn a_second_sender_is_named_until_one_of_them_is_silent_for_a_second() {
        let (mut tally, begin) = (Tally::default(), Instant::now());
        tally.count(&packet(10), sender(1), begin);
        assert_eq!(tally.counts(begin).rival, None);
        tally.count(&packet(500), sender(2), begin + Duration::from_millis(10));
        let counts = tally.counts(begin + Duration::from_millis(20));
        assert_eq!((counts.rival, counts.lost), (Some(sender(1)), 0));
        assert_eq!(tally.counts(begin + Duration::from_millis(1020)).rival, None);
    }

    #[test]
    fn the_rate_covers_the_last_second_and_falls_to_0_in_silence() {
        let (mut tally, begin) = (Tally::default(), Instant::now());
        let mut at = begin;
        for sequence in 0..100 {
            at = begin + Duration::from_millis(20) * u32::from(sequence);
            tally.count(&packet(sequence), Sender::Line, at);
        }
        assert!((tally.counts(at).rate_hz - 50.0).abs() < 0.01);
        assert!(tally.counts(at + Duration::from_millis(1001)).rate_hz < 0.01);
    }

    #[test]
    fn a_flood_takes_no_more_memory() {
        let (mut tally, at) = (Tally::default(), Instant::now());
        for sequence in 0..50_000 {
            tally.count(&packet(sequence), Sender::Line, at);
        }
        assert_eq!(tally.arrivals.len(), MOST_ARRIVALS);
    }
}
