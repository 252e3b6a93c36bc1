//! Finds the pose to which a half of the face returns. The half is at rest there, even if its outputs read like an expression:
//! large eyes read as wide, low brows as lowered, thin lips as pressed.
//!
//! Limits: finding it takes at least 8 s more in that pose than in others, and three expressions in between. If a half is seen
//! at ordinary rest for a second within several minutes, no other pose counts as rest. If it never is, a frown to which the
//! wearer returns is learned, until they return more often to another pose.

use super::COEFFS;
use super::filter::{approach, distance, square};
use super::plausible::{BLINKS, pick, put};

/// Two poses are the same up to the first distance between their outputs. Beyond the second, the half has left its pose.
const SAME: f32 = 0.3;
const LEFT: f32 = 0.4;
/// Seconds away from the pose after which coming back counts as a return. A single frame may be wrong.
const AWAY_S: f32 = 0.15;
/// Time over which the outputs of the pose are averaged, seconds.
const AVERAGE_S: f32 = 5.0;
/// Seconds by which the time in the pose must exceed the time in others before the pose is rest, and the largest excess that is
/// kept.
const LEAD_S: f32 = 8.0;
const MOST_LEAD_S: f32 = 30.0;
/// How often the half must have come back to the pose. Somebody who keeps the brows raised for a minute does not come back.
const RETURNS: u32 = 3;
/// A pose is not rest if a lid's output exceeds the first value (the eyes are shut), or the root of the sum of the squares of
/// all outputs exceeds the second (a strong expression).
const SHUT: f32 = 0.4;
const EXPRESSION: f32 = 0.8;
/// The least likeness to ordinary rest that counts as evidence.
const ORDINARY: f32 = 0.2;
/// Seconds of evidence from which on the half rests ordinarily, and the most that is kept.
const ORDINARY_S: f32 = 0.5;
const MOST_ORDINARY_S: f32 = 5.0;
/// The time in which 63 % of the evidence fades, seconds.
const FADES_S: f32 = 600.0;

/// What is known of how a half of the face rests.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Usual {
    /// The outputs of rest, if it is not ordinary.
    rest: Option<[f32; COEFFS]>,
    pose: Pose,
    /// Seconds of evidence that the half rests as most people's does.
    ordinary_s: f32,
}

/// A pose in which a half of the face is still. While the half is still in another pose that may be rest, the lead falls. Once
/// none is left, the other pose replaces this one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pose {
    outputs: [f32; COEFFS],
    lead_s: f32,
    /// For how long the half has been away from the pose since it was last still there.
    away_s: f32,
    returns: u32,
}

impl Default for Pose {
    fn default() -> Self {
        Self::of([0.0; COEFFS])
    }
}

impl Usual {
    /// The outputs of rest: 0 for ordinary rest, that of most people.
    pub(super) fn rest(&self) -> [f32; COEFFS] {
        self.rest.unwrap_or([0.0; COEFFS])
    }

    /// Takes in the outputs of a half of a face that faces the camera, whether it is still, and how much like ordinary rest it
    /// is, from 0 to 1. Returns whether rest is another one now.
    pub(super) fn see(&mut self, outputs: &[f32; COEFFS], is_still: bool, ordinary: f32, dt_s: f32) -> bool {
        let before = self.rest();
        let evidence_s = if ordinary < ORDINARY { 0.0 } else { ordinary * dt_s };
        self.ordinary_s = (self.ordinary_s * (1.0 - dt_s / FADES_S) + evidence_s).min(MOST_ORDINARY_S);
        if self.rest.is_none() && self.ordinary_s >= ORDINARY_S {
            self.pose = Pose::default();
        } else {
            self.pose.see(outputs, is_still, dt_s);
        }
        if self.pose.lead_s >= LEAD_S && self.pose.returns >= RETURNS {
            self.rest = Some(self.pose.outputs);
        }
        distance(&self.rest(), &before) > SAME
    }

    /// Takes over what another model reads of a face for which this one gave the outputs `before`, if it is the face at rest.
    pub(super) fn read_again(&mut self, before: &[f32; COEFFS], outputs: [f32; COEFFS]) {
        let rest = self.rest.filter(|rest| distance(rest, before) <= SAME).map(|_| outputs);
        *self = Self { rest, ..Self::default() };
    }
}

impl Pose {
    fn of(outputs: [f32; COEFFS]) -> Self {
        Self { outputs, lead_s: 0.0, away_s: 0.0, returns: 0 }
    }

    fn see(&mut self, outputs: &[f32; COEFFS], is_still: bool, dt_s: f32) {
        let [own, other] = [&self.outputs, outputs].map(|outputs| {
            let mut open = *outputs;
            // A blink is no other pose.
            put(&mut open, BLINKS, [0.0; 2]);
            open
        });
        if distance(&own, &other) > LEFT {
            self.away_s += dt_s;
        }
        let [left, right] = pick(outputs, BLINKS);
        if !is_still || left.max(right) > SHUT || square(*outputs).sqrt() > EXPRESSION {
            return;
        }
        if distance(&self.outputs, outputs) <= SAME {
            self.returns = self.returns.saturating_add(u32::from(self.away_s >= AWAY_S));
            self.away_s = 0.0;
            self.lead_s = (self.lead_s + dt_s).min(MOST_LEAD_S);
            approach(&mut self.outputs, outputs, (dt_s / self.lead_s.min(AVERAGE_S)).min(1.0));
        } else if self.lead_s > dt_s {
            self.lead_s -= dt_s;
        } else {
            *self = Self::of(*outputs);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::filter::FRAME_S;
    use crate::solve::plausible::index_of;

    const WIDE: [usize; 2] = [index_of("eyeWideLeft"), index_of("eyeWideRight")];
    const RAISED: [usize; 2] = [index_of("browOuterUpLeft"), index_of("browOuterUpRight")];
    const NONE: [f32; COEFFS] = [0.0; COEFFS];
    const LARGE_EYES: [f32; COEFFS] = with(NONE, WIDE, 0.4);

    const fn with(mut outputs: [f32; COEFFS], [left, right]: [usize; 2], value: f32) -> [f32; COEFFS] {
        outputs[left] = value;
        outputs[right] = value;
        outputs
    }

    /// Shows a half whose likeness to ordinary rest is `ordinary`.
    fn watch(usual: &mut Usual, outputs: [f32; COEFFS], ordinary: f32, is_still: bool, seconds: f32) {
        let mut shown_s = 0.5 * FRAME_S;
        while shown_s < seconds {
            usual.see(&outputs, is_still, ordinary, FRAME_S);
            shown_s += FRAME_S;
        }
    }

    /// Shows the pose for 4 s and then `between` for `between_s`, `count` times.
    fn rounds(usual: &mut Usual, count: usize, pose: [f32; COEFFS], between: [f32; COEFFS], between_s: f32) {
        for _ in 0..count {
            watch(usual, pose, 0.0, true, 4.0);
            watch(usual, between, 0.0, false, between_s);
        }
    }

    fn large_eyed() -> Usual {
        let mut usual = Usual::default();
        rounds(&mut usual, 5, LARGE_EYES, with(LARGE_EYES, RAISED, 0.7), 1.0);
        usual
    }

    fn is_at(usual: &Usual, pose: [f32; COEFFS]) -> bool {
        distance(&usual.rest(), &pose) < 0.02
    }

    #[test]
    fn the_pose_to_which_a_half_returns_is_rest_and_one_that_is_only_held_is_not() {
        assert!(is_at(&large_eyed(), LARGE_EYES));
        let raised = with(NONE, RAISED, 0.4);
        let blinking = with(raised, BLINKS, 0.9);
        let wrong = with(NONE, WIDE, 0.7);
        for (between, between_s) in [(raised, 1.0), (blinking, 0.2), (wrong, FRAME_S)] {
            let mut usual = Usual::default();
            rounds(&mut usual, 20, raised, between, between_s);
            assert!(is_at(&usual, NONE), "{between_s}");
        }
    }

    #[test]
    fn a_strong_expression_and_shut_eyes_are_no_rest_and_change_nothing() {
        for pose in [with(NONE, RAISED, 0.6), with(NONE, BLINKS, 0.45)] {
            let mut usual = Usual::default();
            rounds(&mut usual, 20, pose, with(NONE, WIDE, 0.7), 1.0);
            assert!(is_at(&usual, NONE));
            let mut usual = large_eyed();
            rounds(&mut usual, 20, pose, with(NONE, WIDE, 0.7), 1.0);
            assert!(is_at(&usual, LARGE_EYES));
        }
    }

    #[test]
    fn a_half_that_rests_ordinarily_now_and_then_rests_nowhere_else() {
        let smile = with(NONE, [23, 24], 0.3);
        let mut usual = Usual::default();
        for _ in 0..20 {
            watch(&mut usual, NONE, 0.8, true, 1.0);
            rounds(&mut usual, 10, smile, with(NONE, WIDE, 0.7), 1.0);
            assert!(is_at(&usual, NONE));
        }
    }

    #[test]
    fn a_glance_that_reads_like_ordinary_rest_does_not_take_away_the_pose_of_rest_and_lasting_rest_does() {
        let mut usual = large_eyed();
        for _ in 0..20 {
            watch(&mut usual, NONE, 0.8, true, 1.5);
            rounds(&mut usual, 10, LARGE_EYES, with(NONE, RAISED, 0.7), 1.0);
            assert!(is_at(&usual, LARGE_EYES));
        }
        for _ in 0..15 {
            watch(&mut usual, NONE, 0.8, true, 4.0);
            watch(&mut usual, with(NONE, RAISED, 0.7), 0.0, false, 1.0);
        }
        assert!(is_at(&usual, NONE));
    }

    #[test]
    fn a_pose_slightly_like_ordinary_rest_is_still_rest_after_an_hour() {
        let mut usual = Usual::default();
        for _ in 0..1000 {
            watch(&mut usual, LARGE_EYES, 0.17, true, 4.0);
            watch(&mut usual, with(NONE, RAISED, 0.7), 0.0, true, 1.0);
        }
        assert!(is_at(&usual, LARGE_EYES));
    }

    #[test]
    fn another_pose_is_rest_only_once_the_half_has_come_back_to_it_too() {
        let mut usual = large_eyed();
        let lowered = with(NONE, RAISED, -0.4);
        watch(&mut usual, lowered, 0.0, true, 120.0);
        assert!(is_at(&usual, LARGE_EYES), "it has been held once");
        rounds(&mut usual, 5, lowered, with(NONE, RAISED, 0.7), 1.0);
        assert!(is_at(&usual, lowered));
    }

    #[test]
    fn another_model_reads_rest_again_and_evidence_of_ordinary_rest_is_dropped() {
        let read = with(NONE, WIDE, 0.1);
        let mut usual = large_eyed();
        usual.read_again(&LARGE_EYES, read);
        assert!(is_at(&usual, read));
        let mut usual = large_eyed();
        usual.read_again(&with(NONE, WIDE, 0.15), read);
        assert!(is_at(&usual, NONE), "not the face at rest");
        let mut usual = Usual::default();
        watch(&mut usual, NONE, 0.8, true, 10.0);
        usual.read_again(&NONE, LARGE_EYES);
        assert!(is_at(&usual, NONE), "ordinary rest");
        rounds(&mut usual, 5, LARGE_EYES, with(NONE, RAISED, 0.7), 1.0);
        assert!(is_at(&usual, LARGE_EYES));
    }
}
