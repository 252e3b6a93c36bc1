//! Every table of the settings, with the type, the default, the bounds and the unit of each key.
//!
//! `systemd/facewire.toml` explains them. The tables of links are in `link.rs`.

use super::{
    link::LinkSettings,
    overlay::{Entry, Field, Overlay, Section, Setting, field, key, section, table},
    value::{ANY_TEXT, Listen, choices},
};
use facewire_face::{Adjustment, Adjustments, BLENDSHAPES, EngineChoice, FilterKind, Group, NeutralMode, Rules};

section! {
    Settings {
        board: &'static str = "generic";
        camera: CameraSettings = CameraSettings::default();
        networks: NetworkSettings = NetworkSettings::default();
        solver: SolverSettings = SolverSettings::default();
        smoothing: SmoothingSettings = SmoothingSettings::default();
        wearer: WearerSettings = WearerSettings::default();
        plausibility: Rules = Rules { mouth_close: true, opposed: true, lids: true, gaze: true, dead_zone: 0.02 };
        adjust: Adjustments = Adjustments::default();
        failsafe: FailsafeSettings = FailsafeSettings::default();
        send: SendSettings = SendSettings::default();
        links "link": Vec<LinkSettings> = vec![LinkSettings::default(), LinkSettings::to_the_board()];
        realtime: RealtimeSettings = RealtimeSettings::default();
        hardware: HardwareSettings = HardwareSettings::default();
        adaptation: AdaptationSettings = AdaptationSettings::default();
        metrics: MetricsSettings = MetricsSettings::default();
        log: LogSettings = LogSettings::default();
    }

    CameraSettings {
        device: String = "auto".to_owned(), ANY_TEXT;
        width: u32 = 640, (160..=3840, " (pixels)");
        height: u32 = 480, (120..=2160, " (pixels)");
        fps: u32 = 30, (1..=240, " (1/s)");
        format: CameraFormat = CameraFormat::Auto;
        stall_timeout_ms: u32 = 1000, (100..=60_000, " (ms)");
        horizontal_fov_deg: f32 = 60.0, (10.0..=170.0, " (degrees)");
    }

    NetworkSettings {
        folder: String = String::new(), ANY_TEXT;
        engine: EngineChoice = EngineChoice::Auto;
        threads: u32 = 1, (1..=8, "");
    }

    SolverSettings {
        model: String = String::new(), ANY_TEXT;
    }

    SmoothingSettings {
        lids: FilterKind = FilterKind::GatedAverage;
        lids_ms: u32 = 350, (0..=350, " (ms)");
        gaze: FilterKind = FilterKind::Kalman;
        gaze_ms: u32 = 200, (0..=350, " (ms)");
        brows: FilterKind = FilterKind::GatedAverage;
        brows_ms: u32 = 350, (0..=350, " (ms)");
        mouth: FilterKind = FilterKind::GatedAverage;
        mouth_ms: u32 = 350, (0..=350, " (ms)");
        jaw: FilterKind = FilterKind::GatedAverage;
        jaw_ms: u32 = 220, (0..=350, " (ms)");
        cheeks: FilterKind = FilterKind::GatedAverage;
        cheeks_ms: u32 = 350, (0..=350, " (ms)");
        head: FilterKind = FilterKind::GatedAverage;
        head_ms: u32 = 350, (0..=350, " (ms)");
    }

    WearerSettings {
        name: String = String::new(), ANY_TEXT;
        folder: String = String::new(), ANY_TEXT;
        neutral: NeutralMode = NeutralMode::Auto;
    }

    FailsafeSettings {
        live_ms: u32 = 150, (20..=5000, " (ms)");
        hold_ms: u32 = 300, (40..=10_000, " (ms)");
        neutral_ms: u32 = 1000, (60..=60_000, " (ms)");
        slew_per_s: f32 = 4.0, (0.1..=100.0, " (1/s)");
    }

    SendSettings {
        rate_hz: u32 = 60, (10..=240, " (1/s)");
    }

    RealtimeSettings {
        lock_memory: bool = false;
        priority: u32 = 0, (0..=98, "");
        hot_cpu: i32 = -1, (-1..=1023, "");
        sender_cpu: i32 = -1, (-1..=1023, "");
    }

    HardwareSettings {
        thermal_zone: String = String::new(), ANY_TEXT;
        temperature_limit_c: u32 = 0, (0..=120, " (°C)");
    }

    AdaptationSettings {
        enabled: bool = true;
    }

    MetricsSettings {
        listen: Listen = Listen::Off;
    }

    LogSettings {
        level: LogLevel = LogLevel::Info;
    }
}

impl Section for Rules {
    fn fields(&mut self) -> Vec<Field<'_>> {
        vec![
            field("lids", &mut self.lids, ()),
            field("gaze", &mut self.gaze, ()),
            field("opposed", &mut self.opposed, ()),
            field("mouth_close", &mut self.mouth_close, ()),
            field("dead_zone", &mut self.dead_zone, (0.0..=0.2, "")),
        ]
    }
}

table!(Rules);

/// `mirror`, and a key for each blendshape.
impl Section for Adjustments {
    fn fields(&mut self) -> Vec<Field<'_>> {
        let coefficients = BLENDSHAPES.into_iter().zip(&mut self.coefficients);
        let coefficients = coefficients.map(|(key, adjustment)| field(key, adjustment, ()));
        [field("mirror", &mut self.mirror, ())].into_iter().chain(coefficients).collect()
    }
}

table!(Adjustments);

impl Section for Adjustment {
    fn fields(&mut self) -> Vec<Field<'_>> {
        vec![
            field("gain", &mut self.gain, (0.0..=10.0, "")),
            field("offset", &mut self.offset, (-1.0..=1.0, "")),
            field("min", &mut self.min, (0.0..=1.0, "")),
            field("max", &mut self.max, (0.0..=1.0, "")),
        ]
    }
}

impl Setting for Adjustment {
    type Bounds = ();

    fn set(&mut self, entry: &Entry<'_>, (): &(), file: &mut Overlay<'_>) {
        file.section(self, entry);
        if self.min > self.max {
            file.refuse(entry, "a min that is at most max".to_owned());
        }
    }
}

/// The board is chosen before the tables are read.
impl Setting for &'static str {
    type Bounds = ();

    fn set(&mut self, _: &Entry<'_>, (): &(), _: &mut Overlay<'_>) {}
}

impl SmoothingSettings {
    /// The filter of a group of coefficients and its time in milliseconds.
    pub fn of(&self, group: Group) -> (FilterKind, u32) {
        match group {
            Group::Lids => (self.lids, self.lids_ms),
            Group::Gaze => (self.gaze, self.gaze_ms),
            Group::Brows => (self.brows, self.brows_ms),
            Group::Mouth => (self.mouth, self.mouth_ms),
            Group::Jaw => (self.jaw, self.jaw_ms),
            Group::Cheeks => (self.cheeks, self.cheeks_ms),
        }
    }
}

choices! { pub enum CameraFormat: Auto = "auto", Yuyv = "yuyv", Mjpeg = "mjpeg", Nv12 = "nv12", Grey = "grey" }
choices! {
    /// Severity of a log message.
    pub enum LogLevel: Error = "error", Warn = "warn", Info = "info", Debug = "debug", Trace = "trace"
}
choices! { EngineChoice: Auto = "auto", Native = "native", OnnxRuntime = "onnxruntime" }
choices! {
    FilterKind: Off = "off", Kalman = "kalman", MovingAverage = "moving-average",
    TimeWeightedAverage = "time-weighted-average", LowPass = "low-pass", GatedAverage = "gated-average",
    OneEuro = "one-euro"
}
choices! { NeutralMode: Auto = "auto", Frozen = "frozen", Off = "off" }
