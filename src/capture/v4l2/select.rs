//! Which camera a setting means.

use std::path::Path;

use v4l::Device;

use super::super::CaptureError;
use super::mode::{Wish, choose};
use super::probe::{Camera, Found, cameras, probe};

/// The setting that leaves the choice to the program.
const AUTO: &str = "auto";

/// Finds and opens the camera that `wanted` means: `auto` (the first with a usable mode), a path (`/dev/video0` or a
/// link to it), or a part of its name or of its links, in capitals or not.
///
/// # Errors
/// [`CaptureError::NoCamera`], [`CaptureError::NotFound`], [`CaptureError::NotACamera`],
/// [`CaptureError::PermissionDenied`], [`CaptureError::ModeLacking`] if `auto` finds no usable mode.
pub(super) fn open(wanted: &str, wish: &Wish) -> Result<(Camera, Device), CaptureError> {
    if wanted.starts_with('/') {
        return probe(Path::new(wanted));
    }
    let Found { cameras, refused } = cameras();
    match pick(&cameras, wanted, wish) {
        Some(camera) => probe(&camera.node),
        None => Err(refused.into_iter().next().unwrap_or_else(|| missing(&cameras, wanted, wish))),
    }
}

fn pick<'a>(cameras: &'a [Camera], wanted: &str, wish: &Wish) -> Option<&'a Camera> {
    if wanted == AUTO {
        return cameras.iter().find(|camera| choose(&camera.modes, wish).is_some());
    }
    cameras.iter().find(|camera| camera.is_called(wanted))
}

/// Why none of `cameras` serves.
fn missing(cameras: &[Camera], wanted: &str, wish: &Wish) -> CaptureError {
    let Some(first) = cameras.first() else {
        return CaptureError::NoCamera;
    };
    if wanted == AUTO {
        return first.lacks(wish);
    }
    let names: Vec<_> = cameras.iter().map(|camera| format!("{} ({})", camera.card, camera.node.display())).collect();
    CaptureError::NotFound { wanted: wanted.to_owned(), hint: format!("there is {}", names.join(", ")) }
}

impl Camera {
    /// Whether `part` stands in its name or in the name of one of its links.
    fn is_called(&self, part: &str) -> bool {
        let part = part.to_lowercase();
        let links = self.links.iter().filter_map(|link| link.file_name()).map(|name| name.to_string_lossy());
        let named = |name: &str| name.to_lowercase().contains(&part);
        named(&self.card) || links.into_iter().any(|name| named(&name))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::path::PathBuf;

    use super::super::super::FrameRate;
    use super::super::mode::{Mode, PixelFormat, Steps};
    use super::*;

    const WISH: Wish = Wish { width: 640, height: 480, rate: FrameRate::FPS_30, format: None };

    fn camera(node: &str, card: &str, formats: &[PixelFormat]) -> Camera {
        let size = (Steps::one(640), Steps::one(480));
        let mode = |&format| Mode { format, width: size.0, height: size.1, rates: Vec::new() };
        Camera {
            node: PathBuf::from(node),
            card: card.to_owned(),
            driver: "uvcvideo".to_owned(),
            links: vec![PathBuf::from(format!("/dev/v4l/by-id/usb-{}-video-index0", card.replace(' ', "_")))],
            modes: formats.iter().map(mode).collect(),
        }
    }

    fn three() -> Vec<Camera> {
        vec![
            camera("/dev/video0", "Decoder", &[]),
            camera("/dev/video2", "HD Webcam C615", &[PixelFormat::Yuyv]),
            camera("/dev/video4", "Infrared Camera", &[PixelFormat::Grey]),
        ]
    }

    fn picked(wanted: &str, wish: &Wish) -> Option<String> {
        let cameras = three();
        pick(&cameras, wanted, wish).map(|camera| camera.node.display().to_string())
    }

    #[test]
    fn auto_takes_the_first_camera_with_a_usable_mode() {
        assert_eq!(picked("auto", &WISH).as_deref(), Some("/dev/video2"));
        let grey = Wish { format: Some(PixelFormat::Grey), ..WISH };
        assert_eq!(picked("auto", &grey).as_deref(), Some("/dev/video4"));
        assert_eq!(picked("auto", &Wish { format: Some(PixelFormat::Nv12), ..WISH }), None);
    }

    #[test]
    fn a_part_of_the_name_or_of_a_link_is_enough() {
        assert_eq!(picked("c615", &WISH).as_deref(), Some("/dev/video2"));
        assert_eq!(picked("usb-Infrared_", &WISH).as_deref(), Some("/dev/video4"));
        assert_eq!(picked("C920", &WISH), None);
    }

    #[test]
    fn a_missing_camera_is_reported_with_those_that_are_there() {
        let text = missing(&three(), "C920", &WISH).to_string();
        assert!(text.contains("C920") && text.contains("HD Webcam C615 (/dev/video2)"), "{text}");
        assert!(matches!(missing(&[], "auto", &WISH), CaptureError::NoCamera));
    }

    #[test]
    fn what_is_no_camera_is_refused_before_it_is_opened() {
        let reason = |path| open(path, &WISH).err().unwrap();
        assert!(matches!(reason("/dev/null"), CaptureError::NotACamera { .. }));
        assert!(matches!(reason("/dev/tty"), CaptureError::NotACamera { .. }));
        assert!(matches!(reason("/etc/passwd"), CaptureError::NotACamera { .. }));
        assert!(matches!(reason("/dev/video4000"), CaptureError::NotFound { .. }));
    }
}
