//! Jitter and delay of a filter.

use std::{iter::Sum, ops::Range};

/// Frame rate of the clips.
pub const FPS: f64 = 30.0;
/// Frames at the end of a part at rest whose standard deviation counts: 2 seconds.
const STILL_FRAMES: usize = 60;
/// Most frames by which a curve may follow another one.
const MOST_LAG: usize = 10;
/// Most frames by which noise may make a curve seem to lead.
const MOST_LEAD: usize = 3;
/// A value that moves less in a frame is left out when its delay is measured.
const MOVING: f64 = 0.03;

/// One curve of a clip before and after a filter, with the truth.
pub struct Curves<'a> {
    /// Before the filter.
    pub raw: &'a [f64],
    /// After the filter.
    pub filtered: &'a [f64],
    /// The truth.
    pub truth: &'a [f64],
}

/// Sums over curves, from which the figures of all of them follow.
#[derive(Debug, Clone, Copy, Default)]
pub struct Sums {
    /// Squared deviations at rest, before and after the filter, and their number.
    still: [f64; 3],
    /// Cross-correlations with the truth at each lag, before and after the filter.
    correlations: [[f64; MOST_LEAD + MOST_LAG + 1]; 2],
    /// Frames until the same value appears, and their number.
    same_value: [f64; 2],
    /// Squared errors after the filter, and their number.
    errors: [f64; 2],
}

impl Sums {
    /// Measures one curve: its jitter in the frames at rest, and its delay in those that move.
    pub fn of(curves: &Curves, still: &[Range<usize>], moving: &[Range<usize>]) -> Self {
        let mut sums = Self::default();
        for frames in still {
            let last = frames.end.saturating_sub(STILL_FRAMES).max(frames.start)..frames.end;
            sums.still[0] += deviations(&curves.raw[last.clone()]);
            sums.still[1] += deviations(&curves.filtered[last.clone()]);
            sums.still[2] += last.len() as f64;
        }
        for frames in moving {
            sums.add_movement(
                &curves.raw[frames.clone()],
                &curves.filtered[frames.clone()],
                &curves.truth[frames.clone()],
            );
        }
        sums
    }

    fn add_movement(&mut self, raw: &[f64], filtered: &[f64], truth: &[f64]) {
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

    /// Standard deviation at rest before and after the filter.
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

    /// Mean squared error while the face moves.
    pub fn mse(&self) -> f64 {
        self.errors[0] / self.errors[1].max(1.0)
    }
}

impl Sum for Sums {
    fn sum<I: Iterator<Item = Self>>(sums: I) -> Self {
        sums.fold(Self::default(), |mut all, one| {
            let pairs = all.still.iter_mut().zip(one.still);
            let pairs = pairs.chain(all.correlations.iter_mut().flatten().zip(one.correlations.into_iter().flatten()));
            let pairs = pairs.chain(all.same_value.iter_mut().zip(one.same_value));
            pairs.chain(all.errors.iter_mut().zip(one.errors)).for_each(|(all, one)| *all += one);
            all
        })
    }
}

/// Sum of the squared deviations from the mean.
fn deviations(values: &[f64]) -> f64 {
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

/// Frames until a curve passes `value`, from its second frame on; its first is the one before. `None` if it does not.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A slow wave of 0 to 1, delayed by a number of frames.
    fn wave(delay: f64) -> Vec<f64> {
        (0..300).map(|frame| 0.5 + 0.5 * ((f64::from(frame) - delay) * 0.25).sin()).collect()
    }

    #[test]
    fn delay_between_frames_is_found_by_both_measures() {
        for delay in [0.0, 0.4, 1.0, 2.7] {
            let (raw, filtered) = (wave(1.5), wave(1.5 + delay));
            let curves = Curves { raw: &raw, filtered: &filtered, truth: &wave(0.0) };
            let sums = Sums::of(&curves, &[], core::slice::from_ref(&(0..300)));
            assert!((sums.lag_ms() - delay * 1000.0 / FPS).abs() < 3.0, "{delay}: {}", sums.lag_ms());
            // At the turning points the curve passes some values at once.
            assert!((sums.same_value_ms() - delay * 1000.0 / FPS).abs() < 6.0, "{delay}: {}", sums.same_value_ms());
        }
    }

    #[test]
    fn jitter_is_the_ratio_of_the_deviations_of_the_last_two_seconds() {
        let raw: Vec<f64> = (0..75).map(|frame| if frame < 15 { 5.0 } else { f64::from(frame % 2) }).collect();
        let filtered: Vec<f64> = raw.iter().map(|value| 0.3 * value + 7.0).collect();
        let sums =
            Sums::of(&Curves { raw: &raw, filtered: &filtered, truth: &raw }, core::slice::from_ref(&(0..75)), &[]);
        assert!((sums.jitter() - 0.3).abs() < 1e-9 && (sums.deviations()[0] - 0.5).abs() < 1e-9);
    }
}
