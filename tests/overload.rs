//! A board that is too slow, hot or badly supplied, as receivers and operators see it.
//!
//! `src/service/adaptation/tests.rs` tests the choice of the step over minutes and days of simulated time, and
//! `src/service/timing.rs` tests that a step takes frames evenly. Here the camera of a rehearsal takes real time. Packets are
//! judged by their times of capture, which show how many frames were left out, however busy the machine is.
//! `FACEWIRE_OVERLOAD_MINUTES=10 cargo test --release --test overload -- --nocapture overload_of` runs each overload for ten
//! minutes, on an idle machine, and prints what it has seen.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::thread;
use std::time::{Duration, Instant};

use common::service::{Receiver, Service, counted};
use common::{PATIENCE, eventually};
use facewire_packet::{Packet, State};

const PERIOD_US: u32 = 33_333;
const FRAMES: usize = 12;

struct Overload {
    service: Service,
    receiver: Receiver,
}

impl Overload {
    fn start(scenes: &str, more: &str) -> Self {
        let (service, receiver) =
            Service::with_receiver(&format!("[camera]\ndevice = \"rehearsal: {scenes}\"\n{more}"));
        Self { service, receiver }
    }

    /// Waits until the log has this text. The packets of that time are lost.
    fn logged(&self, text: &str) {
        self.service.await_log(text);
        self.receiver.rest();
    }

    /// The service processes one in so many frames of the camera, by the last change in its log.
    fn every(&self) -> u32 {
        let every = |line: &str| line.split_once(": one frame in ")?.1.split(' ').next()?.parse().ok();
        self.service.log().lines().rfind(|line| line.contains(" step ")).and_then(every).unwrap_or(1)
    }

    /// Receives packets until none of the last [`FRAMES`] frames came sooner than the present step allows. A busy machine
    /// may delay frames. Returns the interval of the step, in frames of the camera.
    fn settled(&self) -> u32 {
        let begun = Instant::now();
        let mut packets = Vec::new();
        loop {
            packets.push(self.receiver.packet());
            let gaps = gaps(&packets);
            let every = self.every();
            let last = &gaps[gaps.len().saturating_sub(FRAMES)..];
            if last.len() == FRAMES && last.iter().all(|gap| *gap >= every) {
                return every;
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

/// For how long each overload runs on an idle machine, if its figures are wanted.
fn minutes() -> Option<u32> {
    Some(std::env::var("FACEWIRE_OVERLOAD_MINUTES").ok()?.parse().unwrap())
}

/// Plays a scene in which decoding takes several frame periods. The step that fits takes every `every`th frame; a busy
/// machine may need a step that takes fewer.
fn assert_overload(scene: &str, every: u32) {
    let overload = Overload::start(&format!("{scene} 3600"), "");
    overload.logged(" is processed, because a frame takes ");
    let settled_on = overload.settled();
    assert!(settled_on >= every, "every {settled_on}: {}", overload.service.log());
    if let Some(minutes) = minutes() {
        let begun = Instant::now();
        let mut packets = Vec::new();
        while begun.elapsed() < Duration::from_mins(1) * minutes {
            packets.push(overload.receiver.packet());
        }
        let live = packets.iter().filter(|packet| packet.state == State::Live);
        let oldest_us = live.clone().map(|packet| packet.age_us).max().unwrap();
        let oldest = f64::from(oldest_us) / f64::from(every * PERIOD_US);
        let lost = packets.len() - live.count();
        let gaps = gaps(&packets);
        let uneven = gaps.iter().filter(|gap| **gap != every).count();
        let changes = overload.service.log().matches(" step ").count();
        println!(
            "{scene}: {uneven} of {} intervals uneven, oldest packet {oldest:.2} intervals of the step",
            gaps.len()
        );
        assert!(oldest < 3.0, "{oldest_us} us old");
        assert!((lost, changes) == (0, 1) && uneven * 100 <= gaps.len(), "{lost} not live, {changes} changes");
    }
    let log = overload.service.stopped();
    assert!(log.contains(" step_by=slow step_changes="), "{log}");
    assert!(counted(&log, "left_out") > 0, "{log}");
}

/// The camera waits instead of computing, so that three services can run side by side.
#[test]
fn an_overload_of_2_4_and_8_takes_no_more_frames_than_the_step_that_fits_wants() {
    thread::scope(|scope| {
        for (scene, every) in [("slow-2", 3), ("slow-4", 6), ("slow-8", 12)] {
            let running = scope.spawn(move || assert_overload(scene, every));
            if minutes().is_some() {
                running.join().unwrap();
            }
        }
    });
}

#[test]
fn after_an_overload_more_frames_are_processed_again() {
    let overload = Overload::start("live 3, slow-4 6, live 3600", "");
    overload.logged("because a frame takes ");
    let begun = Instant::now();
    let mut every = overload.every();
    let mut slowest = every;
    // A step up follows 10 s of calm, which begin anew with each disturbance. A busy machine may not reach the full step.
    while every >= slowest {
        assert!(begun.elapsed() < PATIENCE, "not more frames: {}", overload.service.log());
        slowest = every;
        thread::sleep(Duration::from_millis(20));
        every = overload.every();
    }
    overload.receiver.rest();
    overload.settled();
    overload.service.stopped();
}

#[test]
fn a_hot_board_and_one_with_low_voltage_process_fewer_frames_and_say_why() {
    for (scene, sentence) in [("hot", "the board is so hot"), ("undervoltage", "the supply voltage is too low")] {
        let overload = Overload::start(&format!("{scene} 3600"), "");
        overload.logged(&format!("step half: one frame in 2 is processed, because {sentence}"));
        overload.settled();
        let log = overload.service.stopped();
        assert!(log.contains(&format!("impaired_by={scene} step=")), "{log}");
        assert!(counted(&log, "left_out") > 0, "{log}");
    }
}

#[test]
fn with_adaptation_off_frames_are_skipped_as_they_come() {
    let overload = Overload::start("slow-2 3600", "[adaptation]\nenabled = false\n");
    let mut packets = Vec::new();
    eventually("frames", || {
        packets.push(overload.receiver.packet());
        gaps(&packets).len() > 4
    });
    let gaps = gaps(&packets);
    assert!(gaps.iter().all(|gap| *gap >= 2), "{gaps:?}");
    let log = overload.service.stopped();
    assert!(log.contains(" step=full step_by=none step_changes=0 "), "{log}");
    assert!(counted(&log, "left_out") == 0 && counted(&log, "skipped") > 0, "{log}");
}
