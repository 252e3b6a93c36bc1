//! The C header shows the same face as the Rust receiver, to the last bit.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_possible_truncation)]

mod compiler;
mod random;

use compiler::{compiled_c, printed};
use facewire_packet::{PACKET_BYTES, Packet, Receiver};
use random::Random;

/// What the Rust receiver does on an event, in the numbers that the C program prints.
fn by_rust(receiver: &mut Receiver, now_ms: u32, datagram: Option<&[u8]>) -> Option<Vec<i64>> {
    if let Some(datagram) = datagram {
        let packet = Packet::decode(datagram).ok()?;
        return Some(vec![receiver.receive(&packet, now_ms).into()]);
    }
    let face = receiver.show(now_ms);
    let whole = |value: f32, one: f32| (value * one).round() as i64;
    let mut numbers = vec![i64::from(!face.is_silent)];
    numbers.extend(face.rotation.map(|component| whole(component, 32767.0)));
    numbers.extend(face.coefficients.map(|value| whole(value, 65535.0)));
    Some(numbers)
}

/// The bytes of a random packet. One in 50 has a flipped bit.
fn damaged_now_and_then(random: &mut Random, sequence: u16) -> [u8; PACKET_BYTES] {
    let mut bytes = random.packet(sequence).encode();
    if random.below(50) == 0 {
        bytes[random.below(132) as usize] ^= 1 << random.below(8);
    }
    bytes
}

/// Random events in the input format of `receive.c`, and what the Rust receiver says to each. `None` is a damaged packet.
fn events(random: &mut Random, travel_ms: u16) -> (Vec<u8>, Vec<Option<Vec<i64>>>) {
    let mut receiver = Receiver::new(travel_ms);
    let mut bytes = vec![b'T'];
    bytes.extend(u32::from(travel_ms).to_le_bytes());
    let mut answers = Vec::new();
    let (mut now_ms, mut sequence) = (0u32.wrapping_sub(20_000), 65_000u16);
    for _ in 0..4000 {
        now_ms = now_ms.wrapping_add(random.step(30));
        sequence = sequence.wrapping_add(random.step(3) as u16);
        let datagram = (random.below(2) == 0).then(|| damaged_now_and_then(random, sequence));
        bytes.push(if datagram.is_some() { b'R' } else { b'S' });
        bytes.extend(now_ms.to_le_bytes());
        bytes.extend(datagram.iter().flatten());
        answers.push(by_rust(&mut receiver, now_ms, datagram.as_ref().map(|bytes| &bytes[..])));
    }
    (bytes, answers)
}

#[test]
fn c_and_rust_show_the_same_face_in_random_sequences() {
    let program = compiled_c("receive.c");
    let mut random = Random(0x2545_F491);
    for travel_ms in [0, 1, 77, 500, 3000, 65535] {
        let (bytes, answers) = events(&mut random, travel_ms);
        let mut printed = printed(&program, &bytes).into_iter();
        let mut next = |count| printed.by_ref().take(count).collect::<Vec<_>>();
        for (index, answer) in answers.iter().enumerate() {
            match answer {
                Some(numbers) => assert_eq!(next(numbers.len()), *numbers, "event {index}, travel {travel_ms}"),
                None => assert!(next(1)[0] < 0, "event {index}, travel {travel_ms}"),
            }
        }
        assert!(next(1).is_empty());
        let count =
            |wanted: &dyn Fn(&[i64]) -> bool| answers.iter().flatten().filter(|numbers| wanted(numbers)).count();
        let taken_and_ignored = (count(&|numbers| numbers == [1]), count(&|numbers| numbers == [0]));
        let live_and_silent = (
            count(&|numbers| numbers.len() > 1 && numbers[0] == 1),
            count(&|numbers| numbers.len() > 1 && numbers[0] == 0),
        );
        for (one, other) in [taken_and_ignored, live_and_silent] {
            assert!(one > 100 && other > 100, "{taken_and_ignored:?} {live_and_silent:?}");
        }
        assert!(answers.contains(&None));
    }
}
