//! Every setting: its key, type, default, bounds, unit and comment. `facewire defaults` prints them as they stand here.
//!
//! The settings of links stand in `link.rs`.

use toml::de::DeValue;

use super::{
    adjust::AdjustSettings,
    link::LinkSettings,
    listen::Listen,
    section::{Section, section, write_setting},
    smoothing::{PlausibilitySettings, SmoothingSettings},
    value::{Choice, Value},
};
use crate::solve::NeutralMode;

/// All settings, one field per table.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The name of the board whose settings replace the defaults.
    pub board: &'static str,
    /// `[camera]`
    pub camera: CameraSettings,
    /// `[networks]`
    pub networks: NetworkSettings,
    /// `[solver]`
    pub solver: SolverSettings,
    /// `[smoothing]`
    pub smoothing: SmoothingSettings,
    /// `[wearer]`
    pub wearer: WearerSettings,
    /// `[plausibility]`
    pub plausibility: PlausibilitySettings,
    /// `[adjust]`
    pub adjust: AdjustSettings,
    /// `[failsafe]`
    pub failsafe: FailsafeSettings,
    /// `[send]`
    pub send: SendSettings,
    /// `[[link]]`, at least one
    pub links: Vec<LinkSettings>,
    /// `[realtime]`
    pub realtime: RealtimeSettings,
    /// `[hardware]`
    pub hardware: HardwareSettings,
    /// `[adaptation]`
    pub adaptation: AdaptationSettings,
    /// `[metrics]`
    pub metrics: MetricsSettings,
    /// `[log]`
    pub log: LogSettings,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            board: "generic",
            camera: CameraSettings::default(),
            networks: NetworkSettings::default(),
            solver: SolverSettings::default(),
            smoothing: SmoothingSettings::default(),
            wearer: WearerSettings::default(),
            plausibility: PlausibilitySettings::default(),
            adjust: AdjustSettings::default(),
            failsafe: FailsafeSettings::default(),
            send: SendSettings::default(),
            links: vec![LinkSettings::default(), LinkSettings::to_the_board()],
            realtime: RealtimeSettings::default(),
            hardware: HardwareSettings::default(),
            adaptation: AdaptationSettings::default(),
            metrics: MetricsSettings::default(),
            log: LogSettings::default(),
        }
    }
}

section! {
    /// The source of frames.
    CameraSettings {
        /// The camera:
        /// - "auto": the first camera that works
        /// - "/dev/video0", or a link to such a device: `facewire devices` lists the paths that always mean the same camera
        /// - a part of a camera's name, such as "C920": the first camera of this name that works
        /// - "demo": the built-in clip, played in real time
        /// - "rehearsal: live 5, gone 2": the built-in clip with faults; the scenes live, no-face, damaged, silent, hung,
        ///   gone, dark, cut-off, half-rate, lossy, slow-2, slow-4, slow-8, slow-jpeg, hot and undervoltage take turns,
        ///   each for its number of seconds
        /// - "rehearsal: random 7": the built-in clip with random faults, the same ones for each number
        device: String = "auto".to_owned(), (), "";
        /// Width of the picture. Among the camera's modes that reach `fps`, facewire takes the one nearest to `width` and
        /// `height`.
        width: u32 = 640, 160..=3840, " (pixels)";
        /// Height of the picture.
        height: u32 = 480, 120..=2160, " (pixels)";
        /// Frame rate.
        fps: u32 = 30, 1..=240, " (1/s)";
        /// Pixel format. "auto" takes the one that the processor decodes fastest.
        format: CameraFormat = CameraFormat::Auto, (), "";
        /// A camera that delivers no frame for this long is closed and opened again.
        stall_timeout_ms: u32 = 1000, 100..=60_000, " (ms)";
        /// Horizontal field of view of the lens. It sets the scale of the head's position in millimetres.
        horizontal_fov_deg: f32 = 60.0, 10.0..=170.0, " (degrees)";
    }
}

section! {
    /// The networks that find the face and its landmarks.
    NetworkSettings {
        /// Folder of the network files. If empty, facewire searches the usual folders. A path that does not begin with /
        /// starts at the folder in which facewire is started.
        folder: String = String::new(), (), "";
        /// What runs the networks: "native" is facewire's own engine, "onnxruntime" is ONNX Runtime (scripts/setup
        /// onnxruntime installs it). "auto" is "native".
        engine: EngineChoice = EngineChoice::Auto, (), "";
        /// Number of threads that run one network.
        threads: u32 = 1, 1..=8, "";
    }
}

section! {
    /// From landmarks to coefficients.
    SolverSettings {
        /// File of a fitted blendshape model: a hidden layer, or one formula for each blendshape. If empty, facewire uses
        /// the built-in model. A path that does not begin with / starts at the folder in which facewire is started.
        model: String = String::new(), (), "";
    }
}

section! {
    /// The person whose face is followed.
    WearerSettings {
        /// The wearer whose profile is in use: a name that was given to `facewire calibrate --wearer`. If empty, nobody's.
        name: String = String::new(), (), "";
        /// Folder of the profiles. If empty, it is /var/lib/facewire, or ~/.local/state/facewire for a user who may not read
        /// that. A path that does not begin with / starts at the folder in which facewire is started.
        folder: String = String::new(), (), "";
        /// The neutral face of a wearer without a profile:
        /// - "auto": estimated while facewire watches, anew when another person sits down
        /// - "frozen": as it was estimated until now; after a start, the mean of many people
        /// - "off": the mean of many people
        neutral: NeutralMode = NeutralMode::Auto, (), "";
    }
}

impl Choice for NeutralMode {
    const ALL: &'static [(&'static str, Self)] = &[("auto", Self::Auto), ("frozen", Self::Frozen), ("off", Self::Off)];
}

section! {
    /// What receivers get while no poses come. All times count from the capture of the last good pose.
    FailsafeSettings {
        /// The face stays live until this time, or for 3 frame periods if they take longer; the times below then
        /// move by the same amount.
        live_ms: u32 = 150, 20..=5000, " (ms)";
        /// The last pose is held until this time.
        hold_ms: u32 = 300, 40..=10_000, " (ms)";
        /// The face has moved to neutral by this time, or later if `slew_per_s` does not allow it.
        neutral_ms: u32 = 1000, 60..=60_000, " (ms)";
        /// Fastest change of a coefficient on the way to neutral and back to the live face. A coefficient goes from 0
        /// to 1.
        slew_per_s: f32 = 4.0, 0.1..=100.0, " (1/s)";
    }
}

section! {
    /// How often links send.
    SendSettings {
        /// Packets per second, for every link whose own `rate_hz` is 0. With the default pace, a link sends new poses at once
        /// and uses this rate while the face holds, decays or returns to live.
        rate_hz: u32 = 60, 10..=240, " (1/s)";
    }
}

section! {
    /// Protection from other programs on this machine, requested at the start. If the system refuses a request, the
    /// service runs without it and the status line says so.
    RealtimeSettings {
        /// Keeps all memory of the service in RAM, the stacks of its threads included.
        lock_memory: bool = false, (), "";
        /// Real-time priority (`SCHED_FIFO`) of the thread that processes frames; the thread that sends packets gets one
        /// more. 0 leaves both at ordinary priority.
        priority: u32 = 0, 0..=98, "";
        /// The CPU on which the thread that processes frames runs; -1 lets the system choose.
        hot_cpu: i32 = -1, -1..=1023, "";
        /// The CPU on which the thread that sends packets runs; -1 lets the system choose.
        sender_cpu: i32 = -1, -1..=1023, "";
    }
}

section! {
    /// The sensors of the board. The service and `facewire check` tell when the board slows down.
    HardwareSettings {
        /// The thermal zone of the processor: the text in a file `/sys/class/thermal/thermal_zone*/type`. If empty,
        /// facewire finds it.
        thermal_zone: String = String::new(), (), "";
        /// From this temperature on the processor is hot. 0 stands for the temperature at which the kernel slows the
        /// processor down, or 10 degrees below the one at which it switches the board off.
        temperature_limit_c: u32 = 0, 0..=120, " (°C)";
    }
}

section! {
    /// What the service does while the board is too slow, hot, or badly supplied with power.
    AdaptationSettings {
        /// Processes fewer frames, evenly spaced, and goes back to all of them when the board can. If false, the service
        /// skips the frames for which it has no time, so that motion is uneven, and does not spare a hot board.
        enabled: bool = true, (), "";
    }
}

section! {
    /// Counters and times for Prometheus and compatible programs.
    MetricsSettings {
        /// Where programs on this machine can read the metrics by HTTP, at /metrics: a loopback address and port, or a
        /// Unix socket. If empty, there are no metrics.
        listen: Listen = Listen::Off, (), "";
    }
}

section! {
    /// The log.
    LogSettings {
        /// Least severe level that is logged.
        level: LogLevel = LogLevel::Info, (), "";
    }
}

/// Pixel format of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraFormat {
    /// The format that takes the least time to decode.
    Auto,
    /// Packed YUV 4:2:2.
    Yuyv,
    /// Motion-JPEG.
    Mjpeg,
    /// Semi-planar YUV 4:2:0.
    Nv12,
    /// Grey only.
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

/// What runs the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EngineChoice {
    /// The engine that is best for this machine.
    Auto,
    /// facewire's own engine.
    Native,
    /// ONNX Runtime.
    OnnxRuntime,
}

impl Choice for EngineChoice {
    const ALL: &'static [(&'static str, Self)] =
        &[("auto", Self::Auto), ("native", Self::Native), ("onnxruntime", Self::OnnxRuntime)];
}

/// Severity of a log message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// The service cannot do its work.
    Error,
    /// A fault that the service works around.
    Warn,
    /// A change of state, or the status line.
    Info,
    /// Details that help to find a fault.
    Debug,
    /// All details.
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
