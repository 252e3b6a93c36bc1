//! A board that is too slow, hot or badly supplied, as receivers and operators see it.
//!
//! `src/service/adaptation/tests.rs` tests the choice of the step over minutes and days, where time is a number. Here the
//! camera of a rehearsal takes its time, and packets are judged by the times of capture that they carry.
//! `FACEWIRE_OVERLOAD_MINUTES=10 cargo test --release --test overload -- --nocapture overload_of` runs each overload for ten
//! minutes, on an idle machine, and prints what it has seen.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::thread::sleep;
use std::time::{Duration, Instant};

use common::service::{Receiver, Service, counted};
use facewire_packet::{Packet, State};
use rustix::process::Signal;
use tempfile::NamedTempFile;

/// Frame period of the built-in clip, microseconds.
const PERIOD_US: u32 = 33_333;
/// Longer than any step takes to be chosen on a busy machine.
const PATIENCE: Duration = Duration::from_mins(1);
/// Number of captured frames that are judged.
const FRAMES: usize = 12;

/// A service with its receiver and its log.
struct Overload {
    service: Service,
    receiver: Receiver,
    log: NamedTempFile,
}

impl Overload {
    fn start(scenes: &str, more: &str) -> Self {
        let (receiver, log) = (Receiver::new(), NamedTempFile::new().unwrap());
        let settings = format!("[camera]\ndevice = \"rehearsal: {scenes}\"\n{more}");
        let service = Service::start_logging_to(&settings, &[receiver.address()], log.reopen().unwrap().into());
        Self { service, receiver, log }
    }

    fn log(&self) -> String {
        fs::read_to_string(self.log.path()).unwrap()
    }

    /// Waits until the log has this text. The packets of that time are lost.
    fn logged(&self, text: &str) {
        let begun = Instant::now();
        while !self.log().contains(text) {
            assert!(begun.elapsed() < PATIENCE, "no {text}: {}", self.log());
            sleep(Duration::from_millis(50));
        }
        self.receiver.rest();
    }

    /// Stops the service and returns its log.
    fn stop(self) -> String {
        self.service.stop(Signal::TERM).0.succeeded();
        fs::read_to_string(self.log.path()).unwrap()
    }

    /// Of how many frames of the camera the service processes one, by the last change in its log.
    fn every(&self) -> u32 {
        let every = |line: &str| line.split_once(": one frame in ")?.1.split(' ').next()?.parse().ok();
        self.log().lines().rfind(|line| line.contains(" step ")).and_then(every).unwrap_or(1)
    }

    /// Receives packets until the last [`FRAMES`] frames came at the intervals of the present step, apart from one in four
    /// that a busy machine has delayed. Returns the packets of these frames and the interval, in frames of the camera.
    fn settled(&self) -> (Vec<Packet>, u32) {
        let (begun, mut packets) = (Instant::now(), Vec::new());
        loop {
            packets.push(self.receiver.packet());
            let (gaps, every) = (gaps(&packets), self.every());
            let last = &gaps[gaps.len().saturating_sub(FRAMES)..];
            let even = last.iter().filter(|gap| **gap == every).count();
            if last.len() == FRAMES && even * 4 >= FRAMES * 3 {
                let span_us = last.iter().sum::<u32>() * PERIOD_US;
                let end_us = packets[packets.len() - 1].capture_us;
                packets.retain(|packet| end_us.wrapping_sub(packet.capture_us) < span_us);
                return (packets, every);
            }
            assert!(begun.elapsed() < PATIENCE, "not every {every} frames: {gaps:?}");
        }
    }
}

/// Times between the captures of the live packets' frames, as numbers of the camera's frames.
fn gaps(packets: &[Packet]) -> Vec<u32> {
    let mut captures: Vec<u32> =
        packets.iter().filter(|packet| packet.state == State::Live).map(|packet| packet.capture_us).collect();
    captures.dedup();
    captures.windows(2).map(|pair| (pair[1].wrapping_sub(pair[0]) + PERIOD_US / 2) / PERIOD_US).collect()
}

/// Plays a decoding of so many frame periods. The step that fits takes every `every`th frame; a busy machine may need a
/// lower one.
fn assert_overload(scene: &str, every: u32) {
    let overload = Overload::start(&format!("{scene} 3600"), "");
    overload.logged(" is processed, because a frame takes ");
    let (packets, settled_on) = overload.settled();
    assert!(settled_on >= every, "every {settled_on}: {}", overload.log());
    assert_live(&packets, settled_on);
    if let Ok(minutes) = std::env::var("FACEWIRE_OVERLOAD_MINUTES") {
        run_for(Duration::from_mins(1) * minutes.parse().unwrap(), &overload.receiver, every, scene);
        let changes = overload.log().matches(" step ").count();
        assert_eq!(changes, 1, "the step has changed {changes} times");
    }
    let log = overload.stop();
    assert!(log.contains(" step_by=slow step_changes="), "{log}");
    assert!(counted(&log, "left_out") > 0, "{log}");
}

/// Asserts that no live packet is older than three periods of the step.
fn assert_live(packets: &[Packet], every: u32) -> u32 {
    let live = || packets.iter().filter(|packet| packet.state == State::Live);
    let oldest_us = live().map(|packet| packet.age_us).max().unwrap();
    assert!(oldest_us < 3 * every * PERIOD_US, "{oldest_us} us old");
    oldest_us
}

/// Judges the packets of a longer time: all are live, and frames come evenly.
fn run_for(duration: Duration, receiver: &Receiver, every: u32, scene: &str) {
    let (begun, mut packets) = (Instant::now(), Vec::new());
    while begun.elapsed() < duration {
        packets.push(receiver.packet());
    }
    let oldest_us = assert_live(&packets, every);
    let (gaps, lost) = (gaps(&packets), packets.iter().filter(|packet| packet.state != State::Live).count());
    let uneven = gaps.iter().filter(|gap| **gap != every).count();
    println!(
        "{scene}: {} packets and {} frames in {duration:?}; {lost} packets not live; {uneven} intervals other than {every} \
         frames; oldest live packet {} ms, {:.2} periods of the step",
        packets.len(),
        gaps.len() + 1,
        oldest_us / 1000,
        f64::from(oldest_us) / f64::from(every * PERIOD_US)
    );
    assert_eq!(lost, 0);
    assert!(uneven * 100 <= gaps.len(), "{uneven} of {} intervals", gaps.len());
}

#[test]
fn an_overload_of_2_takes_every_third_frame_evenly_and_packets_stay_under_3_of_its_periods() {
    assert_overload("slow-2", 3);
}

#[test]
fn an_overload_of_4_takes_every_sixth_frame_evenly_and_packets_stay_under_3_of_its_periods() {
    assert_overload("slow-4", 6);
}

#[test]
fn an_overload_of_8_takes_every_twelfth_frame_evenly_and_packets_stay_under_3_of_its_periods() {
    assert_overload("slow-8", 12);
}

#[test]
fn after_an_overload_more_frames_are_processed_again() {
    let overload = Overload::start("live 3, slow-4 6, live 3600", "");
    overload.logged("because a frame takes ");
    overload.logged(" is processed again");
    overload.settled();
    overload.stop();
}

#[test]
fn a_hot_board_and_one_with_low_voltage_process_fewer_frames_and_say_why() {
    for (scene, sentence) in [("hot", "the board is so hot"), ("undervoltage", "the supply voltage is too low")] {
        let overload = Overload::start(&format!("{scene} 3600"), "");
        overload.logged(&format!("step half: one frame in 2 is processed, because {sentence}"));
        overload.settled();
        let log = overload.stop();
        assert!(log.contains(&format!("impaired_by={scene} step=")), "{log}");
        assert!(counted(&log, "left_out") > 0, "{log}");
    }
}

#[test]
fn with_adaptation_off_frames_are_skipped_as_they_come() {
    let overload = Overload::start("slow-2 3600", "[adaptation]\nenabled = false\n");
    let packets: Vec<Packet> = (0..40).map(|_| overload.receiver.packet()).collect();
    let gaps = gaps(&packets);
    assert!(gaps.len() > 4 && gaps.iter().all(|gap| *gap >= 2), "{gaps:?}");
    let log = overload.stop();
    assert!(log.contains(" step=full step_by=none step_changes=0 "), "{log}");
    assert!(counted(&log, "left_out") == 0 && counted(&log, "skipped") > 0, "{log}");
}
