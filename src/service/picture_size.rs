//! Decides whether the camera is opened with half the width and height, because decoding its pictures takes too long.
//!
//! Role: a pure state machine beside [`Adaptation`](super::adaptation::Adaptation), stepped by time. The supervisor updates
//! it; the hot loop opens the camera again when its answer changes, which interrupts the face for up to a second.
//! Contract: a small picture is chosen only if the pipeline has been too slow for [`SMALL_AFTER_US`], the camera has a
//! smaller mode, and the time saved lets the pipeline go up a step. The full size comes back only after a full-sized picture
//! would have left time on the first step for a patience of ten minutes. A return that fails multiplies this patience.

use std::time::Duration;

use super::adaptation::Cause;
use super::load::Load;
use super::patience::Patience;
use super::step::Step;

/// The pipeline must have been on a lower step for this time, because an interruption is worse than a short slowness.
const SMALL_AFTER_US: u64 = 30_000_000;
/// A full-sized picture must have been possible for this time at first.
const PATIENCE_US: u64 = 600_000_000;
/// Longest patience: a day.
const LONGEST_PATIENCE_US: u64 = 86_400_000_000;
/// A picture of half the width and height has this share of the pixels.
const SMALL_SHARE: u32 = 4;

/// What the size depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Need {
    /// Whether the settings allow a small picture.
    pub(super) is_allowed: bool,
    /// `None` while there are no frames.
    pub(super) load: Option<Load>,
    /// The step of the pipeline, and why it is not the first one.
    pub(super) step: (Step, Option<Cause>),
    /// Whether the camera offers a smaller picture than the present one.
    pub(super) has_smaller_mode: bool,
}

/// Which size of picture the camera is opened with.
#[derive(Debug, Default)]
pub(super) struct PictureSize {
    is_small: bool,
    /// Since when the other size has been the better one.
    better_since_us: Option<u64>,
    /// How long a full-sized picture must be possible.
    patience: Patience,
}

impl PictureSize {
    /// Whether the camera is opened with half the width and height.
    pub(super) fn is_small(&self) -> bool {
        self.is_small
    }

    /// Takes in the need. Returns whether the size has changed.
    pub(super) fn update(&mut self, now_us: u64, need: &Need) -> bool {
        if !need.is_allowed {
            let was_small = self.is_small;
            *self = Self::default();
            return was_small;
        }
        let (is_better, wait_us) = if self.is_small {
            (need.allows_full(), self.patience.wait_us())
        } else {
            (need.gains_by_small(), SMALL_AFTER_US)
        };
        self.better_since_us = is_better.then(|| self.better_since_us.unwrap_or(now_us));
        if self.better_since_us.is_none_or(|since_us| now_us.saturating_sub(since_us) < wait_us) {
            return false;
        }
        self.is_small = !self.is_small;
        self.better_since_us = None;
        if self.is_small {
            self.patience.take_back(now_us, [PATIENCE_US, LONGEST_PATIENCE_US]);
        } else {
            self.patience.attempt(now_us);
        }
        true
    }
}

impl Need {
    /// Whether a small picture would let a slow pipeline go up a step.
    fn gains_by_small(&self) -> bool {
        let (step, cause) = self.step;
        let small = |load: Load| load.with_decoding(load.decoding / SMALL_SHARE);
        let gains = self.load.is_some_and(|load| small(load).best_above(step).is_some());
        self.has_smaller_mode && cause == Some(Cause::Slow) && gains
    }

    /// Whether a full-sized picture would leave the pipeline on the first step.
    fn allows_full(&self) -> bool {
        let full = |load: Load| load.with_decoding(load.decoding * SMALL_SHARE);
        self.step.0 == Step::Full && self.load.is_some_and(|load| full(load).fits_well(Step::Full))
    }
}

impl Load {
    /// The load if decoding took this long.
    fn with_decoding(self, decoding: Duration) -> Self {
        Self { busy: self.busy.saturating_sub(self.decoding) + decoding, decoding, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_micros(33_333);
    const S: u64 = 1_000_000;

    /// What is needed if decoding a picture of the present size and the rest take these shares of a frame period.
    fn need(decoding: f64, work: f64, step: Step) -> Need {
        let [decoding, work] = [decoding, work].map(|share| PERIOD.mul_f64(share));
        let load = Load { busy: decoding + work, decoding, camera_period: PERIOD };
        let cause = (step != Step::Full).then_some(Cause::Slow);
        Need { is_allowed: true, load: Some(load), step: (step, cause), has_smaller_mode: true }
    }

    /// The seconds at which the size changes within this time, if `need` is what is needed with a small picture or not.
    fn changes_s(seconds: u64, need: impl Fn(u64, bool) -> Need) -> Vec<u64> {
        let mut size = PictureSize::default();
        (0..seconds).filter(|now_s| size.update(now_s * S, &need(*now_s, size.is_small()))).collect()
    }

    #[test]
    fn a_slow_board_takes_a_small_picture_after_half_a_minute_and_keeps_it_while_a_full_one_would_be_slow() {
        let always_slow = |_, is_small| if is_small { need(0.4, 0.3, Step::Full) } else { need(1.6, 0.3, Step::Third) };
        assert_eq!(changes_s(86_400, always_slow), [30]);
    }

    #[test]
    fn the_picture_stays_as_it_is_where_a_small_one_gains_no_step_or_does_not_exist() {
        let is_small = |need: Need| !changes_s(600, |_, _| need).is_empty();
        assert!(!is_small(need(0.1, 1.9, Step::Third)), "decoding is a small part");
        assert!(!is_small(Need { has_smaller_mode: false, ..need(1.6, 0.3, Step::Third) }));
        assert!(!is_small(Need { step: (Step::Half, Some(Cause::Hot)), ..need(0.2, 0.3, Step::Half) }));
        assert!(!is_small(need(0.6, 0.3, Step::Full)), "not slow");
        assert!(!is_small(Need { load: None, ..need(1.6, 0.3, Step::Third) }), "no camera");
        assert!(!is_small(Need { is_allowed: false, ..need(1.6, 0.3, Step::Third) }));
        assert!(is_small(need(1.6, 0.3, Step::Third)));
    }

    #[test]
    fn the_full_size_comes_back_when_the_board_is_fast_again_for_ten_minutes() {
        let slow_until_100_s = |now_s, is_small| match (now_s < 100, is_small) {
            (true, true) => need(0.4, 0.3, Step::Full),
            (true, false) => need(1.6, 0.3, Step::Third),
            (false, true) => need(0.1, 0.1, Step::Full),
            (false, false) => need(0.4, 0.1, Step::Full),
        };
        assert_eq!(changes_s(86_400, slow_until_100_s), [30, 700]);
    }

    #[test]
    fn a_prediction_that_is_wrong_each_time_interrupts_the_face_ever_more_rarely() {
        let misleading = |_, is_small| if is_small { need(0.1, 0.1, Step::Full) } else { need(1.6, 0.3, Step::Third) };
        let changes = changes_s(86_400, misleading);
        assert!(changes.len() <= 9, "{changes:?}");
        assert!(changes.windows(2).all(|pair| pair[1] - pair[0] >= 30), "{changes:?}");
    }

    #[test]
    fn settings_that_forbid_it_bring_the_full_size_back_at_once() {
        let mut size = PictureSize::default();
        assert!((0..40).any(|now_s| size.update(now_s * S, &need(1.6, 0.3, Step::Third))));
        assert!(size.update(41 * S, &Need { is_allowed: false, ..need(0.4, 0.3, Step::Full) }));
        assert!(!size.is_small());
    }
}
