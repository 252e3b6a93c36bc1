//! What the mean r hides: the direction of the eyes in degrees, and the size of movements compared with their true size.

use std::ops::AddAssign;

use facewire_face::{BLENDSHAPES, COEFFS};

use super::figures::{Judgement, SolvedFaces};
use crate::curves::LIDS;
use crate::gaze::SHUT;
use crate::output::{Table, number};
use crate::statistics::{LEVELS, Moments, level_of};
use crate::synth::anatomy::Gaze;
use crate::synth::expression::GAZE_DEG;

/// The greatest yaw of the head in each row, degrees. A row begins where the one before ends.
const HEAD_YAW_ENDS_DEG: [f64; 3] = [10.0, 20.0, 90.0];

/// The moments of the angles, and the sum of their errors.
type Axis = (Moments, f64);

/// Sums over the faces of a person.
#[derive(Debug, Clone)]
pub struct GazeSums {
    turns: [[Axis; 2]; HEAD_YAW_ENDS_DEG.len()],
    /// For each blendshape and level of its truth: the sum of the estimates and that of the truth.
    levels: Vec<[[f64; 2]; LEVELS.len()]>,
}

impl Default for GazeSums {
    fn default() -> Self {
        Self { turns: Default::default(), levels: vec![Default::default(); COEFFS] }
    }
}

impl GazeSums {
    pub fn new(faces: &SolvedFaces) -> Self {
        let mut sums = Self::default();
        let pairs = faces.estimates.iter().zip(&faces.truths);
        for ((estimate, truth), yaw_deg) in pairs.zip(&faces.head_yaw_deg) {
            let turn =
                HEAD_YAW_ENDS_DEG.iter().position(|end| yaw_deg.abs() <= *end).unwrap_or(HEAD_YAW_ENDS_DEG.len() - 1);
            if LIDS.iter().all(|lid| truth[*lid] <= SHUT) {
                let [seen, real] = [estimate, truth].map(direction_deg);
                for (axis, (seen, real)) in sums.turns[turn].iter_mut().zip(seen.into_iter().zip(real)) {
                    axis.0.add(seen, real);
                    axis.1 += (seen - real).abs();
                }
            }
            for (levels, (estimate, truth)) in sums.levels.iter_mut().zip(estimate.iter().zip(truth)) {
                let [estimates, truths] = &mut levels[level_of(*truth)];
                *estimates += estimate;
                *truths += truth;
            }
        }
        sums
    }

    pub fn axis(&self, axis: usize, turns: std::ops::Range<usize>) -> Axis {
        let mut sum = Axis::default();
        self.turns[turns].iter().for_each(|turn| add(&mut sum, &turn[axis]));
        sum
    }
}

fn add(sum: &mut Axis, own: &Axis) {
    sum.0 += own.0;
    sum.1 += own.1;
}

/// Returns the direction of both eyes together: to the person's left, and up, in degrees.
fn direction_deg(coefficients: &[f64; COEFFS]) -> [f64; 2] {
    let gaze = Gaze::of(&coefficients.map(|value| value as f32));
    [f64::from(gaze.left * GAZE_DEG[0]), f64::from(gaze.up * GAZE_DEG[1])]
}

impl AddAssign<&GazeSums> for GazeSums {
    fn add_assign(&mut self, other: &Self) {
        self.turns.as_flattened_mut().iter_mut().zip(other.turns.as_flattened()).for_each(|(sum, own)| add(sum, own));
        let sums = self.levels.as_flattened_mut().as_flattened_mut();
        sums.iter_mut().zip(other.levels.as_flattened().as_flattened()).for_each(|(sum, own)| *sum += own);
    }
}

/// Returns the directions of gaze, and the size of movements, of all people together.
pub fn tables(judgement: &Judgement) -> [Table; 2] {
    let mut all = GazeSums::default();
    judgement.people.iter().for_each(|person| all += &person.gaze);
    [directions(judgement, &all), movement_sizes(&all)]
}

fn directions(judgement: &Judgement, all: &GazeSums) -> Table {
    let cells = |(moments, error_deg): Axis| {
        let error = error_deg / moments.count;
        let figures = [(moments.truth_deviation(), 1), (moments.pearson(), 3), (moments.slope(), 2), (error, 1)];
        figures.map(|(value, decimals)| number(Some(value), decimals)).to_vec()
    };
    let mut rows = Vec::new();
    for (axis, name) in ["yaw", "pitch"].into_iter().enumerate() {
        let everywhere = 0..HEAD_YAW_ENDS_DEG.len();
        let error = |(moments, error_deg): Axis| error_deg / moments.count;
        let people = judgement.people.iter().map(|person| person.gaze.axis(axis, everywhere.clone()));
        let seen = people.filter(|(moments, _)| moments.count > 0.0);
        let worst = seen.max_by(|one, other| error(*one).total_cmp(&error(*other))).unwrap_or_default();
        rows.push([vec![name.to_owned()], cells(all.axis(axis, everywhere))].concat());
        for (turn, end) in HEAD_YAW_ENDS_DEG.into_iter().enumerate() {
            let title = format!("{name}, head turned up to {end}");
            rows.push([vec![title], cells(all.axis(axis, turn..turn + 1))].concat());
        }
        rows.push([vec![format!("{name}, worst person")], cells(worst)].concat());
    }
    Table::new(["gaze (degrees)", "deviation of truth", "r", "slope", "mean error"], rows)
}

fn movement_sizes(all: &GazeSums) -> Table {
    let row = |(name, levels): (&&str, &[[f64; 2]; LEVELS.len()])| {
        let ratio = |[estimate, truth]: &[f64; 2]| number((*truth > 0.0).then_some(estimate / truth), 2);
        [(*name).to_owned()].into_iter().chain(levels[1..].iter().map(ratio)).collect::<Vec<_>>()
    };
    let ends = LEVELS[1..].iter().map(|end| format!("truth up to {end}"));
    Table::new(["estimate / truth".to_owned()].into_iter().chain(ends), BLENDSHAPES.iter().zip(&all.levels).map(row))
}
