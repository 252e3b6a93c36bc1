//! Simulated cameras that behave as a test describes them (`tests/hooks/camera.c`). The program needs no device.

use std::env;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::Write as _;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, SystemTime};
use std::{slice, thread};

use facewire::capture::{Clip, Source as _};
use facewire_face::Pixels;
use rustix::io::Errno;
use tempfile::TempDir;

use super::eventually;
use super::film::demo_avi;
use super::hooks::hook;
use super::program::{Run, facewire};
use super::service::{Receiver, Service};

const FOLDER: &str = "CAMERAS";
/// Frames of the built-in clip that a camera shows in turn.
const CLIP_FRAMES: usize = 20;

/// Values that a driver lists, each a pair: a width and a height, or the seconds and frames of an interval.
#[derive(Debug, Clone, Copy)]
pub enum Listing {
    /// The driver lists nothing, and has only this value.
    Unlisted([u32; 2]),
    Discrete(&'static [[u32; 2]]),
    Steps {
        least: [u32; 2],
        most: [u32; 2],
        step: [u32; 2],
    },
    Continuous {
        least: [u32; 2],
        most: [u32; 2],
    },
}

/// The clock by which a driver stamps frames. Times are in microseconds.
#[derive(Debug, Clone, Copy)]
pub enum Clock {
    Monotonic,
    /// Stands still from the start of the stream.
    Frozen,
    /// Always shows this time.
    Constant(i64),
    /// The time of day, passed off as monotonic.
    Realtime,
    /// Ahead by this time; behind, if it is negative.
    Offset(i64),
    /// Goes at this percentage of the true rate.
    Rate(i64),
    /// Steps back by this time for every tenth frame.
    StepsBack(i64),
    /// Counts from 0 at the start of the stream.
    FromStart,
    /// Gives every second frame the time of the one before it.
    Pairs,
    /// Always shows this time, which the driver marks as of an unknown clock (`V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN`).
    Unknown(i64),
    /// Always shows this time, which the driver marks as copied from an output buffer (`V4L2_BUF_FLAG_TIMESTAMP_COPY`).
    Copied(i64),
}

/// A share of the frames. `(1, 5)` stands for the last of every 5 frames, `(0, 0)` for none.
pub type Share = (u32, u32);

/// A call that fails: `open`, `mmap`, or a V4L2 call such as `STREAMON`. With `nth` 0 it fails every time, else only the
/// `nth` time since the camera was last described.
#[derive(Debug, Clone, Copy)]
pub struct Failure {
    pub call: &'static str,
    pub error: Errno,
    pub nth: u32,
}

/// A camera. The default is a faultless webcam, which sends grey pictures without a face in YUYV, 640x480 at 30 fps.
#[derive(Debug, Clone)]
pub struct Camera {
    pub card: &'static str,
    pub driver: &'static str,
    pub bus: &'static str,
    /// `V4L2_CAP_...` of the whole device, and of this node.
    pub capabilities: [u32; 2],
    pub formats: &'static [&'static str],
    pub sizes: Listing,
    pub intervals: Listing,
    /// What the driver sets whatever it is asked for.
    pub granted_format: Option<&'static str>,
    pub granted_size: Option<[u32; 2]>,
    pub granted_interval: Option<[u32; 2]>,
    /// The interval at which frames really come, whatever the driver says.
    pub pace: Option<[u32; 2]>,
    pub stride: Option<u32>,
    pub image_bytes: Option<u32>,
    pub colorspace: u32,
    pub quantization: u32,
    pub field: u32,
    /// The planes of the formats of a camera with several, of which it fills the first alone, and the bytes in front of the
    /// picture in that one.
    pub planes: u32,
    pub data_offset: u32,
    /// A folder that [`Cameras::film`] has made. Without it, the pictures are grey.
    pub frames: Option<PathBuf>,
    /// The number of frames after the start of the stream. Then none come.
    pub limit: Option<u32>,
    /// The frames that are lost on the way, that the driver marks as damaged, that are empty, and that are cut in half.
    pub lost: Share,
    pub marked: Share,
    pub empty: Share,
    pub cut: Share,
    /// The number of the first frame, and the step from each number to the next.
    pub sequence: [u32; 2],
    pub clock: Clock,
    pub failures: Vec<Failure>,
    /// Whether the system has made the node a moment ago.
    pub is_new: bool,
}

pub const VIDEO_CAPTURE: u32 = 0x1;
pub const VIDEO_CAPTURE_MPLANE: u32 = 0x1000;
pub const META_CAPTURE: u32 = 0x80_0000;
pub const STREAMING: u32 = 0x400_0000;
pub const DEVICE_CAPS: u32 = 0x8000_0000;
/// A fast camera, so that a test of many frames takes little time.
pub const FPS_120: Listing = Listing::Discrete(&[[1, 120]]);

impl Default for Camera {
    fn default() -> Self {
        Self {
            card: "Simulated camera",
            driver: "uvcvideo",
            bus: "usb-0000:01:00.0-1.2",
            capabilities: [VIDEO_CAPTURE | STREAMING | DEVICE_CAPS, VIDEO_CAPTURE | STREAMING],
            formats: &["YUYV"],
            sizes: Listing::Discrete(&[[640, 480]]),
            intervals: Listing::Discrete(&[[1, 30]]),
            granted_format: None,
            granted_size: None,
            granted_interval: None,
            pace: None,
            stride: None,
            image_bytes: None,
            colorspace: 8,
            quantization: 0,
            field: 1,
            planes: 1,
            data_offset: 0,
            frames: None,
            limit: None,
            lost: (0, 0),
            marked: (0, 0),
            empty: (0, 0),
            cut: (0, 0),
            sequence: [0, 1],
            clock: Clock::Monotonic,
            failures: Vec::new(),
            is_new: false,
        }
    }
}

impl Camera {
    /// A camera with one call that always fails.
    pub fn failing(call: &'static str, error: Errno) -> Self {
        Self { failures: vec![Failure { call, error, nth: 0 }], ..Self::default() }
    }

    /// A camera that is not on a USB bus.
    pub fn built_in() -> Self {
        Self { driver: "vivid", bus: "platform:vivid-000", ..Self::default() }
    }

    /// The same camera with the kernel's interface for several planes alone, as most at a camera connector have it.
    pub fn multi_planar(self) -> Self {
        let own = VIDEO_CAPTURE_MPLANE | STREAMING;
        Self { capabilities: [own | DEVICE_CAPS, own], ..self }
    }

    /// A camera whose pictures a program makes: there is no device behind its node.
    pub fn of_a_program() -> Self {
        Self { driver: "v4l2 loopback", bus: "platform:v4l2loopback-000", ..Self::default() }
    }

    fn has_hardware(&self) -> bool {
        !self.bus.starts_with("platform:v4l2loopback")
    }

    /// The description that `tests/hooks/camera_description.h` reads.
    fn describe(&self) -> String {
        let [capabilities, device_capabilities] = self.capabilities;
        let [first, step] = self.sequence;
        let mut text = format!("card {}\ndriver {}\nbus {}\n", self.card, self.driver, self.bus);
        writeln!(text, "capabilities {capabilities}\ndevice_capabilities {device_capabilities}").unwrap();
        writeln!(text, "formats {}", self.formats.join(" ")).unwrap();
        writeln!(text, "sizes {}\nintervals {}", self.sizes.describe('x'), self.intervals.describe('/')).unwrap();
        writeln!(text, "colorspace {}\nquantization {}", self.colorspace, self.quantization).unwrap();
        writeln!(text, "field {}\nsequence {first} {step}\nclock {}", self.field, self.clock.describe()).unwrap();
        writeln!(text, "planes {}\ndata_offset {}", self.planes, self.data_offset).unwrap();
        let pair = |[first, second]: [u32; 2], sign| format!("{first}{sign}{second}");
        let options = [
            ("granted_format", self.granted_format.map(str::to_owned)),
            ("granted_size", self.granted_size.map(|size| pair(size, 'x'))),
            ("granted_interval", self.granted_interval.map(|interval| pair(interval, '/'))),
            ("pace", self.pace.map(|interval| pair(interval, '/'))),
            ("stride", self.stride.map(|number| number.to_string())),
            ("image_bytes", self.image_bytes.map(|number| number.to_string())),
            ("frames", self.frames.as_ref().map(|folder| folder.display().to_string())),
            ("limit", self.limit.map(|number| number.to_string())),
        ];
        for (key, value) in options {
            text.extend(value.map(|value| format!("{key} {value}\n")));
        }
        for (key, (count, of)) in
            [("lost", self.lost), ("marked", self.marked), ("empty", self.empty), ("short", self.cut)]
        {
            writeln!(text, "{key} {count} {of}").unwrap();
        }
        for Failure { call, error, nth } in &self.failures {
            writeln!(text, "fail {call} {} {nth}", error.raw_os_error()).unwrap();
        }
        text
    }
}

impl Listing {
    fn describe(self, sign: char) -> String {
        let (name, pairs) = match self {
            Self::Unlisted(only) => ("none", vec![only]),
            Self::Discrete(pairs) => ("discrete", pairs.to_vec()),
            Self::Steps { least, most, step } => ("steps", vec![least, most, step]),
            Self::Continuous { least, most } => ("continuous", vec![least, most]),
        };
        let pairs = pairs.iter().map(|[first, second]| format!(" {first}{sign}{second}"));
        name.to_owned() + &pairs.collect::<String>()
    }
}

impl Clock {
    fn describe(self) -> String {
        let (name, number) = match self {
            Self::Monotonic => ("monotonic", 0),
            Self::Frozen => ("frozen", 0),
            Self::Constant(time_us) => ("constant", time_us),
            Self::Realtime => ("realtime", 0),
            Self::Offset(time_us) => ("offset", time_us),
            Self::Rate(percent) => ("rate", percent),
            Self::StepsBack(time_us) => ("steps-back", time_us),
            Self::FromStart => ("from-start", 0),
            Self::Pairs => ("pairs", 0),
            Self::Unknown(time_us) => ("unknown", time_us),
            Self::Copied(time_us) => ("copied", time_us),
        };
        format!("{name} {number}")
    }
}

/// The cameras of a simulated machine, in the folder from which the program takes them.
pub struct Cameras {
    folder: PathBuf,
    /// Removes the folder at the end.
    _owner: Option<TempDir>,
}

impl Cameras {
    /// A machine with these cameras, from `/dev/video0` on.
    pub fn with(cameras: &[Camera]) -> Self {
        let owner = tempfile::tempdir().unwrap();
        let folder = owner.path().canonicalize().unwrap();
        for name in ["dev/v4l/by-id", "dev/v4l/by-path", "sys/class/video4linux", "run/facewire-camera", "calls"] {
            fs::create_dir_all(folder.join(name)).unwrap();
        }
        let machine = Self { folder, _owner: Some(owner) };
        (0..).zip(cameras).for_each(|(number, camera)| machine.plug(number, camera));
        machine
    }

    /// A machine with this camera as `/dev/video0`.
    pub fn one(camera: &Camera) -> Self {
        Self::with(slice::from_ref(camera))
    }

    /// Runs the calling test again in a process that has these cameras, and returns them there. Returns `None` in the first
    /// process, after the other one has passed.
    pub fn inside(cameras: &[Camera]) -> Option<Self> {
        if let Some(folder) = env::var_os(FOLDER) {
            return Some(Self { folder: folder.into(), _owner: None });
        }
        let machine = Self::with(cameras);
        let mut this = Command::new(env::current_exe().unwrap());
        this.args(["--exact", thread::current().name().unwrap(), "--nocapture"]);
        Run::of(machine.prepare(&mut this)).succeeded();
        None
    }

    fn node(&self, number: u32) -> PathBuf {
        self.folder.join(format!("dev/video{number}"))
    }

    fn sysfs(&self, number: u32) -> PathBuf {
        self.folder.join(format!("sys/class/video4linux/video{number}"))
    }

    /// The pipe through which the service of a Raspberry Pi's camera module passes its pictures.
    pub fn module(&self) -> PathBuf {
        self.folder.join("run/facewire-camera/video")
    }

    /// Plugs a camera in as `/dev/videoN`. If there is one already, it is unplugged.
    pub fn plug(&self, number: u32, camera: &Camera) {
        let _ = fs::remove_dir_all(self.sysfs(number));
        let device = self.sysfs(number).join("device");
        fs::create_dir_all(if camera.has_hardware() { &device } else { device.parent().unwrap() }).unwrap();
        fs::write(self.sysfs(number).join("name"), format!("{}\n", camera.card)).unwrap();
        if camera.has_hardware() {
            let driver = self.folder.join("sys/bus/drivers").join(camera.driver);
            fs::create_dir_all(&driver).unwrap();
            symlink(driver, device.join("driver")).unwrap();
        }
        let prepared = self.folder.join("prepared");
        fs::write(&prepared, camera.describe()).unwrap();
        set_age(&File::options().write(true).open(&prepared).unwrap(), camera);
        fs::rename(&prepared, self.node(number)).unwrap();
    }

    pub fn unplug(&self, number: u32) {
        fs::remove_dir_all(self.sysfs(number)).unwrap();
        fs::remove_file(self.node(number)).unwrap();
    }

    /// Gives the camera a new description, which takes effect at once, even if the camera is open.
    pub fn change(&self, number: u32, camera: &Camera) {
        let mut node = File::options().write(true).open(self.node(number)).unwrap();
        node.lock().unwrap();
        node.set_len(0).unwrap();
        node.write_all(camera.describe().as_bytes()).unwrap();
        set_age(&node, camera);
    }

    /// Makes a link in `/dev/v4l`, as udev does, or makes an existing link lead to another camera.
    pub fn link(&self, link: &str, number: u32) {
        let link = self.folder.join("dev/v4l").join(link);
        let _ = fs::remove_file(&link);
        symlink(format!("../../video{number}"), link).unwrap();
    }

    /// The calls to a camera so far, one on each line: `open`, `S_FMT YUYV 640x480 field 1`, `S_PARM 1/30`, `REQBUFS 4`,
    /// `STREAMON`, `STREAMOFF`, `close`.
    pub fn calls(&self, number: u32) -> String {
        fs::read_to_string(self.folder.join(format!("calls/video{number}"))).unwrap_or_default()
    }

    /// How often the camera was asked for this so far.
    pub fn called(&self, number: u32, call: &str) -> usize {
        self.calls(number).lines().filter(|line| *line == call).count()
    }

    /// Makes the command find these cameras, and none of the real machine.
    pub fn prepare<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command.env("LD_PRELOAD", hook("camera")).env(FOLDER, &self.folder)
    }

    /// Runs the program to its end.
    pub fn run(&self, arguments: &[&str]) -> Run {
        Run::of(self.prepare(&mut facewire(arguments)))
    }

    /// Starts a service with these settings, and a receiver.
    pub fn serve(&self, toml: &str) -> (Service, Receiver) {
        let receiver = Receiver::new();
        let service = Service::start_with(toml, &[receiver.address()], |command| self.prepare(command));
        (service, receiver)
    }

    /// Plugs a camera in as `/dev/video0` that shows the face of the built-in clip in its first format.
    pub fn show_clip(&self, camera: Camera) -> Camera {
        let format = camera.formats[0];
        let mut camera = camera;
        let frames = if ["MJPG", "JPEG"].contains(&format) {
            clip_jpegs(CLIP_FRAMES)
        } else {
            let stride = *camera.stride.get_or_insert(640 * bytes_of_pixel(format));
            let frames = clip_raw(format, stride as usize, CLIP_FRAMES);
            camera.image_bytes = Some(frames[0].len() as u32);
            frames
        };
        camera.frames = self.film("clip", &frames);
        self.plug(0, &camera);
        camera
    }

    /// Writes frames, which [`Camera::frames`] shows in turn, into a folder of this name.
    pub fn film(&self, name: &str, frames: &[Vec<u8>]) -> Option<PathBuf> {
        let folder = self.folder.join(name);
        fs::create_dir(&folder).unwrap();
        for (number, frame) in frames.iter().enumerate() {
            fs::write(folder.join(format!("{number:04}")), frame).unwrap();
        }
        Some(folder)
    }
}

/// Makes the node of a camera a minute old, unless it is a new one.
fn set_age(node: &File, camera: &Camera) {
    let age = Duration::from_secs(if camera.is_new { 0 } else { 60 });
    node.set_modified(SystemTime::now() - age).unwrap();
}

/// The first frames of the built-in clip, as JPEG images of 640x480 pixels.
pub fn clip_jpegs(count: usize) -> Vec<Vec<u8>> {
    let film = fs::read(demo_avi()).unwrap();
    let chunks =
        film.windows(10).enumerate().filter(|(_, bytes)| bytes.starts_with(b"00dc") && bytes.ends_with(b"\xff\xd8"));
    let image = |(at, bytes): (usize, &[u8])| {
        let length = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
        film[at + 8..][..length].to_vec()
    };
    chunks.take(count).map(image).collect()
}

/// The first frames of the built-in clip in a raw format, whose rows of luma are `stride` bytes long.
pub fn clip_raw(fourcc: &str, stride: usize, count: usize) -> Vec<Vec<u8>> {
    let mut clip = Clip::once().unwrap();
    let mut frames = Vec::new();
    for _ in 0..count {
        let frame = clip.next().unwrap().unwrap();
        let picture = frame.picture().unwrap();
        let Pixels::Planar { planes: [luma, u, v], strides: [640, 320], .. } = picture.pixels() else {
            panic!("the clip is 4:2:2 without padding");
        };
        frames.push(raw(fourcc, stride, [luma, u, v]));
    }
    frames
}

/// The bytes of a pixel in a row of luma or of colours.
fn bytes_of_pixel(fourcc: &str) -> u32 {
    match fourcc {
        "YUYV" | "UYVY" | "YVYU" | "VYUY" | "RGBP" | "Y10 " | "Y12 " | "Y16 " => 2,
        "RGB3" | "BGR3" => 3,
        "RGB4" | "XR24" | "XB24" | "RX24" => 4,
        _ => 1,
    }
}

/// Red, green and blue of a pixel of full range, by the equations of JFIF.
fn colours([luma, u, v]: [u8; 3]) -> [u8; 3] {
    let [luma, u, v] = [f64::from(luma), f64::from(u) - 128.0, f64::from(v) - 128.0];
    [luma + 1.402 * v, luma - 0.344_14 * u - 0.714_14 * v, luma + 1.772 * u].map(|it| it.round() as u8)
}

/// Arranges the samples of a 4:2:2 picture of 640x480 pixels in the order of the format `fourcc`.
fn raw(fourcc: &str, stride: usize, [luma, u, v]: [&[u8]; 3]) -> Vec<u8> {
    let padded = |mut row: Vec<u8>, bytes: usize| {
        row.resize(bytes, 0);
        row
    };
    let chroma = |row: usize| u[row * 320..][..320].iter().zip(&v[row * 320..][..320]);
    let luma = |row: usize| luma[row * 640..][..640].to_vec();
    let luma_rows = (0..480).flat_map(|row| padded(luma(row), stride));
    match fourcc {
        "GREY" => luma_rows.collect(),
        "NV12" | "NV21" | "NV16" | "NV61" => {
            let is_v_first = ["NV21", "NV61"].contains(&fourcc);
            let step = if ["NV12", "NV21"].contains(&fourcc) { 2 } else { 1 };
            let pairs =
                |row: usize| chroma(row).flat_map(|(u, v)| if is_v_first { [*v, *u] } else { [*u, *v] }).collect();
            luma_rows.chain((0..480).step_by(step).flat_map(|row| padded(pairs(row), stride))).collect()
        }
        "YU12" | "YV12" | "422P" => {
            let step = if fourcc == "422P" { 1 } else { 2 };
            let plane = |of: &[u8]| {
                let rows = (0..480).step_by(step).flat_map(|row| padded(of[row * 320..][..320].to_vec(), stride / 2));
                rows.collect::<Vec<u8>>()
            };
            let planes = if fourcc == "YV12" { [plane(v), plane(u)] } else { [plane(u), plane(v)] };
            luma_rows.chain(planes.concat()).collect()
        }
        "YUYV" | "UYVY" | "YVYU" | "VYUY" => {
            let pixels = |row: usize| {
                let luma = luma(row);
                let pairs = luma.as_chunks::<2>().0.iter().zip(chroma(row));
                let bytes = pairs.flat_map(|([first, second], (u, v))| match fourcc {
                    "YUYV" => [*first, *u, *second, *v],
                    "UYVY" => [*u, *first, *v, *second],
                    "YVYU" => [*first, *v, *second, *u],
                    _ => [*v, *first, *u, *second],
                });
                bytes.collect::<Vec<u8>>()
            };
            (0..480).flat_map(|row| padded(pixels(row), stride)).collect()
        }
        // The unused bytes are not black, so that nobody takes them for a colour.
        "RGB3" | "BGR3" | "RGB4" | "XR24" | "XB24" | "RX24" | "RGBP" => {
            let pixels = |row: usize| {
                let chroma: Vec<_> = chroma(row).collect();
                let pixel = |(at, luma): (usize, u8)| {
                    let [red, green, blue] = colours([luma, *chroma[at / 2].0, *chroma[at / 2].1]);
                    match fourcc {
                        "RGB3" => vec![red, green, blue],
                        "BGR3" => vec![blue, green, red],
                        "RGB4" => vec![99, red, green, blue],
                        "XR24" => vec![blue, green, red, 99],
                        "XB24" => vec![red, green, blue, 99],
                        "RX24" => vec![99, blue, green, red],
                        _ => {
                            let [red, green, blue] = [red >> 3, green >> 2, blue >> 3].map(u16::from);
                            (red << 11 | green << 5 | blue).to_le_bytes().to_vec()
                        }
                    }
                };
                luma(row).into_iter().enumerate().flat_map(pixel).collect::<Vec<u8>>()
            };
            (0..480).flat_map(|row| padded(pixels(row), stride)).collect()
        }
        "Y10 " | "Y12 " | "Y16 " => {
            let bits: u32 = fourcc[1..].trim().parse().unwrap();
            let deep = |luma: u8| (u16::from(luma) << (bits - 8)).to_le_bytes();
            (0..480).flat_map(|row| padded(luma(row).into_iter().flat_map(deep).collect(), stride)).collect()
        }
        _ => panic!("no pixels in {fourcc}"),
    }
}
