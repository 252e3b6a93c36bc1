//! VMC, the protocol of VTuber applications: OSC bundles with blendshapes in the names of Perfect Sync, and bones.
//!
//! The applications show a blendshape once `Apply` arrives, which is the last message of the last bundle. Bones have
//! Unity's left-handed axes (x to the person's right, y up, z out of the face). Their positions are 0, because facewire
//! knows none of the avatar's bones: receivers use the rotation.

use std::{iter::once, time::Instant};

use facewire_packet::{BLENDSHAPES, State};

use super::angles::{Gaze, unity};
use super::osc::{Bundles, Message};
use super::{Format, Output};
use crate::config::VmcSettings;

/// Messages of one frame.
pub struct Vmc {
    /// The status "loaded, calibrated, in the normal mode": first with "not tracked", then with "tracked".
    ok: [Message; 2],
    time: Message,
    bones: Vec<Message>,
    blendshapes: Vec<Message>,
    apply: Message,
    bundles: Bundles,
    begun: Instant,
}

impl Vmc {
    pub fn new(settings: &VmcSettings) -> Self {
        let blendshape = |name: &&str| {
            let (capital, rest) = name.split_at(1);
            Message::new("/VMC/Ext/Blend/Val", "sf", &(capital.to_uppercase() + rest), &[])
        };
        let bones = if settings.bones { &["Head", "LeftEye", "RightEye"][..] } else { &[] };
        Self {
            ok: [0, 1].map(|is_tracked| Message::new("/VMC/Ext/OK", "iiii", "", &[1, 3, 0, is_tracked])),
            time: Message::new("/VMC/Ext/T", "f", "", &[]),
            bones: bones.iter().map(|name| Message::new("/VMC/Ext/Bone/Pos", "sfffffff", name, &[])).collect(),
            blendshapes: BLENDSHAPES.iter().map(blendshape).collect(),
            apply: Message::new("/VMC/Ext/Blend/Apply", "", "", &[]),
            bundles: Bundles::new(settings.bundles),
            begun: Instant::now(),
        }
    }
}

impl Format for Vmc {
    fn encode(&mut self, output: &Output, gaze: Gaze, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        let Self { ok: [lost, tracked], time, bones, blendshapes, apply, bundles, begun } = self;
        let ok = if matches!(output.state, State::Live | State::Hold) { tracked } else { lost };
        time.set(&[begun.elapsed().as_secs_f32()]);
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
    use crate::link::testing::{encoded, face};

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
    fn bones_can_be_left_out_and_messages_can_travel_alone_and_ok_tells_whether_the_face_is_tracked() {
        let settings = VmcSettings { bundles: false, bones: false, ..VmcSettings::default() };
        for (state, tracked) in [(State::Live, 1), (State::Hold, 1), (State::Decay, 0), (State::Neutral, 0)] {
            let alone = encoded(&mut Vmc::new(&settings), &test_output(state)).into_iter();
            let alone = alone.map(|bytes| match rosc::decoder::decode_udp(&bytes) {
                Ok((_, OscPacket::Message(message))) => (message.addr, message.args.len()),
                other => panic!("no message: {other:?}"),
            });
            let bundled = frame(&test_output(state));
            assert_eq!([&*bundled[0].addr, &*bundled[1].addr], ["/VMC/Ext/OK", "/VMC/Ext/T"]);
            assert_eq!(bundled[0].args, [1, 3, 0, tracked].map(OscType::Int));
            let bundled = bundled.into_iter().map(|message| (message.addr, message.args.len()));
            let boneless: Vec<_> = bundled.filter(|(address, _)| address != "/VMC/Ext/Bone/Pos").collect();
            assert_eq!(alone.collect::<Vec<_>>(), boneless);
        }
    }
}
