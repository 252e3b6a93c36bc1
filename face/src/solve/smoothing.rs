//! The filters of all coefficients and of the head, chosen by the part of the face that moves.

use super::filter::{Filter, FilterKind, FilterState, LONGEST_STEP_S, approach, difference, passed, square, towards};
use super::{BLENDSHAPES, COEFFS, Coefficients, HeadPose, correction::smoothstep};

/// Coefficients that share a filter, because they belong to a part of the face that moves in its own way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "`Group::of` tells which belong to each")]
pub enum Group {
    Lids,
    Gaze,
    Brows,
    Mouth,
    Jaw,
    Cheeks,
}

impl Group {
    /// Every group.
    pub const ALL: [Self; 6] = [Self::Lids, Self::Gaze, Self::Brows, Self::Mouth, Self::Jaw, Self::Cheeks];

    /// The group of a blendshape.
    pub fn of(blendshape: &str) -> Self {
        match blendshape.find(char::is_uppercase).map_or(blendshape, |end| blendshape.split_at(end).0) {
            "eye" if blendshape.starts_with("eyeLook") => Self::Gaze,
            "eye" => Self::Lids,
            "brow" => Self::Brows,
            "jaw" => Self::Jaw,
            "cheek" | "nose" => Self::Cheeks,
            _ => Self::Mouth,
        }
    }

    /// The size of a change that is no longer small, in good light; found by `facewire-fit tune smoothing`.
    fn noise_size(self) -> f32 {
        match self {
            Self::Gaze => 0.028,
            Self::Brows => 0.096,
            Self::Mouth => 0.056,
            Self::Lids | Self::Jaw => 0.05,
            Self::Cheeks => 0.048,
        }
    }

    /// The filter of this group, by the settings.
    pub fn filter(self, kind: FilterKind, time_s: f32) -> Filter {
        Filter { kind, time_s, noise_size: self.noise_size() }
    }
}

/// The filters of all coefficients and of the head.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(missing_docs, reason = "the names say it")]
#[non_exhaustive]
pub struct Filters {
    /// In the order of [`BLENDSHAPES`].
    pub coefficients: [Filter; COEFFS],
    pub rotation: Filter,
    pub position: Filter,
}

/// The states of all filters.
#[derive(Debug, Clone, PartialEq)]
pub struct FiltersState {
    noise: NoiseLevel<COEFFS>,
    head_noise: NoiseLevel<3>,
    coefficients: [FilterState<1>; COEFFS],
    rotation: FilterState<4>,
    position: FilterState<3>,
    still_rotation: Option<Still<4>>,
    still_position: Option<Still<3>>,
    last_rotation: Option<[f32; 4]>,
}

impl Default for FiltersState {
    fn default() -> Self {
        Self {
            noise: NoiseLevel {
                sizes: BLENDSHAPES.map(|name| Group::of(name).noise_size()),
                reference: 0.125,
                highest: 2.0,
                average_s: 1.0,
                product: 0.0,
                last: None,
            },
            // In the dark, the noise of the head's rotation grows more than that of the coefficients.
            head_noise: NoiseLevel {
                sizes: [SMALL_TURN; 3],
                reference: 0.2,
                highest: 6.0,
                average_s: 0.5,
                product: 0.0,
                last: None,
            },
            coefficients: [const { FilterState::Empty }; COEFFS],
            rotation: FilterState::Empty,
            position: FilterState::Empty,
            still_rotation: None,
            still_position: None,
            last_rotation: None,
        }
    }
}

impl Filters {
    /// No smoothing.
    pub const OFF: Self = Self { coefficients: [Filter::OFF; COEFFS], rotation: Filter::OFF, position: Filter::OFF };

    /// One filter for each group, and this kind and time for the head.
    pub fn new(of: impl Fn(Group) -> Filter, kind: FilterKind, time_s: f32) -> Self {
        let head = |noise_size| Filter { kind, time_s, noise_size };
        let coefficients = BLENDSHAPES.map(|name| of(Group::of(name)));
        Self { coefficients, rotation: head(SMALL_TURN), position: head(SMALL_MOVE_MM) }
    }

    /// The same kind and time for every group and the head.
    pub fn uniform(kind: FilterKind, time_s: f32) -> Self {
        Self::new(|group| group.filter(kind, time_s), kind, time_s)
    }

    /// Filters the coefficients and the pose of the head of a frame that was captured `dt_s` seconds after the last one.
    pub fn step(
        &self,
        state: &mut FiltersState,
        corrected: &Coefficients,
        head: &HeadPose,
        dt_s: f32,
    ) -> (Coefficients, HeadPose) {
        let level = state.noise.step(&corrected.0, dt_s);
        let mut out = *corrected;
        for (value, (filter, state)) in out.0.iter_mut().zip(self.coefficients.iter().zip(&mut state.coefficients)) {
            [*value] = filter.at_noise_level(level).step(state, [*value], dt_s);
        }
        (out, self.step_head(state, head, level, dt_s))
    }

    /// The rotation is smoothed as a quaternion, so that nothing wraps at 180 degrees. A weighted mean of quaternions that
    /// are near each other is their mean rotation, once it has its length of 1 again.
    fn step_head(&self, state: &mut FiltersState, head: &HeadPose, level: f32, dt_s: f32) -> HeadPose {
        let near = state.last_rotation.map_or(head.rotation_xyzw, |last| nearer(head.rotation_xyzw, last));
        let [x, y, z, _] = near;
        let head_level = state.head_noise.step(&[x, y, z], dt_s);
        let level = level.max(head_level);
        let mean = self.rotation.at_noise_level(level).step(&mut state.rotation, near, dt_s);
        let still = Still::step(&mut state.still_rotation, mean, MOVED * head_level * self.rotation.noise_size, dt_s);
        let noisy = if state.rotation == FilterState::Empty { 0.0 } else { smoothstep(head_level, NOISY) };
        let rotation = unit(towards(mean, still, noisy), near);
        state.last_rotation = rotation.iter().all(|value| value.is_finite()).then_some(rotation);
        let mean_mm = self.position.at_noise_level(level).step(&mut state.position, head.position_mm, dt_s);
        let still_mm =
            Still::step(&mut state.still_position, mean_mm, MOVED * head_level * self.position.noise_size, dt_s);
        let position_mm = towards(mean_mm, still_mm, noisy);
        HeadPose::from_rotation(rotation, position_mm)
    }
}

/// Size of a turn that is no longer small. The distance of two unit quaternions is half of the angle in radians.
const SMALL_TURN: f32 = 0.5 * 0.03;
/// Size of a movement that is no longer small, millimetres. The depth is the noisiest of the three coordinates.
const SMALL_MOVE_MM: f32 = 5.0;

/// Levels of noise between which holding the head still begins and is complete.
const NOISY: [f32; 2] = [1.0, 1.6];
/// The mean distance beyond which the head counts as moving, relative to a small change in this noise.
const MOVED: f32 = 0.28;

/// Of the two quaternions of a rotation, returns the one that is nearer to `last`.
fn nearer(rotation: [f32; 4], last: [f32; 4]) -> [f32; 4] {
    let cosine: f32 = rotation.iter().zip(last).map(|(a, b)| a * b).sum();
    if cosine < 0.0 { rotation.map(|value| -value) } else { rotation }
}

/// Gives a quaternion the length of 1. A mean of opposite rotations has no direction: then `instead` counts.
fn unit(mean: [f32; 4], instead: [f32; 4]) -> [f32; 4] {
    let length = square(mean).sqrt();
    if length > 0.1 { mean.map(|value| value / length) } else { instead }
}

/// Bounds of the product of two steps, relative to the square of a small change. A coefficient that moves widely counts no
/// more than one that hardly moves.
const PRODUCTS: [f32; 2] = [-4.0, 0.5];

/// How noisy the last frames are, relative to the noise for which the sizes of small changes are meant: in a dark picture,
/// a still face trembles 20 times as much as in good light. The mean product of successive steps of a still face is the
/// negative variance of the noise. Movement goes on from frame to frame, and its products are positive.
#[derive(Debug, Clone, PartialEq)]
struct NoiseLevel<const N: usize> {
    /// From this size on, a change of each value is no longer small in good light.
    sizes: [f32; N],
    /// Standard deviation of the noise at level 1, that of good light, relative to a small change.
    reference: f32,
    /// The greatest level. A higher one takes more of fast movements in noisy pictures.
    highest: f32,
    /// Time over which the product is averaged, seconds.
    average_s: f32,
    /// Mean product of successive steps, relative to the square of a small change.
    product: f32,
    last: Option<([f32; N], Option<[f32; N]>)>,
}

impl<const N: usize> NoiseLevel<N> {
    /// Takes a frame that was captured `dt_s` seconds after the last one, and returns the level.
    fn step(&mut self, values: &[f32; N], dt_s: f32) -> f32 {
        let last = self.last.take().filter(|_| (0.0..=LONGEST_STEP_S).contains(&dt_s));
        let steps = last.map(|(last, before)| {
            let steps = difference(*values, last);
            if let Some(product) = before.and_then(|before| self.mean_product(&steps, &before)) {
                self.product += passed(dt_s, self.average_s) * (product - self.product);
            }
            steps
        });
        self.last = Some((*values, steps));
        ((-self.product).max(0.0).sqrt() / self.reference).clamp(1.0, self.highest)
    }

    fn mean_product(&self, steps: &[f32; N], before: &[f32; N]) -> Option<f32> {
        let [least, greatest] = PRODUCTS;
        let mut sum = 0.0_f32;
        let mut count = 0.0_f32;
        for ((step, before), size) in steps.iter().zip(before).zip(&self.sizes) {
            let product = step * before / (size * size);
            // A coefficient that is 0 all the time tells nothing, and neither does a value that is not a number.
            if product != 0.0 && product.is_finite() {
                sum += product.clamp(least, greatest);
                count += 1.0;
            }
        }
        (count > 0.0).then(|| sum / count)
    }
}

/// Time over which a still value is averaged, seconds.
const STILL_S: f32 = 1.8;
/// Time over which the distance of the last values is averaged, seconds.
const NOTICE_S: f32 = 0.12;
/// How long a value must be still until averaging begins and until it is complete, and the longest that counts, seconds.
const CALM_S: [f32; 2] = [0.2, 1.0];
const MOST_CALM_S: f32 = 1.2;
/// Seconds of calm that a second of movement takes away, times the square of its size.
const ALARM: f32 = 4.0;

/// A value that is held until it surely moves, the mean distance of the last values from it, and how long they have been
/// still.
#[derive(Debug, Clone, PartialEq)]
struct Still<const N: usize> {
    value: [f32; N],
    away: [f32; N],
    calm_s: f32,
}

impl<const N: usize> Still<N> {
    /// Takes a value, `dt_s` seconds after the last one. A mean distance of at most `size` counts as still.
    fn step(state: &mut Option<Self>, x: [f32; N], size: f32, dt_s: f32) -> [f32; N] {
        let last = state.take().filter(|_| (0.0..=LONGEST_STEP_S).contains(&dt_s));
        // What was before a long gap tells nothing.
        let dt_s = if last.is_some() { dt_s } else { 0.0 };
        let Self { mut value, mut away, calm_s } = last.unwrap_or(Self { value: x, away: [0.0; N], calm_s: 0.0 });
        approach(&mut away, &difference(x, value), passed(dt_s, NOTICE_S));
        let moved = square(away).sqrt() / size;
        let calm_s = (calm_s + if moved > 1.0 { -ALARM * moved * moved * dt_s } else { dt_s }).clamp(0.0, MOST_CALM_S);
        let kept = smoothstep(calm_s, CALM_S) * (1.0 - passed(dt_s, STILL_S));
        approach(&mut value, &x, 1.0 - kept);
        *state = x.iter().all(|x| x.is_finite()).then_some(Self { value, away: away.map(|away| kept * away), calm_s });
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::filter::{FRAME_S, tests::KINDS};

    #[test]
    fn every_blendshape_belongs_to_the_part_of_the_face_that_it_moves() {
        let members = |group| BLENDSHAPES.iter().filter(|name| Group::of(name) == group).count();
        assert_eq!(Group::ALL.map(members), [6, 8, 5, 24, 4, 5]);
    }

    /// The level after 3 seconds of noise with this deviation in units of a small change, of which the first
    /// `moving` coefficients also swing widely.
    fn level(deviation: f32, moving: usize) -> f32 {
        let mut random = fastrand::Rng::with_seed(2);
        let mut level = FiltersState::default().noise;
        let mut frame = |number: u16| {
            let mut values = [0.5; COEFFS];
            for (index, (value, size)) in values.iter_mut().zip(level.sizes).enumerate() {
                // The sum of 12 has a deviation of 1.
                let noise: f32 = (0..12).map(|_| random.f32() - 0.5).sum();
                let swing = if index < moving { 0.3 * (0.4 * f32::from(number)).sin() } else { 0.0 };
                *value += deviation * size * noise + swing;
            }
            level.step(&values, FRAME_S)
        };
        (0..90).map(&mut frame).last().unwrap_or(0.0)
    }

    #[test]
    fn level_follows_the_noise_and_not_the_movement_even_of_the_whole_face() {
        assert!([0, 30, COEFFS].iter().all(|moving| (level(0.01, *moving) - 1.0).abs() < 0.01));
        assert!((level(0.44, 0) - 2.0).abs() < 0.01, "{}", level(0.44, 0));
        assert!((1.4..1.8).contains(&level(0.2, 0)), "{}", level(0.2, 0));
        let mut level = FiltersState::default().noise;
        for value in [0.1, f32::NAN, 0.3, 0.1] {
            assert!((1.0..=2.0).contains(&level.step(&[value; COEFFS], FRAME_S)), "{value}");
        }
    }

    /// A head that is tilted by an angle about the axis that points into the camera.
    fn tilted(roll_deg: f32) -> HeadPose {
        let half = (0.5 * roll_deg).to_radians();
        HeadPose::from_rotation([0.0, 0.0, half.sin(), half.cos()], [0.0, 0.0, 600.0])
    }

    fn run(kind: FilterKind, poses: impl IntoIterator<Item = HeadPose>) -> Vec<HeadPose> {
        let filters = Filters::uniform(kind, 0.2);
        let mut state = FiltersState::default();
        poses.into_iter().map(|pose| filters.step_head(&mut state, &pose, 1.0, FRAME_S)).collect()
    }

    #[test]
    fn turn_past_180_degrees_is_smoothed_like_any_other() {
        for kind in KINDS {
            let turn = |from: f32| run(kind, (0_u8..60).map(|frame| tilted(from + f32::from(frame))));
            for (past, near) in turn(150.0).iter().zip(&turn(0.0)) {
                let [past_deg, near_deg] = [past, near].map(|pose| pose.yaw_pitch_roll_deg()[2]);
                let turned = (past_deg - near_deg).rem_euclid(360.0);
                assert!((turned - 150.0).abs() < 0.1 && past.rotation_xyzw[3] >= 0.0, "{kind:?}: {turned}");
            }
        }
    }

    #[test]
    fn a_still_head_in_the_dark_trembles_less_than_a_sixth_as_much_and_a_fast_turn_passes_within_a_frame() {
        let mut random = fastrand::Rng::with_seed(5);
        // The sum of 12 has a deviation of 1, here 2 degrees.
        let mut noise_deg = || 2.0 * (0..12).map(|_| random.f32() - 0.5).sum::<f32>();
        let tilts: Vec<f32> = (0..150).map(|frame| noise_deg() + if frame < 120 { 0.0 } else { 30.0 }).collect();
        let out = run(FilterKind::GatedAverage, tilts.iter().copied().map(tilted));
        let sent: Vec<f32> = out.iter().map(|pose| pose.yaw_pitch_roll_deg()[2]).collect();
        let deviation = |angles: &[f32]| square(core::array::from_fn::<_, 60, _>(|at| angles[at + 60])).sqrt();
        assert!(deviation(&sent) < 0.15 * deviation(&tilts), "{} {}", deviation(&sent), deviation(&tilts));
        assert!((sent[120] - tilts[120]).abs() < 3.0, "{} {}", sent[120], tilts[120]);
    }

    #[test]
    fn a_value_that_comes_back_after_a_gap_is_not_held_where_it_is_seen_first() {
        let mut state = None;
        let values = [(0.0, FRAME_S); 60].into_iter().chain([(20.0, 5.0), (20.5, FRAME_S)]);
        let out: Vec<_> = values.map(|(value, dt_s)| Still::step(&mut state, [value], 1.0, dt_s)[0]).collect();
        assert!((out[61] - 20.5).abs() < 0.01, "{:?}", &out[60..]);
    }

    #[test]
    fn rotation_has_a_length_of_1_and_a_pose_that_is_not_finite_affects_no_later_frame() {
        let mut random = fastrand::Rng::with_seed(8);
        let mut pose = || unit([(); 4].map(|()| random.f32() - 0.5), [0.0, 0.0, 0.0, 1.0]);
        let poses: Vec<_> = (0..300).map(|_| HeadPose::from_rotation(pose(), [0.0; 3])).collect();
        let wrong = HeadPose { rotation_xyzw: [f32::NAN; 4], position_mm: [f32::NAN; 3] };
        for kind in KINDS {
            let out = run(kind, poses.iter().copied());
            assert!(out.iter().all(|pose| (square(pose.rotation_xyzw) - 1.0).abs() < 1e-4), "{kind:?}");
            let after = run(kind, [tilted(1.0), wrong].into_iter().chain(poses.iter().copied()));
            assert_eq!(after[2..], out, "{kind:?}");
        }
    }
}
