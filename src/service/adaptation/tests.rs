//! Steps over minutes and days, in which the tests only advance the clock.
#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

use std::time::Duration;

use super::*;

const S: u64 = 1_000_000;
const MINUTE: u64 = 60 * S;
const TICK: u64 = 50_000;
const PERIOD: Duration = Duration::from_micros(33_333);

/// An adaptation with its clock and its changes: when, and to which step.
#[derive(Default)]
struct Rehearsal {
    adaptation: Adaptation,
    now_us: u64,
    changes: Vec<(u64, Step)>,
}

impl Rehearsal {
    /// Lets time pass under a load, as a multiple of the camera's frame period, and impairments.
    fn pass(&mut self, duration_us: u64, load: impl Fn(u64) -> f64, impairments: &[Impairment]) -> &mut Self {
        let end_us = self.now_us + duration_us;
        let mut impaired_by = ImpairmentSet::default();
        for impairment in impairments {
            impaired_by.set(*impairment, true);
        }
        while self.now_us < end_us {
            let load =
                Some(Load { busy: PERIOD.mul_f64(load(self.now_us)), decoding: Duration::ZERO, camera_period: PERIOD });
            self.update(&Conditions { is_allowed: true, load, impaired_by, has_smaller_mode: false });
        }
        self
    }

    fn update(&mut self, conditions: &Conditions) {
        let before = self.adaptation.step();
        let [is_changed, _] = self.adaptation.update(self.now_us, conditions);
        assert_eq!(is_changed, self.adaptation.step() != before);
        assert_eq!(self.adaptation.cause().is_none(), self.adaptation.step() == Step::Full);
        if is_changed {
            self.changes.push((self.now_us, self.adaptation.step()));
        }
        self.now_us += TICK;
    }

    fn steps(&self) -> Vec<Step> {
        self.changes.iter().map(|(_, step)| *step).collect()
    }
}

/// Noise between -1 and 1 that differs from tick to tick.
fn noise(now_us: u64) -> f64 {
    fastrand::Rng::with_seed(now_us).f64() * 2.0 - 1.0
}

#[test]
fn a_constant_overload_changes_the_step_once_within_a_second_and_never_again_in_10_minutes() {
    for (load, step) in
        [(1.02, Step::Turns), (1.5, Step::Half), (2.04, Step::Third), (4.04, Step::Sixth), (8.04, Step::Twelfth)]
    {
        let mut rehearsal = Rehearsal::default();
        rehearsal.pass(10 * MINUTE, |_| load, &[]);
        assert_eq!(rehearsal.steps(), [step], "{load}");
        assert!(rehearsal.changes[0].0 < S, "{load}: {:?}", rehearsal.changes);
    }
}

#[test]
fn a_load_that_no_step_bears_takes_the_lowest_and_stays_there() {
    let mut rehearsal = Rehearsal::default();
    assert_eq!(rehearsal.pass(10 * MINUTE, |_| 40.0, &[]).steps(), [Step::Twelfth]);
}

#[test]
fn a_disturbance_of_less_than_half_a_second_changes_nothing() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(10 * MINUTE, |now_us| if now_us % (2 * S) < 450_000 { 5.0 } else { 0.3 }, &[]);
    assert_eq!(rehearsal.steps(), []);
}

#[test]
fn after_an_overload_the_step_goes_straight_back_once_all_was_well_for_10_s() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(MINUTE, |_| 8.0, &[]).pass(MINUTE, |_| 0.4, &[]);
    assert_eq!(rehearsal.steps(), [Step::Twelfth, Step::Full]);
    let back_us = rehearsal.changes[1].0 - MINUTE;
    assert!((10 * S..11 * S).contains(&back_us), "{back_us}");
}

#[test]
fn a_board_that_recovers_in_part_goes_up_in_part() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(MINUTE, |_| 8.0, &[]).pass(MINUTE, |_| 1.6, &[]);
    assert_eq!(rehearsal.steps(), [Step::Twelfth, Step::Half]);
}

#[test]
fn a_noisy_load_near_a_threshold_changes_the_step_at_most_3_times_in_10_minutes() {
    for load in [0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.7, 1.9, 2.0, 2.1, 4.0, 8.0] {
        for spread in [0.02, 0.1, 0.3] {
            let mut rehearsal = Rehearsal::default();
            // Each value lasts for 400 ms, as it does in a quantile of sixteen frames.
            rehearsal.pass(10 * MINUTE, |now_us| load * (1.0 + spread * noise(now_us / 400_000)), &[]);
            assert!(rehearsal.changes.len() <= 3, "{load} {spread}: {:?}", rehearsal.changes);
        }
    }
}

/// Another program needs the processor for 5 s every 25 s, so that each step up fails.
#[test]
fn a_load_that_returns_soon_after_each_step_up_is_met_with_growing_patience() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(60 * MINUTE, |now_us| if now_us % (25 * S) < 5 * S { 1.5 } else { 0.5 }, &[]);
    assert!(rehearsal.changes.len() <= 5, "{:?}", rehearsal.changes);
    assert_eq!(rehearsal.adaptation.step(), Step::Half);
}

#[test]
fn heat_takes_the_rate_down_to_a_quarter_one_step_a_minute_and_up_again_one_step_every_2() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(4 * MINUTE, |_| 0.8, &[Impairment::Hot]).pass(10 * MINUTE, |_| 0.8, &[]);
    assert_eq!(
        rehearsal.steps(),
        [Step::Half, Step::Third, Step::Quarter, Step::Third, Step::Half, Step::Turns, Step::Full]
    );
    let times_s: Vec<u64> = rehearsal.changes.iter().map(|(at_us, _)| at_us / S).collect();
    assert_eq!(times_s[..3], [0, 60, 120]);
    assert!(times_s[3..].windows(2).all(|pair| (120..122).contains(&(pair[1] - pair[0]))), "{times_s:?}");
}

#[test]
fn heat_that_facewire_does_not_cause_costs_every_second_frame_and_no_more() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(60 * MINUTE, |_| 0.1, &[Impairment::Hot]);
    assert_eq!(rehearsal.steps(), [Step::Half]);
}

#[test]
fn low_voltage_spares_the_board_like_heat_and_says_so() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(10 * S, |_| 0.1, &[Impairment::Undervoltage]);
    assert_eq!((rehearsal.adaptation.step(), rehearsal.adaptation.cause()), (Step::Half, Some(Cause::Undervoltage)));
}

#[test]
fn other_impairments_change_nothing() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(MINUTE, |_| 0.1, &[Impairment::Dark, Impairment::SlowGovernor]);
    assert_eq!(rehearsal.steps(), []);
}

/// A processor that warms up by what facewire takes, with a time constant of a minute, and is hot from 80 degrees until it
/// is below 75.
#[test]
fn heat_that_follows_the_load_does_not_make_the_steps_oscillate() {
    for ambient_c in [30.0, 40.0, 50.0, 60.0, 70.0, 78.0] {
        let mut rehearsal = Rehearsal::default();
        let (mut temperature_c, mut is_hot) = (ambient_c, false);
        while rehearsal.now_us < 24 * 60 * MINUTE {
            let step = rehearsal.adaptation.step();
            let share = step.busy(PERIOD).div_duration_f64(step.period(PERIOD));
            temperature_c += (ambient_c + 60.0 * share - temperature_c) * TICK as f64 / MINUTE as f64;
            is_hot = temperature_c >= if is_hot { 75.0 } else { 80.0 };
            let impairments: &[Impairment] = if is_hot { &[Impairment::Hot] } else { &[] };
            rehearsal.pass(TICK, |_| 0.7, impairments);
        }
        let most_in_10_minutes = rehearsal.changes.iter().map(|(from_us, _)| {
            rehearsal.changes.iter().filter(|(at_us, _)| (*from_us..from_us + 10 * MINUTE).contains(at_us)).count()
        });
        let most = most_in_10_minutes.max().unwrap_or(0);
        println!("{ambient_c} °C: at most {most} changes in 10 minutes, {} in a day", rehearsal.changes.len());
        assert!(most <= 7, "{ambient_c} °C: {most} changes in 10 minutes");
        assert!(rehearsal.changes.len() <= 70, "{ambient_c} °C: {} changes in a day", rehearsal.changes.len());
    }
}

/// A governor lets each frame take most of the time that the step gives it.
#[test]
fn a_processor_that_slows_down_when_it_has_time_is_tried_on_higher_steps_every_15_minutes() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(MINUTE, |_| 2.5, &[]);
    while rehearsal.now_us < 90 * MINUTE {
        let every = f64::from(rehearsal.adaptation.step().every());
        rehearsal.pass(TICK, |_| 0.9 * every, &[]);
    }
    assert_eq!(rehearsal.steps(), [Step::Third, Step::Half, Step::Turns, Step::Full]);
}

#[test]
fn attempts_to_go_up_under_a_constant_overload_become_as_rare_as_once_an_hour() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(24 * 60 * MINUTE, |_| 2.5, &[]);
    assert!(rehearsal.changes.len() <= 2 * 24 + 5, "{}", rehearsal.changes.len());
}

#[test]
fn while_there_are_no_frames_the_step_stays_and_time_without_frames_is_no_time_without_load() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(5 * S, |_| 2.5, &[]);
    let impaired_by = ImpairmentSet::default();
    let away = Conditions { is_allowed: true, load: None, impaired_by, has_smaller_mode: false };
    (0..3600 * S / TICK).for_each(|_| rehearsal.update(&away));
    assert_eq!(rehearsal.steps(), [Step::Third]);
    rehearsal.pass(9 * S, |_| 0.5, &[]);
    assert_eq!(rehearsal.steps(), [Step::Third]);
}

#[test]
fn settings_that_allow_no_step_end_the_present_one() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(5 * S, |_| 2.5, &[]);
    let load = Some(Load { busy: PERIOD * 3, decoding: Duration::ZERO, camera_period: PERIOD });
    let impaired_by = ImpairmentSet::default();
    let refused = Conditions { is_allowed: false, load, impaired_by, has_smaller_mode: false };
    (0..100).for_each(|_| rehearsal.update(&refused));
    assert_eq!(rehearsal.steps(), [Step::Third, Step::Full]);
}

#[test]
fn the_wait_grows_with_each_attempt_that_fails_and_is_the_least_one_after_an_attempt_that_lasts() {
    let mut wait = ProbeBackoff::default();
    let mut now_us = 0;
    let mut wait_after = |lasted_us: Option<u64>| {
        if let Some(lasted_us) = lasted_us {
            wait.attempt(now_us);
            now_us += lasted_us;
        }
        wait.take_back(now_us, [10, 200]);
        wait.us
    };
    assert_eq!([None, None, Some(59), Some(1), Some(1), Some(1)].map(&mut wait_after), [10, 10, 40, 160, 200, 200]);
    assert_eq!([Some(1199), Some(1200)].map(&mut wait_after), [200, 10]);
}

#[test]
fn a_frame_that_takes_longer_than_three_intervals_of_the_lowest_step_is_too_slow() {
    let is_too_slow = |ms| {
        let load = Load { busy: Duration::from_millis(ms), decoding: Duration::ZERO, camera_period: PERIOD };
        load.is_too_slow_on(Step::Twelfth)
    };
    assert_eq!([100, 1199, 1201].map(is_too_slow), [false, false, true]);
}

/// The conditions if decoding a picture of the present size and the rest take these shares of a frame period, and the step.
fn decoding(decoding: f64, work: f64, step: Step) -> (Conditions, Step) {
    let [decoding, work] = [decoding, work].map(|share| PERIOD.mul_f64(share));
    let load = Some(Load { busy: decoding + work, decoding, camera_period: PERIOD });
    (Conditions { is_allowed: true, load, impaired_by: ImpairmentSet::default(), has_smaller_mode: true }, step)
}

/// The seconds at which the size changes within this time, by the conditions with a small picture or not.
fn sizes_s(seconds: u64, conditions: impl Fn(u64, bool) -> (Conditions, Step)) -> Vec<u64> {
    let mut picture = PictureSize::default();
    let mut update = |now_s: &u64| {
        let (conditions, step) = conditions(*now_s, picture.is_small);
        picture.update(now_s * S, &conditions, step, (step != Step::Full).then_some(Cause::Slow))
    };
    (0..seconds).filter(|now_s| update(now_s)).collect()
}

#[test]
fn a_slow_board_takes_a_small_picture_after_half_a_minute_and_keeps_it_while_a_full_one_would_be_slow() {
    let slow = |_, is_small| if is_small { decoding(0.4, 0.3, Step::Full) } else { decoding(1.6, 0.3, Step::Third) };
    assert_eq!(sizes_s(86_400, slow), [30]);
}

#[test]
fn the_picture_stays_as_it_is_where_a_small_one_gains_no_step_or_does_not_exist() {
    let is_small = |now: (Conditions, Step)| !sizes_s(600, |_, _| now).is_empty();
    let (slow, step) = decoding(1.6, 0.3, Step::Third);
    assert!(is_small((slow, step)));
    assert!(!is_small(decoding(0.1, 1.9, Step::Third)), "decoding is a small part");
    assert!(!is_small((Conditions { has_smaller_mode: false, ..slow }, step)));
    assert!(!is_small(decoding(0.6, 0.3, Step::Full)), "not slow");
    assert!(!is_small((Conditions { load: None, ..slow }, step)), "no camera");
    let mut picture = PictureSize::default();
    let hot = |now_s: &u64| picture.update(now_s * S, &decoding(0.2, 0.3, Step::Half).0, Step::Half, Some(Cause::Hot));
    assert_eq!((0..600).filter(hot).count(), 0);
}

#[test]
fn the_full_size_comes_back_when_the_board_is_fast_again_for_ten_minutes() {
    let slow_until_100_s = |now_s, is_small| match (now_s < 100, is_small) {
        (true, true) => decoding(0.4, 0.3, Step::Full),
        (true, false) => decoding(1.6, 0.3, Step::Third),
        (false, true) => decoding(0.1, 0.1, Step::Full),
        (false, false) => decoding(0.4, 0.1, Step::Full),
    };
    assert_eq!(sizes_s(86_400, slow_until_100_s), [30, 700]);
}

#[test]
fn a_prediction_that_is_wrong_each_time_interrupts_the_face_ever_more_rarely() {
    let wrong = |_, is_small| if is_small { decoding(0.1, 0.1, Step::Full) } else { decoding(1.6, 0.3, Step::Third) };
    let changes = sizes_s(86_400, wrong);
    assert!(changes.len() <= 9, "{changes:?}");
    assert!(changes.windows(2).all(|pair| pair[1] - pair[0] >= 30), "{changes:?}");
}

#[test]
fn settings_that_forbid_it_bring_the_full_size_back_at_once() {
    let mut adaptation = Adaptation::default();
    let (slow, _) = decoding(1.6, 0.3, Step::Third);
    assert!((0..40).any(|now_s| adaptation.update(now_s * S, &slow)[1]) && adaptation.is_picture_small());
    assert!(adaptation.update(41 * S, &Conditions { is_allowed: false, ..slow })[1] && !adaptation.is_picture_small());
}
