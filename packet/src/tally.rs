//! Counts what arrives at a receiver that has a clock and memory: rates, losses, and a second sender.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crate::{DecodeError, Packet, SILENCE_MS};

/// The time over which the rate is measured, and after which a sender that is silent no longer counts.
const WINDOW: Duration = Duration::from_secs(1);
/// The most arrivals that are remembered: a port that is flooded costs no more memory.
const MOST_ARRIVALS: usize = 1024;

/// The newest packet of a [`Tally`].
#[derive(Debug, Clone, Copy)]
pub struct Newest<S> {
    /// The packet.
    pub packet: Packet,
    /// Who sent it.
    pub from: S,
    /// The time of arrival.
    pub at: Instant,
    /// How many packets of the same sender are missing just before it.
    pub lost_before: u16,
}

/// Counts packets of senders that an `S` names, such as an address.
#[derive(Debug, Clone)]
pub struct Tally<S> {
    /// Valid packets.
    pub packets: u64,
    /// Packets missing in the sequences.
    pub lost: u64,
    /// Datagrams and frames that were not valid packets.
    pub refused: u64,
    /// What was wrong with the last refused one.
    pub fault: Option<DecodeError>,
    /// The newest packet.
    pub newest: Option<Newest<S>>,
    arrivals: VecDeque<Instant>,
    /// A second sender, and when packets of both arrived within [`WINDOW`].
    rival: Option<(S, Instant)>,
}

impl<S> Default for Tally<S> {
    fn default() -> Self {
        let arrivals = VecDeque::new();
        Self { packets: 0, lost: 0, refused: 0, fault: None, newest: None, arrivals, rival: None }
    }
}

impl<S: Clone + PartialEq> Tally<S> {
    /// Counts a valid packet.
    pub fn count(&mut self, packet: &Packet, from: S, at: Instant) {
        let mut lost_before = 0;
        match &self.newest {
            // A packet of another sender says nothing about losses.
            Some(last) if last.from == from => lost_before = packet.lost_since(&last.packet),
            Some(other) if at.duration_since(other.at) <= WINDOW => self.rival = Some((other.from.clone(), at)),
            _ => {}
        }
        self.packets += 1;
        self.lost += u64::from(lost_before);
        self.arrivals.push_back(at);
        let is_old = |first: &Instant| at.duration_since(*first) > WINDOW;
        while self.arrivals.len() > MOST_ARRIVALS || self.arrivals.front().is_some_and(is_old) {
            self.arrivals.pop_front();
        }
        self.newest = Some(Newest { packet: *packet, from, at, lost_before });
    }

    /// Counts a datagram or a frame that is not a valid packet.
    pub fn refuse(&mut self, fault: DecodeError) {
        self.refused += 1;
        self.fault = Some(fault);
    }

    /// Packets per second over the last second before the newest packet; 0 in silence.
    pub fn rate_hz(&self, now: Instant) -> f64 {
        let (Some(first), Some(last)) = (self.arrivals.front(), self.arrivals.back()) else { return 0.0 };
        let span_s = last.duration_since(*first).as_secs_f64();
        let is_over = now.saturating_duration_since(*last) > WINDOW;
        if is_over || span_s <= 0.0 { 0.0 } else { (self.arrivals.len() - 1) as f64 / span_s }
    }

    /// A second sender, if packets of two arrived within a second.
    pub fn rival(&self, now: Instant) -> Option<&S> {
        self.rival.as_ref().filter(|(_, at)| now.saturating_duration_since(*at) <= WINDOW).map(|(rival, _)| rival)
    }

    /// Time since the newest packet, if receivers go neutral after it.
    pub fn silence(&self, now: Instant) -> Option<Duration> {
        let since = now.saturating_duration_since(self.newest.as_ref()?.at);
        (since > Duration::from_millis(SILENCE_MS.into())).then_some(since)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn packet(sequence: u16) -> Packet {
        Packet { sequence, ..Packet::NEUTRAL }
    }

    #[test]
    fn a_second_sender_is_named_until_one_is_silent_for_a_second_and_is_no_loss_of_the_other() {
        let (mut tally, begin) = (Tally::default(), Instant::now());
        tally.count(&packet(10), 'a', begin);
        assert_eq!(tally.rival(begin), None);
        tally.count(&packet(500), 'b', begin + 10 * MS);
        assert_eq!((tally.rival(begin + 20 * MS), tally.lost), (Some(&'a'), 0));
        assert_eq!(tally.rival(begin + 1020 * MS), None);
        tally.count(&packet(503), 'b', begin + 1020 * MS);
        assert_eq!(tally.lost, 2);
    }

    #[test]
    fn the_rate_covers_the_last_second_and_falls_to_0_in_silence_which_begins_after_500_ms() {
        let (mut tally, begin) = (Tally::default(), Instant::now());
        assert_eq!(tally.silence(begin), None, "before the first packet a receiver waits");
        for sequence in 0..100 {
            tally.count(&packet(sequence), (), begin + 20 * MS * sequence.into());
        }
        let last = begin + 1980 * MS;
        assert!((tally.rate_hz(last) - 50.0).abs() < 0.01);
        assert!(tally.rate_hz(last + 1001 * MS) < 0.01);
        assert_eq!([500, 501].map(|ms| tally.silence(last + ms * MS)), [None, Some(501 * MS)]);
    }

    #[test]
    fn a_flood_takes_no_more_memory() {
        let (mut tally, at) = (Tally::default(), Instant::now());
        (0..50_000).for_each(|sequence| tally.count(&packet(sequence), (), at));
        assert_eq!(tally.arrivals.len(), 1024);
    }
}
