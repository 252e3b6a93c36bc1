//! The guide: asks for one take after the other, and accepts or refuses what it sees.
//!
//! A pure state machine: time comes with the observations, in any order and with any gaps. A take goes through three
//! phases: get ready, wait until the conditions hold (a face that faces the camera, enough light, and for a pose that the
//! pose is seen, relative to the neutral take), and measure while the wearer holds still. A pose that is not seen for
//! some seconds is left out. At the end the neutral take is compared with the poses, in which the parts of the face that
//! they do not move are at rest, too: where these read less than in the neutral take, the wearer smiled, opened
//! the mouth, lowered the lids or raised the brows in it, and it is taken again.

use std::collections::VecDeque;
use std::sync::Arc;

use super::doubt::doubt;
use super::hold::{Fit, Hold, LIDS};
use super::learn::{Takes, learn};
use super::observation::Observation;
use super::progress::{Phase, Progress};
use super::refusal::Refusal;
use super::take::{Take, mean_of};
use super::view::View;
use crate::solve::{Model, Profile};

/// Time to read what to do, for the neutral take and the others.
const READY_S: [f32; 2] = [1.0, 0.7];
/// Time for which the face is measured.
const MEASURE_S: [f32; 2] = [1.5, 0.7];
/// Time after which a take that is not accepted is given up, counted while a face is seen under fair conditions.
const PATIENCE_S: [f32; 2] = [15.0, 5.0];
/// Time under poor conditions after which a pose is left out, and in all after which the calibration ends.
const HINDERED_S: f32 = 8.0;
const ALL_HINDERED_S: f32 = 30.0;
/// Time constant with which the strength of a pose is smoothed.
const SMOOTHING_S: f32 = 0.15;
/// Longest time between two frames of one hold.
const GAP_S: f32 = 1.0;
/// Longest blink that is left out.
const BLINK_S: f32 = 0.6;
/// How often the neutral take is repeated because the poses contradict it.
const RETAKES: u32 = 2;

/// What a calibration has found.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// What is known of the wearer now.
    pub profile: Profile,
    /// The takes that were accepted.
    pub taken: Vec<Take>,
    /// The poses that were left out, and why. Their coefficients keep general values.
    pub left_out: Vec<(Take, Refusal)>,
    /// Number of refused takes.
    pub refused: u32,
}

/// Guides a wearer through a calibration.
#[derive(Debug)]
pub struct Guide {
    model: Arc<Model>,
    last_us: Option<u64>,
    plan: VecDeque<Take>,
    stage: Stage,
    takes: Takes,
    left_out: Vec<(Take, Refusal)>,
    refused: u32,
    last_refusal: Option<Refusal>,
    hindered_s: f32,
    retakes: u32,
    outcome: Option<Result<Profile, Refusal>>,
}

/// The take in progress.
#[derive(Debug, Default)]
struct Stage {
    since_s: f32,
    tried_s: f32,
    hindered_s: f32,
    hold: Option<Hold>,
    /// How strongly the pose is seen, smoothed.
    strength: Option<f32>,
    seen: f32,
    waits_for: Option<Refusal>,
}

impl Stage {
    /// Smooths how strongly the pose is seen: the coefficients of a single frame are noisy.
    fn smooth(&mut self, strength: f32, step_s: f32) -> f32 {
        let last = self.strength.unwrap_or(strength);
        let smoothed = last + (1.0 - (-step_s / SMOOTHING_S).exp()) * (strength - last);
        self.strength = Some(smoothed);
        smoothed
    }
}

impl Guide {
    /// Begins with the neutral take. `model` is that of the solver.
    #[must_use]
    pub fn new(model: impl Into<Arc<Model>>) -> Self {
        Self {
            model: model.into(),
            last_us: None,
            plan: Take::ALL.into(),
            stage: Stage::default(),
            takes: Takes::default(),
            left_out: Vec::new(),
            refused: 0,
            last_refusal: None,
            hindered_s: 0.0,
            retakes: 0,
            outcome: None,
        }
    }

    /// The take that the guide asks for, or `None` at the end.
    #[must_use]
    pub fn wanted(&self) -> Option<Take> {
        if self.outcome.is_some() { None } else { self.plan.front().copied() }
    }

    /// Takes in one frame.
    pub fn update(&mut self, observation: &Observation) {
        let step_s = self.step_s(observation.time_us);
        let Some(take) = self.wanted() else { return };
        self.stage.since_s += step_s;
        match View::new(&self.model, &self.takes, take, observation) {
            Err(hindrance) => self.hinder(take, hindrance, step_s),
            Ok(_) if self.stage.since_s < of(READY_S, take) => {}
            Ok(mut view) => {
                view.strength = self.stage.smooth(view.strength_now, step_s);
                self.measure(take, &view, step_s);
            }
        }
    }

    /// How far the calibration is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        let take = self.plan.front().copied().unwrap_or(Take::LookDown);
        let measured = self.stage.hold.as_ref().map_or(0.0, |hold| hold.done(of(MEASURE_S, take)));
        let phase = match &self.stage {
            _ if self.wanted().is_none() => Phase::Ended,
            Stage { hold: Some(_), .. } => Phase::Measure,
            Stage { since_s, .. } if *since_s < of(READY_S, take) => Phase::GetReady,
            _ => Phase::Wait,
        };
        Progress {
            take,
            done: Take::ALL.len().saturating_sub(self.plan.len()),
            of: Take::ALL.len(),
            phase,
            measured,
            seen: self.stage.seen,
            waits_for: self.stage.waits_for,
            refused: self.refused,
            last_refusal: self.last_refusal,
        }
    }

    /// What the calibration has found, or `None` while it goes on.
    ///
    /// # Errors
    /// The calibration ended without a profile: no neutral take was accepted, the poses contradicted each of them, or
    /// the conditions were poor for too long. The error is the last reason.
    #[must_use]
    pub fn outcome(&self) -> Option<Result<Calibration, Refusal>> {
        let found = |profile: &Profile| Calibration {
            profile: profile.clone(),
            taken: self.takes.taken().collect(),
            left_out: self.left_out.clone(),
            refused: self.refused,
        };
        self.outcome.as_ref().map(|outcome| outcome.as_ref().map(found).map_err(|refusal| *refusal))
    }

    /// Returns the time since the last frame, at most [`GAP_S`]. After a longer time, and after a clock that ran
    /// backwards, a hold begins anew.
    fn step_s(&mut self, time_us: u64) -> f32 {
        let last_us = self.last_us.replace(time_us).unwrap_or(time_us);
        let Some(passed_us) = time_us.checked_sub(last_us) else {
            self.stage.hold = None;
            return 0.0;
        };
        let step_s = passed_us as f32 / 1e6;
        if step_s > GAP_S {
            self.stage.hold = None;
        }
        step_s.min(GAP_S)
    }

    /// The conditions of the take do not hold.
    fn hinder(&mut self, take: Take, hindrance: Refusal, step_s: f32) {
        self.stop_hold(hindrance);
        self.stage.seen = 0.0;
        self.stage.waits_for = Some(hindrance);
        self.stage.hindered_s += step_s;
        self.hindered_s += step_s;
        if self.hindered_s > ALL_HINDERED_S {
            self.outcome = Some(Err(hindrance));
        } else if take != Take::Neutral && self.stage.hindered_s > HINDERED_S {
            self.leave_out(take, hindrance);
        }
    }

    /// Measures a face under fair conditions.
    fn measure(&mut self, take: Take, view: &View<'_>, step_s: f32) {
        self.stage.tried_s += step_s;
        self.stage.seen = if take == Take::Neutral { 0.0 } else { (view.strength / take.threshold()).max(0.0) };
        match view.unfit(take) {
            Some(unfit) => {
                self.stop_hold(if take == Take::Neutral { unfit } else { Refusal::TooShort });
                self.stage.waits_for = Some(unfit);
            }
            None => self.hold(take, view, step_s),
        }
        if self.stage.hold.as_ref().is_some_and(|hold| hold.done(of(MEASURE_S, take)) >= 1.0) {
            self.accept(take);
        } else if self.stage.tried_s > of(PATIENCE_S, take) {
            let why = self.stage.waits_for.or(self.last_refusal).unwrap_or(Refusal::NotSeen);
            self.leave_out(take, why);
        }
    }

    /// Goes on with the hold, or begins one.
    fn hold(&mut self, take: Take, view: &View<'_>, step_s: f32) {
        let View { seen, coefficients, strength_now, strength } = view;
        // While a pose fades, the smoothed strength is still high.
        let is_fading = *strength_now < take.threshold();
        let is_blink = take != Take::Neutral && mean_of(&LIDS, coefficients) > take.lids();
        let Some(hold) = &mut self.stage.hold else {
            self.stage.hold = (!is_blink && !is_fading).then(|| Hold::begin(seen, coefficients, *strength));
            return;
        };
        let fit = match take {
            Take::Neutral => hold.judge_rest(seen, coefficients),
            _ if is_blink => Fit::Blink,
            _ => hold.judge_pose(seen, *strength),
        };
        match fit {
            Fit::Belongs => {
                hold.add(seen, coefficients, *strength, step_s);
                self.stage.waits_for = None;
            }
            Fit::Blink if hold.blink(step_s) <= BLINK_S => {}
            Fit::Blink => self.stop_hold(Refusal::EyesShut),
            Fit::Anew => *hold = Hold::begin(seen, coefficients, *strength),
            Fit::Broken(refusal) => self.stop_hold(refusal),
        }
    }

    /// Refuses what was measured so far, if anything was.
    fn stop_hold(&mut self, refusal: Refusal) {
        if self.stage.hold.take().is_some() {
            self.refused += 1;
            self.last_refusal = Some(refusal);
            self.stage.waits_for = Some(refusal);
        }
    }

    fn accept(&mut self, take: Take) {
        let seen = self.stage.hold.take().and_then(|hold| hold.finish());
        if seen.is_some_and(|seen| self.takes.insert(&self.model, take, seen)) {
            self.go_on();
        } else {
            self.leave_out(take, Refusal::NoFace);
        }
    }

    fn leave_out(&mut self, take: Take, why: Refusal) {
        if take == Take::Neutral {
            self.outcome = Some(Err(why));
            return;
        }
        self.left_out.push((take, why));
        self.go_on();
    }

    /// Goes on with the next take, or ends.
    fn go_on(&mut self) {
        self.plan.pop_front();
        self.stage = Stage::default();
        if !self.plan.is_empty() {
            return;
        }
        let Some(doubt) = doubt(&self.model, &self.takes) else {
            self.outcome = Some(learn(&self.model, &self.takes).ok_or(Refusal::NoFace));
            return;
        };
        self.refused += 1;
        self.last_refusal = Some(doubt);
        if self.retakes == RETAKES {
            self.outcome = Some(Err(doubt));
            return;
        }
        self.retakes += 1;
        self.stage.waits_for = Some(doubt);
        self.plan.push_back(Take::Neutral);
        // Poses that were not seen relative to the wrong neutral face may be seen relative to the new one.
        self.plan.extend(self.left_out.extract_if(.., |(_, why)| *why == Refusal::NotSeen).map(|(take, _)| take));
    }
}

/// The value for the neutral take, or that for a pose.
fn of([neutral, pose]: [f32; 2], take: Take) -> f32 {
    if take == Take::Neutral { neutral } else { pose }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
mod tests;
