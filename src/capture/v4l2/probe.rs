//! Lists the cameras of this machine and the modes that they offer.

use std::cell::Cell;
use std::fs;
use std::io;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once, PoisonError};
use std::time::{Duration, Instant};

use facewire_board::links_to;
use v4l::capability::{Capabilities, Flags};
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::video::Capture;
use v4l::{Device, FourCC, Fraction};

use super::super::error::IDENTIFYING;
use super::super::{CaptureError, FrameRate};
use super::device::{format, formats};
use super::layout::PixelFormat;
use super::mode::{Mode, Rates, Steps, Wish};

const VIDEO_MAJOR: u32 = 81;
/// Folders of links to the nodes: `by-id` names the camera, `by-path` the socket. A link keeps its name when its node gets
/// another number.
const LINK_FOLDERS: [&str; 2] = ["/dev/v4l/by-id", "/dev/v4l/by-path"];

/// Drivers of a processor's own units, whose nodes capture by the kernel's words but are no cameras: codecs and image signal
/// processors, which convert pictures, and bare receivers, which need libcamera or `media-ctl` first. A path selects such a node
/// nevertheless.
const NO_CAMERAS: [&str; 11] = [
    "bcm2835-codec",
    "bcm2835-isp",
    "ipu3-imgu",
    "isys",
    "mxc-isi",
    "pispbe",
    "qcom-camss",
    "rkisp1",
    "rp1-cfe",
    "rpi-hevc-dec",
    "rpivid",
];

/// A camera with its modes in the supported formats.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Camera {
    /// `/dev/videoN`.
    pub node: PathBuf,
    /// Name that the camera gives itself.
    pub card: String,
    pub driver: String,
    pub is_usb: bool,
    /// Whether it has the kernel's interface for several planes alone.
    pub is_multi_planar: bool,
    /// Links to the node, by-id before by-path.
    pub links: Vec<PathBuf>,
    pub modes: Vec<Mode>,
    /// Its formats that are not read.
    pub other_formats: Vec<String>,
}

#[derive(Debug, Default)]
pub struct Found {
    /// In order of the numbers of their nodes.
    pub cameras: Vec<Camera>,
    /// Cameras whose pictures all need several planes.
    pub multi_planar: Vec<CaptureError>,
    /// Errors of the video devices that could not be examined, such as a missing permission.
    pub refused: Vec<CaptureError>,
}

impl Camera {
    pub(super) fn lacks(&self, wish: &Wish) -> CaptureError {
        let mut offered: Vec<_> = self.modes.iter().map(|mode| mode.format.name).collect();
        offered.dedup();
        let node = self.node.display();
        CaptureError::Unusable(match wish.format.filter(|_| !offered.is_empty()) {
            Some(PixelFormat { name, .. }) => format!(
                "{node} does not offer {name}; set camera.format = \"auto\" for those that it offers ({}), or use another \
                 camera",
                offered.join(", ")
            ),
            None => format!("{node} offers {}; use another camera", self.unread()),
        })
    }

    pub(super) fn needs_planes(&self) -> CaptureError {
        CaptureError::MultiPlanar { path: self.node.display().to_string(), card: self.card.clone() }
    }

    /// Says that none of its formats is read.
    pub fn unread(&self) -> String {
        let others = if self.other_formats.is_empty() { "none".to_owned() } else { self.other_formats.join(", ") };
        format!("no format that facewire reads (it has {others})")
    }
}

impl Found {
    /// Adds what the examination of a node gave, and leaves out nodes that are no cameras.
    fn add(&mut self, examined: Result<Camera, CaptureError>) {
        match examined {
            Ok(camera) if NO_CAMERAS.contains(&camera.driver.as_str()) => {}
            Ok(camera) => self.cameras.push(camera),
            Err(CaptureError::Absent(_) | CaptureError::Gone) => {}
            Err(error @ CaptureError::MultiPlanar { .. }) => self.multi_planar.push(error),
            Err(error) => self.refused.push(error),
        }
    }
}

/// Examines every video device, but none that was examined before and has not changed. Devices that are no cameras (metadata,
/// output, converters) are left out.
pub fn cameras() -> Found {
    let mut found = Found::default();
    let number = |path: &PathBuf| path.file_name()?.to_str()?.strip_prefix("video")?.parse::<u32>().ok();
    let entries = fs::read_dir("/dev").into_iter().flatten().flatten().map(|entry| entry.path());
    let mut nodes: Vec<_> = entries.filter(|path| number(path).is_some()).collect();
    nodes.sort_by_key(number);
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    known.retain(|known| nodes.contains(&known.node));
    nodes.iter().for_each(|node| found.add(examine(node, &mut known)));
    found
}

/// A node is opened again after this time even if it has not changed: some drivers are set up late.
const KNOWN_FOR: Duration = Duration::from_mins(1);

/// What a node was found to be, and when.
struct Known {
    node: PathBuf,
    state: NodeState,
    kind: Kind,
    examined: Instant,
}

#[derive(Clone)]
enum Kind {
    Camera(Camera),
    MultiPlanar { card: String },
    NoCamera,
}

/// What changes if a node leads to another device, or if its permissions do. This shows without opening it, which would switch
/// some devices on.
#[derive(PartialEq, Eq)]
struct NodeState {
    inode: u64,
    device: u64,
    changed_s: i64,
    changed_ns: i64,
}

impl NodeState {
    fn of(node: &Path) -> Option<Self> {
        let meta = fs::metadata(node).ok()?;
        let [changed_s, changed_ns] = [meta.ctime(), meta.ctime_nsec()];
        Some(Self { inode: meta.ino(), device: meta.rdev(), changed_s, changed_ns })
    }
}

/// What the nodes with hardware behind them were found to be. A machine without a camera is searched every second.
static KNOWN: Mutex<Vec<Known>> = Mutex::new(Vec::new());

/// Returns what a node is, and opens it only if that is not known.
fn examine(node: &Path, known: &mut Vec<Known>) -> Result<Camera, CaptureError> {
    if driver_in_sysfs(node).is_some_and(|driver| NO_CAMERAS.contains(&driver.as_str())) {
        return Err(CaptureError::not_a_camera(&node.display()));
    }
    let state = NodeState::of(node);
    let is_valid = |before: &Known| Some(&before.state) == state.as_ref() && before.examined.elapsed() < KNOWN_FOR;
    if let Some(before) = known.iter().find(|before| before.node == node && is_valid(before)) {
        return before.kind.clone().at(node);
    }
    let examined = probe(node).map(|(camera, _)| camera);
    known.retain(|before| before.node != node);
    let kind = Kind::of(&examined).filter(|_| has_hardware(node));
    known.extend(state.zip(kind).map(|(state, kind)| Known {
        node: node.to_owned(),
        state,
        kind,
        examined: Instant::now(),
    }));
    examined
}

impl Kind {
    /// Returns `None` if the next attempt may find something else.
    fn of(examined: &Result<Camera, CaptureError>) -> Option<Self> {
        match examined {
            Ok(camera) if camera.modes.is_empty() && camera.other_formats.is_empty() => None,
            Ok(camera) => Some(Self::Camera(camera.clone())),
            Err(CaptureError::Absent(_)) => Some(Self::NoCamera),
            Err(CaptureError::MultiPlanar { card, .. }) => Some(Self::MultiPlanar { card: card.clone() }),
            Err(_) => None,
        }
    }

    fn at(self, node: &Path) -> Result<Camera, CaptureError> {
        match self {
            // The system makes the links after the node.
            Self::Camera(camera) => Ok(Camera { links: links(node), ..camera }),
            Self::MultiPlanar { card } => Err(CaptureError::MultiPlanar { path: node.display().to_string(), card }),
            Self::NoCamera => Err(CaptureError::not_a_camera(&node.display())),
        }
    }
}

/// What the system tells of a node without opening it.
fn sysfs(node: &Path) -> PathBuf {
    Path::new("/sys/class/video4linux").join(node.file_name().unwrap_or_default())
}

fn driver_in_sysfs(node: &Path) -> Option<String> {
    let driver = fs::canonicalize(sysfs(node).join("device/driver")).ok()?;
    Some(driver.file_name()?.to_str()?.to_owned())
}

/// Whether a device is known to be behind a node, and not a program, as with v4l2loopback. What a program shows may stand still,
/// and its node becomes a camera, or none, without a change.
pub(super) fn has_hardware(node: &Path) -> bool {
    sysfs(node).join("device").exists()
}

fn links(node: &Path) -> Vec<PathBuf> {
    LINK_FOLDERS.iter().flat_map(|folder| links_to(node, folder.as_ref())).collect()
}

pub(super) fn probe(path: &Path) -> Result<(Camera, Device), CaptureError> {
    let fail = |during| move |error| CaptureError::device(path, during, error);
    guarded(path, || {
        let node = video_node(path)?;
        let not_a_camera = || CaptureError::not_a_camera(&path.display());
        let device = Device::with_path(&node).map_err(fail("opening it"))?;
        let identity = identity(&device, &node).map_err(fail(IDENTIFYING))?.ok_or_else(not_a_camera)?;
        let Identity { card, driver, is_usb, is_multi_planar } = identity;
        match format(&device, is_multi_planar) {
            Err(error) if error.kind() == io::ErrorKind::InvalidData => {
                return Err(fail("asking for its format")(error));
            }
            Err(_) => return Err(not_a_camera()),
            // A camera that offers only unsupported formats is listed without modes.
            Ok(_) => {}
        }
        let links = links(&node);
        let (modes, other_formats) = modes(&device, is_multi_planar);
        let camera = Camera { card, driver, is_usb, is_multi_planar, links, modes, other_formats, node };
        let has_planes = camera.other_formats.iter().any(|code| needs_planes(code));
        if has_planes && camera.modes.is_empty() && !NO_CAMERAS.contains(&camera.driver.as_str()) {
            return Err(camera.needs_planes());
        }
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

/// What a device that captures pictures says of itself.
struct Identity {
    card: String,
    driver: String,
    is_usb: bool,
    /// Whether it has the interface for several planes alone.
    is_multi_planar: bool,
}

/// Asks a device what it is. Returns `None` if it does not capture pictures by streaming.
///
/// The v4l crate panics on a camera's name that is not UTF-8, for example because the kernel has cut it within a
/// character. The capabilities of such a device are not queried; its formats decide whether it captures. Only USB cameras
/// name themselves.
fn identity(device: &Device, node: &Path) -> io::Result<Option<Identity>> {
    if let Some(card) = fs::read(sysfs(node).join("name")).ok().filter(|card| std::str::from_utf8(card).is_err()) {
        let card = String::from_utf8_lossy(card.trim_ascii()).into_owned();
        let driver = "unknown".to_owned();
        return Ok(Some(Identity { card, driver, is_usb: true, is_multi_planar: false }));
    }
    let Capabilities { card, driver, bus, capabilities, .. } = device.query_caps()?;
    let can = |flag| capabilities.contains(flag | Flags::STREAMING);
    let is_multi_planar = !can(Flags::VIDEO_CAPTURE);
    let captures = !is_multi_planar || can(Flags::VIDEO_CAPTURE_MPLANE) && !can(Flags::VIDEO_OUTPUT_MPLANE);
    Ok(captures.then(|| Identity { card, driver, is_usb: bus.starts_with("usb"), is_multi_planar }))
}

/// Returns the modes of a camera, and its formats that are not read.
fn modes(device: &Device, is_multi_planar: bool) -> (Vec<Mode>, Vec<String>) {
    let codes = formats(device, is_multi_planar);
    let mut read: Vec<_> = codes.iter().filter_map(|code| PixelFormat::of(code.repr)).collect();
    read.dedup();
    let is_read = |code: &&FourCC| PixelFormat::of(code.repr).is_some();
    let others = codes.iter().filter(|code| !is_read(code)).map(|code| readable(code.repr)).collect();
    (read.into_iter().flat_map(|format| modes_of(device, format, is_multi_planar)).collect(), others)
}

/// Whether this is the code of a pixel format that needs several planes of memory, such as NM12.
fn needs_planes(code: &str) -> bool {
    matches!(code.as_bytes(), [_, b'M', b'0'..=b'9', b'0'..=b'9'])
}

/// The code of a pixel format. Bytes that are no letters, as some drivers have, become question marks.
fn readable(code: [u8; 4]) -> String {
    let letter = |byte: &u8| if byte.is_ascii_graphic() { char::from(*byte) } else { '?' };
    code.trim_ascii().iter().map(letter).collect()
}

/// Returns a mode for each size of a format. A driver that lists no sizes offers the size that is set.
fn modes_of(device: &Device, pixels: PixelFormat, is_multi_planar: bool) -> Vec<Mode> {
    let fourcc = FourCC::new(&pixels.fourcc);
    let sizes = device.enum_framesizes(fourcc).unwrap_or_default();
    let mut sizes: Vec<_> = sizes.into_iter().map(|size| steps(&size.size)).collect();
    sizes.retain(|size| size.iter().all(|side| side.max > 0));
    if sizes.is_empty() {
        sizes.extend(format(device, is_multi_planar).ok().map(|set| [set.width, set.height].map(Steps::one)));
    }
    let mode = |size: [Steps; 2]| {
        let intervals = device.enum_frameintervals(fourcc, size[0].max, size[1].max).unwrap_or_default();
        Mode { format: pixels, size, rates: intervals.iter().filter_map(|of| rates(&of.interval)).collect() }
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
    // Many drivers state an absurd longest interval, such as 2^32 - 1 s, or 1/0 s. Without a numerator it says nothing.
    let slowest = rate(longest).unwrap_or(if longest.numerator > 0 { FrameRate::SLOWEST } else { fastest });
    Some(Rates { slowest, fastest })
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
        Err(CaptureError::undefined(&path.display(), text.unwrap_or("without a message")))
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
            found.add(Ok(Camera { node, card, driver, is_usb: false, ..Camera::default() }));
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
