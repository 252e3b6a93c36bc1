//! VMC, the protocol of VTuber applications: OSC bundles with blendshapes in the names of Perfect Sync, and bones.
//!
//! The applications show a blendshape once `Apply` arrives, which is the last message of the last bundle. Bones have
//! Unity's left-handed axes (x to the person's right, y up, z out of the face). Their positions are 0, because facewire
//! knows none of the avatar's bones: receivers use the rotation.

use std::time::Instant;

use facewire_packet::{BLENDSHAPES, State};
use rosc::{OscPacket, OscType};

use super::{
    Format, Output,
    gaze::Gaze,
    head::unity,
    osc::{Bundles, message, set},
};
use crate::config::VmcSettings;

/// The arguments of `/VMC/Ext/OK`: loaded, calibrated, in the normal mode; then whether the face is tracked.
const OK: [i32; 3] = [1, 3, 0];

/// Messages of one frame.
#[derive(Debug)]
pub struct Vmc {
    ok: OscPacket,
    time: OscPacket,
    bones: Option<[OscPacket; 3]>,
    blendshapes: Vec<OscPacket>,
    apply: OscPacket,
    bundles: Bundles,
    gaze: Gaze,
    begun: Instant,
}

impl Vmc {
    pub fn new(settings: &VmcSettings) -> Self {
        let blendshape = |name: &&str| value("/VMC/Ext/Blend/Val", &pascal_case(name), 1);
        Self {
            ok: message("/VMC/Ext/OK", OK.into_iter().chain([0]).map(OscType::Int).collect()),
            time: message("/VMC/Ext/T", vec![OscType::Float(0.0)]),
            bones: settings
                .bones
                .then(|| ["Head", "LeftEye", "RightEye"].map(|bone| value("/VMC/Ext/Bone/Pos", bone, 7))),
            blendshapes: BLENDSHAPES.iter().map(blendshape).collect(),
            apply: message("/VMC/Ext/Blend/Apply", Vec::new()),
            bundles: if settings.bundles { Bundles::new() } else { Bundles::apart() },
            gaze: Gaze::default(),
            begun: Instant::now(),
        }
    }

    fn follow(&mut self, output: &Output) {
        let is_tracked = matches!(output.state, State::Live | State::Hold);
        if let OscPacket::Message(ok) = &mut self.ok
            && let Some(tracked) = ok.args.last_mut()
        {
            *tracked = OscType::Int(is_tracked.into());
        }
        set(&mut self.time, &[self.begun.elapsed().as_secs_f32()]);
        self.gaze.follow(&output.pose.coefficients);
        let eyes = [self.gaze.left, self.gaze.right].map(|eye| unity(eye.quaternion_without_roll()));
        let rotations = [unity(output.pose.rotation)].into_iter().chain(eyes);
        self.bones.iter_mut().flatten().zip(rotations).for_each(|(bone, rotation)| set(bone, &rotation));
        for (blendshape, value) in self.blendshapes.iter_mut().zip(output.pose.coefficients) {
            set(blendshape, &[value]);
        }
    }
}

impl Format for Vmc {
    fn encode(&mut self, output: &Output, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        self.follow(output);
        let Self { ok, time, bones, blendshapes, apply, bundles, .. } = self;
        let messages = [&*ok, &*time].into_iter().chain(bones.iter().flatten()).chain(&*blendshapes).chain([&*apply]);
        messages.for_each(|message| bundles.add(message, send));
        bundles.flush(send);
    }
}

/// Returns a message of a name and `numbers` zeros.
fn value(addr: &str, name: &str, numbers: usize) -> OscPacket {
    let numbers = std::iter::repeat_n(OscType::Float(0.0), numbers);
    message(addr, [OscType::String(name.to_owned())].into_iter().chain(numbers).collect())
}

/// Returns the name with a capital at its beginning.
fn pascal_case(name: &str) -> String {
    let mut letters = name.chars();
    letters.next().into_iter().flat_map(char::to_uppercase).chain(letters).collect()
}

#[cfg(test)]
#[allow(clippy::indexing_slicing, clippy::panic, clippy::float_cmp)]
mod tests {
    use rosc::OscMessage;

    use super::*;
    use crate::link::gaze;
    use crate::link::head::poses;
    use crate::link::osc::received;
    use crate::link::output::test_output;

    fn datagrams(format: &mut Vmc, output: &Output) -> Vec<Vec<u8>> {
        let mut datagrams = Vec::new();
        format.encode(output, 0, &mut |bytes| datagrams.push(bytes.to_vec()));
        datagrams
    }

    fn messages(output: &Output) -> Vec<OscMessage> {
        received::messages(&datagrams(&mut Vmc::new(&VmcSettings::default()), output))
    }

    /// Returns the numbers of the message about a bone or a blendshape.
    fn numbers(messages: &[OscMessage], name: &str) -> Vec<f32> {
        let is_about = |message: &&OscMessage| message.args.first() == Some(&OscType::String(name.to_owned()));
        let found: Vec<_> = messages.iter().filter(is_about).collect();
        let [message] = found[..] else { panic!("{} messages about {name}", found.len()) };
        message.args.iter().filter_map(|argument| argument.clone().float()).collect()
    }

    fn near(a: &[f32], b: &[f32]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5)
    }

    #[test]
    fn a_frame_has_all_blendshapes_of_perfect_sync_and_ends_with_apply() {
        let mut output = test_output(State::Live);
        gaze::set(&mut output.pose.coefficients, &[("jawOpen", 0.5)]);
        let messages = messages(&output);
        let names: Vec<_> = messages.iter().filter(|message| message.addr == "/VMC/Ext/Blend/Val").collect();
        assert_eq!(names.len(), 52);
        assert_eq!(numbers(&messages, "JawOpen"), [0.5]);
        assert_eq!(numbers(&messages, "EyeLookInLeft"), [0.0]);
        assert_eq!(messages.last(), Some(&OscMessage { addr: "/VMC/Ext/Blend/Apply".to_owned(), args: vec![] }));
    }

    /// The documented bytes of JawOpen = 0.5, and of Apply.
    #[test]
    fn messages_have_the_documented_bytes() {
        let mut output = test_output(State::Live);
        gaze::set(&mut output.pose.coefficients, &[("jawOpen", 0.5)]);
        let bytes = datagrams(&mut Vmc::new(&VmcSettings::default()), &output).concat();
        let jaw = b"\0\0\0\x24/VMC/Ext/Blend/Val\0\0,sf\0JawOpen\0\x3f\0\0\0";
        assert_eq!(bytes.windows(jaw.len()).filter(|window| window == jaw).count(), 1);
        assert!(bytes.ends_with(b"\0\0\0\x1c/VMC/Ext/Blend/Apply\0\0\0\0,\0\0\0"));
        assert!(bytes.starts_with(b"#bundle\0\0\0\0\0\0\0\0\x01"));
    }

    #[test]
    fn three_bundles_carry_a_frame() {
        let lengths: Vec<_> =
            datagrams(&mut Vmc::new(&VmcSettings::default()), &test_output(State::Live)).iter().map(Vec::len).collect();
        assert_eq!(lengths.len(), 3, "{lengths:?}");
    }

    #[test]
    fn head_and_eyes_turn_in_unitys_left_handed_axes() {
        let mut output = test_output(State::Live);
        let look = [("eyeLookOutLeft", 1.0), ("eyeLookDownRight", 1.0)];
        gaze::set(&mut output.pose.coefficients, &look);
        let head = |rotation| {
            let output = Output { pose: super::super::Pose { rotation, ..output.pose }, ..output.clone() };
            numbers(&messages(&output), "Head")
        };
        let half = |degrees: f32| (0.5 * degrees).to_radians().sin_cos();
        // In Unity, turns to the person's left are negative about y, nods down are positive about x, and tilts to the
        // right shoulder are negative about z.
        let ((sin, cos), left) = (half(30.0), head(poses::LEFT));
        assert!(near(&left, &[0.0, 0.0, 0.0, 0.0, -sin, 0.0, cos]), "{left:?}");
        let ((sin, cos), down) = (half(20.0), head(poses::DOWN));
        assert!(near(&down, &[0.0, 0.0, 0.0, sin, 0.0, 0.0, cos]), "{down:?}");
        let ((sin, cos), tilted) = (half(10.0), head(poses::TILTED));
        assert!(near(&tilted, &[0.0, 0.0, 0.0, 0.0, 0.0, -sin, cos]), "{tilted:?}");
        let ((sin, cos), messages) = (half(35.0), messages(&output));
        assert!(near(&numbers(&messages, "LeftEye")[3..], &[0.0, -sin, 0.0, cos]));
        assert!(near(&numbers(&messages, "RightEye")[3..], &[sin, 0.0, 0.0, cos]));
    }

    #[test]
    fn receivers_that_read_no_bundles_get_each_message_in_a_datagram_of_its_own() {
        let output = test_output(State::Live);
        let mut apart = Vmc::new(&VmcSettings { bundles: false, ..VmcSettings::default() });
        let decoded = datagrams(&mut apart, &output).into_iter().map(|bytes| match rosc::decoder::decode_udp(&bytes) {
            Ok((_, OscPacket::Message(message))) => (message.addr, message.args.len()),
            other => panic!("no message: {other:?}"),
        });
        let bundled = messages(&output).into_iter().map(|message| (message.addr, message.args.len()));
        assert_eq!(decoded.collect::<Vec<_>>(), bundled.collect::<Vec<_>>());
    }

    #[test]
    fn bones_can_be_left_out() {
        let mut format = Vmc::new(&VmcSettings { bones: false, ..VmcSettings::default() });
        let messages = received::messages(&datagrams(&mut format, &test_output(State::Live)));
        assert!(messages.iter().all(|message| message.addr != "/VMC/Ext/Bone/Pos"));
    }

    #[test]
    fn ok_tells_whether_the_face_is_tracked() {
        for (state, tracked) in [(State::Live, 1), (State::Hold, 1), (State::Decay, 0), (State::Neutral, 0)] {
            let messages = messages(&test_output(state));
            assert_eq!(messages[0].addr, "/VMC/Ext/OK");
            assert_eq!(messages[0].args, [1, 3, 0, tracked].map(OscType::Int));
            assert_eq!(messages[1].addr, "/VMC/Ext/T");
        }
    }
}
