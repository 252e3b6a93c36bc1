//! Events in curves, and how many of them a tracker finds (eq. 12 to 14 of the paper).
//!
//! An event of the reference is found if the coefficient rises to `f_min` within a tolerance of it, where each rise
//! finds one event. The paper's condition "contained within sensitivity and time thresholds" alone would let a curve
//! that is stuck high find all events. The paper defines `n_FN` twice; the first definition is read as
//! `n_FP = n_algo - n_TP`, the second as `n_FN = n_ref - n_TP`.

use serde::Serialize;

/// An event ends when the curve falls below this multiple of `f_min`. Only then can the next event begin.
const RELEASE: f64 = 0.5;
/// Rounding allowance at the limits of the tolerance, because times are sums of frame durations.
const SLACK_S: f64 = 1e-6;

/// Event counts of one blendshape.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct EventCounts {
    /// Events in the reference.
    pub reference: usize,
    /// Events in the judged curve.
    pub estimate: usize,
    /// Events of the reference that were found in the judged curve.
    pub found: usize,
}

impl EventCounts {
    /// Returns the share of the judged curve's events that match, or `None` if it has none.
    pub fn precision(&self) -> Option<f64> {
        ratio(self.found, self.estimate)
    }

    /// Returns the share of the reference's events that were found, or `None` if it has none.
    pub fn recall(&self) -> Option<f64> {
        ratio(self.found, self.reference)
    }

    /// Returns the harmonic mean of precision and recall: 0 if no event was found, `None` if the reference has none.
    pub fn f1(&self) -> Option<f64> {
        let recall = self.recall()?;
        let precision = self.precision().unwrap_or(0.0);
        Some(if self.found > 0 { 2.0 * precision * recall / (precision + recall) } else { 0.0 })
    }
}

fn ratio(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// Returns the times at which a curve rises to `f_min` after it was below half of it.
pub fn rising_edges(times_s: &[f64], curve: &[f64], f_min: f64) -> Vec<f64> {
    let mut armed = false;
    let mut edges = Vec::new();
    for (time, value) in times_s.iter().zip(curve) {
        if armed && *value >= f_min {
            edges.push(*time);
        }
        armed = *value < RELEASE * f_min || (armed && *value < f_min);
    }
    edges
}

/// Counts the events at the times `reference` that a curve finds within `tolerance_s`. In order of time, each event is
/// matched with the first free rise near it; no other matching finds more.
pub fn count_events(times_s: &[f64], curve: &[f64], reference: &[f64], f_min: f64, tolerance_s: f64) -> EventCounts {
    let edges = rising_edges(times_s, curve, f_min);
    let mut events = reference.to_vec();
    events.sort_by(f64::total_cmp);
    let (mut found, mut next) = (0, 0);
    for event in events {
        let reach = tolerance_s + SLACK_S;
        next += edges[next..].iter().take_while(|edge| **edge < event - reach).count();
        if edges.get(next).is_some_and(|edge| *edge <= event + reach) {
            found += 1;
            next += 1;
        }
    }
    EventCounts { reference: reference.len(), estimate: edges.len(), found }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(count: usize) -> Vec<f64> {
        (0..count).map(|frame| frame as f64 / 30.0).collect()
    }

    #[test]
    fn oscillating_around_the_threshold_is_one_event() {
        let curve = [0.0, 0.31, 0.29, 0.31, 0.16, 0.31, 0.1, 0.31];
        assert_eq!(rising_edges(&times(8), &curve, 0.3).len(), 2);
    }

    #[test]
    fn a_slow_rise_is_one_event_at_the_time_it_passes_the_threshold() {
        let curve = [0.1, 0.2, 0.25, 0.3, 0.4];
        assert_eq!(rising_edges(&times(5), &curve, 0.3), [0.1]);
    }

    #[test]
    fn an_event_is_found_up_to_the_tolerance_and_not_beyond() {
        let mut curve = vec![0.0; 60];
        curve[30] = 0.5;
        let found = |event_frame: f64| count_events(&times(60), &curve, &[event_frame / 30.0], 0.3, 0.5).found;
        assert_eq!([found(15.0), found(14.0), found(45.0), found(46.0)], [1, 0, 1, 0]);
    }

    #[test]
    fn a_curve_that_is_stuck_high_finds_no_event() {
        let counts = count_events(&times(90), &[1.0; 90], &[0.1, 1.0, 2.0], 0.3, 0.5);
        assert_eq!(counts, EventCounts { reference: 3, estimate: 0, found: 0 });
        assert_eq!([counts.precision(), counts.f1()], [None, Some(0.0)]);
    }

    #[test]
    fn one_rise_finds_at_most_one_event_and_vice_versa() {
        let mut curve = vec![0.0; 90];
        curve[30..40].fill(0.9);
        let counts = |curve: &[f64], frames: &[f64]| {
            let events: Vec<f64> = frames.iter().map(|frame| frame / 30.0).collect();
            let EventCounts { estimate, found, .. } = count_events(&times(90), curve, &events, 0.3, 0.5);
            [estimate, found]
        };
        assert_eq!(counts(&curve, &[35.0, 28.0]), [1, 1]);
        assert_eq!(counts(&curve, &[50.0]), [1, 0], "still high near the event, but risen long before");
        curve[50..55].fill(0.9);
        assert_eq!(counts(&curve, &[40.0]), [2, 1]);
        assert_eq!(counts(&curve, &[60.0, 40.0]), [2, 2], "in any order");
    }

    #[test]
    fn precision_recall_and_f1_follow_from_the_counts() {
        let counts = EventCounts { reference: 4, estimate: 3, found: 2 };
        assert!((counts.precision().unwrap() - 2.0 / 3.0).abs() < 1e-12);
        assert!((counts.recall().unwrap() - 0.5).abs() < 1e-12);
        assert!((counts.f1().unwrap() - 4.0 / 7.0).abs() < 1e-12);
    }

    #[test]
    fn f1_is_undefined_without_reference_events_and_0_if_none_is_found() {
        assert_eq!(EventCounts { reference: 0, estimate: 2, found: 0 }.f1(), None);
        assert_eq!(EventCounts { reference: 2, estimate: 0, found: 0 }.f1(), Some(0.0));
    }
}
