//! Decides on which [`Step`] the pipeline runs: down when the board is too slow, hot or badly supplied, up again later;
//! and whether the camera is opened with half the width and height, because decoding takes too long.
//!
//! It is a pure state machine, stepped by time. Too slow means that four in sixteen frames take longer than their step
//! allows, for half a second. The step then follows from what a frame takes, so that a constant load changes it once. It
//! goes up when a frame has taken little enough for the step above for [`Cause::calm_us`]. A step up that fails
//! multiplies this time, so that no load makes the steps oscillate. A governor that saves power slows the processor down
//! when there is less to do, so that a frame seems to take long: therefore the step above is tried from time to time.
//! Opening the camera again interrupts the face, so a small picture is chosen only if the time saved lets the pipeline go
//! up a step.

#[cfg(test)]
mod tests;

use std::time::Duration;

use super::failsafe::LIVE_FRAMES;
use facewire_board::{Impairment, ImpairmentSet};

/// Longest time between two processed frames. A face that moves less often than twice a second is of no use, and the
/// failsafe would take longer to notice a lost camera.
const LONGEST_PERIOD: Duration = Duration::from_millis(500);
/// Time of a frame, with its decoding, if the networks for lips and eyes take turns: percent of one on which all run.
const TURNS_PERCENT: u32 = 90;
/// Share of the time between two processed frames that a frame may take on a step that is chosen on the way down.
const FITS: f64 = 0.95;
/// Share of that time that a frame must not exceed on a step before the pipeline goes up to it.
const FITS_WELL: f64 = 0.85;
/// Frames must take too long for this time. Shorter disturbances have passed before a lower step would help.
const OVERLOAD_US: u64 = 500_000;
/// Time between two steps down because of heat or low voltage: a processor takes this long to cool down noticeably.
const THROTTLED_US: u64 = 60_000_000;
/// The lowest step because of heat or low voltage. Lower ones would save little more than its three quarters.
const LOWEST_THROTTLED: Step = Step::Quarter;
/// Below `half`, heat and low voltage take the pipeline down only while frames keep the hot loop busy for more than this
/// share of the time. Otherwise something else heats the board.
const WORTH_SAVING: f64 = 0.2;
/// Time after which the step above is tried even though a frame seems to take too long for it.
const PROBE_US: u64 = 900_000_000;
/// Longest wait before the next attempt at something better, such as a higher step.
const LONGEST_WAIT_US: u64 = 3_600_000_000;
/// An attempt has failed if it is taken back within this multiple of the wait before it. Then the wait grows.
const PROVEN_AFTER: u64 = 6;
const GROWTH: u64 = 4;
/// The pipeline must have been on a lower step for this time before a small picture is chosen.
const SMALL_AFTER_US: u64 = 30_000_000;
/// A full-sized picture must have been possible for this time before it returns: at first, and at most after failures.
const FULL_AFTER_US: [u64; 2] = [600_000_000, 86_400_000_000];
/// A picture of half the width and height has this share of the pixels.
const SMALL_SHARE: u32 = 4;

/// What the pipeline does, from all that it can do down to what a very slow board can do: a later step takes less of the
/// processor's time. docs/faults.md says what each costs; `scripts/measure-steps` measures it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, clap::ValueEnum)]
pub enum Step {
    /// Every frame, with all networks.
    #[default]
    Full,
    /// Every frame; of the three networks for lips and eyes, one runs on each frame.
    Turns,
    /// One frame in two, with all networks.
    Half,
    Third,
    Quarter,
    Sixth,
    Eighth,
    Twelfth,
}

impl Step {
    pub const ALL: [Self; 8] =
        [Self::Full, Self::Turns, Self::Half, Self::Third, Self::Quarter, Self::Sixth, Self::Eighth, Self::Twelfth];

    pub fn name(self) -> &'static str {
        let names = ["full", "turns", "half", "third", "quarter", "sixth", "eighth", "twelfth"];
        names.get(self as usize).copied().unwrap_or_default()
    }

    /// One in this many of the camera's frames is processed.
    pub fn every(self) -> u32 {
        [1, 1, 2, 3, 4, 6, 8, 12].get(self as usize).copied().unwrap_or(1)
    }

    pub fn has_turns(self) -> bool {
        self == Self::Turns
    }

    pub(super) fn sentence(self) -> String {
        match self {
            Self::Full => "every frame is processed".to_owned(),
            Self::Turns => "the networks for lips and eyes take turns".to_owned(),
            lower => format!("one frame in {} is processed", lower.every()),
        }
    }

    /// Time between two processed frames. A step that was chosen for a faster camera takes more frames of this one.
    pub(super) fn period(self, camera: Duration) -> Duration {
        (camera * self.every()).min(LONGEST_PERIOD.max(camera))
    }

    /// Whether the step takes every frame, or at least two a second of a camera with this frame period.
    fn suits(self, camera: Duration) -> bool {
        self.every() == 1 || camera * self.every() <= LONGEST_PERIOD
    }

    /// How long a frame takes on this step, if it takes this long with all networks.
    fn busy(self, full: Duration) -> Duration {
        if self.has_turns() { full * TURNS_PERCENT / 100 } else { full }
    }

    /// How long a frame would take with all networks, if it takes this long on this step.
    pub(super) fn full_busy(self, busy: Duration) -> Duration {
        if self.has_turns() { busy * 100 / TURNS_PERCENT } else { busy }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cause {
    Slow,
    Hot,
    Undervoltage,
}

impl Cause {
    pub(super) const NAMES: [&str; 3] = ["slow", "hot", "undervoltage"];

    fn calm_us(self) -> u64 {
        if self == Self::Slow { 10_000_000 } else { 120_000_000 }
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Conditions {
    /// Whether the settings allow any step but the first, and a small picture.
    pub(super) is_allowed: bool,
    pub(super) load: Option<Load>,
    pub(super) impaired_by: ImpairmentSet,
    pub(super) has_smaller_mode: bool,
}

impl Conditions {
    fn throttled_by(&self) -> Option<Cause> {
        let causes = [(Impairment::Hot, Cause::Hot), (Impairment::Undervoltage, Cause::Undervoltage)];
        causes.into_iter().find(|(by, _)| self.impaired_by.contains(*by)).map(|(_, cause)| cause)
    }
}

#[derive(Debug, Default)]
pub(super) struct Adaptation {
    pub(super) step: Step,
    /// Why the pipeline went down last; `None` on [`Step::Full`].
    pub(super) cause: Option<Cause>,
    /// Whether frames take so long that the face is never live, and no lower step is left.
    pub(super) is_too_slow: bool,
    changed_us: Option<u64>,
    overloaded_since_us: Option<u64>,
    /// Since when a higher step has been possible, and the lowest that was possible at any time since.
    calm: Option<(u64, Step)>,
    wait: ProbeBackoff,
    pub(super) picture: PictureSize,
}

impl Adaptation {
    pub(super) fn update(&mut self, now_us: u64, conditions: &Conditions) {
        if !conditions.is_allowed {
            *self = Self::default();
            return;
        }
        if let Some((step, cause)) = self.lower(now_us, conditions) {
            self.wait.take_back(now_us, [cause.calm_us(), LONGEST_WAIT_US]);
            self.change(now_us, step, Some(cause));
        } else if let Some(step) = self.higher(now_us, conditions) {
            self.wait.attempted_us = Some(now_us);
            self.change(now_us, step, self.cause.filter(|_| step != Step::Full));
        }
        self.picture.update(now_us, conditions, self.step, self.cause);
    }

    fn change(&mut self, now_us: u64, step: Step, cause: Option<Cause>) {
        self.step = step;
        self.cause = cause;
        self.changed_us = Some(now_us);
        self.overloaded_since_us = None;
        self.calm = None;
    }

    fn lower(&mut self, now_us: u64, conditions: &Conditions) -> Option<(Step, Cause)> {
        let load = conditions.load.filter(|load| load.share_on(self.step) > 1.0);
        self.overloaded_since_us = load.map(|_| self.overloaded_since_us.unwrap_or(now_us));
        let is_overloaded = self.overloaded_since_us.is_some_and(|us| now_us.saturating_sub(us) >= OVERLOAD_US);
        let overload = load.filter(|_| is_overloaded).map(|load| (load, load.fitting(self.step)));
        // The pose of a frame that takes longer than this is too old for the failsafe.
        let is_late = |load: Load| load.share_on(self.step) > LIVE_FRAMES as f64;
        self.is_too_slow = overload.is_some_and(|(load, fitting)| fitting == self.step && is_late(load));
        let cooler = || Some((self.cooler(now_us, conditions)?, conditions.throttled_by()?));
        overload.map(|(_, fitting)| (fitting, Cause::Slow)).or_else(cooler).filter(|(step, _)| *step > self.step)
    }

    /// The next lower step, if it is time for one because of heat or low voltage and it would save enough.
    fn cooler(&self, now_us: u64, conditions: &Conditions) -> Option<Step> {
        let is_due = self.changed_us.is_none_or(|at_us| now_us.saturating_sub(at_us) >= THROTTLED_US);
        let load = conditions.load?;
        let is_lower = |step: &Step| *step > self.step && step.every() > 1 && step.suits(load.camera_period);
        let lowest = if load.share_on(self.step) > WORTH_SAVING { LOWEST_THROTTLED } else { Step::Half };
        Step::ALL.into_iter().find(is_lower).filter(|step| is_due && *step <= lowest)
    }

    fn higher(&mut self, now_us: u64, conditions: &Conditions) -> Option<Step> {
        let above = Step::ALL.into_iter().rfind(|step| *step < self.step)?;
        let load = conditions.load.filter(|_| conditions.throttled_by().is_none());
        let best = load.and_then(|load| match self.cause {
            Some(Cause::Slow) => load.best_above(self.step),
            _ => Some(above).filter(|step| load.fits_well(*step)),
        });
        self.calm =
            best.map(|best| self.calm.map_or((now_us, best), |(since_us, lowest)| (since_us, lowest.max(best))));
        if let Some((since_us, best)) = self.calm {
            return (now_us.saturating_sub(since_us) >= self.wait.us).then_some(best);
        }
        // No higher step seems to fit, which a governor may only make it seem. Failures make these attempts rarer.
        let base_us = self.cause.map_or(u64::MAX, Cause::calm_us);
        let wait_us = PROBE_US.saturating_mul(self.wait.us / base_us).min(LONGEST_WAIT_US);
        let is_time = self.changed_us.is_some_and(|at_us| now_us.saturating_sub(at_us) >= wait_us);
        load.filter(|load| is_time && load.share_on(self.step) <= 1.0).map(|_| above)
    }
}

/// What a frame costs, and how much time the camera leaves for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Load {
    /// Decoding and processing of a frame with all networks. Four in five frames take no longer.
    pub(super) busy: Duration,
    /// The part of it that decoding takes, on average.
    pub(super) decoding: Duration,
    pub(super) camera_period: Duration,
}

impl Load {
    /// The time that a frame takes on a step, divided by the time between two processed frames.
    fn share_on(&self, step: Step) -> f64 {
        step.busy(self.busy).as_secs_f64() / step.period(self.camera_period).as_secs_f64().max(f64::EPSILON)
    }

    /// The highest step below `step` that a frame fits, or else the lowest.
    fn fitting(&self, step: Step) -> Step {
        let mut lower = Step::ALL.into_iter().filter(|lower| *lower > step && lower.suits(self.camera_period));
        let lowest = lower.clone().next_back();
        lower.find(|lower| self.share_on(*lower) <= FITS).or(lowest).unwrap_or(step)
    }

    /// The highest step above `step` that a frame fits well.
    fn best_above(&self, step: Step) -> Option<Step> {
        Step::ALL.into_iter().find(|above| *above < step && self.fits_well(*above))
    }

    fn fits_well(&self, step: Step) -> bool {
        self.share_on(step) <= FITS_WELL
    }

    fn with_decoding(self, decoding: Duration) -> Self {
        Self { busy: self.busy.saturating_sub(self.decoding) + decoding, decoding, ..self }
    }
}

/// The wait before the next attempt at something better, such as a higher step. Each attempt that fails makes it longer.
#[derive(Debug, Default)]
struct ProbeBackoff {
    us: u64,
    /// When the last attempt was made, until it is taken back.
    attempted_us: Option<u64>,
}

impl ProbeBackoff {
    /// Takes the last attempt back, if there was one. The wait grows if the attempt has failed, and is the least again if
    /// it lasted.
    fn take_back(&mut self, now_us: u64, [least_us, longest_us]: [u64; 2]) {
        let growth = match self.attempted_us.take().map(|at_us| now_us.saturating_sub(at_us)) {
            Some(lasted_us) if lasted_us < PROVEN_AFTER * self.us => GROWTH,
            Some(_) => 0,
            None => 1,
        };
        self.us = (growth * self.us).max(least_us).min(longest_us);
    }
}

#[derive(Debug, Default)]
pub(super) struct PictureSize {
    pub(super) is_small: bool,
    /// Since when the other size has been the better one.
    better_since_us: Option<u64>,
    wait: ProbeBackoff,
}

impl PictureSize {
    fn update(&mut self, now_us: u64, conditions: &Conditions, step: Step, cause: Option<Cause>) {
        let (is_better, wait_us) = if self.is_small {
            let full = conditions.load.map(|load| load.with_decoding(load.decoding * SMALL_SHARE));
            (step == Step::Full && full.is_some_and(|load| load.fits_well(Step::Full)), self.wait.us)
        } else {
            let small = conditions.load.map(|load| load.with_decoding(load.decoding / SMALL_SHARE));
            let gains = small.is_some_and(|load| load.best_above(step).is_some());
            (conditions.has_smaller_mode && cause == Some(Cause::Slow) && gains, SMALL_AFTER_US)
        };
        self.better_since_us = is_better.then(|| self.better_since_us.unwrap_or(now_us));
        if self.better_since_us.is_none_or(|since_us| now_us.saturating_sub(since_us) < wait_us) {
            return;
        }
        self.is_small = !self.is_small;
        self.better_since_us = None;
        if self.is_small {
            self.wait.take_back(now_us, FULL_AFTER_US);
        } else {
            self.wait.attempted_us = Some(now_us);
        }
    }
}
