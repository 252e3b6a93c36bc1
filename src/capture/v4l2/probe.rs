//! Lists the cameras of this machine and the modes that they offer.

use std::fs;
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use v4l::capability::Flags;
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;
use v4l::{Device, FourCC, Fraction};

use super::super::{CaptureError, FrameRate};
use super::guard::guarded;
use super::mode::{Mode, PixelFormat, Rates, Steps, Wish};

/// The kernel's major number of video devices.
const VIDEO_MAJOR: u32 = 81;
/// Folders of links to the nodes. A link keeps its name when its node gets another number.
const LINK_FOLDERS: [&str; 2] = ["/dev/v4l/by-id", "/dev/v4l/by-path"];

/// A camera with its modes in the supported formats.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Camera {
    /// The device node, `/dev/videoN`.
    pub node: PathBuf,
    /// Name that the camera gives itself.
    pub card: String,
    /// Name of the kernel driver.
    pub driver: String,
    /// Links to the node, by-id before by-path.
    pub links: Vec<PathBuf>,
    /// Formats, sizes and rates.
    pub modes: Vec<Mode>,
}

/// The outcome of a search.
#[derive(Debug, Default)]
pub struct Found {
    /// Cameras in order of the numbers of their nodes.
    pub cameras: Vec<Camera>,
    /// Errors of the video devices that could not be examined, such as a missing permission.
    pub refused: Vec<CaptureError>,
}

impl Camera {
    /// The error for a wish that no mode of this camera meets.
    pub(super) fn lacks(&self, wish: &Wish) -> CaptureError {
        let mut offered: Vec<_> = self.modes.iter().map(|mode| mode.format.name()).collect();
        offered.dedup();
        CaptureError::ModeLacking {
            path: self.node.display().to_string(),
            wanted: wish.format.map_or("YUYV, NV12, MJPEG, JPEG or GREY", PixelFormat::name),
            offered: if offered.is_empty() { "none that is supported".to_owned() } else { offered.join(", ") },
        }
    }
}

/// Examines every video device. Devices that do not capture pictures (metadata, output, converters) are left out.
#[must_use]
pub fn cameras() -> Found {
    let mut found = Found::default();
    for node in nodes() {
        match probe(&node) {
            Ok((camera, _)) => found.cameras.push(camera),
            Err(CaptureError::NotACamera { .. } | CaptureError::NotFound { .. } | CaptureError::Gone) => {}
            Err(error) => found.refused.push(error),
        }
    }
    found
}

/// Opens the camera at `path` and lists its modes.
///
/// # Errors
/// [`CaptureError::NotFound`], [`CaptureError::NotACamera`], [`CaptureError::Driver`], and those of
/// [`CaptureError::device`].
pub(super) fn probe(path: &Path) -> Result<(Camera, Device), CaptureError> {
    guarded(path, || examine(path))
}

fn examine(path: &Path) -> Result<(Camera, Device), CaptureError> {
    let fail = |during| move |error| CaptureError::device(path, during, error);
    let node = video_node(path)?;
    let device = Device::with_path(&node).map_err(fail("opening it"))?;
    let (card, driver, captures) = identity(&device, &node).map_err(fail("asking what it is"))?;
    // A camera that offers only unsupported formats is listed without modes.
    if !captures || device.format().is_err() {
        return Err(not_a_camera(path));
    }
    let camera = Camera { card, driver, links: links(&node), modes: modes(&device), node };
    Ok((camera, device))
}

/// Returns the node to which `path` leads, if it is a video device. This is checked before the node is opened, because
/// opening a serial port by mistake would reset the board behind it.
fn video_node(path: &Path) -> Result<PathBuf, CaptureError> {
    let fail = |error| CaptureError::device(path, "looking for it", error);
    let node = fs::canonicalize(path).map_err(fail)?;
    let meta = fs::metadata(&node).map_err(fail)?;
    let is_video = meta.file_type().is_char_device() && rustix::fs::major(meta.rdev()) == VIDEO_MAJOR;
    if is_video { Ok(node) } else { Err(not_a_camera(path)) }
}

fn not_a_camera(path: &Path) -> CaptureError {
    CaptureError::NotACamera { path: path.display().to_string() }
}

/// Returns all `/dev/videoN` in order of their numbers.
fn nodes() -> Vec<PathBuf> {
    let number = |path: &PathBuf| path.file_name()?.to_str()?.strip_prefix("video")?.parse::<u32>().ok();
    let mut nodes: Vec<_> = entries("/dev").filter(|path| number(path).is_some()).collect();
    nodes.sort_by_key(number);
    nodes
}

fn links(node: &Path) -> Vec<PathBuf> {
    let leads_here = |link: &PathBuf| fs::canonicalize(link).is_ok_and(|target| target == node);
    let mut links: Vec<_> = LINK_FOLDERS.into_iter().flat_map(entries).filter(leads_here).collect();
    // This puts `by-id`, which names the camera, before `by-path`, which names the socket.
    links.sort();
    links
}

fn entries(folder: &str) -> impl Iterator<Item = PathBuf> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path())
}

/// Returns the names of the camera and of its driver, and whether the device captures pictures by streaming.
///
/// The v4l crate panics on a camera's name that is not UTF-8, for example because the kernel has cut it within a
/// character. The capabilities of such a device are not queried; its formats decide whether it captures.
fn identity(device: &Device, node: &Path) -> io::Result<(String, String, bool)> {
    let name = Path::new("/sys/class/video4linux").join(node.file_name().unwrap_or_default()).join("name");
    if let Some(card) = fs::read(name).ok().filter(|card| std::str::from_utf8(card).is_err()) {
        return Ok((String::from_utf8_lossy(card.trim_ascii()).into_owned(), "unknown".to_owned(), true));
    }
    let caps = device.query_caps()?;
    let captures = caps.capabilities.contains(Flags::VIDEO_CAPTURE | Flags::STREAMING);
    Ok((caps.card, caps.driver, captures))
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
    let mut sizes: Vec<_> = sizes.into_iter().filter_map(|size| steps(&size.size)).collect();
    if sizes.is_empty() {
        sizes.extend(device.format().ok().map(|set| [Steps::one(set.width), Steps::one(set.height)]));
    }
    let mode = |[width, height]: [Steps; 2]| {
        let rates = rates(device, fourcc, [width.max, height.max]);
        Mode { format, width, height, rates }
    };
    sizes.into_iter().map(mode).collect()
}

fn steps(size: &FrameSizeEnum) -> Option<[Steps; 2]> {
    let [width, height] = match size {
        FrameSizeEnum::Discrete(size) => [Steps::one(size.width), Steps::one(size.height)],
        FrameSizeEnum::Stepwise(size) => [
            Steps { min: size.min_width, max: size.max_width, step: size.step_width },
            Steps { min: size.min_height, max: size.max_height, step: size.step_height },
        ],
    };
    (width.max > 0 && height.max > 0).then_some([width, height])
}

fn rates(device: &Device, fourcc: FourCC, [width, height]: [u32; 2]) -> Vec<Rates> {
    let intervals = device.enum_frameintervals(fourcc, width, height).unwrap_or_default();
    intervals.iter().filter_map(|interval| rates_of(&interval.interval)).collect()
}

fn rates_of(interval: &FrameIntervalEnum) -> Option<Rates> {
    let rate = |interval: &Fraction| FrameRate::new(interval.denominator, interval.numerator);
    match interval {
        FrameIntervalEnum::Discrete(interval) => rate(interval).map(|rate| Rates { slowest: rate, fastest: rate }),
        FrameIntervalEnum::Stepwise(steps) => {
            let fastest = rate(&steps.min)?;
            // Many drivers state an absurd longest interval.
            Some(Rates { slowest: rate(&steps.max).unwrap_or(fastest), fastest })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_format_is_reported_with_the_offered_ones() {
        let camera = Camera {
            node: "/dev/video7".into(),
            card: "Old camera".to_owned(),
            driver: "gspca".to_owned(),
            links: Vec::new(),
            modes: Vec::new(),
        };
        let wish = Wish { width: 1, height: 1, rate: FrameRate::FPS_30, format: Some(PixelFormat::Nv12) };
        let text = camera.lacks(&wish).to_string();
        assert!(
            text.contains("/dev/video7") && text.contains("NV12") && text.contains("none that is supported"),
            "{text}"
        );
    }
}
