//! Rules of anatomy that coefficients obey, whatever the regression computed.
//!
//! - `mouthClose` says how far the lips close over an open jaw: it is at most `jawOpen`.
//! - Opposed blendshapes, such as `jawLeft` and `jawRight`, are not shown together ([`opposed`]).
//! - The lids: a blink closes both alike, and a wink leaves the other eye open ([`lids`]).
//! - In a blink, the eye keeps its direction, which the camera cannot see then ([`GazeState`]).
//! - A small value at rest is none ([`dead_zone`]). Gaze has no dead zone, because it hardly ever rests in the middle.
//!
//! Every rule is a continuous function, so that no output jumps when a rule begins to apply.

use super::filter::{FRAME_S, LONGEST_STEP_S};
use super::{BLENDSHAPES, COEFFS, Coefficients, correction::smoothstep};

/// The rules that are in force.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::struct_excessive_bools, reason = "each rule is a switch of its own")]
#[non_exhaustive]
pub struct Rules {
    /// `mouthClose` is at most `jawOpen`.
    pub mouth_close: bool,
    /// Opposed blendshapes are not shown together.
    pub opposed: bool,
    /// A blink closes both lids alike, a wink only one.
    pub lids: bool,
    /// An eye keeps its direction in a blink.
    pub gaze: bool,
    /// Values up to this one are 0; those above three times as much are unchanged. 0 leaves all unchanged.
    pub dead_zone: f32,
}

impl Rules {
    /// What the service does by default: all rules.
    pub const ALL: Self = Self { mouth_close: true, opposed: true, lids: true, gaze: true, dead_zone: 0.02 };
    /// No rules.
    pub const OFF: Self = Self { mouth_close: false, opposed: false, lids: false, gaze: false, dead_zone: 0.0 };

    /// Applies the rules to a frame `dt_s` after the last one. Values that are not finite leave no trace in `state`.
    pub(super) fn step(self, state: &mut GazeState, mut values: Coefficients, dt_s: f32) -> Coefficients {
        let out = &mut values.0;
        if self.dead_zone > 0.0 {
            let with_dead_zone = out.iter_mut().enumerate().filter(|(index, _)| !GAZE.as_flattened().contains(index));
            with_dead_zone.for_each(|(_, value)| *value = dead_zone(*value, self.dead_zone));
        }
        if self.lids {
            let lids = lids(pick(out, BLINKS));
            put(out, BLINKS, lids);
        }
        if self.opposed {
            for pair in OPPOSED {
                let pulling = opposed(pick(out, pair));
                put(out, pair, pulling);
            }
        }
        self.close_mouth(out);
        if self.gaze {
            state.hold(out, dt_s);
        } else {
            *state = GazeState::default();
        }
        values
    }

    /// Limits `mouthClose` to `jawOpen`. Filters can undo this, because the two have filters of their own.
    pub(super) fn close_mouth(self, values: &mut [f32; COEFFS]) {
        let [close, open] = pick(values, [MOUTH_CLOSE, JAW_OPEN]);
        if self.mouth_close && close > open {
            put(values, [MOUTH_CLOSE], [open]);
        }
    }
}

/// Turns values up to `zone` into 0. Above, the curve rises without a kink to meet the value at three times the zone.
fn dead_zone(value: f32, zone: f32) -> f32 {
    match (value - zone) / (2.0 * zone) {
        1.0.. => value,
        ..=0.0 => 0.0,
        // The cubic from 0 with slope 0 to 3 zones with slope 1, over a width of 2 zones.
        u => zone * u * u * (7.0 - 4.0 * u),
    }
}

/// Only the larger of two opposed values remains: `a (1 - (b/a)^4)` is 0 where both are equal, so that there is no step,
/// and hardly less than `a` where `b` is less than half.
fn opposed([a, b]: [f32; 2]) -> [f32; 2] {
    let less = |large: f32, small: f32| if large <= small { 0.0 } else { large - large * (small / large).powi(4) };
    [less(a, b), less(b, a)]
}

/// If half the difference between the lids is at most the first value, this is a blink; from the second on, a wink.
const WINK_DIFFERENCE: [f32; 2] = [0.1, 0.25];
/// Share of the winking lid's value that may appear at the other lid as well.
const WINK_LEAK: f32 = 0.4;

/// Draws the values of the lids together: the more they differ, the less. A blink closes both as far as the one that is
/// further shut. In a wink, the lid that is further open loses what comes from the winking lid ([`WINK_LEAK`]).
fn lids([left, right]: [f32; 2]) -> [f32; 2] {
    let half = 0.5 * (left - right).abs();
    let wink = smoothstep(half, WINK_DIFFERENCE);
    let open = left.min(right);
    let shut = left.max(right);
    let both = 0.5 * (left + right) + half * ((shut - 0.3) / 0.5).clamp(0.0, 1.0);
    let free = (open - WINK_LEAK * wink * shut).max(0.0);
    let shut = both + wink * (shut - both);
    let open = (1.0 - wink) * both + wink * free;
    if left >= right { [shut, open] } else { [open, shut] }
}

/// The closures from which on the direction of an eye follows more slowly, and from which on it stays.
const LOWERED: f32 = 0.35;
const SHUT: f32 = 0.75;
/// The direction is held until an eye has been shut for the first of these times, and is free again from the second on.
const BLINK_S: [f32; 2] = [0.4, 0.8];

/// The directions of the left and of the right eye in the last frame, and for how long each lid has been further shut
/// than [`LOWERED`].
///
/// The lid hides the iris before it is shut, so the direction follows the regression ever more slowly while the lid
/// closes, and stops once it has closed. A lowered lid, as of an eye that looks down, is not shut. Eyes that stay shut for
/// longer than any blink are followed again, so that they look where the wearer looks when they open.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct GazeState {
    directions: Option<[[f32; 4]; 2]>,
    shut_s: [f32; 2],
}

impl GazeState {
    fn hold(&mut self, values: &mut [f32; COEFFS], dt_s: f32) {
        if !(0.0..=LONGEST_STEP_S).contains(&dt_s) {
            *self = Self::default();
        }
        let closures = pick(values, BLINKS);
        let mut directions = GAZE.map(|places| pick(values, places));
        let last = self.directions.unwrap_or(directions);
        let eyes = directions.iter_mut().zip(last).zip(closures.into_iter().zip(&mut self.shut_s));
        for ((now, last), (closure, shut_s)) in eyes {
            *shut_s = if closure > LOWERED && dt_s.is_finite() { *shut_s + dt_s } else { 0.0 };
            let share = smoothstep(closure, [LOWERED, SHUT]) * (1.0 - smoothstep(*shut_s, BLINK_S));
            // `share` is that of one frame at 30 frames a second.
            let held = if share > 0.0 { share.powf(dt_s / FRAME_S) } else { 0.0 };
            now.iter_mut().zip(last).for_each(|(now, last)| *now += held * (last - *now));
        }
        GAZE.into_iter().zip(directions).for_each(|(places, now)| put(values, places, now));
        let is_finite = directions.as_flattened().iter().all(|value| value.is_finite());
        self.directions = is_finite.then_some(directions);
    }
}

/// The place of a blendshape. An unknown name does not compile.
#[allow(clippy::indexing_slicing, reason = "runs at compile time, where an index out of range is an error")]
pub(super) const fn index_of(name: &str) -> usize {
    let mut index = 0;
    while !BLENDSHAPES[index].eq_ignore_ascii_case(name) {
        index += 1;
    }
    index
}

pub(super) const BLINKS: [usize; 2] = [index_of("eyeBlinkLeft"), index_of("eyeBlinkRight")];
/// The coefficients of the lids of the left eye and of the right.
pub(super) const LIDS: [[usize; 2]; 3] = [
    BLINKS,
    [index_of("eyeSquintLeft"), index_of("eyeSquintRight")],
    [index_of("eyeWideLeft"), index_of("eyeWideRight")],
];
pub(super) const GAZE: [[usize; 4]; 2] = [
    [index_of("eyeLookDownLeft"), index_of("eyeLookInLeft"), index_of("eyeLookOutLeft"), index_of("eyeLookUpLeft")],
    [index_of("eyeLookDownRight"), index_of("eyeLookInRight"), index_of("eyeLookOutRight"), index_of("eyeLookUpRight")],
];
pub(super) const JAW_OPEN: usize = index_of("jawOpen");
const MOUTH_CLOSE: usize = index_of("mouthClose");
/// Pairs that move the same part in opposite directions. Smile and frown are made by muscles that can pull together.
const OPPOSED: [[usize; 2]; 8] = [
    [index_of("eyeBlinkLeft"), index_of("eyeWideLeft")],
    [index_of("eyeBlinkRight"), index_of("eyeWideRight")],
    [index_of("eyeLookUpLeft"), index_of("eyeLookDownLeft")],
    [index_of("eyeLookUpRight"), index_of("eyeLookDownRight")],
    [index_of("eyeLookInLeft"), index_of("eyeLookOutLeft")],
    [index_of("eyeLookInRight"), index_of("eyeLookOutRight")],
    [index_of("jawLeft"), index_of("jawRight")],
    [index_of("mouthLeft"), index_of("mouthRight")],
];

pub(super) fn pick<const N: usize>(values: &[f32; COEFFS], places: [usize; N]) -> [f32; N] {
    places.map(|place| values.get(place).copied().unwrap_or(0.0))
}

pub(super) fn put<const N: usize>(values: &mut [f32; COEFFS], places: [usize; N], new: [f32; N]) {
    for (place, new) in places.into_iter().zip(new) {
        if let Some(value) = values.get_mut(place) {
            *value = new;
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;

    const ALL: Rules = Rules { mouth_close: true, opposed: true, lids: true, gaze: true, dead_zone: 0.03 };
    const OPPOSED_ALONE: Rules = Rules { opposed: true, ..Rules::OFF };

    fn step(rules: Rules, state: &mut GazeState, values: [f32; COEFFS]) -> [f32; COEFFS] {
        rules.step(state, Coefficients(values), FRAME_S).0
    }

    fn shown<const N: usize>(rules: Rules, places: [usize; N], new: [f32; N]) -> [f32; N] {
        let mut values = [0.0; COEFFS];
        put(&mut values, places, new);
        pick(&step(rules, &mut GazeState::default(), values), places)
    }

    fn random_face(random: &mut fastrand::Rng) -> [f32; COEFFS] {
        [(); COEFFS].map(|()| if random.bool() { random.f32() } else { 0.1 * random.f32() })
    }

    #[test]
    fn no_rule_makes_a_step_leaves_the_range_or_remembers_what_is_not_a_number() {
        let mut random = fastrand::Rng::with_seed(1);
        for rules in [OPPOSED_ALONE, ALL] {
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
            step(rules, &mut state, [f32::NAN; COEFFS]);
            let values = random_face(&mut fastrand::Rng::with_seed(3));
            let fresh = step(rules, &mut GazeState::default(), values);
            assert_eq!(step(rules, &mut state, values), fresh, "what is not a number affects no later frame");
        }
    }

    #[test]
    fn of_opposed_movements_only_the_larger_is_shown_and_hardly_reduced_by_noise() {
        for pair in OPPOSED {
            let shown = |a: f32, b: f32| shown(OPPOSED_ALONE, pair, [a, b]);
            let [larger, smaller] = shown(0.8, 0.1);
            assert!(larger > 0.78 && smaller == 0.0);
            assert_eq!([shown(0.4, 0.4), shown(0.0, 0.3), shown(0.0, 0.0)], [[0.0, 0.0], [0.0, 0.3], [0.0, 0.0]]);
        }
    }

    #[test]
    fn blink_closes_both_lids_alike_and_a_wink_one() {
        let [left, right] = shown(ALL, BLINKS, [0.97, 0.85]);
        assert!((left - right).abs() < 1e-6 && left > 0.9, "{left} {right}");
        for leak in [0.0, 0.1, 0.2, 0.3, 0.4] {
            let [left, right] = shown(ALL, BLINKS, [0.95, leak]);
            assert!(left > 0.9 && right < 0.2, "{leak}: {left} {right}");
            assert_eq!(shown(ALL, BLINKS, [leak, 0.95]), [right, left]);
        }
    }

    /// How far the left eye is shown to look down in each frame, given how far both eyes are shut and it looks down.
    fn looks(frames: impl IntoIterator<Item = (f32, f32)>) -> Vec<f32> {
        let mut state = GazeState::default();
        let mut look = |(shut, down)| {
            let mut values = [0.0; COEFFS];
            put(&mut values, [BLINKS[0], BLINKS[1], GAZE[0][0]], [shut, shut, down]);
            pick(&step(ALL, &mut state, values), [GAZE[0][0]])[0]
        };
        frames.into_iter().map(&mut look).collect()
    }

    #[test]
    fn shut_eye_keeps_its_direction_and_moves_on_from_it_when_it_opens() {
        let blink = [(0.0, 0.1), (0.3, 0.1), (0.8, 0.7), (1.0, 0.9), (1.0, 0.9), (0.8, 0.7)];
        let shown = looks(blink.into_iter().chain([(0.5, 0.3), (0.2, 0.12), (0.0, 0.1)]));
        assert!(shown[..6].iter().all(|down| (down - 0.1).abs() < 0.02), "{shown:?}");
        assert!(shown[6..].iter().all(|down| *down < 0.25) && (shown[8] - 0.1).abs() < 0.01, "{shown:?}");
    }

    #[test]
    fn eye_that_stays_shut_for_longer_than_a_blink_or_is_only_lowered_is_followed_without_a_step() {
        let shown = looks([(0.0, 0.1)].into_iter().chain([(1.0, 0.8); 40]));
        assert!(shown[..12].iter().all(|down| (down - 0.1).abs() < 0.02), "{shown:?}");
        assert!((shown[31] - 0.8).abs() < 0.01, "{shown:?}");
        assert!(shown.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.25), "{shown:?}");
        assert!(looks([(0.5, 0.1), (0.5, 0.9), (0.5, 0.9), (0.5, 0.9), (0.5, 0.9)])[4] > 0.85);
    }

    #[test]
    fn lips_close_only_as_far_as_the_jaw_is_open_and_small_values_at_rest_are_none() {
        let close = |jaw| shown(ALL, [MOUTH_CLOSE, JAW_OPEN], [0.5, jaw])[0];
        assert_eq!((close(0.0), close(0.2), close(0.8)), (0.0, 0.2, 0.5));
        let at = |value| shown(ALL, [index_of("browInnerUp")], [value])[0];
        assert_eq!((at(0.03), at(0.09), at(0.5)), (0.0, 0.09, 0.5));
    }
}
