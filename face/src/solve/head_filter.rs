//! The filter of the head's pose.
//!
//! The rotation is smoothed as a quaternion and not as three angles, so that nothing wraps at 180 degrees. Of the two
//! quaternions of a rotation, the filter takes the one that is nearer to its last output. A weighted mean of
//! quaternions that are near each other is their mean rotation, once it has its length of 1 again.

use super::{
    HeadPose,
    filter::{Filter, FilterKind, FilterState},
};

/// Size of a turn that is no longer small. The distance of two unit quaternions is half of the angle in radians.
const SMALL_TURN: f32 = 0.5 * 0.03;
/// Size of a movement that is no longer small, millimetres. The depth is the noisiest of the three coordinates.
const SMALL_MOVE_MM: f32 = 5.0;

/// How the head's pose is smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadFilter {
    /// How the rotation is smoothed.
    pub rotation: Filter,
    /// How the position is smoothed.
    pub position: Filter,
}

/// What a [`HeadFilter`] remembers between frames.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct HeadState {
    rotation: FilterState<4>,
    position: FilterState<3>,
    last: Option<[f32; 4]>,
}

impl HeadFilter {
    /// No smoothing.
    pub const OFF: Self = Self { rotation: Filter::OFF, position: Filter::OFF };

    /// The filter of this kind, which averages small changes over `time_s`.
    pub fn new(kind: FilterKind, time_s: f32) -> Self {
        Self {
            rotation: Filter { kind, time_s, noise_size: SMALL_TURN },
            position: Filter { kind, time_s, noise_size: SMALL_MOVE_MM },
        }
    }

    /// The filter in a picture that is noisier by a factor of `level`.
    pub(super) fn at_noise_level(self, level: f32) -> Self {
        Self { rotation: self.rotation.at_noise_level(level), position: self.position.at_noise_level(level) }
    }

    /// Filters the pose of a frame that was captured `dt_s` seconds after the last one.
    pub(super) fn step(&self, state: &mut HeadState, head: &HeadPose, dt_s: f32) -> HeadPose {
        let near = state.last.map_or(head.rotation_xyzw, |last| nearer(head.rotation_xyzw, last));
        let rotation = unit(self.rotation.step(&mut state.rotation, near, dt_s), near);
        state.last = rotation.iter().all(|value| value.is_finite()).then_some(rotation);
        let position_mm = self.position.step(&mut state.position, head.position_mm, dt_s);
        HeadPose::from_rotation(rotation, position_mm)
    }
}

/// Of the two quaternions of a rotation, returns the one that is nearer to `last`.
fn nearer(rotation: [f32; 4], last: [f32; 4]) -> [f32; 4] {
    let cosine: f32 = rotation.iter().zip(last).map(|(a, b)| a * b).sum();
    if cosine < 0.0 { rotation.map(|value| -value) } else { rotation }
}

/// Gives a quaternion the length of 1. A mean of opposite rotations has no direction; `instead` counts then.
fn unit(mean: [f32; 4], instead: [f32; 4]) -> [f32; 4] {
    let length = mean.iter().map(|value| value * value).sum::<f32>().sqrt();
    if length > 0.1 { mean.map(|value| value / length) } else { instead }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::filter::tests::KINDS;

    const FRAME_S: f32 = 1.0 / 30.0;
    /// A head that is tilted by an angle about the axis that points into the camera.
    fn tilted(roll_deg: f32) -> HeadPose {
        let half = (0.5 * roll_deg).to_radians();
        HeadPose::from_rotation([0.0, 0.0, half.sin(), half.cos()], [0.0, 0.0, 600.0])
    }

    fn roll_deg(pose: &HeadPose) -> f32 {
        pose.yaw_pitch_roll_deg()[2]
    }

    fn run(kind: FilterKind, poses: impl IntoIterator<Item = HeadPose>) -> Vec<HeadPose> {
        let (filter, mut state) = (HeadFilter::new(kind, 0.2), HeadState::default());
        poses.into_iter().map(|pose| filter.step(&mut state, &pose, FRAME_S)).collect()
    }

    #[test]
    fn turn_past_180_degrees_is_smoothed_like_any_other() {
        for kind in KINDS {
            let turn = |from: f32| run(kind, (0_u8..60).map(|frame| tilted(from + f32::from(frame))));
            let (past, near) = (turn(150.0), turn(0.0));
            for (past, near) in past.iter().zip(&near) {
                let turned = (roll_deg(past) - roll_deg(near)).rem_euclid(360.0);
                assert!((turned - 150.0).abs() < 0.1, "{kind:?}: {turned}");
                assert!(past.rotation_xyzw[3] >= 0.0);
            }
        }
    }

    #[test]
    fn rotation_has_a_length_of_1_whatever_the_poses() {
        let mut random = fastrand::Rng::with_seed(8);
        for kind in KINDS {
            let poses = (0..300).map(|_| {
                let q = [(); 4].map(|()| random.f32() - 0.5);
                HeadPose::from_rotation(unit(q, [0.0, 0.0, 0.0, 1.0]), [0.0; 3])
            });
            for pose in run(kind, poses.collect::<Vec<_>>()) {
                let length: f32 = pose.rotation_xyzw.iter().map(|value| value * value).sum();
                assert!((length - 1.0).abs() < 1e-4, "{kind:?}: {pose:?}");
            }
        }
    }

    #[test]
    fn pose_that_is_not_finite_affects_no_later_frame() {
        for kind in KINDS {
            let wrong = HeadPose { rotation_xyzw: [f32::NAN; 4], position_mm: [f32::NAN; 3] };
            let out = run(kind, [tilted(1.0), tilted(2.0), wrong, tilted(30.0), tilted(31.0)]);
            assert_eq!(out[3..], run(kind, [tilted(30.0), tilted(31.0)]), "{kind:?}");
        }
    }

    #[test]
    fn trembling_head_is_smoothed_and_a_fast_turn_is_followed_at_once() {
        let mut random = fastrand::Rng::with_seed(9);
        let mut noise = || 0.5 * (random.f32() - 0.5);
        let still: Vec<_> = (0..300).map(|_| tilted(10.0 + noise())).collect();
        let deviation = |poses: &[HeadPose]| {
            (poses.iter().map(|pose| (roll_deg(pose) - 10.0).powi(2)).sum::<f32>() / poses.len() as f32).sqrt()
        };
        for kind in [FilterKind::Kalman, FilterKind::GatedAverage, FilterKind::OneEuro] {
            let out = run(kind, still.clone().into_iter().chain([tilted(20.0), tilted(30.0)]));
            assert!(deviation(&out[30..300]) < 0.5 * deviation(&still), "{kind:?}");
            assert!(roll_deg(&out[301]) > 29.0, "{kind:?}: {:?}", out[301]);
        }
    }
}
