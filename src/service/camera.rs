//! The open camera, whether and when to open it again, and what it shows that impairs tracking. The service and the
//! commands read frames through it.

use std::sync::Arc;
use std::time::Duration;

use facewire_face::Landmarks;

use super::counters::Counters;
use crate::capture::v4l2::{PixelFormat, Wish};
use crate::capture::{self, CaptureError, Frame, FrameFault, FrameRate, Source, monotonic_us};
use crate::config::{CameraFormat, CameraSettings};
use crate::retry::{BackOff, LONGEST_WAIT};
use crate::watch::{Look, Watch};

/// The camera is opened again after this many damaged frames in a row, which cures some cameras.
const MAX_DAMAGED: u32 = 8;
/// Time from one look at the picture to the next, microseconds.
const LOOK_US: u64 = 250_000;
/// Time for which an impairment must last, or be gone, before that is reported, microseconds.
const HOLD_US: u64 = 3_000_000;

/// A camera, or the built-in clip played as one.
pub struct OpenCamera {
    pub source: Box<dyn Source + Send>,
    /// How many damaged frames have come since the last intact one, and what was wrong with the last of them.
    damaged: Option<(u32, FrameFault)>,
}

impl OpenCamera {
    pub fn open(settings: &CameraSettings) -> Result<Self, CaptureError> {
        let mut camera = Self::begin(settings, false)?;
        camera.await_picture(|| {})?;
        Ok(camera)
    }

    /// Opens the camera, with half the width and height of the settings if `is_small`.
    pub(super) fn begin(settings: &CameraSettings, is_small: bool) -> Result<Self, CaptureError> {
        let format = match settings.format {
            CameraFormat::Auto => None,
            CameraFormat::Yuyv => Some(PixelFormat::Yuyv),
            CameraFormat::Mjpeg => Some(PixelFormat::Mjpeg),
            CameraFormat::Nv12 => Some(PixelFormat::Nv12),
            CameraFormat::Grey => Some(PixelFormat::Grey),
        };
        let rate = FrameRate::new(settings.fps, 1).unwrap_or(FrameRate::FPS_30);
        let wish = Wish { width: settings.width, height: settings.height, rate, format };
        let wish = if is_small { wish.halved() } else { wish };
        let timeout = Duration::from_millis(settings.stall_timeout_ms.into());
        Ok(Self { source: capture::open_camera(&settings.device, &wish, timeout)?, damaged: None })
    }

    /// Waits for the newest frame. Returns `None` in place of a damaged one.
    pub fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        match self.source.next() {
            Ok(Some(frame)) => {
                self.damaged = None;
                Ok(Some(frame))
            }
            Ok(None) => Err(CaptureError::Gone),
            Err(CaptureError::Frame { fault, .. }) => {
                self.damaged = Some((self.damaged.map_or(1, |(count, _)| count + 1), fault));
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Fails if so many damaged frames came in a row that the camera is to be opened again.
    pub(super) fn check(&self) -> Result<(), CaptureError> {
        let too_many = self.damaged.filter(|(count, _)| *count >= MAX_DAMAGED);
        too_many.map_or(Ok(()), |(count, fault)| Err(CaptureError::AllDamaged { count, fault }))
    }

    /// Waits until the camera delivers a first intact frame and discards that frame. A device that opens but delivers
    /// only damaged frames does not count as a camera. Calls `damaged` for each damaged frame.
    pub(super) fn await_picture(&mut self, mut damaged: impl FnMut()) -> Result<(), CaptureError> {
        while self.next()?.is_none() {
            damaged();
            self.check()?;
        }
        Ok(())
    }

    pub fn close(self) -> Result<(), CaptureError> {
        self.source.close()
    }
}

/// Returns how long to wait before the next attempt to open the camera, which delivered frames for the time `lasted`. A
/// camera that shows a few frames and fails, again and again, does not keep the machine busy.
pub(super) fn wait_after(lasted: Duration, back_off: &mut BackOff) -> Duration {
    if lasted >= LONGEST_WAIT {
        *back_off = BackOff::default();
    }
    back_off.wait()
}

/// Watches for the hot loop: between a frame and the next it neither allocates nor waits.
#[derive(Debug)]
pub(super) struct Watcher {
    counters: Arc<Counters>,
    pub(super) watch: Watch,
    /// The frame period that the camera states, microseconds.
    pub(super) stated_us: Option<u64>,
    last_look_us: u64,
}

impl Watcher {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        Self { counters, watch: Watch::new(HOLD_US), stated_us: None, last_look_us: 0 }
    }

    /// Clears the impairments, because a closed camera causes none.
    pub(super) fn forget(&mut self) {
        self.watch = Watch::new(HOLD_US);
        self.tell();
    }

    /// Looks at a picture, if the last look was long enough ago, and at the face that was found in it.
    pub(super) fn look(&mut self, frame: &Frame, face: Option<&Landmarks>) {
        let Some(picture) = frame.picture() else { return };
        // The timestamps of some drivers step back.
        if frame.captured_us.abs_diff(self.last_look_us) >= LOOK_US {
            self.last_look_us = frame.captured_us;
            self.watch.look(&Look::at(picture, face), frame.captured_us);
            self.tell();
        }
    }

    pub(super) fn count(&mut self, camera: &mut dyn Source) {
        if let Some(delivery) = camera.take_delivery() {
            self.watch.delivery(&delivery, self.stated_us, monotonic_us());
            self.tell();
        }
    }

    fn tell(&self) {
        self.counters.impairments.set_all(Watch::FINDS, self.watch.present());
    }
}

#[cfg(test)]
mod tests {
    use facewire_face::{Picture, Pixels};

    use super::*;
    use crate::capture::{Clip, Content, Description};

    struct DamagedClip {
        clip: Clip,
        damaged: u32,
    }

    impl Source for DamagedClip {
        fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
            let Some(left) = self.damaged.checked_sub(1) else { return self.clip.next() };
            self.damaged = left;
            Err(CaptureError::Frame { number: 0, fault: FrameFault::NotJpeg })
        }

        fn describe(&self) -> Description<'_> {
            self.clip.describe()
        }
    }

    #[test]
    fn a_camera_is_accepted_at_its_first_intact_frame_and_given_up_after_eight_damaged_ones_in_a_row() {
        for (damaged, expected) in [(0, 0), (7, 7), (100, 8)] {
            let source = Box::new(DamagedClip { clip: Clip::looped().unwrap(), damaged });
            let (mut camera, mut counted) = (OpenCamera { source, damaged: None }, 0);
            let outcome = camera.await_picture(|| counted += 1);
            let is_given_up = matches!(outcome, Err(CaptureError::AllDamaged { count: 8, fault: FrameFault::NotJpeg }));
            assert_eq!((counted, is_given_up), (expected, damaged == 100));
            assert_eq!(camera.damaged.is_none(), !is_given_up, "an intact frame begins the count again");
        }
    }

    #[test]
    fn waits_double_up_to_a_second_and_begin_again_only_after_a_camera_that_lasted_a_second() {
        let mut back_off = BackOff::default();
        let mut wait_ms = |lasted_ms| wait_after(Duration::from_millis(lasted_ms), &mut back_off).as_millis();
        assert_eq!([0; 6].map(&mut wait_ms), [100, 200, 400, 800, 1000, 1000]);
        assert_eq!(wait_ms(999), 1000, "a glimpse");
        assert_eq!([1000, 0].map(&mut wait_ms), [100, 200]);
    }

    #[test]
    fn a_camera_whose_timestamps_step_back_is_watched_all_the_same() {
        let counters = Arc::new(Counters::default());
        let mut watcher = Watcher::new(Arc::clone(&counters));
        let pixels = Pixels::Grey { data: &[0; 64 * 64], stride: 64 };
        let content = Content::Picture(Picture::new(64, 64, pixels, true).unwrap());
        let mut look = |captured_us| watcher.look(&Frame { content, captured_us, number: 0 }, None);
        look(3_600_000_000);
        (0..16).for_each(|number| look(5_000_000 + number * LOOK_US));
        assert_eq!(counters.impairments.present().to_string(), "black");
    }
}
