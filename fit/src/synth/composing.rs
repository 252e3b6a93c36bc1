//! Faces made of recorded moments. A recording shows one person with few combinations; taking the regions of the face
//! from different moments, mirrored or blended, keeps what belongs together and breaks what coincided.

use std::ops::Range;

use facewire::solve::COEFFS;
use rand::{RngExt, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::{
    anatomy::{Gaze, Region, index_of, joined, mirrored, weaken_side},
    expression::Coefficients,
    visemes::spoken,
};

/// Range of the factor on each coefficient of a recorded moment.
const SCALE: Range<f32> = 0.6..1.8;
/// The same for faces with two halves, and for a whole clip.
pub const HALVES_SCALE: Range<f32> = 1.0..1.5;
/// The same for the upper face of a person who speaks.
const CALM: Range<f32> = 0.2..1.0;
/// The jaw moves if it opens or shuts by this within [`SPAN`] frames.
const JAW_MOVES: f32 = 0.04;
/// A tenth of a second, in frames.
const SPAN: usize = 3;
/// Two moments with fewer frames between them can be parts of the same motion.
pub const APART: usize = 60;

/// Recorded frames to compose faces of.
pub struct Moments {
    frames: Vec<Coefficients>,
    /// Indices of the frames in which the jaw moves.
    speaking: Vec<usize>,
}

impl Moments {
    /// Collects the frames of recordings.
    pub fn new(recordings: &[Vec<Coefficients>]) -> Self {
        let jaw = index_of("jawOpen");
        let frames = recordings.concat();
        let moves = |index: &usize| (frames[index + SPAN][jaw] - frames[*index][jaw]).abs() > JAW_MOVES;
        let speaking = (0..frames.len().saturating_sub(SPAN)).filter(moves).collect();
        Self { frames, speaking }
    }

    /// Returns all frames.
    pub fn frames(&self) -> &[Coefficients] {
        &self.frames
    }

    /// Returns a random frame.
    pub fn any(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        self.frames.choose(rng).copied().unwrap_or([0.0; COEFFS])
    }

    /// Returns a recorded frame, or its mirror image, with each coefficient scaled.
    pub fn recorded(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let face = self.either_side(rng);
        let mut face = scaled(rng, face, SCALE);
        shift_gaze(rng, &mut face, 0.25);
        face
    }

    /// Returns a face with the regions of different moments.
    pub fn composed(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let mut face = [0.0; COEFFS];
        for region in Region::ALL {
            region.copy(&self.source(rng), &mut face);
        }
        if rng.random_bool(0.3) {
            let side = if rng.random() { "Left" } else { "Right" };
            weaken_side(&mut face, side, rng.random());
        }
        let mut face = scaled(rng, face, SCALE);
        shift_gaze(rng, &mut face, 0.5);
        face
    }

    /// Returns the face of a person who speaks: the mouth between two sounds, under a calm upper face.
    pub fn speech(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let upper = self.source(rng);
        let mut face = scaled(rng, upper, CALM);
        let mouth = if rng.random() { self.spoken(rng) } else { self.spoken_over_a_trace(rng) };
        Region::Mouth.copy(&mouth, &mut face);
        shift_gaze(rng, &mut face, 0.5);
        face
    }

    /// Returns a face whose upper and lower half are from moments far apart, each mirrored or not.
    pub fn halves(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let [upper, lower] = self.apart(rng).map(|index| either_way(rng, &self.frames[index]));
        scaled(rng, with_upper(&upper, &lower), HALVES_SCALE)
    }

    /// Returns the indices of two frames that are at least [`APART`] frames apart, if there are so many.
    fn apart(&self, rng: &mut ChaCha8Rng) -> [usize; 2] {
        let count = self.frames.len();
        let (one, least) = (rng.random_range(0..count), APART.min(count / 2));
        [one, (one + rng.random_range(least..=count - least)) % count]
    }

    fn either_side(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let face = self.any(rng);
        either_way(rng, &face)
    }

    /// Returns a moment, a blend of two, or the sides of two.
    fn source(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let [one, other] = [self.either_side(rng), self.either_side(rng)];
        match rng.random_range(0.0..1.0) {
            0.0..0.55 => one,
            0.55..0.85 => blended(&one, &other, rng.random()),
            _ => joined(&one, &other),
        }
    }

    /// Returns a blend of two moments in which the jaw moves.
    fn spoken(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let [one, other] =
            core::array::from_fn(|_| self.speaking.choose(rng).map_or([0.0; COEFFS], |index| self.frames[*index]));
        let face = blended(&one, &other, rng.random());
        scaled(rng, face, SCALE)
    }

    /// Returns a mixture of visemes, added to a trace of a recorded moment.
    fn spoken_over_a_trace(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let (sound, face, trace) = (spoken(rng), self.either_side(rng), rng.random_range(0.0..0.6));
        core::array::from_fn(|index| sound[index] + trace * face[index])
    }
}

/// Returns a face with the upper half of one face and the lower half of another.
pub fn with_upper(upper: &Coefficients, lower: &Coefficients) -> Coefficients {
    let mut face = *lower;
    Region::ALL.into_iter().filter(|region| region.is_upper()).for_each(|region| region.copy(upper, &mut face));
    face
}

/// Returns a face or its mirror image.
fn either_way(rng: &mut ChaCha8Rng, face: &Coefficients) -> Coefficients {
    if rng.random() { mirrored(face) } else { *face }
}

fn scaled(rng: &mut ChaCha8Rng, face: Coefficients, range: Range<f32>) -> Coefficients {
    face.map(|value| value * rng.random_range(range.clone()))
}

fn blended(one: &Coefficients, other: &Coefficients, share: f32) -> Coefficients {
    core::array::from_fn(|index| one[index] + share * (other[index] - one[index]))
}

/// Gives the face another direction of gaze in a share of the cases, because recorded eyes mostly look at one point.
fn shift_gaze(rng: &mut ChaCha8Rng, face: &mut Coefficients, share: f64) {
    if rng.random_bool(share) {
        let (left, up) = (rng.random_range(-0.9..0.9), rng.random_range(-0.8..0.8));
        Gaze { left, up, ..Gaze::of(face) }.set(face);
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use rand_chacha::rand_core::SeedableRng;

    use super::*;
    use crate::statistics::pearson;

    /// Returns a recording in which every coefficient is the frame's share of the whole.
    fn moments(count: u16) -> Moments {
        Moments::new(&[(0..count).map(|frame| [f32::from(frame) / f32::from(count); COEFFS]).collect()])
    }

    #[test]
    fn halves_are_from_moments_far_apart() {
        let (mut rng, moments) = (ChaCha8Rng::seed_from_u64(1), moments(300));
        let mut seen = [false; 300];
        for _ in 0..3000 {
            let [upper, lower] = moments.apart(&mut rng);
            let gap = upper.abs_diff(lower);
            assert!((APART..=300 - APART).contains(&gap), "{upper} {lower}");
            seen[lower] = true;
        }
        assert!(seen.iter().all(|seen| *seen), "every frame is used");
        assert!(super::tests::moments(1).apart(&mut rng).iter().all(|index| *index == 0));
    }

    #[test]
    fn the_upper_half_is_eyes_and_brows() {
        let face = with_upper(&[0.2; COEFFS], &[0.7; COEFFS]);
        for (name, value) in [("browInnerUp", 0.2), ("eyeLookUpLeft", 0.2), ("noseSneerLeft", 0.7), ("jawOpen", 0.7)] {
            assert_eq!(face[index_of(name)], value, "{name}");
        }
    }

    #[test]
    fn regions_of_a_composed_face_come_from_different_moments() {
        let (mut rng, moments) = (ChaCha8Rng::seed_from_u64(2), moments(1000));
        let mean = |face: &Coefficients, names: [&str; 2]| {
            f64::midpoint(face[index_of(names[0])].into(), face[index_of(names[1])].into())
        };
        let mut r = |draw: fn(&Moments, &mut ChaCha8Rng) -> Coefficients| {
            let faces: Vec<Coefficients> = (0..2000).map(|_| draw(&moments, &mut rng)).collect();
            let [brows, mouth] = [["browInnerUp", "browDownLeft"], ["jawOpen", "mouthFunnel"]]
                .map(|names| faces.iter().map(|face| mean(face, names)).collect::<Vec<_>>());
            pearson(&brows, &mouth)
        };
        let [composed, recorded] = [r(Moments::composed), r(Moments::recorded)];
        assert!(composed.abs() < 0.1, "brows and mouth of composed faces: {composed}");
        assert!(recorded > 0.7, "in recorded faces they go together: {recorded}");
    }

    #[test]
    fn speech_moves_the_mouth_by_sounds_even_where_the_recorded_jaw_never_moves() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let still = Moments::new(&[vec![[0.0; COEFFS]; 100]]);
        let open = (0..200).filter(|_| still.speech(&mut rng)[index_of("jawOpen")] > 0.02).count();
        assert!((70..130).contains(&open), "half of the mouths are visemes: {open}");
    }
}
