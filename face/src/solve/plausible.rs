//! Rules of anatomy that coefficients obey, whatever the regression computed.
//!
//! - `mouthClose` says how far the lips close over an open jaw: it is at most `jawOpen`.
//! - Opposed blendshapes, such as `jawLeft` and `jawRight`, are not shown together ([`opposed`]).
//! - The lids: a blink closes both alike, and a wink leaves the other eye open ([`lids`]).
//! - In a blink, the eye keeps its direction, which the camera cannot see then.
//! - A small value at rest is none ([`dead_zone`]). Gaze has no dead zone, because it hardly ever rests in the middle.
//!
//! Every rule is continuous, so that no rule makes a step.

mod gaze;
#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests;

use super::{BLENDSHAPES, COEFFS, Corrected, correction::smoothstep};
pub(super) use gaze::GazeState;
use gaze::hold_gaze;

/// The rules that are in force.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::struct_excessive_bools, reason = "each rule is a switch of its own")]
pub struct Rules {
    /// `mouthClose` is at most `jawOpen`.
    pub mouth_close: bool,
    /// Opposed blendshapes are not shown together.
    pub opposed: bool,
    /// A blink closes both lids alike, a wink one.
    pub lids: bool,
    /// An eye keeps its direction in a blink.
    pub gaze: bool,
    /// Values up to this one are 0; those above three times as much are unchanged. 0 leaves all unchanged.
    pub dead_zone: f32,
}

impl Rules {
    /// No rules.
    pub const OFF: Self = Self { mouth_close: false, opposed: false, lids: false, gaze: false, dead_zone: 0.0 };

    /// Makes the coefficients of a frame plausible that was captured `dt_s` seconds after the last one. Values that are not
    /// finite leave no trace in `state`.
    pub(super) fn step(self, state: &mut GazeState, corrected: &Corrected, dt_s: f32) -> Corrected {
        let mut out = corrected.0;
        if self.dead_zone > 0.0 {
            let with_dead_zone = out.iter_mut().enumerate().filter(|(index, _)| !GAZE.as_flattened().contains(index));
            with_dead_zone.for_each(|(_, value)| *value = dead_zone(*value, self.dead_zone));
        }
        if self.lids {
            change(&mut out, BLINKS, lids);
        }
        if self.opposed {
            for pair in OPPOSED {
                change(&mut out, pair, opposed);
            }
        }
        self.close_mouth(&mut out);
        if self.gaze {
            hold_gaze(state, &mut out, dt_s);
        } else {
            *state = GazeState::default();
        }
        Corrected(out)
    }

    /// Limits `mouthClose` to `jawOpen`. Filters can undo this, because the two have filters of their own.
    pub(super) fn close_mouth(self, values: &mut [f32; COEFFS]) {
        let [close, open] = pick(values, [MOUTH_CLOSE, JAW_OPEN]);
        if self.mouth_close && close > open {
            put(values, [MOUTH_CLOSE], [open]);
        }
    }
}

/// Turns values up to `zone` into 0. Above, the curve rises without a step or a kink to meet the value itself at three
/// times the zone.
fn dead_zone(value: f32, zone: f32) -> f32 {
    let u = (value - zone) / (2.0 * zone);
    // The cubic from 0 with slope 0 to 3 zones with slope 1, over a width of 2 zones.
    let cubic = zone * u * u * (7.0 - 4.0 * u);
    if u >= 1.0 {
        value
    } else if u <= 0.0 {
        0.0
    } else {
        cubic
    }
}

/// Only the larger of two opposed values remains, and is reduced the more, the nearer the smaller one is to it.
///
/// `a (1 - (b/a)^4)` is 0 where both are equal, so that there is no step, and hardly less than `a` where `b` is less than half.
fn opposed([a, b]: [f32; 2]) -> [f32; 2] {
    let less = |large: f32, small: f32| if large <= small { 0.0 } else { large - large * (small / large).powi(4) };
    [less(a, b), less(b, a)]
}

/// Half of the difference of the lids up to which a blink is meant.
const BLINK_DIFFERENCE: f32 = 0.1;
/// Half of the difference of the lids from which on a wink is meant.
const WINK_DIFFERENCE: f32 = 0.25;

/// Draws the values of the lids together while they are nearly alike, and leaves them more and more to themselves, the
/// more they differ. A blink closes both as far as the one that is further shut. In a wink, the
/// lid that is further open loses the share of the winking lid's closure that shows at it ([`WINK_LEAK`]).
fn lids([left, right]: [f32; 2]) -> [f32; 2] {
    let half = 0.5 * (left - right).abs();
    let wink = smoothstep(half, [BLINK_DIFFERENCE, WINK_DIFFERENCE]);
    let (open, shut) = (left.min(right), left.max(right));
    let both = 0.5 * (left + right) + half * ((shut - 0.3) / 0.5).clamp(0.0, 1.0);
    // In a wink, a part of the other lid's reading comes from the winking lid.
    let free = (open - WINK_LEAK * wink * shut).max(0.0);
    let [shut, open] = [both + wink * (shut - both), (1.0 - wink) * both + wink * free];
    if left >= right { [shut, open] } else { [open, shut] }
}

/// The share of a winking lid that shows at the other one.
const WINK_LEAK: f32 = 0.4;

/// The place of a blendshape. An unknown name does not compile.
#[allow(clippy::indexing_slicing, reason = "runs at compile time, where an index out of range is an error")]
const fn index_of(name: &str) -> usize {
    let mut index = 0;
    while !is_same(BLENDSHAPES[index], name) {
        index += 1;
    }
    index
}

#[allow(clippy::indexing_slicing, reason = "runs at compile time, where an index out of range is an error")]
const fn is_same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    let mut index = 0;
    while index < a.len() && index < b.len() && a[index] == b[index] {
        index += 1;
    }
    index == a.len() && index == b.len()
}

/// `eyeBlink`, left and right.
const BLINKS: [usize; 2] = [index_of("eyeBlinkLeft"), index_of("eyeBlinkRight")];
/// The directions of the left and of the right eye.
const GAZE: [[usize; 4]; 2] = [
    [index_of("eyeLookDownLeft"), index_of("eyeLookInLeft"), index_of("eyeLookOutLeft"), index_of("eyeLookUpLeft")],
    [index_of("eyeLookDownRight"), index_of("eyeLookInRight"), index_of("eyeLookOutRight"), index_of("eyeLookUpRight")],
];
const JAW_OPEN: usize = index_of("jawOpen");
const MOUTH_CLOSE: usize = index_of("mouthClose");
/// Pairs of blendshapes that move the same part in opposite directions. Others, such as smile and frown, are made by
/// muscles that can pull at the same time.
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

/// The values at these places.
fn pick<const N: usize>(values: &[f32; COEFFS], places: [usize; N]) -> [f32; N] {
    places.map(|place| values.get(place).copied().unwrap_or(0.0))
}

/// Replaces the values at these places.
fn put<const N: usize>(values: &mut [f32; COEFFS], places: [usize; N], new: [f32; N]) {
    for (place, new) in places.into_iter().zip(new) {
        if let Some(value) = values.get_mut(place) {
            *value = new;
        }
    }
}

/// Replaces the values at these places by what `rule` makes of them.
fn change<const N: usize>(values: &mut [f32; COEFFS], places: [usize; N], rule: impl Fn([f32; N]) -> [f32; N]) {
    let new = rule(pick(values, places));
    put(values, places, new);
}
