//! Settings: TOML files laid over the defaults.
//!
//! Role: from `--board` and `--config` to one typed [`Settings`]. Defaults come first, then the board's file, then the
//! user's, which may name the board itself; a file names only what it changes.
//! Contract: nothing is half applied. Either every setting is within its bounds, or [`Faults`] names every fault of the
//! files at once, each with key, value and bounds, and no device was touched.
//! The settings themselves stand in `settings.rs`: one entry gives a key its type, default, bounds and comment.

mod board;
mod defaults;
mod fault;
mod listen;
mod overlay;
mod rehearsal;
mod section;
mod settings;
#[cfg(test)]
mod tests;
mod value;

use std::path::Path;

pub use board::BOARDS;
pub use defaults::{defaults, written};
pub use fault::{Fault, Faults};
pub use listen::Listen;
pub use rehearsal::{BadScript, Scene, Script};
pub use settings::{
    CameraFormat, CameraSettings, FailsafeSettings, LinkKind, LinkSettings, LogLevel, LogSettings, MetricsSettings,
    NetworkSettings, RealtimeSettings, SendSettings, Settings, SolverSettings,
};
pub use value::Address;

/// Exit status for bad settings, as in `sysexits.h`: systemd does not restart a service that ends with it.
pub const EX_CONFIG: u8 = 78;

/// The settings of a run: defaults, then the board's, then the file's. A board given here takes the place of the file's.
///
/// # Errors
/// Every fault found: an unknown board, a file that cannot be read, and all that is wrong inside it.
pub fn load(board: Option<&str>, file: Option<&Path>) -> Result<Settings, Faults> {
    let mut settings = Settings::default();
    let mut faults = Faults::default();
    if let Some(name) = board {
        match board::named(name) {
            Ok(board) => overlay::apply_board(&mut settings, board, &mut faults),
            Err(fault) => faults.push(fault),
        }
    }
    if let Some(path) = file {
        match std::fs::read_to_string(path) {
            Ok(text) => {
                let source = path.display().to_string();
                overlay::apply_file(&mut settings, &source, &text, board.is_none(), &mut faults);
            }
            Err(error) => faults.push(Fault::Unreadable { path: path.to_owned(), error }),
        }
    }
    overlay::check_together(&settings, &mut faults);
    overlay::check_ports(&settings, &mut faults);
    overlay::check_lines(&settings, &mut faults);
    faults.into_result(settings)
}

/// The settings in `text`, laid over the defaults and the board it names; `source` names it in faults.
///
/// # Errors
/// Every fault found.
pub fn parse(source: &str, text: &str) -> Result<Settings, Faults> {
    let mut settings = Settings::default();
    let mut faults = Faults::default();
    overlay::apply_file(&mut settings, source, text, true, &mut faults);
    overlay::check_together(&settings, &mut faults);
    overlay::check_ports(&settings, &mut faults);
    overlay::check_lines(&settings, &mut faults);
    faults.into_result(settings)
}
