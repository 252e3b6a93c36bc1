//! Averages over the last seconds: the moving, the time-weighted and the gated one.

use core::iter;

use heapless::HistoryBuf;

use super::{Filter, add, difference, square, towards};

const BINS: usize = 16;

/// The last values. Each stands for the time since the one before, so that the mean does not jump when a frame leaves the
/// window. Values that follow each other fast share a bin, so that the bins suffice at every frame rate.
#[derive(Debug, Clone, PartialEq)]
pub struct Window<const N: usize> {
    newest: ([f32; N], f32),
    older: HistoryBuf<([f32; N], f32), BINS>,
}

impl<const N: usize> Window<N> {
    pub fn new(value: [f32; N]) -> Self {
        Self { newest: (value, f32::INFINITY), older: HistoryBuf::new() }
    }

    pub fn push(&mut self, x: [f32; N], dt_s: f32, window_s: f32) -> &Self {
        let (value, newest_s) = self.newest;
        let span_s = newest_s + dt_s;
        // Two neighbouring bins last longer than this together, so that all of them cover the window.
        if span_s <= 2.0 * window_s / BINS as f32 {
            // Without any time between them, the newer value replaces the older one.
            let share = if span_s > 0.0 { dt_s / span_s } else { 1.0 };
            self.newest = (towards(value, x, share), span_s);
        } else {
            self.older.write(self.newest);
            self.newest = (x, dt_s);
        }
        self
    }

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
        let mut age_s = 0.0_f32;
        let mut before = 1.0;
        self.weighted(|span_s| {
            age_s = (age_s + span_s).min(window_s);
            let after = (-2.0 * age_s / window_s).exp();
            let weight = before - after;
            before = after;
            weight
        })
    }

    fn weighted(&self, mut weight_of: impl FnMut(f32) -> f32) -> [f32; N] {
        let mut sum = [0.0; N];
        let mut total = 0.0;
        for (value, span_s) in iter::once(&self.newest).chain(self.older.oldest_ordered().rev()) {
            let weight = weight_of(*span_s);
            add(&mut sum, weight, *value);
            total += weight;
        }
        if total > 0.0 { sum.map(|sum| sum / total) } else { self.newest.0 }
    }
}

const FPS: f32 = 30.0;
/// Most values that a gated average remembers: the longest window of the settings at 90 frames per second. At higher
/// rates the window is shorter.
const MAX_VALUES: usize = 32;

/// The last outputs of a gated moving average (eq. 9 to 11), and the time since the output before each, seconds.
///
/// A new value within one standard deviation of the last N values is averaged with them, `(f_t + N avg) / (N + 1)`; one
/// outside this gate passes, so that a blink is not delayed. Here N is a time in whole frames of 1/30 s, so that the
/// response takes as long at every frame rate. As the paper has it, the gate has a step at its edge and closes to nothing
/// on a still face. Here the share of the new value grows smoothly from `1 / (N + 1)` in the middle of the gate to 1 at
/// its edge, and the gate is never narrower than a few times the jitter of a still face.
///
/// [`Self::step_as_printed`] is the filter as the paper has it, and counts values, as the paper does.
#[derive(Debug, Clone, PartialEq)]
pub struct Past<const N: usize>(HistoryBuf<([f32; N], f32), MAX_VALUES>);

/// The last values of a time, their number and variance, how far their mean lies from a new value, and the age of the oldest.
struct Spread<const N: usize> {
    count: f32,
    offset: [f32; N],
    variance: f32,
    oldest_s: f32,
}

impl<const N: usize> Past<N> {
    pub fn new(value: [f32; N]) -> Self {
        let mut past = HistoryBuf::new();
        past.write((value, 0.0));
        Self(past)
    }

    /// Filters the value `x`, `dt_s` seconds after the last one (eq. 11). The last value counts however old it is, so that the
    /// filter also works at low frame rates.
    pub fn step(&mut self, filter: &Filter, x: [f32; N], dt_s: f32) -> [f32; N] {
        let Spread { count, offset, variance, oldest_s } = self.spread(filter.time_s, x, dt_s);
        let mut value = x;
        if count >= 1.0 {
            let gate = variance.sqrt().max(filter.noise_size).max(f32::EPSILON);
            let inside = if count >= 2.0 { inside(oldest_s) } else { inside_alone(filter.time_s, dt_s) };
            add(&mut value, 1.0, offset);
            value = towards(value, x, share(square(offset).sqrt() / gate, inside));
        }
        self.0.write((value, dt_s));
        value
    }

    /// Eq. 11 as printed: `(f_t + N avg) / (N + 1)` within one deviation of the average of the last N values, and else the
    /// value itself. N is the number of values in `time_s`; a single one has no deviation, so that nothing is averaged.
    pub fn step_as_printed(&mut self, time_s: f32, x: [f32; N], dt_s: f32) -> [f32; N] {
        let Spread { count, offset, variance, .. } = self.spread(time_s, x, dt_s);
        let mut value = x;
        if count >= 2.0 && square(offset) <= variance {
            add(&mut value, count / (count + 1.0), offset);
        }
        self.0.write((value, dt_s));
        value
    }

    fn spread(&self, window_s: f32, x: [f32; N], dt_s: f32) -> Spread<N> {
        let mut count = 0.0;
        let mut sum = [0.0; N];
        let mut squares = 0.0;
        let mut oldest_s = 0.0;
        for (value, age_s) in self.values(window_s, dt_s) {
            // Squares of differences from `x` lose fewer digits in the variance than squares of the values would.
            let from_x = difference(value, x);
            add(&mut sum, 1.0, from_x);
            count += 1.0;
            squares += square(from_x);
            oldest_s = age_s;
        }
        let offset = sum.map(|sum| sum / f32::max(count, 1.0));
        // A single value has no deviation. Rounding can make the variance of equal values negative.
        let variance = ((squares - count * square(offset)) / f32::max(count - 1.0, 1.0)).max(0.0);
        Spread { count, offset, variance, oldest_s }
    }

    /// The outputs and their ages, `dt_s` after the newest: the newest, and those that are at most `window_s` old.
    fn values(&self, window_s: f32, dt_s: f32) -> impl Iterator<Item = ([f32; N], f32)> {
        let mut next_age_s = dt_s;
        let with_age = self.0.oldest_ordered().rev().map(move |(value, since_last_s)| {
            next_age_s += since_last_s;
            (*value, next_age_s - since_last_s)
        });
        let is_inside = move |at: usize, age_s: f32| at == 0 || age_s <= window_s;
        with_age.enumerate().take_while(move |(at, (_, age_s))| is_inside(*at, *age_s)).map(|(_, value)| value)
    }
}

/// Share of a new value that equals the average of the values of the last `window_s` seconds.
fn inside(window_s: f32) -> f32 {
    1.0 / ((window_s * FPS).round() + 1.0)
}

/// As [`inside`], if a single value, which is `age_s` old, stands for the average. As much passes in a second as at 30 frames a
/// second, where the values are `window_s / 2` and half a frame old on average.
fn inside_alone(window_s: f32, age_s: f32) -> f32 {
    let usual_age_s = 0.5 * (window_s + 1.0 / FPS);
    1.0 - (1.0 - inside(window_s)).powf(age_s / usual_age_s)
}

/// Share of a new value, `distance` gates away from the average, if it is `inside` in the middle of the gate.
fn share(distance: f32, inside: f32) -> f32 {
    if distance > 1.0 {
        return 1.0;
    }
    inside + (1.0 - inside) * distance.powi(4)
}

#[cfg(test)]
mod tests {
    use super::super::tests::step_response;
    use super::super::{FRAME_S, FilterKind};
    use super::*;

    #[test]
    fn averages_over_a_window_rise_by_their_weights_at_every_frame_rate() {
        for fps in [10.0_f32, 30.0, 60.0, 240.0] {
            let [moving, weighted] = [FilterKind::MovingAverage, FilterKind::TimeWeightedAverage]
                .map(|kind| step_response(kind, fps, 0.4).into_iter().map(|y| (y - 0.5) / 0.4));
            for (frame, (moving, weighted)) in (1_u16..).zip(moving.zip(weighted)) {
                let passed = (f32::from(frame) / fps / 0.2).min(1.0);
                assert!((moving - passed).abs() < 0.08, "{fps} frames a second, frame {frame}: {moving}");
                let want = (1.0 - (-2.0 * passed).exp()) / (1.0 - (-2.0_f32).exp());
                assert!((weighted - want).abs() < 0.08, "{fps} frames a second, frame {frame}: {weighted}, not {want}");
            }
        }
    }

    const GATED: Filter = Filter { kind: FilterKind::GatedAverage, time_s: 0.18, noise_size: 0.05 };

    #[test]
    fn value_on_the_average_keeps_it_and_one_outside_the_gate_passes() {
        let mut past = Past::new([0.1]);
        for value in [0.3, 0.1, 0.3, 0.2] {
            past.0.write(([value], FRAME_S));
        }
        let deviation = 0.1_f32;
        let [near] = past.clone().step(&GATED, [0.2 + 0.1 * deviation], FRAME_S);
        assert!((near - (0.2 + 0.1 * deviation / 6.0)).abs() < 1e-4, "{near}");
        let [outside] = past.step(&GATED, [0.2 + 1.01 * deviation], FRAME_S);
        assert!((outside - (0.2 + 1.01 * deviation)).abs() < 1e-6, "{outside}");
    }

    #[test]
    fn gate_as_printed_gives_what_eq_11_gives_by_hand() {
        let mut past = Past::new([0.1]);
        for value in [0.3, 0.1, 0.3, 0.2] {
            past.0.write(([value], FRAME_S));
        }
        // The average is 0.2 and the deviation 0.1, and N is 5: (0.25 + 5 * 0.2) / 6.
        let [inside] = past.clone().step_as_printed(0.18, [0.25], FRAME_S);
        assert!((inside - 1.25 / 6.0).abs() < 1e-6, "{inside}");
        let [outside] = past.clone().step_as_printed(0.18, [0.31], FRAME_S);
        assert_eq!(outside.to_bits(), 0.31_f32.to_bits());
        // Of the last 2 values, 0.3 and 0.2, the average is 0.25: (0.28 + 2 * 0.25) / 3.
        let [of_two] = past.step_as_printed(0.07, [0.28], FRAME_S);
        assert!((of_two - 0.26).abs() < 1e-6, "{of_two}");
    }

    #[test]
    fn noise_is_smoothed_and_a_small_step_is_followed_in_a_like_time_from_5_to_120_frames_a_second() {
        let mut random = fastrand::Rng::with_seed(4);
        let mut noise = || 0.02 * (random.f32() - 0.5);
        let deviation = |x: &[f32]| (x.iter().map(|x| x.powi(2)).sum::<f32>() / x.len() as f32).sqrt();
        for time_s in [0.1, 0.22, 0.35] {
            let filter = Filter { kind: FilterKind::GatedAverage, time_s, noise_size: 0.05 };
            let figures = [5.0_f32, 10.0, 15.0, 20.0, 30.0, 60.0, 90.0, 120.0].map(|fps| {
                let run = |signal: Vec<f32>| -> Vec<f32> {
                    let mut past = Past::new([0.0]);
                    signal.into_iter().map(|x| past.step(&filter, [x], 1.0 / fps)[0]).collect()
                };
                let raw: Vec<f32> = (0..2000).map(|_| noise()).collect();
                let jitter = deviation(&run(raw.clone())) / deviation(&raw);
                let risen = run(vec![0.01; 1000]);
                let delay_s = risen.iter().map(|y| (0.01 - y) / 0.01 / fps).sum::<f32>();
                (fps, jitter, delay_s)
            });
            let [.., (_, _, usual_s), _, _, _] = figures;
            for (fps, jitter, delay_s) in figures {
                assert!(jitter < 0.65, "{time_s} s, {fps} frames a second: {jitter}");
                // From 90 frames a second on, the memory is shorter than the longest window.
                let is_alike = (0.33 * usual_s..2.0 * usual_s).contains(&delay_s);
                assert!(is_alike, "{time_s} s, {fps} frames a second: {delay_s} s, not {usual_s}");
            }
        }
    }

    #[test]
    fn window_holds_as_many_values_as_its_time_and_at_most_32_and_a_sudden_move_passes() {
        for (fps, want) in [(5.0, 1), (10.0, 1), (15.0, 2), (30.0, 5), (60.0, 10), (120.0, 21), (240.0, 32)] {
            let mut past = Past::new([0.5]);
            (0_u8..100).for_each(|frame| _ = past.step(&GATED, [0.5 + 0.01 * f32::from(frame % 2)], 1.0 / fps));
            assert_eq!(past.values(GATED.time_s, 1.0 / fps).count(), want, "{fps} frames per second");
            let [moved] = past.step(&GATED, [0.9], 1.0 / fps);
            assert!((moved - 0.9).abs() < 1e-6, "{fps} frames per second: {moved}");
        }
    }
}
