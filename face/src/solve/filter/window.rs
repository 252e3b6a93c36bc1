//! The moving average and the time-weighted average over the last seconds.
//!
//! Every value stands for the time since the value before it, so that the mean is that of the curve and does not jump
//! when a frame leaves the window. The first value stands for all the time before it. Values that follow each other fast
//! share a bin, so that the bins suffice for the window at every frame rate.

use heapless::HistoryBuf;

use super::{add, towards};

/// Number of bins of a window.
const BINS: usize = 16;

/// The last values, and the times that they stand for.
#[derive(Debug, Clone, PartialEq)]
pub struct Window<const N: usize> {
    newest: Bin<N>,
    older: HistoryBuf<Bin<N>, BINS>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Bin<const N: usize> {
    value: [f32; N],
    span_s: f32,
}

impl<const N: usize> Window<N> {
    pub fn starting_with(value: [f32; N]) -> Self {
        Self { newest: Bin { value, span_s: f32::INFINITY }, older: HistoryBuf::new() }
    }

    /// Adds the value `x`, `dt_s` seconds after the last one.
    pub fn push(&mut self, x: [f32; N], dt_s: f32, window_s: f32) {
        let newest = &mut self.newest;
        let span_s = newest.span_s + dt_s;
        // Two neighbouring bins last longer than this together, so that all of them cover the window.
        if span_s <= 2.0 * window_s / BINS as f32 {
            // Without any time between them, the newer value replaces the older one.
            let share = if span_s > 0.0 { dt_s / span_s } else { 1.0 };
            *newest = Bin { value: towards(newest.value, x, share), span_s };
        } else {
            self.older.write(*newest);
            *newest = Bin { value: x, span_s: dt_s };
        }
    }

    /// The mean of the curve over the last `window_s` seconds.
    pub fn mean(&self, window_s: f32) -> [f32; N] {
        let mut left_s = window_s;
        self.weighted(|span_s| {
            let inside_s = span_s.min(left_s);
            left_s -= inside_s;
            inside_s
        })
    }

    /// The mean of the curve over the last `window_s` seconds, with weights of `exp(-2 age / window_s)`.
    pub fn weighted_mean(&self, window_s: f32) -> [f32; N] {
        let (mut age_s, mut before) = (0.0_f32, 1.0);
        self.weighted(|span_s| {
            age_s = (age_s + span_s).min(window_s);
            let after = (-2.0 * age_s / window_s).exp();
            let weight = before - after;
            before = after;
            weight
        })
    }

    /// The weighted mean of all bins, from the newest to the oldest.
    fn weighted(&self, mut weight_of: impl FnMut(f32) -> f32) -> [f32; N] {
        let (mut sum, mut total) = ([0.0; N], 0.0);
        for bin in core::iter::once(&self.newest).chain(self.older.oldest_ordered().rev()) {
            let weight = weight_of(bin.span_s);
            add(&mut sum, weight, bin.value);
            total += weight;
        }
        if total > 0.0 { sum.map(|sum| sum / total) } else { self.newest.value }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Means of a step from 0 to 1, after each frame.
    fn step(fps: f32, mean: impl Fn(&Window<1>) -> [f32; 1]) -> Vec<f32> {
        let mut window = Window::starting_with([0.0]);
        let mut push = |x| {
            window.push([x], 1.0 / fps, 0.2);
            mean(&window)[0]
        };
        (0..200).for_each(|_| _ = push(0.0));
        (0..200).map(|_| push(1.0)).collect()
    }

    #[test]
    fn moving_average_rises_in_a_straight_line_over_its_window_at_every_frame_rate() {
        for fps in [10.0_f32, 30.0, 60.0, 240.0] {
            for (frame, value) in (1_u16..).zip(step(fps, |window| window.mean(0.2))) {
                let want = (f32::from(frame) / fps / 0.2).min(1.0);
                assert!((value - want).abs() < 0.07, "{fps} frames a second, frame {frame}: {value}, not {want}");
            }
        }
    }

    #[test]
    fn time_weighted_average_weighs_the_newest_most_and_reaches_its_goal_within_the_window() {
        for fps in [30_u8, 60, 240] {
            let curve = step(fps.into(), |window| window.weighted_mean(0.2));
            let half = curve[usize::from(fps) / 10 - 1];
            assert!((0.68..0.78).contains(&half), "{fps} frames a second: {half} after half of the window");
            // Two bins of an eighth of the window may reach over its end.
            assert!(curve[usize::from(fps) * 23 / 100] > 0.999);
        }
    }
}
