use std::path::Path;

use facewire_fit::synth::assets::*;
use facewire_fit::synth::rig::Rig;

use crate::reference;
use crate::synth::anatomy::face;

#[test]
fn a_smile_on_one_side_folds_that_side_only_and_a_resting_face_is_smooth() {
    let rig = Rig::load(Path::new(reference::RIG)).expect("a rig");
    let wrinkles = Wrinkles::new(&rig);
    let shown = |shapes: &[(&str, f32)]| {
        let mut seen = Vec::new();
        wrinkles.each(&face(shapes), |vertex, depth| seen.push((vertex, depth)));
        seen
    };
    assert!(shown(&[]).is_empty());
    let smile = shown(&[("mouthSmileLeft", 1.0)]);
    assert!(smile.len() > 50 && smile.iter().all(|(vertex, _)| rig.neutral[*vertex].x >= 0.0));
    let brows = shown(&[("browInnerUp", 1.0)]);
    assert!(brows.iter().any(|(vertex, _)| rig.neutral[*vertex].x > 1.0));
    assert!(brows.iter().any(|(vertex, _)| rig.neutral[*vertex].x < -1.0));
    assert!(brows.iter().all(|(vertex, depth)| rig.neutral[*vertex].y > 6.0 && (0.0..=1.0).contains(depth)));
}
