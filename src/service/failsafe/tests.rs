//! What the failsafe promises. Time is a number that the tests advance.

use super::*;
use crate::config::LinkSettings;
use crate::link::Pace;

const MS: u64 = 1000;
const FRAME_US: u64 = 33_333;
const SLEW_PER_S: f32 = 4.0;
const SETTINGS: FailsafeSettings =
    FailsafeSettings { live_ms: 150, hold_ms: 300, neutral_ms: 1000, slew_per_s: SLEW_PER_S };

#[test]
fn a_puppet_comes_and_goes_without_a_jump_and_the_face_is_then_followed_at_once_again() {
    let mut run = Run::live(&all(0.2));
    let mut shown = vec![run.pose_after(FRAME_US, &all(0.2))];
    for (hears_puppet, value) in [(true, 1.0), (true, 0.5), (false, 0.2)] {
        run.history.hears_puppet = hears_puppet;
        shown.extend((0..30).map(|_| run.pose_after(FRAME_US, &all(value))));
        assert_eq!(shown.last().unwrap().pose.coefficients[0], value);
    }
    assert!(shown.iter().all(|output| output.state == State::Live));
    let share = fastest(&shown, FRAME_US) / SLEW_PER_S;
    assert!((0.99..1.01).contains(&share), "{share}");
    assert_eq!(run.pose_after(FRAME_US, &all(0.9)).pose.coefficients[0], 0.9);
}

#[test]
fn after_a_pause_of_the_process_the_face_moves_no_farther_than_in_100_ms() {
    const MOST: f32 = SLEW_PER_S * 0.1 + 1e-6;
    for pause_ms in [0, 100, 350, 800, 1000, 60_000] {
        let moved = |run: &mut Run, news: Option<News>| {
            let before = run.history.output.pose.coefficients[0];
            run.now_us += pause_ms * MS;
            (run.news(news).pose.coefficients[0] - before).abs()
        };
        let mut lost = Run::live(&all(1.0));
        let on_the_way_to_neutral = moved(&mut lost, None);
        assert!(on_the_way_to_neutral <= MOST, "{on_the_way_to_neutral} after {pause_ms} ms without news");
        let mut puppet = Run::live(&all(0.0));
        puppet.history.hears_puppet = true;
        let capture_us = puppet.now_us + pause_ms * MS;
        let on_the_way_to_a_puppet = moved(&mut puppet, Some(Ok((all(1.0), capture_us))));
        assert!(on_the_way_to_a_puppet <= MOST, "{on_the_way_to_a_puppet} after {pause_ms} ms to a puppet");
        let mut stopping = Run::live(&all(1.0));
        stopping.now_us += pause_ms * MS;
        let stopped = stopping.failsafe.stop(&mut stopping.history, stopping.now_us);
        assert!(1.0 - stopped.pose.coefficients[0] <= MOST, "{pause_ms} ms before the service stops");
    }
}

struct Run {
    failsafe: Failsafe,
    history: History,
    now_us: u64,
}

fn all(value: f32) -> Pose {
    Pose { coefficients: [value; 52], position_mm: [10.0, 20.0, 600.0], ..Pose::NEUTRAL }
}

fn turned(degrees: f32) -> Pose {
    let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
    Pose { rotation: [0.0, sin, 0.0, cos], ..all(1.0) }
}

fn yaw_deg(pose: &Pose) -> f32 {
    2.0 * pose.rotation[1].atan2(pose.rotation[3]).to_degrees()
}

impl Run {
    fn new() -> Self {
        let failsafe = Failsafe::new(&SETTINGS, FRAME_US);
        let history = History::default();
        Self { failsafe, history, now_us: 5_000_000 }
    }

    /// Follows this pose for two seconds, so that every ramp is over.
    fn live(pose: &Pose) -> Self {
        let mut run = Self::new();
        let last = (0..60).map(|_| run.pose_after(FRAME_US, pose)).last().unwrap();
        assert_eq!((last.state, Some(last.pose)), (State::Live, checked(pose)));
        run
    }

    fn news(&mut self, news: impl Into<Option<News>>) -> Output {
        self.failsafe.update(&mut self.history, self.now_us, news.into().as_ref())
    }

    fn pose_after(&mut self, us: u64, pose: &Pose) -> Output {
        self.now_us += us;
        self.news(Ok((*pose, self.now_us)))
    }

    fn wait(&mut self, us: u64) -> Output {
        self.now_us += us;
        self.news(None)
    }

    fn watch(&mut self, ms: u64) -> Vec<Output> {
        (0..ms).map(|_| self.wait(MS)).collect()
    }
}

/// Returns the states of outputs that are a millisecond apart, and when each begins.
fn transitions(outputs: &[Output]) -> Vec<(u64, State)> {
    let mut states: Vec<_> = (1..).zip(outputs.iter().map(|output| output.state)).collect();
    states.dedup_by_key(|(_, state)| *state);
    states
}

/// Returns the fastest movement of a coefficient between outputs that are `step_us` apart, in units per second.
fn fastest(outputs: &[Output], step_us: u64) -> f32 {
    let moved = |pair: &[Output]| (pair[0].pose.coefficients[0] - pair[1].pose.coefficients[0]).abs();
    outputs.windows(2).map(moved).fold(0.0, f32::max) / (step_us as f32 * 1e-6)
}

#[test]
fn silence_leads_through_hold_and_decay_to_neutral_at_150_300_and_1000_ms_after_the_last_capture() {
    let short = FailsafeSettings { neutral_ms: 310, ..SETTINGS };
    for (what, settings, frame_period_us, late_ms, want_ms, most_per_s) in [
        ("by the settings", SETTINGS, FRAME_US, 0, [150, 300, 1000], 1.0 / 0.7),
        ("from the capture, not the arrival", SETTINGS, FRAME_US, 50, [100, 250, 950], 1.0 / 0.7),
        ("three frames of a slow camera", SETTINGS, 100 * MS, 0, [300, 450, 1150], 1.5),
        ("the slew limit delays neutral", short, FRAME_US, 0, [150, 300, 550], SLEW_PER_S),
    ] {
        let mut run = Run::live(&all(1.0));
        run.now_us += FRAME_US;
        run.news(Ok((all(1.0), run.now_us - late_ms * MS)));
        run.failsafe = Failsafe::new(&settings, frame_period_us);
        let outputs = run.watch(1500);
        let [hold, decay, neutral] = want_ms;
        let want = [(1, State::Live), (hold, State::Hold), (decay, State::Decay), (neutral, State::Neutral)];
        assert_eq!(transitions(&outputs), want, "{what}");
        assert!(outputs.iter().all(|output| output.state != State::Hold || output.pose == all(1.0)), "{what}");
        assert!(fastest(&outputs, MS) <= most_per_s * 1.001, "{what}: {}", fastest(&outputs, MS));
        assert_eq!(outputs.last().unwrap().pose, all(1.0).neutral_here(), "{what}");
    }
    // After a pause of the process, the way to neutral begins at once.
    let mut run = Run::live(&all(1.0));
    let outputs = [1000, 100, 100].map(|ms| run.wait(ms * MS));
    assert_eq!(outputs.each_ref().map(|output| output.state), [State::Decay, State::Decay, State::Neutral]);
    assert_eq!(outputs[2].pose, all(1.0).neutral_here());
}

#[test]
fn what_is_covered_is_said_of_a_live_and_a_held_face_and_of_no_face_on_its_way_to_neutral() {
    let mouth = |value| facewire_packet::Visibility { mouth: value, ..Pose::NEUTRAL.visibility };
    let mut run = Run::live(&Pose { visibility: mouth(0.2), ..all(1.0) });
    for output in run.watch(1500) {
        let is_shown = matches!(output.state, State::Live | State::Hold);
        assert_eq!(output.pose.visibility, mouth(if is_shown { 0.2 } else { 1.0 }), "{:?}", output.state);
    }
    let back: Vec<_> = (0..6).map(|_| run.pose_after(FRAME_US, &Pose { visibility: mouth(0.3), ..all(1.0) })).collect();
    assert!(
        back.iter().all(|output| output.pose.visibility == mouth(if output.state == State::Live { 0.3 } else { 1.0 }))
    );
    assert_eq!(back[5].state, State::Live);
}

#[test]
fn the_head_turns_back_at_a_bounded_rate_and_keeps_its_position() {
    for (degrees, most_deg_per_s, neutral_ms) in [(70.0, 110.0, 1000..1001), (179.0, 190.0, 1290..1300)] {
        let outputs = Run::live(&turned(degrees)).watch(2000);
        let rate = |pair: &[Output]| (yaw_deg(&pair[0].pose) - yaw_deg(&pair[1].pose)).abs() / 1e-3;
        assert!(outputs.windows(2).map(rate).fold(0.0, f32::max) < most_deg_per_s, "{degrees}");
        let (at_ms, state) = transitions(&outputs).pop().unwrap();
        assert!(state == State::Neutral && neutral_ms.contains(&at_ms), "{degrees}: {at_ms}");
        assert_eq!(outputs.last().unwrap().pose, all(1.0).neutral_here());
    }
}

#[test]
fn a_pose_during_hold_is_followed_at_once_by_a_ramp() {
    let mut run = Run::live(&all(0.0));
    run.wait(200 * MS);
    let output = run.pose_after(10 * MS, &all(1.0));
    assert_eq!((output.state, output.reason), (State::Live, Reason::None));
    assert!((output.pose.coefficients[0] - 0.04).abs() < 1e-5);
    let mut fresh = Run::new();
    let pose = (0..3).map(|_| fresh.pose_after(50 * MS, &all(1.0))).last().unwrap().pose;
    assert_eq!(pose.position_mm, [10.0, 20.0, 600.0], "the first pose sets the position without a ramp");
    assert!(pose.coefficients[0] <= 0.2 + 1e-5, "but its expression does not jump");
}

#[test]
fn recovery_takes_three_poses_and_100_ms() {
    for (period_ms, first_live) in [(50, 3), (10, 11)] {
        let mut run = Run::live(&all(0.0));
        run.wait(2000 * MS);
        let mut states = (1..).map(|_| run.pose_after(period_ms * MS, &all(1.0)).state);
        assert_eq!(states.position(|state| state == State::Live), Some(first_live - 1), "every {period_ms} ms");
    }
    // It starts over after a fault or a gap.
    for (interrupt, gap_ms) in [(Some(Err(Reason::NoFace)), 0), (None, 160)] {
        let mut run = Run::live(&all(0.0));
        run.wait(2000 * MS);
        assert!((0..2).all(|_| run.pose_after(60 * MS, &all(1.0)).state == State::Neutral));
        run.now_us += gap_ms * MS;
        run.news(interrupt);
        assert_eq!(run.pose_after(60 * MS, &all(1.0)).state, State::Neutral);
    }
}

#[test]
fn recovery_ramps_from_the_current_output_and_then_follows_exactly() {
    let mut run = Run::live(&all(1.0));
    run.wait(600 * MS);
    let mut show = |ms: u64| if ms.is_multiple_of(33) { run.pose_after(MS, &all(0.8)) } else { run.wait(MS) };
    let outputs: Vec<Output> = (0..1000).map(&mut show).collect();
    assert!(fastest(&outputs, MS) <= SLEW_PER_S * 1.001, "{}", fastest(&outputs, MS));
    assert_eq!(outputs.last().unwrap().pose, all(0.8));
    assert_eq!(run.pose_after(FRAME_US, &all(0.1)).pose, all(0.1), "live and caught up, nothing limits");
}

#[test]
fn every_fault_is_sent_with_its_reason_until_a_pose_is_followed() {
    for reason in [Reason::NoFace, Reason::NoCamera, Reason::Late, Reason::BadResult] {
        let mut run = Run::live(&all(1.0));
        assert_eq!(run.news(Err(reason)).reason, Reason::None, "still live");
        assert_eq!([160, 200, 900].map(|ms| run.wait(ms * MS).reason), [reason; 3]);
        assert_eq!(run.pose_after(50 * MS, &all(1.0)).reason, reason, "one pose does not end it");
    }
    let silent = Run::live(&all(1.0)).wait(160 * MS);
    assert_eq!((silent.reason, silent.age_us), (Reason::Late, 160 * MS), "silence");
    let first = Run::new().news(None);
    assert_eq!((first.state, first.reason, first.age_us), (State::Neutral, Reason::NoCamera, u64::MAX));
}

#[test]
fn a_pose_with_one_bad_number_is_rejected_whole_and_rounding_is_not_bad() {
    let [mut nan, mut beyond] = [all(0.5); 2];
    nan.coefficients[20] = f32::NAN;
    beyond.coefficients[51] = 1.01;
    let rotations = [[0.0, 0.0, 0.0, f32::NAN], [0.0; 4]].map(|rotation| Pose { rotation, ..all(0.5) });
    let far = Pose { position_mm: [0.0, 0.0, f32::INFINITY], ..all(0.5) };
    for bad in [nan, beyond, far].into_iter().chain(rotations) {
        let mut run = Run::live(&all(1.0));
        let output = run.pose_after(FRAME_US, &bad);
        assert_eq!((output.pose, output.followed), (all(1.0), false));
        assert_eq!(run.wait(160 * MS).reason, Reason::BadResult);
    }
    assert_eq!(Run::live(&all(1.0)).pose_after(FRAME_US, &all(1.000_001)).pose, all(1.0));
}

#[test]
fn a_pose_that_is_late_repeated_or_from_the_future_keeps_no_face_live_for_longer() {
    let mut run = Run::live(&all(1.0));
    let capture_us = run.now_us;
    for _ in 1..=150 {
        run.now_us += MS;
        assert!(!run.news(Ok((all(1.0), capture_us))).followed);
    }
    run.now_us += 50 * MS;
    let late = run.news(Ok((all(0.0), run.now_us - 180 * MS)));
    assert_eq!((late.state, late.reason, late.pose), (State::Hold, Reason::Late, all(1.0)));
    let mut run = Run::live(&all(1.0));
    run.news(Ok((all(1.0), run.now_us + 60_000_000)));
    assert_eq!(run.wait(160 * MS).state, State::Hold);
}

#[test]
fn a_clock_that_stands_still_or_steps_back_only_delays() {
    let mut run = Run::live(&all(1.0));
    run.wait(100 * MS);
    assert!((0..1000).all(|_| run.news(None).state == State::Live));
    run.now_us -= 3_000_000;
    assert_eq!(run.news(None).state, State::Live);
    assert_eq!(run.wait(50 * MS).state, State::Hold);
    assert_eq!(run.pose_after(FRAME_US, &all(1.0)).state, State::Live);
}

#[test]
fn packets_come_at_least_10_times_per_second_whatever_the_settings_and_the_camera_are() {
    let patient = FailsafeSettings { live_ms: 5000, hold_ms: 10_000, neutral_ms: 60_000, slew_per_s: 0.1 };
    let link = LinkSettings::default();
    for (settings, frame_period_us) in [(patient, FRAME_US), (SETTINGS, 1_000_000)] {
        let mut run = Run::live(&all(1.0));
        run.failsafe = Failsafe::new(&settings, frame_period_us);
        let mut pace = Pace::default();
        let mut output = run.news(None);
        let mut wait_us = 0;
        let mut silent_us = 0;
        for _ in 0..1000 {
            wait_us = run.failsafe.wait_us(&run.history).min(wait_us);
            output = run.wait(wait_us);
            silent_us += wait_us;
            let (is_due, left_us) = pace.step(&link, 10, run.now_us, &output);
            wait_us = left_us;
            silent_us = if is_due { 0 } else { silent_us };
            assert!(silent_us <= 100 * MS, "{silent_us}, {:?}", output.state);
        }
        assert_eq!(output.state, State::Neutral);
    }
}

#[test]
fn a_face_that_stops_goes_to_neutral_by_the_slew_limit_and_says_why() {
    let mut run = Run::live(&all(1.0));
    for ms in 1..=251_u16 {
        run.now_us += MS;
        let output = run.failsafe.stop(&mut run.history, run.now_us);
        let expected = (1.0 - SLEW_PER_S * f32::from(ms) / 1000.0).max(0.0);
        assert!((output.pose.coefficients[0] - expected).abs() < 1e-4, "{expected} after {ms} ms");
        assert_eq!(output.reason, Reason::Stopping);
        assert_eq!(output.state == State::Decay, output.pose != all(1.0).neutral_here());
        assert!(output.state == State::Neutral || ms < 251);
    }
}
