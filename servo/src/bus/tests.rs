use std::io;
use std::sync::atomic::Ordering::Relaxed;

use facewire_packet::{Reason, State};

use super::family::Family;
use super::simulator::{Answers, Simulator, status};
use super::*;
use crate::channel::tests::valued;
use crate::{AtLoss, Operator};

const STEP: Duration = Duration::from_millis(20);
const KINDS: [Kind; 5] = [Kind::DynamixelX, Kind::DynamixelAx, Kind::DynamixelMx, Kind::FeetechSts, Kind::FeetechScs];

/// A servo that is close to where it is wanted may go there at once.
const SLACK: f64 = 0.02 * 400.0 / 0.02;

fn channel(id: u32, at_0: f32, at_1: f32) -> ChannelSettings {
    let (position_at_0, position_at_1, sources) = (at_0, at_1, valued(&[("jawOpen", 1.0)]));
    ChannelSettings { channel: id, position_at_0, position_at_1, sources, ..ChannelSettings::default() }
}

/// A line with simulated servos at its end, and what the face does.
struct Rig {
    line: Line,
    bus: Simulator,
    now: Instant,
    operator: Arc<Operator>,
    state: State,
    jaw_open: f32,
    /// What has come back since the last message, and the length of the longest message.
    back: Vec<u8>,
    longest: usize,
}

impl Rig {
    fn new(kind: Kind, channels: &[ChannelSettings]) -> Self {
        let (now, operator) = (Instant::now(), Arc::<Operator>::default());
        let dials = Arc::new(Dials::new(channels, &operator));
        let line = Line::new(kind, Unit::Steps, 1_000_000, channels, &dials);
        let ids: Vec<u8> = channels.iter().map(|channel| channel.channel as u8).collect();
        let bus = Simulator::new(kind.family().name, &ids, now);
        Self { line, bus, now, operator, state: State::Live, jaw_open: 0.0, back: Vec::new(), longest: 0 }
    }

    /// Three servos, of which the first one keeps a speed, and the second is released without a face.
    fn of_three(kind: Kind) -> Self {
        let slow = ChannelSettings { speed_per_s: 0.5, acceleration_per_s2: 5.0, ..channel(1, 300.0, 700.0) };
        let released = ChannelSettings { loss: AtLoss::Release, ..channel(2, 700.0, 300.0) };
        Self::new(kind, &[slow, released, channel(7, 300.0, 700.0)])
    }

    fn message(&mut self) -> Vec<u8> {
        self.now += STEP;
        let reason = if self.state == State::Live { Reason::None } else { Reason::NoFace };
        let mut packet = Packet { state: self.state, reason, ..Packet::NEUTRAL };
        packet.coefficients[17] = self.jaw_open;
        self.back.extend(self.bus.take(&[], self.now));
        let mut out = Vec::new();
        self.line.step(&packet, &std::mem::take(&mut self.back), self.now, &mut out);
        out
    }

    fn step(&mut self) {
        let message = self.message();
        self.longest = self.longest.max(message.len());
        self.back = self.bus.take(&message, self.now + Duration::from_millis(1));
    }

    fn run(&mut self, seconds: f32) -> &mut Self {
        (0..(seconds / STEP.as_secs_f32()) as usize).for_each(|_| self.step());
        self
    }

    /// Cuts the power of a servo, which needs 0.8 s to start again.
    fn restart(&mut self, index: usize) {
        self.bus.servos[index].restart(self.now + Duration::from_millis(800));
    }

    fn torques(&self) -> Vec<bool> {
        self.bus.servos.iter().map(|servo| servo.has_torque()).collect()
    }

    fn positions(&self) -> Vec<f64> {
        self.bus.servos.iter().map(|servo| servo.position.round()).collect()
    }
}

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

/// A servo's registers, all of which are 0 but those of limits.
fn registers(family: &Family) -> Registers {
    let mut registers = [0; 160];
    let most: &[(usize, u8)] = match family.name {
        "dynamixel-x" => &[(49, 0x10), (45, 0x10)],
        "feetech-scs" => &[(11, 4)],
        _ => &[(9, 0x10), (12, 0x10)],
    };
    most.iter().for_each(|(address, byte)| registers[*address] = *byte);
    registers
}

#[test]
fn every_frame_equals_the_vectors_of_the_makers() {
    let ids = |order: Order| [(1, order), (2, order)];
    let all = |kind: Kind, orders: &[(u8, Order)]| {
        let mut out = Vec::new();
        kind.family().write(orders, &mut out);
        out
    };
    let moved = |kind: Kind, id, steps, steps_per_s, steps_per_s2, phase| {
        let family = kind.family();
        let mut registers = registers(family);
        registers[18] = phase;
        (id, family.goal(Goal { steps, steps_per_s, steps_per_s2 }, &registers))
    };
    use Kind::{DynamixelAx as Ax, DynamixelX as X, FeetechScs as Scs, FeetechSts as Sts};
    let [x_speed, x_acceleration] = [100.5 * 0.229 * 4096.0 / 60.0, 20.5 * 214.577 * 4096.0 / 3600.0];
    let ax_speed = 0.111 * 6.0 * 1023.0 / 300.0;
    for (out, want) in [
        (all(X, &ids(Order::watchdog(true))), "FF FF FD 00 FE 0B 00 83 62 00 01 00 01 19 02 19 B4 C5"),
        (all(X, &ids(Order::watchdog(false))), "FF FF FD 00 FE 0B 00 83 62 00 01 00 01 00 02 00 16 C4"),
        (
            all(X, &[moved(X, 1, 2048.0, x_speed, x_acceleration, 0)]),
            "FF FF FD 00 FE 14 00 83 6C 00 0C 00 01 14 00 00 00 64 00 00 00 00 08 00 00 57 38",
        ),
        (
            all(
                Ax,
                &[
                    moved(Ax, 0, 16.0, 0x150 as f32 * ax_speed + 1.0, 0.0, 0),
                    moved(Ax, 1, 544.0, 0x360 as f32 * ax_speed + 1.0, 0.0, 0),
                ],
            ),
            "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
        ),
        (
            all(Sts, &[moved(Sts, 1, 4095.0, 60.0, 5000.0, 4), moved(Sts, 2, 2048.0, 60.0, 5000.0, 4)]),
            "FF FF FE 14 83 29 07 01 32 FF 0F 00 00 3C 00 02 32 00 08 00 00 3C 00 45",
        ),
        (
            all(Scs, &[moved(Scs, 1, 1000.0, 1500.0, 0.0, 0), moved(Scs, 2, 20.0, 1500.0, 0.0, 0)]),
            "FF FF FE 12 83 2A 06 01 03 E8 00 00 05 DC 02 00 14 00 00 05 DC 78",
        ),
        (all(Sts, &ids(Order::torque(true))), "FF FF FE 08 83 28 01 01 01 02 01 48"),
        (all(Sts, &ids(Order::torque(false))), "FF FF FE 08 83 28 01 01 00 02 00 4A"),
    ] {
        assert_eq!(out, bytes(want), "{want}");
    }
    let [mut two, mut one] = [Vec::new(), Vec::new()];
    Protocol::Two.write_read(1, Block(132, 4), &mut two);
    Protocol::One.write_read(1, Block(56, 2), &mut one);
    assert_eq!(two, bytes("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"));
    assert_eq!(one, bytes("FF FF 01 04 02 38 02 BE"));
    // A goal is within the limits of the servo, which are 16 and 4095 here.
    for (steps, place) in [(9999.0, [0xFF, 0x0F]), (f32::INFINITY, [0xFF, 0x0F]), (-5.0, [16, 0]), (f32::NAN, [16, 0])]
    {
        let goal = moved(Sts, 1, steps, 0.0, 0.0, 4);
        assert_eq!(all(Sts, &[goal])[9..11], place, "{steps}");
    }
    // The same speed is another number in the coarse unit.
    let (_, coarse) = moved(Sts, 1, 0.0, 600.0, 0.0, 0);
    assert_eq!(all(Sts, &[(1, coarse)])[13..15], [12, 0]);
}

#[test]
fn answers_are_found_in_any_pieces_among_noise_and_those_with_a_wrong_bit_are_damaged() {
    for (protocol, answer, id, error, data) in [
        (Protocol::Two, "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", 1, 0, "A6 00 00 00"),
        (Protocol::Two, "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", 1, 0, "06 04 26"),
        (Protocol::One, "FF FF 01 04 00 18 05 DD", 1, 0, "18 05"),
        (Protocol::One, "FF FF 02 0A 00 FF 07 00 00 00 00 77 23 53", 2, 0, "FF 07 00 00 00 00 77 23"),
        (Protocol::One, "FF FF 01 02 24 D8", 1, 0x24, ""),
    ] {
        let (frame, data) = (bytes(answer), bytes(data));
        for noise in [&[][..], &[0xFF], &[0xFF, 0xFF], &[0, 0xFF, 0xFE], &[0xFF, 0xFF, 0xFD]] {
            let mut reader = Reader::new(protocol);
            let last = [noise, &frame]
                .concat()
                .into_iter()
                .filter_map(|byte| reader.push(byte).map(|it| it == Ok(Status { id, error, data: &data })))
                .last();
            assert_eq!(last, Some(true), "{noise:x?} {answer}");
        }
        for bit in 0..8 * frame.len() {
            let (mut broken, mut reader) = (frame.clone(), Reader::new(protocol));
            broken[bit / 8] ^= 1 << (bit % 8);
            assert!(broken.iter().all(|byte| !matches!(reader.push(*byte), Some(Ok(_)))), "bit {bit} of {answer}");
        }
    }
    let stuffed = [0xFF, 0xFF, 0xFD, 0xFD, 0, 0xFF, 0xFF, 0xFD];
    let mut reader = Reader::new(Protocol::Two);
    let frame = status(true, 9, 0, &stuffed);
    let read = frame
        .iter()
        .filter_map(|byte| reader.push(*byte).map(|it| it == Ok(Status { id: 9, error: 0, data: &stuffed })));
    assert_eq!(read.collect::<Vec<_>>(), [true]);
}

#[test]
fn servos_of_every_family_begin_where_they_stand_go_slowly_and_then_follow_within_their_limits() {
    for (kind, has_echo) in KINDS.into_iter().flat_map(|kind| [(kind, false), (kind, true)]) {
        let (mut rig, family) = (Rig::of_three(kind), kind.family());
        rig.bus.echoes = has_echo;
        rig.jaw_open = 1.0;
        rig.run(4.0);
        let (name, slow) = (family.name, f64::from(START_DEGREES_PER_S / family.degrees_per_step));
        assert_eq!(
            (rig.positions(), rig.line.troubles()),
            (vec![700.0, 300.0, 700.0], String::new()),
            "{name} {has_echo}"
        );
        // The first goal of each servo is where it stands, and comes before the torque.
        for id in [1, 2, 7] {
            let mut told = rig.bus.written.iter().filter(|(_, servo, first, _)| *servo == id && *first != 98);
            let (first, then) = (told.next().unwrap(), told.next().unwrap());
            assert!(first.3.len() > 1 && then.2 == usize::from(family.torque), "{name}: {first:?} {then:?}");
            assert!(
                first.3.windows(2).any(|two| [500_u16.to_le_bytes(), 500_u16.to_be_bytes()].iter().any(|it| it == two))
            );
        }
        let fastest: Vec<f64> = rig.bus.servos.iter().map(|servo| servo.fastest).collect();
        assert!(fastest[0] <= 201.0 && fastest[1..].iter().all(|it| *it <= slow + SLACK), "{name}: {fastest:?}");
        rig.jaw_open = 0.0;
        rig.run(0.1);
        assert_eq!(rig.positions()[1..], [700.0, 300.0], "{name}: without a limit");
        rig.run(2.5);
        assert!(rig.positions()[0] == 300.0 && rig.bus.servos[0].fastest <= 201.0, "{name}");
        assert!(rig.bus.strange.is_empty(), "{:x?}", rig.bus.strange);
        let bytes = family.line_bytes(3);
        assert!(rig.longest <= bytes + 60, "{name}: {bytes} {}", rig.longest);
    }
}

#[test]
fn without_a_face_servos_go_to_rest_and_stay_or_have_no_torque_and_an_operator_takes_it_from_all() {
    for kind in KINDS {
        let mut rig = Rig::of_three(kind);
        rig.jaw_open = 1.0;
        rig.run(4.0);
        rig.state = State::Neutral;
        rig.run(1.5);
        assert_eq!((rig.torques(), &rig.positions()[1..]), (vec![true, false, true], &[700.0, 300.0][..]));
        rig.state = State::Live;
        rig.run(3.0);
        assert_eq!((rig.torques(), rig.positions()), (vec![true; 3], vec![700.0, 300.0, 700.0]));
        // What is held fast on its way to rest has torque for a second.
        (rig.bus.servos[1].motor, rig.state) = (0.0, State::Neutral);
        rig.run(0.8);
        assert!(rig.torques()[1]);
        rig.run(0.4);
        assert!(!rig.torques()[1]);
        (rig.bus.servos[1].motor, rig.state) = (5000.0, State::Live);
        rig.run(3.0);
        // In mid move, all at once.
        rig.jaw_open = 0.0;
        rig.run(0.2);
        rig.operator.is_released.store(true, Relaxed);
        rig.step();
        assert!(rig.torques() == [false; 3] && (301.0..699.0).contains(&rig.positions()[0]));
        rig.jaw_open = 1.0;
        // Somebody turns it, and it begins there.
        rig.bus.servos[2].position = 400.0;
        rig.run(1.0);
        assert_eq!((rig.torques(), rig.positions()[2]), (vec![false; 3], 400.0));
        rig.operator.is_released.store(false, Relaxed);
        rig.bus.servos[2].fastest = 0.0;
        rig.run(3.0);
        let slow = f64::from(START_DEGREES_PER_S / kind.family().degrees_per_step);
        assert!(rig.positions()[2] == 700.0 && rig.bus.servos[2].fastest <= slow + SLACK);
    }
}

#[test]
fn a_servo_that_is_missing_duplicated_damaged_or_refused_is_told_and_left_without_torque_while_others_move() {
    let twice: fn(&mut Rig) = |rig| rig.bus.plug_in(2, rig.now);
    let set = |address: usize, byte: u8| move |rig: &mut Rig| rig.bus.servos[1].registers[address] = byte;
    let never: fn(&mut Rig) = |rig| rig.bus.servos[1].answers = Answers::Never;
    let damaged: fn(&mut Rig) = |rig| rig.bus.servos[1].answers = Answers::Damaged;
    let unlimited: fn(&mut Rig) = |rig| rig.bus.servos[1].registers[9..13].fill(0);
    use Kind::{DynamixelAx as Ax, DynamixelMx as Mx, DynamixelX as X, FeetechScs as Scs, FeetechSts as Sts};
    let cases: [(Kind, &dyn Fn(&mut Rig), &str); 9] = [
        (X, &never, "servo 2: it does not answer: check its power"),
        (Sts, &damaged, "servo 2: its answers are damaged: check"),
        (X, &twice, "servo 2: two servos have this number: unplug one"),
        (Scs, &twice, "servo 2: two servos have this number: unplug one"),
        (Sts, &set(2, 1), "servo 2: its registers have the high byte first: set family = \"feetech-scs\""),
        (X, &set(11, 1), "servo 2: set its operating mode to position control, with the maker's"),
        (Ax, &set(0, 29), "servo 2: its model 29 is not one of dynamixel-ax: set another family"),
        (Mx, &set(9, 0), "servo 2: an end is at 700 steps, but the servo allows 0 to 255: change the"),
        (Scs, &unlimited, "servo 2: its limits are 0 and 0: set it to"),
    ];
    for (kind, fault, want) in cases {
        // From the beginning, and while it moves.
        for seconds in [0.0, 3.0] {
            let mut rig = Rig::of_three(kind);
            rig.jaw_open = 1.0;
            rig.run(seconds);
            fault(&mut rig);
            if seconds > 0.0 && want.contains("set") || want.contains("change") {
                rig.restart(1);
            }
            rig.run(4.0);
            let told = rig.line.troubles();
            assert!(told.starts_with(want) && !told.contains('\n'), "{want}: {told}");
            assert_eq!((rig.torques()[..3].to_vec(), rig.positions()[2]), (vec![true, false, true], 700.0), "{want}");
        }
    }
}

#[test]
fn answers_that_are_lost_or_late_now_and_then_change_nothing() {
    for kind in KINDS {
        let mut rig = Rig::of_three(kind);
        rig.jaw_open = 1.0;
        for round in 0..200 {
            let answers = [Answers::Well, Answers::Late(Duration::from_millis(70)), Answers::Well, Answers::Never];
            rig.bus.servos.iter_mut().for_each(|servo| servo.answers = answers[round % 4]);
            rig.run(0.1);
            assert_eq!(rig.line.troubles(), "");
        }
        assert_eq!((rig.torques(), rig.positions()), (vec![true; 3], vec![700.0, 300.0, 700.0]));
    }
}

#[test]
fn a_servo_that_lost_its_power_in_mid_move_begins_again_where_it_stands() {
    for kind in KINDS {
        let servo = |id| ChannelSettings { speed_per_s: if id == 1 { 0.5 } else { 0.0 }, ..channel(id, 300.0, 700.0) };
        let mut rig = Rig::new(kind, &(1..=12).map(servo).collect::<Vec<_>>());
        rig.run(4.0);
        rig.jaw_open = 1.0;
        rig.run(0.5);
        let before = rig.positions()[0];
        assert!((350.0..450.0).contains(&before), "{before}");
        // The second one has no limit of its own.
        rig.jaw_open = 0.0;
        for index in [0, 1] {
            rig.bus.servos[index].fastest = 0.0;
            rig.restart(index);
        }
        rig.run(5.0);
        assert_eq!((&rig.positions()[..2], rig.line.troubles()), (&[300.0, 300.0][..], String::new()), "{kind:?}");
        let slow = f64::from(START_DEGREES_PER_S / kind.family().degrees_per_step);
        let fastest = [0, 1].map(|index: usize| rig.bus.servos[index].fastest);
        assert!(fastest[0] <= 201.0 && fastest[1] <= slow + SLACK, "{kind:?}: {fastest:?}");
    }
}

#[test]
fn a_watchdog_is_cleared_after_a_silence_of_the_line_and_otherwise_told_and_not_cleared() {
    let mut rig = Rig::of_three(Kind::DynamixelX);
    rig.run(4.0);
    rig.jaw_open = 1.0;
    rig.run(0.2);
    // The line itself is silent.
    rig.now += Duration::from_secs(2);
    rig.bus.take(&[], rig.now);
    assert_eq!(rig.bus.servos[0].registers[98], 0xFF);
    let stopped = rig.positions()[0];
    rig.run(0.1);
    assert!((rig.positions()[0] - stopped).abs() < 5.0);
    rig.run(3.0);
    assert_eq!((rig.positions()[0], rig.line.troubles(), rig.bus.servos[0].registers[98]), (700.0, String::new(), 25));
    // One servo heard nothing.
    rig.bus.servos[2].registers[98] = 0xFF;
    rig.bus.written.clear();
    rig.run(5.0);
    assert!(
        rig.line.troubles().starts_with("servo 7: its Bus Watchdog has stopped it although"),
        "{}",
        rig.line.troubles()
    );
    let told = |rig: &Rig| rig.bus.written.iter().filter(|(_, id, first, _)| *id == 7 && *first != 64).count();
    assert!(rig.torques() == [true, true, false] && told(&rig) < 20, "{}", told(&rig));
    // Its power is cut, or the operator releases all.
    rig.restart(2);
    rig.run(3.0);
    assert_eq!((rig.torques(), rig.line.troubles()), (vec![true; 3], String::new()));
}

#[test]
fn an_alarm_is_told_and_a_dynamixel_x_that_stopped_itself_gets_nothing_more() {
    for (kind, alarms, want) in [
        (Kind::DynamixelX, 1 << 5, "it is overloaded"),
        (Kind::DynamixelAx, 1 << 2, "it is too hot"),
        (Kind::FeetechSts, 1 << 5, "it is overloaded"),
        (Kind::FeetechScs, 1 << 1, "its position sensor fails"),
    ] {
        let mut rig = Rig::of_three(kind);
        rig.run(3.0);
        let torque = usize::from(kind.family().torque);
        rig.bus.servos[1].alarms = alarms;
        rig.run(1.0);
        assert!(rig.line.troubles().starts_with(&format!("servo 2: {want}")) && rig.torques()[1], "only told");
        rig.bus.servos[1].registers[torque] = 0;
        // An X servo is stopped by its alarm, and those with protocol 1.0 get a goal in between.
        rig.bus.servos[1].answers = Answers::Well;
        rig.run(0.04);
        rig.bus.servos[1].registers[torque] = 0;
        rig.run(1.0);
        if kind == Kind::DynamixelX {
            rig.bus.written.clear();
            rig.run(5.0);
            assert!(rig.bus.written.iter().all(|(_, id, ..)| *id != 2), "{:?}", rig.bus.written.last());
            assert!(rig.line.troubles().contains(want) && !rig.torques()[1]);
        }
    }
    let mut rig = Rig::of_three(Kind::FeetechSts);
    rig.bus.servos[1].alarms = 1 << 5;
    rig.run(3.0);
    assert_eq!(rig.torques(), [true, false, true], "an alarm before the start");
    rig.bus.servos[1].alarms = 0;
    for (address, byte, want) in [
        (63, 66, "servo 2: it is at 66 °C, and its limit is 70 °C"),
        (62, 30, "servo 2: its supply has 3.0 V"),
        (61, 3, "servo 2: it pushes"),
    ] {
        let before = std::mem::replace(&mut rig.bus.servos[1].registers[address], byte);
        rig.bus.servos[1].registers[60] = 0xE8;
        rig.run(1.0);
        assert!(rig.line.troubles().starts_with(want), "{}", rig.line.troubles());
        rig.bus.servos[1].registers[address] = before;
    }
    rig.bus.servos[1].registers[60] = 0;
    rig.run(1.0);
    assert_eq!(rig.line.troubles(), "", "what is over is not told any more");
}

#[test]
fn a_busy_line_gets_nothing_and_then_the_newest_goal() {
    let channels: Vec<_> = (1..=30).map(|id| channel(id, 300.0, 700.0)).collect();
    let mut rig = Rig::new(Kind::DynamixelX, &channels);
    rig.run(10.0);
    assert_eq!(rig.torques(), [true; 30]);
    // 30 goals of 12 bytes, each with its ID.
    let carried = Duration::from_micros((14 + 30 * 13) * 10);
    let mut out = Vec::new();
    for (after, is_made) in [(carried / 2, false), (carried * 9 / 10, false), (carried * 2, true), (carried * 2, false)]
    {
        let now = rig.now + after;
        assert_eq!(rig.line.step(&Packet::NEUTRAL, &[], now, &mut out), is_made, "{after:?}");
    }
    // Of protocol 1.0, no frame exceeds the buffer of a servo.
    let mut rig = Rig::new(Kind::FeetechSts, &channels);
    rig.run(5.0);
    let message = rig.message();
    assert!(
        message.windows(3).filter(|start| start == &[0xFF, 0xFF, 0xFE]).count() >= 2 && rig.torques() == [true; 30]
    );
}

#[test]
fn whatever_settings_and_answers_say_only_goals_within_the_limits_torque_and_watchdog_are_written() {
    let mut random = fastrand::Rng::with_seed(25);
    let wild = |random: &mut fastrand::Rng| {
        let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1.0, 5000.0, 1023.0, random.f32() * 4095.0];
        values[random.usize(..values.len())]
    };
    for round in 0..300 {
        let kind = KINDS[round % 5];
        let channels: Vec<_> = (1..4)
            .map(|id| ChannelSettings {
                sources: valued(&[("jawOpen", wild(&mut random))]),
                offset: wild(&mut random),
                neutral: wild(&mut random),
                speed_per_s: wild(&mut random),
                acceleration_per_s2: wild(&mut random),
                ..channel(id, wild(&mut random), wild(&mut random))
            })
            .collect();
        let mut rig = Rig::new(kind, &channels);
        let family = kind.family();
        for _ in 0..300 {
            rig.jaw_open = wild(&mut random);
            rig.state = if random.u8(..20) == 0 { State::Neutral } else { State::Live };
            let servo = &mut rig.bus.servos[random.usize(..3)];
            match random.u8(..12) {
                0 => servo.restart(rig.now + Duration::from_millis(random.u64(..900))),
                1 => servo.answers = Answers::Damaged,
                2 => servo.answers = Answers::Late(Duration::from_millis(random.u64(..200))),
                3 => servo.alarms = random.u8(..),
                4 => servo.position = f64::from(random.u16(..)),
                5 => servo.registers[random.usize(..160)] = random.u8(..),
                _ => (servo.answers, servo.alarms) = (Answers::Well, 0),
            }
            let message = rig.message();
            rig.back = rig.bus.take(&message, rig.now);
            if random.u8(..5) == 0 {
                let kind = family.protocol == Protocol::Two;
                let data: Vec<u8> = (0..random.usize(..60)).map(|_| random.u8(..)).collect();
                rig.back.extend(status(kind, random.u8(..5), random.u8(..), &data));
                rig.back.extend(data);
            }
        }
        assert!(rig.bus.strange.is_empty());
        for (_, id, first, data) in &rig.bus.written {
            let is_allowed = match (family.name, *first) {
                ("dynamixel-x", 98) => data == &[0] || data == &[25],
                ("dynamixel-x", 64) | ("dynamixel-ax" | "dynamixel-mx", 24) | ("feetech-sts" | "feetech-scs", 40) => {
                    data == &[0] || data == &[1]
                }
                ("dynamixel-x", 108)
                | ("dynamixel-ax" | "dynamixel-mx", 30)
                | ("feetech-sts", 41)
                | ("feetech-scs", 42) => {
                    let place = match family.name {
                        "dynamixel-x" => u32::from_le_bytes(data[8..].try_into().unwrap()),
                        "feetech-sts" => u16::from_le_bytes([data[1], data[2]]).into(),
                        "feetech-scs" => u16::from_be_bytes([data[0], data[1]]).into(),
                        _ => u16::from_le_bytes([data[0], data[1]]).into(),
                    };
                    place <= family.most_steps.into()
                }
                _ => false,
            };
            assert!(is_allowed && (1..4).contains(id), "{}: {id} {first} {data:?}", family.name);
        }
    }
}

/// A line with simulated servos as a port. Reading waits for nothing.
struct Wire(Simulator, Vec<u8>);

impl io::Read for Wire {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let length = bytes.len().min(self.1.len());
        bytes.iter_mut().zip(self.1.drain(..length)).for_each(|(to, from)| *to = from);
        if length == 0 { Err(io::ErrorKind::TimedOut.into()) } else { Ok(length) }
    }
}

impl io::Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.1 = self.0.take(bytes, Instant::now());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn servos_are_found_with_model_and_family_even_with_an_echo_and_one_is_moved_by_keys_from_where_it_stands() {
    for (kind, model, echoes) in KINDS
        .into_iter()
        .zip([1200, 12, 29, 777, 1284])
        .flat_map(|(kind, model)| [(kind, model, true), (kind, model, false)])
    {
        let (family, now) = (kind.family(), Instant::now());
        let mut wire = Wire(Simulator::new(family.name, &[9, 200], now), Vec::new());
        wire.0.echoes = echoes;
        let found: Vec<_> =
            (0..=252).filter_map(|id| Some((id, find(&mut wire, family.protocol, id).unwrap()?))).collect();
        assert_eq!(found, [(9, (model, Some(kind))), (200, (model, Some(kind)))], "{}", family.name);
        let other = if family.protocol == Protocol::One { Protocol::Two } else { Protocol::One };
        assert_eq!(find(&mut wire, other, 9).unwrap(), None);
        let mut servo = Single::open(&mut wire, kind, 9).unwrap();
        assert!(servo.place() == 500.0 && servo.reach()[1] >= 1000.0);
        assert!([Some(700.0), Some(600.0), None].into_iter().all(|place| servo.set(place).is_ok()));
        let torque = usize::from(family.torque);
        let written: Vec<_> = wire
            .0
            .written
            .iter()
            .filter(|(_, _, first, _)| *first != 98)
            .map(|(_, id, first, data)| (*id, *first == torque, data.len() == 1 && data[0] == 1))
            .collect();
        assert_eq!(
            written,
            [(9, false, false), (9, true, true), (9, false, false), (9, true, false)],
            "{}",
            family.name
        );
        wire.0.servos[0].alarms = 1;
        assert!(
            Single::open(&mut wire, kind, 9).is_err_and(|trouble| trouble.starts_with("servo 9: its supply voltage"))
        );
        assert!(
            Single::open(&mut wire, kind, 3).is_err_and(|trouble| trouble.starts_with("servo 3: it does not answer"))
        );
    }
}

#[test]
fn goals_take_at_most_half_of_a_line_and_answers_the_rest() {
    let fits = |kind: Kind, servos, baud| kind.family().line_bytes(servos) * 10 * 50 <= baud;
    for (kind, servos, baud, want) in [
        // 16 goals of the X series have 222 bytes, 38.5 ms at 57,600 baud, and 3 of them 53.
        (Kind::DynamixelX, 16, 57_600, false),
        (Kind::DynamixelX, 4, 57_600, false),
        (Kind::DynamixelX, 3, 57_600, true),
        (Kind::DynamixelX, 30, 1_000_000, true),
        (Kind::FeetechSts, 30, 1_000_000, true),
        (Kind::DynamixelAx, 30, 115_200, false),
    ] {
        assert_eq!(fits(kind, servos, baud), want, "{kind:?} {servos} {baud}");
    }
}
