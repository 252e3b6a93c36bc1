//! Random expressions: single shapes, frames of real recordings, combinations, and the face at rest.

use std::sync::LazyLock;

use facewire::solve::{BLENDSHAPES, COEFFS};
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::ChaCha8Rng;

use super::expression::Coefficients;

/// Coefficient above which a shape counts as active.
const ACTIVE: f32 = 0.3;
/// Largest factor on the recorded frame that is added to a single shape.
const TRACE: f32 = 0.15;
/// Range of the factor on each coefficient of a recorded frame.
const SCALE: core::ops::Range<f32> = 0.6..1.8;
/// Pairs of shapes that are not active together on a real face.
const EXCLUSIVE: [(&str, &str); 14] = [
    ("eyeBlinkLeft", "eyeWideLeft"),
    ("eyeBlinkRight", "eyeWideRight"),
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    ("browDownLeft", "browOuterUpLeft"),
    ("browDownRight", "browOuterUpRight"),
    ("mouthSmileLeft", "mouthFrownLeft"),
    ("mouthSmileRight", "mouthFrownRight"),
    ("eyeLookUpLeft", "eyeLookDownLeft"),
    ("eyeLookUpRight", "eyeLookDownRight"),
    ("eyeLookInLeft", "eyeLookOutLeft"),
    ("eyeLookInRight", "eyeLookOutRight"),
    ("mouthFunnel", "mouthStretchLeft"),
    ("mouthPucker", "mouthSmileLeft"),
];
/// The shape that moves together with each shape: the same on the other side, or the same direction of the other eye.
static PARTNERS: LazyLock<Vec<Option<Partner>>> =
    LazyLock::new(|| BLENDSHAPES.iter().map(|name| Partner::of(name)).collect());

struct Partner {
    index: usize,
    /// Whether both shapes always have the same strength.
    fixed: bool,
}

/// Relative frequencies of the kinds of expressions.
#[derive(Debug, Clone, Copy)]
pub struct Mix {
    /// One shape, alone or with its partner.
    pub single: f32,
    /// A frame of a recording.
    pub recorded: f32,
    /// Three to six shapes.
    pub combined: f32,
    /// No expression, to teach what turning the head alone looks like.
    pub rest: f32,
}

/// Returns a random expression. `frames` are recorded frames, `shapes` the candidates for a single shape (all if
/// empty).
pub fn random_expression(rng: &mut ChaCha8Rng, mix: Mix, frames: &[Coefficients], shapes: &[usize]) -> Coefficients {
    let choice = rng.random_range(0.0..mix.single + mix.recorded + mix.combined + mix.rest);
    let mut weights = if choice < mix.single {
        single(rng, frames, shapes)
    } else if choice < mix.single + mix.recorded {
        recorded(rng, frames)
    } else if choice < mix.single + mix.recorded + mix.combined {
        combined(rng)
    } else {
        [0.0; COEFFS]
    };
    constrain(rng, &mut weights);
    weights
}

fn frame(rng: &mut ChaCha8Rng, frames: &[Coefficients]) -> Coefficients {
    frames.iter().choose(rng).copied().unwrap_or([0.0; COEFFS])
}

fn single(rng: &mut ChaCha8Rng, frames: &[Coefficients], shapes: &[usize]) -> Coefficients {
    let trace = rng.random_range(0.0..TRACE);
    let mut weights = frame(rng, frames).map(|value| trace * value);
    let any = rng.random_range(0..COEFFS - 1);
    let (index, strength) = (shapes.get(any % shapes.len().max(1)).copied().unwrap_or(any), rng.random());
    weights[index] = strength;
    match &PARTNERS[index] {
        Some(partner) if partner.fixed => weights[partner.index] = strength,
        Some(partner) if rng.random_bool(0.6) => weights[partner.index] = strength * rng.random_range(0.7..1.3),
        _ => {}
    }
    open_for_closed_lips(rng, &mut weights);
    weights
}

/// Opens the jaw if the lips would close further than the jaw is open.
fn open_for_closed_lips(rng: &mut ChaCha8Rng, weights: &mut Coefficients) {
    let (close, open) = (index_of("mouthClose"), index_of("jawOpen"));
    if weights[close] > weights[open] {
        weights[open] = weights[close] + rng.random_range(0.0..0.4);
    }
}

fn recorded(rng: &mut ChaCha8Rng, frames: &[Coefficients]) -> Coefficients {
    frame(rng, frames).map(|value| value * rng.random_range(SCALE))
}

fn combined(rng: &mut ChaCha8Rng) -> Coefficients {
    let mut weights = [0.0; COEFFS];
    let count = rng.random_range(3..=6);
    for index in (0..COEFFS - 1).sample(rng, count) {
        weights[index] = rng.random();
    }
    open_for_closed_lips(rng, &mut weights);
    weights
}

/// Clamps the coefficients and removes combinations that no real face shows.
fn constrain(rng: &mut ChaCha8Rng, weights: &mut Coefficients) {
    *weights = weights.map(|value| value.clamp(0.0, 1.0));
    for (one, other) in EXCLUSIVE {
        let (one, other) = (index_of(one), index_of(other));
        if weights[one] > ACTIVE && weights[other] > ACTIVE {
            weights[if rng.random() { one } else { other }] = 0.0;
        }
    }
    enforce_limits(weights);
}

/// Enforces the limits of every expression: lips close no further than the jaw is open, and the tongue is not shown.
pub fn enforce_limits(weights: &mut Coefficients) {
    let (close, open) = (index_of("mouthClose"), index_of("jawOpen"));
    weights[close] = weights[close].min(weights[open]);
    weights[index_of("tongueOut")] = 0.0;
}

/// Returns the index of a blendshape.
pub fn index_of(name: &str) -> usize {
    BLENDSHAPES.iter().position(|known| *known == name).unwrap_or(0)
}

impl Partner {
    fn of(name: &str) -> Option<Self> {
        let (stem, other) = match (name.strip_suffix("Left"), name.strip_suffix("Right")) {
            (Some(stem), _) => (stem, "Right"),
            (_, Some(stem)) => (stem, "Left"),
            _ => return None,
        };
        let (fixed, stem) = match stem {
            "jaw" | "mouth" => return None,
            "eyeLookIn" => (true, "eyeLookOut"),
            "eyeLookOut" => (true, "eyeLookIn"),
            _ => (false, stem),
        };
        Some(Self { index: index_of(&format!("{stem}{other}")), fixed })
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::rand_core::SeedableRng;

    use super::*;

    const MIX: Mix = Mix { single: 1.0, recorded: 1.0, combined: 1.0, rest: 0.1 };

    #[test]
    fn coefficients_are_bounded_and_lips_close_no_further_than_the_jaw_is_open() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let frames = [[0.9; COEFFS], [0.1; COEFFS]];
        let (close, open, tongue) = (index_of("mouthClose"), index_of("jawOpen"), index_of("tongueOut"));
        for _ in 0..2000 {
            let weights = random_expression(&mut rng, MIX, &frames, &[]);
            assert!(weights.iter().all(|value| (0.0..=1.0).contains(value)));
            assert!(weights[close] <= weights[open] && weights[tongue] == 0.0);
        }
    }

    #[test]
    fn every_shape_but_the_tongue_is_drawn_strong_and_weak() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mix = Mix { recorded: 0.0, rest: 0.0, ..MIX };
        let drawn: Vec<Coefficients> = (0..4000).map(|_| random_expression(&mut rng, mix, &[], &[])).collect();
        for index in 0..COEFFS - 1 {
            let strong = drawn.iter().filter(|weights| weights[index] > 0.7).count();
            assert!(strong > 20, "{} {strong}", BLENDSHAPES[index]);
        }
    }

    #[test]
    fn only_chosen_shapes_are_shown_alone() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mix = Mix { recorded: 0.0, combined: 0.0, rest: 0.0, ..MIX };
        let (puff, open) = (index_of("cheekPuff"), index_of("jawOpen"));
        for _ in 0..200 {
            let weights = random_expression(&mut rng, mix, &[], &[puff, open]);
            assert!(weights.iter().enumerate().all(|(index, weight)| *weight == 0.0 || [puff, open].contains(&index)));
        }
    }

    #[test]
    fn both_eyes_look_in_the_same_direction() {
        let partner = |name: &str| PARTNERS[index_of(name)].as_ref().map(|partner| BLENDSHAPES[partner.index]);
        assert_eq!(partner("eyeLookInLeft"), Some("eyeLookOutRight"));
        assert_eq!(partner("eyeLookOutLeft"), Some("eyeLookInRight"));
        assert_eq!(partner("eyeBlinkRight"), Some("eyeBlinkLeft"));
        assert_eq!(partner("mouthLeft"), None);
    }
}
