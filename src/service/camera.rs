//! The open camera, and whether and when to open it again. The service and the commands read frames through it.

use std::time::Duration;

use crate::capture::v4l2::{PixelFormat, Wish};
use crate::capture::{self, CaptureError, Content, Frame, FrameFault, FrameRate, Source};
use crate::config::{CameraFormat, CameraSettings};
use facewire_face::Rotation;

/// The camera is opened again after this many damaged frames in a row, which cures some cameras.
const MAX_DAMAGED: u32 = 8;

/// A camera, or the built-in clip played as one.
pub struct OpenCamera {
    pub source: Box<dyn Source + Send>,
    pub rotation: Rotation,
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
            CameraFormat::Yuyv => Some(PixelFormat::YUYV),
            CameraFormat::Mjpeg => Some(PixelFormat::MJPEG),
            CameraFormat::Nv12 => Some(PixelFormat::NV12),
            CameraFormat::Grey => Some(PixelFormat::GREY),
        };
        let rate = FrameRate::new(settings.fps, 1).unwrap_or(FrameRate::FPS_30);
        let wish = Wish { width: settings.width, height: settings.height, rate, format };
        let wish = if is_small { wish.halved() } else { wish };
        let timeout = Duration::from_millis(settings.stall_timeout_ms.into());
        let source = capture::open_camera(&settings.device, &wish, timeout)?;
        Ok(Self { source, rotation: settings.rotation, damaged: None })
    }

    /// Waits for the newest frame. Returns `None` in place of a damaged one.
    pub fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        match self.source.next() {
            Ok(Some(mut frame)) => {
                self.damaged = None;
                if let Content::Picture(picture) = &mut frame.content {
                    *picture = picture.rotated(self.rotation);
                }
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
    pub fn check(&self) -> Result<(), CaptureError> {
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::{Clip, Description};

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
            let mut camera = OpenCamera { source, rotation: Rotation::None, damaged: None };
            let mut counted = 0;
            let outcome = camera.await_picture(|| counted += 1);
            let is_given_up = matches!(outcome, Err(CaptureError::AllDamaged { count: 8, fault: FrameFault::NotJpeg }));
            assert_eq!((counted, is_given_up), (expected, damaged == 100));
            assert_eq!(camera.damaged.is_none(), !is_given_up, "an intact frame begins the count again");
        }
    }
}
