//! How long the last frames kept the hot loop busy, without a lock and in fixed memory.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

/// Number of frames that are looked at.
const FRAMES: usize = 16;
/// Fewer frames are not judged.
const LEAST_FRAMES: usize = 4;
/// Of [`FRAMES`] frames, this many may take longer than the time that is returned. A few slow frames, such as those on
/// which another program wakes up, do not slow down the face.
const SLOWER: usize = FRAMES / 5;

/// The times of the last frames, each from the beginning of its decoding to its result. The hot loop writes, the
/// supervisor reads; a reader may see some frames of one moment and some of the next.
#[derive(Debug, Default)]
pub(super) struct RecentLoad {
    busy_us: [AtomicU32; FRAMES],
    count: AtomicU64,
    /// Mean time of decoding.
    decoding_us: AtomicU64,
    camera_period_us: AtomicU64,
}

/// What a frame costs, and how much time the camera leaves for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Load {
    /// Decoding and processing of a frame with all networks. Four in five frames take no longer.
    pub(super) busy: Duration,
    /// The part of it that decoding takes, on average.
    pub(super) decoding: Duration,
    /// Time between two frames of the camera.
    pub(super) camera_period: Duration,
}

impl RecentLoad {
    /// Begins with another camera.
    pub(super) fn begin(&self, camera_period: Duration) {
        self.count.store(0, Relaxed);
        self.camera_period_us.store(u64::try_from(camera_period.as_micros()).unwrap_or(u64::MAX), Relaxed);
    }

    /// Adds the time of a frame, as if all networks had run, and the part of it that decoding took. Only the hot loop calls
    /// this.
    pub(super) fn record(&self, busy: Duration, decoding: Duration) {
        let count = self.count.load(Relaxed);
        let (mean_us, weight) = (self.decoding_us.load(Relaxed), count.min(FRAMES as u64));
        let decoding_us = u64::try_from(decoding.as_micros()).unwrap_or(u64::from(u32::MAX));
        self.decoding_us.store((mean_us * weight + decoding_us) / (weight + 1), Relaxed);
        if let Some(slot) = usize::try_from(count).ok().and_then(|count| self.busy_us.get(count % FRAMES)) {
            slot.store(u32::try_from(busy.as_micros()).unwrap_or(u32::MAX), Relaxed);
        }
        self.count.store(count + 1, Relaxed);
    }

    /// Returns the load by the last frames; `None` until the camera has delivered enough of them.
    pub(super) fn load(&self) -> Option<Load> {
        let count = usize::try_from(self.count.load(Relaxed)).unwrap_or(FRAMES).min(FRAMES);
        let mut busy_us = [0; FRAMES];
        for (copy, slot) in busy_us.iter_mut().zip(&self.busy_us).take(count) {
            *copy = slot.load(Relaxed);
        }
        let seen = busy_us.get_mut(..count).filter(|seen| seen.len() >= LEAST_FRAMES)?;
        seen.sort_unstable();
        let busy_us = seen.iter().rev().nth(SLOWER * count / FRAMES)?;
        let camera_period = Duration::from_micros(self.camera_period_us.load(Relaxed));
        let decoding = Duration::from_micros(self.decoding_us.load(Relaxed));
        Some(Load { busy: Duration::from_micros(u64::from(*busy_us)), decoding, camera_period })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The busy time after frames that took these milliseconds.
    fn busy_ms(frames_ms: &[u64]) -> Option<u128> {
        let recent = RecentLoad::default();
        recent.begin(Duration::from_millis(33));
        for ms in frames_ms {
            recent.record(Duration::from_millis(*ms), Duration::ZERO);
        }
        recent.load().map(|load| load.busy.as_millis())
    }

    #[test]
    fn a_few_slow_frames_are_no_load_and_more_of_them_are() {
        assert_eq!(busy_ms(&[[10; 13].as_slice(), &[500; 3]].concat()), Some(10));
        assert_eq!(busy_ms(&[[10; 12].as_slice(), &[500; 4]].concat()), Some(500));
        assert_eq!(busy_ms(&[[500; 9].as_slice(), &[10; 16]].concat()), Some(10), "old frames are forgotten");
    }

    #[test]
    fn a_new_camera_is_judged_by_its_own_frames_once_there_are_enough() {
        assert_eq!(busy_ms(&[10; 3]), None);
        assert_eq!(busy_ms(&[10; 4]), Some(10));
        let recent = RecentLoad::default();
        (0..16).for_each(|_| recent.record(Duration::from_millis(500), Duration::from_millis(400)));
        recent.begin(Duration::from_millis(20));
        assert_eq!(recent.load(), None);
        (0..4).for_each(|_| recent.record(Duration::from_millis(10), Duration::from_millis(3)));
        let [busy, decoding, camera_period] = [10, 3, 20].map(Duration::from_millis);
        assert_eq!(recent.load(), Some(Load { busy, decoding, camera_period }));
    }
}
