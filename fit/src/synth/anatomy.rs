//! What the sampler knows about faces: which blendshapes lie on either side, which belong together, and which
//! combinations no face shows.

use std::{array, sync::LazyLock};

use facewire_face::stages::MIRRORED;
use facewire_face::{BLENDSHAPES, COEFFS};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::expression::{Coefficients, ROLLS};
use crate::shapes::index_of;

const ACTIVE: f32 = 0.3;
/// Largest convergence of the eyes, as a share of `eyeLookIn`. Recorded eyes converge by 0.05.
pub const CONVERGENCE: f32 = 0.12;
/// How far the lips are open, as `jawOpen` less `mouthClose`, to let the whole tongue pass.
const LIPS_FOR_TONGUE: f32 = 0.15;
/// How much of this opening a fully rolled-in lip fills.
const ROLLED_LIPS: f32 = 0.18;
/// Pairs of shapes that are not active together on a real face.
pub const EXCLUSIVE: [(&str, &str); 10] = [
    ("eyeBlinkLeft", "eyeWideLeft"),
    ("eyeBlinkRight", "eyeWideRight"),
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    ("browDownLeft", "browOuterUpLeft"),
    ("browDownRight", "browOuterUpRight"),
    ("mouthSmileLeft", "mouthFrownLeft"),
    ("mouthSmileRight", "mouthFrownRight"),
    ("mouthPucker", "mouthSmileLeft"),
    ("mouthPucker", "mouthSmileRight"),
];
/// `eyeLookIn`, `eyeLookOut`, `eyeLookUp` and `eyeLookDown` of the left and the right eye.
pub static LOOK: LazyLock<[[usize; 4]; 2]> = LazyLock::new(|| {
    ["Left", "Right"].map(|side| ["In", "Out", "Up", "Down"].map(|to| index_of(&format!("eyeLook{to}{side}"))))
});
static EXCLUSIVE_INDICES: LazyLock<[[usize; 2]; EXCLUSIVE.len()]> =
    LazyLock::new(|| EXCLUSIVE.map(|(one, other)| [one, other].map(index_of)));
pub static REGIONS: LazyLock<[Region; COEFFS]> = LazyLock::new(|| BLENDSHAPES.map(Region::of));
static JAW_OPEN: LazyLock<usize> = LazyLock::new(|| index_of("jawOpen"));
static MOUTH_CLOSE: LazyLock<usize> = LazyLock::new(|| index_of("mouthClose"));
static ROLL_INDICES: LazyLock<[usize; 2]> = LazyLock::new(|| ROLLS.map(index_of));
pub static TONGUE_OUT: LazyLock<usize> = LazyLock::new(|| index_of("tongueOut"));

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Region {
    Gaze,
    Lids,
    Brows,
    Cheeks,
    Mouth,
}

impl Region {
    pub const ALL: [Self; 5] = [Self::Gaze, Self::Lids, Self::Brows, Self::Cheeks, Self::Mouth];

    fn of(name: &str) -> Self {
        let starts = [
            ("eyeLook", Self::Gaze),
            ("eye", Self::Lids),
            ("brow", Self::Brows),
            ("cheekSquint", Self::Cheeks),
            ("nose", Self::Cheeks),
        ];
        starts.into_iter().find(|(start, _)| name.starts_with(start)).map_or(Self::Mouth, |(_, region)| region)
    }

    pub fn copy(self, from: &Coefficients, to: &mut Coefficients) {
        for (index, value) in from.iter().enumerate().filter(|(index, _)| REGIONS[*index] == self) {
            to[index] = *value;
        }
    }
}

/// Returns the shape of the other side, and whether both always have the same strength.
pub fn partner(index: usize) -> Option<(usize, bool)> {
    let (name, opposite) = (BLENDSHAPES[index], MIRRORED[index]);
    if opposite == index || ["jawLeft", "jawRight", "mouthLeft", "mouthRight"].contains(&name) {
        return None;
    }
    let across = LOOK.iter().zip(LOOK.iter().rev()).find_map(|(eye, other)| {
        let to = eye.iter().position(|look| *look == index)?;
        Some(other[[1, 0, 2, 3][to]])
    });
    Some((across.unwrap_or(opposite), across.is_some()))
}

pub fn mirrored(face: &Coefficients) -> Coefficients {
    array::from_fn(|index| face[MIRRORED[index]])
}

/// Returns a face with the left side of one face and the right side of another. Shapes in the middle are averaged.
pub fn joined(left: &Coefficients, right: &Coefficients) -> Coefficients {
    array::from_fn(|index| match BLENDSHAPES[index] {
        _ if MIRRORED[index] == index => f32::midpoint(left[index], right[index]),
        name if name.ends_with("Left") => left[index],
        _ => right[index],
    })
}

pub fn weaken_side(face: &mut Coefficients, side: &str, factor: f32) {
    let own = BLENDSHAPES.iter().zip(face).filter(|(name, _)| name.ends_with(side));
    own.for_each(|(_, value)| *value *= factor);
}

/// The direction in which both eyes look, as the sum of their `eyeLook` coefficients.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaze {
    /// To the person's left if positive.
    pub left: f32,
    pub up: f32,
    /// How far each eye turns toward the nose.
    pub convergence: f32,
}

impl Gaze {
    pub fn of(face: &Coefficients) -> Self {
        let [left, right] = LOOK.map(|look| look.map(|index| face[index]));
        let [left_out, right_in] = [left[1] - left[0], right[0] - right[1]];
        Self {
            left: f32::midpoint(left_out, right_in),
            up: f32::midpoint(left[2] - left[3], right[2] - right[3]),
            convergence: ((right_in - left_out) / 2.0).clamp(0.0, CONVERGENCE),
        }
    }

    pub fn set(self, face: &mut Coefficients) {
        let [left_out, right_out] = [self.left, -self.left].map(|out| out - self.convergence);
        for (look, out) in LOOK.iter().zip([left_out, right_out]) {
            for (index, value) in look.iter().zip([-out, out, self.up, -self.up]) {
                face[*index] = value.clamp(0.0, 1.0);
            }
        }
    }
}

/// If the lips close further than the jaw opens, opens the jaw as far, so that they meet. In half of the cases, opens it
/// further, so that they do not.
pub fn open_for_closed_lips(rng: &mut ChaCha8Rng, face: &mut Coefficients) {
    if face[*MOUTH_CLOSE] > face[*JAW_OPEN] {
        let further = if rng.random::<bool>() { rng.random_range(0.0..0.4) } else { 0.0 };
        face[*JAW_OPEN] = face[*MOUTH_CLOSE] + further;
    }
}

pub fn constrain(rng: &mut ChaCha8Rng, face: &mut Coefficients) {
    *face = face.map(|value| value.clamp(0.0, 1.0));
    for pair in *EXCLUSIVE_INDICES {
        if pair.iter().all(|index| face[*index] > ACTIVE) {
            face[pair[usize::from(rng.random::<bool>())]] = 0.0;
        }
    }
    enforce_limits(face);
}

/// Enforces the limits of every expression: both eyes look in the same direction, lips close no further than the jaw
/// is open, and no tongue passes shut lips.
pub fn enforce_limits(face: &mut Coefficients) {
    Gaze::of(face).set(face);
    face[*MOUTH_CLOSE] = face[*MOUTH_CLOSE].min(face[*JAW_OPEN]);
    let rolled = ROLL_INDICES.iter().map(|index| face[*index]).fold(0.0, f32::max);
    let lips_open = (face[*JAW_OPEN] - face[*MOUTH_CLOSE] - ROLLED_LIPS * rolled).max(0.0);
    face[*TONGUE_OUT] = face[*TONGUE_OUT].min(lips_open / LIPS_FOR_TONGUE);
}
