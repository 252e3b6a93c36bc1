//! Counts of the packets received so far.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use facewire_packet::{Packet, SILENCE_MS, State};

use super::receiver::Endpoint;
use crate::service::histogram::Histogram;

/// The time over which the rate is measured.
const RATE_WINDOW: Duration = Duration::from_secs(1);

/// Counts, rates and ages of packets, and the newest packet.
pub struct Tally {
    packets: u64,
    lost: u64,
    refused: u64,
    newest: Option<Newest>,
    first: Option<Instant>,
    /// Arrival times within [`RATE_WINDOW`] of the newest packet.
    recent: VecDeque<Instant>,
    /// Ages of live packets; `None` before the first one.
    ages: Option<Histogram>,
}

/// The newest packet.
#[derive(Debug, Clone)]
pub struct Newest {
    /// The packet.
    pub packet: Packet,
    /// The sender.
    pub from: Endpoint,
    /// The time of arrival.
    pub at: Instant,
    /// Number of packets lost just before this one.
    pub lost_before: u16,
}

impl Tally {
    /// Starts with no packet.
    pub fn new() -> Self {
        Self { packets: 0, lost: 0, refused: 0, newest: None, first: None, recent: VecDeque::new(), ages: None }
    }

    /// Counts a valid packet.
    pub fn count(&mut self, packet: &Packet, from: Endpoint, at: Instant) {
        let lost_before = self.gap_before(packet, &from);
        self.packets += 1;
        self.lost += u64::from(lost_before);
        self.first.get_or_insert(at);
        self.recent.push_back(at);
        while self.recent.front().is_some_and(|first| at.duration_since(*first) > RATE_WINDOW) {
            self.recent.pop_front();
        }
        if packet.state == State::Live {
            self.ages.get_or_insert_default().record(Duration::from_micros(packet.age_us.into()));
        }
        self.newest = Some(Newest { packet: *packet, from, at, lost_before });
    }

    /// Returns how many packets of this sender are missing before this one.
    fn gap_before(&self, packet: &Packet, from: &Endpoint) -> u16 {
        let last = self.newest.as_ref().filter(|newest| newest.from == *from);
        last.map_or(0, |last| packet.lost_since(&last.packet))
    }

    /// Counts a datagram or a frame that is not a valid packet.
    pub fn refuse(&mut self) {
        self.refused += 1;
    }

    /// The number of valid packets.
    pub fn packets(&self) -> u64 {
        self.packets
    }

    /// The number of packets missing in the sequence.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// The number of datagrams and frames that were not valid packets.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The newest packet.
    pub fn newest(&self) -> Option<&Newest> {
        self.newest.as_ref()
    }

    /// Time since the newest packet, if receivers go neutral after it.
    pub fn silence(&self, now: Instant) -> Option<Duration> {
        let since = now.saturating_duration_since(self.newest.as_ref()?.at);
        (since > Duration::from_millis(SILENCE_MS.into())).then_some(since)
    }

    /// Packets per second, over the last second.
    pub fn rate_hz(&self) -> f64 {
        let (Some(first), Some(last)) = (self.recent.front(), self.recent.back()) else {
            return 0.0;
        };
        rate(self.recent.len() as u64, last.duration_since(*first))
    }

    /// Summarises everything in one line.
    pub fn summary(&self) -> String {
        let (Some(first), Some(newest)) = (self.first, &self.newest) else {
            return "no packets".to_owned();
        };
        let span = newest.at.duration_since(first);
        let ages = self.ages.as_ref().map_or_else(String::new, |ages| {
            let [p50, p95] = ages.quantiles_ms([0.5, 0.95]);
            format!("; age of live packets p50 {p50:.1} ms, p95 {p95:.1} ms")
        });
        format!(
            "{} packets in {:.1} s ({:.1} a second), {} lost, {} refused{ages}",
            self.packets,
            span.as_secs_f64(),
            rate(self.packets, span),
            self.lost,
            self.refused
        )
    }
}

/// Returns the rate of `count` events, of which the first and the last are `span` apart.
#[expect(clippy::cast_precision_loss, reason = "a count of packets")]
fn rate(count: u64, span: Duration) -> f64 {
    let seconds = span.as_secs_f64();
    if seconds > 0.0 { count.saturating_sub(1) as f64 / seconds } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use std::net::{Ipv4Addr, SocketAddr};

    use super::*;

    const A: Endpoint = Endpoint::Udp(SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 1));
    const B: Endpoint = Endpoint::Udp(SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 2));

    fn packet(sequence: u16) -> Packet {
        Packet { state: State::Live, sequence, age_us: 20_000, ..Packet::NEUTRAL }
    }

    #[test]
    fn two_senders_do_not_count_as_losses_of_each_other() {
        let mut tally = Tally::new();
        tally.count(&packet(10), A, Instant::now());
        tally.count(&packet(500), B, Instant::now());
        assert_eq!(tally.lost(), 0);
    }

    #[test]
    fn the_rate_covers_the_last_second() {
        let mut tally = Tally::new();
        let begin = Instant::now();
        for sequence in 0..100_u16 {
            tally.count(&packet(sequence), A, begin + Duration::from_millis(20) * sequence.into());
        }
        assert!((tally.rate_hz() - 50.0).abs() < 0.01, "{}", tally.rate_hz());
    }

    #[test]
    fn silence_is_reported_after_500_ms() {
        let mut tally = Tally::new();
        let begin = Instant::now();
        assert_eq!(tally.silence(begin), None, "before the first packet the monitor waits");
        tally.count(&packet(0), A, begin);
        assert_eq!(tally.silence(begin + Duration::from_millis(500)), None);
        let longer = Duration::from_millis(501);
        assert_eq!(tally.silence(begin + longer), Some(longer));
    }

    #[test]
    fn the_summary_shows_counts_rate_and_ages() {
        let mut tally = Tally::new();
        let begin = Instant::now();
        for sequence in 0..31_u16 {
            tally.count(&packet(sequence), A, begin + Duration::from_millis(100) * sequence.into());
        }
        tally.refuse();
        let want = "31 packets in 3.0 s (10.0 a second), 0 lost, 1 refused; \
                    age of live packets p50 20.4 ms, p95 20.4 ms";
        // Reported ages are up to 3.2 % too long.
        assert_eq!(tally.summary(), want);
    }
}
