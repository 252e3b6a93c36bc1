//! The motion of a clip: curves of recordings, and a head that sways.

use std::f32::consts::TAU;

use anyhow::{Context, Result};
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::ChaCha8Rng;

use super::{
    anatomy::{enforce_limits, mirrored},
    composing::{APART, HALVES_SCALE, with_upper},
    expression::Coefficients,
};

/// Frame rate of recordings and clips.
pub const RATE: u32 = 30;
/// Largest yaw, pitch and roll (degrees) and displacement along x, y and z (centimetres) of a head, and the smallest
/// share of them that a clip reaches.
const SWAY: [f32; 6] = [22.0, 12.0, 8.0, 2.5, 1.5, 4.0];
const LEAST_SWAY: f32 = 0.75;
/// Number of waves that a motion consists of, and the range of their frequencies.
const WAVES: usize = 4;
const HERTZ: core::ops::Range<f32> = 0.08..0.7;
/// Faster waves are smaller.
const SLOW_HERTZ: f32 = 0.2;

/// Part of a recording.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    recording: usize,
    first: usize,
}

impl Stretch {
    /// Returns whether both stretches are of different moments, even frame by frame.
    fn is_apart_from(self, other: Self) -> bool {
        self.recording != other.recording || self.first.abs_diff(other.first) >= APART
    }
}

/// Returns the curves of a clip. Upper and lower half of the face follow stretches of recordings from different moments,
/// each mirrored in half of the clips, with each coefficient scaled.
pub fn random_curves(
    rng: &mut ChaCha8Rng,
    recordings: &[Vec<Coefficients>],
    count: usize,
) -> Result<Vec<Coefficients>> {
    let of = |(recording, frames): (usize, &Vec<Coefficients>)| {
        let last = (frames.len() + 1).saturating_sub(count);
        (0..last).map(move |first| Stretch { recording, first })
    };
    let all: Vec<Stretch> = recordings.iter().enumerate().flat_map(of).collect();
    let short = "the recordings of this set are too short for two stretches of this length: choose fewer --seconds";
    let upper = *all.iter().choose(rng).context(short)?;
    let lower = *all.iter().filter(|stretch| stretch.is_apart_from(upper)).choose(rng).context(short)?;
    let [upper, lower] = [upper, lower].map(|stretch| {
        let frames = &recordings[stretch.recording][stretch.first..][..count];
        if rng.random() { frames.iter().map(mirrored).collect() } else { frames.to_vec() }
    });
    let gains: Coefficients = core::array::from_fn(|_| rng.random_range(HALVES_SCALE));
    let faces = upper.iter().zip(&lower).map(|(upper, lower)| {
        let face = with_upper(upper, lower);
        let mut face = core::array::from_fn(|index| (gains[index] * face[index]).min(1.0));
        enforce_limits(&mut face);
        face
    });
    Ok(faces.collect())
}

/// Returns yaw, pitch, roll, x, y and z of a head in every frame of a clip.
pub fn random_sway(rng: &mut ChaCha8Rng, count: usize) -> Vec<[f32; 6]> {
    let motions = SWAY.map(|largest| {
        let waves: [Wave; WAVES] = core::array::from_fn(|_| Wave::random(rng));
        let at = |frame: usize| waves.iter().map(|wave| wave.at(frame as f32 / RATE as f32)).sum::<f32>();
        let motion: Vec<f32> = (0..count).map(at).collect();
        let peak = motion.iter().map(|value| value.abs()).fold(f32::MIN_POSITIVE, f32::max);
        let scale = largest * rng.random_range(LEAST_SWAY..1.0) / peak;
        motion.into_iter().map(|value| scale * value).collect::<Vec<f32>>()
    });
    (0..count).map(|frame| core::array::from_fn(|axis| motions[axis][frame])).collect()
}

/// A sinusoidal component of a motion.
struct Wave {
    size: f32,
    hertz: f32,
    phase: f32,
}

impl Wave {
    fn random(rng: &mut ChaCha8Rng) -> Self {
        let hertz: f32 = rng.random_range(HERTZ);
        let size = rng.random_range(0.3..1.0) * (SLOW_HERTZ / hertz).min(1.0);
        Self { size, hertz, phase: rng.random_range(0.0..TAU) }
    }

    fn at(&self, time_s: f32) -> f32 {
        self.size * (TAU * self.hertz * time_s + self.phase).sin()
    }
}

#[cfg(test)]
mod tests {
    use facewire::solve::COEFFS;
    use rand_chacha::rand_core::SeedableRng;

    use super::*;
    use crate::synth::anatomy::index_of;

    /// Returns a recording in which every coefficient grows by 0.001 a frame.
    fn recording(count: u16) -> Vec<Coefficients> {
        (0..count).map(|frame| [f32::from(frame) * 0.001; COEFFS]).collect()
    }

    #[test]
    fn both_halves_of_a_face_move_continuously_and_are_of_different_moments() {
        let (brow, jaw) = (index_of("browInnerUp"), index_of("jawOpen"));
        for seed in 0..20 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let curves = random_curves(&mut rng, &[recording(400)], 200).expect("long enough");
            assert_eq!(curves.len(), 200);
            for index in [brow, jaw] {
                let steps: Vec<f32> = curves.windows(2).map(|pair| pair[1][index] - pair[0][index]).collect();
                assert!(steps.iter().all(|step| (step - steps[0]).abs() < 1e-5 && (0.0009..0.0016).contains(step)));
            }
            let moment = |index: usize| curves[0][index] / (curves[1][index] - curves[0][index]);
            assert!((moment(brow) - moment(jaw)).abs() > APART as f32 - 2.0, "{} {}", moment(brow), moment(jaw));
        }
    }

    #[test]
    fn recordings_without_two_stretches_are_refused() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for count in [230, 300] {
            let error = random_curves(&mut rng, &[recording(280)], count).expect_err("too short").to_string();
            assert!(error.contains("--seconds"), "{error}");
        }
        assert!(random_curves(&mut rng, &[recording(280), recording(280)], 280).is_ok(), "one stretch of each");
    }

    #[test]
    fn heads_sway_by_about_20_degrees_without_jumps() {
        for seed in 0..10 {
            let sway = random_sway(&mut ChaCha8Rng::seed_from_u64(seed), 300);
            let yaw = sway.iter().map(|pose| pose[0].abs()).fold(0.0, f32::max);
            assert!((16.0..=22.0).contains(&yaw), "{yaw}");
            assert!(sway.windows(2).all(|pair| (pair[1][0] - pair[0][0]).abs() < 4.0));
        }
    }
}
