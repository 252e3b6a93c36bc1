//! VMC, the protocol of VTuber applications: OSC bundles with blendshapes in the names of Perfect Sync, and bones.
//!
//! The applications show a blendshape once `Apply` arrives, which is the last message of the last bundle. Bones have
//! Unity's left-handed axes (x to the person's right, y up, z out of the face). Their positions are 0, because facewire
//! knows none of the avatar's bones: receivers use the rotation.

use std::{iter::once, time::Instant};

use facewire_packet::{BLENDSHAPES, State};

use super::{
    Format, Output,
    angles::{Gaze, unity},
    osc::{Argument, Bundles, Message},
};
use crate::config::VmcSettings;

/// Messages of one frame.
#[derive(Debug)]
pub struct Vmc {
    /// Loaded, calibrated, in the normal mode, and not tracked or tracked.
    ok: [Message; 2],
    time: Message,
    bones: Vec<Message>,
    blendshapes: Vec<Message>,
    apply: Message,
    bundles: Bundles,
    gaze: Gaze,
    begun: Instant,
}

impl Vmc {
    pub fn new(settings: &VmcSettings) -> Self {
        let ok = |is_tracked| Message::new("/VMC/Ext/OK", &[1, 3, 0, is_tracked].map(Argument::Int));
        let bone = |name| {
            let position_and_rotation = [const { Argument::Float }; 7];
            let arguments: Vec<_> = once(Argument::Text(name)).chain(position_and_rotation).collect();
            Message::new("/VMC/Ext/Bone/Pos", &arguments)
        };
        let blendshape = |name: &&str| {
            let (capital, rest) = name.split_at(1);
            let name = capital.to_uppercase() + rest;
            Message::new("/VMC/Ext/Blend/Val", &[Argument::Text(&name), Argument::Float])
        };
        let bones = if settings.bones { &["Head", "LeftEye", "RightEye"][..] } else { &[] };
        Self {
            ok: [0, 1].map(ok),
            time: Message::new("/VMC/Ext/T", &[Argument::Float]),
            bones: bones.iter().copied().map(bone).collect(),
            blendshapes: BLENDSHAPES.iter().map(blendshape).collect(),
            apply: Message::new("/VMC/Ext/Blend/Apply", &[]),
            bundles: Bundles::new(settings.bundles),
            gaze: Gaze::default(),
            begun: Instant::now(),
        }
    }
}

impl Format for Vmc {
    fn encode(&mut self, output: &Output, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        let Self { ok: [lost, tracked], time, bones, blendshapes, apply, bundles, gaze, begun } = self;
        let ok = if matches!(output.state, State::Live | State::Hold) { tracked } else { lost };
        time.set(&[begun.elapsed().as_secs_f32()]);
        gaze.follow(&output.pose.coefficients);
        let [left, right] = [gaze.left, gaze.right].map(|eye| eye.quaternion_without_roll());
        let rotations = [output.pose.rotation, left, right].map(unity);
        bones.iter_mut().zip(rotations).for_each(|(bone, rotation)| bone.set(&rotation));
        blendshapes.iter_mut().zip(output.pose.coefficients).for_each(|(blendshape, value)| blendshape.set(&[value]));
        let messages = [&*ok, &*time].into_iter().chain(&*bones).chain(&*blendshapes).chain(once(&*apply));
        messages.for_each(|message| bundles.add(message, send));
        bundles.flush(send);
    }
}

#[cfg(test)]
mod tests {
    use rosc::{OscMessage, OscPacket, OscType};

    use super::*;
    use crate::link::osc::received;
    use crate::link::test_output;
    use crate::link::testing::{DOWN, LEFT, TILTED, encoded, face, near, turned};

    fn frame(output: &Output) -> Vec<OscMessage> {
        received(&encoded(&mut Vmc::new(&VmcSettings::default()), output))
    }

    #[test]
    fn a_frame_has_all_blendshapes_of_perfect_sync_in_three_bundles_and_ends_with_apply() {
        let datagrams = encoded(&mut Vmc::new(&VmcSettings::default()), &face(&[("jawOpen", 0.5)]));
        let (bytes, messages) = (datagrams.concat(), received(&datagrams));
        assert_eq!(datagrams.len(), 3);
        assert_eq!(messages.iter().filter(|message| message.addr == "/VMC/Ext/Blend/Val").count(), 52);
        // The documented bytes of JawOpen = 0.5, and of Apply.
        let jaw = b"\0\0\0\x24/VMC/Ext/Blend/Val\0\0,sf\0JawOpen\0\x3f\0\0\0";
        assert_eq!(bytes.windows(jaw.len()).filter(|window| window == jaw).count(), 1);
        assert!(bytes.ends_with(b"\0\0\0\x1c/VMC/Ext/Blend/Apply\0\0\0\0,\0\0\0"));
    }

    #[test]
    fn head_and_eyes_turn_in_unitys_left_handed_axes() {
        let look = face(&[("eyeLookOutLeft", 1.0), ("eyeLookDownRight", 1.0)]);
        // In Unity, turns to the person's left are negative about y, nods down are positive about x, and tilts to the
        // right shoulder are negative about z.
        for (output, name, [x, y, z], degrees) in [
            (&turned(LEFT), "Head", [0.0, -1.0, 0.0], 30.0_f32),
            (&turned(DOWN), "Head", [1.0, 0.0, 0.0], 20.0),
            (&turned(TILTED), "Head", [0.0, 0.0, -1.0], 10.0),
            (&look, "LeftEye", [0.0, -1.0, 0.0], 35.0),
            (&look, "RightEye", [1.0, 0.0, 0.0], 35.0),
        ] {
            let is_about = |message: &OscMessage| message.args.first() == Some(&OscType::String(name.to_owned()));
            let bone = frame(output).into_iter().find(is_about).unwrap();
            let numbers: Vec<f32> = bone.args.iter().filter_map(|argument| argument.clone().float()).collect();
            let (sin, cos) = (0.5 * degrees).to_radians().sin_cos();
            assert!(near(&numbers, &[0.0, 0.0, 0.0, x * sin, y * sin, z * sin, cos]), "{name} {degrees} {numbers:?}");
        }
    }

    #[test]
    fn bones_can_be_left_out_and_messages_can_travel_alone() {
        let settings = VmcSettings { bundles: false, bones: false, ..VmcSettings::default() };
        let alone = encoded(&mut Vmc::new(&settings), &face(&[])).into_iter();
        let alone = alone.map(|bytes| match rosc::decoder::decode_udp(&bytes) {
            Ok((_, OscPacket::Message(message))) => (message.addr, message.args.len()),
            other => panic!("no message: {other:?}"),
        });
        let bundled = frame(&face(&[])).into_iter().map(|message| (message.addr, message.args.len()));
        let bundled = bundled.filter(|(address, _)| address != "/VMC/Ext/Bone/Pos");
        assert_eq!(alone.collect::<Vec<_>>(), bundled.collect::<Vec<_>>());
    }

    #[test]
    fn ok_tells_whether_the_face_is_tracked() {
        for (state, tracked) in [(State::Live, 1), (State::Hold, 1), (State::Decay, 0), (State::Neutral, 0)] {
            let messages = frame(&test_output(state));
            assert_eq!([&*messages[0].addr, &*messages[1].addr], ["/VMC/Ext/OK", "/VMC/Ext/T"]);
            assert_eq!(messages[0].args, [1, 3, 0, tracked].map(OscType::Int));
        }
    }
}
