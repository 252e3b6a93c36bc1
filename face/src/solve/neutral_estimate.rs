//! Estimates the wearer's neutral face during tracking.
//!
//! It averages the frames whose face is frontal, holds still but for the eyes, and is nearly at rest ([`RestWatch`]). Eyes and
//! brows rest while the mouth speaks: the upper half of the face ([`super::halves`]) is learned by itself. The lower half helps
//! only where the upper one is known as far, too.
//!
//! It judges rest by outputs that are measured from the mean of many people, not from the reference learned so far: otherwise
//! a lasting half-smile would look more like rest the more of it was learned. A half that is never seen at rest by this
//! measure, but returns to the same pose again and again, is at rest in that pose ([`super::usual`]): large eyes read as wide,
//! low brows as lowered. The reference moves at a bounded speed. When another person sits down ([`super::identity`]), it moves
//! back, and learning begins anew.
//!
//! Limits: nothing is learned of a wearer whose face at rest reads like a strong expression, or like an expression that is held
//! without a break. Only a calibration helps then.

use super::features::{Features, Neutral, Reference, measure};
use super::filter::{approach, difference, distance, passed};
use super::halves::{HALF_OF_MEASURE, Half, Halves, half_of};
use super::identity::{Identity, Verdict};
use super::plausible::{BLINKS, GAZE, pick, put};
use super::usual::Usual;
use super::{COEFFS, Coefficients, Normalised};
use crate::model::{MEASURES, Model};

const LONGEST_STEP_S: f32 = 0.1;
/// A longer pause between frames is a gap, seconds: somebody else may have sat down.
const GAP_S: f32 = 0.5;
/// Speeds that heads hardly reach, per second: movement in eye distances, relative change of size, and change of the sines
/// of yaw and pitch.
const MOST_SPEED: f32 = 12.0;
const MOST_ZOOM: f32 = 4.0;
const MOST_TURN: f32 = 6.0;
/// Shorter times between frames count as this one, seconds, because frames in quick succession show some jitter, too.
const SHORTEST_JUMP_S: f32 = 0.033;
/// Evidence at which the reference is half the wearer's, seconds at full weight. Few frames suffice for a good mean.
/// `facewire-fit wearers` shows what is learned from wearers who are never at rest.
const HALF_EVIDENCE_S: f32 = 0.005;
/// Most evidence that counts, seconds: beyond it, newer frames replace older ones.
const MEMORY_S: f32 = 30.0;
/// The most evidence that is kept when the wearer turns out to rest in another pose, seconds.
const OTHER_REST_S: f32 = 0.5;
/// Highest speeds at which the share of the wearer's face in the reference rises and falls.
const RISE_PER_S: f32 = 0.1;
const FALL_PER_S: f32 = 0.25;
/// Time in which the reference in use follows the estimate by 63 %, seconds.
const FOLLOW_S: f32 = 5.0;

/// What the estimate does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum NeutralMode {
    /// Learns and is used.
    Auto,
    /// Is used as it is.
    Frozen,
    /// Is not used: what was learned fades out.
    #[default]
    Off,
}

#[derive(Debug, Clone)]
pub(super) struct NeutralEstimate {
    mean: Box<[f32; MEASURES]>,
    /// Mean of the outputs at rest, measured from the mean of many people.
    outputs: [f32; COEFFS],
    /// The wearer's face in the reference, of which each half makes up a share, and its outputs. They follow the means.
    used: Neutral,
    used_outputs: [f32; COEFFS],
    halves: Halves<Learned>,
    /// Whether `used` shows somebody who has left.
    is_fading: bool,
    pub(super) forgotten: u64,
    identity: Identity,
    position: Option<([f32; 2], f32, [f32; 2])>,
}

/// What is learned of a half of the face.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Learned {
    evidence_s: f32,
    /// The share of the wearer's face in the reference.
    share: f32,
    watch: RestWatch,
    usual: Usual,
}

impl Default for NeutralEstimate {
    fn default() -> Self {
        let measures = Box::new([0.0; MEASURES]);
        Self {
            mean: measures.clone(),
            outputs: [0.0; COEFFS],
            used: Neutral { measures },
            used_outputs: [0.0; COEFFS],
            halves: Halves::default(),
            is_fading: false,
            forgotten: 0,
            identity: Identity::default(),
            position: None,
        }
    }
}

impl NeutralEstimate {
    /// Begins anew. Does not allocate.
    pub(super) fn reset(&mut self) {
        let Self { mean, outputs, used, used_outputs, halves, is_fading, forgotten, identity, position } = self;
        mean.fill(0.0);
        used.measures.fill(0.0);
        *outputs = [0.0; COEFFS];
        *used_outputs = [0.0; COEFFS];
        *halves = Halves::default();
        *is_fading = false;
        *forgotten = 0;
        *identity = Identity::default();
        *position = None;
    }

    /// Evaluates the learned face at rest with the model that computes all later outputs. If only one half of the face has been
    /// learned, or the model fails on it, learning starts again, unless the estimate is frozen. Does not allocate.
    pub(super) fn read_again(&mut self, model: &Model, mode: NeutralMode) {
        self.forget_motion();
        if self.is_fading {
            return;
        }
        let is_whole = self.halves.upper.evidence_s > 0.0 && self.halves.lower.evidence_s > 0.0;
        match model.process(&Features::at_rest(&self.mean)) {
            Ok(Coefficients(outputs)) if is_whole => {
                let before = std::mem::replace(&mut self.outputs, outputs);
                self.used_outputs = outputs;
                let [upper, lower] =
                    [Half::Upper, Half::Lower].map(|half| [&before, &outputs].map(|all| of_half(all, half)));
                self.halves.upper.usual.read_again(&upper[0], upper[1]);
                self.halves.lower.usual.read_again(&lower[0], lower[1]);
            }
            _ if mode == NeutralMode::Frozen => {}
            _ => self.halves = Halves::default(),
        }
    }

    /// The wearer's face, if it makes up at least half of the reference and the wearer has not left. The lower half of the face
    /// is never known further than the upper one.
    pub(super) fn known(&self) -> Option<&Neutral> {
        (self.halves.lower.share >= 0.5 && !self.is_fading).then_some(&self.used)
    }

    pub(super) fn reference(&self) -> Reference<'_> {
        let Halves { upper, lower } = self.halves;
        Reference {
            known: Halves { upper: upper.share, lower: lower.share },
            ..Reference::between(&self.used, upper.share)
        }
    }

    /// Takes in a frame, and what the regression made of it with [`Self::reference`] in these shares. Does not allocate.
    pub(super) fn update(
        &mut self,
        mode: NeutralMode,
        face: &Normalised,
        raw: &Coefficients,
        known: Halves<f32>,
        step_s: f32,
    ) {
        let dt_s = step_s.min(LONGEST_STEP_S);
        if mode == NeutralMode::Auto {
            if self.has_jumped(face, dt_s) || step_s > GAP_S {
                self.forget_motion();
                self.identity.gap();
            }
            match self.identity.update(face, dt_s) {
                Verdict::Same if !self.is_fading => self.learn(face, raw, known, dt_s),
                Verdict::Same | Verdict::Doubtful => {}
                Verdict::Another => self.forget(),
            }
        }
        if mode != NeutralMode::Frozen {
            self.follow(mode, dt_s);
        }
    }

    /// Whether the face moved faster than heads do, so that the picture perhaps shows somebody else.
    fn has_jumped(&mut self, face: &Normalised, dt_s: f32) -> bool {
        let origin_px = face.origin_px;
        let scale_px = face.scale_px;
        let turns = face.turns();
        let Some((last_px, last_scale_px, last_turns)) = self.position.replace((origin_px, scale_px, turns)) else {
            return false;
        };
        let time_s = dt_s.max(SHORTEST_JUMP_S);
        distance(&origin_px, &last_px) > MOST_SPEED * time_s * last_scale_px
            || distance(&turns, &last_turns) > MOST_TURN * time_s
            || (scale_px / last_scale_px - 1.0).abs() > MOST_ZOOM * time_s
    }

    fn forget_motion(&mut self) {
        self.halves.upper.watch = RestWatch::default();
        self.halves.lower.watch = RestWatch::default();
    }

    fn learn(&mut self, face: &Normalised, raw: &Coefficients, known: Halves<f32>, dt_s: f32) {
        let mut outputs = raw.0;
        for (place, (output, rest)) in outputs.iter_mut().zip(&self.used_outputs).enumerate() {
            *output += known.of(half_of(place)) * rest;
        }
        let [left, right] = pick(&difference(outputs, self.halves.upper.usual.rest()), BLINKS);
        let shut = left.max(right).max(0.0);
        let passed = Halves {
            upper: self.halves.upper.learn(face, &outputs, shut, Half::Upper, dt_s),
            lower: self.halves.lower.learn(face, &outputs, shut, Half::Lower, dt_s),
        };
        if passed == Halves::default() {
            return;
        }
        approach_by_halves(&mut self.mean, &measure(&face.points), HALF_OF_MEASURE.iter().copied(), passed);
        approach_by_halves(&mut self.outputs, &outputs, halves_of_outputs(), passed);
    }

    fn forget(&mut self) {
        self.is_fading = self.halves.upper.share > 0.0;
        for learned in [&mut self.halves.upper, &mut self.halves.lower] {
            *learned = Learned { share: learned.share, ..Learned::default() };
        }
        self.forgotten += 1;
    }

    fn follow(&mut self, mode: NeutralMode, dt_s: f32) {
        let is_wanted = mode == NeutralMode::Auto && !self.is_fading;
        let Halves { upper, lower } = &mut self.halves;
        let deserved = upper.deserved(&self.outputs, Half::Upper);
        let upper_passed = upper.follow(if is_wanted { deserved } else { 0.0 }, dt_s);
        let deserved = lower.deserved(&self.outputs, Half::Lower);
        let lower_passed = lower.follow(if is_wanted { deserved.min(upper.share) } else { 0.0 }, dt_s);
        // The lower share is never larger.
        self.is_fading &= upper.share > 0.0;
        if is_wanted {
            let passed = Halves { upper: upper_passed, lower: lower_passed };
            approach_by_halves(&mut self.used.measures, &self.mean, HALF_OF_MEASURE.iter().copied(), passed);
            approach_by_halves(&mut self.used_outputs, &self.outputs, halves_of_outputs(), passed);
        }
    }
}

impl Learned {
    /// Judges a frame and returns its weight in the new mean, from 0 to 1. `shut` is how much further the lids are shut than at
    /// the wearer's rest.
    fn learn(&mut self, face: &Normalised, outputs: &[f32; COEFFS], shut: f32, half: Half, dt_s: f32) -> f32 {
        let own = of_half(outputs, half);
        let facing = facing(face);
        let still = facing * self.watch.stillness(own, half, dt_s);
        let open = falling(shut / MOST_SHUT);
        if facing > 0.0 {
            let ordinary = still * open * likeness(&own, &[0.0; COEFFS], half);
            if self.usual.see(&own, still >= STILL, ordinary, dt_s) {
                self.evidence_s = self.evidence_s.min(OTHER_REST_S);
            }
        }
        let weight = still * open * likeness(&own, &self.usual.rest(), half);
        let weight_s = if weight < LEAST_WEIGHT { 0.0 } else { weight * dt_s };
        if weight_s <= 0.0 {
            return 0.0;
        }
        self.evidence_s = (self.evidence_s + weight_s).min(MEMORY_S);
        (weight_s / self.evidence_s).min(1.0)
    }

    /// The more evidence, and the nearer to rest the model reads its mean, the larger the share.
    fn deserved(&self, outputs: &[f32; COEFFS], half: Half) -> f32 {
        let ratio = expression(&of_half(outputs, half), &self.usual.rest()) / MOST_OUTPUT.of(half);
        self.evidence_s / (self.evidence_s + HALF_EVIDENCE_S) * (1.0 - ratio * ratio).max(0.0)
    }

    /// Moves the share towards the one that is wanted, and returns the weight of the mean in the new face in use, from 0 to 1.
    fn follow(&mut self, wanted: f32, dt_s: f32) -> f32 {
        let has_begun = self.share > 0.0;
        self.share = wanted.clamp(self.share - FALL_PER_S * dt_s, self.share + RISE_PER_S * dt_s).max(0.0);
        match self.share > 0.0 {
            true if has_begun => (dt_s / FOLLOW_S).min(1.0),
            true => 1.0,
            false => 0.0,
        }
    }
}

/// Moves values towards others, those of each half by a share of the difference.
fn approach_by_halves<const N: usize>(
    values: &mut [f32; N],
    to: &[f32; N],
    halves: impl IntoIterator<Item = Half>,
    shares: Halves<f32>,
) {
    for ((value, to), half) in values.iter_mut().zip(to).zip(halves) {
        *value += shares.of(half) * (to - *value);
    }
}

fn halves_of_outputs() -> impl Iterator<Item = Half> {
    (0..COEFFS).map(half_of)
}

/// The outputs of a half of the face, without those of the gaze, which wanders in a face at rest. The others are 0.
fn of_half(outputs: &[f32; COEFFS], half: Half) -> [f32; COEFFS] {
    let mut own = *outputs;
    for (place, output) in own.iter_mut().enumerate() {
        if half_of(place) != half {
            *output = 0.0;
        }
    }
    GAZE.into_iter().flatten().for_each(|place| put(&mut own, [place], [0.0]));
    own
}

/// Sines of yaw and pitch at which a face no longer counts as frontal. A camera is often above or below the face.
const FRONTAL: [f32; 2] = [0.3, 0.4];
/// Root sum square of the outputs at which a half no longer counts as at rest. Brows at rest differ more between people than
/// mouths do.
const MOST_OUTPUT: Halves<f32> = Halves { upper: 0.5, lower: 0.45 };
const MOST_SHUT: f32 = 0.3;
/// Least weight that counts: a speaking mouth comes close to rest again and again, which would add up.
const LEAST_WEIGHT: f32 = 0.05;
/// The least stillness at which a half counts as holding a pose.
const STILL: f32 = 0.2;
/// Distance of the outputs, averaged over `NOW_S`, from their recent average at which a half no longer counts as still. A mouth
/// that speaks moves the landmarks of the brows, too.
const MOST_MOTION: Halves<f32> = Halves { upper: 0.45, lower: 0.2 };
const NOW_S: f32 = 0.03;
const RECENT_S: f32 = 0.3;
/// Time after which 63 % of a motion is forgotten, seconds. A mouth that speaks passes its average again and again.
const CALM_S: f32 = 0.8;

/// Judges by the recent outputs how sure it is that a half of a face is at rest. In rendered videos of 20 people, the root sum
/// square of all outputs is at most 0.15 at rest, and rarely below 0.4 otherwise; brows of real people differ more at rest.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct RestWatch {
    /// The outputs of this half now, and those of the recent past. Gaze and blinks are left out: they change in a face at
    /// rest, too.
    averages: Option<[[f32; COEFFS]; 2]>,
    motion: f32,
}

impl RestWatch {
    /// Returns from 0 to 1 how sure it is that this half of the face is still, `dt_s` seconds after the last frame.
    fn stillness(&mut self, own: [f32; COEFFS], half: Half, dt_s: f32) -> f32 {
        falling(self.motion(own, dt_s) / MOST_MOTION.of(half))
    }

    /// The largest recent distance of the outputs from their average, which fades. The first frame counts as moving.
    fn motion(&mut self, mut outputs: [f32; COEFFS], dt_s: f32) -> f32 {
        put(&mut outputs, BLINKS, [0.0; 2]);
        let Some([now, recent]) = &mut self.averages else {
            self.averages = Some([outputs; 2]);
            return f32::INFINITY;
        };
        approach(now, &outputs, passed(dt_s, NOW_S));
        let moved = distance(now, recent);
        approach(recent, now, passed(dt_s, RECENT_S));
        self.motion = moved.max(self.motion * (-dt_s / CALM_S).exp());
        self.motion
    }
}

/// Falls smoothly from 1 at 0 to 0 at 1 and beyond.
fn falling(ratio: f32) -> f32 {
    (1.0 - ratio * ratio).max(0.0).powi(3)
}

/// From 0 to 1 how much a face faces the camera.
fn facing(face: &Normalised) -> f32 {
    let [yaw, pitch] = face.turns();
    falling(yaw / FRONTAL[0]) * falling(pitch / FRONTAL[1])
}

/// From 0 to 1 how much the outputs of a half are like those of rest.
fn likeness(own: &[f32; COEFFS], rest: &[f32; COEFFS], half: Half) -> f32 {
    falling(expression(own, rest) / MOST_OUTPUT.of(half))
}

/// The distance of outputs from those of rest. Outputs below 0 are no expression.
fn expression(outputs: &[f32; COEFFS], rest: &[f32; COEFFS]) -> f32 {
    let [outputs, rest] = [outputs, rest].map(|outputs| outputs.map(|value| value.max(0.0)));
    distance(&outputs, &rest)
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use core::iter;

    use super::*;
    use crate::solve::filter::FRAME_S;
    use crate::solve::normalise;
    use crate::solve::plausible::{JAW_OPEN, index_of};
    use crate::testing::face;

    const SECOND: usize = 30;
    const SMILES: [usize; 2] = [23, 24];
    const RAISED: [usize; 2] = [index_of("browOuterUpLeft"), index_of("browOuterUpRight")];
    const CHIN: usize = 152;
    /// A point of a brow.
    const BROW: usize = 105;

    /// A frame: how the head is turned, where the chin is, and the outputs measured from the mean of many people.
    #[derive(Clone, Copy)]
    struct Shot {
        yaw_deg: f32,
        chin: f32,
        /// Where a brow is.
        brow: f32,
        /// How much wider than usual the temples are.
        width: f32,
        outputs: [f32; COEFFS],
    }

    const REST: Shot = Shot { yaw_deg: 0.0, chin: -1.4, brow: 0.3, width: 0.0, outputs: [0.0; COEFFS] };

    impl Shot {
        fn with(mut self, blendshapes: &[usize], value: f32) -> Self {
            for index in blendshapes {
                self.outputs[*index] = value;
            }
            self
        }

        fn face(&self) -> Normalised {
            let mut face = normalise(&face([self.yaw_deg, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face");
            face.points[CHIN] = [0.0, self.chin, 0.0];
            face.points[BROW] = [-0.5, self.brow, 0.0];
            for (landmark, side) in [(389, 1.0), (251, 1.0), (340, 1.0), (162, -1.0), (21, -1.0), (111, -1.0)] {
                face.points[landmark] = [side * (1.0 + self.width), 0.0, 0.0];
            }
            face
        }

        fn held(self, seconds: usize) -> impl Iterator<Item = Self> {
            iter::repeat_n(self, seconds * SECOND)
        }
    }

    fn speech(amplitude: f32, frame: usize) -> Shot {
        let open = 0.35 + amplitude * (0.6 * frame as f32).sin();
        Shot { chin: -1.4 - 0.4 * open, ..REST }.with(&[JAW_OPEN], open)
    }

    impl NeutralEstimate {
        fn watch(&mut self, mode: NeutralMode, shots: impl IntoIterator<Item = Shot>) {
            shots.into_iter().for_each(|shot| self.step(mode, &shot, FRAME_S));
        }

        /// Shows a frame. The more of the reference is the wearer's, the less of what that reads is in the outputs.
        fn step(&mut self, mode: NeutralMode, shot: &Shot, step_s: f32) {
            let mut raw = shot.outputs;
            let known = self.reference().known;
            for (place, (raw, rest)) in raw.iter_mut().zip(&self.used_outputs).enumerate() {
                *raw -= known.of(half_of(place)) * rest;
            }
            self.update(mode, &shot.face(), &Coefficients(raw), known, step_s);
        }

        fn chin(&self) -> f32 {
            self.used.measures[3 * CHIN + 1]
        }

        fn brow(&self) -> f32 {
            self.used.measures[3 * BROW + 1]
        }

        fn share(&self) -> f32 {
            self.halves.lower.share
        }
    }

    fn watched(shots: impl IntoIterator<Item = Shot>) -> NeutralEstimate {
        let mut estimate = NeutralEstimate::default();
        estimate.watch(NeutralMode::Auto, shots);
        estimate
    }

    #[test]
    fn speaking_smiling_turned_and_shut_eyed_faces_are_never_learned() {
        let turned = Shot { yaw_deg: 25.0, ..REST };
        for shot in [REST.with(&SMILES, 0.5), REST.with(&BLINKS, 0.9), REST.with(&BLINKS, 0.32), turned] {
            assert_eq!(watched(shot.held(60)).share(), 0.0);
        }
        let share = watched((0..60 * SECOND).map(|frame| speech(0.2, frame))).share();
        assert!(share < 0.05, "{share}");
    }

    #[test]
    fn brows_at_rest_are_learned_while_the_mouth_speaks_and_raised_ones_are_not() {
        let raised = |shot: Shot| Shot { brow: 0.6, ..shot }.with(&RAISED, 0.3);
        let speaking = |seconds: usize| (0..seconds * SECOND).map(|frame| speech(0.25, frame));
        let estimate = watched(speaking(30).chain(speaking(30).map(raised)));
        assert!(estimate.halves.upper.share > 0.9 && estimate.share() < 0.05, "{:?}", estimate.reference().known);
        assert!((estimate.brow() - 0.3).abs() < 0.01, "{}", estimate.brow());
        let estimate = watched(speaking(60).map(raised));
        assert_eq!(estimate.reference(), Reference::MEAN);
    }

    #[test]
    fn large_and_narrow_eyes_are_learned_as_rest_once_the_brows_have_come_back_to_it() {
        let large = Shot { brow: 0.5, ..REST }.with(&[index_of("eyeWideLeft"), index_of("eyeWideRight")], 0.38);
        let narrow = Shot { brow: 0.5, ..REST }.with(&BLINKS, 0.33);
        for rest in [large, narrow] {
            assert_eq!(
                watched(rest.held(60)).reference(),
                Reference::MEAN,
                "a wearer who never moves may be holding an expression"
            );
            let raised = rest.with(&RAISED, 0.8);
            let estimate = watched((0..12).flat_map(|_| rest.held(5).chain(raised.held(1))));
            let Halves { upper, lower } = estimate.reference().known;
            assert!(upper > 0.95 && lower > 0.95, "{upper} {lower}");
            assert!((estimate.brow() - 0.5).abs() < 0.02, "{}", estimate.brow());
        }
    }

    #[test]
    fn eyes_that_rest_ordinarily_again_are_learned_and_wide_ones_that_are_held_then_are_not() {
        let wide =
            |brow: f32, value| Shot { brow, ..REST }.with(&[index_of("eyeWideLeft"), index_of("eyeWideRight")], value);
        let raised = wide(0.5, 0.4).with(&RAISED, 0.8);
        let mut estimate = watched((0..12).flat_map(|_| wide(0.5, 0.4).held(5).chain(raised.held(1))));
        assert!((estimate.brow() - 0.5).abs() < 0.02, "{}", estimate.brow());
        let lasting = (0..16).flat_map(|_| REST.held(5).chain(REST.with(&RAISED, 0.8).held(1)));
        estimate.watch(NeutralMode::Auto, lasting);
        assert!((estimate.brow() - 0.3).abs() < 0.02, "{}", estimate.brow());
        assert!(
            of_half(&estimate.outputs, Half::Upper).iter().all(|output| output.abs() < 0.05),
            "{:?}",
            estimate.outputs
        );
        estimate.watch(NeutralMode::Auto, wide(0.5, 0.35).held(60));
        assert!((estimate.brow() - 0.3).abs() < 0.02, "{}", estimate.brow());
    }

    #[test]
    fn a_mouth_at_rest_is_learned_only_as_far_as_the_brows_are() {
        let estimate = watched(REST.with(&RAISED, 0.5).held(60));
        assert_eq!(estimate.reference(), Reference::MEAN);
        let estimate = watched(REST.with(&RAISED, 0.5).held(60).chain(REST.held(5)));
        let Halves { upper, lower } = estimate.reference().known;
        assert!(lower > 0.3 && lower <= upper, "{lower} {upper}");
    }

    #[test]
    fn rest_outweighs_a_half_smile_or_speech_that_lasts_much_longer() {
        let half_smile = Shot { chin: -1.3, ..REST }.with(&SMILES, 0.24);
        let speech = (0..58 * SECOND).map(|frame| speech(0.25, frame));
        for estimate in [watched(half_smile.held(20).chain(REST.held(20))), watched(speech.chain(REST.held(5)))] {
            assert!((estimate.chin() + 1.4).abs() < 0.02, "{}", estimate.chin());
        }
    }

    #[test]
    fn face_at_rest_is_the_reference_within_half_a_minute_and_moves_at_a_bounded_speed_when_people_change() {
        let other = Shot { chin: -1.6, width: 0.2, ..REST };
        assert!(watched(REST.held(1)).share() < 0.11, "not at once");
        let mut estimate = watched(REST.held(30));
        assert!(estimate.share() > 0.95 && (estimate.chin() + 1.4).abs() < 1e-3, "{}", estimate.share());
        let mut least = 0.0_f32;
        let mut most = 0.0_f32;
        for shot in other.held(40) {
            let share = estimate.share();
            let chin = estimate.chin();
            estimate.step(NeutralMode::Auto, &shot, FRAME_S);
            least = least.min(estimate.share() - share);
            most = most.max(estimate.share() - share);
            assert!(share == 0.0 || estimate.share() == 0.0 || (estimate.chin() - chin).abs() < 0.002);
        }
        assert!(most <= 1.01 * 0.1 * FRAME_S && least >= -1.01 * 0.25 * FRAME_S, "{least} {most}");
        assert_eq!(estimate.forgotten, 1);
        assert!((estimate.chin() + 1.6).abs() < 0.01 && estimate.share() > 0.8, "{}", estimate.share());
    }

    #[test]
    fn another_person_is_noticed_within_ten_seconds_and_a_wearer_who_looks_away_leaves_or_speaks_is_not_forgotten() {
        let mut estimate = watched(REST.held(40));
        let mut other = estimate.clone();
        let gap_s = 60.0;
        other.step(NeutralMode::Auto, &Shot { width: 0.2, ..REST }, gap_s);
        other.watch(NeutralMode::Auto, Shot { width: 0.2, ..REST }.held(10));
        assert_eq!(other.forgotten, 1);
        estimate.watch(NeutralMode::Auto, Shot { yaw_deg: 40.0, ..REST }.held(20));
        estimate.step(NeutralMode::Auto, &REST, gap_s);
        estimate.watch(NeutralMode::Auto, (0..20 * SECOND).map(|frame| speech(0.25, frame)));
        assert!(estimate.forgotten == 0 && estimate.share() > 0.95);
    }

    #[test]
    fn another_model_reads_the_learned_face_at_rest_and_begins_anew_with_one_half_that_is_not_frozen() {
        let model = Model::embedded_formulas();
        let mut estimate = watched(REST.with(&SMILES, 0.1).held(20));
        let before = estimate.clone();
        estimate.read_again(&model, NeutralMode::Auto);
        let features = Features::new(&REST.face(), Reference::MEAN);
        let want = model.process(&features).expect("coefficients").0;
        assert!(distance(&estimate.outputs, &want) < 1e-3, "{:?} in place of {want:?}", estimate.outputs);
        assert!(distance(&estimate.outputs, &before.outputs) > 0.01);
        assert_eq!(estimate.reference(), before.reference());
        let mut estimate = watched(REST.with(&SMILES, 0.5).held(20));
        assert!(estimate.reference().known.upper > 0.5);
        let before = estimate.clone();
        estimate.read_again(&model, NeutralMode::Frozen);
        assert_eq!(estimate.reference(), before.reference());
        estimate.read_again(&model, NeutralMode::Auto);
        assert_eq!(estimate.reference(), Reference::MEAN);
    }

    #[test]
    fn frozen_estimate_stays_and_one_that_is_off_fades_in_four_seconds() {
        let mut estimate = watched(REST.held(20));
        let before = estimate.clone();
        estimate.watch(NeutralMode::Frozen, Shot { chin: -1.7, width: 0.2, ..REST }.held(20));
        assert_eq!((estimate.halves, &estimate.used), (before.halves, &before.used));
        estimate.watch(NeutralMode::Off, REST.held(2));
        assert!((0.3..0.6).contains(&estimate.share()), "{}", estimate.share());
        estimate.watch(NeutralMode::Off, REST.held(2));
        assert_eq!(estimate.reference(), Reference::MEAN);
        estimate.watch(NeutralMode::Auto, REST.held(20));
        assert!(estimate.share() > 0.9, "what was learned is still there");
    }

    #[test]
    fn time_that_stands_still_or_jumps_changes_nothing_visible() {
        let before = watched(REST.held(20));
        for step_s in [0.0, 1e9, f32::INFINITY] {
            let mut estimate = before.clone();
            let share = before.share();
            estimate.step(NeutralMode::Auto, &REST, step_s);
            assert!((estimate.share() - share).abs() <= 0.1 * 0.1, "no more than in 0.1 s");
            assert!(estimate.used.measures.iter().all(|value| value.is_finite()), "{step_s}");
        }
    }
}
