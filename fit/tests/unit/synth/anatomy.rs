use facewire_face::{BLENDSHAPES, COEFFS};
use facewire_fit::shapes::find;
use facewire_fit::shapes::index_of;
use facewire_fit::synth::anatomy::*;
use facewire_fit::synth::expression::Coefficients;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub fn face(shapes: &[(&str, f32)]) -> Coefficients {
    let mut face = [0.0; COEFFS];
    for (name, value) in shapes {
        face[find(name).expect("a blendshape")] = *value;
    }
    face
}

#[test]
fn all_names_are_of_blendshapes() {
    assert!(EXCLUSIVE.iter().all(|(one, other)| find(one).is_some() && find(other).is_some()));
    assert!(Region::ALL.iter().all(|region| REGIONS.contains(region)));
    assert_eq!(REGIONS[index_of("cheekPuff")], Region::Mouth);
    assert_eq!(LOOK.concat().into_iter().collect::<std::collections::BTreeSet<_>>().len(), 8);
}

#[test]
fn both_eyes_look_in_the_same_direction() {
    let partner = |name: &str| partner(index_of(name)).map(|(partner, _)| BLENDSHAPES[partner]);
    assert_eq!(partner("eyeLookInLeft"), Some("eyeLookOutRight"));
    assert_eq!(partner("eyeLookOutLeft"), Some("eyeLookInRight"));
    assert_eq!(partner("eyeLookUpLeft"), Some("eyeLookUpRight"));
    assert_eq!(partner("eyeBlinkRight"), Some("eyeBlinkLeft"));
    assert_eq!(partner("mouthLeft"), None);
    let mut squinting = face(&[("eyeLookOutLeft", 0.8), ("eyeLookUpLeft", 0.5)]);
    enforce_limits(&mut squinting);
    let coupled = [("eyeLookOutLeft", 0.4), ("eyeLookInRight", 0.4), ("eyeLookUpLeft", 0.25), ("eyeLookUpRight", 0.25)];
    assert_eq!(squinting, face(&coupled));
    let seen = face(&[("eyeLookOutLeft", 0.5), ("eyeLookInRight", 0.6), ("eyeLookDownLeft", 0.3)]);
    let gaze = Gaze::of(&seen);
    assert!((gaze.left - 0.55).abs() < 1e-6 && (gaze.convergence - 0.05).abs() < 1e-6, "they may converge");
}

#[test]
fn mirrored_and_joined_faces_take_each_side_from_its_face() {
    let one = face(&[("mouthSmileLeft", 0.7), ("jawOpen", 0.4), ("jawLeft", 0.2)]);
    assert_eq!(mirrored(&one), face(&[("mouthSmileRight", 0.7), ("jawOpen", 0.4), ("jawRight", 0.2)]));
    assert_eq!(joined(&one, &[0.0; COEFFS]), face(&[("mouthSmileLeft", 0.7), ("jawOpen", 0.2), ("jawLeft", 0.2)]));
    assert_eq!(joined(&[0.0; COEFFS], &one), face(&[("jawOpen", 0.2)]));
}

#[test]
fn lips_that_are_closed_over_an_open_jaw_meet_in_half_of_the_cases() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let meet = |_: &u32| {
        let mut closed = face(&[("mouthClose", 0.5), ("jawOpen", 0.1)]);
        open_for_closed_lips(&mut rng, &mut closed);
        let jaw = closed[index_of("jawOpen")];
        assert!((0.5..0.9).contains(&jaw), "{jaw}");
        jaw == 0.5
    };
    let count = (0..1000).filter(meet).count();
    assert!((450..550).contains(&count), "{count}");
    let open = face(&[("mouthClose", 0.2), ("jawOpen", 0.6)]);
    let mut same = open;
    open_for_closed_lips(&mut rng, &mut same);
    assert_eq!(same, open, "lips that do not meet stay so");
}

#[test]
fn rolled_lips_leave_less_room_for_the_tongue() {
    let tongue = |roll: f32| {
        let mut out = face(&[("jawOpen", 0.3), ("mouthClose", 0.1), ("mouthRollLower", roll), ("tongueOut", 1.0)]);
        enforce_limits(&mut out);
        out[index_of("tongueOut")]
    };
    assert_eq!(tongue(0.0), 1.0);
    assert!((0.1..0.2).contains(&tongue(1.0)), "{}", tongue(1.0));
}
