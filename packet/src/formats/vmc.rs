//! VMC, the protocol of `VTuber` applications: OSC bundles with blendshapes in the names of Perfect Sync, and bones.
//!
//! The applications show a blendshape once `Apply` arrives, which is the last message of the last bundle. Bones have
//! Unity's left-handed axes (x to the person's right, y up, z out of the face). Their positions are 0, because facewire
//! knows none of the avatar's bones: receivers use the rotation. The time is relative, so that it shows a receiver that the
//! sender goes on; it begins at 0 again every hour, because a number of 32 bits counts more seconds only in coarse steps.

use std::time::Duration;

use super::angles::{Angles, Gaze, unity};
use super::osc::{Bundles, Message};
use crate::{BLENDSHAPES, Packet};

/// After how long the time begins at 0 again. Up to here its steps are at most 0.25 ms.
const HOUR_US: u128 = 3_600_000_000;

/// Writes the messages of a frame.
#[derive(Debug)]
pub struct Vmc {
    time: Message,
    /// The status "loaded, calibrated, in the normal mode": first with "not tracked", then with "tracked".
    ok: [Message; 2],
    bones: Vec<Message>,
    blendshapes: Vec<Message>,
    apply: Message,
    bundles: Bundles,
    gaze: Gaze,
}

impl Vmc {
    /// Makes the format, with the bones of head and eyes or without, and with messages in bundles or each in a datagram.
    #[must_use]
    pub fn new(has_bones: bool, is_bundled: bool) -> Self {
        let blendshape = |name: &&str| {
            let (capital, rest) = name.split_at(1);
            Message::new("/VMC/Ext/Blend/Val", "sf", &(capital.to_uppercase() + rest), &[])
        };
        let bones = if has_bones { &["Head", "LeftEye", "RightEye"][..] } else { &[] };
        Self {
            time: Message::new("/VMC/Ext/T", "f", "", &[]),
            ok: [0, 1].map(|is_tracked| Message::new("/VMC/Ext/OK", "iiii", "", &[1, 3, 0, is_tracked])),
            bones: bones.iter().map(|name| Message::new("/VMC/Ext/Bone/Pos", "sfffffff", name, &[])).collect(),
            blendshapes: BLENDSHAPES.iter().map(blendshape).collect(),
            apply: Message::new("/VMC/Ext/Blend/Apply", "", "", &[]),
            bundles: Bundles::new(is_bundled),
            gaze: Gaze::default(),
        }
    }

    /// Sends the packet as a frame, at this time since the first one.
    pub fn encode(&mut self, packet: &Packet, time: Duration, send: &mut dyn FnMut(&[u8])) {
        let Self { time: clock, ok: [lost, tracked], bones, blendshapes, apply, bundles, gaze } = self;
        gaze.follow(&packet.coefficients);
        clock.set(&[(time.as_micros() % HOUR_US) as f32 / 1e6]);
        let [left, right] = [gaze.left, gaze.right].map(Angles::quaternion_without_roll);
        let rotations = [packet.rotation, left, right].map(unity);
        bones.iter_mut().zip(rotations).for_each(|(bone, rotation)| bone.set(&rotation));
        blendshapes.iter_mut().zip(packet.coefficients).for_each(|(blendshape, value)| blendshape.set(&[value]));
        let ok = if packet.state.shows_face() { tracked } else { lost };
        let messages = [&*ok, clock].into_iter().chain(bones.iter()).chain(blendshapes.iter()).chain([&*apply]);
        messages.for_each(|message| bundles.add(message, send));
        bundles.flush(send);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]
mod tests {
    use rosc::{OscPacket, OscType};

    use super::super::osc::received;
    use super::super::testing::{face, sent};
    use super::*;
    use crate::State;

    #[test]
    fn a_frame_has_bones_and_the_blendshapes_of_perfect_sync_in_three_bundles_and_ends_with_apply() {
        let datagrams = sent(|send| Vmc::new(true, true).encode(&face(&[("jawOpen", 0.5)]), Duration::ZERO, send));
        let messages = received(&datagrams);
        let count = |address| messages.iter().filter(|message| message.addr == address).count();
        assert_eq!((datagrams.len(), messages.len()), (3, 2 + 3 + 52 + 1));
        assert_eq!((count("/VMC/Ext/Blend/Val"), count("/VMC/Ext/Bone/Pos")), (52, 3));
        let jaw = [OscType::String("JawOpen".to_owned()), OscType::Float(0.5)];
        assert!(messages.iter().any(|message| message.args == jaw));
        assert_eq!(messages.last().map(|last| (&*last.addr, last.args.len())), Some(("/VMC/Ext/Blend/Apply", 0)));
    }

    #[test]
    fn the_time_has_steps_below_a_millisecond_however_long_it_runs_and_begins_again_every_hour() {
        let mut format = Vmc::new(false, true);
        let mut time_s = |ms| {
            let datagrams = sent(|send| format.encode(&Packet::NEUTRAL, Duration::from_millis(ms), send));
            let [OscType::Float(time_s)] = received(&datagrams)[1].args[..] else { panic!() };
            f64::from(time_s)
        };
        for days in [0, 3, 1000] {
            let midnight_ms = days * 86_400_000;
            for ms in [0, 1, 1_800_000, 1_800_001, 3_599_999] {
                assert!((time_s(midnight_ms + ms) - ms as f64 / 1000.0).abs() < 0.00025, "{days} {ms}");
            }
            assert!(time_s(midnight_ms + 3_600_000).abs() < 0.00025);
        }
    }

    #[test]
    fn bones_can_be_left_out_and_messages_can_travel_alone_and_ok_tells_whether_the_face_is_tracked() {
        for (state, tracked) in [(State::Live, 1), (State::Hold, 1), (State::Decay, 0), (State::Neutral, 0)] {
            let packet = Packet { state, ..Packet::NEUTRAL };
            let datagrams = sent(|send| Vmc::new(false, false).encode(&packet, Duration::from_millis(1500), send));
            let messages = datagrams.iter().map(|bytes| {
                let (_, OscPacket::Message(message)) = rosc::decoder::decode_udp(bytes).unwrap() else { panic!() };
                message
            });
            let messages: Vec<_> = messages.collect();
            assert_eq!([&*messages[0].addr, &*messages[1].addr], ["/VMC/Ext/OK", "/VMC/Ext/T"]);
            assert_eq!((messages.len(), &*messages[0].args), (2 + 52 + 1, &[1, 3, 0, tracked].map(OscType::Int)[..]));
            assert_eq!(messages[1].args, [OscType::Float(1.5)]);
        }
    }
}
