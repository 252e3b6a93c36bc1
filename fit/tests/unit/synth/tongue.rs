use facewire_fit::synth::expression::Deformer;
use facewire_fit::synth::rig::Rig;
use facewire_fit::synth::tongue::*;
use glam::Vec2;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use crate::reference;
use crate::synth::anatomy::face;

#[test]
fn a_tongue_comes_out_over_the_lower_lip_as_far_as_its_coefficient_says_and_not_between_shut_lips() {
    let rig = Rig::load(std::path::Path::new(reference::RIG)).expect("a rig");
    let (deformer, below) = (Deformer::new(&rig).expect("shapes"), below_tongue(&rig));
    for (seed, open) in (0..20).flat_map(|seed| [0.15, 0.5, 0.9].map(|open| (seed, open))) {
        let tongue = Tongue { aim: Vec2::new(0.2, 0.9), ..Tongue::random(&mut ChaCha8Rng::seed_from_u64(seed)) };
        let before_lip = |close: f32, out: f32| {
            let mut head = Vec::new();
            deformer.deform(&rig, &rig.neutral, &face(&[("jawOpen", open), ("mouthClose", close)]), &mut head);
            Some(*tongue.build(&rig, &below, &head, out)?.points.last()? - head[rig.landmarks[66]])
        };
        assert!(before_lip(open, 1.0).is_none() && before_lip(0.0, 0.0).is_none());
        let tips = [0.1, 0.3, 0.6, 1.0].map(|out| before_lip(0.0, out).expect("a tongue"));
        let ahead = tips.map(|tip| tip.z);
        assert!(ahead.is_sorted() && ahead[0] < -1.0 && ahead[1] > 0.3, "seed {seed}, jaw {open}: {tips:?}");
        assert!(ahead[3] > 1.2 && tips[3].y < -0.5, "it hangs down: seed {seed}, jaw {open}: {tips:?}");
    }
}
