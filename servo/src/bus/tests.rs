use std::sync::atomic::Ordering::Relaxed;

use facewire_packet::{Reason, State};

use super::simulator::{Simulator, Written};
use super::*;
use crate::channel::tests::valued;
use crate::{AtLoss, Operator};

const STEP: Duration = Duration::from_millis(20);
const X: &Family = FAMILIES[0].1;
const AX: &Family = FAMILIES[1].1;
const MX: &Family = FAMILIES[2].1;
const STS: &Family = FAMILIES[3].1;
const SCS: &Family = FAMILIES[4].1;

const ALL: [&Family; 5] = [X, AX, MX, STS, SCS];

/// The fastest goal of a servo that starts, steps a second.
fn slow(family: &Family) -> f64 {
    (60.0 / family.degrees_per_step).into()
}

fn channel(id: u32, at_0: f32, at_1: f32) -> ChannelSettings {
    let (position_at_0, position_at_1, sources) = (at_0, at_1, valued(&[("jawOpen", 1.0)]));
    ChannelSettings { channel: id, position_at_0, position_at_1, sources, ..ChannelSettings::default() }
}

/// The servos of [`Rig::of_three`] while the jaw is open.
const OPEN: [(bool, f64); 3] = [(true, 700.0), (true, 300.0), (true, 700.0)];

/// A line with simulated servos at its end, and what the face does.
struct Rig {
    line: Line,
    bus: Simulator,
    now: Instant,
    operator: Arc<Operator>,
    state: State,
    jaw_open: f32,
    /// What has come back since the last message.
    back: Vec<u8>,
}

impl Rig {
    fn new(family: &'static Family, channels: &[ChannelSettings]) -> Self {
        let (now, operator) = (Instant::now(), Arc::<Operator>::default());
        let dials = Arc::new(Dials::new(channels, &operator));
        let line = Line::new(family, Unit::Steps, 1_000_000, channels, &dials);
        let ids: Vec<u8> = channels.iter().map(|channel| channel.channel as u8).collect();
        let bus = Simulator::new(family, &ids, now);
        Self { line, bus, now, operator, state: State::Live, jaw_open: 0.0, back: Vec::new() }
    }

    /// Three servos that stand at 500 steps, of which the first one keeps a speed, and the second is released without a face.
    fn of_three(family: &'static Family) -> Self {
        let limited = ChannelSettings { speed_per_s: 0.5, acceleration_per_s2: 5.0, ..channel(1, 300.0, 700.0) };
        let released = ChannelSettings { loss: AtLoss::Release, ..channel(2, 700.0, 300.0) };
        Self { jaw_open: 1.0, ..Self::new(family, &[limited, released, channel(7, 300.0, 700.0)]) }
    }

    /// The line's message of the next step.
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

    fn run(&mut self, seconds: f32) -> &mut Self {
        for _ in 0..(seconds / STEP.as_secs_f32()) as usize {
            let message = self.message();
            self.back = self.bus.take(&message, self.now + Duration::from_millis(1));
        }
        self
    }

    /// Cuts the power of a servo, which needs 0.8 s to start again.
    fn restart(&mut self, index: usize) {
        self.bus.servos[index].restart(self.now + Duration::from_millis(800));
    }

    /// Torque and place of each servo.
    fn servos(&self) -> Vec<(bool, f64)> {
        self.bus.servos.iter().map(|servo| (servo.has_torque(), servo.place.round())).collect()
    }

    /// What a servo was told of goal and torque since it was released.
    fn told(&self, id: u8) -> Vec<&Written> {
        let is_off = |it: &Written| it.data == [0];
        let told: Vec<_> = self.bus.written.iter().filter(|it| it.id == id && it.first != 98).collect();
        told.rsplit(|it| is_off(it)).next().unwrap_or_default().to_vec()
    }

    /// Asserts that a servo got a goal where it stood, then torque, and then only goals that are slow or near its place.
    fn assert_slow_start(&self, id: u8) {
        let (told, name) = (self.told(id), self.line.family.name);
        let is_where_it_stood = told[0].data.len() > 1 && (told[0].place - told[0].stood).abs() <= 0.5;
        assert!(is_where_it_stood && told[1].data == [1], "{name}: {:?} {:?}", told[0], told[1]);
        for goal in told.into_iter().filter(|it| it.data.len() > 1) {
            let is_slow = goal.speed > 0.0 && goal.speed <= slow(self.line.family);
            assert!(is_slow || (goal.place - goal.stood).abs() <= 0.02 * 400.0, "{name}: {goal:?}");
        }
    }
}

const STUFFED: &str = "FF FF FD 00 01 0E 00 55 00 FF FF FD FD FD 00 FF FF FD FD 55 0A";

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

#[test]
fn every_frame_equals_the_vectors_of_the_makers() {
    let made = |write: &dyn Fn(&mut Vec<u8>)| {
        let mut out = Vec::new();
        write(&mut out);
        out
    };
    // All registers are 0 but the limits, of which the lower one of an STS is 16, and its phase, for the fine unit of speed.
    let moved = |family: &'static Family, phase: u8, goals: &[(u8, [f32; 3])]| {
        let most = if family == SCS { [11, 11] } else { [9, 12] };
        let (mut registers, limits) = (unknown(), if family == X { [45, 49] } else { most });
        limits.into_iter().for_each(|at| registers[at] = 16);
        registers[18] = phase;
        let goals: Vec<_> = goals.iter().map(|(id, goal)| (*id, family.goal(*goal, &registers))).collect();
        made(&|out| family.write_goals(&goals, out))
    };
    let [x_speed, x_acceleration] = [100.5 * 0.229 * 4096.0 / 60.0, 20.5 * 214.577 * 4096.0 / 3600.0];
    let ax_speed = |number: u16| (f32::from(number) + 0.1) * 0.111 * 6.0 * 1023.0 / 300.0;
    for (out, want) in [
        (made(&|out| X.write_watchdog(&[1, 2], true, out)), "FF FF FD 00 FE 0B 00 83 62 00 01 00 01 19 02 19 B4 C5"),
        (made(&|out| X.write_watchdog(&[1, 2], false, out)), "FF FF FD 00 FE 0B 00 83 62 00 01 00 01 00 02 00 16 C4"),
        (
            moved(X, 0, &[(1, [2048.0, x_speed, x_acceleration])]),
            "FF FF FD 00 FE 14 00 83 6C 00 0C 00 01 14 00 00 00 64 00 00 00 00 08 00 00 57 38",
        ),
        (
            moved(AX, 0, &[(0, [16.0, ax_speed(0x150), 0.0]), (1, [544.0, ax_speed(0x360), 0.0])]),
            "FF FF FE 0E 83 1E 04 00 10 00 50 01 01 20 02 60 03 67",
        ),
        (
            moved(STS, 4, &[(1, [4095.0, 60.0, 5000.0]), (2, [2048.0, 60.0, 5000.0])]),
            "FF FF FE 14 83 29 07 01 32 FF 0F 00 00 3C 00 02 32 00 08 00 00 3C 00 45",
        ),
        (
            moved(SCS, 0, &[(1, [1000.0, 1500.0, 0.0]), (2, [20.0, 1500.0, 0.0])]),
            "FF FF FE 12 83 2A 06 01 03 E8 00 00 05 DC 02 00 14 00 00 05 DC 78",
        ),
        (made(&|out| STS.write_torque(&[1, 2], true, out)), "FF FF FE 08 83 28 01 01 01 02 01 48"),
        (made(&|out| STS.write_torque(&[1, 2], false, out)), "FF FF FE 08 83 28 01 01 00 02 00 4A"),
        (made(&|out| STS.write_watchdog(&[1, 2], true, out)), ""),
        (made(&|out| X.protocol.write_read(1, (132, 4), out)), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
        (made(&|out| STS.protocol.write_read(1, (56, 2), out)), "FF FF 01 04 02 38 02 BE"),
        (
            made(&|out| Protocol::Two.write(1, bytes("03 74 00 FF FF FD FF"), out)),
            "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD FF 23 E5",
        ),
    ] {
        assert_eq!(out, bytes(want), "{want}");
    }
    // A goal is within the limits of the servo, and the same speed is another number in the coarse unit.
    for (place, want) in [(9999.0, [0xFF, 0x0F]), (f32::INFINITY, [0xFF, 0x0F]), (-5.0, [16, 0]), (f32::NAN, [16, 0])] {
        let goal = moved(STS, 0, &[(1, [place, 600.0, 0.0])]);
        assert_eq!((&goal[9..11], &goal[13..15]), (&want[..], &[12, 0][..]), "{place}");
    }
}

#[test]
fn limits_are_counted_in_the_units_of_each_model_and_never_exceed_what_its_manual_allows() {
    // By the makers' manuals, and not by the table: the unit of speed in revolutions a minute, and the highest number.
    let x = (0.229, 32_767);
    let ax = (0.111, 1023);
    let mx = (0.114, 1023);
    for (family, model, (rpm, most)) in [
        (MX, 360, (0.916, 1023)),
        (X, 1200, x),
        (X, 1060, x),
        (X, 1020, x),
        (X, 1310, x),
        (X, 30, x),
        (X, 321, x),
        (AX, 12, ax),
        (AX, 18, ax),
        (AX, 300, ax),
        (AX, 24, ax),
        (AX, 28, ax),
        (AX, 64, ax),
        (MX, 29, mx),
        (MX, 310, mx),
        (MX, 320, mx),
        (STS, 777, (0.732, 255)),
        (STS, 2825, (0.732, 255)),
        (SCS, 1284, (60.0 / 1023.0 * 300.0 / 360.0, 12_750)),
    ] {
        let mut registers = unknown();
        family.set(&mut registers, family.model, model);
        assert_eq!(family.refusal(&registers, [0.0; 2]).filter(|why| why.contains("model")), None);
        let number = |units: f32| {
            let steps_per_s = units * rpm * 6.0 / family.degrees_per_step;
            let mut goal = unknown();
            store(family.goal, &family.goal([0.0, steps_per_s, 0.0], &registers), &mut goal);
            family.get(&goal, family.goal_parts[1])
        };
        let most_units = most as f32;
        assert_eq!([0.5, 10.5, 2.0 * most_units].map(number), [1, 10, most], "{} {model}", family.name);
    }
    // An acceleration of an X has 15 bits, and one of an STS a byte. A servo's own limits apply.
    let acceleration = |family: &Family, registers: &Registers, limit| {
        let mut goal = unknown();
        store(family.goal, &family.goal([0.0, 1000.0, limit], registers), &mut goal);
        family.get(&goal, family.goal_parts[2])
    };
    let mut registers = unknown();
    assert_eq!([1e5, 1e9].map(|limit| acceleration(X, &registers, limit)), [409, 32_767]);
    assert_eq!([1e4, 1e9].map(|limit| acceleration(STS, &registers, limit)), [100, 254]);
    store((40, 4), &200_u32.to_le_bytes(), &mut registers);
    assert_eq!(acceleration(X, &registers, 1e5), 200);
    // The fine unit of an STS is a fiftieth.
    let mut registers = unknown();
    store((18, 1), &[0b100], &mut registers);
    let speeds = [60.0, 1e9].map(|speed| STS.goal([0.0, speed, 0.0], &registers)[5..7].to_vec());
    assert_eq!(speeds, [60_u16, 12_750].map(|speed| speed.to_le_bytes().to_vec()));
}

#[test]
fn an_x_with_a_limit_of_acceleration_alone_gets_the_highest_speed_that_it_allows_so_that_it_keeps_the_limit() {
    let goal = |speed_limit: u32, limits: [f32; 2]| {
        let mut registers = unknown();
        store((44, 4), &speed_limit.to_le_bytes(), &mut registers);
        let [speed, acceleration] = limits;
        let goal = X.goal([0.0, speed, acceleration], &registers);
        [&goal[4..8], &goal[..4]].map(|number| u32::from_le_bytes(number.try_into().unwrap()))
    };
    // 0.229 rpm are 15.6 steps/s, and 214.577 rev/min² are 244 steps/s².
    for none in [0.0, f32::INFINITY, f32::NAN] {
        assert_eq!(goal(445, [none, 1000.0]), [445, 4]);
        assert_eq!(goal(0, [none, 1000.0]), [32_767, 4]);
        assert_eq!(goal(445, [none; 2]), [0, 0], "without limits there is no profile");
        assert_eq!(goal(445, [1000.0, none]), [63, 0]);
    }
    // An STS keeps it at a speed of 0, too.
    let mut registers = unknown();
    store((18, 1), &[0b1100], &mut registers);
    assert_eq!(STS.goal([0.0, 0.0, 1000.0], &registers), [10, 0, 0, 0, 0, 0, 0]);
}

#[test]
fn feetech_servos_without_a_limit_of_speed_move_whether_or_not_a_speed_of_0_stops_them() {
    for (family, phase) in [STS, SCS].into_iter().flat_map(|family| [0, 0b100, 0b1000, 0b1100].map(|it| (family, it))) {
        let mut rig = Rig::of_three(family);
        rig.bus.servos.iter_mut().for_each(|servo| servo.registers[18] = phase);
        assert_eq!((rig.run(4.0).servos(), &*rig.line.troubles()), (OPEN.to_vec(), ""), "{} {phase}", family.name);
        rig.jaw_open = 0.0;
        rig.run(0.1);
        assert_eq!(rig.servos()[1..], [(true, 700.0), (true, 300.0)], "{} {phase}: without a limit", family.name);
    }
}

#[test]
fn answers_are_found_in_any_pieces_among_noise_and_those_with_a_wrong_bit_are_damaged() {
    for (protocol, answer, id, error, data) in [
        (Protocol::Two, "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", 1, 0, "A6 00 00 00"),
        (Protocol::Two, "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", 1, 0, "06 04 26"),
        (Protocol::Two, STUFFED, 1, 0, "FF FF FD FD 00 FF FF FD"),
        (Protocol::One, "FF FF 01 04 00 18 05 DD", 1, 0, "18 05"),
        (Protocol::One, "FF FF 02 0A 00 FF 07 00 00 00 00 77 23 53", 2, 0, "FF 07 00 00 00 00 77 23"),
        (Protocol::One, "FF FF 01 02 24 D8", 1, 0x24, ""),
    ] {
        let (frame, data) = (bytes(answer), bytes(data));
        let read = |bytes: &[u8]| {
            let mut reader = Reader::default();
            bytes.iter().filter_map(|byte| reader.push(protocol, *byte)).filter_map(Result::ok).last()
        };
        for noise in [&[][..], &[0xFF], &[0xFF, 0xFF], &[0, 0xFF, 0xFE], &[0xFF, 0xFF, 0xFD]] {
            let found = read(&[noise, &frame].concat()).unwrap();
            assert_eq!((found.id, protocol.answer(&found)), (id, Some((error, &data[..]))), "{noise:x?} {answer}");
        }
        for bit in 0..8 * frame.len() {
            let mut broken = frame.clone();
            broken[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(read(&broken), None, "bit {bit} of {answer}");
        }
    }
}

#[test]
fn servos_of_every_family_begin_where_they_stand_go_slowly_and_then_follow_within_their_limits() {
    for (family, has_echo) in ALL.into_iter().flat_map(|family| [(family, false), (family, true)]) {
        let (mut rig, name) = (Rig::of_three(family), family.name);
        rig.bus.echoes = has_echo;
        rig.run(4.0);
        assert_eq!((rig.servos(), &*rig.line.troubles()), (OPEN.to_vec(), ""), "{name} {has_echo}");
        [1, 2, 7].into_iter().for_each(|id| rig.assert_slow_start(id));
        assert!(rig.line.is_at_rest(), "{name}");
        // A jaw that shuts for a moment between two readings of a servo is no rest.
        rig.jaw_open = 0.0;
        rig.run(0.04).jaw_open = 1.0;
        assert!(!rig.run(0.02).line.is_at_rest() && rig.run(1.0).line.is_at_rest(), "{name}");
        rig.jaw_open = 0.0;
        rig.run(0.1);
        assert_eq!(rig.servos()[1..], [(true, 700.0), (true, 300.0)], "{name}: without a limit");
        rig.run(2.5);
        // 0.5 of 400 steps a second, which are 4 in 20 ms.
        let goals: Vec<_> = rig.told(1).into_iter().filter(|it| it.data.len() > 1).collect();
        assert!(rig.servos()[0].1 == 300.0 && goals.iter().all(|it| (1.0..=200.0).contains(&it.speed)), "{name}");
        let is_even = goals.windows(2).all(|two| (two[0].place - two[1].place).abs() <= 5.0);
        assert!(is_even || family.units[1] > 0.0, "{name}");
        assert_eq!(rig.bus.strange, 0, "{name}");
    }
}

#[test]
fn without_a_face_servos_go_to_rest_and_stay_or_have_no_torque_and_an_operator_takes_it_from_all() {
    for family in ALL {
        let mut rig = Rig::of_three(family);
        rig.run(4.0);
        rig.state = State::Neutral;
        assert_eq!(rig.run(1.5).servos()[1..], [(false, 700.0), (true, 300.0)]);
        rig.state = State::Live;
        assert_eq!(rig.run(3.0).servos(), OPEN);
        // What is held fast on its way to rest has torque for a second.
        (rig.bus.servos[1].motor, rig.state) = (0.0, State::Neutral);
        assert!(rig.run(0.8).servos()[1].0 && !rig.run(0.4).servos()[1].0);
        (rig.bus.servos[1].motor, rig.state) = (5000.0, State::Live);
        rig.run(3.0);
        // In mid move, all at once.
        rig.jaw_open = 0.0;
        rig.run(0.2);
        assert!(!rig.line.board.dials.has_released());
        rig.operator.is_released.store(true, Relaxed);
        let servos = rig.run(0.02).servos();
        assert!(servos.iter().all(|servo| !servo.0) && (301.0..699.0).contains(&servos[0].1), "{servos:?}");
        // Somebody turns it, and it begins there.
        (rig.jaw_open, rig.bus.servos[2].place) = (1.0, 400.0);
        assert_eq!(rig.run(1.0).servos()[2], (false, 400.0));
        assert!(rig.line.board.dials.has_released(), "all three were read without torque");
        rig.bus.servos[1].answers_after = None;
        assert!(!rig.run(1.0).line.board.dials.has_released(), "one has fallen silent");
        rig.bus.servos[1].answers_after = rig.bus.servos[0].answers_after;
        rig.run(1.0).operator.is_released.store(false, Relaxed);
        assert!(!rig.run(0.1).line.board.dials.has_released());
        assert_eq!(rig.run(3.0).servos(), OPEN);
        rig.assert_slow_start(7);
    }
}

#[test]
fn a_servo_that_is_missing_duplicated_damaged_or_refused_is_told_and_left_without_torque_while_others_move() {
    let twice: fn(&mut Rig) = |rig| rig.bus.plug_in(2, rig.now);
    let never: fn(&mut Rig) = |rig| rig.bus.servos[1].answers_after = None;
    let damaged: fn(&mut Rig) = |rig| rig.bus.servos[1].is_damaged = true;
    let unlimited: fn(&mut Rig) = |rig| rig.bus.servos[1].registers[9..13].fill(0);
    let set = |address: usize, byte: u8| move |rig: &mut Rig| rig.bus.servos[1].registers[address] = byte;
    let cases: [(_, &dyn Fn(&mut Rig), _); 11] = [
        (X, &never, "it does not answer: check its power"),
        (STS, &damaged, "its answers are damaged: check"),
        (X, &twice, "two servos have this number: unplug one"),
        (SCS, &twice, "two servos have this number: unplug one"),
        (STS, &set(2, 1), "its registers have the high byte first: set family = \"feetech-scs\""),
        (STS, &set(3, 10), "it is of the series HLS, which has other registers: use one of the series"),
        (STS, &set(30, 4), "set its angle resolution to 1, with the maker's"),
        (X, &set(11, 1), "set its operating mode to position control, with the maker's"),
        (AX, &set(0, 29), "its model 29 is not one of dynamixel-ax: set another family"),
        (MX, &set(9, 0), "an end is at 700 steps, but the servo allows 0 to 255: change the"),
        (SCS, &unlimited, "its limits are 0 and 0: set it to"),
    ];
    for (family, fault, want) in cases {
        // From the beginning, and while it moves.
        for seconds in [0.0, 3.0] {
            let mut rig = Rig::of_three(family);
            rig.run(seconds);
            if seconds > 0.0 && ["set", "change", "HLS"].iter().any(|word| want.contains(word)) {
                rig.restart(1);
            }
            fault(&mut rig);
            rig.run(4.0);
            let told = rig.line.troubles();
            assert!(told.starts_with(&format!("servo 2: {want}")) && !told.contains('\n'), "{want}: {told}");
            let servos = rig.servos();
            assert!(servos[0] == OPEN[0] && !servos[1].0 && servos[2] == OPEN[2], "{want}: {servos:?}");
        }
    }
}

#[test]
fn answers_that_are_lost_or_late_now_and_then_change_nothing() {
    for family in ALL {
        let mut rig = Rig::of_three(family);
        let late = [Some(0), Some(70), Some(0), None].map(|ms| ms.map(Duration::from_millis));
        for round in 0..200 {
            rig.bus.servos.iter_mut().for_each(|servo| servo.answers_after = late[round % 4]);
            assert_eq!(rig.run(0.1).line.troubles(), "");
        }
        assert_eq!(rig.servos(), OPEN);
        rig.bus.servos.iter_mut().for_each(|servo| servo.answers_after = late[0]);
        rig.bus.plug_in(2, rig.now);
        assert!(rig.run(3.0).line.troubles().contains("two servos"));
    }
}

#[test]
fn a_servo_that_lost_its_power_in_mid_move_begins_again_where_it_stands() {
    for family in ALL {
        let servo = |id| ChannelSettings { speed_per_s: if id == 1 { 0.5 } else { 0.0 }, ..channel(id, 300.0, 700.0) };
        let mut rig = Rig::new(family, &(1..=12).map(servo).collect::<Vec<_>>());
        rig.run(4.0);
        rig.jaw_open = 1.0;
        let before = rig.run(0.5).servos()[0].1;
        assert!((350.0..450.0).contains(&before), "{before}");
        // The second one has no limit of its own.
        rig.jaw_open = 0.0;
        (0..2).for_each(|index| rig.restart(index));
        rig.run(5.0);
        assert_eq!((&rig.servos()[..2], &*rig.line.troubles()), (&[(true, 300.0); 2][..], ""), "{}", family.name);
        [1, 2].into_iter().for_each(|id| rig.assert_slow_start(id));
    }
}

#[test]
fn a_line_that_falls_silent_in_mid_move_gets_no_goals_is_at_rest_within_1_5_s_and_comes_back_slowly_by_itself() {
    let cuts = [(0.3, true), (0.7, true), (0.7, false), (1.5, true), (1.5, false)];
    let cases = ALL.into_iter().flat_map(|family| [(family, 3), (family, 8)]);
    for ((family, count), (seconds, has_power)) in cases.flat_map(|case| cuts.map(|cut| (case, cut))) {
        let mut rig = Rig::new(family, &(1..=count).map(|id| channel(id, 300.0, 700.0)).collect::<Vec<_>>());
        let name = format!("{count} {} {seconds} {has_power}", family.name);
        rig.run(3.0);
        rig.bus.servos.iter_mut().for_each(|servo| servo.motor = 300.0);
        rig.jaw_open = 1.0;
        rig.run(0.5);
        if !has_power {
            let back = rig.now + Duration::from_secs_f32(seconds);
            rig.bus.servos.iter_mut().for_each(|servo| servo.restart(back));
        }
        // Nothing reaches the servos, and nothing comes back.
        for step in 0..(seconds / STEP.as_secs_f32()) as usize {
            let message = rig.message();
            let has_goals = message.windows(2).any(|start| start == [0x83, family.goal.0]);
            assert!(step < 12 || !has_goals, "{name}: goals after 0.24 s");
        }
        if seconds == 1.5 {
            assert!(rig.line.is_at_rest() && rig.line.troubles().lines().count() == count as usize, "{name}");
            // As the documents say: at once, after half a second, and at the last goal.
            let places = if !has_power {
                430.0..470.0
            } else if family == X {
                570.0..630.0
            } else {
                700.0..701.0
            };
            let stand = |servo: &(bool, f64)| servo.0 == has_power && places.contains(&servo.1);
            assert!(rig.servos().iter().all(stand), "{name}: {:?}", rig.servos());
        }
        rig.bus.written.clear();
        rig.run(5.0);
        assert_eq!((rig.servos(), &*rig.line.troubles()), (vec![(true, 700.0); count as usize], ""), "{name}");
        if !has_power || family == X && seconds > 0.5 || seconds > 1.0 {
            (1..=count).for_each(|id| rig.assert_slow_start(id as u8));
        }
    }
}

#[test]
fn a_servo_whose_answer_comes_after_a_silence_of_the_line_gets_no_torque_without_a_goal_where_it_stands() {
    let after = |steps| [400, 600].map(|silence_ms| (steps, silence_ms));
    for (family, (steps, silence_ms)) in
        ALL.into_iter().flat_map(|family| (1..12).flat_map(after).map(move |case| (family, case)))
    {
        let mut rig = Rig::new(family, &[channel(1, 300.0, 700.0)]);
        for _ in 0..steps {
            rig.run(STEP.as_secs_f32());
        }
        rig.now += Duration::from_millis(silence_ms);
        let told = rig.run(1.0).told(1);
        let holds = told[0].data.len() > 1 && (told[0].place - told[0].stood).abs() <= 0.5 && told[1].data == [1];
        assert!(holds, "{} {steps} {silence_ms}: {:?} {:?}", family.name, told[0], told[1]);
    }
}

#[test]
fn one_of_30_servos_that_falls_silent_holds_each_of_the_others_up_for_at_most_0_6_s() {
    for family in ALL {
        let mut rig = Rig::new(family, &(1..=30).map(|id| channel(id, 300.0, 700.0)).collect::<Vec<_>>());
        rig.run(5.0).bus.servos[0].answers_after = None;
        let mut held_up = [0.0_f32; 29];
        for _ in 0..150 {
            rig.bus.written.clear();
            rig.run(STEP.as_secs_f32());
            let has_goal = |id: usize| rig.bus.written.iter().any(|it| usize::from(it.id) == id && it.data.len() > 1);
            (2..).zip(&mut held_up).filter(|(id, _)| !has_goal(*id)).for_each(|(_, time_s)| *time_s += 0.02);
        }
        let longest_s = held_up.into_iter().fold(0.0, f32::max);
        assert!((0.1..0.61).contains(&longest_s) && rig.servos()[29].0, "{}: {held_up:?}", family.name);
        assert!(
            rig.line.troubles().starts_with("servo 1: it does not answer") && rig.line.troubles().lines().count() == 1
        );
    }
}

#[test]
fn a_watchdog_is_cleared_after_a_silence_of_the_line_and_otherwise_told_and_not_cleared() {
    let mut rig = Rig::of_three(X);
    rig.jaw_open = 0.0;
    rig.run(4.0);
    rig.jaw_open = 1.0;
    rig.run(0.2);
    // The line itself is silent.
    rig.now += Duration::from_secs(2);
    rig.bus.take(&[], rig.now);
    assert_eq!(rig.bus.servos[0].registers[98], 0xFF);
    let stopped = rig.servos()[0].1;
    assert!((rig.run(0.1).servos()[0].1 - stopped).abs() < 5.0);
    rig.run(3.0);
    assert_eq!((rig.servos(), &*rig.line.troubles(), rig.bus.servos[0].registers[98]), (OPEN.to_vec(), "", 25));
    // One servo heard nothing.
    rig.bus.servos[2].registers[98] = 0xFF;
    rig.bus.written.clear();
    let told = rig.run(5.0).line.troubles();
    assert!(told.starts_with("servo 7: its Bus Watchdog has stopped it although"), "{told}");
    let count = rig.bus.written.iter().filter(|it| it.id == 7 && it.first != 64).count();
    assert!(!rig.servos()[2].0 && count < 20, "{count}");
    // The operator releases all, or its power is cut for a moment.
    for is_cut in [false, true] {
        rig.bus.servos[2].registers[98] = 0xFF;
        assert!(!rig.run(1.0).servos()[2].0);
        if is_cut {
            rig.bus.servos[2].restart(rig.now);
        }
        rig.operator.is_released.store(!is_cut, Relaxed);
        rig.run(0.1).operator.is_released.store(false, Relaxed);
        assert_eq!((rig.run(3.0).servos(), &*rig.line.troubles()), (OPEN.to_vec(), ""));
    }
}

#[test]
fn an_alarm_is_told_and_a_dynamixel_x_that_stopped_itself_gets_nothing_more() {
    for (family, alarms, want) in [
        (X, 1 << 5, "it is overloaded"),
        (AX, 1 << 2, "it is too hot"),
        (STS, 1 << 5, "it is overloaded"),
        (STS, 1 << 1, "its position sensor fails"),
        (SCS, 1 << 5, "it is overloaded"),
    ] {
        let mut rig = Rig::of_three(family);
        rig.run(3.0);
        rig.bus.servos[1].alarms = alarms;
        let told = rig.run(1.0).line.troubles();
        assert!(told.starts_with(&format!("servo 2: {want}")) && rig.servos()[1].0, "only told: {told}");
    }
    let mut rig = Rig::of_three(X);
    rig.run(3.0);
    rig.bus.servos[1].alarms = 1 << 5;
    rig.bus.servos[1].registers[64] = 0;
    rig.run(1.0).bus.written.clear();
    rig.run(5.0);
    assert!(rig.bus.written.iter().all(|it| it.id != 2), "{:?}", rig.bus.written.last());
    assert!(rig.line.troubles().contains("it is overloaded") && !rig.servos()[1].0);
    let mut rig = Rig::of_three(STS);
    rig.bus.servos[1].alarms = 1 << 5;
    assert!(!rig.run(3.0).servos()[1].0, "an alarm before the start");
    rig.bus.servos[1].alarms = 0;
    for (first, bytes, want) in [
        (63, [66, 0], "servo 2: it is at 66 °C, and its limit is 70 °C"),
        (62, [30, 30], "servo 2: its supply has 3.0 V"),
        (60, [0xE8, 3], "servo 2: it pushes"),
    ] {
        let before = rig.bus.servos[1].registers.clone();
        rig.bus.servos[1].registers[first..first + 2].copy_from_slice(&bytes);
        let told = rig.run(1.0).line.troubles();
        assert!(told.starts_with(want), "{told}");
        rig.bus.servos[1].registers = before;
    }
    assert_eq!(rig.run(1.0).line.troubles(), "", "what is over is not told any more");
}

#[test]
fn volts_degrees_and_the_load_in_either_direction_from_0_to_1_are_shown_as_far_as_the_family_tells_them() {
    // By the makers' manuals: where the load is, whose bit 10 is its direction, and in which order its bytes are.
    for (family, load, celsius) in
        [(X, None, 146), (AX, Some(40), 43), (MX, Some(40), 43), (STS, Some(60), 63), (SCS, Some(60), 63)]
    {
        let mut rig = Rig::of_three(family);
        rig.run(1.0);
        for (told, want) in
            [(0, 0.0), (250, 0.25), (1000, 1.0), (1023, 1.0), (1024, 0.0), (1024 + 250, 0.25), (2047, 1.0)]
        {
            let told = if family == SCS { u16::to_be_bytes(told) } else { u16::to_le_bytes(told) };
            let registers = &mut rig.bus.servos[1].registers;
            registers[celsius] = 41;
            load.into_iter().for_each(|at: usize| registers[at..at + 2].copy_from_slice(&told));
            rig.run(1.0);
            let dial = &rig.line.board.dials.channels[1];
            let shown = dial.health.each_ref().map(crate::Number::get);
            assert_eq!(shown[1..3], [Some(41.0), load.map(|_| want)], "{} {told:?}", family.name);
            assert!(shown[0].is_some_and(|volts| (5.0..13.0).contains(&volts)), "{}: {shown:?}", family.name);
        }
    }
}

#[test]
fn a_servo_shows_the_position_where_it_is_even_beyond_its_ends_and_nothing_once_it_does_not_answer_or_is_not_read() {
    for family in ALL {
        let mut rig = Rig::of_three(family);
        let dials = Arc::clone(&rig.line.board.dials);
        let measured = |index: usize| dials.channels[index].measured.get();
        assert_eq!(measured(1), None, "{}: it was not read yet", family.name);
        rig.run(0.5).operator.is_released.store(true, Relaxed);
        rig.run(0.1);
        // The second one runs backwards, from 700 to 300.
        for (place, want) in [(600.0, 0.25), (300.0, 1.0), (250.0, 1.125)] {
            rig.bus.servos[1].place = place;
            rig.run(0.5);
            assert_eq!(measured(1), Some(want), "{}", family.name);
        }
        rig.bus.servos[1].answers_after = None;
        rig.run(2.0);
        assert_eq!((measured(1), measured(0).is_some()), (None, true), "{}", family.name);
        drop(rig);
        assert_eq!(measured(0), None, "{}", family.name);
    }
}

#[test]
fn a_servo_with_a_name_is_called_by_it_beside_its_number() {
    let named = ChannelSettings { name: "left brow".to_owned(), ..channel(3, 300.0, 700.0) };
    let mut rig = Rig::new(STS, &[channel(2, 300.0, 700.0), named]);
    rig.bus.servos.iter_mut().for_each(|servo| servo.answers_after = None);
    let told = rig.run(2.0).line.troubles();
    let lines: Vec<_> = told.lines().map(|line| line.split(": ").next().unwrap()).collect();
    assert_eq!(lines, ["servo 2", "servo 3 (left brow)"]);
    assert_eq!(rig.line.board.dials.channels[1].name, "left brow");
}

#[test]
fn a_busy_line_gets_nothing_and_then_the_newest_goal_and_steady_messages_and_answers_fit_as_the_check_of_settings_says()
{
    let channels: Vec<_> = (1..=30).map(|id| channel(id, 300.0, 700.0)).collect();
    // An answer by protocol 2.0 has 11 bytes beside its data, and one by 1.0 has 6.
    for (family, answer) in [(X, 35 + 11), (STS, 26 + 6)] {
        let mut rig = Rig::new(family, &channels);
        assert_eq!(rig.run(10.0).servos(), [(true, 300.0); 30]);
        let message = rig.message();
        assert!(message.len() + answer <= family.line_bytes(30), "{} {}", message.len(), family.line_bytes(30));
        // Of protocol 1.0, no frame exceeds the buffer of a servo.
        let frames = message.windows(3).filter(|start| start == &[0xFF, 0xFF, 0xFE]).count();
        assert!(family == X || frames == 2, "{frames}");
        let carried = Duration::from_micros(message.len() as u64 * 10);
        for (share, is_made) in [(0.5, false), (0.95, false), (2.0, true), (2.0, false)] {
            let now = rig.now + carried.mul_f64(share);
            assert_eq!(rig.line.step(&Packet::NEUTRAL, &[], now, &mut Vec::new()), is_made, "{share}");
        }
    }
    // 3 goals of the X series have 53 bytes, and 16 have 222, which take 38.5 ms.
    for (family, servos, baud, want) in [
        (X, 3, 57_600, true),
        (X, 4, 57_600, false),
        (X, 30, 1_000_000, true),
        (STS, 30, 1_000_000, true),
        (AX, 30, 115_200, false),
    ] {
        assert_eq!(family.line_bytes(servos) * 10 * 50 <= baud, want, "{} {servos} {baud}", family.name);
    }
}

#[test]
fn whatever_settings_and_answers_say_only_goals_within_the_limits_torque_and_watchdog_are_written() {
    let mut random = fastrand::Rng::with_seed(25);
    let wild = |random: &mut fastrand::Rng| {
        let values = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, -1.0, 5000.0, 1023.0, random.f32() * 4095.0];
        values[random.usize(..values.len())]
    };
    for family in ALL.into_iter().cycle().take(300) {
        let servo = |random: &mut fastrand::Rng, id| ChannelSettings {
            sources: valued(&[("jawOpen", wild(random))]),
            offset: wild(random),
            neutral: wild(random),
            speed_per_s: wild(random),
            acceleration_per_s2: wild(random),
            ..channel(id, wild(random), wild(random))
        };
        let mut rig = Rig::new(family, &[1, 2, 3].map(|id| servo(&mut random, id)));
        for _ in 0..300 {
            rig.jaw_open = wild(&mut random);
            rig.state = if random.u8(..20) == 0 { State::Neutral } else { State::Live };
            let servo = &mut rig.bus.servos[random.usize(..3)];
            match random.u8(..12) {
                0 => servo.restart(rig.now + Duration::from_millis(random.u64(..900))),
                1 => servo.is_damaged = true,
                2 => servo.answers_after = Some(Duration::from_millis(random.u64(..200))),
                3 => servo.alarms = random.u8(..),
                4 => servo.place = f64::from(random.u16(..)),
                5 => servo.registers[random.usize(..160)] = random.u8(..),
                _ => (servo.answers_after, servo.is_damaged, servo.alarms) = (Some(Duration::ZERO), false, 0),
            }
            let message = rig.message();
            rig.back = rig.bus.take(&message, rig.now);
            if random.u8(..5) == 0 {
                let data: Vec<u8> = (0..random.usize(1..60)).map(|_| random.u8(..)).collect();
                family.protocol.write(random.u8(..5), data.iter().copied(), &mut rig.back);
                rig.back.extend(data);
            }
        }
        assert_eq!(rig.bus.strange, 0);
        // By the makers' manuals, and not by the table.
        let (torque, goal, places) = match family.name {
            "dynamixel-x" => (64, 108, 0..=4095),
            "dynamixel-ax" => (24, 30, 0..=1023),
            "dynamixel-mx" => (24, 30, 0..=4095),
            "feetech-sts" => (40, 41, 0..=4095),
            _ => (40, 42, 0..=1023),
        };
        for Written { first, data, .. } in &rig.bus.written {
            let place = match (family.name, data.as_slice()) {
                ("dynamixel-x", [.., a, b, c, d]) => u32::from_le_bytes([*a, *b, *c, *d]),
                ("feetech-sts", [_, low, high, ..]) => u16::from_le_bytes([*low, *high]).into(),
                ("feetech-scs", [high, low, ..]) => u16::from_be_bytes([*high, *low]).into(),
                (_, [low, high, ..]) => u16::from_le_bytes([*low, *high]).into(),
                _ => 0,
            };
            let is_allowed = match (*first, data.as_slice()) {
                (98, [0 | 25]) => family == X,
                (first, [0 | 1]) => first == torque,
                (first, [_, _, ..]) => first == goal && places.contains(&place),
                _ => false,
            };
            assert!(is_allowed, "{}: {first} {data:?}", family.name);
        }
    }
}
