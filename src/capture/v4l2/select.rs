//! Finds the camera that a setting names.

use std::path::{Path, PathBuf};

use v4l::Device;

use super::super::CaptureError;
use super::mode::{Wish, choose};
use super::probe::{Camera, Found, cameras, probe};

/// The setting that selects the first usable camera.
const AUTO: &str = "auto";

/// The camera that a setting names.
pub(super) struct Selected {
    pub(super) camera: Camera,
    pub(super) device: Device,
    /// Name and node for the operator, with the other cameras that the setting fits.
    pub(super) origin: String,
}

/// Finds and opens the camera that `wanted` names: `auto` (the first camera with a usable mode), a path (`/dev/video0` or a
/// link to it), or a part of the camera's name or of its links, in upper or lower case. If several cameras have such a
/// name, the first with a usable mode is opened.
///
/// # Errors
/// [`CaptureError::NoCamera`], [`CaptureError::NotFound`], [`CaptureError::NotACamera`],
/// [`CaptureError::PermissionDenied`], [`CaptureError::ModeLacking`] if `auto` finds no usable mode.
pub(super) fn open(wanted: &str, wish: &Wish) -> Result<Selected, CaptureError> {
    let selected = |(camera, device), rivals: &[PathBuf]| {
        let origin = origin(&camera, rivals);
        Selected { camera, device, origin }
    };
    if wanted.starts_with('/') {
        return probe(Path::new(wanted)).map(|found| selected(found, &[]));
    }
    let Found { cameras, refused } = cameras();
    match pick(&cameras, wanted, wish) {
        Some((camera, rivals)) => probe(&camera.node).map(|found| selected(found, &rivals)),
        None => Err(refused.into_iter().next().unwrap_or_else(|| missing(&cameras, wanted, wish))),
    }
}

/// Returns the camera that is named, and the nodes of the other usable cameras with such a name. A camera without a usable
/// mode is selected only if no other has such a name, because many webcams have a second device of the same name.
fn pick<'a>(cameras: &'a [Camera], wanted: &str, wish: &Wish) -> Option<(&'a Camera, Vec<PathBuf>)> {
    let mut usable = cameras.iter().filter(|camera| choose(&camera.modes, wish).is_some());
    if wanted == AUTO {
        return usable.next().map(|camera| (camera, Vec::new()));
    }
    let mut named = usable.filter(|camera| camera.is_named(wanted));
    let first = named.next().or_else(|| cameras.iter().find(|camera| camera.is_named(wanted)))?;
    Some((first, named.map(|camera| camera.node.clone()).collect()))
}

/// The error if none of `cameras` can be selected.
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

/// Describes a camera to the operator, and tells how to distinguish it from `rivals`.
fn origin(camera: &Camera, rivals: &[PathBuf]) -> String {
    let (card, node) = (&camera.card, camera.node.display());
    if rivals.is_empty() {
        return format!("{card} ({node})");
    }
    let rivals: Vec<_> = rivals.iter().map(|rival| rival.display().to_string()).collect();
    let rivals = rivals.join(", ");
    // The last link names the socket, and so distinguishes cameras of the same model.
    let remedy = camera.links.last().map_or("a path".to_owned(), |link| format!("\"{}\"", link.display()));
    format!("{card} ({node}, but the name fits {rivals} too: set camera.device = {remedy} to keep to this one)")
}

impl Camera {
    /// Returns whether the name of the camera or of one of its links contains `part`.
    fn is_named(&self, part: &str) -> bool {
        let part = part.to_lowercase();
        let links = self.links.iter().filter_map(|link| link.file_name()).map(|name| name.to_string_lossy());
        let fits = |name: &str| name.to_lowercase().contains(&part);
        fits(&self.card) || links.into_iter().any(|name| fits(&name))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
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

    fn selected(wanted: &str, wish: &Wish) -> Option<String> {
        let cameras = three();
        pick(&cameras, wanted, wish).map(|(camera, _)| camera.node.display().to_string())
    }

    #[test]
    fn auto_selects_the_first_camera_with_a_usable_mode() {
        assert_eq!(selected("auto", &WISH).as_deref(), Some("/dev/video2"));
        let grey = Wish { format: Some(PixelFormat::Grey), ..WISH };
        assert_eq!(selected("auto", &grey).as_deref(), Some("/dev/video4"));
        assert_eq!(selected("auto", &Wish { format: Some(PixelFormat::Nv12), ..WISH }), None);
    }

    #[test]
    fn a_part_of_the_name_or_of_a_link_selects_the_camera() {
        assert_eq!(selected("c615", &WISH).as_deref(), Some("/dev/video2"));
        assert_eq!(selected("usb-Infrared_", &WISH).as_deref(), Some("/dev/video4"));
        assert_eq!(selected("C920", &WISH), None);
    }

    #[test]
    fn of_several_cameras_of_one_name_the_first_usable_one_is_selected_and_the_others_are_named() {
        let mut cameras = three();
        cameras.insert(0, camera("/dev/video1", "HD Webcam C615", &[]));
        cameras.push(camera("/dev/video6", "HD Webcam C615", &[PixelFormat::Yuyv]));
        let (first, rivals) = pick(&cameras, "C615", &WISH).unwrap();
        assert_eq!(
            (first.node.as_path(), &rivals[..]),
            (Path::new("/dev/video2"), &[PathBuf::from("/dev/video6")][..])
        );
        let (unusable, _) = pick(&cameras[..1], "C615", &WISH).unwrap();
        assert_eq!(unusable.node, Path::new("/dev/video1"), "the error is about its formats then");
        assert!(pick(&cameras, "auto", &WISH).unwrap().1.is_empty());
    }

    #[test]
    fn an_ambiguous_name_is_reported_with_its_remedy() {
        let named = |links: &[&str], rivals: &[&str]| {
            let links = links.iter().map(PathBuf::from).collect();
            let camera = Camera { links, ..camera("/dev/video2", "C615", &[]) };
            origin(&camera, &rivals.iter().map(PathBuf::from).collect::<Vec<_>>())
        };
        let links = ["/dev/v4l/by-id/usb-C615", "/dev/v4l/by-path/usb-1"];
        assert_eq!(named(&links, &[]), "C615 (/dev/video2)");
        let text = "C615 (/dev/video2, but the name fits /dev/video4, /dev/video6 too: \
                    set camera.device = \"/dev/v4l/by-path/usb-1\" to keep to this one)";
        assert_eq!(named(&links, &["/dev/video4", "/dev/video6"]), text);
        assert!(named(&[], &["/dev/video4"]).contains("set camera.device = a path to keep"));
    }

    #[test]
    fn a_missing_camera_is_reported_with_the_existing_ones() {
        let text = missing(&three(), "C920", &WISH).to_string();
        assert!(text.contains("C920") && text.contains("HD Webcam C615 (/dev/video2)"), "{text}");
        assert!(matches!(missing(&[], "auto", &WISH), CaptureError::NoCamera));
    }

    #[test]
    fn a_path_to_another_kind_of_file_is_refused_before_it_is_opened() {
        let reason = |path| open(path, &WISH).err().unwrap();
        assert!(matches!(reason("/dev/null"), CaptureError::NotACamera { .. }));
        assert!(matches!(reason("/dev/tty"), CaptureError::NotACamera { .. }));
        assert!(matches!(reason("/etc/passwd"), CaptureError::NotACamera { .. }));
        assert!(matches!(reason("/dev/video4000"), CaptureError::NotFound { .. }));
    }
}
