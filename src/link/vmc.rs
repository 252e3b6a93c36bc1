//! VMC, the protocol of VTuber applications: OSC bundles with blendshapes in the names of Perfect Sync, and bones.
//!
//! The applications show a blendshape once `Apply` arrives, which is the last message of the last bundle. Bones have
//! Unity's left-handed axes (x to the person's right, y up, z out of the face). Their positions are 0, because facewire
//! knows none of the avatar's bones: receivers use the rotation.

use std::time::Instant;

use facewire_packet::BLENDSHAPES;

use super::Encoder;
use super::angles::unity;
use super::osc::{Bundles, Message};
use crate::config::VmcSettings;

pub fn encoder(settings: &VmcSettings) -> Encoder {
    let blendshape = |name: &&str| {
        let (capital, rest) = name.split_at(1);
        Message::new("/VMC/Ext/Blend/Val", "sf", &(capital.to_uppercase() + rest), &[])
    };
    let bones = if settings.bones { &["Head", "LeftEye", "RightEye"][..] } else { &[] };
    let mut bones: Vec<_> = bones.iter().map(|name| Message::new("/VMC/Ext/Bone/Pos", "sfffffff", name, &[])).collect();
    let mut blendshapes: Vec<_> = BLENDSHAPES.iter().map(blendshape).collect();
    // The status "loaded, calibrated, in the normal mode": first with "not tracked", then with "tracked".
    let [lost, tracked] = [0, 1].map(|is_tracked| Message::new("/VMC/Ext/OK", "iiii", "", &[1, 3, 0, is_tracked]));
    let (mut time, begun) = (Message::new("/VMC/Ext/T", "f", "", &[]), Instant::now());
    let (apply, mut bundles) = (Message::new("/VMC/Ext/Blend/Apply", "", "", &[]), Bundles::new(settings.bundles));
    Box::new(move |output, gaze, _sequence, send| {
        time.set(&[begun.elapsed().as_secs_f32()]);
        let [left, right] = [gaze.left, gaze.right].map(|eye| eye.quaternion_without_roll());
        let rotations = [output.pose.rotation, left, right].map(unity);
        bones.iter_mut().zip(rotations).for_each(|(bone, rotation)| bone.set(&rotation));
        blendshapes.iter_mut().zip(output.pose.coefficients).for_each(|(blendshape, value)| blendshape.set(&[value]));
        let ok = if output.shows_face() { &tracked } else { &lost };
        let messages = [ok, &time].into_iter().chain(&bones).chain(&blendshapes).chain([&apply]);
        messages.for_each(|message| bundles.add(message, send));
        bundles.flush(send);
    })
}

#[cfg(test)]
mod tests {
    use facewire_packet::State;
    use rosc::{OscPacket, OscType};

    use super::*;
    use crate::link::osc::received;
    use crate::link::test_output;
    use crate::link::testing::{encoded, face};

    #[test]
    fn a_frame_has_bones_and_the_blendshapes_of_perfect_sync_in_three_bundles_and_ends_with_apply() {
        let datagrams = encoded(&mut encoder(&VmcSettings::default()), &face(&[("jawOpen", 0.5)]));
        let messages = received(&datagrams);
        let count = |address| messages.iter().filter(|message| message.addr == address).count();
        assert_eq!((datagrams.len(), messages.len()), (3, 2 + 3 + 52 + 1));
        assert_eq!((count("/VMC/Ext/Blend/Val"), count("/VMC/Ext/Bone/Pos")), (52, 3));
        let jaw = [OscType::String("JawOpen".to_owned()), OscType::Float(0.5)];
        assert!(messages.iter().any(|message| message.args == jaw));
        assert_eq!(messages.last().map(|last| (&*last.addr, last.args.len())), Some(("/VMC/Ext/Blend/Apply", 0)));
    }

    #[test]
    fn bones_can_be_left_out_and_messages_can_travel_alone_and_ok_tells_whether_the_face_is_tracked() {
        let settings = VmcSettings { bundles: false, bones: false, ..VmcSettings::default() };
        for (state, tracked) in [(State::Live, 1), (State::Hold, 1), (State::Decay, 0), (State::Neutral, 0)] {
            let messages = encoded(&mut encoder(&settings), &test_output(state)).into_iter().map(|bytes| {
                let (_, OscPacket::Message(message)) = rosc::decoder::decode_udp(&bytes).unwrap() else { panic!() };
                message
            });
            let messages: Vec<_> = messages.collect();
            assert_eq!([&*messages[0].addr, &*messages[1].addr], ["/VMC/Ext/OK", "/VMC/Ext/T"]);
            assert_eq!((messages.len(), &*messages[0].args), (2 + 52 + 1, &[1, 3, 0, tracked].map(OscType::Int)[..]));
        }
    }
}
