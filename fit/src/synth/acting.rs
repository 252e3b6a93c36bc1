//! Random expressions: faces of recordings and faces composed of them, speech, grimaces, few shapes, and rest.

use std::array;
use std::ops::{Range, RangeInclusive};
use std::sync::LazyLock;

use clap::ValueEnum;
use facewire_face::{BLENDSHAPES, COEFFS};
use rand::RngExt;
use rand::seq::{IndexedRandom, IteratorRandom};
use rand_chacha::ChaCha8Rng;
use rand_distr::Distribution;
use rand_distr::weighted::WeightedIndex;

use super::anatomy::{
    CONVERGENCE, Gaze, Region, constrain, joined, mirrored, open_for_closed_lips, partner, weaken_side,
};
use super::expression::Coefficients;
use super::prototypes::{LOWER, UPPER};
use crate::shapes::{find, index_of};

/// Largest factor on the recorded frame that is added to a single shape.
const TRACE: f32 = 0.15;
/// Probability that the partner of a random shape moves, too, and the factor on its strength.
const PAIRED: f64 = 0.6;
const PARTNER_SCALE: Range<f32> = 0.7..1.3;
/// Shares of the faces of [`Kind::Gaze`] that are calm, and that look nearly straight ahead, as people mostly do.
const CALM_LOOKS: f64 = 0.3;
const SMALL_LOOKS: f64 = 0.4;
/// Number of shapes that are added to a composed face, and that a grimace consists of.
const ADDED: RangeInclusive<usize> = 1..=4;
const GRIMACE: RangeInclusive<usize> = 6..=16;

/// Of combinations of facial actions: the range of their strength, that of the factor on each coefficient, the share in which the
/// upper or the lower face does nothing, and that in which one side is weaker.
const STRENGTH: Range<f32> = 0.15..1.25;
const PROTOTYPE: Range<f32> = 0.7..1.3;
const WITHOUT: f64 = 0.2;
const ONE_SIDED: f64 = 0.3;

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Upper and lower half of two recorded frames far apart in time
    Halves,
    /// A frame of a recording, with each coefficient scaled
    Recorded,
    /// Eyes, brows, cheeks and mouth of different recorded frames, with one to four shapes added
    Composed,
    /// A mouth between two sounds, and a calm upper face
    Speech,
    /// 6 to 16 random shapes, mostly on both sides
    Grimace,
    /// One shape, alone or with its partner on the other side
    Single,
    /// Three to six random shapes
    Combined,
    /// A face, calm or not, perhaps with lowered lids, whose eyes look anywhere, often nearly ahead
    Gaze,
    /// A mouth wide open, half open, nearly closed, round or smiling, in six of ten cases with the tongue out
    Tongue,
    /// A combination of facial actions of brows and lids, and one of the mouth, each as frequent as any other
    Prototypes,
    /// No expression, to teach what turning the head alone looks like
    Rest,
}

pub type Share = (Kind, f32);

pub struct Expressions {
    pub moments: Moments,
    kinds: Vec<Kind>,
    frequencies: WeightedIndex<f32>,
    shapes: Vec<usize>,
}

impl Expressions {
    /// Returns a sampler of a mixture of kinds, of which at least one needs a positive frequency.
    pub fn new(moments: Moments, mix: &[Share], shapes: Vec<usize>) -> anyhow::Result<Self> {
        let frequencies = WeightedIndex::new(mix.iter().map(|(_, share)| *share))?;
        Ok(Self { moments, kinds: mix.iter().map(|(kind, _)| *kind).collect(), frequencies, shapes })
    }

    pub fn draw(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let mut face = match self.kinds[self.frequencies.sample(rng)] {
            Kind::Recorded => self.moments.recorded(rng),
            Kind::Composed => self.composed(rng),
            Kind::Speech => self.moments.speech(rng),
            Kind::Grimace => grimace(rng),
            Kind::Single => self.single(rng),
            Kind::Combined => combined(rng),
            Kind::Gaze => self.moments.looking(rng),
            Kind::Halves => self.moments.halves(rng),
            Kind::Tongue => self.moments.tongue_mouth(rng),
            Kind::Prototypes => self.moments.prototypes(rng),
            Kind::Rest => [0.0; COEFFS],
        };
        constrain(rng, &mut face);
        face
    }

    pub fn composed(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let mut face = self.moments.composed(rng);
        for _ in 0..rng.random_range(ADDED) {
            let strength = rng.random();
            let index = any_shape(rng);
            raise(rng, &mut face, index, strength);
        }
        face
    }

    fn single(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let trace = rng.random_range(0.0..TRACE);
        let mut face = self.moments.any(rng).map(|value| trace * value);
        let index = self.shapes.iter().choose(rng).copied().unwrap_or_else(|| any_shape(rng));
        let strength = rng.random();
        raise(rng, &mut face, index, strength);
        open_for_closed_lips(rng, &mut face);
        face
    }
}

/// Returns any blendshape but the last, `tongueOut`.
fn any_shape(rng: &mut ChaCha8Rng) -> usize {
    rng.random_range(0..COEFFS - 1)
}

fn raise(rng: &mut ChaCha8Rng, face: &mut Coefficients, index: usize, strength: f32) {
    let mut raise_to = |index: usize, strength: f32| face[index] = face[index].max(strength);
    raise_to(index, strength);
    match partner(index) {
        Some((partner, true)) => raise_to(partner, strength),
        Some((partner, false)) if rng.random_bool(PAIRED) => {
            raise_to(partner, strength * rng.random_range(PARTNER_SCALE));
        }
        _ => {}
    }
}

fn grimace(rng: &mut ChaCha8Rng) -> Coefficients {
    let mut face = [0.0; COEFFS];
    for _ in 0..rng.random_range(GRIMACE) {
        let (index, strength) = (any_shape(rng), rng.random::<f32>().powi(2));
        raise(rng, &mut face, index, strength);
    }
    open_for_closed_lips(rng, &mut face);
    face
}

fn combined(rng: &mut ChaCha8Rng) -> Coefficients {
    let mut face = [0.0; COEFFS];
    let count = rng.random_range(3..=6);
    for index in (0..COEFFS - 1).sample(rng, count) {
        face[index] = rng.random();
    }
    open_for_closed_lips(rng, &mut face);
    face
}

// Faces made of recorded moments. A recording shows one person with few combinations; taking the regions of the face
// from different moments, mirrored or blended, keeps what belongs together and breaks what coincided.

/// Range of the factor on each coefficient of a recorded moment.
const SCALE: Range<f32> = 0.6..1.8;
/// The same for faces with two halves, and for a whole clip.
pub const HALVES_SCALE: Range<f32> = 1.0..1.5;
/// The same for the upper face of a person who speaks.
const CALM: Range<f32> = 0.2..1.0;
/// The jaw moves if it opens or shuts by this within [`SPAN`] frames.
const JAW_MOVES: f32 = 0.04;
const SPAN: usize = 3;
/// Two moments with fewer frames between them can be parts of the same motion.
pub const APART: usize = 60;

pub struct Moments {
    pub frames: Vec<Coefficients>,
    speaking: Vec<usize>,
}

impl Moments {
    pub fn new(recordings: &[Vec<Coefficients>]) -> Self {
        let jaw = index_of("jawOpen");
        let frames = recordings.concat();
        let moves = |index: &usize| (frames[index + SPAN][jaw] - frames[*index][jaw]).abs() > JAW_MOVES;
        let speaking = (0..frames.len().saturating_sub(SPAN)).filter(moves).collect();
        Self { frames, speaking }
    }

    fn any(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        self.frames.choose(rng).copied().unwrap_or([0.0; COEFFS])
    }

    pub fn recorded(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let face = self.either_side(rng);
        let mut face = scaled(rng, face, SCALE);
        shift_gaze(rng, &mut face, 0.25);
        face
    }

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

    /// Returns a face whose lids may be lowered, and whose eyes look anywhere.
    fn looking(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let source = self.source(rng);
        let range = if rng.random_bool(CALM_LOOKS) { CALM } else { SCALE };
        let mut face = scaled(rng, source, range);
        let lowered = rng.random_range(-1.0..0.6_f32).max(0.0);
        raise(rng, &mut face, index_of("eyeBlinkLeft"), lowered);
        let spread = if rng.random_bool(SMALL_LOOKS) { 0.25 } else { 1.0 };
        let [left, up] = [(); 2].map(|()| spread * rng.random_range(-1.0..1.0));
        Gaze { left, up, convergence: rng.random_range(0.0..CONVERGENCE) }.set(&mut face);
        face
    }

    /// Returns a face whose upper and lower half are from moments far apart, each mirrored or not.
    fn halves(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let [upper, lower] = self.apart(rng).map(|index| either_way(rng, &self.frames[index]));
        scaled(rng, with_upper(&upper, &lower), HALVES_SCALE)
    }

    /// Returns the face of one combination of facial actions above and one below, either of which may be missing or weaker on one
    /// side, over a trace of a recorded face.
    fn prototypes(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let mut parts =
            [UPPER.as_slice(), &LOWER].map(|shapes| shapes.choose(rng).map_or([0.0; COEFFS], |shapes| face(shapes)));
        for part in &mut parts {
            let strength = if rng.random_bool(WITHOUT) { 0.0 } else { rng.random_range(STRENGTH) };
            *part = scaled(rng, part.map(|value| strength * value), PROTOTYPE);
            if rng.random_bool(ONE_SIDED) {
                let side = if rng.random() { "Left" } else { "Right" };
                weaken_side(part, side, rng.random());
            }
        }
        let [upper, lower] = parts.map(|part| if rng.random() { mirrored(&part) } else { part });
        let (recorded, trace) = (self.either_side(rng), rng.random_range(0.0..TRACE));
        let mut face = array::from_fn(|index| (upper[index] + lower[index]).max(trace * recorded[index]));
        shift_gaze(rng, &mut face, 0.5);
        face
    }

    /// Returns a face with an open mouth, in six of ten cases with the tongue out, anywhere up to fully.
    fn tongue_mouth(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let upper = self.source(rng);
        let mut face = scaled(rng, upper, SCALE);
        let mouth = self::face(TONGUE_MOUTHS[rng.random_range(0..TONGUE_MOUTHS.len())]);
        let (mouth, trace, other) =
            (scaled(rng, mouth, ARTICULATION), rng.random_range(0.0..0.3), self.either_side(rng));
        Region::Mouth.copy(&array::from_fn(|index| mouth[index] + trace * other[index]), &mut face);
        for (value, name) in face.iter_mut().zip(BLENDSHAPES) {
            match name {
                "jawOpen" => *value = value.clamp(0.15, 0.9),
                "mouthClose" => *value = 0.0,
                "tongueOut" => *value = if rng.random_bool(0.6) { rng.random() } else { 0.0 },
                name if name.starts_with("mouthPress") || name.starts_with("mouthRoll") => *value *= 0.3,
                _ => {}
            }
        }
        face
    }

    /// Returns the indices of two frames that are at least [`APART`] frames apart, if there are so many.
    pub fn apart(&self, rng: &mut ChaCha8Rng) -> [usize; 2] {
        let count = self.frames.len();
        let (one, least) = (rng.random_range(0..count), APART.min(count / 2));
        [one, (one + rng.random_range(least..=count - least)) % count]
    }

    fn either_side(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let face = self.any(rng);
        either_way(rng, &face)
    }

    fn source(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let [one, other] = [self.either_side(rng), self.either_side(rng)];
        match rng.random_range(0.0..1.0) {
            0.0..0.55 => one,
            0.55..0.85 => blended(&one, &other, rng.random()),
            _ => joined(&one, &other),
        }
    }

    fn spoken(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let [one, other] =
            core::array::from_fn(|_| self.speaking.choose(rng).map_or([0.0; COEFFS], |index| self.frames[*index]));
        let face = blended(&one, &other, rng.random());
        scaled(rng, face, SCALE)
    }

    fn spoken_over_a_trace(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let (sound, face, trace) = (spoken(rng), self.either_side(rng), rng.random_range(0.0..0.6));
        core::array::from_fn(|index| sound[index] + trace * face[index])
    }
}

pub fn with_upper(upper: &Coefficients, lower: &Coefficients) -> Coefficients {
    let mut face = *lower;
    [Region::Gaze, Region::Lids, Region::Brows].iter().for_each(|region| region.copy(upper, &mut face));
    face
}

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

// Mouth shapes of speech sounds. Neighbouring sounds blend into each other (co-articulation), so that a picture of
// speech shows a mixture of two.

/// Range of the factor on each coefficient: people articulate differently.
const ARTICULATION: Range<f32> = 0.4..1.6;

/// Names of blendshapes, without the side for those that have two, and their coefficients.
pub type Shapes = &'static [(&'static str, f32)];

/// The visemes of English, after the groups of MPEG-4 (ISO/IEC 14496-2): p b m, where the lips close over an open jaw;
/// f v, where the lower lip is below the upper teeth; th; t d; k g; sh ch j; s z; n l; r; a; e i; o; u w.
const VISEMES: [Shapes; 13] = [
    &[("jawOpen", 0.2), ("mouthClose", 0.19), ("mouthPress", 0.3), ("mouthRollUpper", 0.25), ("mouthRollLower", 0.3)],
    &[("jawOpen", 0.1), ("mouthRollLower", 0.5), ("mouthUpperUp", 0.2), ("mouthShrugLower", 0.15)],
    &[("jawOpen", 0.2), ("mouthLowerDown", 0.3), ("mouthUpperUp", 0.15), ("mouthFunnel", 0.1)],
    &[("jawOpen", 0.12), ("mouthLowerDown", 0.25), ("mouthStretch", 0.2), ("mouthShrugUpper", 0.2)],
    &[("jawOpen", 0.25), ("mouthLowerDown", 0.3), ("mouthStretch", 0.2), ("mouthUpperUp", 0.2)],
    &[("jawOpen", 0.08), ("mouthFunnel", 0.5), ("mouthShrugUpper", 0.35), ("mouthPucker", 0.3), ("jawForward", 0.2)],
    &[("jawOpen", 0.04), ("mouthStretch", 0.35), ("mouthLowerDown", 0.4), ("mouthUpperUp", 0.2), ("mouthDimple", 0.15)],
    &[("jawOpen", 0.18), ("mouthLowerDown", 0.3), ("mouthUpperUp", 0.2), ("mouthShrugUpper", 0.15)],
    &[("jawOpen", 0.12), ("mouthFunnel", 0.35), ("mouthPucker", 0.3), ("mouthShrugUpper", 0.2)],
    &[("jawOpen", 0.55), ("mouthLowerDown", 0.35), ("mouthUpperUp", 0.2), ("mouthStretch", 0.15)],
    &[("jawOpen", 0.2), ("mouthSmile", 0.25), ("mouthStretch", 0.35), ("mouthDimple", 0.2), ("mouthLowerDown", 0.35)],
    &[("jawOpen", 0.4), ("mouthFunnel", 0.55), ("mouthPucker", 0.35), ("mouthLowerDown", 0.15)],
    &[("jawOpen", 0.12), ("mouthPucker", 0.75), ("mouthFunnel", 0.3), ("mouthShrugLower", 0.15)],
];

/// Mouths that put out a tongue: wide open, as in recordings; half open; nearly closed; round; and with a smile.
const TONGUE_MOUTHS: [Shapes; 5] = [
    &[("jawOpen", 0.65), ("mouthStretch", 0.5), ("mouthLowerDown", 0.43), ("mouthShrugUpper", 0.37)],
    &[("jawOpen", 0.4), ("mouthLowerDown", 0.3), ("mouthStretch", 0.2), ("mouthUpperUp", 0.1)],
    &[("jawOpen", 0.2), ("mouthLowerDown", 0.15), ("mouthShrugUpper", 0.15)],
    &[("jawOpen", 0.25), ("mouthFunnel", 0.35), ("mouthPucker", 0.35), ("mouthLowerDown", 0.15)],
    &[("jawOpen", 0.25), ("mouthSmile", 0.5), ("mouthUpperUp", 0.2), ("mouthLowerDown", 0.2)],
];

static FACES: LazyLock<[Coefficients; VISEMES.len()]> = LazyLock::new(|| VISEMES.map(face));

fn face(shapes: Shapes) -> Coefficients {
    let mut face = [0.0; COEFFS];
    for (stem, strength) in shapes {
        for ending in ["", "Left", "Right"] {
            if let Some(index) = find(&format!("{stem}{ending}")) {
                face[index] = *strength;
            }
        }
    }
    face
}

pub fn spoken(rng: &mut ChaCha8Rng) -> Coefficients {
    let [one, other] = core::array::from_fn(|_| FACES.choose(rng).copied().unwrap_or([0.0; COEFFS]));
    let share: f32 = rng.random();
    core::array::from_fn(|index| (share * one[index] + (1.0 - share) * other[index]) * rng.random_range(ARTICULATION))
}
