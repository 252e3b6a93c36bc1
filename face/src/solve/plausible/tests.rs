//! What the rules promise.

use super::*;

const FRAME_S: f32 = 1.0 / 30.0;
const ALL: Rules = Rules { mouth_close: true, opposed: true, lids: true, gaze: true, dead_zone: 0.03 };
/// Each rule alone, and all of them.
const EACH: [Rules; 6] = [
    Rules { mouth_close: true, ..Rules::OFF },
    Rules { opposed: true, ..Rules::OFF },
    Rules { lids: true, ..Rules::OFF },
    Rules { gaze: true, ..Rules::OFF },
    Rules { dead_zone: 0.03, ..Rules::OFF },
    ALL,
];

fn step(rules: Rules, state: &mut GazeState, values: [f32; COEFFS]) -> [f32; COEFFS] {
    rules.step(state, &Corrected(values), FRAME_S).0
}

fn once(values: [f32; COEFFS]) -> [f32; COEFFS] {
    step(ALL, &mut GazeState::default(), values)
}

fn face(named: &[(&str, f32)]) -> [f32; COEFFS] {
    let mut values = [0.0; COEFFS];
    for (name, value) in named {
        values[BLENDSHAPES.iter().position(|known| known == name).unwrap_or(COEFFS)] = *value;
    }
    values
}

/// Shows both eyes shut this far and the left one looking down; returns how far it is shown to look down.
fn look(state: &mut GazeState, shut: f32, down: f32) -> f32 {
    let values = face(&[("eyeBlinkLeft", shut), ("eyeBlinkRight", shut), ("eyeLookDownLeft", down)]);
    pick(&step(ALL, state, values), [GAZE[0][0]])[0]
}

fn random_face(random: &mut fastrand::Rng) -> [f32; COEFFS] {
    [(); COEFFS].map(|()| if random.bool() { random.f32() } else { 0.1 * random.f32() })
}

#[test]
fn no_rule_makes_a_step_or_leaves_the_range() {
    let mut random = fastrand::Rng::with_seed(1);
    for rules in EACH {
        let mut state = GazeState::default();
        for _ in 0..2000 {
            let values = random_face(&mut random);
            let change = 0.001;
            let near = values.map(|value| (value + change * (2.0 * random.f32() - 1.0)).clamp(0.0, 1.0));
            let [a, b] = [values, near].map(|values| step(rules, &mut state.clone(), values));
            assert!(a.iter().all(|value| (0.0..=1.0).contains(value)), "{rules:?}: {a:?}");
            // The rules follow each other, and the slope of each is at most about 3.
            let largest = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(largest < 20.0 * change, "{rules:?}: {largest}");
            step(rules, &mut state, values);
        }
    }
}

#[test]
fn value_that_is_not_a_number_affects_no_later_frame() {
    let mut random = fastrand::Rng::with_seed(3);
    for rules in EACH {
        let mut state = GazeState::default();
        step(rules, &mut state, random_face(&mut random));
        step(rules, &mut state, [f32::NAN; COEFFS]);
        let values = random_face(&mut random);
        let after = step(rules, &mut state, values);
        assert_eq!(after, step(rules, &mut GazeState::default(), values));
        assert!(after.iter().all(|value| value.is_finite()));
    }
}

#[test]
fn lips_close_only_as_far_as_the_jaw_is_open() {
    let close = |jaw| pick(&once(face(&[("jawOpen", jaw), ("mouthClose", 0.5)])), [MOUTH_CLOSE])[0];
    assert_eq!((close(0.0), close(0.2), close(0.8)), (0.0, 0.2, 0.5));
}

#[test]
fn of_opposed_movements_only_the_larger_is_shown_and_hardly_reduced_by_noise() {
    for pair in OPPOSED {
        let shown = |a: f32, b: f32| {
            let mut values = [0.0; COEFFS];
            put(&mut values, pair, [a, b]);
            pick(&step(EACH[1], &mut GazeState::default(), values), pair)
        };
        let [larger, smaller] = shown(0.8, 0.1);
        assert!(larger > 0.78 && smaller == 0.0);
        assert_eq!(shown(0.4, 0.4), [0.0, 0.0]);
        assert_eq!(shown(0.0, 0.3), [0.0, 0.3]);
        assert_eq!(shown(0.0, 0.0), [0.0, 0.0]);
    }
}

#[test]
fn blink_closes_both_lids_alike_and_a_wink_one() {
    let shown = |left, right| pick(&once(face(&[("eyeBlinkLeft", left), ("eyeBlinkRight", right)])), BLINKS);
    let [left, right] = shown(0.97, 0.85);
    assert!((left - right).abs() < 1e-6 && left > 0.9, "{left} {right}");
    for leak in [0.0, 0.1, 0.2, 0.3, 0.4] {
        let [left, right] = shown(0.95, leak);
        assert!(left > 0.9 && right < 0.2, "{leak}: {left} {right}");
        let mirrored = shown(leak, 0.95);
        assert_eq!(mirrored, [right, left]);
    }
}

#[test]
fn shut_eye_keeps_its_direction_and_moves_on_from_it_when_it_opens() {
    let mut state = GazeState::default();
    let mut show = |shut, down| look(&mut state, shut, down);
    show(0.0, 0.1);
    let shut: Vec<f32> =
        [(0.3, 0.1), (0.8, 0.7), (1.0, 0.9), (1.0, 0.9), (0.8, 0.7)].map(|(shut, down)| show(shut, down)).into();
    assert!(shut.iter().all(|down| (down - 0.1).abs() < 0.02), "{shut:?}");
    let opened = [(0.5, 0.3), (0.2, 0.12), (0.0, 0.1)].map(|(shut, down)| show(shut, down));
    assert!(opened.iter().all(|down| *down < 0.25) && (opened[2] - 0.1).abs() < 0.01, "{opened:?}");
}

#[test]
fn eye_that_stays_shut_for_longer_than_a_blink_is_followed_without_a_step() {
    let mut state = GazeState::default();
    let mut show = |shut, down| look(&mut state, shut, down);
    show(0.0, 0.1);
    let shown: Vec<f32> = (0..40).map(|_| show(1.0, 0.8)).collect();
    assert!(shown[..11].iter().all(|down| (down - 0.1).abs() < 0.02), "{shown:?}");
    assert!((shown[30] - 0.8).abs() < 0.01, "{shown:?}");
    assert!(shown.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.25), "{shown:?}");
}

#[test]
fn eye_that_looks_down_under_a_lowered_lid_is_followed() {
    let mut state = GazeState::default();
    let down: Vec<f32> = (0..6).map(|_| look(&mut state, 0.5, 0.9)).collect();
    assert!(down[5] > 0.85, "{down:?}");
}

#[test]
fn small_values_at_rest_are_none_and_larger_ones_unchanged() {
    let at = |value| pick(&once(face(&[("browInnerUp", value)])), [43])[0];
    assert_eq!(BLENDSHAPES[43], "browInnerUp");
    assert_eq!((at(0.03), at(0.09), at(0.5)), (0.0, 0.09, 0.5));
    let curve: Vec<f32> = (0_u8..=120).map(|i| at(f32::from(i) / 1000.0)).collect();
    assert!(curve.windows(2).all(|pair| pair[1] >= pair[0] && pair[1] - pair[0] < 0.0025));
}
