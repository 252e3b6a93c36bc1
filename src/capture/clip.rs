//! The built-in clip: 240 frames of a rendered face, 640 x 480 pixels, 30 frames per second, in a file of its own; and a film
//! played as if it were a camera.

use std::env;
use std::fs::File;
use std::io::{Seek as _, SeekFrom};
use std::mem::take;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};

use super::{AviSource, CaptureError, Description, Frame, FrameRate, Source, Tally, monotonic_us};

/// The name of the built-in clip, in place of a file or a camera.
pub const DEMO: &str = "demo";
const VARIABLE: &str = "FACEWIRE_DEMO";
const INSTALLED: &str = "/usr/share/facewire/demo.avi";
/// Largest number of frames that are skipped at once, so that a process that was stopped for hours continues soon.
const MAX_SKIPPED: u32 = 300;

#[derive(Debug)]
pub struct Clip {
    file: Arc<File>,
    film: AviSource<Arc<File>>,
    looped: bool,
}

/// Returns the path of the clip: beside the program, in the checkout in which it was built, or where a package puts it.
fn path() -> PathBuf {
    if let Some(named) = env::var_os(VARIABLE) {
        return named.into();
    }
    let program = env::current_exe().unwrap_or_default();
    let folders: Vec<&Path> = program.ancestors().skip(1).collect();
    let beside = folders.first().map(|folder| folder.join("demo.avi"));
    let in_checkout = folders.iter().map(|folder| folder.join("src/capture/demo.avi"));
    // A build for tests may stand in a folder far from its checkout.
    let of_tests = cfg!(debug_assertions).then(|| concat!(env!("CARGO_MANIFEST_DIR"), "/src/capture/demo.avi").into());
    let found = beside.into_iter().chain(in_checkout).chain(of_tests).find(|path| path.is_file());
    found.unwrap_or_else(|| INSTALLED.into())
}

impl Clip {
    pub fn once() -> Result<Self, CaptureError> {
        let path = path();
        let refused = |error| CaptureError::unopened(&path.display().to_string(), &error);
        let file = Arc::new(File::open(&path).map_err(refused)?);
        Ok(Self { film: AviSource::open(Arc::clone(&file), DEMO, FrameRate::FPS_30)?, file, looped: false })
    }

    /// Opens the clip, to be repeated for ever. Frame numbers and times continue to grow.
    pub fn looped() -> Result<Self, CaptureError> {
        Ok(Self { looped: true, ..Self::once()? })
    }
}

impl Source for Clip {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        if self.skip()? { self.film.decoded().map(Some) } else { Ok(None) }
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        if self.film.skip()? {
            return Ok(true);
        }
        if self.looped {
            self.file.seek(SeekFrom::Start(0)).map_err(CaptureError::Read)?;
            self.film.rewind(Arc::clone(&self.file))?;
        }
        self.film.skip()
    }

    fn describe(&self) -> Description<'_> {
        self.film.describe()
    }
}

/// The clip, repeated in real time as a camera delivers it: with timestamps of the monotonic clock, and skipping frames for a
/// reader that is late.
#[derive(Debug)]
pub(super) struct Paced {
    clip: Clip,
    period_us: u64,
    /// Time at which the next frame is due. The first call sets it.
    due_us: Option<u64>,
    /// Frames that are due earlier are left out.
    wanted_us: u64,
    pub(super) tally: Tally,
}

impl Paced {
    pub(super) fn new(clip: Clip) -> Self {
        let period_us = clip.frame_period_us().unwrap_or(FrameRate::FPS_30.period_us());
        Self { clip, period_us, due_us: None, wanted_us: 0, tally: Tally::default() }
    }
}

impl Source for Paced {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let now_us = monotonic_us();
        let due_us = self.due_us.unwrap_or(now_us);
        let [for_newer, left_out] = frames_skipped(now_us, due_us, self.wanted_us, self.period_us);
        let count = for_newer.saturating_add(left_out);
        let captured_us = due_us + u64::from(count) * self.period_us;
        self.due_us = Some(captured_us + self.period_us);
        self.tally.for_newer = self.tally.for_newer.saturating_add(for_newer);
        self.tally.left_out = self.tally.left_out.saturating_add(left_out);
        for _ in 0..count.min(MAX_SKIPPED) {
            self.clip.skip()?;
        }
        sleep(Duration::from_micros(captured_us.saturating_sub(now_us)));
        let begun = Instant::now();
        let frame = self.clip.next()?;
        self.tally.decoding += begun.elapsed();
        Ok(frame.map(|frame| Frame { captured_us, ..frame }))
    }

    fn leave_out_until(&mut self, captured_us: u64) {
        self.wanted_us = captured_us;
    }

    fn take_tally(&mut self) -> Tally {
        take(&mut self.tally)
    }

    fn describe(&self) -> Description<'_> {
        self.clip.describe()
    }
}

/// Returns how many frames from `due_us` on are older than the newest one, apart from those that are due before `wanted_us`,
/// and how many the latter are.
fn frames_skipped(now_us: u64, due_us: u64, wanted_us: u64, period_us: u64) -> [u32; 2] {
    let count = |periods: u64| u32::try_from(periods).unwrap_or(u32::MAX);
    let left_out = count(wanted_us.saturating_sub(due_us).div_ceil(period_us));
    let older = count(now_us.saturating_sub(due_us) / period_us);
    [older.saturating_sub(left_out), left_out]
}

#[cfg(test)]
mod tests {
    use facewire_face::Pixels;

    use super::*;

    #[test]
    fn the_looped_clip_repeats_its_240_pictures_while_numbers_and_times_grow() {
        let luma = |frame: &Frame<'_>| match frame.picture().unwrap().pixels {
            Pixels::Planar { planes: [luma, ..], .. } => luma.to_vec(),
            _ => panic!("the clip is Motion-JPEG"),
        };
        let [mut once, mut looped] = [Clip::once().unwrap(), Clip::looped().unwrap()];
        let first = luma(&looped.next().unwrap().unwrap());
        assert!((0..240).all(|_| once.skip().unwrap()) && (1..240).all(|_| looped.skip().unwrap()));
        assert!(!once.skip().unwrap() && once.next().unwrap().is_none());
        let again = looped.next().unwrap().unwrap();
        assert_eq!((again.number, again.captured_us), (240, 8_000_000));
        assert_eq!(luma(&again), first);
    }

    #[test]
    fn a_late_reader_gets_the_newest_frame_that_is_due() {
        for (now_us, wanted_us, skipped, what) in [
            (109, 0, [0, 0], "still the newest"),
            (110, 0, [1, 0], "late"),
            (135, 0, [3, 0], "later"),
            (99, 125, [0, 3], "the frame that is due at 130 is the first wanted one"),
            (155, 125, [2, 3], "of the wanted ones the newest"),
            (u64::MAX, 0, [u32::MAX, 0], "no overflow"),
        ] {
            assert_eq!(frames_skipped(now_us, 100, wanted_us, 10), skipped, "{what}");
        }
    }

    #[test]
    fn frames_carry_the_monotonic_time_at_which_they_were_due_and_skipped_ones_are_counted() {
        const PERIOD_US: u64 = 33_333;
        for (wanted_periods, late_periods) in [(0, 0), (2, 0), (0, 5)] {
            let mut camera = Paced::new(Clip::looped().unwrap());
            let mut first_us = camera.next().unwrap().unwrap().captured_us;
            if late_periods > 0 {
                first_us = monotonic_us() - (late_periods + 1) * PERIOD_US;
                camera.due_us = Some(first_us + PERIOD_US);
            }
            camera.leave_out_until(first_us + wanted_periods * PERIOD_US);
            let (captured_us, number) = camera.next().unwrap().map(|frame| (frame.captured_us, frame.number)).unwrap();
            let Tally { for_newer, left_out, .. } = camera.take_tally();
            let periods = u64::from(for_newer + left_out) + 1;
            assert_eq!((captured_us, number), (first_us + periods * PERIOD_US, periods));
            assert!(captured_us <= monotonic_us() && u64::from(for_newer) >= late_periods);
            assert_eq!(u64::from(left_out), wanted_periods.saturating_sub(1));
            assert_eq!(camera.take_tally(), Tally::default());
        }
    }
}
