use facewire_face::COEFFS;
use facewire_fit::shapes::index_of;
use facewire_fit::synth::acting::APART;
use facewire_fit::synth::expression::Coefficients;
use facewire_fit::synth::script::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

fn wearer_parts(seed: u64) -> Vec<Part> {
    let recording: Vec<Coefficients> =
        (0..600).map(|frame| [0.5 + 0.4 * (frame as f32 * 0.05).sin(); COEFFS]).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Script::Wearer.parts(&mut rng, &[recording.clone(), recording], 0).expect("long enough recordings")
}

fn part<'a>(parts: &'a [Part], name: &str) -> &'a [Moment] {
    &parts.iter().find(|part| part.name == name).expect("a part").moments
}

#[test]
fn faces_move_without_steps_but_for_blinks() {
    let parts = wearer_parts(1);
    let moments = parts.iter().filter(|part| part.name != "blinks").flat_map(|part| &part.moments);
    let moments: Vec<&Moment> = moments.collect();
    for (number, pair) in moments.windows(2).enumerate() {
        let step = |shape: usize| (pair[1].face[shape] - pair[0].face[shape]).abs();
        assert!((0..COEFFS).all(|shape| step(shape) < 0.6), "moment {number}");
        assert!((pair[1].yaw_deg - pair[0].yaw_deg).abs() < 2.0);
    }
}

#[test]
fn poses_are_held_on_both_sides_shut_eyes_are_shut_and_every_blink_is_seen_shut() {
    for seed in 0..10 {
        let parts = wearer_parts(seed);
        let lid: Vec<f32> = part(&parts, "blinks").iter().map(|moment| moment.face[0]).collect();
        assert_eq!(lid.windows(2).filter(|pair| pair[0] < 0.9 && pair[1] >= 0.9).count(), 6, "seed {seed}");
    }
    let parts = wearer_parts(2);
    let held = |name: &str, shape: &str| part(&parts, name)[50].face[index_of(shape)];
    for side in ["eyeBlinkLeft", "eyeBlinkRight"] {
        assert!((held("eyes-shut", side) - 1.0).abs() < 1e-6);
    }
    for (pose, shape) in [("smile", "mouthSmileLeft"), ("jaw-open", "jawOpen"), ("look-up", "eyeLookUpRight")] {
        assert!((0.69..1.0).contains(&held(pose, shape)), "{pose}");
        assert!(part(&parts, pose)[0].face.iter().all(|value| value.abs() < 1e-6));
    }
}

/// Returns a recording in which every coefficient grows by 0.001 a frame.
fn recording(count: u16) -> Vec<Coefficients> {
    (0..count).map(|frame| [f32::from(frame) * 0.001; COEFFS]).collect()
}

#[test]
fn both_halves_of_a_face_move_continuously_and_are_of_different_moments() {
    let (brow, jaw) = (index_of("browInnerUp"), index_of("jawOpen"));
    for seed in 0..20 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let curves = random_curves(&mut rng, &[recording(400)], 200).expect("long enough");
        assert_eq!(curves.len(), 200);
        for index in [brow, jaw] {
            let steps: Vec<f32> = curves.windows(2).map(|pair| pair[1][index] - pair[0][index]).collect();
            assert!(steps.iter().all(|step| (step - steps[0]).abs() < 1e-5 && (0.0009..0.0016).contains(step)));
        }
        let moment = |index: usize| curves[0][index] / (curves[1][index] - curves[0][index]);
        assert!((moment(brow) - moment(jaw)).abs() > APART as f32 - 2.0, "{} {}", moment(brow), moment(jaw));
    }
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let error = random_curves(&mut rng, &[recording(280)], 230).expect_err("too short").to_string();
    assert!(error.contains("--seconds"), "{error}");
    random_curves(&mut rng, &[recording(280), recording(280)], 280).expect("one stretch of each");
}

#[test]
fn heads_sway_by_about_20_degrees_without_jumps() {
    for seed in 0..10 {
        let sway = random_sway(&mut ChaCha8Rng::seed_from_u64(seed), 300);
        let yaw = sway.iter().map(|pose| pose[0].abs()).fold(0.0, f32::max);
        assert!((16.0..=22.0).contains(&yaw), "{yaw}");
        assert!(sway.windows(2).all(|pair| (pair[1][0] - pair[0][0]).abs() < 4.0));
    }
}

#[test]
fn each_coefficient_alone_follows_two_periods_of_a_sine_from_0_to_1_and_lips_close_over_an_open_jaw() {
    let [jaw, close] = ["jawOpen", "mouthClose"].map(index_of);
    let parts = sines(&[jaw, close]);
    assert_eq!(parts.iter().map(|part| part.name).collect::<Vec<_>>(), ["rest", "jawOpen", "mouthClose"]);
    assert!(part(&parts, "rest").iter().all(|moment| moment.face == [0.0; COEFFS]));
    let wave = part(&parts, "jawOpen");
    assert_eq!(wave.len(), 60);
    for (frame, wanted) in [(0, 0.0), (5, 0.25), (15, 1.0), (30, 0.0), (45, 1.0)] {
        assert!((wave[frame].face[jaw] - wanted).abs() < 1e-5, "frame {frame}");
    }
    assert!(wave.iter().all(|moment| (moment.face.iter().sum::<f32>() - moment.face[jaw]).abs() < 1e-6));
    let closed = part(&parts, "mouthClose")[15].face;
    assert!((closed[jaw] - 1.0).abs() < 1e-5 && (closed[close] - 1.0).abs() < 1e-5);
}
