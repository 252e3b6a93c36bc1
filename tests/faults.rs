//! What receivers see, in real time, if the face is lost, or if the camera or an inference fails.
//!
//! `src/service/failsafe/` tests the times of the failsafe to the microsecond, in simulated time. Here they are lower
//! bounds, and states may be passed over, since the machine may be busy.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::thread::sleep;
use std::time::Duration;

use common::eventually;
use common::service::{DEMO, Receiver, Service, counted};
use common::slew::assert_slew;
use common::stuck::Stuck;
use facewire_packet::{Packet, Reason, State};

/// The states during a fault in their order, each with the least age of the last good pose at its beginning, microseconds.
const STATES: [(State, u32); 3] = [(State::Hold, 150_000), (State::Decay, 300_000), (State::Neutral, 1_000_000)];

fn is_neutral_by(reason: Reason) -> impl Fn(&Packet) -> bool {
    move |packet| (packet.state, packet.reason) == (State::Neutral, reason)
}

/// Returns the packets between two live ones in which the face first becomes neutral for this reason. A busy machine may hold
/// the face briefly before and after, or make it neutral because frames come late.
fn lasting_fault(packets: &[Packet], reason: Reason) -> Vec<&Packet> {
    let neutral = packets.iter().position(is_neutral_by(reason)).unwrap();
    let is_live = |packet: &Packet| packet.state == State::Live;
    let begin = packets[..neutral].iter().rposition(is_live).map_or(0, |live| live + 1);
    packets[begin..].iter().take_while(|packet| !is_live(packet)).collect()
}

/// Checks the packets of a fault and around it: states, times, reason, and that no step exceeds the slew limit.
fn assert_failsafe(packets: &[Packet], reason: Reason) {
    packets.windows(2).for_each(|pair| assert_slew(&pair[0], &pair[1]));
    assert!(packets.windows(2).all(|pair| pair[1].sequence == pair[0].sequence.wrapping_add(1)));
    let faulty = lasting_fault(packets, reason);
    let place = |packet: &&Packet| STATES.iter().position(|(state, _)| *state == packet.state).unwrap();
    assert!(faulty.is_sorted_by_key(place), "{faulty:?}");
    for packet in &faulty {
        let (_, earliest_us) = STATES[place(packet)];
        assert!(packet.age_us >= earliest_us, "{packet:?}");
        let is_at_rest = packet.coefficients.iter().all(|value| *value == 0.0);
        assert!(is_at_rest || packet.state != State::Neutral, "{packet:?}");
    }
}

/// Plays the clip for 2 s and this scene for 3 s, again and again, and checks the packets through the first such fault. On a
/// busy machine, a late frame may give the end of the fault another reason.
fn assert_rehearsed(scene: &str, reason: Reason, more: &str) {
    let toml = format!("{more}[camera]\ndevice = \"rehearsal: live 2, {scene} 3\"\nstall_timeout_ms = 500\n");
    let (_service, receiver) = Service::live(&toml);
    let packets = receiver.until(is_neutral_by(reason));
    assert_failsafe(&through(packets, &receiver), reason);
}

fn through(mut packets: Vec<Packet>, receiver: &Receiver) -> Vec<Packet> {
    packets.extend(receiver.live());
    packets.extend((0..4).map(|_| receiver.packet()));
    packets
}

#[test]
fn a_lost_face_holds_decays_is_neutral_and_comes_back_by_a_ramp() {
    for method in ["network", "paper"] {
        assert_rehearsed("no-face", Reason::NoFace, &format!("[solver]\nmethod = \"{method}\"\n"));
    }
}

#[test]
fn a_camera_that_is_gone_holds_decays_is_neutral_and_comes_back_by_a_ramp() {
    assert_rehearsed("gone", Reason::NoCamera, "");
}

#[test]
fn a_silent_camera_holds_decays_is_neutral_and_comes_back_by_a_ramp() {
    assert_rehearsed("silent", Reason::NoCamera, "");
}

#[test]
fn a_camera_with_damaged_frames_only_is_none_and_comes_back_by_a_ramp() {
    assert_rehearsed("damaged", Reason::NoCamera, "");
}

/// The service opens such a camera again and again, says so once, and counts every damaged frame.
#[test]
fn a_camera_that_never_shows_anything_is_told_once_and_its_frames_are_counted() {
    let (service, receiver) = Service::with_receiver("[camera]\ndevice = \"rehearsal: damaged 3600\"\n");
    receiver.packet();
    // Eight of them for each time that the camera is opened.
    eventually("damaged frames", || counted(&service.status(), "damaged") > 16);
    for packet in receiver.rest() {
        assert_eq!((packet.state, packet.reason), (State::Neutral, Reason::NoCamera));
    }
    let log = service.stopped();
    assert_eq!(counted(&log, "cameras_opened"), 0, "{log}");
    assert_eq!(log.matches("no camera: 8 frames in a row were bad").count(), 1, "{log}");
    assert!(!log.contains("camera opened"), "{log}");
}

/// The thread that runs inferences is stopped while the sender runs on.
#[test]
fn a_stuck_inference_holds_decays_is_neutral_and_comes_back_by_a_ramp() {
    let (mut service, receiver) = Service::live(DEMO);
    let stuck = Stuck::stop(service.thread("fw-hot"));
    let packets = receiver.until(is_neutral_by(Reason::Late));
    drop(stuck);
    assert_failsafe(&through(packets, &receiver), Reason::Late);
}

/// Each stop takes three frame periods, and not every stop hits the work on a frame.
#[test]
fn work_that_takes_longer_than_a_frame_period_is_a_missed_deadline() {
    let (mut service, _receiver) = Service::live(DEMO);
    let hot = service.thread("fw-hot");
    eventually("a missed deadline", || {
        let stuck = Stuck::computing(hot);
        sleep(Duration::from_millis(100));
        drop(stuck);
        counted(&service.status(), "deadline_misses") > 0
    });
}
