//! The pose to which a half of the face returns. It is at rest there, even if its outputs read like an expression: large eyes
//! read as wide, low brows as lowered, thin lips as pressed.

use super::COEFFS;
use super::correction::smoothstep;
use super::filter::{approach, difference, square};
use super::plausible::{BLINKS, put};

/// Distance of outputs up to which two poses are the same one, and from which on the half has left it.
const SAME: f32 = 0.3;
const LEFT: f32 = 0.45;
/// Time over which the outputs of the pose are averaged, seconds.
const AVERAGE_S: f32 = 5.0;
/// By how much the time in the pose must exceed the time in all others until it counts and until it is certain, and the most
/// that is counted, seconds.
const LEAD_S: [f32; 2] = [4.0, 10.0];
const MOST_LEAD_S: f32 = 30.0;
/// How often the half must have come back to the pose. Who raises their brows for a minute does not come back.
const RETURNS: u32 = 3;
/// Share of this lead at which evidence of ordinary rest makes the pose an expression: the half has been seen at rest elsewhere.
const ORDINARY: f32 = 0.1;
/// Root sum square of the outputs up to which the pose may be rest, and from which on it is an expression.
const EXPRESSION: [f32; 2] = [0.75, 0.9];

/// The pose in which a half of the face has been still for longer than in all others together, if there is one: whenever it is
/// still in another pose, the lead falls, and where none is left, the other pose takes its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Usual {
    outputs: [f32; COEFFS],
    lead_s: f32,
    returns: u32,
    has_left: bool,
    /// Evidence of rest near the mean of many people, seconds.
    ordinary_s: f32,
}

impl Default for Usual {
    fn default() -> Self {
        Self { outputs: [0.0; COEFFS], lead_s: 0.0, returns: 0, has_left: false, ordinary_s: 0.0 }
    }
}

impl Usual {
    /// Takes in the outputs of a half of the face in a frame, whether it is still, and how sure it is that this is ordinary
    /// rest, from 0 to 1.
    pub(super) fn see(&mut self, outputs: &[f32; COEFFS], is_still: bool, ordinary: f32, dt_s: f32) {
        self.ordinary_s = (self.ordinary_s + ordinary * dt_s).min(MOST_LEAD_S);
        let mut unlike = difference(*outputs, self.outputs);
        let distance = square(unlike).sqrt();
        // A blink is no other pose.
        put(&mut unlike, BLINKS, [0.0; 2]);
        self.has_left |= square(unlike).sqrt() > LEFT;
        if !is_still {
            return;
        }
        if distance <= SAME {
            self.returns = self.returns.saturating_add(u32::from(self.has_left));
            self.has_left = false;
            self.lead_s = (self.lead_s + dt_s).min(MOST_LEAD_S);
            approach(&mut self.outputs, outputs, (dt_s / self.lead_s.min(AVERAGE_S)).min(1.0));
        } else if self.lead_s > dt_s {
            self.lead_s -= dt_s;
        } else {
            *self = Self { outputs: *outputs, ordinary_s: self.ordinary_s, ..Self::default() };
        }
    }

    /// The outputs of rest: those of this pose as far as it is certain, else those of ordinary rest, 0.
    pub(super) fn rest(&self) -> [f32; COEFFS] {
        let certain = if self.returns < RETURNS { 0.0 } else { smoothstep(self.lead_s, LEAD_S) };
        let ordinary = (self.ordinary_s / (ORDINARY * self.lead_s.max(1.0))).min(1.0);
        let expression = smoothstep(square(self.outputs).sqrt(), EXPRESSION);
        self.outputs.map(|output| certain * (1.0 - ordinary) * (1.0 - expression) * output)
    }
}

#[cfg(test)]
mod tests {
    use core::iter;

    use super::*;
    use crate::solve::filter::FRAME_S;
    use crate::solve::plausible::index_of;

    const WIDE: [usize; 2] = [index_of("eyeWideLeft"), index_of("eyeWideRight")];
    const RAISED: [usize; 2] = [index_of("browOuterUpLeft"), index_of("browOuterUpRight")];

    fn pose(places: [usize; 2], value: f32) -> [f32; COEFFS] {
        let mut outputs = [0.0; COEFFS];
        put(&mut outputs, places, [value; 2]);
        outputs
    }

    fn held(outputs: [f32; COEFFS], seconds: f32) -> impl Iterator<Item = [f32; COEFFS]> + Clone {
        iter::repeat_n(outputs, (seconds / FRAME_S) as usize)
    }

    /// What is known of rest after still frames with these outputs, all of which are this much like ordinary rest.
    fn rest(ordinary: f32, frames: impl IntoIterator<Item = [f32; COEFFS]>) -> [f32; COEFFS] {
        let mut usual = Usual::default();
        frames.into_iter().for_each(|outputs| usual.see(&outputs, true, ordinary, FRAME_S));
        usual.rest()
    }

    /// Large eyes at rest, and raised brows in between.
    fn large_eyes(rounds: usize) -> impl Iterator<Item = [f32; COEFFS]> {
        let round = held(pose(WIDE, 0.4), 4.0).chain(held(pose(RAISED, 0.7), 1.0));
        iter::repeat_n(round, rounds).flatten()
    }

    #[test]
    fn the_pose_to_which_a_half_returns_is_rest_and_one_that_is_only_held_or_interrupted_by_blinks_is_not() {
        assert_eq!(rest(0.0, large_eyes(3)), [0.0; COEFFS]);
        let learned = rest(0.0, large_eyes(5));
        assert!(WIDE.iter().all(|place| (learned[*place] - 0.4).abs() < 0.01), "{learned:?}");
        let blinks = held(pose(RAISED, 0.4), 4.0).chain(held(pose(BLINKS, 0.9), 0.2));
        assert_eq!(rest(0.0, iter::repeat_n(blinks, 20).flatten()), [0.0; COEFFS]);
    }

    #[test]
    fn a_pose_is_no_rest_if_the_half_is_seen_at_ordinary_rest_or_if_it_is_a_strong_expression() {
        assert_eq!(rest(0.1, large_eyes(5)), [0.0; COEFFS]);
        let strong = held(pose(WIDE, 0.7), 4.0).chain(held([0.0; COEFFS], 1.0));
        assert_eq!(rest(0.0, iter::repeat_n(strong, 5).flatten()), [0.0; COEFFS]);
    }

    #[test]
    fn a_pose_that_takes_more_than_half_of_the_time_takes_the_place_of_another() {
        let before = held(pose(RAISED, 0.7), 10.0);
        let learned = rest(0.0, before.chain(large_eyes(10)));
        assert!(WIDE.iter().all(|place| (learned[*place] - 0.4).abs() < 0.01), "{learned:?}");
    }
}
