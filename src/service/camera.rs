//! From the settings to an open camera.

use std::time::Duration;

use crate::capture::v4l2::{PixelFormat, Wish};
use crate::capture::{self, CaptureError, FrameRate, Source};
use crate::config::{CameraFormat, CameraSettings};

/// Opens the camera that the settings name: a device, or the built-in clip played as one.
///
/// # Errors
/// Those of [`capture::open_camera`].
pub fn open(settings: &CameraSettings) -> Result<Box<dyn Source + Send>, CaptureError> {
    let timeout = Duration::from_millis(settings.stall_timeout_ms.into());
    capture::open_camera(&settings.device, &wish(settings), timeout)
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
