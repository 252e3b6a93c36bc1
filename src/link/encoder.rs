//! Which bytes a link sends: the format of each kind, with the options that its settings give.

use std::{sync::Arc, time::Instant};

use facewire_face::Wears;
use facewire_packet::formats::vrchat::{self, Eyes, Group, Parameter};
use facewire_packet::formats::{Dmx, IFacialMocap, JsonLines, LiveLink, Vmc, Vrchat};
use facewire_packet::{Packet, Reason, State};
use facewire_servo::maestro::COMMAND_BYTES;
use facewire_servo::{Board, Dials, dmx::Values};

use super::Output;
use super::discovery::cid_of;
use crate::clock::LocalTime;
use crate::config::{LinkKind, VrchatSettings};

/// Encodes a packet in memory that was taken when the link was opened, and calls the last argument once for each message.
/// The packet is made of the output, whose times do not wrap. Both are as the settings of the link want them: adjusted, and
/// held or neutral while no face is followed.
pub type Encoder = Box<dyn FnMut(&Packet, &Output, &mut dyn FnMut(&[u8])) + Send>;

pub fn encoder_of(kind: &LinkKind, dials: &Arc<Dials>) -> Encoder {
    let begun = Instant::now();
    match kind {
        // The threads of servos take packets, too.
        LinkKind::Udp(_) | LinkKind::Pca9685(_) | LinkKind::BusServo(_) => {
            Box::new(|packet, _, send| send(&packet.encode()))
        }
        LinkKind::Serial(_) => Box::new(|packet, _, send| send(&packet.encode_frame())),
        LinkKind::LiveLink(it) => {
            let mut format = LiveLink::new(&it.device_id, &it.subject, it.swap_mouth);
            let mut time = LocalTime::of_this_machine();
            Box::new(move |packet, _, send| format.encode(packet, time.now_us(), send))
        }
        LinkKind::Vmc(it) => {
            let mut format = Vmc::new(it.bones, it.bundles);
            Box::new(move |packet, _, send| format.encode(packet, begun.elapsed(), send))
        }
        LinkKind::Vrchat(it) => {
            let eyes = match (it.wears, it.native_eyes) {
                (Wears::Headset, _) => Eyes::Nowhere,
                (_, true) => Eyes::Native,
                (_, false) => Eyes::Parameters,
            };
            let mut format = Vrchat::new(&it.prefix, eyes, |parameter| form_of(parameter, it));
            Box::new(move |packet, _, send| format.encode(packet, begun.elapsed(), send))
        }
        LinkKind::Maestro(it) => {
            let mut board = Board::new(&it.channels, dials);
            let commands = it.commands();
            let multiple_targets = it.multiple_targets;
            let mut message = Vec::with_capacity(it.channels.len() * COMMAND_BYTES);
            Box::new(move |packet, _, send| {
                message.clear();
                let channels = board.follow(packet, Instant::now());
                commands.write_targets(channels, multiple_targets, &mut message);
                send(&message);
            })
        }
        LinkKind::Sacn(it) => {
            let format = Dmx::sacn(cid_of(it), &it.source, it.priority as u8, it.universe as u16);
            dmx(format, Values::new(&it.channels, it.whole_face, it.stop, dials), begun)
        }
        LinkKind::ArtNet(it) => {
            dmx(Dmx::art_net(it.universe as u16), Values::new(&it.channels, it.whole_face, it.stop, dials), begun)
        }
        LinkKind::IFacialMocap(it) => {
            let mut format = IFacialMocap::new(it.version);
            Box::new(move |packet, _, send| format.encode(packet, send))
        }
        LinkKind::Json(_) => {
            let mut format = JsonLines::default();
            Box::new(move |packet, output, send| {
                let age_us = (output.age_us != u64::MAX).then_some(output.age_us);
                format.encode(packet, age_us, output.capture_us, send);
            })
        }
    }
}

fn dmx(mut format: Dmx, mut values: Values, begun: Instant) -> Encoder {
    Box::new(move |packet, output, send| {
        // Packets on the way to neutral have this state too, but `moving` is true.
        let is_last = (packet.state, packet.reason, output.moving) == (State::Neutral, Reason::Stopping, false);
        if let Some((universe, ends)) = values.follow(packet, Instant::now()) {
            format.encode(universe, is_last || ends, begun.elapsed(), send);
        }
    })
}

fn form_of(parameter: &Parameter, it: &VrchatSettings) -> vrchat::Form {
    let is_wanted = match parameter.group {
        Group::Shape => it.shapes,
        Group::Compound => it.compounds,
        Group::Head => it.head,
    };
    let general = if is_wanted { vrchat::Form { number: it.floats, bits: it.bits } } else { vrchat::Form::default() };
    it.parameters.form_of(&parameter.name).unwrap_or(general)
}

/// The packet of an output. Its age saturates, and its times wrap.
pub fn packet(output: &Output, sequence: u16) -> Packet {
    let Output { state, reason, age_us, capture_us, .. } = *output;
    let age_us = u32::try_from(age_us).unwrap_or(u32::MAX);
    let capture_us = capture_us as u32;
    Packet { state, reason, sequence, age_us, capture_us, ..Packet::NEUTRAL }.with_pose(&output.pose)
}

#[cfg(test)]
mod tests {
    use facewire_packet::{FrameReader, NeutralFace, Pose, Visibility};

    use super::*;
    use crate::config;
    use crate::link::test_output;
    use crate::link::testing::kind;

    fn encoded(kind: &LinkKind, output: &Output) -> Vec<u8> {
        let mut messages = Vec::new();
        encoder_of(kind, &Arc::default())(&packet(output, 7), output, &mut |bytes| messages.extend_from_slice(bytes));
        messages
    }

    #[test]
    fn datagrams_and_frames_carry_every_field_of_the_output() {
        let rotation = [0.0, 0.6, 0.0, 0.8];
        let position_mm = [1.0, -2.0, 600.0];
        let mut pose = Pose { rotation, position_mm, neutral_face: NeutralFace::Estimated, ..Pose::NEUTRAL };
        pose.coefficients[17] = 1.0;
        pose.visibility = Visibility { mouth: 0.0, ..Visibility::WHOLE };
        let output = Output { pose, age_us: 200, capture_us: (7 << 32) + 5, ..test_output(State::Hold) };
        let [udp, serial] = ["udp", "serial"].map(|name| encoded(&kind(name, ""), &output));
        let packet = Packet::decode(&udp).unwrap();
        let Packet { state, reason, sequence, age_us, capture_us, neutral_face, .. } = packet;
        assert_eq!((state, reason, sequence), (State::Hold, Reason::NoFace, 7));
        assert_eq!((age_us, capture_us, neutral_face), (200, 5, NeutralFace::Estimated));
        assert_eq!((packet.position_mm, packet.coefficients), (pose.position_mm, pose.coefficients));
        assert_eq!(packet.visibility, pose.visibility);
        assert!(packet.rotation.iter().zip(pose.rotation).all(|(got, want)| (got - want).abs() < 1e-4));
        let mut reader = FrameReader::default();
        assert_eq!(serial.iter().filter_map(|byte| reader.push(*byte)?.ok()).collect::<Vec<_>>(), [packet]);
    }

    #[test]
    fn other_formats_get_times_that_do_not_wrap_and_no_age_before_the_first_pose() {
        let output = Output { age_us: 1 << 40, capture_us: 1 << 41, ..test_output(State::Live) };
        let line = |output: &Output| String::from_utf8(encoded(&kind("json", ""), output)).unwrap();
        assert!(line(&output).contains("\"age_ms\":1099511627.776,\"capture_us\":2199023255552,"));
        assert!(line(&Output { age_us: u64::MAX, ..output.clone() }).contains("\"age_ms\":null,"));
    }

    #[test]
    fn by_live_link_every_face_has_the_time_of_day_also_before_the_first_pose() {
        let mut time = LocalTime::of_this_machine();
        let mut frame_of_day = || time.now_us() % 86_400_000_000 * 60 / 1_000_000;
        for output in [Output::NEUTRAL, test_output(State::Live)] {
            let before = frame_of_day();
            let datagram = encoded(&kind("live-link", "subject = \"face\"\n"), &output);
            let after = frame_of_day();
            let frame = u32::from_be_bytes(datagram[49..53].try_into().unwrap()).into();
            // The day may end meanwhile.
            assert!((before..=after).contains(&frame) || after < before, "{before} {frame} {after}");
        }
    }

    #[test]
    fn vrchat_gets_no_lids_and_no_gaze_from_a_wearer_of_a_headset() {
        for (wears, count) in [("nothing", 2), ("mask", 2), ("headset", 0)] {
            let link = "[[link]]\nkind = \"vrchat\"\nparameters = \"EyeLidLeft, EyeLeftX, JawOpen\"\n";
            let settings = config::parse("test", &format!("[wearer]\nwears = \"{wears}\"\n{link}")).unwrap();
            let sent = encoded(&settings.links[0].kind, &test_output(State::Live));
            let sent = String::from_utf8_lossy(&sent);
            let names = ["v2/EyeLidLeft", "v2/EyeLeftX"];
            assert_eq!(names.iter().filter(|name| sent.contains(*name)).count(), count, "{wears}");
            assert!(sent.contains("v2/JawOpen"), "{wears}");
        }
    }

    #[test]
    fn groups_or_else_a_list_choose_the_parameters_of_vrchat_and_their_form() {
        for (keys, want) in [
            ("", [(true, 0); 3]),
            ("bits = 3\nfloats = false\nshapes = false\n", [(false, 0), (false, 3), (false, 3)]),
            ("bits = 2\ncompounds = false\nhead = false\n", [(true, 2), (false, 0), (false, 0)]),
            ("bits = 3\nshapes = false\nparameters = \"JawOpen:2, Head/Yaw\"\n", [(false, 2), (false, 0), (true, 0)]),
        ] {
            let LinkKind::Vrchat(it) = kind("vrchat", keys) else { unreachable!() };
            let parameters = facewire_packet::formats::vrchat::PARAMETERS.iter();
            let form = |name| form_of(parameters.clone().find(|parameter| parameter.name == name).unwrap(), &it);
            let forms = ["JawOpen", "SmileFrown", "Head/Yaw"].map(form);
            assert_eq!(forms, want.map(|(number, bits)| vrchat::Form { number, bits }), "{keys}");
        }
    }
}
