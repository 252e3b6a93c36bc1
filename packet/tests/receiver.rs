//! The receiver shows the newest packet, goes neutral when packets stop, and never jumps.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::float_cmp)]

use facewire_packet::{Face, Packet, Receiver, State};

/// The times that the rule of receivers promises, written again, so that no other time passes.
const SILENCE_MS: u32 = 500;
const LATE_MS: u32 = 250;
const TRAVEL_MS: u16 = 500;
/// jawOpen.
const JAW: usize = 17;
/// The time between two packets, and between two calls of `show`.
const PERIOD_MS: u32 = 10;

/// A packet of a face whose jaw is open by this much and whose head is turned by 60 degrees to the left.
fn packet(sequence: u16, jaw: f32) -> Packet {
    let turned = [0.0, 0.5, 0.0, 0.866_025_4];
    let mut packet = Packet { state: State::Live, sequence, rotation: turned, ..Packet::NEUTRAL };
    packet.coefficients[JAW] = jaw;
    Packet::decode(&packet.encode()).unwrap()
}

/// A receiver that has followed packets from 0 up to `sequence`, and so shows the face of `packet(sequence, 1.0)`. The
/// last packet came at `end_ms`.
fn following(sequence: u16, end_ms: u32) -> Receiver {
    let mut receiver = Receiver::new(TRAVEL_MS);
    for back in (0..100).rev() {
        let now_ms = end_ms.wrapping_sub(u32::from(back) * PERIOD_MS);
        assert!(receiver.receive(&packet(sequence.wrapping_sub(back), 1.0), now_ms));
    }
    receiver
}

fn jaw(face: &Face) -> f32 {
    face.coefficients[JAW]
}

#[test]
fn the_face_is_exactly_that_of_the_newest_packet() {
    let mut receiver = following(7, 5000);
    let newest = packet(8, 0.25);
    assert!(receiver.receive(&newest, 5010));
    let face = receiver.show(5010);
    assert_eq!((face.is_silent, face.rotation, face.coefficients), (false, newest.rotation, newest.coefficients));
    assert_eq!(*receiver.newest(), newest);
}

#[test]
fn the_face_holds_for_499_ms_of_silence_and_moves_from_500_ms() {
    let mut receiver = following(7, 5000);
    let face = receiver.show(5000 + SILENCE_MS - 1);
    assert!(!face.is_silent && jaw(&face) == 1.0);
    assert!(receiver.show(5000 + SILENCE_MS).is_silent);
    assert!(jaw(&receiver.show(5000 + SILENCE_MS + 1)) < 1.0);
}

#[test]
fn the_face_is_neutral_one_travel_time_later_and_never_faster() {
    let mut receiver = following(7, 5000);
    let mut before = receiver.show(5000);
    let most = PERIOD_MS as f32 / f32::from(TRAVEL_MS) + 2.0 / 65535.0;
    for now_ms in (5010..=6000).step_by(10) {
        let face = receiver.show(now_ms);
        assert!((0.0..=most).contains(&(jaw(&before) - jaw(&face))), "at {now_ms}");
        assert!((0.0..=most).contains(&(before.rotation[1] - face.rotation[1])), "at {now_ms}");
        before = face;
    }
    assert_eq!((before.rotation, before.coefficients), ([0.0, 0.0, 0.0, 1.0], [0.0; 52]));
}

#[test]
fn rotations_between_have_length_1() {
    let mut receiver = following(7, 5000);
    for now_ms in 5000..6000 {
        let length = receiver.show(now_ms).rotation.iter().map(|component| component * component).sum::<f32>();
        assert!((length - 1.0).abs() < 2e-4, "{length} at {now_ms}");
    }
}

#[test]
fn the_first_packet_makes_no_jump() {
    let mut receiver = Receiver::new(TRAVEL_MS);
    assert!(receiver.show(123_456).is_silent);
    assert!(receiver.receive(&packet(500, 1.0), 123_456));
    assert_eq!(jaw(&receiver.show(123_456)), 0.0);
    let halfway = jaw(&{ receiver }.show(123_456 + 50));
    assert!((halfway - 50.0 / f32::from(TRAVEL_MS)).abs() < 1e-3, "{halfway}");
}

#[test]
fn a_packet_in_the_middle_of_the_way_to_neutral_makes_no_jump() {
    let mut receiver = following(7, 5000);
    let way =
        |receiver: &mut Receiver| (5510..5750).step_by(10).map(|now_ms| jaw(&receiver.show(now_ms))).last().unwrap();
    receiver.show(5500);
    let before = way(&mut receiver);
    assert!((0.4..0.6).contains(&before), "{before}");
    assert!(receiver.receive(&packet(8, 1.0), 5740));
    assert_eq!(jaw(&receiver.show(5740)), before);
    assert!(jaw(&receiver.show(5750)) > before);
}

#[test]
fn a_receiver_that_was_held_up_makes_no_step() {
    let mut receiver = following(7, 5000);
    assert_eq!(jaw(&receiver.show(9000)), 1.0);
    assert!((jaw(&receiver.show(19_000)) - 0.8).abs() < 1e-3);
}

#[test]
fn duplicates_and_late_datagrams_are_ignored() {
    let mut receiver = following(7, 5000);
    for sequence in [7, 6, 0, 65535, 7u16.wrapping_add(1 << 15)] {
        assert!(!receiver.receive(&packet(sequence, 0.0), 5000 + LATE_MS - 1), "{sequence}");
    }
    assert_eq!(jaw(&receiver.show(5249)), 1.0);
}

#[test]
fn an_ignored_datagram_does_not_delay_the_move_to_neutral() {
    let mut receiver = following(7, 5000);
    for now_ms in 5000..5000 + LATE_MS {
        receiver.receive(&packet(7, 1.0), now_ms);
    }
    assert!(receiver.show(5000 + SILENCE_MS).is_silent);
}

#[test]
fn a_gap_and_the_wrap_of_the_sequence_are_followed_at_once() {
    let mut receiver = following(65534, 5000);
    for sequence in [65535, 0, 1, 900, 900 + 32767] {
        assert!(receiver.receive(&packet(sequence, 0.5), 5001), "{sequence}");
    }
}

#[test]
fn a_sender_that_restarts_is_followed_after_a_quarter_of_a_second() {
    let mut receiver = following(700, 5000);
    assert!(!receiver.receive(&packet(0, 0.5), 5000 + LATE_MS - 1));
    assert!(receiver.receive(&packet(1, 0.5), 5000 + LATE_MS));
    assert!(receiver.receive(&packet(2, 0.5), 5000 + LATE_MS));
}

#[test]
fn with_two_senders_the_face_stays_with_one_until_it_stops() {
    let mut receiver = following(700, 5000);
    for turn in 1..100 {
        let now_ms = 5000 + u32::from(turn) * PERIOD_MS;
        assert!(receiver.receive(&packet(700 + turn, 1.0), now_ms));
        assert!(!receiver.receive(&packet(turn, 0.0), now_ms + 1));
    }
    assert!(receiver.receive(&packet(100, 0.0), 5990 + LATE_MS));
}

#[test]
fn the_clock_may_wrap_at_any_point() {
    for end_ms in (0..=1200).step_by(7).map(|after| 0u32.wrapping_sub(600).wrapping_add(after)) {
        let mut receiver = following(7, end_ms);
        assert_eq!(jaw(&receiver.show(end_ms.wrapping_add(499))), 1.0, "{end_ms}");
        assert!(receiver.show(end_ms.wrapping_add(500)).is_silent, "{end_ms}");
    }
}

#[test]
fn a_clock_that_was_read_before_the_last_packet_came_means_no_silence() {
    let mut receiver = following(7, 5000);
    assert!(!receiver.show(4990).is_silent);
    assert!(!receiver.show(5499).is_silent);
}

#[test]
fn a_silence_of_fifty_days_stays_a_silence() {
    let mut receiver = following(7, 5000);
    for day in 0..100 {
        let now_ms = 5500u32.wrapping_add(86_400_000u32.wrapping_mul(day));
        assert!(receiver.show(now_ms).is_silent, "day {day}");
    }
    assert!(receiver.receive(&packet(3, 1.0), 5000));
}
