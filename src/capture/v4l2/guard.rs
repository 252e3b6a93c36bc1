//! Converts panics of the v4l crate into errors of one camera.
//!
//! The crate panics on unexpected values: a field order that the kernel does not define (the writer of a v4l2loopback
//! device can set one), a name that is not UTF-8, or an error when buffers are given back.

use std::any::Any;
use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::Path;
use std::sync::Once;

use super::super::CaptureError;

thread_local! {
    /// Whether [`guarded`] reports a panic of this thread as an error.
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `ask` on the device at `path`. A panic becomes an error and is not printed.
///
/// # Errors
/// [`CaptureError::Driver`] for a panic, and the errors of `ask`.
pub(super) fn guarded<T>(path: &Path, ask: impl FnOnce() -> Result<T, CaptureError>) -> Result<T, CaptureError> {
    silence_guarded_panics();
    let before = GUARDED.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(ask));
    GUARDED.set(before);
    outcome.unwrap_or_else(|panic| {
        Err(CaptureError::Driver { path: path.display().to_string(), reason: message(&*panic).to_owned() })
    })
}

/// Installs a panic hook that ignores guarded panics, and passes all others to the previous hook.
fn silence_guarded_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let previous = take_hook();
        set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                previous(info);
            }
        }));
    });
}

fn message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message")
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error_of_the_device_and_later_panics_are_not_guarded() {
        let outcome = guarded(Path::new("/dev/video7"), || -> Result<(), _> { panic!("Invalid field order: {}", 77) });
        let text = outcome.map_err(|error| error.to_string());
        assert!(text.is_err_and(|text| text.contains("/dev/video7") && text.contains("(Invalid field order: 77)")));
        assert!(!GUARDED.get());
    }

    #[test]
    fn results_without_a_panic_are_returned_unchanged() {
        assert!(matches!(guarded(Path::new("/dev/video7"), || Ok(3)), Ok(3)));
        assert!(matches!(
            guarded(Path::new("/dev/video7"), || Err::<(), _>(CaptureError::Gone)),
            Err(CaptureError::Gone)
        ));
    }
}
