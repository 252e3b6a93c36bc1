//! What the failsafe promises. Time is a number that the tests advance.
#![allow(clippy::float_cmp)]

use super::*;
use crate::config::LinkSettings;
use crate::link::{Pace, Sent};

const MS: u64 = 1000;
/// Frame period of a camera with 30 frames per second.
const FRAME_US: u64 = 33_333;
const SLEW_PER_S: f32 = 4.0;

struct Run {
    failsafe: Failsafe,
    history: History,
    now_us: u64,
    /// What a link with the default pace sent last.
    sent: Option<Sent>,
}

fn settings() -> FailsafeSettings {
    FailsafeSettings { live_ms: 150, hold_ms: 300, neutral_ms: 1000, slew_per_s: SLEW_PER_S }
}

fn all(value: f32) -> Pose {
    Pose { coefficients: [value; 52], position_mm: [10.0, 20.0, 600.0], ..Pose::NEUTRAL }
}

/// Returns a head turned about the vertical axis.
fn turned(degrees: f32) -> Pose {
    let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
    Pose { rotation: [0.0, sin, 0.0, cos], ..all(1.0) }
}

fn yaw_deg(pose: &Pose) -> f32 {
    2.0 * pose.rotation[1].atan2(pose.rotation[3]).to_degrees()
}

impl Run {
    fn new() -> Self {
        let (failsafe, history) = (Failsafe::new(&settings(), FRAME_US), History::default());
        Self { failsafe, history, now_us: 5_000_000, sent: None }
    }

    /// Follows this pose for two seconds, so that every ramp is over.
    fn live(pose: &Pose) -> Self {
        let mut run = Self::new();
        for _ in 0..60 {
            run.now_us += FRAME_US;
            run.pose(pose);
        }
        assert_eq!(run.history.state, State::Live);
        assert_eq!(Some(run.history.shown), pose.checked());
        run
    }

    /// Gives a pose captured at this moment.
    fn pose(&mut self, pose: &Pose) -> Output {
        self.news(News::Pose(*pose, self.now_us))
    }

    fn news(&mut self, news: News) -> Output {
        self.failsafe.update(&mut self.history, self.now_us, &news)
    }

    /// Offers the output to a link with the default pace. Returns whether the link sends it.
    fn sends(&mut self, output: &Output, rate_hz: u32) -> bool {
        let pace = Pace::new(&LinkSettings::default(), rate_hz);
        let is_due = pace.is_due(self.sent.as_ref(), self.now_us, output);
        if is_due {
            self.sent = Some(pace.sent(self.sent.as_ref(), self.now_us, output));
        }
        is_due
    }

    /// Lets a sender run as long as it may wait. Returns the output, whether it was sent, and how long that took.
    fn wait_as_told(&mut self, last: &Output, rate_hz: u32) -> (Output, bool, u64) {
        let pace = Pace::new(&LinkSettings::default(), rate_hz);
        let wait_us = pace.wait_us(self.sent.as_ref(), self.now_us, last).min(self.failsafe.wait_us(&self.history));
        let output = self.wait(wait_us);
        let is_sent = self.sends(&output, rate_hz);
        (output, is_sent, wait_us)
    }

    fn wait(&mut self, us: u64) -> Output {
        self.now_us += us;
        self.news(News::Nothing)
    }

    /// Lets this time pass in steps of a millisecond, and returns the output of every step.
    fn watch(&mut self, us: u64) -> Vec<(u64, Output)> {
        let begin_us = self.now_us;
        (0..us / MS)
            .map(|_| {
                let output = self.wait(MS);
                (self.now_us - begin_us, output)
            })
            .collect()
    }
}

/// Returns the times at which the state changes.
fn transitions(outputs: &[(u64, Output)]) -> Vec<(u64, State)> {
    let mut changes: Vec<(u64, State)> = Vec::new();
    for (at_us, output) in outputs {
        if changes.last().is_none_or(|(_, state)| *state != output.state) {
            changes.push((at_us / MS, output.state));
        }
    }
    changes
}

/// Returns the fastest movement of a coefficient between consecutive outputs, in units per second.
fn fastest(outputs: &[(u64, Output)]) -> f32 {
    let steps = outputs.windows(2).map(|pair| {
        let [(from_us, from), (to_us, to)] = pair else {
            return 0.0;
        };
        let seconds = Duration::from_micros(to_us - from_us).as_secs_f32();
        let moved = from.pose.coefficients.iter().zip(to.pose.coefficients);
        moved.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) / seconds
    });
    steps.fold(0.0, f32::max)
}

#[test]
fn silence_leads_through_hold_and_decay_to_neutral_at_150_300_and_1000_ms() {
    let outputs = Run::live(&all(1.0)).watch(1500 * MS);
    let want = [(1, State::Live), (150, State::Hold), (300, State::Decay), (1000, State::Neutral)];
    assert_eq!(transitions(&outputs), want);
}

#[test]
fn times_count_from_the_capture_of_the_last_pose_not_from_its_arrival() {
    let mut run = Run::live(&all(1.0));
    run.now_us += FRAME_US;
    run.news(News::Pose(all(0.9), run.now_us - 50 * MS));
    let want = [(1, State::Live), (100, State::Hold), (250, State::Decay), (950, State::Neutral)];
    assert_eq!(transitions(&run.watch(1500 * MS)), want);
}

#[test]
fn slow_cameras_move_all_times_by_what_three_frames_take_longer() {
    let mut run = Run::live(&all(1.0));
    run.failsafe = Failsafe::new(&settings(), 100 * MS);
    let want = [(1, State::Live), (300, State::Hold), (450, State::Decay), (1150, State::Neutral)];
    assert_eq!(transitions(&run.watch(1500 * MS)), want);
}

#[test]
fn hold_stands_still_and_decay_never_moves_faster_than_the_slew_limit() {
    let outputs = Run::live(&all(1.0)).watch(1500 * MS);
    let held = outputs.iter().filter(|(_, output)| output.state == State::Hold);
    assert!(held.clone().count() == 150 && held.clone().all(|(_, output)| output.pose == all(1.0)));
    assert!(fastest(&outputs) <= 1.0 / 0.7 * 1.001, "{}", fastest(&outputs));
    let last = outputs.last().map(|(_, output)| output.pose);
    assert_eq!(last, Some(all(1.0).neutral_here()));
}

#[test]
fn a_short_decay_is_limited_by_the_slew_rate_and_delays_neutral() {
    let mut run = Run::live(&all(1.0));
    let short = FailsafeSettings { neutral_ms: 310, ..settings() };
    run.failsafe = Failsafe::new(&short, FRAME_US);
    let outputs = run.watch(1000 * MS);
    assert!(fastest(&outputs) <= SLEW_PER_S * 1.001, "{}", fastest(&outputs));
    assert_eq!(transitions(&outputs).last(), Some(&(550, State::Neutral)));
}

#[test]
fn neutral_is_complete_by_its_time_even_when_no_update_came_before() {
    let mut run = Run::live(&all(1.0));
    let output = run.wait(1000 * MS);
    assert_eq!((output.state, output.pose), (State::Neutral, all(1.0).neutral_here()));
}

#[test]
fn the_head_turns_back_at_a_bounded_rate_by_the_time_of_neutral_and_keeps_its_position() {
    let outputs = Run::live(&turned(70.0)).watch(1500 * MS);
    let rates = outputs.windows(2).map(|pair| match pair {
        [(_, from), (_, to)] => (yaw_deg(&from.pose) - yaw_deg(&to.pose)).abs() / 1e-3,
        _ => 0.0,
    });
    assert!(rates.fold(0.0, f32::max) < 110.0, "70 degrees in 700 ms are 100 a second");
    let last = outputs.last().map(|(_, output)| output.pose);
    assert_eq!(last, Some(all(1.0).neutral_here()));
}

#[test]
fn a_head_that_looks_backwards_decays_at_180_degrees_per_second() {
    let outputs = Run::live(&turned(179.0)).watch(2000 * MS);
    let (at_ms, state) = transitions(&outputs).pop().unwrap_or_default();
    assert_eq!(state, State::Neutral);
    assert!((1290..1300).contains(&at_ms), "{at_ms}: 179 degrees take 994 ms");
}

#[test]
fn a_pose_during_hold_is_followed_at_once_by_a_ramp() {
    let mut run = Run::live(&all(0.0));
    run.wait(200 * MS);
    run.now_us += 10 * MS;
    let output = run.pose(&all(1.0));
    assert_eq!((output.state, output.reason), (State::Live, Reason::None));
    assert!((output.pose.coefficients[0] - 0.04).abs() < 1e-5);
}

#[test]
fn recovery_takes_three_poses_and_100_ms() {
    let mut slow = Run::live(&all(0.0));
    slow.wait(2000 * MS);
    let states: Vec<State> = (0..4)
        .map(|_| {
            slow.now_us += 50 * MS;
            slow.pose(&all(1.0)).state
        })
        .collect();
    assert_eq!(states, [State::Neutral, State::Neutral, State::Live, State::Live]);

    let mut quick = Run::live(&all(0.0));
    quick.wait(2000 * MS);
    let states = (0..12).map(|_| {
        quick.now_us += 10 * MS;
        quick.pose(&all(1.0)).state
    });
    assert_eq!(states.filter(|state| *state == State::Live).count(), 2, "at 100 and 110 ms");
}

#[test]
fn recovery_starts_over_after_a_fault_or_a_gap() {
    for interrupt in [News::Fault(Reason::NoFace), News::Nothing] {
        let mut run = Run::live(&all(0.0));
        run.wait(2000 * MS);
        for _ in 0..2 {
            run.now_us += 60 * MS;
            run.pose(&all(1.0));
        }
        run.now_us += if matches!(interrupt, News::Nothing) { 160 * MS } else { 0 };
        run.news(interrupt);
        run.now_us += 60 * MS;
        assert_eq!(run.pose(&all(1.0)).state, State::Neutral);
    }
}

#[test]
fn recovery_ramps_from_the_current_output_and_then_follows_exactly() {
    let mut run = Run::live(&all(1.0));
    run.wait(600 * MS);
    let mut outputs = Vec::new();
    for ms in 0..1000 {
        run.now_us += MS;
        let at_us = run.now_us;
        let output = if ms % 33 == 0 { run.pose(&all(0.8)) } else { run.news(News::Nothing) };
        outputs.push((at_us, output));
    }
    assert!(fastest(&outputs) <= SLEW_PER_S * 1.001, "{}", fastest(&outputs));
    assert_eq!(run.history.shown, all(0.8));
    run.now_us += FRAME_US;
    assert_eq!(run.pose(&all(0.1)).pose, all(0.1), "live and caught up, nothing limits");
}

#[test]
fn the_first_pose_sets_the_position_without_a_ramp() {
    let mut run = Run::new();
    let output = (0..3)
        .map(|_| {
            run.now_us += 50 * MS;
            run.pose(&all(1.0))
        })
        .last();
    let pose = output.map_or(Pose::NEUTRAL, |output| output.pose);
    assert_eq!(pose.position_mm, [10.0, 20.0, 600.0]);
    assert!(pose.coefficients[0] <= 0.2 + 1e-5, "but its expression does not jump");
}

#[test]
fn every_fault_is_sent_with_its_reason_until_a_pose_is_followed() {
    for reason in [Reason::NoFace, Reason::NoCamera, Reason::Late, Reason::BadResult] {
        let mut run = Run::live(&all(1.0));
        assert_eq!(run.news(News::Fault(reason)).reason, Reason::None, "still live");
        for us in [160 * MS, 200 * MS, 900 * MS] {
            assert_eq!(run.wait(us).reason, reason);
        }
        run.now_us += 50 * MS;
        assert_eq!(run.pose(&all(1.0)).reason, reason, "one pose does not end it");
    }
}

#[test]
fn silence_without_a_known_fault_has_the_reason_late() {
    assert_eq!(Run::live(&all(1.0)).wait(160 * MS).reason, Reason::Late);
}

#[test]
fn before_the_first_frame_the_face_is_neutral_because_there_is_no_camera() {
    let output = Run::new().news(News::Nothing);
    assert_eq!((output.state, output.reason), (State::Neutral, Reason::NoCamera));
    assert_eq!((output.pose, output.age_us), (Pose::NEUTRAL, u64::MAX));
}

#[test]
fn a_pose_with_one_bad_number_is_rejected_whole() {
    let mut nan = all(0.5);
    nan.coefficients[20] = f32::NAN;
    let mut beyond = all(0.5);
    beyond.coefficients[51] = 1.01;
    let bad_rotation = Pose { rotation: [0.0, 0.0, 0.0, f32::NAN], ..all(0.5) };
    let no_rotation = Pose { rotation: [0.0; 4], ..all(0.5) };
    let far = Pose { position_mm: [0.0, 0.0, f32::INFINITY], ..all(0.5) };
    for bad in [nan, beyond, bad_rotation, no_rotation, far] {
        let mut run = Run::live(&all(1.0));
        run.now_us += FRAME_US;
        let output = run.pose(&bad);
        assert_eq!((output.pose, output.followed), (all(1.0), false));
        assert_eq!(run.wait(160 * MS).reason, Reason::BadResult);
    }
}

#[test]
fn rounding_beyond_0_and_1_is_clamped_not_rejected() {
    let mut run = Run::live(&all(1.0));
    run.now_us += FRAME_US;
    assert_eq!(run.pose(&all(1.000_001)).pose, all(1.0));
}

#[test]
fn poses_that_come_too_late_are_not_followed() {
    let mut run = Run::live(&all(1.0));
    run.now_us += 200 * MS;
    let output = run.news(News::Pose(all(0.0), run.now_us - 180 * MS));
    assert_eq!((output.state, output.reason, output.pose), (State::Hold, Reason::Late, all(1.0)));
}

#[test]
fn a_repeated_pose_changes_nothing() {
    let mut run = Run::live(&all(1.0));
    let capture_us = run.now_us;
    for ms in 1..=150 {
        run.now_us += MS;
        assert!(!run.news(News::Pose(all(1.0), capture_us)).followed, "{ms}");
    }
    assert_eq!(run.history.state, State::Hold);
}

#[test]
fn the_age_counts_from_the_pose_that_the_output_follows() {
    let mut run = Run::live(&all(1.0));
    let capture_us = run.now_us;
    let output = run.wait(2000 * MS);
    assert_eq!((output.age_us, output.capture_us), (2000 * MS, capture_us));
    run.now_us += 50 * MS;
    assert_eq!(run.pose(&all(1.0)).age_us, 2050 * MS, "not followed yet");
}

#[test]
fn a_clock_that_stands_still_or_steps_back_only_delays() {
    let mut run = Run::live(&all(1.0));
    run.wait(100 * MS);
    for _ in 0..1000 {
        assert_eq!(run.news(News::Nothing).state, State::Live);
    }
    run.now_us -= 3_000_000;
    assert_eq!(run.news(News::Nothing).state, State::Live);
    assert_eq!(run.wait(50 * MS).state, State::Hold);
    run.now_us += FRAME_US;
    assert_eq!(run.pose(&all(1.0)).state, State::Live);
}

#[test]
fn a_pose_from_the_future_is_not_live_for_longer() {
    let mut run = Run::live(&all(1.0));
    run.news(News::Pose(all(1.0), run.now_us + 60_000_000));
    assert_eq!(run.wait(160 * MS).state, State::Hold);
}

#[test]
fn a_live_face_is_sent_with_every_pose_and_again_when_it_has_stood_still_for_100_ms() {
    let mut run = Run::live(&all(1.0));
    run.now_us += FRAME_US;
    let followed = run.pose(&all(0.9));
    assert!(run.sends(&followed, 60));
    let (again, is_sent, waited_us) = run.wait_as_told(&followed, 60);
    assert_eq!((is_sent, waited_us), (true, 100 * MS));
    assert_eq!((again.state, again.pose, again.age_us), (State::Live, all(0.9), 100 * MS));
    let (hold, is_sent, waited_us) = run.wait_as_told(&again, 60);
    assert_eq!((hold.state, is_sent, waited_us), (State::Hold, true, 50 * MS));
}

#[test]
fn packets_come_at_least_10_times_per_second_whatever_the_settings_and_the_camera_are() {
    let patient = FailsafeSettings { live_ms: 5000, hold_ms: 10_000, neutral_ms: 60_000, slew_per_s: 0.1 };
    for (settings, frame_period_us) in [(patient, FRAME_US), (settings(), 1_000_000)] {
        let mut run = Run::live(&all(1.0));
        run.failsafe = Failsafe::new(&settings, frame_period_us);
        let (mut silent_us, mut output) = (0, run.news(News::Nothing));
        for _ in 0..1000 {
            let (next, is_sent, waited_us) = run.wait_as_told(&output, 10);
            silent_us = if is_sent { 0 } else { silent_us + waited_us };
            assert!(silent_us <= 100 * MS, "{silent_us}, {:?}", run.history.state);
            output = next;
        }
        assert_eq!(run.history.state, State::Neutral);
    }
}

#[test]
fn hold_and_decay_are_sent_at_the_rate_and_a_neutral_face_10_times_per_second() {
    let mut run = Run::live(&all(1.0));
    let (begin_us, mut sent, mut output) = (run.now_us, Vec::new(), run.news(News::Nothing));
    while run.now_us < begin_us + 3_000_000 {
        let (next, is_sent, waited_us) = run.wait_as_told(&output, 60);
        assert!(waited_us > 0 || sent.is_empty(), "waiting makes progress");
        sent.extend(is_sent.then_some(next.state));
        output = next;
    }
    let count = |state| sent.iter().filter(|sent| **sent == state).count();
    assert!((9..=10).contains(&count(State::Hold)), "150 ms at 60 Hz: {}", count(State::Hold));
    assert!((41..=43).contains(&count(State::Decay)), "700 ms at 60 Hz: {}", count(State::Decay));
    assert!((20..=21).contains(&count(State::Neutral)), "2 s at 10 Hz: {}", count(State::Neutral));
}

#[test]
fn a_change_of_reason_is_sent_at_once() {
    let mut run = Run::live(&all(1.0));
    let output = run.wait(2000 * MS);
    run.sends(&output, 60);
    for is_sent in [true, false] {
        run.now_us += MS;
        let output = run.news(News::Fault(Reason::NoCamera));
        assert_eq!(run.sends(&output, 60), is_sent);
    }
}

#[test]
fn a_face_that_stops_goes_to_neutral_by_the_slew_limit_and_says_why() {
    let mut run = Run::live(&all(1.0));
    for ms in 1..=250_u16 {
        run.now_us += MS;
        let output = run.failsafe.stop(&mut run.history, run.now_us);
        let expected = 1.0 - SLEW_PER_S * f32::from(ms) / 1000.0;
        assert!((output.pose.coefficients[0] - expected).abs() < 1e-4, "{expected} after {ms} ms");
        assert_eq!(output.reason, Reason::Stopping);
        assert_eq!(output.state == State::Decay, output.pose != all(1.0).neutral_here());
    }
    run.now_us += MS;
    let output = run.failsafe.stop(&mut run.history, run.now_us);
    assert_eq!((output.state, output.pose), (State::Neutral, all(1.0).neutral_here()));
}
