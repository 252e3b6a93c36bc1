//! Settings: TOML files laid over the defaults.
//!
//! Role: reads `--board` and `--config` into one typed [`Settings`]. The board's file overrides the defaults, and the
//! user's file overrides the board's. A file contains only the settings that it changes, and may name the board. Which
//! board this is, the caller finds out.
//! Contract: either every setting is valid, or [`Faults`] names every fault at once, each with key, value and bounds.
//! Settings are judged by their text alone: no device, host or model file is touched. Links judge their settings
//! themselves, see [`load`].
//! `settings.rs` and `link.rs` declare each key with its type, default and bounds; `systemd/facewire.toml` and
//! `links.toml` explain them.

mod builtin;
mod link;
mod overlay;
mod rehearsal;
mod section;
mod settings;
#[cfg(test)]
mod tests;
mod value;

use std::path::Path;

pub use builtin::{BOARDS, DEFAULTS, default_link};
pub use link::{
    AtLoss, AutoDevice, CarrierSettings, ChannelSettings, IFacialMocapSettings, LinkKind, LinkSettings,
    LiveLinkSettings, Loss, MOST_MAESTRO_BAUD, MaestroProtocol, MaestroSettings, PaceKind, PaceSettings,
    Pca9685Settings, SOURCE_COUNT, SOURCE_NAMES, SerialSettings, Sources, UdpSettings, VmcSettings, VrchatSettings,
};
pub use overlay::{Fault, Faults};
pub use rehearsal::{BadScript, Scene, Script};
pub use settings::{
    AdaptationSettings, CameraFormat, CameraSettings, FailsafeSettings, HardwareSettings, LogLevel, LogSettings,
    MetricsSettings, NetworkSettings, RealtimeSettings, SendSettings, Settings, SmoothingSettings, SolverSettings,
    WearerSettings,
};
pub(crate) use value::quoted;
pub use value::{Address, Choice, JsonTarget, Listen, ParameterChoice, Parameters, SerialDevice};

use self::overlay::Boards;
use crate::calibration::WearerName;

/// Exit status for bad settings, as in `sysexits.h`. systemd does not restart a service that exits with it.
pub const EX_CONFIG: u8 = 78;
/// Slowest rate of a link, packets per second: receivers go neutral after 500 ms without one.
pub const SLOWEST_LINK_HZ: u32 = 10;

/// Loads the settings of a run: the defaults, overridden by the board, overridden by the file. `argument` takes precedence
/// over the board that the file names. `detected` is the board that was recognised, for "auto". `check` adds the faults
/// that settings can have besides, such as those of links.
pub fn load(
    argument: Option<&str>,
    detected: &str,
    file: Option<&Path>,
    check: impl FnOnce(&Settings, &mut Faults),
) -> Result<Settings, Faults> {
    let mut faults = Faults::default();
    let fixed = argument.and_then(|name| {
        let board = builtin::find_board(name, detected);
        if board.is_none() {
            let known = builtin::board_names().collect::<Vec<_>>().join(", ");
            faults.push(format!("board \"{name}\": not known; give --board one of {known}"));
        }
        board
    });
    let text = file.map_or_else(String::new, |path| {
        std::fs::read_to_string(path).unwrap_or_else(|error| {
            let path = path.display();
            faults.push(format!("{path}: cannot be read ({error}); give --config a readable file"));
            String::new()
        })
    });
    let source = file.map_or_else(String::new, |path| path.display().to_string());
    judged(&source, &text, Boards { fixed, detected }, faults, check)
}

/// Parses the settings in `text`, over the defaults and the board that the text names, with "generic" for "auto". Faults
/// refer to the text as `source`. Links are not checked.
pub fn parse(source: &str, text: &str) -> Result<Settings, Faults> {
    parse_and_check(source, text, |_, _| {})
}

/// As [`parse`], with the same `check` as [`load`].
pub fn parse_and_check(
    source: &str,
    text: &str,
    check: impl FnOnce(&Settings, &mut Faults),
) -> Result<Settings, Faults> {
    judged(source, text, Boards { fixed: None, detected: "generic" }, Faults::default(), check)
}

fn judged(
    source: &str,
    text: &str,
    boards: Boards<'_>,
    mut faults: Faults,
    check_more: impl FnOnce(&Settings, &mut Faults),
) -> Result<Settings, Faults> {
    let mut settings = Settings::default();
    overlay::lay(source, text, &mut settings, Some(boards), &mut faults);
    check(&settings, &mut faults);
    check_more(&settings, &mut faults);
    faults.into_result(settings)
}

/// Adds the faults of settings that are valid one by one but do not fit together. Tables with faults of their own are not
/// judged.
fn check(settings: &Settings, faults: &mut Faults) {
    let mut need = |is_good: bool, key: &str, value: String, expected: &str| {
        if !is_good && !faults.has_invalid_value(key.split('.').next().unwrap_or(key)) {
            faults.conflict(key, value, expected);
        }
    };
    let FailsafeSettings { live_ms, hold_ms, neutral_ms, .. } = settings.failsafe;
    let after_live = format!("more than failsafe.live_ms, which is {live_ms}");
    need(live_ms < hold_ms, "failsafe.hold_ms", hold_ms.to_string(), &after_live);
    let after_hold = format!("more than failsafe.hold_ms, which is {hold_ms}");
    need(hold_ms < neutral_ms, "failsafe.neutral_ms", neutral_ms.to_string(), &after_hold);
    let device = &settings.camera.device;
    let cameras = "\"auto\", the path of a camera, part of its name, \"demo\" or a rehearsal";
    need(!device.trim().is_empty(), "camera.device", format!("{device:?}"), cameras);
    let is_readable = Script::of(device).is_none_or(|script| script.is_ok());
    need(is_readable, "camera.device", format!("{device:?}"), Script::EXPECTED);
    let paths = [
        ("networks.folder", &settings.networks.folder),
        ("solver.model", &settings.solver.model),
        ("wearer.folder", &settings.wearer.folder),
    ];
    for (key, path) in paths {
        let expected = "a path from / on: no shell replaces the ~ of a setting";
        need(!path.starts_with('~'), key, format!("{path:?}"), expected);
    }
    let name = &settings.wearer.name;
    let is_name = name.is_empty() || WearerName::new(name).is_some();
    need(is_name, "wearer.name", format!("{name:?}"), &format!("{}, or \"\"", WearerName::EXPECTED));
    need(!settings.links.is_empty(), "link", "[]".to_owned(), "at least one [[link]]");
    for rate_hz in settings.links.iter().map(|link| link.pace.rate_hz).filter(|rate_hz| *rate_hz > 0) {
        let expected = format!("0 or at least {SLOWEST_LINK_HZ}: receivers go neutral when packets come more rarely");
        need(rate_hz >= SLOWEST_LINK_HZ, "link.rate_hz", rate_hz.to_string(), &expected);
    }
}
