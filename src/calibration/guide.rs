//! The guide: asks for one take after the other, and accepts or refuses what it sees.
//!
//! A pure state machine: time comes with the observations, in any order and with any gaps. In a take the guide lets the
//! wearer get ready, waits until the conditions hold (a face that faces the camera, enough light, and the pose), and
//! measures while the wearer holds still. A pose that is not seen for some seconds is left out. If the poses contradict the
//! neutral take at the end, it is taken again.

use std::collections::VecDeque;

use facewire_face::{Model, Profile, Wears};
use facewire_packet::control::{Phase, Progress, Refusal, Take};

use super::model_hash;
use super::observation::{Fit, Hold, Observation, View};
use super::take::{Takes, doubt, expected, learn, takes_of};

/// Time to read what to do, for the neutral take and the others.
const READY_S: [f32; 2] = [1.0, 0.7];
/// How long the wearer holds still for the neutral take and for the others.
const MEASURE_S: [f32; 2] = [1.5, 0.7];
/// Time after which a take that is not accepted is given up, counted while a face is seen under fair conditions.
const PATIENCE_S: [f32; 2] = [15.0, 5.0];
/// Time under poor conditions after which a pose is left out, and after which, over all takes, the calibration ends.
const HINDERED_S: f32 = 8.0;
const ALL_HINDERED_S: f32 = 30.0;
/// Time constant with which the strength of a pose is smoothed.
const SMOOTHING_S: f32 = 0.15;
/// Least number of frames under fair conditions before a take is given up, however slow the camera is.
const PATIENCE_FRAMES: u32 = 15;
/// Longest time between two frames of one hold: this time, or with a slow camera this many frames.
const GAP_S: f32 = 1.0;
const GAP_FRAMES: f32 = 3.0;
/// The newest time between frames enters their moving average with the weight of one over this.
const PERIOD_SHARE: f32 = 8.0;
const MAX_PERIOD_S: f32 = 5.0;
/// Longest blink that is left out. A blink that a slow camera shows in one frame is never too long.
const BLINK_S: f32 = 0.6;
/// How often the neutral take is repeated because the poses contradict it.
const RETAKES: u32 = 2;

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Calibration {
    pub profile: Profile,
    /// The hash of the model.
    pub model: u32,
    pub taken: Vec<Take>,
    /// The poses that were left out, and why. Their coefficients keep general values.
    pub left_out: Vec<(Take, Refusal)>,
    pub refused: u32,
}

pub struct Guide {
    model: Model,
    /// What is found so far.
    pub(crate) calibration: Calibration,
    last_us: Option<u64>,
    period_s: Option<f32>,
    plan: VecDeque<Take>,
    takes_in_all: usize,
    stage: Stage,
    takes: Takes,
    last_refusal: Option<Refusal>,
    hindered_s: f32,
    retakes: u32,
    outcome: Option<Result<Calibration, Refusal>>,
}

#[derive(Default)]
struct Stage {
    /// Time since the guide asked for the take.
    since_s: f32,
    /// Time and frames under fair conditions, after the time to get ready.
    tried_s: f32,
    tried_frames: u32,
    hindered_s: f32,
    hold: Option<Hold>,
    /// How strongly the pose is seen, smoothed: the coefficients of a single frame are noisy.
    strength: Option<f32>,
    seen: f32,
    waits_for: Option<Refusal>,
}

impl Guide {
    /// Begins with the neutral take. `model` is that of the solver, and `wears` what the wearer has on the face.
    pub fn new(model: Model, wears: Wears) -> Self {
        let plan: VecDeque<Take> = takes_of(wears).collect();
        Self {
            calibration: Calibration { model: model_hash(&model), ..Calibration::default() },
            model,
            last_us: None,
            period_s: None,
            takes_in_all: plan.len(),
            plan,
            stage: Stage::default(),
            takes: Takes::of(wears),
            last_refusal: None,
            hindered_s: 0.0,
            retakes: 0,
            outcome: None,
        }
    }

    /// The take that the guide asks for, or `None` at the end.
    pub fn wanted(&self) -> Option<Take> {
        if self.outcome.is_some() { None } else { self.plan.front().copied() }
    }

    pub fn wears(&self) -> Wears {
        self.takes.wears
    }

    pub fn outcome(&self) -> Option<Result<Calibration, Refusal>> {
        self.outcome.clone()
    }

    pub fn update(&mut self, observation: &Observation) {
        let step_s = self.step_s(observation.time_us);
        let Some(take) = self.wanted() else { return };
        let stage = &mut self.stage;
        stage.since_s += step_s;
        match View::new(&self.model, &self.takes, take, observation) {
            Err(hindrance) => self.hinder(take, hindrance, step_s),
            Ok(_) if stage.since_s < value_for(READY_S, take) => stage.waits_for = None,
            Ok(mut view) => {
                let last = stage.strength.unwrap_or(view.strength_now);
                view.strength = last + (1.0 - (-step_s / SMOOTHING_S).exp()) * (view.strength_now - last);
                stage.strength = Some(view.strength);
                self.measure(take, &view, step_s);
            }
        }
    }

    pub fn progress(&self) -> Progress {
        let take = self.plan.front().copied().or(takes_of(self.takes.wears).last()).unwrap_or(Take::Neutral);
        let phase = match &self.stage {
            _ if self.wanted().is_none() => Phase::Ended,
            Stage { hold: Some(_), .. } => Phase::Measure,
            Stage { since_s, .. } if *since_s < value_for(READY_S, take) => Phase::GetReady,
            _ => Phase::Wait,
        };
        Progress {
            take,
            done: self.takes_in_all.saturating_sub(self.plan.len()),
            of: self.takes_in_all,
            phase,
            measured: self.stage.hold.as_ref().map_or(0.0, |hold| hold.done(value_for(MEASURE_S, take))),
            seen: self.stage.seen,
            waits_for: self.outcome.as_ref().map_or(self.stage.waits_for, |outcome| outcome.as_ref().err().copied()),
            refused: self.calibration.refused,
            last_refusal: self.last_refusal,
        }
    }

    /// The longest time between two frames of one hold. A longer gap means that the camera gives no pictures.
    pub fn gap_s(&self) -> f32 {
        GAP_S.max(GAP_FRAMES * self.period_s.unwrap_or_default())
    }

    /// Returns the time since the last frame, but no more than the longest time between two frames of one hold. A longer
    /// time, and a clock that ran backwards, end the hold.
    fn step_s(&mut self, time_us: u64) -> f32 {
        let Some(last_us) = self.last_us.replace(time_us) else { return 0.0 };
        let Some(passed_us) = time_us.checked_sub(last_us) else {
            self.stage.hold = None;
            return 0.0;
        };
        let step_s = passed_us as f32 / 1e6;
        let period_s = *self.period_s.get_or_insert(step_s.min(MAX_PERIOD_S));
        let gap_s = self.gap_s();
        if step_s > gap_s {
            self.stage.hold = None;
        }
        let step_s = step_s.min(gap_s);
        self.period_s = Some((period_s + (step_s - period_s) / PERIOD_SHARE).min(MAX_PERIOD_S));
        step_s
    }

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

    fn measure(&mut self, take: Take, view: &View<'_>, step_s: f32) {
        self.stage.tried_s += step_s;
        self.stage.tried_frames += 1;
        self.stage.seen = if take == Take::Neutral { 0.0 } else { (view.strength / expected(take).threshold).max(0.0) };
        match view.unfit(take) {
            Some(unfit) => {
                self.stop_hold(if take == Take::Neutral { unfit } else { Refusal::TooShort });
                self.stage.waits_for = Some(unfit);
            }
            None => self.hold(take, view, step_s),
        }
        if self.stage.hold.as_ref().is_some_and(|hold| hold.done(value_for(MEASURE_S, take)) >= 1.0) {
            let seen = self.stage.hold.take().and_then(|hold| hold.finish());
            match seen.and_then(|seen| self.takes.insert(&self.model, take, seen)) {
                Some(()) => self.go_on(),
                None => self.leave_out(take, Refusal::NoFace),
            }
        } else if self.is_given_up(take) {
            let why = if view.is_blink(take) { Some(Refusal::EyesShut) } else { self.stage.waits_for };
            self.leave_out(take, why.unwrap_or(Refusal::NotSeen));
        }
    }

    /// Whether the time for the take is over. A hold that has begun may end.
    fn is_given_up(&self, take: Take) -> bool {
        let Stage { tried_s, tried_frames, hold, .. } = &self.stage;
        hold.is_none() && *tried_s > value_for(PATIENCE_S, take) && *tried_frames > PATIENCE_FRAMES
    }

    fn hold(&mut self, take: Take, view: &View<'_>, step_s: f32) {
        let Some(hold) = &mut self.stage.hold else {
            // While a pose fades, the smoothed strength is still high.
            let is_fading = view.strength_now < expected(take).threshold;
            self.stage.hold = (!view.is_blink(take) && !is_fading).then(|| Hold::begin(view));
            return;
        };
        let fit = hold.judge(take, view);
        if fit == Fit::Blink {
            hold.blink_s += step_s;
        }
        match fit {
            Fit::Belongs => {
                hold.add(view, step_s);
                self.stage.waits_for = None;
            }
            Fit::Blink if hold.blink_s <= BLINK_S.max(step_s) => {}
            Fit::Blink => self.stop_hold(Refusal::EyesShut),
            Fit::Anew => *hold = Hold::begin(view),
            Fit::Broken(refusal) => self.stop_hold(refusal),
        }
    }

    fn stop_hold(&mut self, refusal: Refusal) {
        if self.stage.hold.take().is_some() {
            self.refuse(refusal);
        }
    }

    fn refuse(&mut self, refusal: Refusal) {
        self.calibration.refused += 1;
        self.last_refusal = Some(refusal);
        self.stage.waits_for = Some(refusal);
    }

    fn leave_out(&mut self, take: Take, why: Refusal) {
        if take == Take::Neutral {
            self.outcome = Some(Err(why));
        } else {
            self.calibration.left_out.push((take, why));
            self.go_on();
        }
    }

    fn go_on(&mut self) {
        self.plan.pop_front();
        self.stage = Stage::default();
        if !self.plan.is_empty() {
            return;
        }
        let Some(doubt) = doubt(&self.model, &self.takes) else {
            let found = |profile| Calibration { profile, taken: self.takes.taken(), ..self.calibration.clone() };
            self.outcome = Some(learn(&self.model, &self.takes).map(found).ok_or(Refusal::NoFace));
            return;
        };
        self.refuse(doubt);
        self.retakes += 1;
        if self.retakes > RETAKES {
            self.outcome = Some(Err(doubt));
            return;
        }
        self.plan.push_back(Take::Neutral);
        // Poses that were not seen relative to the wrong neutral face may be seen relative to the new one.
        let left_out = &mut self.calibration.left_out;
        self.plan.extend(left_out.extract_if(.., |(_, why)| *why == Refusal::NotSeen).map(|(take, _)| take));
    }
}

/// Chooses between the values for the neutral take and for the poses.
fn value_for([neutral, pose]: [f32; 2], take: Take) -> f32 {
    if take == Take::Neutral { neutral } else { pose }
}

#[cfg(test)]
pub(crate) mod tests;
