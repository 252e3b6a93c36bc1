//! The errors of one person's estimates: sums for each blendshape, from which the figures of any group of people
//! follow.

use std::ops::AddAssign;

use facewire::solve::COEFFS;

use super::sheet::{Figure, Figures};
use crate::{
    curves::MOVING,
    statistics::{ErrorParts, Moments, jitter_at_rest},
};

/// A blendshape is at rest in the pictures in which its true coefficient is at most this, and moves in the others.
pub const REST: f64 = 0.02;

/// Fewest pictures for a correlation, gain or slope.
const LEAST_PICTURES: f64 = 10.0;

/// Which pictures count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// All pictures.
    All,
    /// Those in which the blendshape is at rest.
    AtRest,
    /// Those in which it moves.
    Moving,
}

impl Phase {
    /// All phases.
    pub const ALL: [Self; 3] = [Self::All, Self::AtRest, Self::Moving];

    /// The name in files.
    pub fn name(self) -> &'static str {
        ["all", "at_rest", "moving"][self as usize]
    }

    /// The name in tables.
    pub fn title(self) -> &'static str {
        ["all", "at rest", "moving"][self as usize]
    }
}

/// The pictures or frames of one person, in order: for each the estimates and the truth of all blendshapes.
#[derive(Debug, Clone, Default)]
pub struct SolvedFaces {
    /// The estimated coefficients.
    pub estimates: Vec<[f64; COEFFS]>,
    /// The true coefficients.
    pub truths: Vec<[f64; COEFFS]>,
    /// Whether the person's neutral face was taken from this picture. Then it cannot show how well rest is recognised.
    pub is_neutral: Vec<bool>,
}

/// One person.
#[derive(Debug, Clone)]
pub struct Person {
    /// The subject's number, or the clip's name.
    pub name: String,
    /// For each blendshape, a tally of each phase.
    tallies: Vec<[Tally; Phase::ALL.len()]>,
    /// The figures that belong to `tallies`.
    figures: Vec<[Figures; Phase::ALL.len()]>,
}

/// Sums over pictures. Sums of several people can be added.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tally {
    moments: Moments,
    /// The parts of each person's error, weighted by the number of pictures.
    parts: ErrorParts,
    /// Jitter of each person, and the number of people who have it.
    jitter: [f64; 2],
    /// Coefficients of faces that are at rest as a whole, and the number of these faces.
    resting: [f64; 2],
}

impl Person {
    /// Sums up the pictures of a person. Frames of a film follow each other in time, so that they have jitter.
    pub fn new(name: String, faces: &SolvedFaces, is_film: bool) -> Self {
        let resting: Vec<bool> = (0..faces.truths.len()).map(|row| faces.rests(row)).collect();
        let tally = |blendshape| phases(faces, blendshape, &resting, is_film);
        let tallies: Vec<_> = (0..COEFFS).map(tally).collect();
        let figures = tallies.iter().map(|phases| phases.map(|tally| tally.figures())).collect();
        Self { name, tallies, figures }
    }

    /// Returns the sums of a blendshape.
    pub fn tally(&self, blendshape: usize, phase: Phase) -> &Tally {
        &self.tallies[blendshape][phase as usize]
    }

    /// Returns the figures of a blendshape.
    pub fn figures(&self, blendshape: usize, phase: Phase) -> &Figures {
        &self.figures[blendshape][phase as usize]
    }

    /// Returns whether a blendshape moves enough for a correlation.
    pub fn moves(&self, blendshape: usize) -> bool {
        self.tally(blendshape, Phase::All).moves()
    }

    /// Returns the number of pictures.
    pub fn pictures(&self) -> f64 {
        self.tally(0, Phase::All).moments.count()
    }
}

impl SolvedFaces {
    fn rests(&self, row: usize) -> bool {
        !self.is_neutral[row] && self.truths[row].iter().all(|truth| *truth == 0.0)
    }
}

fn phases(faces: &SolvedFaces, blendshape: usize, resting: &[bool], is_film: bool) -> [Tally; Phase::ALL.len()] {
    let mut phases = [Tally::default(); Phase::ALL.len()];
    let pairs = faces.estimates.iter().zip(&faces.truths).map(|(a, b)| (a[blendshape], b[blendshape]));
    for ((estimate, truth), rests) in pairs.clone().zip(resting) {
        let own = if truth > REST { Phase::Moving } else { Phase::AtRest };
        for phase in [Phase::All, own] {
            let tally = &mut phases[phase as usize];
            tally.moments.add(estimate, truth);
            if *rests {
                tally.resting = [tally.resting[0] + estimate.abs(), tally.resting[1] + 1.0];
            }
        }
    }
    if is_film {
        let (estimates, truths): (Vec<f64>, Vec<f64>) = pairs.unzip();
        let jitter = jitter_at_rest(&estimates, &truths).map_or([0.0; 2], |jitter| [jitter, 1.0]);
        phases[Phase::All as usize].jitter = jitter;
    }
    for tally in &mut phases {
        let (parts, count) = (tally.moments.error_parts(), tally.moments.count());
        if count > 0.0 {
            tally.parts = ErrorParts { bias: count * parts.bias, gain: count * parts.gain, rest: count * parts.rest };
        }
    }
    phases
}

impl Tally {
    /// Returns whether the truth moves enough for a correlation.
    pub fn moves(&self) -> bool {
        self.moments.truth_deviation() > MOVING
    }

    /// Returns all figures, in the order of [`Figure::ALL`].
    pub fn figures(&self) -> Figures {
        let (moments, count) = (&self.moments, self.moments.count());
        let shows_motion = self.moves() && count >= LEAST_PICTURES;
        Figure::ALL.map(|figure| match figure {
            Figure::R | Figure::Gain | Figure::Slope if !shows_motion => f64::NAN,
            Figure::R => moments.pearson(),
            Figure::Mse => moments.mse(),
            Figure::Bias => moments.bias(),
            Figure::Gain => moments.gain(),
            Figure::Slope => moments.slope(),
            Figure::MseOfBias => self.parts.bias / count,
            Figure::MseOfGain => self.parts.gain / count,
            Figure::MseOfRest => self.parts.rest / count,
            Figure::Jitter => self.jitter[0] / self.jitter[1],
            Figure::Resting => self.resting[0] / self.resting[1],
        })
    }
}

impl AddAssign<&Tally> for Tally {
    fn add_assign(&mut self, other: &Self) {
        self.moments += other.moments;
        self.parts.bias += other.parts.bias;
        self.parts.gain += other.parts.gain;
        self.parts.rest += other.parts.rest;
        self.jitter = [self.jitter[0] + other.jitter[0], self.jitter[1] + other.jitter[1]];
        self.resting = [self.resting[0] + other.resting[0], self.resting[1] + other.resting[1]];
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Returns a person whose blendshapes rest in 20 pictures and move up and down in 40. `estimate` gets the true coefficient.
    pub fn person(name: &str, estimate: impl Fn(f64) -> f64) -> Person {
        let mut faces = SolvedFaces::default();
        for picture in 0..60 {
            let truth = if picture < 20 { 0.0 } else { 0.55 + 0.45 * f64::from(picture).sin() };
            faces.truths.push([truth; COEFFS]);
            faces.estimates.push([estimate(truth); COEFFS]);
            faces.is_neutral.push(picture < 5);
        }
        Person::new(name.to_owned(), &faces, true)
    }

    fn figure(person: &Person, phase: Phase, figure: Figure) -> f64 {
        person.figures(0, phase)[figure as usize]
    }

    #[test]
    fn pictures_at_rest_and_moving_are_judged_apart() {
        let person = person("one", |truth| if truth > REST { truth - 0.1 } else { 0.04 });
        assert!((figure(&person, Phase::AtRest, Figure::Bias) - 0.04).abs() < 1e-9);
        assert!(figure(&person, Phase::AtRest, Figure::R).is_nan());
        assert!((figure(&person, Phase::Moving, Figure::Bias) + 0.1).abs() < 1e-9);
        assert!((figure(&person, Phase::Moving, Figure::Gain) - 1.0).abs() < 1e-9);
        assert!(figure(&person, Phase::All, Figure::Gain) < 1.0 && person.moves(0));
        assert!((figure(&person, Phase::All, Figure::Resting) - 0.04).abs() < 1e-9);
        assert!(figure(&person, Phase::All, Figure::Jitter).abs() < 1e-9);
    }

    #[test]
    fn a_bias_that_differs_between_people_is_a_bias_of_each_of_them() {
        let [low, high] = [-0.1, 0.1].map(|bias| person("one", move |truth| truth + bias));
        let mut both = *low.tally(0, Phase::All);
        both += high.tally(0, Phase::All);
        let figures = both.figures();
        assert!(figures[Figure::Bias as usize].abs() < 1e-9);
        assert!((figures[Figure::MseOfBias as usize] - 0.01).abs() < 1e-9);
        assert!((figures[Figure::Mse as usize] - 0.01).abs() < 1e-9);
    }
}
