//! Decides on which [`Step`] the pipeline runs: down when the board is too slow, hot or badly supplied, up again later.
//!
//! Role: a pure state machine, stepped by time like the failsafe. The supervisor updates it; the hot loop reads the step
//! between frames.
//! Contract: too slow means that four in sixteen frames take longer than their step allows, for half a second. The step
//! then follows from what a frame takes, so that a constant load changes it once. It goes up when a frame has taken little
//! enough for the step above, without a break, for [`Cause::patience_us`]. Heat and low voltage take it down by one step at a
//! time. A step up that fails multiplies the patience, so that no load makes the steps oscillate.
//! Limits: a governor that saves power slows the processor down when there is less to do, so that a frame seems to take
//! long. Therefore the step above is tried from time to time whatever a frame takes.

#[cfg(test)]
mod tests;

use super::load::Load;
use super::patience::Patience;
use super::step::Step;
use crate::impairment::{Impairment, ImpairmentSet};

/// Share of its time that a frame may take on a step that is chosen on the way down.
const FITS: f64 = 0.95;
/// Share that a frame must not exceed on a step before the pipeline goes up to it.
const FITS_WELL: f64 = 0.85;
/// Frames must take too long for this time. Shorter disturbances have passed before a lower step would help.
const OVERLOAD_US: u64 = 500_000;
/// Time between two steps down because of heat or low voltage: a processor takes this long to cool down noticeably.
const THROTTLED_US: u64 = 60_000_000;
/// The lowest step because of heat or low voltage. It saves three quarters of what facewire takes; lower ones would save
/// little more.
const LOWEST_THROTTLED: Step = Step::Quarter;
/// Below `half`, heat and low voltage take the pipeline down only while the frames keep the hot loop busy for more than this
/// share of the time. Below it something else heats the board, and a slower face would not help.
const WORTH_SAVING: f64 = 0.2;
/// Time after which the step above is tried even though a frame seems to take too long for it.
const PROBE_US: u64 = 900_000_000;
/// Longest patience.
const LONGEST_PATIENCE_US: u64 = 3_600_000_000;

/// Why the pipeline is not on [`Step::Full`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// Frames take too long.
    Slow,
    /// The board is hot.
    Hot,
    /// The supply voltage is too low.
    Undervoltage,
}

impl Cause {
    /// Every cause.
    pub const ALL: [Self; 3] = [Self::Slow, Self::Hot, Self::Undervoltage];

    /// The name in the status line and in the metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Slow => "slow",
            Self::Hot => "hot",
            Self::Undervoltage => "undervoltage",
        }
    }

    /// How long all must be well before the first attempt to go up.
    fn patience_us(self) -> u64 {
        match self {
            Self::Slow => 10_000_000,
            Self::Hot | Self::Undervoltage => 120_000_000,
        }
    }
}

/// What the step depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Conditions {
    /// Whether the settings allow any step but the first.
    pub(super) is_allowed: bool,
    /// `None` while there are no frames.
    pub(super) load: Option<Load>,
    /// What makes tracking poor at present.
    pub(super) impaired_by: ImpairmentSet,
}

impl Conditions {
    fn throttled_by(&self) -> Option<Cause> {
        let hot = self.impaired_by.contains(Impairment::Hot).then_some(Cause::Hot);
        hot.or_else(|| self.impaired_by.contains(Impairment::Undervoltage).then_some(Cause::Undervoltage))
    }
}

/// The state of the adaptation.
#[derive(Debug, Default)]
pub(super) struct Adaptation {
    step: Step,
    /// Why the pipeline went down last; `None` on [`Step::Full`].
    cause: Option<Cause>,
    /// When the step changed last.
    changed_us: Option<u64>,
    /// Since when frames have taken too long.
    overloaded_since_us: Option<u64>,
    /// Since when a higher step has been possible, and the lowest that was possible at any time since.
    calm: Option<(u64, Step)>,
    /// How long it must be possible.
    patience: Patience,
}

impl Adaptation {
    /// The present step.
    pub(super) fn step(&self) -> Step {
        self.step
    }

    /// Why the pipeline is not on the first step.
    pub(super) fn cause(&self) -> Option<Cause> {
        self.cause
    }

    /// Takes in the conditions. Returns whether the step has changed.
    pub(super) fn update(&mut self, now_us: u64, conditions: &Conditions) -> bool {
        if !conditions.is_allowed {
            let was_lower = self.step != Step::Full;
            *self = Self::default();
            return was_lower;
        }
        if let Some((step, cause)) = self.lower(now_us, conditions) {
            self.descend(now_us, step, cause);
        } else if let Some(step) = self.higher(now_us, conditions) {
            self.climb(now_us, step);
        } else {
            return false;
        }
        true
    }

    /// The lower step that is due now.
    fn lower(&mut self, now_us: u64, conditions: &Conditions) -> Option<(Step, Cause)> {
        let load = conditions.load.filter(|load| load.share_on(self.step) > 1.0);
        let since_us = load.map(|_| self.overloaded_since_us.unwrap_or(now_us));
        self.overloaded_since_us = since_us;
        let is_overloaded = since_us.is_some_and(|since_us| now_us.saturating_sub(since_us) >= OVERLOAD_US);
        let fitting = load.filter(|_| is_overloaded).map(|load| (load.fitting(self.step), Cause::Slow));
        let cooler = || Some((self.cooler(now_us, conditions)?, conditions.throttled_by()?));
        fitting.or_else(cooler).filter(|(step, _)| *step > self.step)
    }

    /// The next lower step that a hot board takes.
    fn cooler(&self, now_us: u64, conditions: &Conditions) -> Option<Step> {
        let is_due = self.changed_us.is_none_or(|at_us| now_us.saturating_sub(at_us) >= THROTTLED_US);
        let load = conditions.load?;
        let is_lower = |step: &Step| *step > self.step && step.every() > 1 && step.suits(load.camera_period);
        let lowest = if load.share_on(self.step) > WORTH_SAVING { LOWEST_THROTTLED } else { Step::Half };
        Step::ALL.into_iter().find(is_lower).filter(|step| is_due && *step <= lowest)
    }

    /// The higher step that is due now.
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
            return (now_us.saturating_sub(since_us) >= self.patience.wait_us()).then_some(best);
        }
        let wait_us = self.probe_us();
        let is_time = self.changed_us.is_some_and(|at_us| now_us.saturating_sub(at_us) >= wait_us);
        load.filter(|load| is_time && load.share_on(self.step) <= 1.0).map(|_| above)
    }

    /// Time after which a higher step is tried against all appearances.
    fn probe_us(&self) -> u64 {
        let base_us = self.cause.map_or(u64::MAX, Cause::patience_us);
        PROBE_US.saturating_mul(self.patience.wait_us() / base_us).min(LONGEST_PATIENCE_US)
    }

    fn descend(&mut self, now_us: u64, step: Step, cause: Cause) {
        self.patience.take_back(now_us, [cause.patience_us(), LONGEST_PATIENCE_US]);
        self.cause = Some(cause);
        self.change(now_us, step);
    }

    fn climb(&mut self, now_us: u64, step: Step) {
        self.patience.attempt(now_us);
        if step == Step::Full {
            self.cause = None;
        }
        self.change(now_us, step);
    }

    fn change(&mut self, now_us: u64, step: Step) {
        self.step = step;
        self.changed_us = Some(now_us);
        self.overloaded_since_us = None;
        self.calm = None;
    }
}

impl Load {
    /// The share of its time that a frame takes on a step.
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
    pub(super) fn best_above(&self, step: Step) -> Option<Step> {
        Step::ALL.into_iter().find(|above| *above < step && self.fits_well(*above))
    }

    /// Whether a frame leaves enough time on a step for the pipeline to go up to it.
    pub(super) fn fits_well(&self, step: Step) -> bool {
        self.share_on(step) <= FITS_WELL
    }
}
