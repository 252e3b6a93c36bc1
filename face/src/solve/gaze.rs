//! The direction of the eyes, as a stage of its own: all else that moves in a face is larger and drowns it out.
//!
//! A linear map of a few points of the eyes (eq. 4) follows small movements of every wearer. But each wearer shifts it by an
//! offset of their own, and the landmarks of the irises lag at the ends of the range. A blend of the regression, which reads
//! the whole face, and a layer that reads a picture of each eye is right at those ends and on average. So the mean difference
//! between blend and map is the offset. The map counts most in small turns, and more for yaw than for pitch; in wide turns it
//! counts little or not at all.

use std::slice;

use facewire_engine::kernels::rows::add_rows;
use facewire_packet::FULL_GAZE_DEG;

use super::correction::smoothstep;
use super::filter::{LONGEST_STEP_S, passed, towards};
use super::plausible::{BLINKS, GAZE, pick, put};
use super::{COEFFS, Coefficients, Features};
use crate::model::{EyesLayer, GazeLayer, Model};
use crate::track::EyeValues;

/// Share of the pictures of the eyes in the direction that they and the regression see.
const PICTURE_SHARE: f32 = 0.6;
/// [`PICTURE_SHARE`] falls to 0 while `eyeBlink` of either eye rises from the first to the second of these values.
const LIDS_HIDE: [f32; 2] = [0.4, 0.7];
/// Share of the blend against the map, in a small turn and in a wide one: for yaw, then for pitch.
const TURN_SHARES: [[f32; 2]; 2] = [[0.4, 0.8], [0.6, 1.0]];
/// The turns between which these shares rise, degrees.
const WIDE_TURN_DEG: [f32; 2] = [5.0, 15.0];
/// The most that an eye turns, degrees.
const MAX_TURN_DEG: f32 = 90.0;
/// The most that an eye turns towards the nose beyond the common direction, degrees.
const MAX_VERGENCE_DEG: f32 = 2.0;
/// Time over which the wearer's offset is averaged, seconds.
const OFFSET_S: f32 = 10.0;
/// What the first frame weighs in the average, seconds.
const FIRST_FRAME_S: f32 = 1.0;
/// While a lid is further shut than this, the offset is not learned.
const SHUT: f32 = 0.4;

/// Where both eyes look, in the axes of the head.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct Gaze {
    /// The turns to the person's left and upwards, degrees.
    pub yaw_pitch_deg: [f32; 2],
    /// How far each eye turns towards the nose beyond the common direction, degrees.
    pub vergence_deg: f32,
}

impl Gaze {
    /// The gaze for which `eyeLook` coefficients stand.
    pub fn of(coefficients: &Coefficients) -> Self {
        let [left, right] = GAZE.map(|places| {
            let [down, inwards, out, up] = pick(&coefficients.0, places).map(|value| value.max(0.0));
            [out - inwards, up - down].map(|share| FULL_GAZE_DEG * share)
        });
        let [left_out, left_up] = left;
        let [right_out, right_up] = right;
        Self {
            yaw_pitch_deg: [0.5 * (left_out - right_out), 0.5 * (left_up + right_up)],
            vergence_deg: (-0.5 * (left_out + right_out)).clamp(0.0, MAX_VERGENCE_DEG),
        }
    }

    /// Writes the `eyeLook` coefficients. Those of opposed directions have opposite signs, so that a resting offset can be
    /// removed from both; only positive ones are shown.
    fn write(self, coefficients: &mut [f32; COEFFS]) {
        let [yaw_deg, pitch_deg] = self.yaw_pitch_deg;
        for (places, out_deg) in GAZE.into_iter().zip([yaw_deg, -yaw_deg]) {
            let out_deg = out_deg - self.vergence_deg;
            put(coefficients, places, [-pitch_deg, -out_deg, out_deg, pitch_deg].map(|deg| deg / FULL_GAZE_DEG));
        }
    }
}

impl GazeLayer {
    /// Returns the turns to the person's left and upwards that the map sees, degrees.
    pub(super) fn process(&self, features: &Features) -> [f32; 2] {
        let mut turns_deg = self.offsets.neutral_unknown;
        for input in &self.inputs {
            let value = features.displacement(input.feature, input.neutral, features.remaining());
            turns_deg.iter_mut().zip(input.weights).for_each(|(sum, weight)| *sum += value * weight);
        }
        turns_deg.map(bounded_turn_deg)
    }
}

impl EyesLayer {
    /// Returns the turns to the person's left and upwards that the pictures of the eyes show, degrees.
    fn process(&self, features: &Features, eyes: &EyeValues) -> [f32; 2] {
        let mut sums = self.offsets;
        let (inputs, values) = self.weights.as_chunks().0.split_at(self.inputs.len());
        for (id, weights) in self.inputs.iter().zip(inputs) {
            add_rows(&mut sums, slice::from_ref(weights), &[features.get(*id)]);
        }
        add_rows(&mut sums, values, eyes.as_flattened());
        let [yaw, pitch, units @ ..] = sums;
        let mut turns_deg = [yaw, pitch];
        for (unit, weights) in units.into_iter().zip(&self.outputs) {
            turns_deg.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += unit.max(0.0) * weight);
        }
        turns_deg.map(bounded_turn_deg)
    }
}

impl Model {
    /// Returns the turns to the person's left and upwards that the map sees, degrees. They are measured from the mean of many
    /// people, because another neutral face would shift them at once, and the wearer's offset would follow only slowly.
    pub(super) fn map_of_gaze(&self, from_mean: &Features) -> Option<[f32; 2]> {
        self.gaze.as_ref().map(|layer| layer.process(from_mean))
    }

    /// Blends what the pictures of the eyes show into the gaze of the regression, if the model reads them. The features are
    /// measured from the mean of many people.
    pub fn look(&self, raw: &mut Coefficients, from_mean: &Features, eyes: Option<&EyeValues>) {
        if let Some((layer, eyes)) = self.eyes.as_ref().zip(eyes) {
            let seen = Gaze::of(raw);
            let shut = pick(&raw.0, BLINKS).into_iter().fold(0.0, f32::max);
            let share = PICTURE_SHARE * (1.0 - smoothstep(shut, LIDS_HIDE));
            let yaw_pitch_deg = towards(seen.yaw_pitch_deg, layer.process(from_mean, eyes), share);
            Gaze { yaw_pitch_deg, ..seen }.write(&mut raw.0);
        }
    }
}

/// Bounds what an absurd model file gives, which would otherwise stay in the wearer's offset.
#[expect(clippy::manual_clamp, reason = "unlike `clamp`, it turns what is not a number into one")]
fn bounded_turn_deg(turn_deg: f32) -> f32 {
    turn_deg.max(-MAX_TURN_DEG).min(MAX_TURN_DEG)
}

/// The wearer's offset, which is the mean difference between blend and map, and for how long it has been observed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Offset {
    mean_deg: [f32; 2],
    observed_s: f32,
}

impl Offset {
    /// Blends the gaze of the map, shifted by the offset, into the gaze in `raw`. The first frame with open eyes shows that
    /// in `raw`.
    pub(super) fn step(&mut self, map_deg: [f32; 2], raw: &mut Coefficients, dt_s: f32) {
        let seen = Gaze::of(raw);
        let are_eyes_open = pick(&raw.0, BLINKS).iter().all(|shut| *shut <= SHUT);
        let learned = if self.observed_s > 0.0 { passed(dt_s, self.observed_s) } else { 1.0 };
        let mut yaw_pitch_deg = [0.0; 2];
        let axes = yaw_pitch_deg.iter_mut().zip(&mut self.mean_deg).zip(TURN_SHARES);
        for (((turn_deg, mean_deg), [small_share, wide_share]), (map_deg, seen_deg)) in
            axes.zip(map_deg.into_iter().zip(seen.yaw_pitch_deg))
        {
            if are_eyes_open {
                *mean_deg += learned * (seen_deg - map_deg - *mean_deg);
            }
            let shifted_deg = map_deg + *mean_deg;
            let share = small_share + (wide_share - small_share) * smoothstep(seen_deg.abs(), WIDE_TURN_DEG);
            *turn_deg = shifted_deg + share * (seen_deg - shifted_deg);
        }
        if are_eyes_open {
            self.observed_s = (self.observed_s + dt_s.clamp(0.0, LONGEST_STEP_S)).clamp(FIRST_FRAME_S, OFFSET_S);
        }
        Gaze { yaw_pitch_deg, ..seen }.write(&mut raw.0);
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::model::{Cases, EYE_SUMS, EYE_VALUES, FEATURES, FeatureId, GazeInput};
    use crate::solve::halves::Halves;
    use crate::solve::{filter::FRAME_S, normalise};
    use crate::testing::face;

    /// A map that turns the gaze by 100 degrees to the left and upwards for 1 of the left iris's x.
    fn layer() -> GazeLayer {
        let feature = FeatureId::from_name("x473").expect("known");
        GazeLayer {
            inputs: Box::new([GazeInput { feature, neutral: 0.5, weights: [100.0; 2] }]),
            offsets: Cases::default(),
        }
    }

    /// Steps by a frame in which map and regression see the eyes turned by these angles both to the left and upwards.
    fn follow(offset: &mut Offset, map_deg: f32, seen_deg: f32) -> Gaze {
        let mut features = Features { values: [0.0; FEATURES], known: Halves::default() };
        features.values[layer().inputs[0].feature.index()] = 0.5 + map_deg / 100.0;
        let mut raw = Coefficients([0.0; COEFFS]);
        Gaze { yaw_pitch_deg: [seen_deg; 2], vergence_deg: 1.0 }.write(&mut raw.0);
        offset.step(layer().process(&features), &mut raw, FRAME_S);
        Gaze::of(&raw)
    }

    #[test]
    fn coefficients_hold_the_directions_of_both_eyes() {
        let gaze = Gaze { yaw_pitch_deg: [17.5, -7.0], vergence_deg: 1.4 };
        let mut values = Coefficients([0.0; COEFFS]);
        gaze.write(&mut values.0);
        let [left, right] = GAZE.map(|places| pick(&values.0, places));
        let near = |found: [f32; 4], want: [f32; 4]| found.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6);
        assert!(near(left, [0.2, -0.46, 0.46, -0.2]) && near(right, [0.2, 0.54, -0.54, -0.2]), "{left:?} {right:?}");
        let again = Gaze::of(&values);
        assert!((again.yaw_pitch_deg[0] - 17.5).abs() < 1e-4 && (again.vergence_deg - 1.4).abs() < 1e-4);
    }

    #[test]
    fn small_movements_follow_the_map_by_its_share_around_the_mean_of_the_regression() {
        let mut offset = Offset::default();
        let first_deg = follow(&mut offset, 10.0, 3.0).yaw_pitch_deg[0];
        assert!((first_deg - 3.0).abs() < 1e-4, "the first frame is the regression's");
        for frame in 0..600 {
            let move_deg = if frame % 20 < 10 { 2.0 } else { -2.0 };
            follow(&mut offset, 10.0 + move_deg, 3.0 + 0.2 * move_deg);
        }
        let [high, low] = [12.0, 8.0].map(|map_deg| follow(&mut offset, map_deg, 3.0).yaw_pitch_deg);
        for (axis, [small_share, _]) in TURN_SHARES.into_iter().enumerate() {
            let difference_deg = high[axis] - low[axis];
            let sum_deg = high[axis] + low[axis];
            assert!((difference_deg - 4.0 * (1.0 - small_share)).abs() < 0.1, "{difference_deg}");
            assert!((sum_deg - 6.0).abs() < 0.4, "{sum_deg}");
        }
    }

    #[test]
    fn wide_turns_follow_the_regression_by_its_share_and_no_turn_makes_a_step() {
        let shown = |seen_deg: f32| {
            let mut offset = Offset::default();
            follow(&mut offset, 0.0, 0.0);
            follow(&mut offset, 3.0, seen_deg).yaw_pitch_deg
        };
        for (axis, [_, wide_share]) in TURN_SHARES.into_iter().enumerate() {
            for wide_deg in [30.0, -30.0] {
                let turn_deg = shown(wide_deg)[axis];
                assert!((turn_deg / wide_deg - wide_share).abs() < 0.05, "{turn_deg}");
            }
            let turns: Vec<f32> = (-400..400).map(|step| shown(step as f32 * 0.1)[axis]).collect();
            assert!(turns.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.5));
        }
    }

    #[test]
    fn pictures_of_the_eyes_move_the_gaze_by_their_share_and_not_that_of_shut_eyes() {
        let mut weights = vec![0.0; (1 + 2 * EYE_VALUES) * EYE_SUMS];
        // The first sum, yaw, reads how the head is turned; the first hidden unit reads a value of the left eye.
        weights[0] = 20.0;
        weights[(1 + EYE_VALUES + 3) * EYE_SUMS + 2] = 1.0;
        let inputs = FeatureId::from_name("yaw").into_iter().collect();
        let outputs = Box::new([[4.0, -2.0]]);
        let offsets = core::array::from_fn(|sum| if sum == 1 { 5.0 } else { 0.0 });
        let eyes = EyesLayer { inputs, weights: weights.into(), offsets, outputs };
        let model = Model { eyes: Some(eyes), ..Model::embedded() };
        let head = normalise(&face([30.0, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face");
        let features = Features::from_mean(&head);
        for (value, shut, found_deg) in [(3.0, 0.0, [22.0, -1.0]), (-3.0, 0.0, [10.0, 5.0]), (3.0, 0.7, [1.0, 2.0])] {
            let mut raw = Coefficients([0.0; COEFFS]);
            let mut values = EyeValues::default();
            Gaze { yaw_pitch_deg: [1.0, 2.0], vergence_deg: 1.0 }.write(&mut raw.0);
            values[1][3] = value;
            put(&mut raw.0, BLINKS, [shut, 0.0]);
            model.look(&mut raw, &features, Some(&values));
            let want = towards([1.0, 2.0], found_deg, PICTURE_SHARE);
            let got = Gaze::of(&raw).yaw_pitch_deg;
            assert!(got.iter().zip(want).all(|(got, want)| (got - want).abs() < 0.1), "{got:?} in place of {want:?}");
        }
    }

    #[test]
    fn absurd_turns_are_bounded() {
        assert_eq!([f32::NAN, f32::INFINITY, -1e9, 30.0].map(bounded_turn_deg), [-90.0, 90.0, -90.0, 30.0]);
    }

    #[test]
    fn shut_eyes_teach_no_offset() {
        let mut offset = Offset::default();
        follow(&mut offset, 0.0, 0.0);
        let before = offset;
        let mut raw = Coefficients([0.0; COEFFS]);
        put(&mut raw.0, BLINKS, [0.9, 0.1]);
        (0..100).for_each(|_| offset.step([20.0, -20.0], &mut raw.clone(), FRAME_S));
        assert_eq!(offset, before);
    }
}
