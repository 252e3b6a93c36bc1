//! What every kind of filter promises.

use super::*;

const FRAME_S: f32 = 1.0 / 30.0;
/// Every kind of filter.
pub(in crate::solve) const KINDS: [FilterKind; 7] = [
    FilterKind::Off,
    FilterKind::Kalman,
    FilterKind::MovingAverage,
    FilterKind::TimeWeightedAverage,
    FilterKind::LowPass,
    FilterKind::GatedAverage,
    FilterKind::OneEuro,
];

/// A filter of each kind.
fn filters() -> impl Iterator<Item = Filter> {
    KINDS.into_iter().map(|kind| Filter { kind, time_s: 0.18, noise_size: 0.05 })
}

/// What a filter makes of pairs of a value and the time since the one before.
fn run(filter: &Filter, signal: impl IntoIterator<Item = (f32, f32)>) -> Vec<f32> {
    let mut state = FilterState::Empty;
    signal.into_iter().map(|(x, dt_s)| filter.step(&mut state, [x], dt_s)).map(|[y]| y).collect()
}

/// Values from 0 to 1 at irregular times, with pauses, repeated times and far too many frames a second.
fn irregular(seed: u64) -> impl Iterator<Item = (f32, f32)> {
    let mut random = fastrand::Rng::with_seed(seed);
    core::iter::repeat_with(move || (random.f32(), [0.0, 1e-6, 0.004, FRAME_S, 0.2, 9.0][random.usize(..6)]))
}

#[test]
fn outputs_lie_between_the_least_and_the_greatest_input_whatever_the_times() {
    for (filter, seed) in filters().flat_map(|filter| (0..20).map(move |seed| (filter, seed))) {
        let signal = irregular(seed).map(|(x, dt_s)| (0.3 + 0.1 * x, dt_s));
        let out = run(&filter, signal.take(500));
        assert!(out.iter().all(|y| (0.3 - 1e-6..=0.4 + 1e-6).contains(y)), "{filter:?}, seed {seed}");
    }
}

#[test]
fn value_that_is_not_finite_affects_no_later_frame() {
    for (filter, wrong) in filters().flat_map(|filter| [f32::NAN, f32::INFINITY].map(|wrong| (filter, wrong))) {
        let (before, after): (Vec<_>, Vec<_>) = (irregular(1).take(50).collect(), irregular(2).take(50).collect());
        let out = run(&filter, before.into_iter().chain([(wrong, FRAME_S)]).chain(after.clone()));
        assert!(!out[50].is_finite(), "{filter:?} hides a fault");
        assert_eq!(out[51..], run(&filter, after), "{filter:?}");
    }
}

#[test]
fn long_gap_and_a_step_that_is_no_time_start_a_filter_anew() {
    for (filter, dt_s) in filters().flat_map(|filter| [10.0, f32::NAN, -0.02].map(|dt_s| (filter, dt_s))) {
        let after = [(0.5, dt_s), (0.52, FRAME_S), (0.49, FRAME_S)];
        let out = run(&filter, irregular(1).take(50).chain(after));
        assert_eq!(out[50..], run(&filter, after), "{filter:?}");
    }
}

#[test]
fn filter_of_another_kind_starts_anew() {
    for [before, after] in filters().flat_map(|a| filters().map(move |b| [a, b])) {
        let shares_a_window =
            |filter: Filter| filter.kind == FilterKind::MovingAverage || filter.kind == FilterKind::TimeWeightedAverage;
        if before.kind == after.kind || shares_a_window(before) && shares_a_window(after) {
            continue;
        }
        let mut state = FilterState::Empty;
        (1_u8..9).for_each(|x| _ = before.step(&mut state, [f32::from(x)], FRAME_S));
        assert_eq!(after.step(&mut state, [0.4], FRAME_S), [0.4], "{before:?}, then {after:?}");
        assert_eq!(state == FilterState::Empty, after.kind == FilterKind::Off);
        let off = Filter { time_s: 0.0, ..before };
        (1_u8..9).for_each(|x| assert_eq!(off.step(&mut state, [x.into()], FRAME_S), [x.into()], "{off:?}"));
    }
}

#[test]
fn value_that_stays_is_reached_within_a_second_at_every_frame_rate() {
    for (filter, fps) in filters().flat_map(|filter| [10_u16, 30, 60, 240].map(|fps| (filter, fps))) {
        for step in [0.02, 0.5] {
            let frame_s = 1.0 / f32::from(fps);
            let signal = [(0.1, frame_s); 300].into_iter().chain([(0.1 + step, frame_s); 480]);
            let out = run(&filter, signal);
            let after_1_s = out[300 + usize::from(fps)];
            assert!((after_1_s - 0.1 - step).abs() < 0.15 * step, "{filter:?}, {fps} frames a second: {after_1_s}");
        }
    }
}

#[test]
fn noise_of_a_value_that_stays_is_smoothed_to_less_than_two_thirds() {
    let mut random = fastrand::Rng::with_seed(4);
    let noise: Vec<f32> = (0..900).map(|_| 0.5 + 0.02 * (random.f32() - 0.5)).collect();
    let deviation = |x: &[f32]| (x.iter().map(|x| (x - 0.5).powi(2)).sum::<f32>() / x.len() as f32).sqrt();
    for (filter, fps) in filters().skip(1).flat_map(|filter| [30.0, 60.0].map(|fps| (filter, fps))) {
        let out = run(&filter, noise.iter().map(|x| (*x, 1.0 / fps)));
        assert!(deviation(&out[30..]) < 0.66 * deviation(&noise), "{filter:?}, {fps} frames a second");
    }
}

#[test]
fn values_of_several_numbers_are_smoothed_like_each_of_them_where_the_kind_is_linear() {
    for kind in [FilterKind::MovingAverage, FilterKind::TimeWeightedAverage, FilterKind::LowPass] {
        let filter = Filter { kind, time_s: 0.18, noise_size: 0.05 };
        let signal: Vec<_> = irregular(6).take(50).collect();
        let mut state = FilterState::Empty;
        let both = signal.iter().map(|(x, dt_s)| filter.step(&mut state, [*x, 1.0 - x], *dt_s));
        let one = run(&filter, signal.clone());
        assert!(both.zip(one).all(|([a, b], want)| a == want && (a + b - 1.0).abs() < 1e-5), "{kind:?}");
    }
}
