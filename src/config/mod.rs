//! Settings: TOML files laid over the defaults.
//!
//! Role: reads `--board` and `--config` into one typed [`Settings`]. The board's file overrides the defaults, and the
//! user's file overrides the board's. A file contains only the settings that it changes, and may name the board. Which
//! board this is, the caller finds out.
//! Contract: either every setting is valid, or [`Faults`] names every fault at once, each with key, value and bounds.
//! Settings are judged by their text alone: no device, host or model file is touched.
//! `settings.rs` and `link.rs` declare the settings: one entry gives a key its type, default, bounds and comment.

mod adjust;
mod avatar;
mod board;
mod check;
mod defaults;
mod fault;
mod link;
mod listen;
mod overlay;
mod receiver_check;
mod rehearsal;
mod section;
mod servo;
mod servo_check;
mod settings;
mod smoothing;
#[cfg(test)]
mod tests;
mod value;

use std::path::Path;

use overlay::{Boards, Overlay};

pub use adjust::AdjustSettings;
pub use avatar::{
    IFacialMocapSettings, JsonSettings, JsonTarget, ListenAddress, LiveLinkSettings, MaybeAddress, OscPrefix,
    ParameterChoice, Parameters, Text, VmcSettings, VrchatSettings,
};
pub use board::BOARDS;
pub use defaults::{default_link, defaults, written};
pub use fault::{Fault, Faults};
pub use link::{
    AutoDevice, CarrierSettings, LinkKind, LinkSettings, Loss, PaceKind, PaceSettings, SerialSettings, UdpSettings,
};
pub use listen::Listen;
pub use rehearsal::{BadScript, Scene, Script};
pub use servo::{
    ChannelSettings, MaestroBoard, MaestroProtocol, MaestroSettings, Pca9685Board, Pca9685Settings, ServoSettings,
    Sources,
};
pub use settings::{
    AdaptationSettings, CameraFormat, CameraSettings, EngineChoice, FailsafeSettings, HardwareSettings, LogLevel,
    LogSettings, MetricsSettings, NetworkSettings, RealtimeSettings, SendSettings, Settings, SolverSettings,
    WearerSettings,
};
pub use smoothing::{PlausibilitySettings, SmoothingSettings};
pub(crate) use value::Choice;
pub use value::{Address, SerialDevice};

/// Exit status for bad settings, as in `sysexits.h`. systemd does not restart a service that exits with it.
pub const EX_CONFIG: u8 = 78;

/// Loads the settings of a run: the defaults, overridden by the board, overridden by the file. `argument` takes precedence
/// over the board that the file names. `detected` is the board that was recognised, for "auto".
///
/// # Errors
/// Returns every fault: an unknown board, a file that cannot be read, and each fault inside the file.
pub fn load(argument: Option<&str>, detected: &str, file: Option<&Path>) -> Result<Settings, Faults> {
    let mut faults = Faults::default();
    let fixed = argument.and_then(|name| board::named(name, detected).map_err(|fault| faults.push(fault)).ok());
    let text = file.map_or_else(String::new, |path| {
        std::fs::read_to_string(path).unwrap_or_else(|error| {
            faults.push(Fault::Unreadable { path: path.to_owned(), error });
            String::new()
        })
    });
    let source = file.map_or_else(String::new, |path| path.display().to_string());
    judged(Overlay::new(&source, &text), Boards { fixed, detected }, faults)
}

/// Parses the settings in `text`, over the defaults and the board that the text names, with "generic" for "auto". Faults
/// refer to the text as `source`.
///
/// # Errors
/// Returns every fault.
pub fn parse(source: &str, text: &str) -> Result<Settings, Faults> {
    judged(Overlay::new(source, text), Boards { fixed: None, detected: "generic" }, Faults::default())
}

/// Lays a file over its board, and checks the result.
fn judged(file: Overlay<'_>, boards: Boards<'_>, mut faults: Faults) -> Result<Settings, Faults> {
    let mut settings = Settings::default();
    file.apply(&mut settings, Some(boards), &mut faults);
    check::check(&settings, &mut faults);
    faults.into_result(settings)
}
