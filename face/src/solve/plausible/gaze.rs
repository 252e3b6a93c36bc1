//! An eye keeps its direction in a blink.
//!
//! The lid hides the iris before it is shut, so the direction follows the regression ever more slowly while the lid
//! closes, and stops once it has closed. While the lid opens, the direction moves on from where it was. A lowered lid,
//! as of an eye that looks down, is not shut: the direction then still follows within a few frames. Eyes that stay shut for
//! longer than any blink are followed again, so that they look where the wearer looks when they open.

use super::{BLINKS, GAZE, pick, put};
use crate::solve::{COEFFS, correction::smoothstep, filter::LONGEST_STEP_S};

/// The directions of the left and of the right eye in the last frame, and for how long each lid has been further shut
/// than [`LOWERED`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(in crate::solve) struct GazeState {
    directions: Option<[[f32; 4]; 2]>,
    shut_s: [f32; 2],
}

/// From this closure on the direction follows more slowly.
const LOWERED: f32 = 0.35;
/// From this closure on the direction stays.
const SHUT: f32 = 0.75;
/// The direction is held until an eye has been shut for the first of these times, and is free again from the second on.
const BLINK_S: [f32; 2] = [0.4, 0.8];
/// The time at which the share that a closure holds is meant, seconds.
const FRAME_S: f32 = 1.0 / 30.0;

/// Holds the directions of eyes that are shut, `dt_s` seconds after the last frame.
pub(super) fn hold_gaze(state: &mut GazeState, values: &mut [f32; COEFFS], dt_s: f32) {
    if !(0.0..=LONGEST_STEP_S).contains(&dt_s) {
        *state = GazeState::default();
    }
    let closures = pick(values, BLINKS);
    let mut directions = GAZE.map(|places| pick(values, places));
    let last = state.directions.unwrap_or(directions);
    let eyes = directions.iter_mut().zip(last).zip(closures.into_iter().zip(&mut state.shut_s));
    for ((now, last), (closure, shut_s)) in eyes {
        *shut_s = if closure > LOWERED && dt_s.is_finite() { *shut_s + dt_s } else { 0.0 };
        let held = held_share(closure, *shut_s, dt_s);
        now.iter_mut().zip(last).for_each(|(now, last)| *now += held * (last - *now));
    }
    GAZE.into_iter().zip(directions).for_each(|(places, now)| put(values, places, now));
    let is_finite = directions.as_flattened().iter().all(|value| value.is_finite());
    state.directions = is_finite.then_some(directions);
}

/// The share of the last direction that a lid with this closure, shut since `shut_s`, holds over `dt_s`.
fn held_share(closure: f32, shut_s: f32, dt_s: f32) -> f32 {
    let share = smoothstep(closure, [LOWERED, SHUT]) * (1.0 - smoothstep(shut_s, BLINK_S));
    if share > 0.0 { share.powf(dt_s / FRAME_S) } else { 0.0 }
}
