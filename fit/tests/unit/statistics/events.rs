use facewire_fit::statistics::events::*;

const LIMITS: EventLimits = EventLimits { f_min: 0.3, tolerance_s: 0.5 };

/// An event that has only a time.
pub fn at(time_s: f64) -> Event {
    Event { start_s: time_s, end_s: time_s }
}

fn times(count: usize) -> Vec<f64> {
    (0..count).map(|frame| frame as f64 / 30.0).collect()
}

fn counts(curve: &[f64], frames: &[f64]) -> EventCounts {
    let events: Vec<Event> = frames.iter().map(|frame| at(frame / 30.0)).collect();
    count_events(&times(curve.len()), curve, &events, LIMITS)
}

#[test]
fn an_event_lasts_from_its_rise_to_the_last_frame_above_half_of_the_threshold() {
    let curve = [0.1, 0.2, 0.25, 0.3, 0.4, 0.2, 0.1, 0.0];
    assert_eq!(events_of(&times(8), &curve, 0.3), [Event { start_s: 0.1, end_s: 5.0 / 30.0 }]);
    let oscillating = [0.0, 0.31, 0.29, 0.31, 0.16, 0.31, 0.1, 0.31];
    assert_eq!(events_of(&times(8), &oscillating, 0.3).len(), 2, "around the threshold it is one event");
}

#[test]
fn an_event_is_found_up_to_the_tolerance_and_not_beyond() {
    let mut curve = vec![0.0; 60];
    curve[30] = 0.5;
    assert_eq!([15.0, 14.0, 45.0, 46.0].map(|frame| counts(&curve, &[frame]).found), [1, 0, 1, 0]);
}

#[test]
fn a_curve_that_is_stuck_high_finds_no_event_and_all_time_outside_is_false() {
    let counts = counts(&[1.0; 90], &[3.0, 30.0, 60.0]);
    assert_eq!([counts.reference, counts.estimate, counts.found], [3, 0, 0]);
    assert_eq!(counts.rates(), [None, Some(0.0), Some(0.0), Some(-1.0)]);
    let none = EventCounts { estimate: 2, ..EventCounts::default() };
    assert_eq!(none.rates(), [Some(0.0), None, None, None], "without events in the reference");
}

#[test]
fn one_rise_finds_at_most_one_event_and_vice_versa() {
    let mut curve = vec![0.0; 90];
    curve[30..40].fill(0.9);
    let counts = |curve: &[f64], frames: &[f64]| {
        let EventCounts { estimate, found, .. } = counts(curve, frames);
        [estimate, found]
    };
    assert_eq!(counts(&curve, &[35.0, 28.0]), [1, 1]);
    assert_eq!(counts(&curve, &[50.0]), [1, 0], "still high near the event, but risen long before");
    curve[50..55].fill(0.9);
    assert_eq!(counts(&curve, &[40.0]), [2, 1]);
    assert_eq!(counts(&curve, &[60.0, 40.0]), [2, 2], "in any order");
}

#[test]
fn false_time_is_that_in_which_the_curve_is_up_beyond_the_tolerance_of_every_event() {
    let mut curve = vec![0.0; 120];
    curve[20..60].fill(0.9);
    // Frames 5 to 35 belong to the event. The curve is up in frames 36 to 59, too.
    let counted = counts(&curve, &[20.0]);
    assert_eq!([counted.frames_outside, counted.frames_false], [120 - 31, 24]);
    assert!((counted.rates()[3].unwrap() - (1.0 - 24.0 / 89.0)).abs() < 1e-12);
    let lasting = [Event { start_s: 20.0 / 30.0, end_s: 60.0 / 30.0 }];
    let counted = count_events(&times(120), &curve, &lasting, LIMITS);
    assert_eq!((counted.frames_false, counted.rates()[3]), (0, Some(1.0)));
}
