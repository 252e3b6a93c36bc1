//! The figures of a group of people: of each blendshape, of all blendshapes together, and of the average person.

use facewire::solve::COEFFS;
use rayon::prelude::*;

use super::people::{Person, Phase, Tally};
use crate::statistics::{Interval, draw, mean, standard_deviation};

/// The number of figures.
pub const FIGURES: usize = Figure::ALL.len();
/// Figures in the order of [`Figure::ALL`]. One that is not defined is not a number.
pub type Figures = [f64; FIGURES];
/// The blendshapes that landmarks show: all but the last one, `tongueOut`.
const SHOWN: usize = COEFFS - 1;

/// A figure of merit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// Pearson's correlation.
    R,
    /// Mean squared error.
    Mse,
    /// Mean error, estimate minus truth.
    Bias,
    /// Standard deviation of the estimates divided by that of the truth.
    Gain,
    /// Slope of the straight line through the estimates over the truth.
    Slope,
    /// Part of the error that subtracting each person's mean error would remove.
    MseOfBias,
    /// Part of the error that each person's best factor would remove after that.
    MseOfGain,
    /// The other part of the error.
    MseOfRest,
    /// Root mean square of the steps from frame to frame while the truth rests. Films only.
    Jitter,
    /// Mean coefficient of faces that are at rest as a whole, without the neutral pictures.
    Resting,
}

impl Figure {
    /// All figures.
    pub const ALL: [Self; 10] = [
        Self::R,
        Self::Mse,
        Self::Bias,
        Self::Gain,
        Self::Slope,
        Self::MseOfBias,
        Self::MseOfGain,
        Self::MseOfRest,
        Self::Jitter,
        Self::Resting,
    ];

    /// The name in files.
    pub fn name(self) -> &'static str {
        let names =
            ["r", "mse", "bias", "gain", "slope", "mse_of_bias", "mse_of_gain", "mse_of_rest", "jitter", "resting"];
        names[self as usize]
    }
}

/// A row of a sheet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Row {
    /// A blendshape, by its index: all pictures of all people together.
    Blendshape(usize),
    /// The mean of the blendshapes' rows: of all that landmarks show, or for figures that need motion, of those that
    /// move.
    Blendshapes,
    /// The mean of the people, where a person's figures are the mean over the blendshapes that the person moves.
    People,
}

impl Row {
    fn index(self) -> usize {
        match self {
            Self::Blendshape(index) => index,
            Self::Blendshapes => COEFFS,
            Self::People => COEFFS + 1,
        }
    }
}

/// All figures of a group of people.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet(Vec<[Figures; Phase::ALL.len()]>);

impl Sheet {
    /// Returns the figures of the people with these indices. An index may occur several times.
    fn of(people: &[Person], averages: &[[Figures; Phase::ALL.len()]], indices: &[usize]) -> Self {
        let blendshape = |shape: usize| Phase::ALL.map(|phase| together(people, indices, shape, phase));
        let mut rows: Vec<_> = (0..COEFFS).map(blendshape).collect();
        let shown = Phase::ALL.map(|phase| mean_of(&rows[..SHOWN].iter().map(|row| row[phase as usize])));
        let person = Phase::ALL.map(|phase| mean_of(&indices.iter().map(|index| averages[*index][phase as usize])));
        rows.extend([shown, person]);
        Self(rows)
    }

    /// Returns a figure.
    pub fn get(&self, row: Row, phase: Phase, figure: Figure) -> f64 {
        self.0[row.index()][phase as usize][figure as usize]
    }
}

/// Returns the figures of all pictures of these people together.
fn together(people: &[Person], indices: &[usize], shape: usize, phase: Phase) -> Figures {
    let mut sum = Tally::default();
    for index in indices {
        sum += people[*index].tally(shape, phase);
    }
    sum.figures()
}

/// Returns the mean of each figure over those that are defined.
fn mean_of(figures: &(impl Iterator<Item = Figures> + Clone)) -> Figures {
    core::array::from_fn(|index| defined_mean(figures.clone().map(|figures| figures[index])))
}

/// Returns the mean of the values that are numbers, or not a number if none is.
fn defined_mean(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    if values.is_empty() { f64::NAN } else { mean(values.into_iter()) }
}

/// Returns a person's mean figures over the blendshapes that this person moves. The jitter and the mean coefficient at
/// rest are means over all blendshapes.
pub fn average(person: &Person) -> [Figures; Phase::ALL.len()] {
    Phase::ALL.map(|phase| {
        let all = || (0..SHOWN).map(|shape| (shape, person.figures(shape, phase)));
        let moving = mean_of(&all().filter(|(shape, _)| person.moves(*shape)).map(|(_, figures)| *figures));
        let shown = mean_of(&all().map(|(_, figures)| *figures));
        Figure::ALL.map(|figure| match figure {
            Figure::Jitter | Figure::Resting => shown[figure as usize],
            _ => moving[figure as usize],
        })
    })
}

/// The figures of a group of people with their uncertainty.
#[derive(Debug, Clone)]
pub struct Judgement {
    /// The people.
    pub people: Vec<Person>,
    /// The mean figures of each person.
    pub averages: Vec<[Figures; Phase::ALL.len()]>,
    /// The figures of all of them.
    pub sheet: Sheet,
    /// The figures of each draw of people.
    draws: Vec<Sheet>,
}

impl Judgement {
    /// Computes all figures, and again for each of `resamples` draws of people.
    pub fn new(people: Vec<Person>, resamples: u64) -> Self {
        let averages: Vec<_> = people.iter().map(average).collect();
        let everybody: Vec<usize> = (0..people.len()).collect();
        let sheet = Sheet::of(&people, &averages, &everybody);
        let resample = |number| Sheet::of(&people, &averages, &draw(number, people.len()));
        let draws = (0..resamples).into_par_iter().map(resample).collect();
        Self { people, averages, sheet, draws }
    }

    /// Returns the confidence interval of a figure.
    pub fn interval(&self, row: Row, phase: Phase, figure: Figure) -> Interval {
        Interval::of(self.draws.iter().map(|sheet| sheet.get(row, phase, figure)))
    }

    /// Returns how much higher a figure is than in `other`, which judges the same people, with the confidence interval of
    /// the difference. Both are compared on the same draws.
    pub fn difference(&self, other: &Self, row: Row, phase: Phase, figure: Figure) -> (f64, Interval) {
        let value = |sheet: &Sheet| sheet.get(row, phase, figure);
        let pairs = self.draws.iter().zip(&other.draws);
        let interval = Interval::of(pairs.map(|(own, other)| value(own) - value(other)));
        (value(&self.sheet) - value(&other.sheet), interval)
    }

    /// Returns mean and standard deviation over the people of a blendshape's figure. Only people who move the blendshape
    /// count.
    pub fn spread(&self, shape: usize, phase: Phase, figure: Figure) -> [f64; 2] {
        let moving = self.people.iter().filter(|person| person.moves(shape));
        let values: Vec<f64> = moving.map(|person| person.figures(shape, phase)[figure as usize]).collect();
        let values: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
        if values.is_empty() { [f64::NAN; 2] } else { [mean(values.iter().copied()), standard_deviation(&values)] }
    }

    /// Returns the number of pictures.
    pub fn pictures(&self) -> f64 {
        self.people.iter().map(Person::pictures).sum()
    }

    /// Returns the number of blendshapes that move.
    pub fn moving(&self) -> usize {
        let moves = |shape: &usize| !self.sheet.get(Row::Blendshape(*shape), Phase::All, Figure::R).is_nan();
        (0..SHOWN).filter(moves).count()
    }
}

/// The rows in the order in which they are shown.
pub fn rows() -> impl Iterator<Item = Row> {
    (0..COEFFS).map(Row::Blendshape).chain([Row::Blendshapes, Row::People])
}

#[cfg(test)]
mod tests {
    use super::{super::people::tests::person, *};

    fn judged(errors: &[f64]) -> Judgement {
        let people = errors.iter().map(|error| person("one", |truth| truth + error));
        Judgement::new(people.collect(), 400)
    }

    #[test]
    fn a_better_model_is_certain_although_people_differ_more_than_the_models() {
        let hard: Vec<f64> = (0..20).map(|person| 0.1 + 0.02 * f64::from(person)).collect();
        let better: Vec<f64> = hard.iter().map(|error| error - 0.005).collect();
        let [a, b] = [judged(&hard), judged(&better)];
        let place = (Row::Blendshapes, Phase::All, Figure::Mse);
        let (difference, interval) = b.difference(&a, place.0, place.1, place.2);
        assert!(difference < 0.0 && interval.high < 0.0 && interval.excludes_zero(), "{difference} {interval:?}");
        let [own, other] = [&b, &a].map(|judged| judged.interval(place.0, place.1, place.2));
        assert!(own.high > other.low, "the intervals of both models overlap");
    }

    #[test]
    fn equal_models_differ_by_nothing_and_few_people_have_wide_intervals() {
        let many: Vec<f64> = (0..40).map(|person| 0.01 * f64::from(person)).collect();
        let few: Vec<f64> = (0..4).map(|person| 0.1 * f64::from(person)).collect();
        let [many, few] = [judged(&many), judged(&few)];
        let place = (Row::People, Phase::All, Figure::Bias);
        let (difference, interval) = many.difference(&many, place.0, place.1, place.2);
        assert!(difference.abs() < 1e-12 && !interval.excludes_zero());
        let [many, few] = [&many, &few].map(|judged| judged.interval(place.0, place.1, place.2).half_width());
        assert!(few > 2.0 * many, "{few} {many}");
    }

    #[test]
    fn spread_is_that_of_the_people() {
        let judged = judged(&[0.1, 0.3]);
        let [mean, deviation] = judged.spread(3, Phase::All, Figure::Bias);
        assert!((mean - 0.2).abs() < 1e-9 && (deviation - 0.02_f64.sqrt()).abs() < 1e-9);
        assert!(judged.moving() == 51 && (judged.pictures() - 120.0).abs() < 1e-9);
    }
}
