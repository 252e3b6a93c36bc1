//! Opens the camera that the settings name, and decides whether and when to open it again.

use std::time::Duration;

use crate::capture::v4l2::{PixelFormat, Wish};
use crate::capture::{self, CaptureError, FrameFault, FrameRate, Source};
use crate::config::{CameraFormat, CameraSettings};
use crate::retry::{BackOff, LONGEST_WAIT};

/// The camera is opened again after this many damaged frames in a row, which cures some cameras.
const MAX_DAMAGED: u32 = 8;

/// Opens the camera: a device, or the built-in clip played as a camera.
///
/// # Errors
/// Those of [`capture::open_camera`].
pub fn open(settings: &CameraSettings) -> Result<Box<dyn Source + Send>, CaptureError> {
    open_wish(settings, &wish(settings))
}

/// Opens the camera with half the width and height of the settings.
///
/// # Errors
/// Those of [`capture::open_camera`].
pub(super) fn open_small(settings: &CameraSettings) -> Result<Box<dyn Source + Send>, CaptureError> {
    open_wish(settings, &wish(settings).halved())
}

fn open_wish(settings: &CameraSettings, wish: &Wish) -> Result<Box<dyn Source + Send>, CaptureError> {
    let timeout = Duration::from_millis(settings.stall_timeout_ms.into());
    capture::open_camera(&settings.device, wish, timeout)
}

fn wish(settings: &CameraSettings) -> Wish {
    let format = match settings.format {
        CameraFormat::Auto => None,
        CameraFormat::Yuyv => Some(PixelFormat::Yuyv),
        CameraFormat::Mjpeg => Some(PixelFormat::Mjpeg),
        CameraFormat::Nv12 => Some(PixelFormat::Nv12),
        CameraFormat::Grey => Some(PixelFormat::Grey),
    };
    let rate = FrameRate::new(settings.fps, 1).unwrap_or(FrameRate::FPS_30);
    Wish { width: settings.width, height: settings.height, rate, format }
}

/// Waits until the camera delivers a first intact frame and discards that frame. A device that opens but delivers only
/// damaged frames does not count as a camera. Calls `damaged` for each damaged frame.
///
/// # Errors
/// [`CaptureError::AllDamaged`], and those of [`Source::next`].
pub fn await_picture(source: &mut dyn Source, mut damaged: impl FnMut()) -> Result<(), CaptureError> {
    let mut in_a_row = DamagedInARow::default();
    loop {
        match source.next() {
            Ok(Some(_)) => return Ok(()),
            Ok(None) => return Err(CaptureError::Gone),
            Err(CaptureError::Frame { fault, .. }) => {
                damaged();
                in_a_row.add(fault)?;
            }
            Err(error) => return Err(error),
        }
    }
}

/// Counts the damaged frames since the last intact one.
#[derive(Debug, Default)]
pub(super) struct DamagedInARow(u32);

impl DamagedInARow {
    /// Counts another damaged frame.
    ///
    /// # Errors
    /// [`CaptureError::AllDamaged`] if there were too many in a row.
    pub(super) fn add(&mut self, fault: FrameFault) -> Result<(), CaptureError> {
        self.0 += 1;
        if self.0 < MAX_DAMAGED { Ok(()) } else { Err(CaptureError::AllDamaged { count: self.0, fault }) }
    }

    /// Begins again after an intact frame.
    pub(super) fn reset(&mut self) {
        self.0 = 0;
    }
}

/// Returns how long to wait before the next attempt to open the camera, which delivered frames for the time `lasted`.
/// The back-off starts again at 100 ms if that was at least [`LONGEST_WAIT`]: a camera that shows a few frames and fails,
/// again and again, does not keep the machine busy.
pub(super) fn wait_after(lasted: Duration, back_off: &mut BackOff) -> Duration {
    if lasted >= LONGEST_WAIT {
        *back_off = BackOff::default();
    }
    back_off.wait()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::capture::{Clip, Description, Frame};

    /// The built-in clip with damaged frames at its beginning.
    struct DamagedClip {
        clip: Clip,
        damaged: u32,
    }

    impl DamagedClip {
        fn new(damaged: u32) -> Self {
            Self { clip: Clip::looped().unwrap(), damaged }
        }
    }

    impl Source for DamagedClip {
        fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
            let Some(left) = self.damaged.checked_sub(1) else { return self.clip.next() };
            self.damaged = left;
            Err(CaptureError::Frame { number: 0, fault: FrameFault::NotJpeg })
        }

        fn frame_period_us(&self) -> Option<u64> {
            self.clip.frame_period_us()
        }

        fn describe(&self) -> Description<'_> {
            self.clip.describe()
        }
    }

    /// Returns how waiting for a picture ends, and how many damaged frames were counted.
    fn awaited(damaged: u32) -> (Result<(), CaptureError>, u32) {
        let mut counted = 0;
        let outcome = await_picture(&mut DamagedClip::new(damaged), || counted += 1);
        (outcome, counted)
    }

    #[test]
    fn a_camera_is_accepted_at_its_first_intact_frame_and_given_up_after_eight_damaged_ones() {
        assert!(matches!(awaited(0), (Ok(()), 0)));
        assert!(matches!(awaited(7), (Ok(()), 7)));
        let (outcome, counted) = awaited(100);
        assert!(matches!(outcome, Err(CaptureError::AllDamaged { count: 8, fault: FrameFault::NotJpeg })));
        assert_eq!(counted, 8);
    }

    #[test]
    fn an_intact_frame_resets_the_count_of_damaged_frames() {
        let mut in_a_row = DamagedInARow::default();
        for _ in 0..3 {
            assert!((0..7).all(|_| in_a_row.add(FrameFault::Corrupt).is_ok()));
            in_a_row.reset();
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
}
