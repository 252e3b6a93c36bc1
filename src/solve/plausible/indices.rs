//! The places of some blendshapes in [`BLENDSHAPES`].

use crate::solve::{BLENDSHAPES, COEFFS};

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
pub const BLINKS: [usize; 2] = [index_of("eyeBlinkLeft"), index_of("eyeBlinkRight")];
/// The directions of the left and of the right eye.
pub const GAZE: [[usize; 4]; 2] = [
    [index_of("eyeLookDownLeft"), index_of("eyeLookInLeft"), index_of("eyeLookOutLeft"), index_of("eyeLookUpLeft")],
    [index_of("eyeLookDownRight"), index_of("eyeLookInRight"), index_of("eyeLookOutRight"), index_of("eyeLookUpRight")],
];
pub const JAW_OPEN: usize = index_of("jawOpen");
pub const MOUTH_CLOSE: usize = index_of("mouthClose");
/// Pairs of blendshapes that move the same part in opposite directions. Others, such as smile and frown, are made by
/// muscles that can pull at the same time.
pub const OPPOSED: [[usize; 2]; 8] = [
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
pub fn pick<const N: usize>(values: &[f32; COEFFS], places: [usize; N]) -> [f32; N] {
    places.map(|place| values.get(place).copied().unwrap_or(0.0))
}

/// Replaces the values at these places.
pub fn put<const N: usize>(values: &mut [f32; COEFFS], places: [usize; N], new: [f32; N]) {
    for (place, new) in places.into_iter().zip(new) {
        if let Some(value) = values.get_mut(place) {
            *value = new;
        }
    }
}

/// Replaces the values at these places by what `rule` makes of them.
pub fn change<const N: usize>(values: &mut [f32; COEFFS], places: [usize; N], rule: impl Fn([f32; N]) -> [f32; N]) {
    let new = rule(pick(values, places));
    put(values, places, new);
}
