//! Judges the service second by second, and as a whole at the end.

use std::collections::BTreeSet;
use std::time::Duration;

use facewire_packet::{Reason, State};

use super::common::service::counted;
use super::common::slew::assert_slew;
use super::process::{Arrival, Sample};

/// Longest time between two packets, apart from the time in which the sender waits for a processor. A neutral face is sent
/// 10 times a second.
const LONGEST_PAUSE: Duration = Duration::from_secs(1);
/// Of this many judged seconds, one may show minor page faults, because the kernel may move a page of its own accord.
const SECONDS_PER_FAULT: usize = 3600;
/// The states, each with its reason, that must have been seen by the end.
const WANTED: [&str; 4] = ["Live/None", "Hold/Late", "Neutral/NoFace", "Neutral/NoCamera"];
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
    /// The judged seconds with minor page faults.
    faulted_s: usize,
}

impl Judge {
    /// Judges the packets of a second and the state of the process at its end. A change of the settings may have been taken in
    /// this second.
    pub fn interval(&mut self, packets: Vec<Arrival>, sample: Sample, is_changed: bool) {
        // These packets stem from frames, with or without a face.
        let is_of_frame = |(_, packet): &Arrival| matches!(packet.reason, Reason::None | Reason::NoFace);
        // On a busy machine, a frame may come late. A camera that is lost is told by another reason.
        let is_late = |(_, packet): &Arrival| packet.reason == Reason::Late;
        let flows =
            packets.iter().any(is_of_frame) && packets.iter().all(|arrival| is_of_frame(arrival) || is_late(arrival));
        // The last pause may have begun in the second before.
        let before = self.samples.iter().rev().nth(1).map_or(Duration::ZERO, |earlier| earlier.starved);
        let longest_pause = LONGEST_PAUSE + (sample.starved - before);
        for arrival in packets {
            self.packet(arrival, longest_pause);
        }
        self.flowing_s = if flows && !is_changed { self.flowing_s + 1 } else { 0 };
        self.samples.push(sample);
        if self.flowing_s >= SURROUNDINGS_S && self.samples.len() > WARM_UP_S {
            self.assert_still();
        }
    }

    /// Checks that frames allocate nothing and fault no page, in the second before the last. In the first second of flowing
    /// frames a camera may have been opened, and at the end of the last second the camera may have been lost, which packets
    /// show only later. New settings may cost something when they take effect, in the second in which the log says so or in the
    /// next.
    fn assert_still(&mut self) {
        let second = self.samples.len() - 1;
        let [.., before, after, _] = &self.samples[..] else { return };
        assert_eq!(after.allocations, before.allocations, "frames allocate, in second {second}");
        assert_eq!(after.major_faults, before.major_faults, "frames fault pages on a disk, in second {second}");
        self.judged_s += 1;
        self.faulted_s += usize::from(after.minor_faults != before.minor_faults);
    }

    /// Whether frames flowed for long enough, and every state has come.
    pub fn has_seen_all(&self) -> bool {
        self.judged_s > 0 && self.missing().is_empty()
    }

    /// The states and reasons that have not come yet.
    pub fn missing(&self) -> Vec<&str> {
        WANTED.into_iter().filter(|wanted| !self.seen.contains(*wanted)).collect()
    }

    fn packet(&mut self, (at, packet): Arrival, longest_pause: Duration) {
        self.packets += 1;
        self.seen.insert(format!("{:?}/{:?}", packet.state, packet.reason));
        assert_eq!(packet.state == State::Live, packet.reason == Reason::None, "{packet:?}");
        if let Some((last_at, last)) = self.last.replace((at, packet)) {
            assert_eq!(packet.sequence, last.sequence.wrapping_add(1), "a packet is missing");
            // The system's clock may be set back.
            let pause = at.saturating_sub(last_at);
            assert!(pause < longest_pause, "{pause:?} without a packet, after {} s", self.samples.len());
            self.longest_pause = self.longest_pause.max(pause);
            assert_slew(&last, &packet);
        }
    }

    /// Judges the last packets, the log with the service's own counts, and the memory over the whole run.
    pub fn end(&mut self, packets: Vec<Arrival>, log: &str) {
        for arrival in packets {
            self.packet(arrival, Duration::MAX);
        }
        let (_, last) = self.last.unwrap();
        assert_eq!((last.state, last.reason), (State::Neutral, Reason::Stopping));
        for unwanted in ["panicked", "settings refused", "another program", "not closed it yet"] {
            assert!(!log.contains(unwanted), "{unwanted}: {log}");
        }
        let reloads = log.matches("settings changed").count() as u64;
        assert!(reloads > 0, "{log}");
        // Every link sends what this one receives, and a link that a reload opens sends one packet at once besides.
        let count = |name: &str| counted(log, name);
        let all = LINKS * self.packets;
        assert!((all..=all + LINKS * reloads).contains(&count("packets")), "{} received: {log}", self.packets);
        assert_eq!(count("faces") + count("no_face") + count("rejected"), count("frames"), "{log}");
        assert_eq!(count("sent") + count("dropped"), count("packets"), "{log}");
        self.assert_memory();
        let allowed_s = 1 + self.judged_s / SECONDS_PER_FAULT;
        assert!(self.faulted_s <= allowed_s, "frames fault pages, in {} of {} seconds", self.faulted_s, self.judged_s);
    }

    /// The largest number of descriptors that the service had open in the first third of the run.
    pub fn descriptors_at_first(&self) -> usize {
        let (first, _) = self.thirds();
        first.iter().map(|sample| sample.descriptors).max().unwrap()
    }

    /// The samples of the first and of the last third of what is judged.
    fn thirds(&self) -> (&[Sample], &[Sample]) {
        let judged = &self.samples[WARM_UP_S..];
        let third = judged.len() / 3;
        (&judged[..third], &judged[judged.len() - third..])
    }

    fn assert_memory(&self) {
        let (first, last) = self.thirds();
        let between = last[0].at - first[0].at;
        let growth_kib = median_kib(last) - median_kib(first);
        let allowed_kib = RESIDENT_NOISE_KIB.max(RESIDENT_KIB_PER_H * between.as_secs_f64() / 3600.0);
        assert!(growth_kib <= allowed_kib, "memory grew by {growth_kib} KiB in {between:?}");
        println!("{} packets, longest pause {:?}, growth {growth_kib:.0} KiB", self.packets, self.longest_pause);
    }
}

fn median_kib(samples: &[Sample]) -> f64 {
    let mut kib: Vec<usize> = samples.iter().map(|sample| sample.resident_kib).collect();
    kib.sort_unstable();
    kib[kib.len() / 2] as f64
}
