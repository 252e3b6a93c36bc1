//! Steps over minutes and days, in which the tests only advance the clock.

use super::*;

const S: u64 = 1_000_000;
const MINUTE: u64 = 60 * S;
const TICK: u64 = 50_000;
const PERIOD: Duration = Duration::from_micros(33_333);

/// A load in multiples of the camera's frame period: decoding, and the work on a frame.
fn load(decoding: f64, work: f64) -> Option<Load> {
    let [decoding, work] = [decoding, work].map(|share| PERIOD.mul_f64(share));
    Some(Load { busy: decoding + work, decoding, camera_period: PERIOD })
}

fn conditions(load: Option<Load>, impairments: &[Impairment]) -> Conditions {
    let mut impaired_by = ImpairmentSet::default();
    impairments.iter().for_each(|impairment| impaired_by.set(*impairment, true));
    Conditions { is_allowed: true, load, impaired_by, has_smaller_mode: false }
}

/// An adaptation with its clock and its changes: when, and to which step.
#[derive(Default)]
struct Rehearsal {
    adaptation: Adaptation,
    now_us: u64,
    changes: Vec<(u64, Step)>,
}

impl Rehearsal {
    /// Lets time pass under the work on a frame, as a multiple of the camera's frame period, and impairments.
    fn pass(&mut self, duration_us: u64, work: impl Fn(u64) -> f64, impairments: &[Impairment]) -> &mut Self {
        let end_us = self.now_us + duration_us;
        while self.now_us < end_us {
            self.update(&conditions(load(0.0, work(self.now_us)), impairments));
        }
        self
    }

    fn update(&mut self, conditions: &Conditions) {
        let before = self.adaptation.step;
        self.adaptation.update(self.now_us, conditions);
        assert_eq!(self.adaptation.cause.is_none(), self.adaptation.step == Step::Full);
        if self.adaptation.step != before {
            self.changes.push((self.now_us, self.adaptation.step));
        }
        self.now_us += TICK;
    }

    fn steps(&self) -> Vec<Step> {
        self.changes.iter().map(|(_, step)| *step).collect()
    }
}

fn steps_after_10_minutes(work: impl Fn(u64) -> f64, impairments: &[Impairment]) -> Vec<Step> {
    Rehearsal::default().pass(10 * MINUTE, work, impairments).steps()
}

#[test]
fn the_option_step_accepts_the_names_that_the_metrics_show() {
    use clap::ValueEnum as _;
    assert!(Step::ALL.into_iter().all(|step| Step::from_str(step.name(), false) == Ok(step)));
}

#[test]
fn each_step_takes_less_of_the_processors_time_and_none_is_slower_than_two_frames_a_second() {
    let share = |step: Step| load(0.0, 3.0).unwrap().share_on(step);
    assert!(Step::ALL.windows(2).all(|pair| share(pair[1]) < share(pair[0])));
    assert_eq!(Step::Turns.full_busy(Step::Turns.busy(PERIOD)), PERIOD);
    let last = |fps: u32| Step::ALL.into_iter().rfind(|step| step.suits(Duration::from_secs(1) / fps)).unwrap();
    assert_eq!([30, 15, 5, 1].map(last), [Step::Twelfth, Step::Sixth, Step::Half, Step::Turns]);
    let after_a_fast_camera = |fps: u32| Step::Twelfth.period(Duration::from_secs(1) / fps);
    assert_eq!([5, 1].map(after_a_fast_camera), [500, 1000].map(Duration::from_millis));
}

#[test]
fn a_constant_overload_changes_the_step_once_within_a_second_and_never_again_in_10_minutes() {
    for (work, step) in [(1.02, Step::Turns), (1.5, Step::Half), (4.04, Step::Sixth), (40.0, Step::Twelfth)] {
        let mut rehearsal = Rehearsal::default();
        rehearsal.pass(10 * MINUTE, |_| work, &[]);
        assert!(rehearsal.steps() == [step] && rehearsal.changes[0].0 < S, "{work}: {:?}", rehearsal.changes);
    }
}

#[test]
fn a_disturbance_of_less_than_half_a_second_changes_nothing_and_neither_does_any_other_impairment() {
    assert_eq!(steps_after_10_minutes(|now_us| if now_us % (2 * S) < 450_000 { 5.0 } else { 0.3 }, &[]), []);
    assert_eq!(steps_after_10_minutes(|_| 0.1, &[Impairment::Dark, Impairment::SlowGovernor]), []);
}

#[test]
fn after_an_overload_the_step_goes_straight_up_to_what_was_possible_for_10_s() {
    for (work, step) in [(0.4, Step::Full), (1.6, Step::Half)] {
        let mut rehearsal = Rehearsal::default();
        rehearsal.pass(MINUTE, |_| 8.0, &[]).pass(MINUTE, |_| work, &[]);
        assert_eq!(rehearsal.steps(), [Step::Twelfth, step]);
        assert!((MINUTE + 10 * S..MINUTE + 11 * S).contains(&rehearsal.changes[1].0), "{:?}", rehearsal.changes);
    }
}

#[test]
fn a_noisy_load_near_a_threshold_changes_the_step_at_most_3_times_in_10_minutes() {
    for work in [0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.7, 1.9, 2.0, 2.1, 4.0, 8.0] {
        for spread in [0.02, 0.1, 0.3] {
            // Each value lasts for 400 ms, as it does in a quantile of sixteen frames.
            let noise = |now_us| fastrand::Rng::with_seed(now_us / 400_000).f64() * 2.0 - 1.0;
            let steps = steps_after_10_minutes(|now_us| work * (1.0 + spread * noise(now_us)), &[]);
            assert!(steps.len() <= 3, "{work} {spread}: {steps:?}");
        }
    }
}

#[test]
fn heat_takes_the_rate_down_to_a_quarter_one_step_a_minute_and_up_again_one_step_every_2() {
    for (impairment, cause) in [(Impairment::Hot, Cause::Hot), (Impairment::Undervoltage, Cause::Undervoltage)] {
        let mut rehearsal = Rehearsal::default();
        rehearsal.pass(60 * MINUTE, |_| 0.1, &[impairment]);
        let changed = (rehearsal.steps(), rehearsal.adaptation.cause);
        assert_eq!(changed, (vec![Step::Half], Some(cause)), "facewire heats little");
    }
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(4 * MINUTE, |_| 0.8, &[Impairment::Hot]).pass(10 * MINUTE, |_| 0.8, &[]);
    let want = [Step::Half, Step::Third, Step::Quarter, Step::Third, Step::Half, Step::Turns, Step::Full];
    assert_eq!(rehearsal.steps(), want);
    let times_s: Vec<u64> = rehearsal.changes.iter().map(|(at_us, _)| at_us / S).collect();
    assert!(times_s[..3] == [0, 60, 120] && times_s[3..].windows(2).all(|pair| pair[1] - pair[0] >= 120));
}

/// A processor that warms up by what facewire takes, with a time constant of a minute, and is hot from 80 degrees until
/// it is below 75.
#[test]
fn heat_that_follows_the_load_does_not_make_the_steps_oscillate() {
    for ambient_c in [30.0, 40.0, 50.0, 60.0, 70.0, 78.0] {
        let mut rehearsal = Rehearsal::default();
        let mut temperature_c = ambient_c;
        let mut is_hot = false;
        while rehearsal.now_us < 24 * 60 * MINUTE {
            let step = rehearsal.adaptation.step;
            let share = step.busy(PERIOD).div_duration_f64(step.period(PERIOD));
            temperature_c += (ambient_c + 60.0 * share - temperature_c) * TICK as f64 / MINUTE as f64;
            is_hot = temperature_c >= if is_hot { 75.0 } else { 80.0 };
            rehearsal.pass(TICK, |_| 0.7, if is_hot { &[Impairment::Hot] } else { &[] });
        }
        let times_us: Vec<u64> = rehearsal.changes.iter().map(|(at_us, _)| *at_us).collect();
        // Eight changes never come within ten minutes.
        assert!(times_us.windows(8).all(|times_us| times_us[7] - times_us[0] >= 10 * MINUTE), "{ambient_c} °C");
        assert!(times_us.len() <= 70, "{ambient_c} °C: {} changes in a day", times_us.len());
    }
}

/// A governor lets each frame take most of the time that the step gives it.
#[test]
fn a_processor_that_slows_down_when_it_has_time_is_tried_on_higher_steps_every_15_minutes() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(MINUTE, |_| 2.5, &[]);
    while rehearsal.now_us < 90 * MINUTE {
        let every = f64::from(rehearsal.adaptation.step.every());
        rehearsal.pass(TICK, |_| 0.9 * every, &[]);
    }
    assert_eq!(rehearsal.steps(), [Step::Third, Step::Half, Step::Turns, Step::Full]);
}

#[test]
fn while_there_are_no_frames_the_step_stays_and_time_without_frames_is_no_time_without_load() {
    let mut rehearsal = Rehearsal::default();
    rehearsal.pass(5 * S, |_| 2.5, &[]);
    (0..3600 * S / TICK).for_each(|_| rehearsal.update(&conditions(None, &[])));
    rehearsal.pass(9 * S, |_| 0.5, &[]);
    assert_eq!(rehearsal.steps(), [Step::Third]);
}

#[test]
fn a_board_on_whose_lowest_step_frames_take_longer_than_three_intervals_is_too_slow_also_if_it_becomes_so_there() {
    let is_too_slow = |first_ms: f64, then_ms: f64| {
        let mut rehearsal = Rehearsal::default();
        let work = |ms: f64| move |_| ms / PERIOD.as_secs_f64() / 1000.0;
        rehearsal.pass(5 * S, work(first_ms), &[]).pass(5 * S, work(then_ms), &[]);
        rehearsal.adaptation.is_too_slow
    };
    assert_eq!([100.0, 1199.0, 1201.0].map(|ms| is_too_slow(ms, ms)), [false, false, true]);
    assert!(is_too_slow(380.0, 1201.0) && !is_too_slow(1201.0, 380.0));
}

/// The seconds at which the size of the picture changes, by the shares of a frame period that decoding a picture of the
/// present size and the rest take, and the step.
fn sizes_s(seconds: u64, now: impl Fn(u64, bool) -> (f64, f64, Step)) -> Vec<u64> {
    let mut picture = PictureSize::default();
    let mut is_changed = |now_s: &u64| {
        let before = picture.is_small;
        let (decoding, work, step) = now(*now_s, before);
        let conditions = Conditions { has_smaller_mode: true, ..conditions(load(decoding, work), &[]) };
        picture.update(now_s * S, &conditions, step, (step != Step::Full).then_some(Cause::Slow));
        picture.is_small != before
    };
    (0..seconds).filter(|now_s| is_changed(now_s)).collect()
}

#[test]
fn a_slow_board_takes_a_small_picture_after_half_a_minute_and_keeps_it_while_a_full_one_would_be_slow() {
    let slow = |_, is_small| if is_small { (0.4, 0.3, Step::Full) } else { (1.6, 0.3, Step::Third) };
    assert_eq!(sizes_s(86_400, slow), [30]);
    assert!(sizes_s(600, |_, _| (0.1, 1.9, Step::Third)).is_empty(), "decoding is a small part");
    assert!(sizes_s(600, |_, _| (0.6, 0.3, Step::Full)).is_empty(), "not slow");
}

#[test]
fn the_full_size_comes_back_when_the_board_is_fast_again_for_ten_minutes() {
    let slow_until_100_s = |now_s, is_small| match (now_s < 100, is_small) {
        (true, true) => (0.4, 0.3, Step::Full),
        (true, false) => (1.6, 0.3, Step::Third),
        (false, true) => (0.1, 0.1, Step::Full),
        (false, false) => (0.4, 0.1, Step::Full),
    };
    assert_eq!(sizes_s(86_400, slow_until_100_s), [30, 700]);
}

#[test]
fn a_prediction_that_is_wrong_each_time_interrupts_the_face_ever_more_rarely() {
    let wrong = |_, is_small| if is_small { (0.1, 0.1, Step::Full) } else { (1.6, 0.3, Step::Third) };
    let changes = sizes_s(86_400, wrong);
    assert!(changes.len() <= 9 && changes.windows(2).all(|pair| pair[1] - pair[0] >= 30), "{changes:?}");
}

#[test]
fn settings_that_allow_no_step_end_the_present_one_and_bring_the_full_size_back() {
    let slow = Conditions { has_smaller_mode: true, ..conditions(load(1.6, 0.3), &[]) };
    let mut adaptation = Adaptation::default();
    (0..40).for_each(|now_s| adaptation.update(now_s * S, &slow));
    assert!(adaptation.step > Step::Full && adaptation.picture.is_small);
    adaptation.update(41 * S, &Conditions { is_allowed: false, ..slow });
    assert!(adaptation.step == Step::Full && !adaptation.picture.is_small);
}
