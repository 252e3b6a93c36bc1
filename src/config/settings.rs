//! Every setting: key, type, default, bounds, unit and comment. Nothing about them stands anywhere else.

use std::path::PathBuf;

use facewire_packet::FRAME_BYTES;
use toml::de::DeValue;

use super::{
    listen::Listen,
    section::{Section, section, write_setting},
    value::{Address, Choice, Value},
};

/// All settings, one field a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// `[camera]`
    pub camera: CameraSettings,
    /// `[networks]`
    pub networks: NetworkSettings,
    /// `[solver]`
    pub solver: SolverSettings,
    /// `[failsafe]`
    pub failsafe: FailsafeSettings,
    /// `[send]`
    pub send: SendSettings,
    /// `[[link]]`, at least one
    pub links: Vec<LinkSettings>,
    /// `[realtime]`
    pub realtime: RealtimeSettings,
    /// `[metrics]`
    pub metrics: MetricsSettings,
    /// `[log]`
    pub log: LogSettings,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            camera: CameraSettings::default(),
            networks: NetworkSettings::default(),
            solver: SolverSettings::default(),
            failsafe: FailsafeSettings::default(),
            send: SendSettings::default(),
            links: vec![LinkSettings::default()],
            realtime: RealtimeSettings::default(),
            metrics: MetricsSettings::default(),
            log: LogSettings::default(),
        }
    }
}

section! {
    /// Where frames come from.
    CameraSettings {
        /// Camera: "auto" (the first one), "/dev/video0" or a link to it, part of a camera's name (the first that bears
        /// it; of several, keep to one by its stable path), "demo" (the built-in clip played as a camera), or a
        /// rehearsal, which is that with faults: "rehearsal: live 5, gone 2" with the scenes live, no-face, damaged,
        /// silent, hung and gone and their seconds, or "rehearsal: random 7". `facewire devices` lists what there is.
        device: String = "auto".to_owned(), (), "";
        /// Picture width. Of the camera's modes that reach `fps`, the nearest is taken.
        width: u32 = 640, 160..=3840, " (pixels)";
        /// Picture height.
        height: u32 = 480, 120..=2160, " (pixels)";
        /// Frames a second.
        fps: u32 = 30, 1..=240, " (1/s)";
        /// Pixel format; "auto" takes the one that costs least.
        format: CameraFormat = CameraFormat::Auto, (), "";
        /// A camera that gives no frame for so long is opened anew.
        stall_timeout_ms: u32 = 1000, 100..=60_000, " (ms)";
        /// Horizontal field of view of the lens: turns pixels into millimetres for the head's position.
        horizontal_fov_deg: f32 = 60.0, 10.0..=170.0, " (degrees)";
    }
}

section! {
    /// The networks that find face and landmarks.
    NetworkSettings {
        /// Folder of the networks; empty: searched in the usual places. One that does not begin with / is looked for from
        /// the folder in which facewire is started.
        folder: String = String::new(), (), "";
        /// Threads of one inference.
        threads: u32 = 1, 1..=8, "";
    }
}

section! {
    /// From landmarks to coefficients.
    SolverSettings {
        /// File of the fitted model; empty: the built-in one. One that does not begin with / is looked for as above.
        model: String = String::new(), (), "";
        /// Smoothing averages small changes of a coefficient over this time, for the eyes over at most 80 ms; 0 is off.
        /// A time that holds fewer than 2 earlier frames smooths nothing.
        smoothing_ms: u32 = 180, 0..=350, " (ms)";
    }
}

section! {
    /// What is sent when poses stop coming. Times count from the capture of the last good pose.
    FailsafeSettings {
        /// Live up to here, or for 3 frame periods if that is longer; the later times move with it.
        live_ms: u32 = 150, 20..=5000, " (ms)";
        /// The last pose stands still up to here.
        hold_ms: u32 = 300, 40..=10_000, " (ms)";
        /// The face is neutral from here on, or later where `slew_per_s` allows no more.
        neutral_ms: u32 = 1000, 60..=60_000, " (ms)";
        /// Fastest change of a coefficient on the way to neutral and back.
        slew_per_s: f32 = 4.0, 0.1..=100.0, " (1/s)";
    }
}

section! {
    /// How packets are sent.
    SendSettings {
        /// Packets a second while the output moves without a new pose. A new pose is sent at once; a face that is neutral,
        /// or waits for the next pose, 10 times a second.
        rate_hz: u32 = 60, 10..=240, " (1/s)";
    }
}

section! {
    /// A receiver. Each `[[link]]` adds one; the first in a file replaces those before it.
    LinkSettings {
        /// Carrier: "udp" sends each packet as a datagram, "serial" as a frame (COBS) of 134 bytes.
        kind: LinkKind = LinkKind::Udp, (), "";
        /// Where to: a host name, an address, a broadcast or a multicast address.
        address: Address = Address::default(), (), "";
        /// Serial port, best by a path that stays when others are plugged in: `facewire devices` lists what there is, with
        /// such paths.
        device: PathBuf = PathBuf::new(), (), "";
        /// Bits a second on the line. At most 80 % of them may be used: 115200 carries a `camera.fps` and a
        /// `send.rate_hz` of 68.
        baud: u32 = 115_200, 19_200..=4_000_000, " (1/s)";
    }
}

/// Share of a serial line that packets may use, percent: the rest is for clocks that differ, and to catch up.
const LINE_SHARE: u64 = 80;
/// A byte on a serial line: start bit, 8 bits, stop bit.
const BITS_PER_BYTE: u64 = 10;

/// Most packets a second that a serial line of so many bits a second may be given.
pub fn most_packets_hz(baud: u32) -> u32 {
    let packets = u64::from(baud) * LINE_SHARE / 100 / (FRAME_BYTES as u64 * BITS_PER_BYTE);
    u32::try_from(packets).unwrap_or(u32::MAX)
}

section! {
    /// What the system is asked for at the start, so that other programs cannot hold the service up. Where it refuses,
    /// the service runs on and the status line says so.
    RealtimeSettings {
        /// Keeps the service's memory in RAM, all its stack among it.
        lock_memory: bool = false, (), "";
        /// Real-time priority (`SCHED_FIFO`) of the thread that runs frames; the one that sends has one more. 0 is off.
        priority: u32 = 0, 0..=98, "";
        /// The only CPU of the thread that runs frames; -1 leaves it to the system.
        hot_cpu: i32 = -1, -1..=1023, "";
        /// The only CPU of the thread that sends; -1 leaves it to the system.
        sender_cpu: i32 = -1, -1..=1023, "";
    }
}

section! {
    /// Counts and times for Prometheus and its kin.
    MetricsSettings {
        /// Where they can be read by HTTP, at /metrics, from this machine only: an address and port, or a Unix socket; empty:
        /// nowhere.
        listen: Listen = Listen::Off, (), "";
    }
}

section! {
    /// What is logged.
    LogSettings {
        /// Least severe level that is logged.
        level: LogLevel = LogLevel::Info, (), "";
    }
}

/// Pixel format of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraFormat {
    /// The cheapest the camera has.
    Auto,
    /// Packed 4:2:2.
    Yuyv,
    /// Motion-JPEG.
    Mjpeg,
    /// Semi-planar 4:2:0.
    Nv12,
    /// Luma only.
    Grey,
}

impl Choice for CameraFormat {
    const ALL: &'static [(&'static str, Self)] = &[
        ("auto", Self::Auto),
        ("yuyv", Self::Yuyv),
        ("mjpeg", Self::Mjpeg),
        ("nv12", Self::Nv12),
        ("grey", Self::Grey),
    ];
}

/// Carrier of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkKind {
    /// Packets of version 1 by UDP.
    Udp,
    /// Packets of version 1 as frames on a serial line.
    Serial,
}

impl LinkKind {
    /// The keys that a link of this kind has.
    pub(super) fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Udp => &["kind", "address"],
            Self::Serial => &["kind", "device", "baud"],
        }
    }
}

impl Choice for LinkKind {
    const ALL: &'static [(&'static str, Self)] = &[("udp", Self::Udp), ("serial", Self::Serial)];
}

/// Severity of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// Only what stops the service.
    Error,
    /// What needs a look.
    Warn,
    /// Changes of state and a status line.
    Info,
    /// What helps to find a fault.
    Debug,
    /// Everything.
    Trace,
}

impl Choice for LogLevel {
    const ALL: &'static [(&'static str, Self)] = &[
        ("error", Self::Error),
        ("warn", Self::Warn),
        ("info", Self::Info),
        ("debug", Self::Debug),
        ("trace", Self::Trace),
    ];
}
