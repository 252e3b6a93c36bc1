//! Jitter and delay of a filter.

use std::iter::Sum;
use std::ops::Range;

use anyhow::{Context, Result};
use facewire_face::{BLENDSHAPES, COEFFS, Group, HeadPose, Model};

use super::{PARTS, Part};
use crate::judge::set::Clip;
use crate::output::Table;

pub const FPS: f64 = 30.0;
/// Frames at the end of a part at rest whose standard deviation counts: 2 seconds.
const STILL_FRAMES: usize = 60;
/// Most frames by which a curve may follow another one.
const MOST_LAG: usize = 10;
/// Most frames by which noise may make a curve seem to lead.
const MOST_LEAD: usize = 3;
/// A value that moves less in a frame is left out when its delay is measured.
const MOVING: f64 = 0.03;

#[derive(Debug, Clone, Copy, Default)]
pub struct Sums {
    /// Squared deviations at rest, before and after the filter, and their number.
    still: [f64; 3],
    /// Cross-correlations with the truth at each lag, before and after the filter.
    correlations: [[f64; MOST_LEAD + MOST_LAG + 1]; 2],
    /// Frames until the filter returned the value that it was given, and number of such values.
    same_value: [f64; 2],
    /// Squared errors after the filter, and their number.
    errors: [f64; 2],
}

impl Sums {
    /// Measures the jitter at rest and the delay in motion of a curve, given raw, filtered and true.
    pub fn of([raw, filtered, truth]: [&[f64]; 3], still: &[Range<usize>], moving: &[Range<usize>]) -> Self {
        let mut sums = Self::default();
        for frames in still {
            let last = frames.end.saturating_sub(STILL_FRAMES).max(frames.start)..frames.end;
            sums.still[0] += deviations(&raw[last.clone()]);
            sums.still[1] += deviations(&filtered[last.clone()]);
            sums.still[2] += last.len() as f64;
        }
        for frames in moving {
            sums.add_movement([raw, filtered, truth].map(|curve| &curve[frames.clone()]));
        }
        sums
    }

    fn add_movement(&mut self, [raw, filtered, truth]: [&[f64]; 3]) {
        for (correlation, curve) in self.correlations.iter_mut().zip([raw, filtered]) {
            let inner = &truth[MOST_LEAD..truth.len().saturating_sub(MOST_LAG).max(MOST_LEAD)];
            for (lag, sum) in correlation.iter_mut().enumerate() {
                *sum += covariance(&curve[lag..lag + inner.len()], inner);
            }
        }
        for frame in 1..raw.len().saturating_sub(MOST_LAG) {
            if (raw[frame] - raw[frame - 1]).abs() > MOVING {
                let frames = frames_until(raw[frame], &filtered[frame - 1..=frame + MOST_LAG]);
                self.same_value[0] += frames.unwrap_or(0.0);
                self.same_value[1] += f64::from(u8::from(frames.is_some()));
            }
        }
        self.errors[0] += filtered.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        self.errors[1] += filtered.len() as f64;
    }

    pub fn deviations(&self) -> [f64; 2] {
        [self.still[0], self.still[1]].map(|squares| (squares / self.still[2]).sqrt())
    }

    /// Standard deviation at rest after the filter, divided by that before it.
    pub fn jitter(&self) -> f64 {
        let [raw, filtered] = self.deviations();
        if raw > 0.0 { filtered / raw } else { 1.0 }
    }

    /// Delay that the filter adds, by cross-correlation with the truth.
    pub fn lag_ms(&self) -> f64 {
        let [raw, filtered] = self.correlations.map(|correlations| peak(&correlations));
        (filtered - raw) * 1000.0 / FPS
    }

    /// Mean time until the filter returns the value that it was given.
    pub fn same_value_ms(&self) -> f64 {
        self.same_value[0] / self.same_value[1].max(1.0) * 1000.0 / FPS
    }

    pub fn mse(&self) -> f64 {
        self.errors[0] / self.errors[1].max(1.0)
    }
}

impl Sum for Sums {
    fn sum<I: Iterator<Item = Self>>(sums: I) -> Self {
        sums.fold(Self::default(), |mut all, one| {
            let Self { still, correlations, same_value, errors } = &mut all;
            let sums = still.iter_mut().chain(correlations.as_flattened_mut()).chain(same_value).chain(errors);
            let still = one.still.iter().chain(one.correlations.as_flattened());
            sums.zip(still.chain(&one.same_value).chain(&one.errors)).for_each(|(all, one)| *all += one);
            all
        })
    }
}

/// Sum of the squared deviations from the mean.
pub fn deviations(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| (value - mean).powi(2)).sum()
}

fn covariance(a: &[f64], b: &[f64]) -> f64 {
    let count = a.len().min(b.len()) as f64;
    let [mean_a, mean_b] = [a, b].map(|values| values.iter().sum::<f64>() / count);
    a.iter().zip(b).map(|(a, b)| (a - mean_a) * (b - mean_b)).sum::<f64>() / count
}

/// The place of the greatest value, between the frames by the parabola through it and its neighbours.
fn peak(values: &[f64]) -> f64 {
    let best = (0..values.len()).max_by(|a, b| values[*a].total_cmp(&values[*b])).unwrap_or(0);
    if best == 0 || best + 1 == values.len() {
        return best as f64;
    }
    let [before, top, after] = [values[best - 1], values[best], values[best + 1]];
    best as f64 + 0.5 * (before - after) / (before - 2.0 * top + after)
}

/// Counts the frames from the second of a curve until it passes `value`; `None` if it never does. The first frame only tells
/// from which side it comes.
fn frames_until(value: f64, curve: &[f64]) -> Option<f64> {
    for (frame, pair) in curve.windows(2).enumerate() {
        let [from, to] = [pair[0] - value, pair[1] - value];
        if from == 0.0 && frame > 0 || to == 0.0 {
            return Some(if to == 0.0 { frame as f64 } else { frame as f64 - 1.0 });
        }
        if from * to < 0.0 {
            return Some((frame as f64 - 1.0 + from / (from - to)).max(0.0));
        }
    }
    None
}

/// Frames at the start of a clip in which the face is at rest, and from which its neutral face is taken.
const NEUTRAL_FRAMES: u64 = 75;

/// The coefficients and the head in each frame.
pub type Frames = Vec<([f32; COEFFS], HeadPose)>;

/// A clip of a wearer whose neutral face is known: as solved, and as sent with the default filters.
pub struct Stream {
    clip: Clip,
    pub raw: Frames,
    sent: Frames,
}

impl Stream {
    pub fn of(clip: Clip) -> Result<Self> {
        let (mut raw, mut sent) = (Frames::new(), Frames::new());
        for shown in clip.shown(&Model::embedded(), Some(&clip.neutral(NEUTRAL_FRAMES)?)) {
            if let Some(solved) = shown.solution {
                raw.push((solved.corrected.0, solved.raw_head));
                sent.push((solved.smoothed.0, solved.head));
            } else {
                // A frame without a solution repeats the frame before.
                raw.push(*raw.last().context("no face in the first frame")?);
                sent.push(*sent.last().context("no face in the first frame")?);
            }
        }
        Ok(Self { clip, raw, sent })
    }

    /// Measures what a filter makes of a part of the face, in the parts of the clip at rest and in motion.
    pub fn sums(&self, part: Part, filtered: &Frames, still: &[&str], moving: &[&str]) -> Sums {
        let [still, moving] = [still, moving].map(|names| self.clip.parts.starting_with(names).collect::<Vec<_>>());
        let truth = &self.clip.truth;
        let sums = |value: &dyn Fn(&([f32; COEFFS], HeadPose)) -> f64, truth: Vec<f64>| {
            let [raw, filtered] = [&self.raw, filtered].map(|frames| frames.iter().map(value).collect::<Vec<_>>());
            Sums::of([&raw, &filtered, &truth], &still, &moving)
        };
        let Part::Group(group) = part else {
            let angle = |axis: usize| {
                let truth = truth.pose_deg.iter().map(|pose| pose[axis]).collect();
                sums(&|(_, head)| head.yaw_pitch_roll_deg()[axis].into(), truth)
            };
            return (0..3).map(angle).sum();
        };
        let members = (0..COEFFS).filter(|index| Group::of(BLENDSHAPES[*index]) == group);
        let truth = |index: usize| truth.coefficients.iter().map(|frame| frame[index]).collect();
        members.map(|index| sums(&|(face, _)| face[index].into(), truth(index))).sum()
    }
}

/// The parts of a clip at rest.
const LIGHTS: [&str; 3] = ["still-bright", "still-dim", "still-dark"];

/// Returns for each part of the face the deviation at rest under each light, sent and raw (of the head in degrees), and
/// the delay by cross-correlation and until the same value appears.
pub fn summary_of(streams: &[Stream]) -> Table {
    let sums = |part: Part, still: &[&str], moving: &[&str]| -> Sums {
        streams.iter().map(|stream| stream.sums(part, &stream.sent, still, moving)).sum()
    };
    let row = |(part, name, _): (Part, &str, f64)| {
        let rest = LIGHTS.map(|light| {
            let [raw, sent] = sums(part, &[light], &[]).deviations();
            format!("{sent:.4} of {raw:.4} ({:.2})", sent / raw.max(1e-9))
        });
        let moved = sums(part, &[], &["talk", "judged"]);
        let lags = [moved.lag_ms(), moved.same_value_ms()].map(|ms| format!("{ms:.1}"));
        [name.to_owned()].into_iter().chain(rest).chain(lags).collect::<Vec<_>>()
    };
    let heads = ["part", "deviation at rest, bright", "dim", "dark", "lag ms", "same value ms"];
    Table::new(heads, PARTS.map(row))
}
