//! What the monitor counts besides: the ages of live packets, for the summary.

use std::time::{Duration, Instant};

use facewire::service::histogram::Histogram;
use facewire_packet::{Packet, State};

use super::receiver::Endpoint;

pub type Newest = facewire_packet::Newest<Endpoint>;

/// The tally of all packets, and what the summary shows.
#[derive(Default)]
pub struct Tally {
    pub packets: facewire_packet::Tally<Endpoint>,
    first: Option<Instant>,
    /// `None` before the first live packet.
    ages: Option<Histogram>,
}

impl Tally {
    /// Counts a valid packet.
    pub fn count(&mut self, packet: &Packet, from: Endpoint, at: Instant) {
        self.packets.count(packet, from, at);
        self.first.get_or_insert(at);
        if packet.state == State::Live {
            self.ages.get_or_insert_default().record(Duration::from_micros(packet.age_us.into()));
        }
    }

    /// Summarises everything in one line.
    pub fn summary(&self) -> String {
        let (Some(first), Some(newest)) = (self.first, &self.packets.newest) else {
            return "no packets".to_owned();
        };
        let facewire_packet::Tally { packets, lost, refused, .. } = self.packets;
        let span_s = newest.at.duration_since(first).as_secs_f64();
        let rate_hz = if span_s > 0.0 { packets.saturating_sub(1) as f64 / span_s } else { 0.0 };
        let ages = self.ages.as_ref().map_or_else(String::new, |ages| {
            let [p50, p95] = ages.quantiles_ms([0.5, 0.95]);
            format!("; age of live packets p50 {p50:.1} ms, p95 {p95:.1} ms")
        });
        format!("{packets} packets in {span_s:.1} s ({rate_hz:.1} a second), {lost} lost, {refused} refused{ages}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_summary_shows_counts_rate_and_ages() {
        let (mut tally, begin) = (Tally::default(), Instant::now());
        for sequence in 0..31_u16 {
            let packet = Packet { state: State::Live, sequence, age_us: 20_000, ..Packet::NEUTRAL };
            let from = Endpoint::Udp(([127, 0, 0, 1], 1).into());
            tally.count(&packet, from, begin + Duration::from_millis(100) * sequence.into());
        }
        tally.packets.refuse(facewire_packet::DecodeError::Checksum);
        // Reported ages are up to 3.2 % too long.
        let want = "31 packets in 3.0 s (10.0 a second), 0 lost, 1 refused; \
                    age of live packets p50 20.4 ms, p95 20.4 ms";
        assert_eq!(tally.summary(), want);
    }
}
