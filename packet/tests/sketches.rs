//! The Arduino sketches follow the face within the limits of their servos, and go neutral when packets stop.
//!
//! They run here against stand-ins for the libraries of Arduino, on a simulated clock (`arduino/main.cpp`).
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

mod compiler;
mod random;

use std::{path::PathBuf, sync::LazyLock};

use compiler::{compiled_sketch, printed};
use facewire_packet::{Packet, State};
use random::Random;

/// A sketch, and what its first three servos do.
struct Sketch {
    program: &'static LazyLock<PathBuf>,
    servos: usize,
    /// How far a pulse may be from the wanted one: one step of the outputs.
    step_us: i64,
    by_udp: bool,
}

static HEAD: LazyLock<PathBuf> = LazyLock::new(|| compiled_sketch("head", &[]));
static PCA9685: LazyLock<PathBuf> = LazyLock::new(|| compiled_sketch("head_pca9685", &[]));
static ESP32: LazyLock<PathBuf> = LazyLock::new(|| compiled_sketch("head_esp32", &[]));
static ESP32_CORE_2: LazyLock<PathBuf> =
    LazyLock::new(|| compiled_sketch("head_esp32", &["-DESP_ARDUINO_VERSION_MAJOR=2"]));

const SKETCHES: [Sketch; 4] = [
    Sketch { program: &HEAD, servos: 3, step_us: 0, by_udp: false },
    Sketch { program: &PCA9685, servos: 9, step_us: 5, by_udp: false },
    Sketch { program: &ESP32, servos: 3, step_us: 2, by_udp: true },
    Sketch { program: &ESP32_CORE_2, servos: 3, step_us: 2, by_udp: true },
];
/// The pulses of jaw, left lid and right lid at coefficient 0 and 1.
const NEUTRAL_US: [i64; 3] = [1000, 1800, 1200];
const FULL_US: [i64; 3] = [1600, 1200, 1800];
/// Least and greatest pulse of the three in the sketches, in which a lid of the servo board opens wide, too.
const LIMITS_US: [(i64, i64); 3] = [(1000, 1600), (1200, 1900), (1100, 1800)];
/// The longest way of the three in 20 ms.
const STEPS_US: [i64; 3] = [49, 141, 141];
/// The time between two packets.
const PERIOD_MS: u32 = 17;

/// Commands for a sketch.
struct Script<'a> {
    sketch: &'a Sketch,
    bytes: Vec<u8>,
    sequence: u16,
    prints: usize,
}

impl<'a> Script<'a> {
    /// Starts the sketch at this time of its clock.
    fn new(sketch: &'a Sketch, start_ms: u32) -> Self {
        let script = Self { sketch, bytes: Vec::new(), sequence: 0, prints: 0 };
        if sketch.by_udp { script.command(b'N', 1) } else { script }.command(b'S', start_ms).wait(100)
    }

    fn command(mut self, letter: u8, number: u32) -> Self {
        self.bytes.push(letter);
        self.bytes.extend(number.to_le_bytes());
        self
    }

    fn wait(self, ms: u32) -> Self {
        self.command(b'W', ms)
    }

    /// Sends bytes as they are.
    fn raw(mut self, bytes: &[u8]) -> Self {
        let letter = if self.sketch.by_udp { b'D' } else { b'L' };
        self = self.command(letter, u32::try_from(bytes.len()).unwrap());
        self.bytes.extend(bytes);
        self
    }

    fn packet(mut self, packet: &Packet) -> Self {
        self.sequence = self.sequence.wrapping_add(1);
        let packet = Packet { sequence: self.sequence, ..*packet };
        if self.sketch.by_udp { self.raw(&packet.encode()) } else { self.raw(&packet.encode_frame()) }
    }

    /// Sends the packet for so long, about 60 times a second.
    fn follow(mut self, packet: &Packet, ms: u32) -> Self {
        for _ in 0..ms / PERIOD_MS {
            self = self.packet(packet).wait(PERIOD_MS);
        }
        self
    }

    fn print(mut self) -> Self {
        self.prints += 1;
        self.command(b'P', 0)
    }

    /// Runs the sketch and returns the pulses of each print. No byte of the serial line may have been lost.
    fn pulses(self) -> Vec<Vec<i64>> {
        let numbers = printed(self.sketch.program, &self.bytes);
        assert_eq!(numbers.len(), self.prints * (self.sketch.servos + 1));
        let prints = numbers.chunks(self.sketch.servos + 1);
        assert!(prints.clone().all(|print| print[self.sketch.servos] == 0), "the serial port has lost bytes");
        prints.map(|print| print[..self.sketch.servos].to_vec()).collect()
    }
}

/// A face with these coefficients of the jaw, the left lid and the right lid.
fn face(values: [f32; 3]) -> Packet {
    let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
    for (index, value) in [17, 0, 7].into_iter().zip(values) {
        packet.coefficients[index] = value;
    }
    packet
}

fn assert_pulses(sketch: &Sketch, pulses: &[i64], wanted: [i64; 3]) {
    let differences = pulses.iter().zip(wanted).map(|(pulse, wanted)| (pulse - wanted).abs());
    let most = sketch.step_us + 1;
    assert!(differences.max().unwrap() <= most, "{pulses:?} instead of {wanted:?}");
}

#[test]
fn servos_get_no_pulses_before_the_first_packet_and_then_start_one_after_another_at_neutral() {
    for sketch in &SKETCHES {
        let mut script = Script::new(sketch, 0).wait(3000).print();
        for _ in 0..sketch.servos * 13 {
            script = script.follow(&face([0.0; 3]), 17).print();
        }
        let prints = script.pulses();
        assert!(prints[0].iter().all(|pulse| *pulse == 0));
        let running = |print: &Vec<i64>| print.iter().filter(|pulse| **pulse > 0).count();
        assert!(prints.windows(2).all(|pair| running(&pair[1]) - running(&pair[0]) <= 1));
        let periods = prints.iter().filter(|print| running(print) == 2).count();
        assert!((11..=13).contains(&periods), "a servo each 200 ms: {periods} of 17 ms");
        let first = |servo: usize| prints.iter().map(|print| print[servo]).find(|pulse| *pulse > 0).unwrap();
        assert_pulses(sketch, &[first(0), first(1), first(2)], NEUTRAL_US);
        assert_eq!(running(prints.last().unwrap()), sketch.servos);
    }
}

#[test]
fn servos_follow_the_face_and_go_neutral_when_packets_stop() {
    for sketch in &SKETCHES {
        let script = Script::new(sketch, 5000).follow(&face([0.5, 1.0, 0.0]), 3000).print();
        let prints = script.wait(450).print().wait(600).print().pulses();
        assert_pulses(sketch, &prints[0], [1300, FULL_US[1], NEUTRAL_US[2]]);
        assert_eq!(prints[1], prints[0]);
        assert_pulses(sketch, &prints[2], NEUTRAL_US);
    }
}

#[test]
fn servos_are_released_after_ten_seconds_of_silence_and_come_back() {
    for sketch in &SKETCHES {
        let script = Script::new(sketch, 5000).follow(&face([1.0; 3]), 3000).wait(10_300).print().wait(400).print();
        let prints = script.follow(&face([1.0; 3]), 3000).print().pulses();
        assert_pulses(sketch, &prints[0], NEUTRAL_US);
        assert!(prints[1].iter().all(|pulse| *pulse == 0));
        assert_pulses(sketch, &prints[2], FULL_US);
    }
}

#[test]
fn no_packet_drives_a_servo_beyond_its_limits_or_faster_than_its_travel_time() {
    let mut random = Random(77);
    for sketch in &SKETCHES {
        let mut script = Script::new(sketch, 5000).follow(&face([0.0; 3]), 3000).print();
        for sequence in 0..600 {
            let mut packet = random.packet(sequence);
            packet.coefficients = packet.coefficients.map(f32::round);
            script = script.packet(&packet).wait(20).print();
        }
        let prints = script.pulses();
        for servo in 0..3 {
            let (least, most) = LIMITS_US[servo];
            let within = least - sketch.step_us..=most + sketch.step_us;
            assert!(prints.iter().all(|print| within.contains(&print[servo])), "servo {servo}");
            let steps = prints.windows(2).map(|pair| (pair[1][servo] - pair[0][servo]).abs());
            assert!(steps.clone().max().unwrap() <= STEPS_US[servo] + 2 * sketch.step_us, "servo {servo}");
            assert!(steps.max().unwrap() > STEPS_US[servo] / 2, "servo {servo} moves");
        }
    }
}

#[test]
fn the_clock_of_the_board_may_wrap() {
    for sketch in &SKETCHES {
        for before_ms in [500, 3000, 3700, 8000] {
            let start_ms = 0u32.wrapping_sub(before_ms);
            let script = Script::new(sketch, start_ms).follow(&face([1.0; 3]), 3000).print().wait(1100).print();
            let prints = script.wait(10_000).print().follow(&face([1.0; 3]), 3000).print().pulses();
            assert_pulses(sketch, &prints[0], FULL_US);
            assert_pulses(sketch, &prints[1], NEUTRAL_US);
            assert!(prints[2].iter().all(|pulse| *pulse == 0));
            assert_pulses(sketch, &prints[3], FULL_US);
        }
    }
}

#[test]
fn garbage_moves_nothing_and_hides_no_packet() {
    let mut random = Random(5);
    for sketch in &SKETCHES {
        let mut script = Script::new(sketch, 5000);
        for _ in 0..100 {
            let garbage: Vec<u8> = (0..random.below(300)).map(|_| random.below(256).to_le_bytes()[0]).collect();
            script = script.raw(&garbage).wait(30);
        }
        script = script.print().wait(5000).raw(&[0]).wait(5);
        let prints = script.follow(&face([1.0; 3]), 3000).print().pulses();
        assert!(prints[0].iter().all(|pulse| *pulse == 0));
        assert_pulses(sketch, &prints[1], FULL_US);
    }
}

#[test]
fn a_line_that_is_always_busy_loses_no_byte() {
    for sketch in SKETCHES.iter().filter(|sketch| !sketch.by_udp) {
        let stream = face([1.0; 3]).encode_frame().repeat(300);
        let prints = Script::new(sketch, 5000).raw(&stream).wait(3000).print().pulses();
        // All these packets have the same number, so that one each quarter of a second is taken.
        assert_pulses(sketch, &prints[0], FULL_US);
    }
}

#[test]
fn the_neck_follows_the_head() {
    let sketch = &SKETCHES[1];
    let turned = |rotation| Packet { state: State::Live, rotation, ..Packet::NEUTRAL };
    // 22.5 degrees to the left, 45 degrees to the right, 22.5 degrees up.
    let rotations = [[0.0, 0.195, 0.0, 0.981], [0.0, -0.383, 0.0, 0.924], [-0.195, 0.0, 0.0, 0.981]];
    let mut script = Script::new(sketch, 0).follow(&turned([0.0, 0.0, 0.0, 1.0]), 3000);
    for rotation in rotations {
        script = script.follow(&turned(rotation), 2000).print();
    }
    let prints = script.pulses();
    let necks: Vec<_> = prints.iter().map(|print| (print[7], print[8])).collect();
    for ((turn, nod), (wanted_turn, wanted_nod)) in necks.iter().zip([(1755, 1500), (1000, 1500), (1500, 1653)]) {
        assert!((turn - wanted_turn).abs() < 12 && (nod - wanted_nod).abs() < 12, "{necks:?}");
    }
}

#[test]
fn a_servo_board_that_lost_its_power_is_set_up_again_within_a_second() {
    let sketch = &SKETCHES[1];
    let script = Script::new(sketch, 0).follow(&face([1.0; 3]), 3000).command(b'R', 0).print();
    let prints = script.follow(&face([1.0; 3]), 1100).print().follow(&face([1.0; 3]), 3000).print().pulses();
    assert!(prints[0].iter().all(|pulse| *pulse == 0));
    assert!(prints[1][0] > 0);
    assert_pulses(sketch, &prints[2], FULL_US);
}

#[test]
fn a_servo_board_that_does_not_answer_costs_no_byte_of_the_line_and_is_waited_for() {
    let sketch = &SKETCHES[1];
    let script = Script::new(sketch, 0).follow(&face([1.0; 3]), 3000).command(b'H', 1);
    let script = script.follow(&face([0.0; 3]), 5000).command(b'H', 0);
    let prints = script.follow(&face([1.0; 3]), 4000).print().pulses();
    assert_pulses(sketch, &prints[0], FULL_US);
}

#[test]
fn a_network_that_comes_late_goes_and_returns_is_waited_for() {
    for sketch in &SKETCHES[2..] {
        let late = Script::new(sketch, 0).command(b'N', 0).wait(20_000).command(b'N', 1).wait(16_000);
        let prints = late.follow(&face([1.0; 3]), 3000).print().command(b'N', 0).wait(2000).print();
        let prints = prints.command(b'N', 1).wait(16_000).follow(&face([1.0; 3]), 3000).print().pulses();
        assert_pulses(sketch, &prints[0], FULL_US);
        assert_pulses(sketch, &prints[1], NEUTRAL_US);
        assert_pulses(sketch, &prints[2], FULL_US);
    }
}

#[test]
fn a_datagram_that_is_too_long_blocks_nothing() {
    for sketch in &SKETCHES[2..] {
        let script = Script::new(sketch, 0).follow(&face([1.0; 3]), 3000).raw(&[0x46; 1400]);
        let prints = script.follow(&face([0.0; 3]), 500).print().pulses();
        assert_pulses(sketch, &prints[0], NEUTRAL_US);
    }
}

#[test]
fn an_empty_datagram_blocks_the_port_for_five_seconds_at_most() {
    for sketch in &SKETCHES[2..] {
        let script = Script::new(sketch, 0).follow(&face([1.0; 3]), 3000).raw(&[]);
        let prints = script.follow(&face([1.0; 3]), 9000).print().pulses();
        assert_pulses(sketch, &prints[0], FULL_US);
    }
}
