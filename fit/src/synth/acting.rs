//! Random expressions: faces of recordings and faces composed of them, speech, grimaces, few shapes, and rest.

use clap::ValueEnum;
use facewire::solve::COEFFS;
use rand::{RngExt, seq::IteratorRandom};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, weighted::WeightedIndex};

use super::{
    anatomy::{Partner, constrain, open_for_closed_lips},
    composing::Moments,
    expression::Coefficients,
};

/// Largest factor on the recorded frame that is added to a single shape.
const TRACE: f32 = 0.15;
/// Probability that the partner of a random shape moves, too, and the factor on its strength.
const PAIRED: f64 = 0.6;
const PARTNER_SCALE: core::ops::Range<f32> = 0.7..1.3;
/// Number of shapes that are added to a composed face, and that a grimace consists of.
const ADDED: core::ops::RangeInclusive<usize> = 1..=4;
const GRIMACE: core::ops::RangeInclusive<usize> = 6..=16;

/// A kind of expression.
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
    /// No expression, to teach what turning the head alone looks like
    Rest,
}

impl Kind {
    /// Returns the name on the command line.
    pub fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// A kind of expression with its relative frequency.
pub type Share = (Kind, f32);

/// Draws random expressions.
pub struct Expressions {
    moments: Moments,
    kinds: Vec<Kind>,
    frequencies: WeightedIndex<f32>,
    /// Shapes that may be shown alone, or all if empty.
    shapes: Vec<usize>,
}

impl Expressions {
    /// Returns a sampler of a mixture of kinds, of which at least one needs a positive frequency.
    pub fn new(moments: Moments, mix: &[Share], shapes: Vec<usize>) -> anyhow::Result<Self> {
        let frequencies = WeightedIndex::new(mix.iter().map(|(_, share)| *share))?;
        Ok(Self { moments, kinds: mix.iter().map(|(kind, _)| *kind).collect(), frequencies, shapes })
    }

    /// Returns the recorded frames.
    pub fn frames(&self) -> &[Coefficients] {
        self.moments.frames()
    }

    /// Returns a random expression.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> Coefficients {
        let mut face = match self.kinds[self.frequencies.sample(rng)] {
            Kind::Recorded => self.moments.recorded(rng),
            Kind::Composed => self.composed(rng),
            Kind::Speech => self.moments.speech(rng),
            Kind::Grimace => paired(rng),
            Kind::Single => self.single(rng),
            Kind::Combined => combined(rng),
            Kind::Halves => self.moments.halves(rng),
            Kind::Rest => [0.0; COEFFS],
        };
        constrain(rng, &mut face);
        face
    }

    fn composed(&self, rng: &mut ChaCha8Rng) -> Coefficients {
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

/// Returns any shape but the tongue, which is the last.
fn any_shape(rng: &mut ChaCha8Rng) -> usize {
    rng.random_range(0..COEFFS - 1)
}

/// Raises a shape to a strength, and mostly its partner, too.
fn raise(rng: &mut ChaCha8Rng, face: &mut Coefficients, index: usize, strength: f32) {
    let mut raise_to = |index: usize, strength: f32| face[index] = face[index].max(strength);
    raise_to(index, strength);
    match Partner::of(index) {
        Some(partner) if partner.fixed => raise_to(partner.index, strength),
        Some(partner) if rng.random_bool(PAIRED) => raise_to(partner.index, strength * rng.random_range(PARTNER_SCALE)),
        _ => {}
    }
}

fn paired(rng: &mut ChaCha8Rng) -> Coefficients {
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

#[cfg(test)]
mod tests {
    use facewire::solve::BLENDSHAPES;
    use rand_chacha::rand_core::SeedableRng;

    use super::*;
    use crate::synth::anatomy::index_of;

    fn expressions(kinds: &[Kind], shapes: &[&str]) -> Expressions {
        let mix: Vec<Share> = kinds.iter().map(|kind| (*kind, 1.0)).collect();
        let recording = (0..200_u16).map(|frame| [f32::from(frame) / 200.0; COEFFS]).collect();
        let shapes = shapes.iter().map(|name| index_of(name)).collect();
        Expressions::new(Moments::new(&[recording]), &mix, shapes).expect("a mixture")
    }

    fn drawn(kinds: &[Kind], count: usize) -> Vec<Coefficients> {
        let (mut rng, expressions) = (ChaCha8Rng::seed_from_u64(5), expressions(kinds, &[]));
        (0..count).map(|_| expressions.draw(&mut rng)).collect()
    }

    #[test]
    fn coefficients_are_bounded_and_lips_close_no_further_than_the_jaw_is_open() {
        let (close, open, tongue) = (index_of("mouthClose"), index_of("jawOpen"), index_of("tongueOut"));
        for kind in Kind::value_variants() {
            for face in drawn(&[*kind], 300) {
                assert!(face.iter().all(|value| (0.0..=1.0).contains(value)), "{kind:?}");
                assert!(face[close] <= face[open] && face[tongue] == 0.0, "{kind:?}");
            }
        }
    }

    #[test]
    fn every_shape_but_the_tongue_is_drawn_strong_and_weak() {
        for kinds in [&[Kind::Single, Kind::Combined][..], &[Kind::Grimace]] {
            let faces = drawn(kinds, 4000);
            for index in 0..COEFFS - 1 {
                let [strong, weak] = [0.6..1.1, 0.01..0.4].map(|range: core::ops::Range<f32>| {
                    faces.iter().filter(|face| range.contains(&face[index])).count()
                });
                assert!(strong > 20 && weak > 20, "{} {strong} {weak}", BLENDSHAPES[index]);
            }
        }
    }

    #[test]
    fn only_chosen_shapes_are_shown_alone() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (puff, open) = (index_of("cheekPuff"), index_of("jawOpen"));
        let rest = vec![[0.0; COEFFS]];
        let expressions =
            Expressions::new(Moments::new(&[rest]), &[(Kind::Single, 1.0)], vec![puff, open]).expect("a mixture");
        for _ in 0..200 {
            let face = expressions.draw(&mut rng);
            assert!(face.iter().enumerate().all(|(index, value)| *value == 0.0 || [puff, open].contains(&index)));
        }
    }

    #[test]
    fn rest_moves_nothing() {
        assert!(drawn(&[Kind::Rest], 3).iter().flatten().all(|value| *value == 0.0));
    }

    #[test]
    fn kinds_are_drawn_as_often_as_the_mixture_says() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let mix = [(Kind::Rest, 3.0), (Kind::Recorded, 1.0), (Kind::Grimace, 0.0)];
        let expressions = Expressions::new(Moments::new(&[vec![[0.5; COEFFS]]]), &mix, Vec::new()).expect("a mixture");
        let rests = (0..2000).filter(|_| expressions.draw(&mut rng).iter().all(|value| *value == 0.0)).count();
        assert!((1400..1600).contains(&rests), "{rests}");
    }
}
