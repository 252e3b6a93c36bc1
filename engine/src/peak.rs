//! The core's peak rate of multiply-adds, with which the rate of a network is compared.

use std::hint::black_box;
use std::time::{Duration, Instant};

use crate::kernels::Kernels;

/// Time of one measurement: long enough for the clock, short enough to lie between two interruptions by the system.
const TRIAL: Duration = Duration::from_millis(1);
/// Number of measurements. During the first ones the core raises its clock rate.
const TRIALS: usize = 30;

/// Measures how many multiply-adds per second the calling core computes in registers, with the instructions of
/// `kernels`. Takes about 50 milliseconds. Returns the highest rate of several trials, because interruptions only ever
/// lower a rate.
#[must_use]
pub fn multiply_adds_per_second(kernels: &Kernels) -> f64 {
    let time = |rounds: usize| {
        let start = Instant::now();
        black_box((kernels.peak)(black_box(rounds)));
        start.elapsed()
    };
    let mut rounds = 1 << 10;
    while time(rounds) < TRIAL && rounds < 1 << 30 {
        rounds *= 2;
    }
    let fastest = (0..TRIALS).map(|_| time(rounds)).fold(Duration::MAX, Duration::min);
    (rounds * kernels.peak_round) as f64 / fastest.as_secs_f64()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels;

    #[test]
    fn the_peak_computes_every_multiply_add_that_it_counts() {
        for kernels in kernels::available() {
            // Each round adds 1/65536 of each sum to the sum itself, rounded to a multiple of 2^-23. At the end the sums
            // are added up.
            for rounds in [0, 1, 2, 3, 100] {
                let expected = (1.0 + rounds as f32 / 65536.0) * (kernels.peak_round / kernels.vector) as f32;
                assert_eq!((kernels.peak)(rounds).to_bits(), expected.to_bits(), "{}", kernels.name);
            }
        }
    }

    #[test]
    fn the_rate_lies_between_1e7_and_1e12_multiply_adds_per_second() {
        for kernels in kernels::available() {
            let rate = multiply_adds_per_second(kernels);
            assert!((1e7..1e12).contains(&rate), "{}: {rate}", kernels.name);
        }
    }
}
