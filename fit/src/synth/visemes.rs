//! Mouth shapes of speech sounds. Neighbouring sounds blend into each other (co-articulation), so that a picture of
//! speech shows a mixture of two.

use std::sync::LazyLock;

use facewire::solve::COEFFS;
use rand::{RngExt, seq::IndexedRandom};
use rand_chacha::ChaCha8Rng;

use super::{anatomy::find, expression::Coefficients};

/// Range of the factor on each coefficient: people articulate differently.
const ARTICULATION: core::ops::Range<f32> = 0.4..1.6;

/// Shapes with their strength. A name without a side stands for both sides.
type Viseme = &'static [(&'static str, f32)];

/// The visemes of English, after the groups of MPEG-4 (ISO/IEC 14496-2).
const VISEMES: [Viseme; 13] = [
    // p, b, m: the lips close over an open jaw.
    &[("jawOpen", 0.2), ("mouthClose", 0.19), ("mouthPress", 0.3), ("mouthRollUpper", 0.25), ("mouthRollLower", 0.3)],
    // f, v: the lower lip is below the upper teeth.
    &[("jawOpen", 0.1), ("mouthRollLower", 0.5), ("mouthUpperUp", 0.2), ("mouthShrugLower", 0.15)],
    // th
    &[("jawOpen", 0.2), ("mouthLowerDown", 0.3), ("mouthUpperUp", 0.15), ("mouthFunnel", 0.1)],
    // t, d
    &[("jawOpen", 0.12), ("mouthLowerDown", 0.25), ("mouthStretch", 0.2), ("mouthShrugUpper", 0.2)],
    // k, g
    &[("jawOpen", 0.25), ("mouthLowerDown", 0.3), ("mouthStretch", 0.2), ("mouthUpperUp", 0.2)],
    // sh, ch, j
    &[("jawOpen", 0.08), ("mouthFunnel", 0.5), ("mouthShrugUpper", 0.35), ("mouthPucker", 0.3), ("jawForward", 0.2)],
    // s, z
    &[("jawOpen", 0.04), ("mouthStretch", 0.35), ("mouthLowerDown", 0.4), ("mouthUpperUp", 0.2), ("mouthDimple", 0.15)],
    // n, l
    &[("jawOpen", 0.18), ("mouthLowerDown", 0.3), ("mouthUpperUp", 0.2), ("mouthShrugUpper", 0.15)],
    // r
    &[("jawOpen", 0.12), ("mouthFunnel", 0.35), ("mouthPucker", 0.3), ("mouthShrugUpper", 0.2)],
    // a
    &[("jawOpen", 0.55), ("mouthLowerDown", 0.35), ("mouthUpperUp", 0.2), ("mouthStretch", 0.15)],
    // e, i
    &[("jawOpen", 0.2), ("mouthSmile", 0.25), ("mouthStretch", 0.35), ("mouthDimple", 0.2), ("mouthLowerDown", 0.35)],
    // o
    &[("jawOpen", 0.4), ("mouthFunnel", 0.55), ("mouthPucker", 0.35), ("mouthLowerDown", 0.15)],
    // u, w
    &[("jawOpen", 0.12), ("mouthPucker", 0.75), ("mouthFunnel", 0.3), ("mouthShrugLower", 0.15)],
];

static FACES: LazyLock<[Coefficients; VISEMES.len()]> = LazyLock::new(|| VISEMES.map(face));

fn face(viseme: Viseme) -> Coefficients {
    let mut face = [0.0; COEFFS];
    for (stem, strength) in viseme {
        for ending in ["", "Left", "Right"] {
            if let Some(index) = find(&format!("{stem}{ending}")) {
                face[index] = *strength;
            }
        }
    }
    face
}

/// Returns a random mixture of two visemes.
pub fn spoken(rng: &mut ChaCha8Rng) -> Coefficients {
    let [one, other] = core::array::from_fn(|_| FACES.choose(rng).copied().unwrap_or([0.0; COEFFS]));
    let share: f32 = rng.random();
    core::array::from_fn(|index| (share * one[index] + (1.0 - share) * other[index]) * rng.random_range(ARTICULATION))
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use rand_chacha::rand_core::SeedableRng;

    use super::*;

    #[test]
    fn every_viseme_moves_all_its_shapes_and_shapes_with_sides_on_both() {
        for (viseme, face) in VISEMES.iter().zip(FACES.iter()) {
            let sides = |stem: &str| if find(stem).is_some() { 1 } else { 2 };
            let expected: usize = viseme.iter().map(|(stem, _)| sides(stem)).sum();
            assert_eq!(face.iter().filter(|value| **value > 0.0).count(), expected, "{viseme:?}");
        }
    }

    #[test]
    fn spoken_faces_differ_and_stay_moderate() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let faces: Vec<Coefficients> = (0..50).map(|_| spoken(&mut rng)).collect();
        assert!(faces.windows(2).all(|pair| pair[0] != pair[1]));
        assert!(faces.iter().flatten().all(|value| (0.0..1.3).contains(value)));
    }
}
