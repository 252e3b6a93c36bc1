//! Every table of the settings, with the type, the default, the bounds and the unit of each key.
//!
//! `systemd/facewire.toml` explains them. The tables of links are in `link.rs`, and those that shape the output in
//! `face/src/settings/shaping.rs`, for the library has them, too.

use super::{
    board_names,
    link::{LinkSettings, Links},
    value::{ANY_TEXT, Choice, HOST_NAMES, Listen, choice, choices, listen, rotation, text},
};
use facewire_board::HardwareSettings;
use facewire_face::settings::{
    Entry, Field, Overlay, Reader, SmoothingSettings, Table, TableOf, Takes, field, flag, number, section, whole,
};
use facewire_face::{Adjustments, EngineChoice, Follow, HeadPose, Method, NeutralMode, Rotation, Rules, Wears};
use tracing::level_filters::LevelFilter;

section! {
    Settings {
        board: &'static str = "generic", Board;
        camera: CameraSettings = CameraSettings::default(), Table;
        networks: NetworkSettings = NetworkSettings::default(), Table;
        solver: SolverSettings = SolverSettings::default(), Table;
        smoothing: SmoothingSettings = SmoothingSettings::default(), Table;
        wearer: WearerSettings = WearerSettings::default(), Table;
        plausibility: Rules = Rules::ALL, Table;
        adjust: Adjustments = Adjustments::default(), Table;
        failsafe: FailsafeSettings = FailsafeSettings::default(), Table;
        send: SendSettings = SendSettings::default(), Table;
        links "link": Vec<LinkSettings> = vec![LinkSettings::default(), LinkSettings::to_the_board()], Links;
        realtime: RealtimeSettings = RealtimeSettings::default(), Table;
        hardware: HardwareSettings = HardwareSettings::default(), TableOf(hardware_fields);
        adaptation: AdaptationSettings = AdaptationSettings::default(), Table;
        metrics: MetricsSettings = MetricsSettings::default(), Table;
        console: ConsoleSettings = ConsoleSettings::default(), Table;
        log: LogSettings = LogSettings::default(), Table;
    }

    CameraSettings {
        device: String = "auto".to_owned(), text(ANY_TEXT);
        width: u32 = 640, whole(160..=3840, "pixels");
        height: u32 = 480, whole(120..=2160, "pixels");
        fps: u32 = 30, whole(1..=240, "1/s");
        format: CameraFormat = CameraFormat::Auto, choice();
        rotation: Rotation = Rotation::None, rotation();
        stall_timeout_ms: u32 = 1000, whole(100..=60_000, "ms");
        horizontal_fov_deg: f32 = 60.0, number(10.0..=170.0, "degrees");
    }

    NetworkSettings {
        folder: String = String::new(), text(ANY_TEXT);
        engine: EngineChoice = EngineChoice::Auto, choice();
        threads: u32 = 1, whole(1..=8, "");
    }

    SolverSettings {
        method: Method = Method::Network, choice();
        model: String = String::new(), text(ANY_TEXT);
    }

    WearerSettings {
        name: String = String::new(), text(ANY_TEXT);
        folder: String = String::new(), text(ANY_TEXT);
        neutral: NeutralMode = NeutralMode::Auto, choice();
        wears: Wears = Wears::Nothing, choice();
        follow: Follow = Follow::Wearer, choice();
        eye_distance_mm: f32 = HeadPose::EYE_DISTANCE_MM, number(20.0..=200.0, "mm");
    }

    FailsafeSettings {
        live_ms: u32 = 150, whole(20..=5000, "ms");
        hold_ms: u32 = 300, whole(40..=10_000, "ms");
        neutral_ms: u32 = 1000, whole(60..=60_000, "ms");
        slew_per_s: f32 = 4.0, number(0.1..=100.0, "1/s");
    }

    SendSettings { rate_hz: u32 = 60, whole(10..=240, "1/s"); }

    RealtimeSettings {
        lock_memory: bool = false, flag();
        priority: u32 = 0, whole(0..=98, "");
        hot_cpu: i32 = -1, whole(-1..=1023, "");
        sender_cpu: i32 = -1, whole(-1..=1023, "");
    }

    AdaptationSettings { enabled: bool = true, flag(); }
    MetricsSettings { listen: Listen = Listen::Off, listen(); }
    ConsoleSettings {
        picture: bool = false, flag();
        names: String = String::new(), text(HOST_NAMES);
    }
    LogSettings { level: LevelFilter = LevelFilter::INFO, choice(); }
}

/// The board is chosen before the tables are read.
struct Board;

impl Reader<&'static str> for Board {
    fn takes(&self, _: &mut &'static str) -> Takes {
        Takes::OneOf(board_names().collect())
    }

    fn read(&self, _: &mut &'static str, _: &Entry<'_>, _: &mut Overlay<'_>) {}
}

fn hardware_fields(hardware: &mut HardwareSettings) -> Vec<Field<'_>> {
    vec![
        field("thermal_zone", &mut hardware.thermal_zone, text(ANY_TEXT)),
        field("temperature_limit_c", &mut hardware.temperature_limit_c, whole(0..=120, "°C")),
    ]
}

choices! { pub enum CameraFormat: Auto = "auto", Yuyv = "yuyv", Mjpeg = "mjpeg", Nv12 = "nv12", Grey = "grey" }
choices! { LevelFilter: ERROR = "error", WARN = "warn", INFO = "info", DEBUG = "debug", TRACE = "trace" }
choices! { EngineChoice: Auto = "auto", Native = "native", OnnxRuntime = "onnxruntime" }
choices! { NeutralMode: Auto = "auto", Frozen = "frozen", Off = "off" }
choices! { Follow: Nearest = "nearest", Centre = "centre", Wearer = "wearer" }

impl Choice for Wears {
    const ALL: &'static [(&'static str, Self)] = Self::NAMES;
}

impl Choice for Method {
    const ALL: &'static [(&'static str, Self)] = Self::NAMES;
}
