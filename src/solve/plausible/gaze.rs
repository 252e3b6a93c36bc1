//! An eye keeps its direction while its lid is shut.
//!
//! The lid hides the iris before it is shut, so the direction follows the regression ever more slowly while the lid
//! closes, and stops once it has closed. While the lid opens, the direction moves on from where it was. A lowered lid,
//! as of an eye that looks down, is not shut: the direction then still follows within a few frames.

use super::{
    COEFFS,
    indices::{BLINKS, GAZE, pick, put},
};
use crate::solve::LONGEST_STEP_S;

/// The directions of the left and of the right eye in the last frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GazeState(Option<[[f32; 4]; 2]>);

/// From this closure on the direction follows more slowly.
const LOWERED: f32 = 0.35;
/// From this closure on the direction stays.
const SHUT: f32 = 0.75;
/// The time at which the share that a closure holds is meant, seconds.
const FRAME_S: f32 = 1.0 / 30.0;

/// Holds the directions of eyes that are shut, `dt_s` seconds after the last frame.
pub fn hold_gaze(state: &mut GazeState, values: &mut [f32; COEFFS], dt_s: f32) {
    let last = state.0.filter(|_| (0.0..=LONGEST_STEP_S).contains(&dt_s));
    let closures = pick(values, BLINKS);
    let mut directions = GAZE.map(|places| pick(values, places));
    let last = last.unwrap_or(directions);
    for ((now, last), closure) in directions.iter_mut().zip(last).zip(closures) {
        let held = held_share(closure, dt_s);
        now.iter_mut().zip(last).for_each(|(now, last)| *now += held * (last - *now));
    }
    GAZE.into_iter().zip(directions).for_each(|(places, now)| put(values, places, now));
    let is_finite = directions.as_flattened().iter().all(|value| value.is_finite());
    *state = GazeState(is_finite.then_some(directions));
}

/// The share of the last direction that a lid with this closure holds over `dt_s`.
fn held_share(closure: f32, dt_s: f32) -> f32 {
    let u = ((closure - LOWERED) / (SHUT - LOWERED)).clamp(0.0, 1.0);
    let share = u * u * (3.0 - 2.0 * u);
    if share > 0.0 { share.powf(dt_s / FRAME_S) } else { 0.0 }
}
