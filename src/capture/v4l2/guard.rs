//! Keeps panics of the v4l crate within one camera.
//!
//! The crate panics on what it does not know: a field order that the kernel does not define, as the feeder of a
//! v4l2loopback device may set one, a name that is not UTF-8, or buffers that the driver does not take back.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::Path;
use std::sync::Once;

use super::super::CaptureError;

thread_local! {
    /// Whether a panic of this thread is an error that is told elsewhere.
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `ask` on the device at `path`; a panic becomes an error and is not printed.
///
/// # Errors
/// [`CaptureError::Driver`] in place of a panic, else those of `ask`.
pub(super) fn guarded<T>(path: &Path, ask: impl FnOnce() -> Result<T, CaptureError>) -> Result<T, CaptureError> {
    quieten();
    let before = GUARDED.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(ask));
    GUARDED.set(before);
    outcome.unwrap_or_else(|panic| {
        Err(CaptureError::Driver { path: path.display().to_string(), reason: message(&*panic).to_owned() })
    })
}

/// Leaves the panics of others to the hook that there is.
fn quieten() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let others = take_hook();
        set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                others(info);
            }
        }));
    });
}

fn message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("it does not say what")
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_the_error_of_that_device_and_what_comes_after_is_not_guarded() {
        let outcome = guarded(Path::new("/dev/video7"), || -> Result<(), _> { panic!("Invalid field order: {}", 77) });
        let text = outcome.map_err(|error| error.to_string());
        assert!(text.is_err_and(|text| text.contains("/dev/video7") && text.contains("(Invalid field order: 77)")));
        assert!(!GUARDED.get());
    }

    #[test]
    fn what_does_not_panic_passes_through() {
        assert!(matches!(guarded(Path::new("/dev/video7"), || Ok(3)), Ok(3)));
        assert!(matches!(
            guarded(Path::new("/dev/video7"), || Err::<(), _>(CaptureError::Gone)),
            Err(CaptureError::Gone)
        ));
    }
}
