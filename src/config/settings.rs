//! Every setting: key, type, default, bounds, unit and comment. Nothing about them stands anywhere else.

use toml::de::DeValue;

use super::{
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
            log: LogSettings::default(),
        }
    }
}

section! {
    /// Where frames come from.
    CameraSettings {
        /// Camera: "auto" (the first one), "/dev/video0" or a link to it, part of a camera's name, or "demo" (the built-in
        /// clip played as a camera). `facewire devices` lists what there is.
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
        /// Folder of the networks; empty: searched in the usual places.
        folder: String = String::new(), (), "";
        /// Threads of one inference.
        threads: u32 = 1, 1..=8, "";
    }
}

section! {
    /// From landmarks to coefficients.
    SolverSettings {
        /// File of the fitted model; empty: the built-in one.
        model: String = String::new(), (), "";
        /// Earlier frames that smoothing averages with the newest, for the eyes at most 2; 0 is off.
        smoothing_frames: u32 = 5, 0..=10, " (frames)";
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
        /// Packets a second while the output moves without a new pose. A new pose is sent at once, a neutral face 10 times
        /// a second.
        rate_hz: u32 = 60, 1..=240, " (1/s)";
    }
}

section! {
    /// A receiver. Each `[[link]]` adds one; the first in a file replaces those before it.
    LinkSettings {
        /// Carrier and format: "udp" sends facewire packets.
        kind: LinkKind = LinkKind::Udp, (), "";
        /// Where to: a host name, an address, a broadcast or a multicast address.
        address: Address = Address::default(), (), "";
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

/// Carrier and format of a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkKind {
    /// Packets of version 1 by UDP.
    Udp,
}

impl Choice for LinkKind {
    const ALL: &'static [(&'static str, Self)] = &[("udp", Self::Udp)];
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
