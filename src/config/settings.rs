//! Every table of the settings, with the type, the default, the bounds and the unit of each key.
//!
//! `systemd/facewire.toml` explains them. The tables of links are in `link.rs`.

use super::{
    board_names,
    link::{LinkSettings, Links},
    overlay::{Entry, Field, Overlay, Reader, Section, field, section},
    takes::Takes,
    value::{ANY_TEXT, HOST_NAMES, Listen, Table, choice, choices, flag, listen, number, rotation, text, whole},
};
use facewire_board::HardwareSettings;
use facewire_face::{
    Adjustment, Adjustments, BLENDSHAPES, EngineChoice, FilterKind, Follow, Group, NeutralMode, Rotation, Rules, Wears,
};
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
        hardware: HardwareSettings = HardwareSettings::default(), Table;
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

    SmoothingSettings {
        lids: FilterKind = FilterKind::GatedAverage, choice();
        lids_ms: u32 = 350, whole(0..=350, "ms");
        gaze: FilterKind = FilterKind::GatedAverage, choice();
        gaze_ms: u32 = 100, whole(0..=350, "ms");
        brows: FilterKind = FilterKind::GatedAverage, choice();
        brows_ms: u32 = 350, whole(0..=350, "ms");
        mouth: FilterKind = FilterKind::GatedAverage, choice();
        mouth_ms: u32 = 350, whole(0..=350, "ms");
        jaw: FilterKind = FilterKind::GatedAverage, choice();
        jaw_ms: u32 = 220, whole(0..=350, "ms");
        cheeks: FilterKind = FilterKind::GatedAverage, choice();
        cheeks_ms: u32 = 350, whole(0..=350, "ms");
        head: FilterKind = FilterKind::GatedAverage, choice();
        head_ms: u32 = 350, whole(0..=350, "ms");
    }

    WearerSettings {
        name: String = String::new(), text(ANY_TEXT);
        folder: String = String::new(), text(ANY_TEXT);
        neutral: NeutralMode = NeutralMode::Auto, choice();
        wears: Wears = Wears::Nothing, choice();
        follow: Follow = Follow::Wearer, choice();
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

impl Section for Rules {
    fn fields(&mut self) -> Vec<Field<'_>> {
        vec![
            field("lids", &mut self.lids, flag()),
            field("gaze", &mut self.gaze, flag()),
            field("opposed", &mut self.opposed, flag()),
            field("mouth_close", &mut self.mouth_close, flag()),
            field("dead_zone", &mut self.dead_zone, number(0.0..=0.2, "")),
        ]
    }
}

impl Section for HardwareSettings {
    fn fields(&mut self) -> Vec<Field<'_>> {
        vec![
            field("thermal_zone", &mut self.thermal_zone, text(ANY_TEXT)),
            field("temperature_limit_c", &mut self.temperature_limit_c, whole(0..=120, "°C")),
        ]
    }
}

/// `mirror`, and a key for each blendshape.
impl Section for Adjustments {
    fn fields(&mut self) -> Vec<Field<'_>> {
        let coefficients = BLENDSHAPES.into_iter().zip(&mut self.coefficients);
        let coefficients = coefficients.map(|(key, coefficient)| field(key, coefficient, Limited));
        [field("mirror", &mut self.mirror, flag())].into_iter().chain(coefficients).collect()
    }
}

/// Reads an adjustment whose limits do not contradict each other.
struct Limited;

impl Reader<Adjustment> for Limited {
    fn takes(&self, adjustment: &mut Adjustment) -> Takes {
        Table.takes(adjustment)
    }

    fn read(&self, adjustment: &mut Adjustment, entry: &Entry<'_>, file: &mut Overlay<'_>) {
        file.section(adjustment, entry);
        if adjustment.min > adjustment.max {
            file.refuse(entry, "a min that is at most max".to_owned());
        }
    }
}

impl Section for Adjustment {
    fn fields(&mut self) -> Vec<Field<'_>> {
        vec![
            field("gain", &mut self.gain, number(0.0..=10.0, "")),
            field("offset", &mut self.offset, number(-1.0..=1.0, "")),
            field("min", &mut self.min, number(0.0..=1.0, "")),
            field("max", &mut self.max, number(0.0..=1.0, "")),
        ]
    }
}

impl SmoothingSettings {
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
    /// Which of the built-in models solves the coefficients.
    pub enum Method: Network = "network", Paper = "paper"
}
choices! { LevelFilter: ERROR = "error", WARN = "warn", INFO = "info", DEBUG = "debug", TRACE = "trace" }
choices! { EngineChoice: Auto = "auto", Native = "native", OnnxRuntime = "onnxruntime" }
choices! {
    FilterKind: Off = "off", Kalman = "kalman", MovingAverage = "moving-average",
    TimeWeightedAverage = "time-weighted-average", LowPass = "low-pass", GatedAverage = "gated-average",
    GatedAsPrinted = "gated-as-printed", OneEuro = "one-euro"
}
choices! { NeutralMode: Auto = "auto", Frozen = "frozen", Off = "off" }
choices! { Wears: Nothing = "nothing", Headset = "headset", Mask = "mask" }
choices! { Follow: Nearest = "nearest", Centre = "centre", Wearer = "wearer" }
