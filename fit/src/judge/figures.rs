//! The figures of people: sums of the errors of one person's estimates for each blendshape, from which the figures of any
//! group follow; and what they are for each blendshape, for all together, and for the average person.

use std::ops::AddAssign;

use facewire_face::COEFFS;
use nalgebra::{Vector2, Vector3, vector};
use rayon::prelude::*;

use super::gaze::GazeSums;
use crate::curves::MOVING;
use crate::shapes::MODELLED;
use crate::statistics::{Interval, Moments, draw, jitter_at_rest, mean};

/// A blendshape is at rest in the pictures in which its true coefficient is at most this, and moves in the others.
pub const REST: f64 = 0.02;
const LEAST_PICTURES: f64 = 10.0;

/// Which pictures count: all, those in which the blendshape is at rest, or those in which it moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    All,
    AtRest,
    Moving,
}

impl Phase {
    pub const ALL: [Self; 3] = [Self::All, Self::AtRest, Self::Moving];

    pub fn name(self) -> &'static str {
        ["all", "at_rest", "moving"][self as usize]
    }

    pub fn title(self) -> String {
        self.name().replace('_', " ")
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    R,
    Mse,
    Bias,
    /// Standard deviation of the estimates divided by that of the truth.
    Gain,
    Slope,
    /// Part of the error that subtracting each person's mean error would remove.
    MseOfBias,
    /// Part of the error that each person's best factor would remove after that.
    MseOfGain,
    MseOfRest,
    /// Root mean square of the steps from frame to frame while the truth rests. Films only.
    Jitter,
    /// Mean coefficient of faces that are at rest as a whole, without the neutral pictures.
    Resting,
}

impl Figure {
    /// The figures in order, with their names in files and their decimals.
    const TABLE: [(Self, &str, usize); 10] = [
        (Self::R, "r", 3),
        (Self::Mse, "mse", 4),
        (Self::Bias, "bias", 3),
        (Self::Gain, "gain", 2),
        (Self::Slope, "slope", 2),
        (Self::MseOfBias, "mse_of_bias", 4),
        (Self::MseOfGain, "mse_of_gain", 4),
        (Self::MseOfRest, "mse_of_rest", 4),
        (Self::Jitter, "jitter", 4),
        (Self::Resting, "resting", 3),
    ];

    pub fn all() -> [Self; Self::TABLE.len()] {
        Self::TABLE.map(|(figure, ..)| figure)
    }

    pub fn name(self) -> &'static str {
        Self::TABLE[self as usize].1
    }

    pub fn decimals(self) -> usize {
        Self::TABLE[self as usize].2
    }

    pub fn format(self, value: f64) -> String {
        if self == Self::Bias { self.signed(value) } else { crate::output::number(Some(value), self.decimals()) }
    }

    pub fn signed(self, value: f64) -> String {
        if value.is_finite() { format!("{value:+.*}", self.decimals()) } else { "-".to_owned() }
    }
}

pub type Figures = [f64; Figure::TABLE.len()];
type Phases<T> = [T; Phase::ALL.len()];

/// The pictures or frames of one person, in order: for each the estimates and the truth of all blendshapes.
#[derive(Debug, Clone, Default)]
pub struct SolvedFaces {
    pub estimates: Vec<[f64; COEFFS]>,
    pub truths: Vec<[f64; COEFFS]>,
    /// Whether the person's neutral face was taken from this picture. Then it cannot show how well rest is recognised.
    pub is_neutral: Vec<bool>,
    /// The true yaw of the head.
    pub head_yaw_deg: Vec<f64>,
}

#[derive(Debug, Clone)]
pub struct Person {
    pub name: String,
    sums: Vec<Phases<ErrorSums>>,
    figures: Vec<Phases<Figures>>,
    /// Means over the blendshapes that this person moves; of jitter and the mean coefficient at rest, over all.
    pub averages: Phases<Figures>,
    pub gaze: GazeSums,
}

#[derive(Debug, Clone, Copy, Default)]
struct ErrorSums {
    moments: Moments,
    /// The parts of each person's error, weighted by the number of pictures.
    parts: Vector3<f64>,
    jitter: Vector2<f64>,
    /// Coefficients of faces that are at rest as a whole, and the number of these faces.
    resting: Vector2<f64>,
}

impl Person {
    /// Sums up the pictures of a person. Frames of a film follow each other in time, so that they have jitter.
    pub fn new(name: String, faces: &SolvedFaces, is_film: bool) -> Self {
        let rests = |row: usize| !faces.is_neutral[row] && faces.truths[row].iter().all(|truth| *truth == 0.0);
        let resting: Vec<bool> = (0..faces.truths.len()).map(rests).collect();
        let sums: Vec<_> = (0..COEFFS).map(|shape| error_sums(faces, shape, &resting, is_film)).collect();
        let figures: Vec<Phases<Figures>> = sums.iter().map(|phases| phases.map(|sums| sums.figures())).collect();
        let averages = Phase::ALL.map(|phase| {
            let all = || figures[..MODELLED].iter().map(|own| own[phase as usize]);
            let moves = sums.iter().map(|sums| sums[Phase::All as usize].moves());
            let moving = mean_of(&all().zip(moves).filter(|(_, moves)| *moves).map(|(own, _)| own));
            let shown = mean_of(&all());
            Figure::all().map(|figure| match figure {
                Figure::Jitter | Figure::Resting => shown[figure as usize],
                _ => moving[figure as usize],
            })
        });
        Self { name, sums, figures, averages, gaze: GazeSums::new(faces) }
    }

    pub fn figures(&self, blendshape: usize, phase: Phase) -> &Figures {
        &self.figures[blendshape][phase as usize]
    }
}

fn error_sums(faces: &SolvedFaces, blendshape: usize, resting: &[bool], is_film: bool) -> Phases<ErrorSums> {
    let mut phases = Phases::<ErrorSums>::default();
    let pairs = faces.estimates.iter().zip(&faces.truths).map(|(a, b)| (a[blendshape], b[blendshape]));
    for ((estimate, truth), rests) in pairs.clone().zip(resting) {
        let own = if truth > REST { Phase::Moving } else { Phase::AtRest };
        for phase in [Phase::All, own] {
            let sums = &mut phases[phase as usize];
            sums.moments.add(estimate, truth);
            if *rests {
                sums.resting += vector![estimate.abs(), 1.0];
            }
        }
    }
    if is_film {
        let (estimates, truths): (Vec<f64>, Vec<f64>) = pairs.unzip();
        let jitter = jitter_at_rest(&estimates, &truths).map_or(Vector2::zeros(), |jitter| vector![jitter, 1.0]);
        phases[Phase::All as usize].jitter = jitter;
    }
    for sums in phases.iter_mut().filter(|sums| sums.moments.count > 0.0) {
        sums.parts = sums.moments.count * sums.moments.error_parts();
    }
    phases
}

impl ErrorSums {
    fn moves(&self) -> bool {
        self.moments.truth_deviation() > MOVING
    }

    pub fn figures(&self) -> Figures {
        let (moments, count) = (&self.moments, self.moments.count);
        let shows_motion = self.moves() && count >= LEAST_PICTURES;
        Figure::all().map(|figure| match figure {
            Figure::R | Figure::Gain | Figure::Slope if !shows_motion => f64::NAN,
            Figure::R => moments.pearson(),
            Figure::Mse => moments.mse(),
            Figure::Bias => moments.bias(),
            Figure::Gain => moments.gain(),
            Figure::Slope => moments.slope(),
            Figure::MseOfBias => self.parts[0] / count,
            Figure::MseOfGain => self.parts[1] / count,
            Figure::MseOfRest => self.parts[2] / count,
            Figure::Jitter => self.jitter[0] / self.jitter[1],
            Figure::Resting => self.resting[0] / self.resting[1],
        })
    }
}

impl AddAssign<&ErrorSums> for ErrorSums {
    fn add_assign(&mut self, other: &Self) {
        self.moments += other.moments;
        self.parts += other.parts;
        self.jitter += other.jitter;
        self.resting += other.resting;
    }
}

fn mean_of(figures: &(impl Iterator<Item = Figures> + Clone)) -> Figures {
    core::array::from_fn(|index| {
        let values: Vec<f64> = figures.clone().map(|own| own[index]).filter(|value| value.is_finite()).collect();
        if values.is_empty() { f64::NAN } else { mean(values.into_iter()) }
    })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Row {
    Blendshape(usize),
    /// The mean of the rows of all blendshapes that landmarks show, or that move if the figure needs motion.
    Blendshapes,
    /// The mean of the people, where a person's figures are the mean over the blendshapes that the person moves.
    People,
}

impl Row {
    pub fn all() -> impl Iterator<Item = Self> {
        (0..COEFFS).map(Self::Blendshape).chain([Self::Blendshapes, Self::People])
    }

    fn index(self) -> usize {
        match self {
            Self::Blendshape(index) => index,
            Self::Blendshapes => COEFFS,
            Self::People => COEFFS + 1,
        }
    }
}

pub struct Judgement {
    pub people: Vec<Person>,
    figures: Vec<Phases<Figures>>,
    draws: Vec<Vec<Phases<Figures>>>,
}

impl Judgement {
    pub fn new(people: Vec<Person>, resamples: u64) -> Self {
        let everybody: Vec<usize> = (0..people.len()).collect();
        let figures = figures_of(&people, &everybody);
        let resample = |number| figures_of(&people, &draw(number, people.len()));
        let draws = (0..resamples).into_par_iter().map(resample).collect();
        Self { people, figures, draws }
    }

    pub fn get(&self, row: Row, phase: Phase, figure: Figure) -> f64 {
        self.figures[row.index()][phase as usize][figure as usize]
    }

    pub fn interval(&self, row: Row, phase: Phase, figure: Figure) -> Interval {
        Interval::of(self.draws.iter().map(|draw| draw[row.index()][phase as usize][figure as usize]))
    }

    /// Returns a figure minus that of `other`, which judges the same people, and its interval over the same draws.
    pub fn difference(&self, other: &Self, row: Row, phase: Phase, figure: Figure) -> (f64, Interval) {
        let value = |figures: &[Phases<Figures>]| figures[row.index()][phase as usize][figure as usize];
        let pairs = self.draws.iter().zip(&other.draws);
        let interval = Interval::of(pairs.map(|(own, other)| value(own) - value(other)));
        (value(&self.figures) - value(&other.figures), interval)
    }

    pub fn pictures(&self) -> f64 {
        self.people.iter().map(|person| person.sums[0][Phase::All as usize].moments.count).sum()
    }

    pub fn moves(&self, row: Row) -> bool {
        !self.get(row, Phase::All, Figure::R).is_nan()
    }
}

/// Returns the figures of each row for the people with these indices. An index may occur several times.
fn figures_of(people: &[Person], indices: &[usize]) -> Vec<Phases<Figures>> {
    let together = |shape: usize, phase: Phase| {
        let mut sum = ErrorSums::default();
        indices.iter().for_each(|index| sum += &people[*index].sums[shape][phase as usize]);
        sum.figures()
    };
    let mut rows: Vec<_> = (0..COEFFS).map(|shape| Phase::ALL.map(|phase| together(shape, phase))).collect();
    let shown = Phase::ALL.map(|phase| mean_of(&rows[..MODELLED].iter().map(|row| row[phase as usize])));
    let person = Phase::ALL.map(|phase| mean_of(&indices.iter().map(|index| people[*index].averages[phase as usize])));
    rows.extend([shown, person]);
    rows
}

pub struct Judged {
    pub set: String,
    /// Facts about the set itself, such as the number of frames without a face.
    pub notes: String,
    pub neutral: [Rivals; 2],
}

pub struct Rivals {
    pub model: Judgement,
    pub against: Option<Judgement>,
}

pub const NEUTRAL: [&str; 2] = ["neutral face known", "neutral face not known"];
