//! Events in curves, and how many of them a tracker finds (eq. 12 to 14 of the paper).
//!
//! An event of the reference is found if the coefficient rises to `f_min` within a tolerance of it, where each rise
//! finds one event. The paper's condition "contained within sensitivity and time thresholds" alone would let a curve
//! that is stuck high find all events. The paper defines `n_FN` twice; the first definition is read as
//! `n_FP = n_algo - n_TP`, the second as `n_FN = n_ref - n_TP`.
//!
//! F1 does not tell for how long a curve is up without an event. J does.

use serde::Serialize;

/// An event ends when the curve falls below this multiple of `f_min`. Only then can the next event begin.
const RELEASE: f64 = 0.5;
/// Rounding allowance at the limits of the tolerance, because times are sums of frame durations.
const SLACK_S: f64 = 1e-6;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// The time at which it reaches `f_min`, or which a person noted.
    pub start_s: f64,
    /// The time at which it ends; the start if nobody noted an end.
    pub end_s: f64,
}

impl Event {}

#[derive(Debug, Clone, Copy)]
pub struct EventLimits {
    pub f_min: f64,
    /// Largest time between an event and the rise that finds it.
    pub tolerance_s: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct EventCounts {
    pub reference: usize,
    pub estimate: usize,
    pub found: usize,
    /// Frames outside of the reference's events.
    pub frames_outside: usize,
    /// Those of them in which the judged curve is at least `f_min`.
    pub frames_false: usize,
}

impl EventCounts {
    /// Returns precision, recall, F1 and J. Precision is undefined without an event of the judged curve, the others without
    /// one of the reference. F1 is 0 if no event was found. J is recall minus the share of the time outside of events in
    /// which the judged curve is up: at most 0 for a curve that is always up, and 1 for a perfect one.
    pub fn rates(&self) -> [Option<f64>; 4] {
        let ratio = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
        let (precision, recall) = (ratio(self.found, self.estimate), ratio(self.found, self.reference));
        let harmonic = |recall: f64| precision.map_or(0.0, |precision| 2.0 * precision * recall / (precision + recall));
        let f1 = recall.map(|recall| if self.found > 0 { harmonic(recall) } else { 0.0 });
        let false_time = ratio(self.frames_false, self.frames_outside).unwrap_or(0.0);
        [precision, recall, f1, recall.map(|recall| recall - false_time)]
    }
}

/// Returns the events of a curve: it rises to `f_min` after it was below half of it, and falls below half of it again.
pub fn events_of(times_s: &[f64], curve: &[f64], f_min: f64) -> Vec<Event> {
    let (mut armed, mut is_up) = (false, false);
    let mut events: Vec<Event> = Vec::new();
    for (time, value) in times_s.iter().zip(curve) {
        let is_low = *value < RELEASE * f_min;
        if armed && *value >= f_min {
            events.push(Event { start_s: *time, end_s: *time });
            is_up = true;
        }
        is_up &= !is_low;
        if let Some(last) = events.last_mut().filter(|_| is_up) {
            last.end_s = *time;
        }
        armed = is_low || (armed && *value < f_min);
    }
    events
}

/// Counts the events of `reference` at whose start a curve rises within the tolerance. In order of time, each event is
/// matched with the first free rise near it; no other matching finds more.
pub fn count_events(times_s: &[f64], curve: &[f64], reference: &[Event], limits: EventLimits) -> EventCounts {
    let rises = events_of(times_s, curve, limits.f_min);
    let mut events = reference.to_vec();
    events.sort_by(|a, b| a.start_s.total_cmp(&b.start_s));
    let (mut found, mut next, reach) = (0, 0, limits.tolerance_s + SLACK_S);
    for event in &events {
        next += rises[next..].iter().take_while(|rise| rise.start_s < event.start_s - reach).count();
        if rises.get(next).is_some_and(|rise| rise.start_s <= event.start_s + reach) {
            found += 1;
            next += 1;
        }
    }
    let is_near = |event: &Event, time: &f64| (event.start_s - reach..=event.end_s + reach).contains(time);
    let is_outside = |time: &f64| !events.iter().any(|event| is_near(event, time));
    let outside: Vec<f64> =
        times_s.iter().zip(curve).filter(|(time, _)| is_outside(time)).map(|(_, value)| *value).collect();
    let frames_false = outside.iter().filter(|value| **value >= limits.f_min).count();
    EventCounts { reference: events.len(), estimate: rises.len(), found, frames_outside: outside.len(), frames_false }
}
