use std::ops::Range;

use clap::ValueEnum;
use facewire_face::{BLENDSHAPES, COEFFS};
use facewire_fit::shapes::index_of;
use facewire_fit::statistics::pearson;
use facewire_fit::synth::acting::*;
use facewire_fit::synth::describe::Figures;
use facewire_fit::synth::expression::Coefficients;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn drawn(moments: Moments, mix: &[Share], shapes: &[&str], count: usize) -> Vec<Coefficients> {
    let shapes = shapes.iter().map(|name| index_of(name)).collect();
    let expressions = Expressions::new(moments, mix, shapes).expect("a mixture");
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    (0..count).map(|_| expressions.draw(&mut rng)).collect()
}

fn moments(count: u16) -> Moments {
    Moments::new(&[(0..count).map(|frame| [f32::from(frame) / f32::from(count); COEFFS]).collect()])
}

#[test]
fn coefficients_are_bounded_lips_close_no_further_than_the_jaw_is_open_and_no_tongue_passes_them_further() {
    let [close, open, tongue] = ["mouthClose", "jawOpen", "tongueOut"].map(index_of);
    for kind in Kind::value_variants() {
        for face in drawn(moments(200), &[(*kind, 1.0)], &[], 300) {
            assert!(face.iter().all(|value| (0.0..=1.0).contains(value)), "{kind:?}");
            let gap = face[open] - face[close];
            assert!(gap >= 0.0 && face[tongue] <= gap / 0.15 + 1e-6, "{kind:?}");
        }
    }
    let out = |face: &&Coefficients| face[tongue] > 0.0;
    let faces = drawn(moments(200), &[(Kind::Tongue, 1.0)], &[], 1000);
    assert!(faces.iter().all(|face| face[close] == 0.0 && face[open] >= 0.15));
    assert!((500..700).contains(&faces.iter().filter(out).count()) && faces.iter().any(|face| face[tongue] > 0.9));
}

#[test]
fn every_shape_but_the_tongue_is_drawn_strong_and_weak() {
    for mix in [&[(Kind::Single, 1.0), (Kind::Combined, 1.0)][..], &[(Kind::Grimace, 1.0)]] {
        let faces = drawn(moments(200), mix, &[], 4000);
        for index in 0..COEFFS - 1 {
            let [strong, weak] = [0.6..1.1, 0.01..0.4]
                .map(|range: Range<f32>| faces.iter().filter(|face| range.contains(&face[index])).count());
            assert!(strong > 20 && weak > 20, "{} {strong} {weak}", BLENDSHAPES[index]);
        }
    }
}

#[test]
fn combinations_of_facial_actions_tie_no_two_coefficients_of_the_brows_and_roll_both_lips_and_each_alone() {
    // A recording in which all brows move together, as those of one person do.
    let faces = drawn(moments(200), &[(Kind::Prototypes, 1.0)], &[], 6000);
    let brows = ["browDownLeft", "browInnerUp", "browOuterUpLeft"].map(index_of);
    for (one, other, correlation) in Figures::of(&faces).tied() {
        assert!(!(brows.contains(&one) && brows.contains(&other)), "{one} {other} {correlation}");
    }
    let share =
        |is: &dyn Fn(&Coefficients) -> bool| faces.iter().filter(|face| is(face)).count() as f64 / faces.len() as f64;
    let [inner, outer, down] = ["browInnerUp", "browOuterUpLeft", "browDownLeft"].map(index_of);
    let [upper, lower] = ["mouthRollUpper", "mouthRollLower"].map(index_of);
    assert!(share(&|face| face[inner] > 0.4 && face[outer] < 0.16) > 0.02);
    assert!(share(&|face| face[inner] > 0.3 && face[down] > 0.2) > 0.02);
    assert!(share(&|face| face[upper] > 0.4 && face[lower] > 0.4) > 0.01);
    assert!(share(&|face| face[upper] > 0.4 && face[lower] < 0.16) > 0.005);
}

#[test]
fn only_chosen_shapes_are_shown_alone_and_kinds_are_drawn_as_often_as_the_mixture_says() {
    let shapes = ["cheekPuff", "jawOpen"];
    for face in drawn(Moments::new(&[vec![[0.0; COEFFS]]]), &[(Kind::Single, 1.0)], &shapes, 200) {
        let mut shown = BLENDSHAPES.iter().zip(face).filter(|(_, value)| *value > 0.0);
        assert!(shown.all(|(name, _)| shapes.contains(name)));
    }
    let mix = [(Kind::Rest, 3.0), (Kind::Recorded, 1.0), (Kind::Grimace, 0.0)];
    let faces = drawn(Moments::new(&[vec![[0.5; COEFFS]]]), &mix, &[], 2000);
    let rests = faces.iter().filter(|face| face.iter().all(|value| *value == 0.0)).count();
    assert!((1400..1600).contains(&rests), "{rests}");
}

#[test]
fn halves_are_from_moments_far_apart() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let many = moments(300);
    let mut seen = [false; 300];
    for _ in 0..3000 {
        let [upper, lower] = many.apart(&mut rng);
        let gap = upper.abs_diff(lower);
        assert!((APART..=300 - APART).contains(&gap), "{upper} {lower}");
        seen[lower] = true;
    }
    assert!(seen.iter().all(|seen| *seen), "every frame is used");
    assert_eq!(moments(1).apart(&mut rng), [0; 2]);
}

#[test]
fn regions_of_a_composed_face_come_from_different_moments() {
    let (mut rng, moments) = (ChaCha8Rng::seed_from_u64(2), moments(1000));
    let mean = |face: &Coefficients, names: [&str; 2]| {
        f64::midpoint(face[index_of(names[0])].into(), face[index_of(names[1])].into())
    };
    let mut r = |draw: fn(&Moments, &mut ChaCha8Rng) -> Coefficients| {
        let faces: Vec<Coefficients> = (0..2000).map(|_| draw(&moments, &mut rng)).collect();
        let [brows, mouth] = [["browInnerUp", "browDownLeft"], ["jawOpen", "mouthFunnel"]]
            .map(|names| faces.iter().map(|face| mean(face, names)).collect::<Vec<_>>());
        pearson(&brows, &mouth)
    };
    let [composed, recorded] = [r(Moments::composed), r(Moments::recorded)];
    assert!(composed.abs() < 0.1, "brows and mouth of composed faces: {composed}");
    assert!(recorded > 0.7, "in recorded faces they go together: {recorded}");
}

#[test]
fn speech_moves_the_mouth_by_sounds_even_where_the_recorded_jaw_never_moves() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let still = Moments::new(&[vec![[0.0; COEFFS]; 100]]);
    let open = (0..200).filter(|_| still.speech(&mut rng)[index_of("jawOpen")] > 0.02).count();
    assert!((70..130).contains(&open), "half of the mouths are visemes: {open}");
}
