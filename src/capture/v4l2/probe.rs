//! Lists the cameras of this machine and the modes that they offer.

use std::cell::Cell;
use std::fs;
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::{Path, PathBuf};
use std::sync::Once;

use facewire_board::links_to;
use v4l::capability::Flags;
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;
use v4l::{Device, FourCC, Fraction};

use super::super::{CaptureError, FrameRate};
use super::mode::{Mode, PixelFormat, Rates, Steps, Wish};

const VIDEO_MAJOR: u32 = 81;
/// Folders of links to the nodes: `by-id` names the camera, `by-path` the socket. A link keeps its name when its node gets
/// another number.
const LINK_FOLDERS: [&str; 2] = ["/dev/v4l/by-id", "/dev/v4l/by-path"];

/// Drivers of a processor's own units, whose nodes capture by the kernel's words but are no cameras: codecs and image signal
/// processors, which convert pictures, and bare receivers, which need libcamera or `media-ctl` first. Most are a Raspberry
/// Pi's, and `isys` is a laptop's. A path selects such a node nevertheless.
const NO_CAMERAS: [&str; 7] = ["bcm2835-codec", "bcm2835-isp", "isys", "pispbe", "rp1-cfe", "rpi-hevc-dec", "rpivid"];

/// A camera with its modes in the supported formats.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Camera {
    /// `/dev/videoN`.
    pub node: PathBuf,
    /// Name that the camera gives itself.
    pub card: String,
    pub driver: String,
    pub is_usb: bool,
    /// Links to the node, by-id before by-path.
    pub links: Vec<PathBuf>,
    pub modes: Vec<Mode>,
}

#[derive(Debug, Default)]
pub struct Found {
    /// In order of the numbers of their nodes.
    pub cameras: Vec<Camera>,
    /// Errors of the video devices that could not be examined, such as a missing permission.
    pub refused: Vec<CaptureError>,
}

impl Camera {
    pub(super) fn lacks(&self, wish: &Wish) -> CaptureError {
        let mut offered: Vec<_> = self.modes.iter().map(|mode| mode.format.name()).collect();
        offered.dedup();
        let offered = if offered.is_empty() { "none that is supported".to_owned() } else { offered.join(", ") };
        let wanted = wish.format.map_or("YUYV, NV12, MJPEG, JPEG or GREY", PixelFormat::name);
        let remedy = format!("set camera.format to a format it offers ({offered}), or use another camera");
        CaptureError::Unusable(format!("{} does not offer {wanted}; {remedy}", self.node.display()))
    }
}

impl Found {
    /// Adds what the examination of a node gave, and leaves out nodes that are no cameras.
    fn add(&mut self, examined: Result<Camera, CaptureError>) {
        match examined {
            Ok(camera) if NO_CAMERAS.contains(&camera.driver.as_str()) => {}
            Ok(camera) => self.cameras.push(camera),
            Err(CaptureError::Absent(_) | CaptureError::Gone) => {}
            Err(error) => self.refused.push(error),
        }
    }
}

/// Examines every video device. Devices that are no cameras (metadata, output, converters) are left out.
pub fn cameras() -> Found {
    let mut found = Found::default();
    let number = |path: &PathBuf| path.file_name()?.to_str()?.strip_prefix("video")?.parse::<u32>().ok();
    let entries = fs::read_dir("/dev").into_iter().flatten().flatten().map(|entry| entry.path());
    let mut nodes: Vec<_> = entries.filter(|path| number(path).is_some()).collect();
    nodes.sort_by_key(number);
    nodes.iter().for_each(|node| found.add(probe(node).map(|(camera, _)| camera)));
    found
}

pub(super) fn probe(path: &Path) -> Result<(Camera, Device), CaptureError> {
    let fail = |during| move |error| CaptureError::device(path, during, error);
    guarded(path, || {
        let node = video_node(path)?;
        let device = Device::with_path(&node).map_err(fail("opening it"))?;
        let (card, driver, is_usb) = match identity(&device, &node).map_err(fail("asking what it is"))? {
            // A camera that offers only unsupported formats is listed without modes.
            Some(identity) if device.format().is_ok() => identity,
            _ => return Err(CaptureError::not_a_camera(&path.display())),
        };
        let links = LINK_FOLDERS.iter().flat_map(|folder| links_to(&node, folder.as_ref())).collect();
        let camera = Camera { card, driver, is_usb, links, modes: modes(&device), node };
        Ok((camera, device))
    })
}

/// Returns the node to which `path` leads, if it is a video device. This is checked before the node is opened, because
/// opening a serial port by mistake would reset the board behind it.
fn video_node(path: &Path) -> Result<PathBuf, CaptureError> {
    let fail = |error| CaptureError::device(path, "looking for it", error);
    let node = fs::canonicalize(path).map_err(fail)?;
    let meta = fs::metadata(&node).map_err(fail)?;
    let is_video = meta.file_type().is_char_device() && rustix::fs::major(meta.rdev()) == VIDEO_MAJOR;
    if is_video { Ok(node) } else { Err(CaptureError::not_a_camera(&path.display())) }
}

/// Returns the names of the camera and of its driver, and whether it is on a USB bus; `None` if the device does not
/// capture pictures by streaming.
///
/// The v4l crate panics on a camera's name that is not UTF-8, for example because the kernel has cut it within a
/// character. The capabilities of such a device are not queried; its formats decide whether it captures. Only USB cameras
/// name themselves.
fn identity(device: &Device, node: &Path) -> io::Result<Option<(String, String, bool)>> {
    let name = Path::new("/sys/class/video4linux").join(node.file_name().unwrap_or_default()).join("name");
    if let Some(card) = fs::read(name).ok().filter(|card| std::str::from_utf8(card).is_err()) {
        return Ok(Some((String::from_utf8_lossy(card.trim_ascii()).into_owned(), "unknown".to_owned(), true)));
    }
    let caps = device.query_caps()?;
    let captures = caps.capabilities.contains(Flags::VIDEO_CAPTURE | Flags::STREAMING);
    Ok(captures.then(|| (caps.card, caps.driver, caps.bus.starts_with("usb"))))
}

fn modes(device: &Device) -> Vec<Mode> {
    let codes = device.enum_formats().unwrap_or_default().into_iter().map(|format| format.fourcc.repr);
    let mut formats: Vec<_> = codes.filter_map(PixelFormat::of).collect();
    formats.dedup();
    formats.into_iter().flat_map(|format| modes_of(device, format)).collect()
}

/// Returns a mode for each size of a format. A driver that lists no sizes offers the size that is set.
fn modes_of(device: &Device, format: PixelFormat) -> Vec<Mode> {
    let fourcc = FourCC::new(&format.fourcc());
    let sizes = device.enum_framesizes(fourcc).unwrap_or_default();
    let mut sizes: Vec<_> = sizes.into_iter().map(|size| steps(&size.size)).collect();
    sizes.retain(|size| size.iter().all(|side| side.max > 0));
    if sizes.is_empty() {
        sizes.extend(device.format().ok().map(|set| [set.width, set.height].map(Steps::one)));
    }
    let mode = |size: [Steps; 2]| {
        let intervals = device.enum_frameintervals(fourcc, size[0].max, size[1].max).unwrap_or_default();
        Mode { format, size, rates: intervals.iter().filter_map(|of| rates(&of.interval)).collect() }
    };
    sizes.into_iter().map(mode).collect()
}

fn steps(size: &FrameSizeEnum) -> [Steps; 2] {
    match size {
        FrameSizeEnum::Discrete(size) => [size.width, size.height].map(Steps::one),
        FrameSizeEnum::Stepwise(size) => [
            Steps { min: size.min_width, max: size.max_width, step: size.step_width },
            Steps { min: size.min_height, max: size.max_height, step: size.step_height },
        ],
    }
}

fn rates(interval: &FrameIntervalEnum) -> Option<Rates> {
    let rate = |interval: &Fraction| FrameRate::new(interval.denominator, interval.numerator);
    let (shortest, longest) = match interval {
        FrameIntervalEnum::Discrete(interval) => (interval, interval),
        FrameIntervalEnum::Stepwise(steps) => (&steps.min, &steps.max),
    };
    let fastest = rate(shortest)?;
    // Many drivers state an absurd longest interval.
    Some(Rates { slowest: rate(longest).unwrap_or(fastest), fastest })
}

thread_local! {
    /// Whether [`guarded`] reports a panic of this thread as an error.
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `ask` on the device at `path`. A panic becomes an error and is not printed.
///
/// The v4l crate panics on unexpected values: a field order that the kernel does not define (the writer of a v4l2loopback
/// device can set one), a name that is not UTF-8, or an error when buffers are given back.
pub(super) fn guarded<T>(path: &Path, ask: impl FnOnce() -> Result<T, CaptureError>) -> Result<T, CaptureError> {
    // The hook ignores guarded panics, and passes all others to the previous one.
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let previous = take_hook();
        set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                previous(info);
            }
        }));
    });
    let before = GUARDED.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(ask));
    GUARDED.set(before);
    outcome.unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
        let path = path.display();
        let reason = text.unwrap_or("without a message");
        let fault = format!("returned a value that the kernel does not define ({reason})");
        Err(CaptureError::Unusable(format!("the driver of {path} {fault}; use another camera")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_a_processor_are_no_cameras_and_a_device_that_could_not_be_examined_is_told() {
        let mut found = Found::default();
        for driver in NO_CAMERAS.into_iter().chain(["uvcvideo", "bm2835 mmal", "unicam", "v4l2 loopback"]) {
            let node = "/dev/video14".into();
            let card = driver.to_owned();
            let driver = driver.to_owned();
            found.add(Ok(Camera { node, card, driver, is_usb: false, links: Vec::new(), modes: Vec::new() }));
        }
        found.add(Err(CaptureError::Gone));
        found.add(Err(CaptureError::Unusable("no permission".to_owned())));
        let drivers: Vec<_> = found.cameras.iter().map(|camera| camera.driver.as_str()).collect();
        assert_eq!((drivers, found.refused.len()), (vec!["uvcvideo", "bm2835 mmal", "unicam", "v4l2 loopback"], 1));
    }

    #[test]
    fn a_panic_becomes_an_error_of_the_device_and_later_panics_are_not_guarded() {
        let path = Path::new("/dev/video7");
        let outcome = guarded(path, || -> Result<(), _> { panic!("Invalid field order: {}", 77) });
        let text = outcome.map_err(|error| error.to_string());
        assert!(text.is_err_and(|text| text.contains("/dev/video7") && text.contains("(Invalid field order: 77)")));
        assert!(!GUARDED.get());
        assert!(matches!(guarded(path, || Ok(3)), Ok(3)));
    }
}
