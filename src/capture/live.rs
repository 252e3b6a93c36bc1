//! What the sources have in common whose frames come by themselves: cameras and named pipes.

use std::mem::take;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::Tally;
use super::delivery::DeliveryCounter;
use super::repeats::Repeats;

/// A source that has shown this many pictures is a good one: if it fails after that, it is tried first again.
const PROVEN_AFTER: u32 = 30;
/// Largest number of frames that are left out at once, so that a camera with a wrong clock is read nevertheless.
const MAX_LEFT_OUT: u32 = 16;

/// The sources that failed in this process, the last one at the end.
static FAILED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
/// The pictures at which cameras hung when they were closed.
static FROZEN: Mutex<Vec<(PathBuf, u64)>> = Mutex::new(Vec::new());

/// Remembers whether a source failed when it was used last.
pub(super) fn remember(path: &Path, has_failed: bool) {
    let mut failed = FAILED.lock().unwrap_or_else(PoisonError::into_inner);
    failed.retain(|failed| failed != path);
    failed.extend(has_failed.then(|| path.to_owned()));
}

/// The sources that failed when they were used last, the last one at the end.
pub(super) fn failed() -> Vec<PathBuf> {
    FAILED.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// The state of an open source.
pub(super) struct Live {
    path: PathBuf,
    /// Frames that were captured earlier are left out.
    pub(super) wanted_us: u64,
    /// Number of frames that were left out since the last one that was wanted.
    left_out: u32,
    pub(super) tally: Tally,
    pub(super) delivery: DeliveryCounter,
    pub(super) repeats: Repeats,
    /// Number of pictures so far, up to [`PROVEN_AFTER`].
    shown: u32,
    /// Whether no picture came when one was asked for the last time.
    has_failed: bool,
}

impl Live {
    pub(super) fn new(path: &Path, period_us: u64) -> Self {
        let frozen = FROZEN.lock().unwrap_or_else(PoisonError::into_inner);
        let picture = frozen.iter().find(|(frozen, _)| frozen == path).map(|(_, picture)| *picture);
        Self {
            path: path.to_owned(),
            wanted_us: 0,
            left_out: 0,
            tally: Tally::default(),
            delivery: DeliveryCounter::new(period_us),
            repeats: Repeats::new(picture),
            shown: 0,
            has_failed: false,
        }
    }

    /// Whether the frame that was captured at this time is left out, because a later one is wanted. Counts it.
    pub(super) fn leaves_out(&mut self, captured_us: u64) -> bool {
        let is_left_out = captured_us < self.wanted_us && self.left_out < MAX_LEFT_OUT;
        if is_left_out {
            self.left_out += 1;
            self.tally.left_out += 1;
        } else {
            self.left_out = 0;
        }
        is_left_out
    }

    /// Takes what the source answers to whom asks for the next picture.
    pub(super) fn answered<T, E>(&mut self, answer: Result<T, E>) -> Result<T, E> {
        self.has_failed = answer.is_err();
        self.shown = PROVEN_AFTER.min(self.shown + u32::from(answer.is_ok()));
        answer
    }

    pub(super) fn has_shown_nothing(&self) -> bool {
        self.shown == 0
    }

    pub(super) fn take_tally(&mut self) -> Tally {
        take(&mut self.tally)
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        let is_proven = self.shown == PROVEN_AFTER;
        if is_proven || self.has_failed {
            remember(&self.path, !is_proven);
        }
        let mut frozen = FROZEN.lock().unwrap_or_else(PoisonError::into_inner);
        frozen.retain(|(path, _)| *path != self.path);
        frozen.extend(self.repeats.frozen().map(|picture| (self.path.clone(), picture)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_most_16_frames_in_a_row_are_left_out_before_the_one_that_is_wanted() {
        let mut live = Live::new(Path::new("/dev/video4001"), 1);
        live.wanted_us = 100;
        let left_out: Vec<_> = (0..20).map(|_| live.leaves_out(99)).collect();
        assert_eq!(left_out.iter().position(|is_left_out| !is_left_out), Some(16));
        assert!(!live.leaves_out(100));
        assert_eq!((live.take_tally().left_out, live.take_tally().left_out), (19, 0));
    }

    #[test]
    fn a_source_that_failed_is_remembered_unless_it_has_shown_30_pictures_and_so_is_the_picture_at_which_it_hung() {
        let use_it = |path: &Path, pictures: u32| {
            let mut live = Live::new(path, 1);
            (0..pictures).for_each(|_| live.answered(Ok::<_, ()>(())).unwrap());
            let _ = live.answered(Err::<(), _>(()));
            for second in 0..20 {
                live.repeats.is_frozen(&[7; 100], second * 1_000_000);
            }
        };
        let [young, proven] = ["/dev/video4002", "/dev/video4003"].map(Path::new);
        use_it(young, 29);
        use_it(proven, 30);
        let failed = failed();
        assert!(failed.contains(&young.to_owned()) && !failed.contains(&proven.to_owned()));
        assert!(Live::new(young, 1).repeats.is_frozen(&[7; 100], 0), "the picture is remembered");
        assert!(!Live::new(young, 1).repeats.is_frozen(&[8; 100], 0));
    }
}
