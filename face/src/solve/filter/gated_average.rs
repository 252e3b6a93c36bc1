//! The gated moving average (eq. 9 to 11).
//!
//! A new value within one standard deviation of the last N values is averaged with them, `(f_t + N avg) / (N + 1)`. A
//! value outside this gate passes unchanged, so that a blink is not delayed. (Eq. 10 has the root, so it is a standard
//! deviation.) The equations count frames at 30 frames per second. Here the last values are those of a window of time,
//! and N is that time in whole frames of 1/30 s, so that the response to a small change takes as long at every frame
//! rate.
//!
//! As printed, the gate has a step at its edge and closes to nothing on a face that holds still, so that values jump
//! between smoothed and not smoothed. Here the share of the new value grows smoothly from `1 / (N + 1)` in the middle
//! of the gate to 1 at its edge, and the gate is never narrower than a few times the jitter of a still face.

use heapless::HistoryBuf;

use super::{Filter, add, difference, square, towards};

/// Frame rate that the equations assume.
const FPS: f32 = 30.0;
/// Most values that are remembered: the longest window of the settings at 90 frames per second. At higher rates the
/// window is shorter.
const MAX_VALUES: usize = 32;

/// The last outputs of a gated moving average.
#[derive(Debug, Clone, PartialEq)]
pub struct Past<const N: usize>(HistoryBuf<Output<N>, MAX_VALUES>);

#[derive(Debug, Clone, Copy, PartialEq)]
struct Output<const N: usize> {
    value: [f32; N],
    /// Time since the output before, seconds.
    dt_s: f32,
}

impl<const N: usize> Past<N> {
    pub fn starting_with(value: [f32; N]) -> Self {
        let mut past = HistoryBuf::new();
        past.write(Output { value, dt_s: 0.0 });
        Self(past)
    }

    /// Filters the value `x`, `dt_s` seconds after the last one. A window that holds fewer than two values smooths
    /// nothing.
    pub fn step(&mut self, filter: &Filter, x: [f32; N], dt_s: f32) -> [f32; N] {
        let value = gated(x, filter.noise_size, self.values(filter.time_s, dt_s));
        self.0.write(Output { value, dt_s });
        value
    }

    /// The outputs and their ages, `dt_s` after the newest, from the newest to the last that is at most `window_s` old.
    fn values(&self, window_s: f32, dt_s: f32) -> impl Iterator<Item = ([f32; N], f32)> {
        let with_age = self.0.oldest_ordered().rev().scan(dt_s, |next_age_s, output| {
            let age_s = *next_age_s;
            *next_age_s += output.dt_s;
            Some((output.value, age_s))
        });
        with_age.take_while(move |(_, age_s)| *age_s <= window_s)
    }
}

/// Eq. 11, given the previous values and their ages, and the half width below which the gate never closes. Fewer than two
/// values have no deviation, so that `x` passes.
fn gated<const N: usize>(x: [f32; N], min_gate: f32, previous: impl Iterator<Item = ([f32; N], f32)>) -> [f32; N] {
    let (mut count, mut sum, mut squares, mut oldest_s) = (0.0, [0.0; N], 0.0, 0.0);
    for (value, age_s) in previous {
        // Squares of differences from `x` lose fewer digits in the variance than squares of the values would.
        let from_x = difference(value, x);
        add(&mut sum, 1.0, from_x);
        (count, squares, oldest_s) = (count + 1.0, squares + square(from_x), age_s);
    }
    if count < 2.0 {
        return x;
    }
    // The average minus `x`.
    let offset = sum.map(|sum| sum / count);
    let variance = (squares - count * square(offset)) / (count - 1.0);
    // Rounding can make the variance of equal values negative.
    let gate = variance.max(0.0).sqrt().max(min_gate).max(f32::EPSILON);
    let mut average = x;
    add(&mut average, 1.0, offset);
    towards(average, x, share(square(offset).sqrt() / gate, (oldest_s * FPS).round()))
}

/// Share of the new value, `distance` gates away from the average of the values of the last `frames` frames.
fn share(distance: f32, frames: f32) -> f32 {
    if distance > 1.0 {
        return 1.0;
    }
    let inside = 1.0 / (frames + 1.0);
    inside + (1.0 - inside) * distance.powi(4)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FACE: Filter = Filter { kind: super::super::FilterKind::GatedAverage, time_s: 0.18, noise_size: 0.05 };

    fn run_at(fps: f32, signal: impl IntoIterator<Item = f32>) -> Vec<f32> {
        let mut signal = signal.into_iter();
        let mut past = Past::starting_with([signal.next().unwrap_or_default()]);
        signal.map(|x| past.step(&FACE, [x], 1.0 / fps)).map(|[y]| y).collect()
    }

    /// A resting value with jitter of ±0.01.
    fn jittering(frames: usize) -> Vec<f32> {
        let mut random = fastrand::Rng::with_seed(7);
        (0..frames).map(|_| 0.29 + 0.02 * random.f32()).collect()
    }

    #[test]
    fn value_on_the_average_keeps_it_and_one_outside_the_gate_passes() {
        let mut past = Past::starting_with([0.1]);
        for value in [0.3, 0.1, 0.3, 0.2] {
            past.0.write(Output { value: [value], dt_s: 1.0 / FPS });
        }
        let deviation = 0.1_f32;
        let [near] = past.clone().step(&FACE, [0.2 + 0.1 * deviation], 1.0 / FPS);
        assert!((near - (0.2 + 0.1 * deviation / 6.0)).abs() < 1e-4, "{near}");
        let [outside] = past.step(&FACE, [0.2 + 1.01 * deviation], 1.0 / FPS);
        assert!((outside - (0.2 + 1.01 * deviation)).abs() < 1e-6, "{outside}");
    }

    #[test]
    fn window_holds_as_many_values_as_its_time_and_at_most_32() {
        for (fps, want) in [(10.0, 1), (15.0, 2), (30.0, 5), (60.0, 10), (120.0, 21), (240.0, 32)] {
            let mut past = Past::starting_with([0.5]);
            (0..100).for_each(|_| _ = past.step(&FACE, [0.5], 1.0 / fps));
            assert_eq!(past.values(FACE.time_s, 1.0 / fps).count(), want, "{fps} frames per second");
        }
    }

    #[test]
    fn frames_that_come_10_ms_early_or_late_leave_the_window_as_it_is() {
        let mut random = fastrand::Rng::with_seed(3);
        let (mut past, mut last_us) = (Past::starting_with([0.5]), 0);
        for frame in 1..500 {
            let time_us = 33_333 * frame + random.i32(-5000..5000);
            let dt_s = (time_us - last_us) as f32 / 1e6;
            if frame > 5 {
                assert_eq!(past.values(FACE.time_s, dt_s).count(), 5, "frame {frame}");
            }
            past.step(&FACE, [0.5], dt_s);
            last_us = time_us;
        }
    }

    #[test]
    fn sudden_move_passes_undelayed_at_every_frame_rate() {
        for fps in [5.0, 15.0, 30.0, 60.0, 120.0] {
            let out = run_at(fps, jittering(30).into_iter().chain([0.9]));
            assert!((out[29] - 0.9).abs() < 1e-6, "{fps} frames per second: {}", out[29]);
        }
    }

    #[test]
    fn smooth_edge_lets_near_values_come_out_near() {
        let out = |last| run_at(30.0, [0.2, 0.2, 0.2, 0.2, 0.2, last])[4];
        assert!((out(0.251) - out(0.249)).abs() < 0.015, "across the edge of the gate");
        assert!(out(0.21) < 0.203, "well inside");
    }

    #[test]
    fn small_step_is_followed_as_fast_at_every_frame_rate() {
        for fps in [15.0_f32, 30.0, 60.0, 120.0] {
            let out = run_at(fps, [0.5; 30].into_iter().chain([0.53; 500]));
            let reached_s = |y| out.iter().skip(29).position(|out| *out > y).map(|frames| frames as f32 / fps);
            let half_way_s = reached_s(0.515).expect("half way");
            let nearly_s = reached_s(0.527).expect("90 percent");
            assert!((0.19..0.25).contains(&half_way_s), "{fps} frames per second: {half_way_s} s");
            assert!((0.9..1.2).contains(&nearly_s), "{fps} frames per second: {nearly_s} s");
        }
    }
}
