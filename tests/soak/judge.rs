//! Judges the service second by second, and as a whole at the end.

use std::collections::BTreeSet;
use std::fmt;
use std::time::Duration;

use facewire_packet::{Packet, Reason, State};

use super::common::slew::assert_slew;
use super::process::{Arrival, Sample};

/// Longest time between two packets. A neutral face is sent 10 times a second; a busy machine may be later.
const LONGEST_PAUSE: Duration = Duration::from_secs(1);
/// A serial port, a receiver with faults, and a receiver without.
const LINKS: u64 = 3;
/// Seconds at the beginning that are not judged, because networks load and caches fill.
const WARM_UP_S: usize = 20;
/// Frames must flow for this many seconds before one of these seconds is judged.
const SURROUNDINGS_S: usize = 3;
/// Growth of the resident memory that a short run may show: the heap grows once by the buffers of a camera (600 KiB) if
/// their former place is taken when the camera is opened again. Over hours the limit is 1 MiB an hour.
const RESIDENT_NOISE_KIB: f64 = 1024.0;
const RESIDENT_KIB_PER_H: f64 = 1024.0;

/// The observations so far.
#[derive(Default)]
pub struct Judge {
    last: Option<Arrival>,
    packets: u64,
    longest_pause: Duration,
    seen: BTreeSet<String>,
    samples: Vec<Sample>,
    /// For how many seconds frames have flowed under the same settings.
    flowing_s: usize,
    judged_s: usize,
    growth_kib: f64,
}

impl Judge {
    /// Judges the packets of a second and the state of the process at its end. The settings may have changed at its beginning.
    pub fn interval(&mut self, packets: Vec<Arrival>, sample: Sample, is_changed: bool) {
        let flows = !packets.is_empty() && packets.iter().all(|(_, packet)| flows(packet));
        for arrival in packets {
            self.packet(arrival);
        }
        self.flowing_s = if flows && !is_changed { self.flowing_s + 1 } else { 0 };
        self.samples.push(sample);
        if self.flowing_s >= SURROUNDINGS_S && self.samples.len() > WARM_UP_S {
            self.assert_still();
        }
    }

    /// Checks that frames allocate nothing and fault no page, in the second before the last. In the first second of flowing
    /// frames a camera may have been opened, and at the end of the last second the camera may have been lost, which packets
    /// show only later. New settings may cost something when they take effect, in the second of the change or in the next.
    fn assert_still(&mut self) {
        let second = self.samples.len() - 1;
        let [.., before, after, _] = &self.samples[..] else { return };
        assert_eq!(after.allocations, before.allocations, "frames allocate, in second {second}");
        assert_eq!(after.page_faults, before.page_faults, "frames fault pages, in second {second}");
        self.judged_s += 1;
    }

    fn packet(&mut self, (at, packet): Arrival) {
        self.packets += 1;
        self.seen.insert(format!("{:?}/{:?}", packet.state, packet.reason));
        assert_eq!(packet.state == State::Live, packet.reason == Reason::None, "{packet:?}");
        if let Some((last_at, last)) = self.last.replace((at, packet)) {
            assert_eq!(packet.sequence, last.sequence.wrapping_add(1), "a packet is missing");
            let pause = at - last_at;
            assert!(pause < LONGEST_PAUSE, "{pause:?} without a packet, after {} s", self.samples.len());
            self.longest_pause = self.longest_pause.max(pause);
            assert_slew(&last, &packet);
        }
    }

    /// Judges the last packets, the log with the service's own counts, and the memory over the whole run.
    pub fn end(&mut self, packets: Vec<Arrival>, log: &str) {
        for arrival in packets {
            self.packet(arrival);
        }
        let (_, last) = self.last.unwrap();
        assert_eq!((last.state, last.reason), (State::Neutral, Reason::Stopping));
        for unwanted in ["panicked", "settings refused", "another program", "not closed it yet"] {
            assert!(!log.contains(unwanted), "{unwanted}: {log}");
        }
        let reloads = log.matches("settings changed").count();
        assert!(reloads > 0, "{log}");
        self.assert_counts(log.lines().last().unwrap(), reloads as u64);
        self.assert_memory();
        for wanted in ["Live/None", "Hold/Late", "Neutral/NoFace", "Neutral/NoCamera"] {
            assert!(self.seen.contains(wanted), "{wanted} never came: {:?}", self.seen);
        }
        assert!(self.judged_s > 0, "frames never flowed for long enough to be judged");
    }

    /// Checks that the counters of the last line add up. Every link sends what this one receives, and a link that a reload
    /// opens sends one packet at once besides.
    fn assert_counts(&self, line: &str, reloads: u64) {
        let count = |name: &str| -> u64 {
            let value = line.split_whitespace().find_map(|pair| pair.strip_prefix(name)?.strip_prefix('='));
            value.and_then(|value| value.parse().ok()).unwrap_or_else(|| panic!("no {name} in {line}"))
        };
        let all = LINKS * self.packets;
        assert!((all..=all + LINKS * reloads).contains(&count("packets")), "{} received, {line}", self.packets);
        assert_eq!(count("faces") + count("no_face") + count("rejected"), count("frames"), "{line}");
        assert_eq!(count("sent") + count("dropped"), count("packets"), "{line}");
    }

    /// Checks that memory and descriptors have not grown.
    fn assert_memory(&mut self) {
        let judged = &self.samples[WARM_UP_S..];
        let third = judged.len() / 3;
        let (first, last) = (&judged[..third], &judged[judged.len() - third..]);
        let most = |samples: &[Sample]| samples.iter().map(|sample| sample.descriptors).max().unwrap();
        assert!(most(last) <= most(first), "descriptors: {} at first, {} at last", most(first), most(last));
        let between = last[0].at - first[0].at;
        self.growth_kib = median_kib(last) - median_kib(first);
        let allowed_kib = RESIDENT_NOISE_KIB.max(RESIDENT_KIB_PER_H * between.as_secs_f64() / 3600.0);
        assert!(self.growth_kib <= allowed_kib, "memory grew by {} KiB in {between:?}", self.growth_kib);
    }
}

impl fmt::Display for Judge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (first, last) = (&self.samples[0], &self.samples[self.samples.len() - 1]);
        write!(
            f,
            "{} packets in {:.0} s, longest pause {:.0} ms; resident {} KiB, growth between first and last third \
             {:.0} KiB; {} descriptors; allocations and page faults judged in {} s; seen {:?}",
            self.packets,
            (last.at - first.at).as_secs_f64(),
            self.longest_pause.as_secs_f64() * 1000.0,
            last.resident_kib,
            self.growth_kib,
            last.descriptors,
            self.judged_s,
            self.seen
        )
    }
}

/// Whether the packet stems from a frame, with or without a face.
fn flows(packet: &Packet) -> bool {
    matches!(packet.reason, Reason::None | Reason::NoFace)
}

fn median_kib(samples: &[Sample]) -> f64 {
    let mut kib: Vec<u64> = samples.iter().map(|sample| sample.resident_kib).collect();
    kib.sort_unstable();
    kib[kib.len() / 2] as f64
}
